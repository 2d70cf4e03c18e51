"""Depth maps against the true depth, by tilt of the surface and by contrast of the skin."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture_eval.cameras import View, pixel_rays
from capture_eval.evaluation.surface_error import TrueScene
from capture_eval.files.colmap_workspace import map_path, read_colours, read_map, read_workspace
from capture_eval.images.ray_casting import TriangleScene
from capture_eval.triangle_geometry import triangle_normals

Floats = NDArray[np.float64]

EVERY = 4  # every so many photos are compared
TILTS = (0, 15, 30, 40, 50, 60, 70, 80)  # degrees between the normal and the ray
CONTRASTS = (0.0, 0.7, 0.85, 1.0, 1.25, 1.6, 2.0, 2.5, 3.5, 5.0, 99.0)  # grey levels
FINE, WINDOW = 2.0, 3.0  # pixels: detail is what a blur of the first removes; its deviation over the second
FRONTAL = 45.0  # degrees: contrast is looked at where tilt does no harm
STAGES = ("photometric", "geometric")


def true_depth(view: View, truth: TrueScene) -> tuple[Floats, Floats]:
    """Depth (H, W) and tilt (H, W) in degrees of the skin at the pixel centres; NaN beside it."""
    width, height = view.intrinsics.width, view.intrinsics.height
    columns, rows = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    origin, rays = pixel_rays(view, np.stack([columns.ravel(), rows.ravel()], axis=1))
    triangle = TriangleScene(truth.vertices, truth.triangles).first_triangles(origin, rays)
    skin = (triangle >= 0) & (triangle < truth.skin_triangles)
    depth, tilt = np.full(len(rays), np.nan), np.full(len(rays), np.nan)
    normals = triangle_normals(truth.vertices, truth.triangles[triangle[skin]])
    cosine = -np.sum(normals * rays[skin], axis=1)
    # The distance in double precision: the plane of the triangle met.
    base = truth.vertices[truth.triangles[triangle[skin], 0]] - origin
    along = np.sum(base * normals, axis=1) / np.where(np.abs(cosine) > 1e-9, -cosine, np.nan)
    depth[skin] = along * (rays[skin] @ view.rotation[2])
    tilt[skin] = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
    return depth.reshape(height, width), tilt.reshape(height, width)


def fine_contrast(colours: NDArray[np.uint8]) -> Floats:
    """Local standard deviation (H, W) of the fine detail of a photo, grey levels; noise counts in it."""
    import cv2

    grey = colours.mean(axis=2)
    fine = grey - cv2.GaussianBlur(grey, (0, 0), FINE)
    return np.sqrt(cv2.GaussianBlur(fine**2, (0, 0), WINDOW))


def compare_maps(workspace: Path, truth: TrueScene) -> dict[str, Any]:
    """Errors of depth by tilt and by contrast, before and after the maps confirm each other.

    Returns
    -------
    dict
        `tilt`, and `contrast` of skin tilted by less than 45 degrees: edges of the bins, pixels of skin in them, and
        for both stages the share of the pixels that have a depth, the share within .3 % of D, and the median and the
        90th percentile of the error (% of D).
    """
    content = read_workspace(workspace)
    tilts, contrasts = [], []
    errors: dict[str, list[Floats]] = {stage: [] for stage in STAGES}
    for index in range(0, len(content.views), EVERY):
        view = content.views[index]
        depth, tilt = true_depth(view, truth)
        skin = np.isfinite(depth) & (tilt < TILTS[-1])
        tilts.append(tilt[skin])
        contrasts.append(fine_contrast(read_colours(content.image_path(index), view))[skin])
        for stage in STAGES:
            found = read_map(map_path(workspace, "depth", view.name, stage)).astype(np.float64)[skin]
            gap = 100.0 * np.abs(found - depth[skin]) / truth.size
            errors[stage].append(np.where(found > 0, gap, np.nan))
    joined = {stage: np.concatenate(parts) for stage, parts in errors.items()}
    tilt, contrast = np.concatenate(tilts), np.concatenate(contrasts)
    frontal = tilt < FRONTAL
    return {
        "tilt": _binned(tilt, TILTS, joined),
        "contrast": _binned(contrast[frontal], CONTRASTS, {stage: gap[frontal] for stage, gap in joined.items()}),
    }


def _binned(key: Floats, edges: tuple[float, ...], errors: dict[str, Floats]) -> dict[str, Any]:
    place = np.digitize(key, edges) - 1
    bins = range(len(edges) - 1)
    result: dict[str, Any] = {
        "edges": list(edges),
        "pixels": [int(np.count_nonzero(place == number)) for number in bins],
        "middle": [_percentile(key[place == number], 50) for number in bins],
    }
    for stage, gap in errors.items():
        parts = [gap[place == number] for number in bins]
        known = [part[np.isfinite(part)] for part in parts]
        result[stage] = {
            "share": [len(some) / max(len(part), 1) for some, part in zip(known, parts, strict=True)],
            "share_close": [
                np.count_nonzero(some < 0.3) / max(len(part), 1) for some, part in zip(known, parts, strict=True)
            ],
            "median": [_percentile(some, 50) for some in known],
            "p90": [_percentile(some, 90) for some in known],
        }
    return result


def _percentile(values: Floats, share: float) -> float | None:
    """None where there are too few pixels to say."""
    return float(np.percentile(values, share)) if len(values) >= 200 else None
