"""Exact visibility by ray casting (Open3D RaycastingScene, which is Embree): which triangle each pixel sample sees.

Embree works in single precision, so only its answer *which triangle* is used; where the ray meets that triangle is
computed again in double precision.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from capture_eval.cameras import View, pixel_rays, project

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
MISSED = -1
SAMPLES_PER_SIDE = 3
# Below this cosine between ray and triangle a pixel spans several triangles more often than not.
GRAZING_COSINE = 0.25


@dataclass(frozen=True)
class PixelSamples:
    """Which triangle every sample sees, for the pixels that see anything but the backdrop.

    Attributes
    ----------
    columns, rows
        (N,) pixels.
    triangles
        (N, samples) triangle, -1 where the backdrop is seen.
    directions
        (N, samples, 3) world ray directions, not normalised (depth 1 along the optical axis).
    center
        (3,) camera centre.
    """

    columns: IntArray
    rows: IntArray
    triangles: NDArray[np.int32]
    directions: FloatArray
    center: FloatArray


class TriangleScene:
    """Triangles that rays are cast against.

    Parameters
    ----------
    vertices
        (V, 3), any unit.
    triangles
        (K, 3) vertex indices.
    """

    def __init__(self, vertices: ArrayLike, triangles: ArrayLike) -> None:
        self.vertices = np.ascontiguousarray(vertices, dtype=np.float64)
        self.triangles = np.ascontiguousarray(triangles, dtype=np.int64)
        self._tensor, self._scene = _embree_scene(self.vertices, self.triangles)

    def first_triangles(self, origins: ArrayLike, directions: ArrayLike) -> NDArray[np.int32]:
        """First triangle met by rays (..., 3), -1 where there is none; origins may be one point (3,)."""
        rays = _rays(origins, directions)
        hits = self._scene.cast_rays(self._tensor(rays), nthreads=1)["primitive_ids"].numpy()
        # Embree's invalid id is 2^32 - 1, which is -1 as a signed number.
        return np.asarray(hits.view(np.int32), dtype=np.int32)

    def occluded(self, origins: ArrayLike, targets: ArrayLike, slack: float = 1e-4) -> NDArray[np.bool_]:
        """True where something stands between origins and targets (..., 3); the last `slack` part is ignored."""
        rays = _rays(origins, np.asarray(targets, dtype=np.float64) - np.asarray(origins, dtype=np.float64))
        found = self._scene.test_occlusions(self._tensor(rays), tnear=0.0, tfar=1.0 - slack, nthreads=1)
        return np.asarray(found.numpy(), dtype=np.bool_)

    def escapes(self, origins: ArrayLike, directions: ArrayLike) -> NDArray[np.bool_]:
        """True where rays (..., 3) meet nothing at all."""
        found = self._scene.test_occlusions(self._tensor(_rays(origins, directions)), nthreads=1)
        return np.asarray(~found.numpy(), dtype=np.bool_)


def _embree_scene(vertices: FloatArray, triangles: IntArray) -> tuple[Any, Any]:
    """Open3D's tensor type and a scene of the triangles."""
    import open3d

    core: Any = open3d.core
    scene: Any = open3d.t.geometry.RaycastingScene(nthreads=1)
    scene.add_triangles(core.Tensor(vertices.astype(np.float32)), core.Tensor(triangles.astype(np.uint32)))
    return core.Tensor, scene


def _rays(origins: ArrayLike, directions: ArrayLike) -> NDArray[np.float32]:
    directions = np.asarray(directions)
    rays = np.empty((*directions.shape[:-1], 6), dtype=np.float32)
    rays[..., :3] = origins
    rays[..., 3:] = directions
    return rays


def sample_pixels(scene: TriangleScene, view: View, samples_per_side: int = SAMPLES_PER_SIDE) -> PixelSamples:
    """Cast the rays of a photo: a regular grid of samples in every pixel, so that their mean is a box filter.

    One ray is cast through every pixel centre. Where the pixel lies inside one smooth stretch of surface, its other
    samples are placed on the plane of the triangle at the centre; at silhouettes, creases and grazing angles every
    sample gets a ray of its own.

    Parameters
    ----------
    scene
        What stands before the camera.
    view
        Camera.
    samples_per_side
        3 means 9 samples in a pixel.
    """
    left, top, width, height = _window(scene.vertices, view)
    columns, rows = (grid.ravel() for grid in np.meshgrid(left + np.arange(width), top + np.arange(height)))
    central, along_u, along_v = _direction_planes(view, np.stack([columns + 0.5, rows + 0.5], axis=1))
    center = view.center
    seen = scene.first_triangles(center, central)
    mixed = _mixed_pixels(scene, center, central, seen, (height, width), float(view.intrinsics.matrix[0, 0]))
    used = np.flatnonzero((seen >= 0) | mixed)
    offsets = (np.arange(samples_per_side) + 0.5) / samples_per_side - 0.5
    shift_u, shift_v = (grid.ravel() for grid in np.meshgrid(offsets, offsets))
    directions = (
        central[used, None, :]
        + shift_u[None, :, None] * along_u[used, None, :]
        + shift_v[None, :, None] * along_v[used, None, :]
    )
    triangles = np.repeat(seen[used, None], samples_per_side**2, axis=1)
    again = mixed[used]
    triangles[again] = scene.first_triangles(center, directions[again])
    return PixelSamples(columns[used], rows[used], triangles, directions, center)


def _window(vertices: FloatArray, view: View) -> tuple[int, int, int, int]:
    pixels, depth = project(view, vertices)
    pixels = pixels[depth > 0]
    if not len(pixels):
        return 0, 0, 0, 0
    size = np.array([view.intrinsics.width, view.intrinsics.height])
    low = np.clip(np.floor(pixels.min(axis=0)) - 2, 0, size).astype(int)
    high = np.clip(np.ceil(pixels.max(axis=0)) + 2, 0, size).astype(int)
    width, height = np.maximum(high - low, 0)
    return int(low[0]), int(low[1]), int(width), int(height)


def _direction_planes(view: View, pixels: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Directions of depth 1 through pixels, and how they change per pixel in u and v (exact without distortion)."""
    axis = view.rotation[2]

    def directions(shift: tuple[float, float]) -> FloatArray:
        _, rays = pixel_rays(view, pixels + np.asarray(shift))
        return np.asarray(rays / (rays @ axis)[:, None], dtype=np.float64)

    central = directions((0.0, 0.0))
    if not np.any(view.intrinsics.distortion):
        matrix = view.intrinsics.matrix
        sideways = view.rotation[0] / matrix[0, 0]
        downwards = view.rotation[1] / matrix[1, 1] - matrix[0, 1] / matrix[1, 1] * sideways
        return central, np.broadcast_to(sideways, central.shape), np.broadcast_to(downwards, central.shape)
    along_u = directions((0.5, 0.0)) - directions((-0.5, 0.0))
    along_v = directions((0.0, 0.5)) - directions((0.0, -0.5))
    return central, along_u, along_v


def plane_depths(
    scene: TriangleScene, center: FloatArray, directions: FloatArray, triangles: NDArray[np.int32]
) -> tuple[FloatArray, FloatArray]:
    """Ray parameter at the planes of the given triangles, and the cosine between ray and plane normal.

    Parameters
    ----------
    center
        (3,) common origin.
    directions
        (N, 3).
    triangles
        (N,) triangle of every ray; rows with -1 give NaN.

    Returns
    -------
    depth, cosine
        (N,) each.
    """
    corners = scene.vertices[scene.triangles[np.maximum(triangles, 0)]]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    slope = np.einsum("ij,ij->i", normals, directions)
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = np.einsum("ij,ij->i", normals, corners[:, 0] - center) / slope
        cosine = np.abs(slope) / (np.linalg.norm(normals, axis=1) * np.linalg.norm(directions, axis=1))
    depth[triangles < 0] = np.nan
    return depth, cosine


def _mixed_pixels(
    scene: TriangleScene,
    center: FloatArray,
    directions: FloatArray,
    seen: NDArray[np.int32],
    shape: tuple[int, int],
    focal: float,
) -> NDArray[np.bool_]:
    """Pixels whose surroundings are no smooth stretch of surface: (pixels,) bool."""
    depth, cosine = plane_depths(scene, center, directions, seen)
    mixed = (seen >= 0) & ~(cosine > GRAZING_COSINE)
    seen_grid, depth_grid = seen.reshape(shape), depth.reshape(shape)
    rays = directions.reshape(*shape, 3)
    mixed_grid = mixed.reshape(shape).copy()
    # A neighbour continues the surface when it lies on this pixel's plane to half a pixel's footprint.
    for rows, columns in ((0, 1), (0, -1), (1, 0), (-1, 0), (1, 1), (-1, -1), (1, -1), (-1, 1)):
        here, there = _shifted(shape, rows, columns)
        own, other = seen_grid[here], seen_grid[there]
        differs = (own != other) & ((own >= 0) | (other >= 0))
        flat = np.flatnonzero(differs)
        if not len(flat):
            continue
        predicted, _ = plane_depths(scene, center, rays[there][differs], own[differs])
        actual = depth_grid[there][differs]
        with np.errstate(invalid="ignore"):
            continues = np.abs(predicted - actual) < 0.5 * np.abs(actual) / focal
        view = mixed_grid[here]
        view[differs] |= ~continues
        mixed_grid[here] = view
    return np.asarray(mixed_grid.ravel(), dtype=np.bool_)


def _shifted(shape: tuple[int, int], rows: int, columns: int) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
    def pair(size: int, step: int) -> tuple[slice, slice]:
        return slice(max(0, -step), size - max(0, step)), slice(max(0, step), size - max(0, -step))

    row_here, row_there = pair(shape[0], rows)
    column_here, column_there = pair(shape[1], columns)
    return (row_here, column_here), (row_there, column_there)
