"""One case of the dense stereo benchmark: reconstruct it in this process, then compare it with the truth.

Each function is called in a fresh process, so that the peak of its memory is its own.
"""

from __future__ import annotations

import resource
import shutil
import subprocess
import time
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
from dense_stereo_cases import Case
from dense_stereo_maps import compare_maps
from dense_stereo_peers import run_openmvs, run_sgbm
from dense_stereo_rendering import POSE, photo_folder, read_truth
from numpy.typing import NDArray

from capture_eval.errors import InputError, ReconstructionError
from capture_eval.evaluation.surface_error import (
    RegionError,
    TruePlaces,
    TrueScene,
    closest_distance,
    cloud_error,
    mesh_error,
    share_within,
    true_places,
)
from capture_eval.files.atomic import read_json, write_json
from capture_eval.files.colmap_files import read_sparse_model
from capture_eval.files.colmap_workspace import read_workspace
from capture_eval.files.ply_files import read_ply_with_properties
from capture_eval.files.point_cloud_files import read_point_cloud
from capture_eval.polygon_mesh import PolygonMesh
from capture_eval.reconstruction.patch_match import PatchMatchOptions
from capture_eval.similarity import Similarity, estimate_similarity
from capture_eval.stages.dense import DenseOptions, reconstruct_dense
from capture_eval.stages.fusion import fuse_maps
from capture_eval.stages.sparse import SparseOptions, reconstruct_sparse
from capture_eval.stages.surface import SurfaceOptions, reconstruct_surface

Floats = NDArray[np.float64]

HERE = Path(__file__).parent
FAR = 0.003  # of D: a point farther from the truth is crust
CLOSE = (0.001, 0.003)
PERCENTILES = (50, 90, 95, 99)
DEVIATION_BINS = 12
_ICP_ROUNDS, _ICP_SHARE = 25, 0.9


def scene_folder(case: Case, work: Path) -> Path:
    """Photos and truth of a case."""
    return work / "scenes" / case.scene.name


def solve_case(case: Case, work: Path) -> Path:
    """Sparse model of a case's photos, once for all cases that share it; returns its folder."""
    folder = scene_folder(case, work)
    label = "true" if case.known else "solved"
    solved = work / "sparse" / f"{case.scene.name}_{label}_{case.photo_count}" / POSE
    if (solved / "sparse.json").is_file():
        return solved
    photos = sorted(photo_folder(folder).glob("*.jpg"))
    chosen = spread_evenly(read_truth(folder), case.photo_count)
    cameras = folder / "truth" / "cameras.json" if case.known else None
    reconstruct_sparse([photos[k] for k in chosen], solved, SparseOptions(known_cameras=cameras))
    return solved


def spread_evenly(truth: TrueScene, count: int) -> list[int]:
    """So many of the photos, each as far as can be from those already taken, from the middle one on; sorted."""
    centers = np.array([view.center for view in truth.views])
    if count >= len(centers):
        return list(range(len(centers)))
    taken = [int(np.argmin(np.linalg.norm(centers - centers.mean(axis=0), axis=1)))]
    while len(taken) < count:
        gaps = np.linalg.norm(centers[:, None] - centers[None, taken], axis=2).min(axis=1)
        taken.append(int(np.argmax(gaps)))
    return sorted(taken)


def run_case(case: Case, work: Path) -> dict[str, Any]:
    """Reconstruct one case and compare it with the truth; a row of the results."""
    solved = solve_case(case, work)
    sparse = read_json(solved / "sparse.json")
    if sparse["status"] != "ok":
        raise ReconstructionError(f"sparse stage: {sparse['reason']}")
    folder = work / "cases" / case.name
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(solved / "sparse", folder / "sparse")
    shutil.copy(solved / "sparse.json", folder)
    _load_libraries()
    _forget_peak()
    base = _peak_megabytes()
    started = time.perf_counter(), time.process_time()
    dense = _dense(case, folder)
    dense_cost = time.process_time() - started[1]
    if case.method == "openmvs":
        dense_cost = sum(dense.get("seconds", {}).values())
    record = {
        "case": asdict(case),
        "fingerprint": case.fingerprint,
        "commit": _commit(),
        "status": dense["status"],
        "reason": dense.get("reason", ""),
        "photos": case.photo_count,
        "sparse_points": sparse["points"],
        "dense_cpu_s": dense_cost,
        "dense_wall_s": time.perf_counter() - started[0],
        "dense_steps_cpu_s": dense.get("seconds", {}),
        "base_mb": base,
        "dense_peak_mb": _peak_megabytes(of_children=case.method == "openmvs"),
    }
    if dense["status"] != "ok":
        return record
    _forget_peak()
    surface = reconstruct_surface(folder, SurfaceOptions())
    record |= {"surface_cpu_s": surface.get("seconds", 0.0), "surface_peak_mb": _peak_megabytes()}
    if surface["status"] != "ok":
        return record | {"status": surface["status"], "reason": surface.get("reason", "")}
    record |= _errors(case, folder, scene_folder(case, work))
    if not (case.maps and case.group == "heads"):
        shutil.rmtree(folder / "dense", ignore_errors=True)
    return record


def _load_libraries() -> None:
    """Libraries take memory of their own, which does not grow with the photos."""
    import cv2  # noqa: F401
    import open3d  # noqa: F401
    import pycolmap  # noqa: F401

    import capture_eval.reconstruction.depth_filtering_kernels
    import capture_eval.reconstruction.patch_match_kernels  # noqa: F401


def _dense(case: Case, folder: Path) -> dict[str, Any]:
    options = DenseOptions(
        backend="cpu",
        keep_maps=case.maps,
        stereo=replace(PatchMatchOptions(), **case.stereo),
        **case.dense,
    )
    if case.method == "own":
        return reconstruct_dense(folder, options)
    if case.method == "colmap_fusion":
        return _fuse_again(folder, folder.parent / case.twin / "dense")
    _undistort(folder)
    run = run_sgbm if case.method == "sgbm" else run_openmvs
    result = run(folder / "dense", folder / "fused.ply")
    write_json(folder / "dense.json", result)
    return result


def _fuse_again(folder: Path, maps: Path) -> dict[str, Any]:
    """COLMAP's fusion of the maps that another case has left."""
    if not (maps / "stereo" / "fusion.cfg").is_file():
        raise InputError(f"{maps}: no depth maps here; measure {maps.parent.name} first")
    start = time.process_time()
    points = fuse_maps(read_workspace(maps), folder / "fused.ply", "colmap", 1.0, 3)
    result = {"status": "ok", "points": points, "seconds": {"fusion": time.process_time() - start}}
    write_json(folder / "dense.json", result)
    return result


def _undistort(folder: Path) -> None:
    import pycolmap

    pycolmap.logging.minloglevel = 2
    photos = read_json(folder / "sparse.json")["photo_folder"]
    pycolmap.undistort_images(folder / "dense", folder / "sparse", photos, jpeg_quality=100, num_threads=1)


def _errors(case: Case, folder: Path, scene: Path) -> dict[str, Any]:
    truth = read_truth(scene)
    places = true_places(truth)
    points, numbers = read_point_cloud(folder / "fused.ply")
    scan, of_vertices = read_ply_with_properties(folder / "scan.ply")
    triangles = scan.triangles()[0]
    move = Similarity(1.0, np.eye(3), np.zeros(3))
    if not case.known:
        move = align_to_truth(folder / "sparse", truth, places, scan)
    points = move.apply(points)
    cloud = cloud_error(points, truth, places)
    vertices = move.apply(scan.vertices)
    mesh = mesh_error(vertices, triangles, truth, places)
    result: dict[str, Any] = {
        "points": len(points),
        "vertices": len(scan.vertices),
        "pixel_percent": pixel_percent(truth),
        "far_share": float(np.mean(cloud["everything"].to_truth > FAR)),
        "regions": {name: _figures(cloud[name], mesh[name], len(points)) for name in ("face", "head")},
    }
    stated = {"points": (points, numbers.get("deviation")), "mesh": (vertices, of_vertices.get("deviation"))}
    result["calibration"] = {
        name: calibration(places_of, deviation * move.scale, truth)
        for name, (places_of, deviation) in stated.items()
        if deviation is not None and np.all(np.isfinite(deviation))
    }
    if case.maps and case.known:
        result["maps"] = compare_maps(folder / "dense", truth)
    return result


def _figures(cloud: RegionError, mesh: RegionError, points: int) -> dict[str, Any]:
    """Numbers of one region; all errors in % of D."""

    def percent(values: Floats) -> list[float]:
        return [float(100 * np.percentile(values, share)) for share in PERCENTILES]

    return {
        "points": round(cloud.share * points),
        "accuracy": percent(cloud.to_truth),
        "complete": [float(np.mean(cloud.to_reconstruction < limit)) for limit in CLOSE],
        "truth_to_mesh": percent(mesh.to_reconstruction),
        "truth_to_mesh_rms": float(100 * np.sqrt(np.mean(mesh.to_reconstruction**2))),
        "mesh_to_truth": percent(mesh.to_truth),
    }


def pixel_percent(truth: TrueScene) -> float:
    """Width of a pixel at the middle of the skin, mean over the photos, % of D."""
    middle = truth.vertices[np.unique(truth.triangles[: truth.skin_triangles])].mean(axis=0)
    depths = [(view.rotation @ middle + view.translation)[2] / view.intrinsics.matrix[0, 0] for view in truth.views]
    return float(100 * np.mean(depths) / truth.size)


def calibration(points: Floats, deviation: Floats, truth: TrueScene, count: int = 60000) -> dict[str, Any]:
    """How honest the standard deviation of every point is.

    Shares within one and two deviations (.683 and .954 for normal errors), and for bins of equal size the stated
    deviation and the real one (1.4826 times the median distance, which is the deviation of normal errors), % of D.
    """
    generator = np.random.default_rng(2)
    drawn = generator.permutation(len(points))[:count]
    distance = closest_distance(points[drawn], truth.vertices, truth.triangles)
    stated = deviation[drawn]
    order = np.argsort(stated, kind="stable")
    percent = 100.0 / truth.size
    bins = [
        [float(np.median(stated[part]) * percent), float(1.4826 * np.median(distance[part]) * percent)]
        for part in np.array_split(order, DEVIATION_BINS)
    ]
    return {"within": share_within(distance, stated), "stated_and_real": bins}


def align_to_truth(sparse: Path, truth: TrueScene, places: TruePlaces, scan: PolygonMesh) -> Similarity:
    """Similarity from the frame of the solved cameras to truth: camera centres, then ICP on what photos see."""
    import open3d

    centers = {view.name: view.center for view in truth.views}
    solved = read_sparse_model(sparse).views
    names = [name for name in solved if name in centers]
    transform = estimate_similarity(
        np.array([solved[name].center for name in names]), np.array([centers[name] for name in names])
    )
    core = open3d.core
    target = places.points[places.regions["head"]][::4]
    middle = scan.vertices.mean(axis=0)
    scene = open3d.t.geometry.RaycastingScene(nthreads=1)
    corners = core.Tensor((scan.vertices - middle).astype(np.float32))
    scene.add_triangles(corners, core.Tensor(scan.triangles()[0].astype(np.uint32)))
    for _ in range(_ICP_ROUNDS):
        asked = transform.inverse().apply(target) - middle
        found = scene.compute_closest_points(core.Tensor(asked.astype(np.float32)), nthreads=1)
        closest = found["points"].numpy().astype(np.float64)
        gap = np.linalg.norm(closest - asked, axis=1)
        good = gap <= np.quantile(gap, _ICP_SHARE)
        transform = estimate_similarity(closest[good] + middle, target[good])
    return transform


def _commit() -> str:
    """The last commit that touched what is measured, with a plus when the files differ from it."""
    names = ["reconstruction", "stages/sparse.py", "stages/dense.py", "stages/fusion.py", "stages/surface.py"]
    paths = [f"../capture_eval/{name}" for name in names]

    def git(*words: str) -> str:
        found = subprocess.run(["git", *words, "--", *paths], capture_output=True, text=True, check=False, cwd=HERE)
        return found.stdout.strip()

    try:
        return git("log", "-1", "--format=%h") + ("+" if git("status", "--porcelain") else "")
    except OSError:
        return ""


def _peak_megabytes(of_children: bool = False) -> float:
    """Peak of this process's resident memory since `_forget_peak`; where the system does not say, since its start."""
    if of_children:
        return resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024
    try:
        text = Path("/proc/self/status").read_text()
        return int(text.split("VmHWM:")[1].split()[0]) / 1024
    except (OSError, IndexError):
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def _forget_peak() -> None:
    try:
        Path("/proc/self/clear_refs").write_text("5")
    except OSError:
        return
