"""Compiled kernel that asks other photos' depth maps whether they see the same surface."""

# mypy: disable-error-code="no-untyped-def,no-untyped-call,misc,untyped-decorator"

import numba
import numpy as np


@numba.njit(cache=True, nogil=True, error_model="numpy")
def support_rows(
    rows,
    depth,
    normal,
    inverse_matrix,
    matrix,
    other_depth,
    other_normal,
    other_weight,
    rotation,
    translation,
    tolerances,
    count,
    conflicts,
    total,
    moved,
    total_normal,
):
    """Add what one other depth map says to the running sums of a reference map.

    A pixel's point is seen by the other map when it falls on a surface whose depth there is equal to
    tolerances[0] (relative), whose return lands within tolerances[1] pixels, and whose normal turns by less than the
    angle of cosine tolerances[2].  `moved` sums, weighted, the depth at which the reference ray meets the other's
    plane.  `conflicts` counts maps that see through the point (their surface lies clearly behind it).
    """
    width = depth.shape[1]
    other_height, other_width = other_depth.shape
    for v in range(rows[0], rows[1]):
        for u in range(width):
            z = depth[v, u]
            if z <= 0:
                continue
            rx = inverse_matrix[0, 0] * (u + 0.5) + inverse_matrix[0, 1] * (v + 0.5) + inverse_matrix[0, 2]
            ry = inverse_matrix[1, 1] * (v + 0.5) + inverse_matrix[1, 2]
            dx = rotation[0, 0] * rx + rotation[0, 1] * ry + rotation[0, 2]
            dy = rotation[1, 0] * rx + rotation[1, 1] * ry + rotation[1, 2]
            dz = rotation[2, 0] * rx + rotation[2, 1] * ry + rotation[2, 2]
            x = dx * z + translation[0]
            y = dy * z + translation[1]
            w = dz * z + translation[2]
            if w <= 0:
                continue
            pu = (matrix[0, 0] * x + matrix[0, 1] * y) / w + matrix[0, 2]
            pv = matrix[1, 1] * y / w + matrix[1, 2]
            column = int(np.floor(pu))
            row = int(np.floor(pv))
            if column < 0 or row < 0 or column >= other_width or row >= other_height:
                continue
            seen = other_depth[row, column]
            if seen <= 0:
                continue
            nx = other_normal[row, column, 0]
            ny = other_normal[row, column, 1]
            nz = other_normal[row, column, 2]
            gx = (column + 0.5 - matrix[0, 2] - matrix[0, 1] * (row + 0.5 - matrix[1, 2]) / matrix[1, 1]) / matrix[0, 0]
            gy = (row + 0.5 - matrix[1, 2]) / matrix[1, 1]
            offset = (nx * gx + ny * gy + nz) * seen
            facing = nx * dx + ny * dy + nz * dz
            if abs(seen - w) > 4.0 * tolerances[0] * w:
                if seen > w * (1.0 + 4.0 * tolerances[0]):
                    conflicts[v, u] += 1
                continue
            if facing >= -0.05:
                continue
            met = (offset - (nx * translation[0] + ny * translation[1] + nz * translation[2])) / facing
            if abs(met - z) > tolerances[0] * z:
                continue
            turned_x = rotation[0, 0] * nx + rotation[1, 0] * ny + rotation[2, 0] * nz
            turned_y = rotation[0, 1] * nx + rotation[1, 1] * ny + rotation[2, 1] * nz
            turned_z = rotation[0, 2] * nx + rotation[1, 2] * ny + rotation[2, 2] * nz
            cosine = turned_x * normal[v, u, 0] + turned_y * normal[v, u, 1] + turned_z * normal[v, u, 2]
            if cosine < tolerances[2]:
                continue
            share = other_weight[row, column] * cosine
            count[v, u] += 1
            total[v, u] += share
            moved[v, u] += share * met
            total_normal[v, u, 0] += share * turned_x
            total_normal[v, u, 1] += share * turned_y
            total_normal[v, u, 2] += share * turned_z
