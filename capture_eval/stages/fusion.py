"""Depth maps of a workspace become one cloud, by the project's own fusion or by COLMAP's."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from capture_eval.cameras import View
from capture_eval.errors import ReconstructionError
from capture_eval.files.colmap_workspace import DenseWorkspace, map_path, read_map
from capture_eval.files.point_cloud_files import read_point_cloud, write_point_cloud
from capture_eval.reconstruction.depth_filtering import DepthMap, point_deviation, points_of_depth
from capture_eval.reconstruction.point_fusion import CellFusion, PointCloud, clearly_uncertain

Floats = NDArray[np.float64]


def fuse_maps(
    workspace: DenseWorkspace,
    fused: Path,
    fusion: str,
    point_spacing: float,
    minimum_pixels: int,
    most_deviation: float = 5.0,
) -> int:
    """Write the cloud of a workspace's geometric maps and return its number of points.

    Parameters
    ----------
    workspace : DenseWorkspace
    fused : Path
        PLY to write; own fusion adds `deviation` (unit of the model) and `supporters` (photos) to the normals.
    fusion : str
        `own` or `colmap`.
    point_spacing : float
        Own fusion: edge of the cells, pixels of the photos at the surface.
    minimum_pixels : int
        COLMAP's fusion: photos that must see a point.
    most_deviation : float
        Own fusion: points that are so many times more uncertain than the median, in pixels of the photos, are left out.

    Raises
    ------
    ReconstructionError
        No point is confirmed by enough photos.
    """
    if fusion == "colmap":
        count = _fuse_with_colmap(workspace, fused, minimum_pixels)
    else:
        count = _fuse_own(workspace, fused, point_spacing, most_deviation)
    if count == 0:
        raise ReconstructionError(f"{workspace.folder}: no point is confirmed by enough photos")
    return count


def _fuse_with_colmap(workspace: DenseWorkspace, fused: Path, minimum_pixels: int) -> int:
    import pycolmap

    pycolmap.logging.minloglevel = 2
    settings = pycolmap.StereoFusionOptions()
    settings.min_num_pixels = minimum_pixels
    settings.num_threads = 1
    settings.max_depth_error = 0.005
    pycolmap.stereo_fusion(
        str(fused), str(workspace.folder), input_type="geometric", options=settings, output_type="PLY"
    )
    return len(read_point_cloud(fused)[0])


def _fuse_own(workspace: DenseWorkspace, fused: Path, point_spacing: float, most_deviation: float) -> int:
    """Two walks over the maps, one photo in memory at a time: first how large the scene is, then its points."""
    boxes = []
    widths = []
    for view in workspace.views:
        cloud, width = _points_of(workspace, view)
        if len(width):
            boxes.append(np.stack([cloud.points.min(axis=0), cloud.points.max(axis=0)]))
            widths.append(float(np.median(width)))
    if not boxes:
        return 0
    low, high = np.min(boxes, axis=(0, 1)), np.max(boxes, axis=(0, 1))
    fusion = CellFusion(low, high, point_spacing * float(np.median(widths)))
    for view in workspace.views:
        cloud, width = _points_of(workspace, view)
        fusion.add(cloud, point_spacing * width)
    cloud = fusion.cloud()
    deviation = cloud.table()[:, 7]
    kept = ~clearly_uncertain(deviation, fusion.edges(), most_deviation)
    properties = {name: cloud.normals[kept, axis] for axis, name in enumerate(("nx", "ny", "nz"))}
    properties["deviation"] = deviation[kept]
    properties["supporters"] = cloud.supporters[kept]
    write_point_cloud(fused, cloud.points[kept], properties)
    return int(np.count_nonzero(kept))


def _points_of(workspace: DenseWorkspace, view: View) -> tuple[PointCloud, Floats]:
    """Points of one photo's geometric map, and the width of a pixel at each."""
    depth = read_map(map_path(workspace.folder, "depth", view.name, "geometric"))
    normal = read_map(map_path(workspace.folder, "normal", view.name, "geometric"))
    confidence = read_map(map_path(workspace.folder, "confidence", view.name, "geometric")).astype(np.float64)
    used = depth > 0
    frame = DepthMap(
        depth, normal, confidence[..., 0].astype(np.float32), view.intrinsics.matrix, view.rotation, view.translation
    )
    points, normals = points_of_depth(depth, normal, frame)
    width = depth[used].astype(np.float64) / view.intrinsics.matrix[0, 0]
    deviation = point_deviation(depth, normal, confidence[..., 2], view.intrinsics.matrix)
    return PointCloud(points, normals, confidence[..., 0][used], confidence[..., 1][used], deviation), width
