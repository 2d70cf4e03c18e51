"""Compiled kernel that asks another photo's depth map whether it sees the same surface."""

# mypy: disable-error-code="no-untyped-def,no-untyped-call,misc,untyped-decorator"

from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray


class OtherMap(NamedTuple):
    """A depth map to ask, with its calibration and its pose relative to the reference (other_from_reference)."""

    depth: NDArray[np.float32]
    normal: NDArray[np.float32]
    weight: NDArray[np.float32]
    matrix: NDArray[np.float64]
    rotation: NDArray[np.float64]
    translation: NDArray[np.float64]


class Sums(NamedTuple):
    """What the others said so far, per pixel.

    How many agree, how many see through the point; sums of the weights and, weighted, of the difference between the
    depth they meet and the depth asked about, of its square, and of the normals.
    """

    agree: NDArray[np.int32]
    through: NDArray[np.int32]
    weight: NDArray[np.float64]
    difference: NDArray[np.float64]
    square: NDArray[np.float64]
    normal: NDArray[np.float64]


@numba.njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _look_up(other, ray, z):
    """Pixel (row, column) of the other map where the point lies, its depth there, and the turned ray."""
    r = other.rotation
    turned_x = r[0, 0] * ray[0] + r[0, 1] * ray[1] + r[0, 2]
    turned_y = r[1, 0] * ray[0] + r[1, 1] * ray[1] + r[1, 2]
    turned_z = r[2, 0] * ray[0] + r[2, 1] * ray[1] + r[2, 2]
    w = turned_z * z + other.translation[2]
    if w <= 0:
        return -1, -1, w, turned_x, turned_y, turned_z
    x = (turned_x * z + other.translation[0]) / w
    y = (turned_y * z + other.translation[1]) / w
    column = int(np.floor(other.matrix[0, 0] * x + other.matrix[0, 1] * y + other.matrix[0, 2]))
    row = int(np.floor(other.matrix[1, 1] * y + other.matrix[1, 2]))
    height, width = other.depth.shape
    if column < 0 or row < 0 or column >= width or row >= height:
        return -1, -1, w, turned_x, turned_y, turned_z
    return row, column, w, turned_x, turned_y, turned_z


@numba.njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _plane_offset(other, row, column, normal, depth):
    """n . X of the tangent plane at a pixel of the other map, in its camera frame."""
    m = other.matrix
    y = (row + 0.5 - m[1, 2]) / m[1, 1]
    x = (column + 0.5 - m[0, 2] - m[0, 1] * y) / m[0, 0]
    return (normal[0] * x + normal[1] * y + normal[2]) * depth


@numba.njit(cache=True, nogil=True, error_model="numpy")
def support_rows(rows, depth, normal, inverse_matrix, other, tolerance, least_cosine, sums):
    """Add what one other depth map says to the running sums of a reference map.

    The other map agrees when the reference ray meets its tangent plane within `tolerance` (share of the depth) of the
    reference depth and the normals turn by less than the angle of `least_cosine`; the depth at which the planes are met
    is what gets averaged.  It sees through the point when its surface lies clearly behind.
    """
    t = other.translation
    r = other.rotation
    ray = np.ones(3)
    turned = np.zeros(3)
    for v in range(rows[0], rows[1]):
        for u in range(depth.shape[1]):
            z = depth[v, u]
            if z <= 0:
                continue
            m = inverse_matrix
            ray[0] = m[0, 0] * (u + 0.5) + m[0, 1] * (v + 0.5) + m[0, 2]
            ray[1] = m[1, 1] * (v + 0.5) + m[1, 2]
            row, column, w, x, y, along = _look_up(other, ray, z)
            if row < 0 or other.depth[row, column] <= 0:
                continue
            seen = other.depth[row, column]
            n = other.normal[row, column]
            if abs(seen - w) > 4.0 * tolerance * w:
                if seen > w:
                    sums.through[v, u] += 1
                continue
            facing = n[0] * x + n[1] * y + n[2] * along
            if facing >= -0.05:
                continue
            offset = _plane_offset(other, row, column, n, seen)
            met = (offset - (n[0] * t[0] + n[1] * t[1] + n[2] * t[2])) / facing
            for k in range(3):
                turned[k] = r[0, k] * n[0] + r[1, k] * n[1] + r[2, k] * n[2]
            cosine = turned[0] * normal[v, u, 0] + turned[1] * normal[v, u, 1] + turned[2] * normal[v, u, 2]
            if abs(met - z) > tolerance * z or cosine < least_cosine:
                continue
            share = other.weight[row, column] * cosine
            sums.agree[v, u] += 1
            sums.weight[v, u] += share
            sums.difference[v, u] += share * (met - z)
            sums.square[v, u] += share * (met - z) ** 2
            for k in range(3):
                sums.normal[v, u, k] += share * turned[k]
