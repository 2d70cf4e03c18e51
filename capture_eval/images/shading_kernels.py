"""Compiled inner loops of the photographer (imported only where used, because compiling takes seconds)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

Array = Any


@njit(cache=True, nogil=True, fastmath=False)
def _texture_value(
    texels: Array, offset: int, width: int, height: int, u: float, v: float, linear: Array, out: Array
) -> None:
    """Bilinear lookup in linear light; u to the right, v up, texel centres at half integers, clamped at the border."""
    x = u * width - 0.5
    y = (1.0 - v) * height - 0.5
    x = min(max(x, 0.0), width - 1.0)
    y = min(max(y, 0.0), height - 1.0)
    x0 = min(int(x), width - 2) if width > 1 else 0
    y0 = min(int(y), height - 2) if height > 1 else 0
    fx, fy = x - x0, y - y0
    right = 1 if width > 1 else 0
    below = width if height > 1 else 0
    base = offset + y0 * width + x0
    for channel in range(3):
        upper = linear[texels[base, channel]] * (1.0 - fx) + linear[texels[base + right, channel]] * fx
        lower = linear[texels[base + below, channel]] * (1.0 - fx) + linear[texels[base + below + right, channel]] * fx
        out[channel] = upper * (1.0 - fy) + lower * fy


@njit(cache=True, nogil=True, fastmath=False)
def shade_samples(
    hit: Array,
    directions: Array,
    center: Array,
    vertices: Array,
    triangles: Array,
    normals: Array,
    irradiance: Array,
    light_visibility: Array,
    lights: Array,
    light_power: Array,
    triangle_texture: Array,
    triangle_uv: Array,
    colors: Array,
    gloss: Array,
    shininess: Array,
    level_table: Array,
    texels: Array,
    linear: Array,
    sample_spacing: float,
    backdrop: Array,
    image: Array,
) -> None:
    """Mean light of the samples of every pixel, written into image (pixels, 3).

    For each sample the ray meets the plane of its triangle (double precision); barycentric coordinates there give
    texture place, irradiance and normal. The mip level is the one whose texels are as large as the sample's footprint.
    """
    pixels, samples = hit.shape
    albedo = np.zeros(3)
    point = np.zeros(3)
    normal = np.zeros(3)
    for pixel in range(pixels):
        total0 = total1 = total2 = 0.0
        for sample in range(samples):
            triangle = hit[pixel, sample]
            if triangle < 0:
                total0 += backdrop[0]
                total1 += backdrop[1]
                total2 += backdrop[2]
                continue
            a, b, c = triangles[triangle, 0], triangles[triangle, 1], triangles[triangle, 2]
            dx, dy, dz = directions[pixel, sample, 0], directions[pixel, sample, 1], directions[pixel, sample, 2]
            e1x, e1y, e1z = (
                vertices[b, 0] - vertices[a, 0], vertices[b, 1] - vertices[a, 1], vertices[b, 2] - vertices[a, 2],
            )
            e2x, e2y, e2z = (
                vertices[c, 0] - vertices[a, 0], vertices[c, 1] - vertices[a, 1], vertices[c, 2] - vertices[a, 2],
            )
            nx, ny, nz = e1y * e2z - e1z * e2y, e1z * e2x - e1x * e2z, e1x * e2y - e1y * e2x
            square = nx * nx + ny * ny + nz * nz
            ax, ay, az = vertices[a, 0] - center[0], vertices[a, 1] - center[1], vertices[a, 2] - center[2]
            slope = nx * dx + ny * dy + nz * dz
            if square == 0.0 or slope == 0.0:
                continue
            depth = (nx * ax + ny * ay + nz * az) / slope
            px, py, pz = depth * dx - ax, depth * dy - ay, depth * dz - az
            wb = (nx * (py * e2z - pz * e2y) + ny * (pz * e2x - px * e2z) + nz * (px * e2y - py * e2x)) / square
            wc = (nx * (e1y * pz - e1z * py) + ny * (e1z * px - e1x * pz) + nz * (e1x * py - e1y * px)) / square
            # A sample beside its triangle (its pixel's centre triangle goes on) may not run away at thin slivers.
            wb = min(max(wb, -1.0), 2.0)
            wc = min(max(wc, -1.0), 2.0)
            wa = 1.0 - wb - wc
            point[0], point[1], point[2] = depth * dx + center[0], depth * dy + center[1], depth * dz + center[2]
            texture = triangle_texture[triangle]
            if texture >= 0:
                u = wa * triangle_uv[triangle, 0, 0] + wb * triangle_uv[triangle, 1, 0] + wc * triangle_uv[triangle, 2, 0]
                v = wa * triangle_uv[triangle, 0, 1] + wb * triangle_uv[triangle, 1, 1] + wc * triangle_uv[triangle, 2, 1]
                du1 = triangle_uv[triangle, 1, 0] - triangle_uv[triangle, 0, 0]
                dv1 = triangle_uv[triangle, 1, 1] - triangle_uv[triangle, 0, 1]
                du2 = triangle_uv[triangle, 2, 0] - triangle_uv[triangle, 0, 0]
                dv2 = triangle_uv[triangle, 2, 1] - triangle_uv[triangle, 0, 1]
                area_uv = abs(du1 * dv2 - du2 * dv1)
                cosine = abs(slope) / np.sqrt(square * (dx * dx + dy * dy + dz * dz))
                footprint = depth * sample_spacing
                # Texels of level 0 that one sample covers (area), foreshortening counted half way so that grazing
                # surfaces are neither blurred across nor aliased along the tilt.
                covered = area_uv * level_table[texture, 0, 1] * level_table[texture, 0, 2] / np.sqrt(square)
                covered *= footprint * footprint / max(cosine, 0.15)
                level = int(np.floor(0.5 * np.log2(max(covered, 1.0)) + 0.35))
                last = level_table.shape[1] - 1
                while level > last or (level > 0 and level_table[texture, level, 1] == 0):
                    level -= 1
                _texture_value(
                    texels, level_table[texture, level, 0], level_table[texture, level, 1],
                    level_table[texture, level, 2], u, v, linear, albedo,
                )
            else:
                for channel in range(3):
                    albedo[channel] = wa * colors[a, channel] + wb * colors[b, channel] + wc * colors[c, channel]
            length = 0.0
            for axis in range(3):
                normal[axis] = wa * normals[a, axis] + wb * normals[b, axis] + wc * normals[c, axis]
                length += normal[axis] * normal[axis]
            length = np.sqrt(max(length, 1e-30))
            vx, vy, vz = -dx, -dy, -dz
            vl = np.sqrt(vx * vx + vy * vy + vz * vz)
            vx, vy, vz = vx / vl, vy / vl, vz / vl
            shine = 0.0
            for light in range(lights.shape[0]):
                seen = (
                    wa * light_visibility[a, light] + wb * light_visibility[b, light] + wc * light_visibility[c, light]
                )
                if seen <= 0.0:
                    continue
                lx, ly, lz = lights[light, 0] - point[0], lights[light, 1] - point[1], lights[light, 2] - point[2]
                ll = np.sqrt(lx * lx + ly * ly + lz * lz)
                hx, hy, hz = lx / ll + vx, ly / ll + vy, lz / ll + vz
                hl = np.sqrt(hx * hx + hy * hy + hz * hz)
                facing = (normal[0] * hx + normal[1] * hy + normal[2] * hz) / (length * max(hl, 1e-12))
                if facing > 0.0:
                    shine += light_power[light] * min(seen, 1.0) * facing ** shininess[triangle]
            shine *= gloss[triangle]
            light_here = max(wa * irradiance[a] + wb * irradiance[b] + wc * irradiance[c], 0.0)
            total0 += albedo[0] * light_here + shine
            total1 += albedo[1] * light_here + shine
            total2 += albedo[2] * light_here + shine
        image[pixel, 0] = total0 / samples
        image[pixel, 1] = total1 / samples
        image[pixel, 2] = total2 / samples
