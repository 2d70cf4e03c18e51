"""Compiled loops of the texture-space steps: rasterising, depth buffers, sampling photos at surface points.

Imported only by the functions that use it, since numba is heavy. Every loop is sequential, so that results
are the same bit for bit whatever the number of threads.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

SUBTEXEL = 4096


@numba.njit(cache=True)
def _edge(ax: int, ay: int, bx: int, by: int, px: int, py: int) -> int:
    return (bx - ax) * (py - ay) - (by - ay) * (px - ax)


@numba.njit(cache=True)
def _owns_its_edge(ax: int, ay: int, bx: int, by: int) -> bool:
    """Top-left rule for a triangle whose inner side has positive edge values."""
    return (ay == by and bx > ax) or by < ay


@numba.njit(cache=True)
def rasterise(corners: NDArray[np.int64], size: int) -> tuple[NDArray[np.int32], NDArray[np.float32], int]:
    """Triangle and barycentric weights at every texel's centre, and the number of texels covered twice.

    ``corners`` (K, 3, 2) are whole numbers of 1/4096 texel: edge values are then exact, and a texel on a
    shared edge belongs to one of the two triangles, never to both or none. The first triangle keeps a texel.
    """
    triangle = np.full((size, size), -1, dtype=np.int32)
    barycentric = np.zeros((size, size, 3), dtype=np.float32)
    twice = 0
    half = SUBTEXEL // 2
    for k in range(corners.shape[0]):
        ax, ay = corners[k, 0, 0], corners[k, 0, 1]
        bx, by = corners[k, 1, 0], corners[k, 1, 1]
        cx, cy = corners[k, 2, 0], corners[k, 2, 1]
        area = _edge(ax, ay, bx, by, cx, cy)
        if area == 0:
            continue
        flipped = area < 0
        if flipped:
            bx, by, cx, cy = cx, cy, bx, by
            area = -area
        column_first = max(0, min(ax, bx, cx) // SUBTEXEL)
        column_last = min(size - 1, max(ax, bx, cx) // SUBTEXEL)
        row_first = max(0, min(ay, by, cy) // SUBTEXEL)
        row_last = min(size - 1, max(ay, by, cy) // SUBTEXEL)
        own_a = _owns_its_edge(bx, by, cx, cy)
        own_b = _owns_its_edge(cx, cy, ax, ay)
        own_c = _owns_its_edge(ax, ay, bx, by)
        for row in range(row_first, row_last + 1):
            py = row * SUBTEXEL + half
            for column in range(column_first, column_last + 1):
                px = column * SUBTEXEL + half
                wa = _edge(bx, by, cx, cy, px, py)
                wb = _edge(cx, cy, ax, ay, px, py)
                wc = _edge(ax, ay, bx, by, px, py)
                if wa < 0 or wb < 0 or wc < 0:
                    continue
                if (wa == 0 and not own_a) or (wb == 0 and not own_b) or (wc == 0 and not own_c):
                    continue
                if triangle[row, column] >= 0:
                    twice += 1
                    continue
                triangle[row, column] = k
                barycentric[row, column, 0] = wa / area
                if flipped:
                    wb, wc = wc, wb
                barycentric[row, column, 1] = wb / area
                barycentric[row, column, 2] = wc / area
    return triangle, barycentric, twice


@numba.njit(cache=True)
def surface_points(
    triangle: NDArray[np.int32],
    barycentric: NDArray[np.float32],
    triangles: NDArray[np.int64],
    values: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Interpolate (V, 3) ``values`` at (M,) points given by triangle and (M, 3) barycentric weights."""
    result = np.empty((triangle.shape[0], 3))
    for m in range(triangle.shape[0]):
        k = triangle[m]
        a, b, c = triangles[k, 0], triangles[k, 1], triangles[k, 2]
        wa, wb, wc = barycentric[m, 0], barycentric[m, 1], barycentric[m, 2]
        for axis in range(3):
            result[m, axis] = wa * values[a, axis] + wb * values[b, axis] + wc * values[c, axis]
    return result


@numba.njit(cache=True, inline="always")
def _to_camera(camera, x, y, z):  # type: ignore[no-untyped-def]
    return (
        camera[0] * x + camera[1] * y + camera[2] * z + camera[9],
        camera[3] * x + camera[4] * y + camera[5] * z + camera[10],
        camera[6] * x + camera[7] * y + camera[8] * z + camera[11],
    )


@numba.njit(cache=True, inline="always")
def _to_pixel(camera, xc, yc, zc):  # type: ignore[no-untyped-def]
    """OpenCV's four-parameter lens on camera coordinates."""
    x = xc / zc
    y = yc / zc
    r2 = x * x + y * y
    radial = 1.0 + r2 * (camera[16] + r2 * camera[17])
    xd = x * radial + 2.0 * camera[18] * x * y + camera[19] * (r2 + 2.0 * x * x)
    yd = y * radial + camera[18] * (r2 + 2.0 * y * y) + 2.0 * camera[19] * x * y
    return camera[12] * xd + camera[20] * yd + camera[14], camera[13] * yd + camera[15]


@numba.njit(cache=True)
def depth_buffer(
    camera: NDArray[np.float64],
    vertices: NDArray[np.float64],
    triangles: NDArray[np.int64],
    buffer: NDArray[np.float32],
) -> None:
    """Draw a mesh into ``buffer`` (H, W; changed in place), nearest depth along the camera's axis."""
    height, width = buffer.shape
    count = vertices.shape[0]
    pixel = np.empty((count, 2))
    inverse_depth = np.empty(count)
    for i in range(count):
        xc, yc, zc = _to_camera(camera, vertices[i, 0], vertices[i, 1], vertices[i, 2])
        if zc > 0:
            inverse_depth[i] = 1.0 / zc
            pixel[i, 0], pixel[i, 1] = _to_pixel(camera, xc, yc, zc)
        else:
            inverse_depth[i] = -1.0
    for k in range(triangles.shape[0]):
        a, b, c = triangles[k, 0], triangles[k, 1], triangles[k, 2]
        if inverse_depth[a] <= 0 or inverse_depth[b] <= 0 or inverse_depth[c] <= 0:
            continue
        ax, ay = pixel[a, 0] - 0.5, pixel[a, 1] - 0.5
        bx, by = pixel[b, 0] - 0.5, pixel[b, 1] - 0.5
        cx, cy = pixel[c, 0] - 0.5, pixel[c, 1] - 0.5
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if area == 0.0:
            continue
        first_column = max(0, int(np.ceil(min(ax, bx, cx))))
        last_column = min(width - 1, int(np.floor(max(ax, bx, cx))))
        first_row = max(0, int(np.ceil(min(ay, by, cy))))
        last_row = min(height - 1, int(np.floor(max(ay, by, cy))))
        for row in range(first_row, last_row + 1):
            for column in range(first_column, last_column + 1):
                wa = ((bx - column) * (cy - row) - (by - row) * (cx - column)) / area
                wb = ((cx - column) * (ay - row) - (cy - row) * (ax - column)) / area
                wc = 1.0 - wa - wb
                # A hair of slack closes the cracks that rounding would leave along shared edges.
                if wa < -1e-9 or wb < -1e-9 or wc < -1e-9:
                    continue
                depth = 1.0 / (wa * inverse_depth[a] + wb * inverse_depth[b] + wc * inverse_depth[c])
                if depth < buffer[row, column]:
                    buffer[row, column] = depth


@numba.njit(cache=True, inline="always")
def _seen(buffer, u, v, depth, slack):  # type: ignore[no-untyped-def]
    """Whether nothing in the four pixels around (u, v) lies in front of ``depth - slack``."""
    height, width = buffer.shape
    column = int(np.floor(u - 0.5))
    row = int(np.floor(v - 0.5))
    if column < 1 or row < 1 or column >= width - 2 or row >= height - 2:
        return False
    nearest = min(
        min(buffer[row, column], buffer[row, column + 1]), min(buffer[row + 1, column], buffer[row + 1, column + 1])
    )
    return depth <= nearest + slack


@numba.njit(cache=True)
def visible_points(
    camera: NDArray[np.float64],
    buffer: NDArray[np.float32],
    points: NDArray[np.float64],
    normals: NDArray[np.float64],
    minimum_cosine: float,
    tolerance: float,
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Cosine of incidence (M,) of every point, 0 where the view does not see it, and its pixel (M, 2)."""
    count = points.shape[0]
    cosine = np.zeros(count, dtype=np.float32)
    pixel = np.zeros((count, 2), dtype=np.float32)
    for m in range(count):
        xc, yc, zc = _to_camera(camera, points[m, 0], points[m, 1], points[m, 2])
        if zc <= 0:
            continue
        nx = camera[0] * normals[m, 0] + camera[1] * normals[m, 1] + camera[2] * normals[m, 2]
        ny = camera[3] * normals[m, 0] + camera[4] * normals[m, 1] + camera[5] * normals[m, 2]
        nz = camera[6] * normals[m, 0] + camera[7] * normals[m, 1] + camera[8] * normals[m, 2]
        incidence = -(nx * xc + ny * yc + nz * zc) / np.sqrt(xc * xc + yc * yc + zc * zc)
        if incidence < minimum_cosine:
            continue
        u, v = _to_pixel(camera, xc, yc, zc)
        slope = np.sqrt(max(0.0, 1.0 - incidence * incidence)) / incidence
        if _seen(buffer, u, v, zc, tolerance + 1.5 * slope * zc / camera[12]):
            cosine[m] = incidence
            pixel[m, 0] = u
            pixel[m, 1] = v
    return cosine, pixel


@numba.njit(cache=True, inline="always")
def _cubic(t):  # type: ignore[no-untyped-def]
    """Four weights of the Catmull-Rom cubic at fraction ``t``."""
    t2 = t * t
    t3 = t2 * t
    return (
        0.5 * (-t + 2.0 * t2 - t3),
        0.5 * (2.0 - 5.0 * t2 + 3.0 * t3),
        0.5 * (t + 4.0 * t2 - 3.0 * t3),
        0.5 * (t3 - t2),
    )


@numba.njit(cache=True)
def blend_photo(
    image: NDArray[np.float32],
    cosine: NDArray[np.float32],
    pixel: NDArray[np.float32],
    power: float,
    colour_sum: NDArray[np.float32],
    weight_sum: NDArray[np.float32],
    seen_count: NDArray[np.int16],
) -> None:
    """Add one photo (H, W, C) to the sums over points (changed in place), weight cosine^power."""
    channels = image.shape[2]
    for m in range(cosine.shape[0]):
        if cosine[m] <= 0:
            continue
        weight = np.float32(cosine[m] ** power)
        x = pixel[m, 0] - np.float32(0.5)
        y = pixel[m, 1] - np.float32(0.5)
        column = int(np.floor(x))
        row = int(np.floor(y))
        x0, x1, x2, x3 = _cubic(x - np.float32(column))
        y0, y1, y2, y3 = _cubic(y - np.float32(row))
        for channel in range(channels):
            value = np.float32(0.0)
            for i in range(4):
                line = row - 1 + i
                yi = y0 if i == 0 else (y1 if i == 1 else (y2 if i == 2 else y3))
                value += yi * (
                    x0 * image[line, column - 1, channel]
                    + x1 * image[line, column, channel]
                    + x2 * image[line, column + 1, channel]
                    + x3 * image[line, column + 2, channel]
                )
            colour_sum[m, channel] += weight * value
        weight_sum[m] += weight
        seen_count[m] += 1


@numba.njit(cache=True)
def sample_offsets(
    camera: NDArray[np.float64],
    image: NDArray[np.float32],
    points: NDArray[np.float64],
    normals: NDArray[np.float64],
    chosen: NDArray[np.int32],
    places: NDArray[np.int32],
    offsets: NDArray[np.float64],
    sampled: NDArray[np.float32],
) -> None:
    """Photo (H, W) at ``points[chosen] + offset * normals[chosen]`` into ``sampled[o, places]`` (in place)."""
    height, width = image.shape
    for j in range(chosen.shape[0]):
        m = chosen[j]
        # The camera is affine in the offset before the division by depth.
        xc, yc, zc = _to_camera(camera, points[m, 0], points[m, 1], points[m, 2])
        nx = camera[0] * normals[m, 0] + camera[1] * normals[m, 1] + camera[2] * normals[m, 2]
        ny = camera[3] * normals[m, 0] + camera[4] * normals[m, 1] + camera[5] * normals[m, 2]
        nz = camera[6] * normals[m, 0] + camera[7] * normals[m, 1] + camera[8] * normals[m, 2]
        for o in range(offsets.shape[0]):
            d = offsets[o]
            u, v = _to_pixel(camera, xc + d * nx, yc + d * ny, zc + d * nz)
            x = np.float32(min(max(u - 0.5, 1.0), width - 3.001))
            y = np.float32(min(max(v - 0.5, 1.0), height - 3.001))
            column = int(np.floor(x))
            row = int(np.floor(y))
            x0, x1, x2, x3 = _cubic(x - np.float32(column))
            y0, y1, y2, y3 = _cubic(y - np.float32(row))
            value = np.float32(0.0)
            for i in range(4):
                line = row - 1 + i
                yi = y0 if i == 0 else (y1 if i == 1 else (y2 if i == 2 else y3))
                value += yi * (
                    x0 * image[line, column - 1]
                    + x1 * image[line, column]
                    + x2 * image[line, column + 1]
                    + x3 * image[line, column + 2]
                )
            sampled[o, places[j]] = value


@numba.njit(cache=True)
def add_high_pass(
    picture: NDArray[np.float32], mean: NDArray[np.float32], weights: NDArray[np.float32], sums: NDArray[np.float32]
) -> None:
    """With h = picture - mean and votes w, add w h, w^2 h^2, w h^2 to ``sums`` (3, H, W), in place."""
    for row in range(picture.shape[0]):
        for column in range(picture.shape[1]):
            w = weights[row, column]
            if w > 0:
                weighted = w * (picture[row, column] - mean[row, column])
                sums[0, row, column] += weighted
                sums[1, row, column] += weighted * weighted
                sums[2, row, column] += weighted * weighted / w
