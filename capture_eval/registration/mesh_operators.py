"""Neighbourhoods, Laplacian and local rotations of a triangle mesh."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray

from capture_eval.errors import InputError
from capture_eval.triangle_geometry import unique_edges

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

# Cotangents of slivers explode or turn negative; clipped relative to the mean they keep the operator definite.
_WEIGHT_RANGE = (0.15, 3.0)


@dataclass(frozen=True)
class MeshOperators:
    """What the deformation solver needs of the rest shape.

    Parameters
    ----------
    vertices : (V, 3) float64
        Rest shape.
    triangles : (K, 3) int64
    edges : (E, 2) int64
        Undirected, the smaller index first.
    weights : (E,) float64
        Cotangent weights divided by their mean, clipped to [.15, 3].
    laplacian : (V, V) sparse
        Umbrella: vertex minus the weighted mean of its neighbours.
    adjacency : (V, V) sparse
        The weights as a symmetric matrix.
    """

    vertices: Floats
    triangles: Integers
    edges: Integers
    weights: Floats
    laplacian: sparse.csr_matrix
    adjacency: sparse.csr_matrix


def build_mesh_operators(vertices: Floats, triangles: Integers) -> MeshOperators:
    """Operators of a rest shape.

    Raises
    ------
    InputError
        No triangles, indices outside the mesh, or positions that are not finite.
    """
    if triangles.ndim != 2 or triangles.shape[1] != 3 or len(triangles) == 0:
        raise InputError(f"mesh operators: triangles {triangles.shape}, expected (K, 3) with K > 0")
    if triangles.min() < 0 or triangles.max() >= len(vertices):
        raise InputError(f"mesh operators: a triangle uses a vertex outside of 0..{len(vertices) - 1}")
    if not np.all(np.isfinite(vertices)):
        raise InputError("mesh operators: the rest shape is not finite")
    edges = unique_edges(triangles)
    weights = _cotangent_weights(vertices, triangles, edges)
    count = len(vertices)
    rows = np.concatenate([edges[:, 0], edges[:, 1]])
    columns = np.concatenate([edges[:, 1], edges[:, 0]])
    adjacency = sparse.csr_matrix((np.tile(weights, 2), (rows, columns)), shape=(count, count))
    total = np.asarray(adjacency.sum(axis=1)).ravel()
    scale = np.divide(1.0, total, out=np.zeros(count), where=total > 0)
    connected = sparse.diags((total > 0).astype(np.float64))
    laplacian = sparse.csr_matrix(connected - sparse.diags(scale) @ adjacency)
    return MeshOperators(vertices, triangles, edges, weights, laplacian, adjacency)


def _cotangent_weights(vertices: Floats, triangles: Integers, edges: Integers) -> Floats:
    count = np.int64(len(vertices))
    keys = edges[:, 0] * count + edges[:, 1]
    total = np.zeros(len(edges))
    for corner in range(3):
        apex = triangles[:, corner]
        left, right = triangles[:, (corner + 1) % 3], triangles[:, (corner + 2) % 3]
        first, second = vertices[left] - vertices[apex], vertices[right] - vertices[apex]
        area = np.linalg.norm(np.cross(first, second), axis=1)
        cotangent = np.sum(first * second, axis=1) / np.maximum(area, 1e-12 * np.abs(first).max() ** 2 + 1e-300)
        edge = np.searchsorted(keys, np.minimum(left, right) * count + np.maximum(left, right))
        total += np.bincount(edge, 0.5 * np.clip(cotangent, -10.0, 10.0), minlength=len(edges))
    mean = float(np.mean(total[total > 0])) if np.any(total > 0) else 1.0
    return np.clip(total / mean, *_WEIGHT_RANGE)


def local_rotations(operators: MeshOperators, deformed: Floats, smoothing: int = 2) -> Floats:
    """Rotation of every vertex's surroundings from the rest shape to the deformed one, (V, 3, 3).

    The covariance of the edges around a vertex (Sorkine and Alexa 2007, Eq 5) is averaged over neighbours
    `smoothing` times before its nearest rotation is taken: flat surroundings alone leave it ill determined.
    """
    tail, head = operators.edges[:, 0], operators.edges[:, 1]
    rest_edges = operators.vertices[head] - operators.vertices[tail]
    new_edges = deformed[head] - deformed[tail]
    products = operators.weights[:, None, None] * new_edges[:, :, None] * rest_edges[:, None, :]
    flat = products.reshape(-1, 9)
    count = len(operators.vertices)
    covariance = np.empty((count, 9))
    for entry in range(9):
        covariance[:, entry] = np.bincount(tail, flat[:, entry], minlength=count)
        covariance[:, entry] += np.bincount(head, flat[:, entry], minlength=count)
    total = np.asarray(operators.adjacency.sum(axis=1)).ravel()
    mean_weight = np.divide(1.0, total, out=np.zeros(count), where=total > 0)
    for _ in range(smoothing):
        covariance = 0.5 * covariance + 0.5 * mean_weight[:, None] * (operators.adjacency @ covariance)
    return nearest_rotations(covariance.reshape(-1, 3, 3))


def nearest_rotations(matrices: Floats) -> Floats:
    """Proper rotation nearest to each matrix, (N, 3, 3); the identity for zero matrices."""
    left, singular, right = np.linalg.svd(matrices)
    signs = np.ones_like(singular)
    signs[:, 2] = np.where(np.linalg.det(left @ right) < 0, -1.0, 1.0)
    rotations = (left * signs[:, None, :]) @ right
    rotations[singular[:, 0] == 0.0] = np.eye(3)
    return np.asarray(rotations, dtype=np.float64)


def ring_neighbourhood(operators: MeshOperators, rings: int) -> sparse.csr_matrix:
    """Boolean (V, V) matrix: which vertices lie within so many edges of a vertex, itself included."""
    step = sparse.csr_matrix(operators.adjacency > 0) + sparse.identity(len(operators.vertices), dtype=bool)
    reach = sparse.identity(len(operators.vertices), dtype=bool, format="csr")
    for _ in range(rings):
        reach = sparse.csr_matrix((reach @ step) > 0)
    return reach
