"""Other dense stereo programs on the same photos: OpenCV's semi-global matching, and OpenMVS where it is installed.

Both leave `fused.ply` with normals, as the dense stage does, so that surface and errors are measured by the same code.
"""

from __future__ import annotations

import resource
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
from numpy.typing import NDArray

from capture_eval.cameras import View
from capture_eval.files.colmap_workspace import map_path, read_colours, read_workspace, write_map
from capture_eval.files.point_cloud_files import read_point_cloud, write_point_cloud
from capture_eval.reconstruction.foreground_mask import textured_region
from capture_eval.reconstruction.view_selection import choose_sources, pair_scores
from capture_eval.stages.dense import DenseOptions, dense_workspace

Floats = NDArray[np.float64]

PAIRS = 4  # neighbours each photo is matched with
AGREEMENT = 0.004  # of the depth: two pairs must agree within it
MATCHING = {"blockSize": 5, "P1": 200, "P2": 800, "disp12MaxDiff": 1, "uniquenessRatio": 5}
SPECKLES = {"speckleWindowSize": 60, "speckleRange": 2}
OPENMVS = ("InterfaceCOLMAP", "DensifyPointCloud")


def missing_peer(method: str) -> str:
    """Why a peer cannot run here, or nothing."""
    if method == "sgbm":
        try:
            import cv2  # noqa: F401
        except ImportError:
            return "opencv-python-headless is not installed"
    if method == "openmvs":
        absent = [name for name in OPENMVS if shutil.which(name) is None]
        if absent:
            return f"no {' and no '.join(absent)} on PATH"
    return ""


def _index_matrix(view: View) -> Floats:
    """Calibration for OpenCV, where the centre of the top-left pixel is (0, 0)."""
    matrix = view.intrinsics.matrix.copy()
    matrix[:2, 2] -= 0.5
    return matrix


def pair_depth(reference: View, source: View, photos: Sequence[NDArray[Any]], points: Floats) -> Floats:
    """Depth (H, W) of the reference photo from one rectified pair; NaN where nothing matched."""
    import cv2

    size = (reference.intrinsics.width, reference.intrinsics.height)
    rotation = source.rotation @ reference.rotation.T
    translation = source.translation - rotation @ reference.translation
    matrices = _index_matrix(reference), _index_matrix(source)
    straightness, shift = np.zeros(5), translation.reshape(3, 1)
    turns = cv2.stereoRectify(matrices[0], straightness, matrices[1], straightness, size, rotation, shift, flags=0)[:4]
    upright = abs(turns[3][1, 3]) > abs(turns[3][0, 3])
    axis = 1 if upright else 0
    offset = float(turns[2][axis, 2] - turns[3][axis, 2])
    baseline = float(turns[3][axis, 3])
    straight = []
    for photo, matrix, turn, projection in zip(photos, matrices, turns[:2], turns[2:], strict=True):
        maps = cv2.initUndistortRectifyMap(matrix, None, turn, projection[:, :3], size, cv2.CV_32FC1)
        picture = cv2.remap(photo, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        straight.append(np.ascontiguousarray(picture.T if upright else picture))
    depths = (points @ reference.rotation.T + reference.translation) @ turns[0][2]
    near, far = np.percentile(depths, [1, 99]) * np.array([0.94, 1.06])
    ends = offset - baseline / np.array([near, far])
    lowest = int(np.floor(ends.min()))
    count = 16 * int(np.ceil((ends.max() - lowest + 1) / 16))
    matcher = cv2.StereoSGBM_create(
        minDisparity=lowest, numDisparities=count, mode=cv2.STEREO_SGBM_MODE_HH, **MATCHING, **SPECKLES
    )
    disparity = matcher.compute(straight[0], straight[1]).astype(np.float32) / 16.0
    disparity[disparity < lowest] = np.nan
    if upright:
        disparity = np.ascontiguousarray(disparity.T)
    return _back_to_the_photo(disparity, offset, baseline, matrices[0], turns[0], turns[2])


def _back_to_the_photo(
    disparity: NDArray[np.float32], offset: float, baseline: float, matrix: Floats, turn: Floats, projection: Floats
) -> Floats:
    """Depth at the pixels of the unrectified photo: a pure rotation, so depth scales by the ray's third coordinate."""
    import cv2

    height, width = disparity.shape
    columns, rows = np.meshgrid(np.arange(width), np.arange(height))
    rays = np.stack([columns, rows, np.ones_like(rows)], axis=2) @ np.linalg.inv(matrix).T @ turn.T
    pixels = rays @ projection[:, :3].T
    place = (pixels[..., :2] / pixels[..., 2:]).astype(np.float32)
    found = cv2.remap(
        disparity, place[..., 0], place[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=np.nan
    )
    return -baseline / (found.astype(np.float64) - offset) / rays[..., 2]


def agreed_depth(depths: Floats) -> Floats:
    """Median (H, W) of pair depths (N, H, W) where at least two agree with it; 0 elsewhere."""
    with np.errstate(invalid="ignore"):
        ordered = np.sort(depths, axis=0)  # NaN go last
        count = np.count_nonzero(np.isfinite(ordered), axis=0)
        middle = np.take_along_axis(ordered, np.maximum(count - 1, 0)[None] // 2, axis=0)[0]
        agree = np.count_nonzero(np.abs(depths - middle) <= AGREEMENT * middle, axis=0)
    return np.where((agree >= 2) & (middle > 0), middle, 0.0)


def normals_of_depth(depth: Floats, view: View) -> Floats:
    """Unit normals (H, W, 3) in the camera's frame from differences of smoothed neighbours; 0 where undefined."""
    import cv2

    height, width = depth.shape
    columns, rows = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    rays = np.stack([columns, rows, np.ones_like(rows)], axis=2) @ np.linalg.inv(view.intrinsics.matrix).T
    known = (depth > 0).astype(np.float64)
    smooth = cv2.GaussianBlur(depth, (7, 7), 1.5) / np.maximum(cv2.GaussianBlur(known, (7, 7), 1.5), 1e-9)
    places = rays * smooth[..., None]
    down, right = np.gradient(places, axis=(0, 1))
    normal = np.cross(down, right)
    normal /= np.maximum(np.linalg.norm(normal, axis=2, keepdims=True), 1e-300)
    facing = -np.sign(np.sum(normal * rays, axis=2, keepdims=True))
    return np.where(depth[..., None] > 0, normal * facing, 0.0)


def write_sgbm_maps(folder: str, **_: Any) -> None:
    """Depth and normal maps of a workspace by semi-global matching, where COLMAP's stereo leaves its own.

    The backdrop is masked as for our stereo. Takes the place of `pycolmap.patch_match_stereo`.
    """
    workspace = read_workspace(Path(folder))
    views = workspace.views
    scores = pair_scores(np.array([view.center for view in views]), workspace.points, workspace.visible)
    colours = [read_colours(workspace.image_path(index), view) for index, view in enumerate(views)]
    greys = [np.rint(picture.mean(axis=2)).astype(np.uint8) for picture in colours]
    for index, partners in enumerate(choose_sources(scores, PAIRS)):
        view = views[index]
        points = workspace.points[workspace.visible[index]]
        found = [pair_depth(view, views[k], (greys[index], greys[k]), points) for k in partners]
        depth = agreed_depth(np.stack(found)) * textured_region(colours[index], 4)
        for stage in ("photometric", "geometric"):
            write_map(map_path(workspace.folder, "depth", view.name, stage), depth)
            write_map(map_path(workspace.folder, "normal", view.name, stage), normals_of_depth(depth, view))


def run_sgbm(workspace: Path, fused: Path) -> dict[str, Any]:
    """Semi-global matching in place of COLMAP's CUDA stereo; everything after it is the dense stage's own."""
    import pycolmap

    stand_in = mock.patch.multiple(pycolmap, has_cuda=True, patch_match_stereo=write_sgbm_maps)
    with stand_in:
        result = dense_workspace(workspace, fused, DenseOptions(backend="cuda"))
    return {**result, "backend": "sgbm"}


def run_openmvs(workspace: Path, fused: Path, threads: int = 1) -> dict[str, Any]:
    """OpenMVS on the CPU with the settings of the study; its CPU seconds are those of the child processes."""
    folder = fused.parent / "openmvs"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    before = _child_seconds()
    convert = ["InterfaceCOLMAP", "-w", str(folder), "-i", str(workspace), "-o", "scene.mvs"]
    convert += ["--image-folder", str(workspace / "images")]
    densify = ["DensifyPointCloud", "-w", str(folder), "scene.mvs", "-o", "dense.mvs", "--resolution-level", "0"]
    densify += ["--number-views", "5", "--max-threads", str(threads), "--cuda-device", "-2"]
    for command in (convert, densify):
        finished = subprocess.run(command, capture_output=True, text=True, check=False)
        if finished.returncode:
            tail = (finished.stderr or finished.stdout).strip().splitlines()[-1:]
            return {"status": "failed", "reason": f"{command[0]} ended with {finished.returncode}: {' '.join(tail)}"}
    points, numbers = read_point_cloud(folder / "dense.ply")
    write_point_cloud(fused, points, {name: numbers[name] for name in ("nx", "ny", "nz")})
    seconds = {"stereo and fusion": _child_seconds() - before}
    return {"status": "ok", "backend": "openmvs", "points": len(points), "seconds": seconds}


def _child_seconds() -> float:
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime
