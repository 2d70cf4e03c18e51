"""Surface of one pose: the fused cloud becomes a clean triangle mesh with support per vertex."""

from __future__ import annotations

import logging
import time
from pathlib import Path
from typing import Any

import numpy as np

from capture_eval.errors import InputError, ReconstructionError
from capture_eval.files.atomic import read_json, write_json
from capture_eval.files.ply_files import write_ply
from capture_eval.files.point_cloud_files import read_point_cloud
from capture_eval.polygon_mesh import PolygonMesh
from capture_eval.reconstruction.surface_cleaning import SurfaceOptions, surface_from_cloud

logger = logging.getLogger("capture_eval.surface")

__all__ = ["SurfaceOptions", "reconstruct_surface"]


def reconstruct_surface(pose_folder: Path, options: SurfaceOptions) -> dict[str, Any]:
    """Read ``fused.ply``, write ``scan.ply`` (normals, `support` and `deviation` per vertex) and ``surface.json``.

    Returns
    -------
    dict
        The content of surface.json; status `ok`, `failed` (with a reason) or `skipped` (the dense stage failed).

    Raises
    ------
    InputError
        The cloud cannot be read or has no normals.
    """
    pose_folder = Path(pose_folder)
    if read_json(pose_folder / "dense.json").get("status") != "ok":
        return _save(pose_folder, {"status": "skipped", "reason": "the dense stage failed", "vertices": 0})
    start = time.process_time()
    path = pose_folder / "fused.ply"
    points, numbers = read_point_cloud(path)
    if not all(name in numbers for name in ("nx", "ny", "nz")):
        raise InputError(f"{path}: the cloud has no normals (nx, ny, nz)")
    normals = np.stack([numbers[name] for name in ("nx", "ny", "nz")], axis=1)
    weight = numbers.get("supporters", np.ones(len(points)))
    try:
        surface = surface_from_cloud(points, normals, weight, options, numbers.get("deviation"))
    except ReconstructionError as error:
        return _save(pose_folder, {"status": "failed", "reason": str(error), "vertices": 0})
    properties = {name: surface.normals[:, axis] for axis, name in enumerate(("nx", "ny", "nz"))}
    properties["support"] = surface.support
    known = bool(np.all(np.isfinite(surface.deviation)))  # COLMAP's own fusion says nothing about it
    if known:
        properties["deviation"] = surface.deviation
    write_ply(pose_folder / "scan.ply", PolygonMesh.from_faces(surface.vertices, surface.triangles), properties)
    result = {
        "status": "ok",
        "vertices": len(surface.vertices),
        "triangles": len(surface.triangles),
        "bounding_box": [surface.vertices.min(axis=0).tolist(), surface.vertices.max(axis=0).tolist()],
        "support_quantiles": {
            str(share): float(np.quantile(surface.support, share / 100)) for share in (1, 5, 25, 50, 75, 95)
        },
        "deviation_quantiles": {
            str(share): float(np.quantile(surface.deviation, share / 100)) for share in (50, 90, 99) if known
        },
        "seconds": time.process_time() - start,
    }
    logger.info("surface %s: %d vertices", pose_folder.name, result["vertices"])
    return _save(pose_folder, result)


def _save(pose_folder: Path, result: dict[str, Any]) -> dict[str, Any]:
    write_json(pose_folder / "surface.json", result)
    return result
