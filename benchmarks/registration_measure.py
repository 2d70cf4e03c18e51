"""What is measured of a registered case: errors per pose and region against the truth, curve errors, times."""

from __future__ import annotations

import itertools
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from registration_cases import Case, time_of
from registration_runs import Bench

from capture_eval import __version__
from capture_eval.evaluation.surface_error import face_proper
from capture_eval.evaluation.tracking_error import SkinPoints, TrackingError, tracking_error
from capture_eval.files.atomic import read_json, read_npz, write_npz
from capture_eval.files.manifest_files import Capture
from capture_eval.files.mesh_files import read_mesh
from capture_eval.images.head import Head
from capture_eval.similarity import estimate_similarity
from capture_eval.stages.evaluate import EvaluateOptions, evaluate_capture, evaluate_truth
from capture_eval.stages.truth import TruthFiles, TruthOptions, measure_tracking
from capture_eval.triangle_geometry import diameter

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]

PARTS = ("tracking", "surface", "tangential", "normal", "relative")
REGIONS = ("lips", "chin", "cheeks", "eyes", "nose", "forehead", "ears", "scalp", "neck")
CONFIDENT = 0.5
STATIC = 2e-4  # of D: skin that moves less in the whole sequence stands still
DECIDED = 1e-3  # of D: methods whose true LAE differ by more must come out in the right order


def measure_case(bench: Bench, case: Case, capture: Capture, seconds: dict[str, float]) -> dict[str, Any]:
    """Everything the page says about a case, as fractions of D."""
    folder = capture.folder
    use_masks_of(bench, case, folder)
    files = TruthFiles(folder / "truth" / "mesh.obj", folder / "truth.npz", folder / "cameras.json")
    truth = measure_tracking(folder / "work", folder / "template.obj", files, folder / "report", TruthOptions())
    head = bench.heads(case.shots)[0]
    rows = pose_rows(folder, case, head)
    ablated = case.masks_of is not None
    memory = folder / "memory.json"
    return {
        "case": case.name,
        "group": case.group,
        "head": case.shots.person,
        "motion": case.shots.motion,
        "photos": case.shots.views,
        "size": f"{case.shots.width}x{case.shots.height}",
        "version": __version__,
        "measured": time.strftime("%Y-%m-%d %H:%M", time.gmtime()),
        "vertices": len(read_mesh(folder / "template.obj").vertices),
        "D_mm": truth["D"],
        "seen": truth["seen_vertices"],
        "confident_share_of_seen": truth["confident_share_of_seen"],
        "masks_of": case.masks_of,
        "notes": scan_notes(folder),
        "poses": rows,
        "align": alignment_rows(folder),
        "doubts": {row["pose"]: doubt for row in saved_rows(folder) if (doubt := row["reason"] or row.get("doubts"))},
        "error_bars": truth.get("error_bars"),
        "timings": {} if ablated else {timing: evaluate_timing(folder, case, timing) for timing in case.timings},
        "cpu_seconds": seconds,
        "peak_memory_mb": read_json(memory)["peak_memory_mb"] if memory.is_file() else None,
        "cpu_seconds_of_track": {
            row["pose"]: row.get("cpu_seconds") for row in read_json(folder / "work/register/tracking.json")["poses"]
        },
    }


def use_masks_of(bench: Bench, case: Case, folder: Path) -> None:
    """Let the vertices that are seen and confident in another case count in this one."""
    if case.masks_of is None:
        return
    other = bench.out / "cases" / case.masks_of / "work" / "register" / "registered.npz"
    if not other.is_file():
        raise SystemExit(f"{case.name}: {case.masks_of} must be registered first, its vertices count")
    path = folder / "work" / "register" / "registered.npz"
    own, masks = read_npz(path), read_npz(other)
    count = len(own["t"])
    rows = np.arange(count) if len(masks["t"]) == count else np.zeros(count, dtype=int)
    confidence, seen = masks["confidence"][rows], masks["seen"][rows]
    write_npz(path, own | {"confidence": confidence, "seen": seen})


def pose_rows(folder: Path, case: Case, head: Head) -> list[dict[str, Any]]:
    """Errors of every pose over regions, and over the skin that stands still."""
    saved = read_npz(folder / "work" / "register" / "registered.npz")
    tracked = read_npz(folder / "work" / "register" / "tracked_truth.npz")
    true_mesh = read_mesh(folder / "truth" / "mesh.obj")
    triangles = true_mesh.triangles()[0]
    true_vertices = read_npz(folder / "truth.npz")["vertices"]
    points = SkinPoints(tracked["triangle"], tracked["barycentric"])
    truth_from_head = estimate_similarity(tracked["vertices"][0], points.places(true_vertices[0], triangles))
    size = diameter(true_vertices[0])
    ok = saved["pose_ok"].astype(bool)
    neutral = truth_from_head.apply(saved["vertices"][0])
    masks = region_masks(saved, ok, points, triangles, head, true_vertices, size)
    rows = []
    for index, name in enumerate(saved["pose_names"]):
        row: dict[str, Any] = {"pose": str(name), "amount": case.amounts[index], "status": "failed"}
        if ok[index]:
            moved = truth_from_head.apply(saved["vertices"][index])
            error = tracking_error(moved, neutral, points, true_vertices[index], true_vertices[0], triangles)
            figures = {key: region_figures(error, mask, size) for key, mask in masks.items()}
            row |= {"status": "ok", "regions": {key: value for key, value in figures.items() if value}}
        rows.append(row)
    return rows


def region_masks(
    saved: dict[str, Any], ok: Flags, points: SkinPoints, triangles: Any, head: Head, true_vertices: Floats, size: float
) -> dict[str, Flags]:
    """Seen and confident vertices, all, of the face proper, by region; skin that stands still."""
    seen = np.all(saved["seen"][ok], axis=0)
    confident = seen & np.all(saved["confidence"][ok] > CONFIDENT, axis=0)
    corner = triangles[points.triangle, np.argmax(points.barycentric, axis=1)]
    label = np.full(len(head.skin.vertices), "inner", dtype=object)
    for name, vertices in head.regions.items():
        label[vertices] = name
    motion = np.linalg.norm(true_vertices - true_vertices[0], axis=2).max(axis=0)
    still = confident & (motion[corner] < STATIC * size)
    face = np.isin(corner, face_proper(head.skin.vertices, head.regions))
    masks = {"face": seen & face, "seen": seen, "confident": confident, "still": still}
    masks["face, confident"] = confident & face
    for name in REGIONS:
        masks[name] = seen & (label[corner] == name)
        masks[f"{name}, confident"] = confident & (label[corner] == name)
    return masks


def region_figures(error: TrackingError, mask: Flags, size: float) -> dict[str, Any]:
    """Median and 95th percentile of all parts of the error over some vertices."""
    if not mask.any():
        return {}
    values = (error.total, error.surface, error.tangential, np.abs(error.normal), error.relative)
    figures: dict[str, Any] = {"vertices": int(np.count_nonzero(mask))}
    for name, value in zip(PARTS, values, strict=True):
        figures[name] = [float(np.median(value[mask]) / size), float(np.quantile(value[mask], 0.95) / size)]
    return figures


def scan_notes(folder: Path) -> list[str]:
    """What is to be said of the scans a case was registered from."""
    scans = [path.resolve().parents[2] / "scan.json" for path in sorted((folder / "work").glob("*/scan.ply"))]
    return sorted({read_json(scan)["note"] for scan in scans if "note" in read_json(scan)})


def saved_rows(folder: Path) -> list[dict[str, Any]]:
    """What the registration itself says of every pose."""
    return list(read_json(folder / "work" / "register" / "registered.json")["poses"])


def alignment_rows(folder: Path) -> list[dict[str, Any]]:
    """Scale and residual of every pose."""
    rows = read_json(folder / "work" / "align" / "alignment.json")["poses"]
    return [{key: row[key] for key in ("pose", "status", "scale", "residual", "inliers")} for row in rows]


def evaluate_timing(folder: Path, case: Case, timing: str) -> dict[str, Any]:
    """Curve errors from photos beside those from the truth when the poses stand at the times of a law."""
    work = folder / "timings" / timing / "work"
    times = np.array([time_of(amount, timing) for amount in case.amounts])
    source = folder / "work" / "register"
    write_npz(work / "register" / "registered.npz", read_npz(source / "registered.npz") | {"t": times})
    write_npz(work / "register" / "tracked_truth.npz", read_npz(source / "tracked_truth.npz"))
    methods = [(name, {}) for name in ("linear", "pde_linear", "pde_quadratic", "pde_cubic")]
    result: dict[str, Any] = {"t": times.tolist()}
    for vertices in ("confident", "seen"):
        options = EvaluateOptions(evaluation_vertices=vertices, fit="none")
        report = folder / "timings" / timing / vertices
        inputs = (work, folder / "template.obj", folder / "curves.yaml", methods, report, options)
        summary = evaluate_capture(*inputs)
        comparison = evaluate_truth(*inputs)
        result[vertices] = comparison | wrong_orders(comparison["methods"])
        result[vertices]["points_used"] = [summary["counts"]["points_used"], summary["counts"]["points"]]
        result[vertices]["curves_used"] = [summary["counts"]["curves_used"], summary["counts"]["curves"]]
    return result


def wrong_orders(methods: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """Pairs of methods whose true LAE differ by enough to decide, and those that photos put in the other order."""
    decided, wrong = 0, []
    for (first, one), (second, other) in itertools.combinations(methods.items(), 2):
        true = one["LAE_truth"] - other["LAE_truth"]
        if abs(true) > DECIDED:
            decided += 1
            if (one["LAE_photos"] - other["LAE_photos"]) * true <= 0:
                wrong.append(f"{first} and {second}")
    return {"decided_pairs": decided, "wrong_pairs": wrong}
