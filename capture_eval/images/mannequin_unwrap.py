"""Texture coordinates of the mannequin: one chart, cut at the back of the head, without flips or overlaps.

The border of the cut skin lies on a convex curve and every other vertex is a weighted mean of its neighbours, so all
quads become convex and none flips (Floater, "Parametrization and smooth approximation of surface triangulations",
1997). The weights are then changed until each region gets the texel density asked for, after Yoshizawa, Belyaev and
Seidel, "A fast and simple stretch-minimizing mesh parameterization", 2004.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.linalg import spsolve

from capture_eval.images.mannequin_topology import CAP, Topology

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


def cut_at_back(topology: Topology, positions: FloatArray) -> tuple[IntArray, IntArray, IntArray]:
    """Cut the skin from the neck over the back of the head to the crown.

    Returns
    -------
    corners
        (F, 4) texture vertices; up to V - 1 they are the vertices themselves, then copies on the seam's left side.
    owner
        (T,) vertex of every texture vertex.
    border
        (B,) texture vertices round the cut skin: neck, left side of the seam upwards, right side downwards.
    """
    path = np.concatenate([topology.skull[::-1, 0], topology.cap[1 : CAP // 2 + 1, CAP // 2]])
    copies = topology.vertex_count + np.arange(len(path) - 1)
    table = np.arange(topology.vertex_count)
    table[path[:-1]] = copies
    on_left = positions[topology.quads].mean(axis=1)[:, 0] > 0
    corners = np.where(on_left[:, None], table[topology.quads], topology.quads)
    owner = np.concatenate([np.arange(topology.vertex_count), path[:-1]])
    neck = topology.skull[-1, 1:]
    border = np.concatenate([path[:1], neck, copies, path[:0:-1]])
    return corners, owner, border


def density_weights(topology: Topology, regions: dict[str, IntArray]) -> FloatArray:
    """(V,) wanted texels per millimetre relative to the face."""
    wanted = np.full(topology.vertex_count, 1.0)
    for name, value in {"scalp": 0.68, "neck": 0.68, "ears": 0.75, "inner": 0.22}.items():
        wanted[regions[name]] = value
    return wanted


def unwrap(topology: Topology, positions: FloatArray, wanted: FloatArray) -> tuple[FloatArray, IntArray]:
    """Texture coordinates (T, 2) in [0, 1] and corners (F, 4) of the canonical skin.

    Parameters
    ----------
    topology, positions
        The canonical skin, millimetres.
    wanted
        (V,) texels per millimetre wanted, relative.
    """
    corners, owner, border = cut_at_back(topology, positions)
    start, end = corners.ravel(), np.roll(corners, -1, axis=1).ravel()
    start, end = np.r_[start, end], np.r_[end, start]
    length = np.linalg.norm(positions[owner[start]] - positions[owner[end]], axis=1)
    weights = 1.0 / np.maximum(length, 0.05)
    frame = _border_frame(positions[owner[border]], topology.skull.shape[1])
    scaled_area = _areas(positions[topology.quads]) * wanted[topology.quads].mean(axis=1) ** 2
    coordinates = _solve(start, end, weights, border, frame, len(owner))
    for _ in range(60):
        flat = np.maximum(_areas(coordinates[corners]), 1e-12)
        stretch = np.sqrt(scaled_area / flat)
        per_vertex = 1.0 * np.bincount(corners.ravel(), np.repeat(stretch * scaled_area, 4), len(owner))
        per_vertex = per_vertex / np.bincount(corners.ravel(), np.repeat(scaled_area, 4), len(owner))
        per_vertex = np.clip(per_vertex / np.median(stretch), 0.2, 5.0)
        weights = weights / (per_vertex[end] ** 0.25 * per_vertex[start] ** 0.25)
        coordinates = _solve(start, end, weights, border, frame, len(owner))
    return 0.5 + 0.494 * coordinates, corners


def _solve(
    start: IntArray, end: IntArray, weights: FloatArray, border: IntArray, frame: FloatArray, count: int
) -> FloatArray:
    free = np.ones(count, dtype=bool)
    free[border] = False
    matrix = coo_matrix((weights, (start, end)), shape=(count, count)).tocsr()
    total = np.asarray(matrix.sum(axis=1)).ravel()
    coordinates = np.zeros((count, 2))
    coordinates[border] = frame
    left = coo_matrix((total[free], (np.arange(free.sum()), np.arange(free.sum())))) - matrix[free][:, free]
    coordinates[free] = np.asarray(spsolve(left.tocsc(), matrix[free][:, ~free] @ coordinates[~free]))
    return coordinates


def _border_frame(points: FloatArray, neck_count: int) -> FloatArray:
    """Positions of the border on a rounded square in [-1, 1]^2: neck below, seam on the sides and above."""
    steps = np.linalg.norm(np.roll(points, -1, axis=0) - points, axis=1)
    neck, seam = steps[:neck_count], steps[neck_count:]
    # angles from the lower left corner: the neck takes the lower side, the seam the other three
    angle = np.radians(
        np.r_[225 + 90 * np.r_[0, np.cumsum(neck)] / neck.sum(), 315 + 270 * np.cumsum(seam)[:-1] / seam.sum()]
    )
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    power = 7.0
    return np.asarray(circle / np.sum(np.abs(circle) ** power, axis=1, keepdims=True) ** (1 / power))


def _areas(quads: FloatArray) -> FloatArray:
    """Areas of quads (F, 4, 2 or 3) from their diagonals."""
    first, second = quads[:, 2] - quads[:, 0], quads[:, 3] - quads[:, 1]
    if quads.shape[2] == 2:
        return np.asarray(0.5 * np.abs(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]))
    return np.asarray(0.5 * np.linalg.norm(np.cross(first, second), axis=1))
