"""Normals, areas, edges and the diameter of triangle meshes."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from capture_eval.errors import InputError

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


def triangle_area_vectors(vertices: Floats, triangles: Integers) -> Floats:
    """Normals with the length of the triangle's area, (..., K, 3), for vertices (..., V, 3)."""
    first = vertices[..., triangles[:, 0], :]
    second = vertices[..., triangles[:, 1], :]
    third = vertices[..., triangles[:, 2], :]
    return np.asarray(0.5 * np.cross(second - first, third - first), dtype=np.float64)


def triangle_normals(vertices: Floats, triangles: Integers) -> Floats:
    """Unit normals (..., K, 3), right-handed; zero where a triangle has no area."""
    return _normalize(triangle_area_vectors(vertices, triangles))


def triangle_areas(vertices: Floats, triangles: Integers) -> Floats:
    """Areas (..., K)."""
    return np.asarray(np.linalg.norm(triangle_area_vectors(vertices, triangles), axis=-1), dtype=np.float64)


def vertex_normals(vertices: Floats, triangles: Integers) -> Floats:
    """Unit area-weighted vertex normals (V, 3); zero for vertices without area around them."""
    areas = triangle_area_vectors(vertices, triangles)
    total = np.zeros_like(vertices, dtype=np.float64)
    for corner in range(3):
        for axis in range(3):
            total[:, axis] += np.bincount(triangles[:, corner], areas[:, axis], minlength=len(vertices))
    return _normalize(total)


def unique_edges(triangles: Integers) -> Integers:
    """Undirected edges (E, 2), the smaller index first, sorted."""
    pairs = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    return np.unique(np.sort(pairs, axis=1), axis=0)


def diameter(points: ArrayLike) -> float:
    """Largest distance between two of the points (N, 3): the D of paper 003, Eq 35.

    Raises
    ------
    InputError
        Fewer than two points, wrong shape, or all points in one place.
    """
    places = np.asarray(points, dtype=np.float64)
    if places.ndim != 2 or places.shape[1] != 3 or len(places) < 2:
        raise InputError(f"diameter: points {places.shape}, expected at least two rows of three")
    corners = _hull_points(places)
    largest = 0.0
    for start in range(0, len(corners), 512):
        block = corners[start : start + 512, None, :] - corners[None, :, :]
        largest = max(largest, float(np.max(np.einsum("ijk,ijk->ij", block, block))))
    if largest == 0.0:
        raise InputError("diameter: all points are in one place (D = 0)")
    return float(np.sqrt(largest))


def _hull_points(points: Floats) -> Floats:
    from scipy.spatial import ConvexHull, QhullError

    if len(points) < 64:
        return points
    try:
        return np.asarray(points[ConvexHull(points).vertices], dtype=np.float64)
    except QhullError:  # flat or degenerate point sets have no hull: compare all of them
        return np.unique(points, axis=0)


def _normalize(vectors: Floats) -> Floats:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.asarray(vectors / np.where(length > 0, length, 1.0), dtype=np.float64)
