"""Compiled inner loops of the photographer (imported only where used, because compiling takes seconds)."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit

Array = Any


class Surface(NamedTuple):
    """Triangles with what lies on them: see `skin_shading.HeadModel` and `LitHead` for the meaning."""

    vertices: Array
    triangles: Array
    normals: Array
    irradiance: Array
    light_visibility: Array
    triangle_texture: Array
    triangle_uv: Array
    colors: Array
    gloss: Array
    shininess: Array


class Textures(NamedTuple):
    """Texels of all textures and levels; table (textures, levels, 3): first texel, width, height."""

    table: Array
    texels: Array
    linear: Array


class Lamps(NamedTuple):
    """Positions (L, 3) and powers (L,) of the soft boxes."""

    positions: Array
    powers: Array


@njit(cache=True, nogil=True, inline="always")
def _meet(surface: Surface, triangle: int, center: Array, direction: Array) -> tuple[float, float, float, float, float]:
    """Where a ray meets the plane of a triangle: depth, weights of corners b and c, |normal|^2, normal . direction."""
    a = surface.vertices[surface.triangles[triangle, 0]]
    b = surface.vertices[surface.triangles[triangle, 1]]
    c = surface.vertices[surface.triangles[triangle, 2]]
    bx, by, bz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    cx, cy, cz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    nx, ny, nz = by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx
    square = nx * nx + ny * ny + nz * nz
    slope = nx * direction[0] + ny * direction[1] + nz * direction[2]
    if square == 0.0 or slope == 0.0:
        return 0.0, 0.0, 0.0, 0.0, 0.0
    ax, ay, az = a[0] - center[0], a[1] - center[1], a[2] - center[2]
    depth = (nx * ax + ny * ay + nz * az) / slope
    px, py, pz = depth * direction[0] - ax, depth * direction[1] - ay, depth * direction[2] - az
    wb = (nx * (py * cz - pz * cy) + ny * (pz * cx - px * cz) + nz * (px * cy - py * cx)) / square
    wc = (nx * (by * pz - bz * py) + ny * (bz * px - bx * pz) + nz * (bx * py - by * px)) / square
    # A sample beside its triangle (its pixel's centre triangle goes on) may not run away at thin slivers.
    return depth, min(max(wb, -1.0), 2.0), min(max(wc, -1.0), 2.0), square, slope


@njit(cache=True, nogil=True, inline="always")
def _mip_level(table: Array, texture: int, uv: Array, square: float, footprint: float, cosine: float) -> int:
    """Level whose texels are about as large as a sample's footprint on the surface.

    Foreshortening counts half way (the geometric mean of the footprint's sides), so that grazing surfaces are neither
    blurred across nor aliased along the tilt.
    """
    area = abs((uv[1, 0] - uv[0, 0]) * (uv[2, 1] - uv[0, 1]) - (uv[2, 0] - uv[0, 0]) * (uv[1, 1] - uv[0, 1]))
    texels = area * table[texture, 0, 1] * table[texture, 0, 2] / np.sqrt(square)
    covered = texels * footprint * footprint / max(cosine, 0.15)
    level = min(int(np.floor(0.5 * np.log2(max(covered, 1.0)) + 0.35)), table.shape[1] - 1)
    while level > 0 and table[texture, level, 1] == 0:
        level -= 1
    return int(level)


@njit(cache=True, nogil=True)
def _texture_value(textures: Textures, texture: int, level: int, u: float, v: float, out: Array) -> None:
    """Bilinear lookup in linear light; u to the right, v up, texel centres at half integers, clamped at the border."""
    offset, width, height = textures.table[texture, level]
    x = min(max(u * width - 0.5, 0.0), width - 1.0)
    y = min(max((1.0 - v) * height - 0.5, 0.0), height - 1.0)
    x0 = max(min(int(x), width - 2), 0)
    y0 = max(min(int(y), height - 2), 0)
    fx, fy = x - x0, y - y0
    right = 1 if width > 1 else 0
    below = width if height > 1 else 0
    base = offset + y0 * width + x0
    for channel in range(3):
        first = textures.linear[textures.texels[base, channel]]
        second = textures.linear[textures.texels[base + right, channel]]
        third = textures.linear[textures.texels[base + below, channel]]
        fourth = textures.linear[textures.texels[base + below + right, channel]]
        upper = first * (1.0 - fx) + second * fx
        out[channel] = upper * (1.0 - fy) + (third * (1.0 - fx) + fourth * fx) * fy


@njit(cache=True, nogil=True)
def _highlight(surface: Surface, lamps: Lamps, triangle: int, weights: Array, point: Array, direction: Array) -> float:
    """Blinn's highlight of all lamps (Blinn 1977), each times the share of it that is seen from here."""
    corners = surface.triangles[triangle]
    nx = ny = nz = 0.0
    for k in range(3):
        nx += weights[k] * surface.normals[corners[k], 0]
        ny += weights[k] * surface.normals[corners[k], 1]
        nz += weights[k] * surface.normals[corners[k], 2]
    length = np.sqrt(max(nx * nx + ny * ny + nz * nz, 1e-30))
    far = np.sqrt(direction[0] ** 2 + direction[1] ** 2 + direction[2] ** 2)
    shine = 0.0
    for lamp in range(lamps.positions.shape[0]):
        seen = 0.0
        for k in range(3):
            seen += weights[k] * surface.light_visibility[corners[k], lamp]
        if seen <= 0.0:
            continue
        lx = lamps.positions[lamp, 0] - point[0]
        ly = lamps.positions[lamp, 1] - point[1]
        lz = lamps.positions[lamp, 2] - point[2]
        away = np.sqrt(lx * lx + ly * ly + lz * lz)
        hx, hy, hz = lx / away - direction[0] / far, ly / away - direction[1] / far, lz / away - direction[2] / far
        facing = (nx * hx + ny * hy + nz * hz) / (length * max(np.sqrt(hx * hx + hy * hy + hz * hz), 1e-12))
        if facing > 0.0:
            shine += lamps.powers[lamp] * min(seen, 1.0) * facing ** surface.shininess[triangle]
    return float(shine * surface.gloss[triangle])


@njit(cache=True, nogil=True)
def _sample_light(
    surface: Surface,
    textures: Textures,
    lamps: Lamps,
    triangle: int,
    center: Array,
    direction: Array,
    spacing: float,
    work: Array,
) -> None:
    """Light (3,) that one ray brings, left in work[0]; work[1] and work[2] are scratch.

    work[3] keeps triangle, mip level and highlight between the samples of a pixel: on one triangle they hardly change.
    """
    depth, wb, wc, square, slope = _meet(surface, triangle, center, direction)
    light, weights, point, kept = work[0], work[1], work[2], work[3]
    light[:] = 0.0
    if square == 0.0:
        return
    weights[0], weights[1], weights[2] = 1.0 - wb - wc, wb, wc
    corners = surface.triangles[triangle]
    texture = surface.triangle_texture[triangle]
    if kept[0] != triangle:
        kept[0] = triangle
        for axis in range(3):
            point[axis] = center[axis] + depth * direction[axis]
        kept[2] = _highlight(surface, lamps, triangle, weights, point, direction)
        if texture >= 0:
            far = np.sqrt(direction[0] ** 2 + direction[1] ** 2 + direction[2] ** 2)
            cosine = abs(slope) / (np.sqrt(square) * far)
            kept[1] = _mip_level(
                textures.table, texture, surface.triangle_uv[triangle], square, depth * spacing, cosine
            )
    if texture >= 0:
        uv = surface.triangle_uv[triangle]
        u = weights[0] * uv[0, 0] + wb * uv[1, 0] + wc * uv[2, 0]
        v = weights[0] * uv[0, 1] + wb * uv[1, 1] + wc * uv[2, 1]
        _texture_value(textures, texture, int(kept[1]), u, v, light)
    else:
        for k in range(3):
            for channel in range(3):
                light[channel] += weights[k] * surface.colors[corners[k], channel]
    received = 0.0
    for k in range(3):
        received += weights[k] * surface.irradiance[corners[k]]
    received = max(received, 0.0)
    for channel in range(3):
        light[channel] = light[channel] * received + kept[2]


@njit(cache=True, nogil=True)
def shade_pixels(
    surface: Surface,
    textures: Textures,
    lamps: Lamps,
    hit: Array,
    directions: Array,
    center: Array,
    spacing: float,
    backdrop: Array,
    image: Array,
) -> None:
    """Mean light of the samples of every pixel, written into image (pixels, 3).

    Parameters
    ----------
    hit, directions
        (pixels, samples) triangle, -1 for the backdrop, and (pixels, samples, 3) ray directions of depth 1.
    center
        (3,) camera centre.
    spacing
        Distance between samples at depth 1.
    backdrop
        (3,) linear light.
    """
    pixels, samples = hit.shape
    work = np.zeros((4, 3))
    total = np.zeros(3)
    for pixel in range(pixels):
        total[:] = 0.0
        work[3, 0] = -1.0
        for sample in range(samples):
            if hit[pixel, sample] < 0:
                total += backdrop
                continue
            _sample_light(
                surface, textures, lamps, hit[pixel, sample], center, directions[pixel, sample], spacing, work
            )
            total += work[0]
        for channel in range(3):
            image[pixel, channel] = total[channel] / samples
