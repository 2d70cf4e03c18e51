"""Seconds a pose on two cores, and the neutral fit beside trimesh's non-rigid ICP on the same scan and landmarks."""

from __future__ import annotations

import multiprocessing
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from queue import Empty
from typing import Any

import numpy as np
from numpy.typing import NDArray
from registration_cases import NO_BARS, Case, all_cases
from registration_measure import measure_case
from registration_runs import (
    Bench,
    CaseContext,
    compose,
    cpu_seconds,
    make_photos,
    peak_memory,
    run_case,
    say,
    scan_poses,
)

from capture_eval.evaluation.tracking_error import SkinPoints
from capture_eval.files.atomic import read_json, read_npz, write_json
from capture_eval.files.manifest_files import Capture
from capture_eval.files.mesh_files import read_mesh
from capture_eval.registration.nonrigid_icp import NonrigidIcpOptions, fit_template
from capture_eval.registration.surface_correspondence import Surface
from capture_eval.registration.template_visibility import skin_vertices
from capture_eval.similarity import Similarity, estimate_similarity
from capture_eval.stages.registration_inputs import (
    Template,
    load_scan,
    load_template,
    place_landmarks,
)
from capture_eval.triangle_geometry import diameter
from capture_eval.workflow.step_calls import STEP_CALLS

Floats = NDArray[np.float64]

TIME_GROUP = "time"
TIME_NAMES = ("time_two_cores", "time_peer")
PEER_LIMIT = 300.0  # seconds after which trimesh is stopped
PEER_TRIANGLES = 20000  # of the scan that trimesh gets: its closest points on all of it take minutes


def run_time(bench: Bench, names: list[str], force: bool) -> None:
    """Measure on two cores and against the peer; each has its result."""
    jaw = next(case for case in all_cases() if case.shots.motion == "jaw_open")
    run_case(bench, jaw, "results", False, measure_case)
    for name, measure in zip(TIME_NAMES, (two_cores, beside_peer), strict=True):
        if name not in names:
            continue
        result = bench.out / "results" / f"{name}.json"
        if force or not result.is_file():
            bench.check_time()
            write_json(result, {"case": name, "group": TIME_GROUP} | measure(bench, jaw))
            say(f"{name}: measured")


def two_cores(bench: Bench, jaw: Case) -> dict[str, Any]:
    """Wall seconds of the neutral and of two poses, refined side by side in processes of their own."""
    case = Case("time_two_cores", TIME_GROUP, jaw.shots, (0, 2, 4), {"register": NO_BARS})
    capture_folder = make_photos(bench, case.shots)
    capture = compose(bench, case, capture_folder, scan_poses(bench, case, capture_folder))
    wall = {}
    for step in ("align", "neutral", "track"):
        start = time.perf_counter()
        STEP_CALLS[step](CaseContext(capture, capture.folder, None, 1, case.options))
        wall[step] = time.perf_counter() - start
    start = time.perf_counter()
    with ProcessPoolExecutor(2, multiprocessing.get_context("spawn")) as pool:
        for done in [pool.submit(_refine, capture, name) for name in capture.manifest.pose_names[1:]]:
            done.result()
    wall["refine_two_poses"] = time.perf_counter() - start
    vertices = len(read_mesh(capture.folder / "template.obj").vertices)
    a_pose = (wall["track"] + wall["refine_two_poses"]) / 2
    return {"vertices": vertices, "wall_seconds": wall, "wall_seconds_a_pose": a_pose}


def _refine(capture: Capture, pose: str) -> None:
    STEP_CALLS["refine"](CaseContext(capture, capture.folder, pose, 1, {"register": NO_BARS}))


def beside_peer(bench: Bench, jaw: Case) -> dict[str, Any]:
    """The neutral fit of the jaw sequence: ours without and with texture stereo, and trimesh's."""
    folder = bench.out / "cases" / jaw.name
    parts = load_template(folder / "template.obj", folder / "occluders.obj")
    neutral = folder / "work" / "pose_00"
    head_from_neutral, placed, _ = place_landmarks(neutral, folder / "landmarks.yaml", parts)
    scan = load_scan(neutral, parts.working_from_head.compose(head_from_neutral))
    rest = parts.working_from_head.apply(parts.mesh.vertices)
    blockers = (parts.working_from_head.apply(parts.occluders[0]), parts.occluders[1])
    skin = skin_vertices(rest, parts.triangles, blockers)
    fit_template(rest, parts.triangles, skin, scan, placed, NonrigidIcpOptions(stiffness=(100.0,)))  # compiles
    start, clock = cpu_seconds(), time.perf_counter()
    own = fit_template(rest, parts.triangles, skin, scan, placed, NonrigidIcpOptions()).vertices
    rows = {"own": {"cpu_seconds": cpu_seconds() - start, "seconds": time.perf_counter() - clock}}
    fits = {"own": own, "own_with_stereo": read_npz(folder / "work/register/neutral.npz")["vertices"] / parts.unit}
    rows["own_with_stereo"] = {"cpu_seconds": read_json(folder / "work/register/neutral.json")["cpu_seconds"]}
    rows["trimesh"], fitted = peer_in_time(rest, parts, scan, placed.vertices, placed.positions)
    if fitted is not None:
        fits["trimesh"] = fitted
    for name, vertices in fits.items():
        rows[name] |= neutral_errors(folder, parts, vertices)
    return {"vertices": len(rest), "scan_triangles": len(scan.triangles), "rows": rows}


def neutral_errors(folder: Path, parts: Template, fitted: Floats) -> dict[str, Any]:
    """Distance to the true surface and to the person's own vertices (same topology), of D, over seen vertices."""
    register = folder / "work" / "register"
    tracked = read_npz(register / "tracked_truth.npz")
    mesh = read_mesh(folder / "truth" / "mesh.obj")
    triangles = mesh.triangles()[0]
    places = SkinPoints(tracked["triangle"], tracked["barycentric"]).places(mesh.vertices, triangles)
    truth_from_head: Similarity = estimate_similarity(tracked["vertices"][0], places)
    seen = read_npz(register / "registered.npz")["seen"][0].astype(bool)
    moved = truth_from_head.apply(parts.unit * fitted)[seen]
    size = diameter(mesh.vertices)
    surface = np.linalg.norm(moved - Surface(mesh.vertices, triangles).closest(moved).points, axis=1) / size
    own = np.linalg.norm(moved - mesh.vertices[seen], axis=1) / size
    return {
        name: [float(np.median(values)), float(np.quantile(values, 0.95))]
        for name, values in (("surface", surface), ("correspondence", own))
    }


def peer_in_time(
    rest: Floats, parts: Template, scan: Surface, landmarks: NDArray[np.int64], places: Floats
) -> tuple[dict[str, Any], Floats | None]:
    """trimesh's nricp_amberg in a process that is stopped after a while; why there is no fit, if there is none."""
    context = multiprocessing.get_context("spawn")
    answers: Any = context.Queue()
    target = _decimated(scan.vertices, scan.triangles)
    worker = context.Process(target=_peer, args=(answers, rest, parts.triangles, *target, landmarks, places))
    worker.start()
    try:
        row, fitted = answers.get(timeout=PEER_LIMIT)
    except Empty:
        row, fitted = {"skipped": f"stopped after {PEER_LIMIT:.0f} s"}, None
        worker.terminate()
    worker.join()
    return row, fitted


def _decimated(vertices: Floats, triangles: NDArray[np.int64]) -> tuple[Floats, NDArray[np.int64]]:
    import open3d

    mesh = open3d.geometry.TriangleMesh(
        open3d.utility.Vector3dVector(vertices), open3d.utility.Vector3iVector(triangles.astype(np.int32))
    ).simplify_quadric_decimation(PEER_TRIANGLES)
    return np.asarray(mesh.vertices).copy(), np.asarray(mesh.triangles).astype(np.int64)


def _peer(
    answers: Any,
    rest: Floats,
    triangles: NDArray[np.int64],
    scan_vertices: Floats,
    scan_triangles: NDArray[np.int64],
    landmarks: NDArray[np.int64],
    places: Floats,
) -> None:
    try:
        import rtree  # noqa: F401  (trimesh's closest points need it)
        import trimesh
        from trimesh.registration import nricp_amberg
    except ImportError as error:
        answers.put(({"skipped": f"not installed ({error.name})"}, None))
        return
    source = trimesh.Trimesh(rest, triangles, process=False)
    target = trimesh.Trimesh(scan_vertices, scan_triangles, process=False)
    start, clock = cpu_seconds(), time.perf_counter()
    fitted = np.asarray(nricp_amberg(source, target, landmarks, places), dtype=np.float64)
    row = {"cpu_seconds": cpu_seconds() - start, "seconds": time.perf_counter() - clock}
    row |= {"version": trimesh.__version__, "peak_memory_mb": peak_memory()}
    answers.put((row, fitted))
