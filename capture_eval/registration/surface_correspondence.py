"""Closest points and ray hits on a triangulated surface, with what is known there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from capture_eval.errors import InputError
from capture_eval.triangle_geometry import vertex_normals

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


@dataclass(frozen=True)
class SurfacePoints:
    """Places on a surface.

    Parameters
    ----------
    points : (N, 3) float64
    normals : (N, 3) float64
        Interpolated vertex normals of unit length.
    triangle : (N,) int64
        -1 where a ray missed.
    barycentric : (N, 3) float64
    support : (N,) float64
        Interpolated support of the surface; zero on triangles at its border.
    """

    points: Floats
    normals: Floats
    triangle: Integers
    barycentric: Floats
    support: Floats

    @property
    def hit(self) -> NDArray[np.bool_]:
        """Where there is a point at all."""
        return np.asarray(self.triangle >= 0, dtype=np.bool_)


class Surface:
    """A triangulated surface for closest-point and ray queries (Embree through Open3D, single thread).

    Parameters
    ----------
    vertices : (V, 3) float64
    triangles : (K, 3) int64
    support : (V,) float64, optional
        How well each vertex is measured, in [0, 1]; 1 where not given.

    Raises
    ------
    InputError
        An empty surface or support of another length.
    """

    def __init__(self, vertices: Floats, triangles: Integers, support: Floats | None = None) -> None:
        import open3d

        if len(vertices) == 0 or len(triangles) == 0:
            raise InputError(f"surface: {len(vertices)} vertices and {len(triangles)} triangles")
        self.vertices = vertices
        self.triangles = triangles
        self.normals = vertex_normals(vertices, triangles)
        self.support = np.ones(len(vertices)) if support is None else np.asarray(support, dtype=np.float64)
        if self.support.shape != (len(vertices),):
            raise InputError(f"surface: support {self.support.shape} for {len(vertices)} vertices")
        self.border = _border_triangles(triangles)
        # Embree works in single precision: distances keep their digits around the middle of the surface.
        self._middle = vertices.mean(axis=0)
        library = cast("Any", open3d)
        self._tensor = library.core.Tensor
        self._scene = library.t.geometry.RaycastingScene(nthreads=1)
        self._scene.add_triangles(
            self._tensor((vertices - self._middle).astype(np.float32)),
            self._tensor(triangles.astype(np.uint32)),
        )

    def closest(self, queries: Floats) -> SurfacePoints:
        """Closest point of the surface to each query (N, 3)."""
        places = self._tensor((queries - self._middle).astype(np.float32))
        answer = self._scene.compute_closest_points(places, nthreads=1)
        triangle = answer["primitive_ids"].numpy().astype(np.int64)
        barycentric = barycentric_of(answer["points"].numpy() + self._middle, self.vertices[self.triangles[triangle]])
        return self._at(triangle, barycentric)

    def cast(self, origins: Floats, directions: Floats) -> SurfacePoints:
        """First hit of rays; origins (N, 3) or (3,), directions (N, 3)."""
        start = np.broadcast_to(origins - self._middle, directions.shape)
        rays = np.concatenate([start, directions], axis=1).astype(np.float32)
        answer = self._scene.cast_rays(self._tensor(rays), nthreads=1)
        triangle = answer["primitive_ids"].numpy().astype(np.int64)
        missed = ~np.isfinite(answer["t_hit"].numpy())
        pair = answer["primitive_uvs"].numpy().astype(np.float64)
        barycentric = np.concatenate([1.0 - pair.sum(axis=1, keepdims=True), pair], axis=1)
        triangle[missed] = -1
        return self._at(triangle, barycentric)

    def _at(self, triangle: Integers, barycentric: Floats) -> SurfacePoints:
        corners = self.triangles[np.maximum(triangle, 0)]
        points = np.einsum("nk,nki->ni", barycentric, self.vertices[corners])
        normals = np.einsum("nk,nki->ni", barycentric, self.normals[corners])
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
        support = np.einsum("nk,nk->n", barycentric, self.support[corners])
        support[self.border[np.maximum(triangle, 0)] | (triangle < 0)] = 0.0
        return SurfacePoints(points, normals, triangle, barycentric, support)


def _border_triangles(triangles: Integers) -> NDArray[np.bool_]:
    """Triangles with a vertex on an open edge."""
    count = np.int64(triangles.max()) + 1
    pairs = np.sort(np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), axis=1)
    keys, uses = np.unique(pairs[:, 0] * count + pairs[:, 1], return_counts=True)
    single = keys[uses == 1]
    on_border = np.zeros(count, dtype=np.bool_)
    on_border[single // count] = True
    on_border[single % count] = True
    return np.asarray(on_border[triangles].any(axis=1), dtype=np.bool_)


def barycentric_of(points: Floats, corners: Floats) -> Floats:
    """Barycentric coordinates (N, 3) of points (N, 3) in triangles (N, 3, 3), clipped to the triangle."""
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    offset = points - corners[:, 0]
    aa, ab, bb = (np.sum(x * y, axis=1) for x, y in ((first, first), (first, second), (second, second)))
    ap, bp = np.sum(first * offset, axis=1), np.sum(second * offset, axis=1)
    determinant = aa * bb - ab * ab
    usable = determinant > 1e-300
    safe = np.where(usable, determinant, 1.0)
    u = np.where(usable, (bb * ap - ab * bp) / safe, 0.0)
    v = np.where(usable, (aa * bp - ab * ap) / safe, 0.0)
    weights = np.clip(np.stack([1.0 - u - v, u, v], axis=1), 0.0, 1.0)
    return np.asarray(weights / weights.sum(axis=1, keepdims=True), dtype=np.float64)
