"""Seeded noise in space: gradient noise and round spots, evaluated at points. Compiled; import inside functions.

Source: K. Perlin, "Improving noise", 2002 (gradient noise with a quintic blend); S. Worley, "A cellular texture basis
function", 1996 (spots around one random point a cell).
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

FloatArray = NDArray[np.float32]


@njit(cache=True, inline="always")
def _hash(i: int, j: int, k: int, seed: int) -> np.uint32:  # pragma: no cover - compiled
    value = np.uint32(i) * np.uint32(0x8DA6B343) + np.uint32(j) * np.uint32(0xD8163841)
    value += np.uint32(k) * np.uint32(0xCB1AB31F) + np.uint32(seed) * np.uint32(0x9E3779B1)
    value ^= value >> np.uint32(16)
    value *= np.uint32(0x7FEB352D)
    value ^= value >> np.uint32(15)
    value *= np.uint32(0x846CA68B)
    value ^= value >> np.uint32(16)
    return np.uint32(value)


@njit(cache=True, inline="always")
def _slope(code: np.uint32, x: float, y: float, z: float) -> float:  # pragma: no cover - compiled
    case = code & np.uint32(15)
    u = x if case < 8 else y
    v = y if case < 4 else (x if case == 12 or case == 14 else z)
    return (u if (case & np.uint32(1)) == 0 else -u) + (v if (case & np.uint32(2)) == 0 else -v)


@njit(cache=True)
def _gradient_noise(points: FloatArray, scale: FloatArray, seed: int, out: FloatArray) -> None:  # pragma: no cover
    for n in range(points.shape[0]):
        x, y, z = points[n, 0] * scale[0], points[n, 1] * scale[1], points[n, 2] * scale[2]
        fx, fy, fz = np.floor(x), np.floor(y), np.floor(z)
        i, j, k = np.int64(fx), np.int64(fy), np.int64(fz)
        x, y, z = x - fx, y - fy, z - fz
        u = x * x * x * (x * (x * 6 - 15) + 10)
        v = y * y * y * (y * (y * 6 - 15) + 10)
        w = z * z * z * (z * (z * 6 - 15) + 10)
        total = 0.0
        for a in range(2):
            wa = u if a else 1 - u
            for b in range(2):
                wb = v if b else 1 - v
                for c in range(2):
                    wc = w if c else 1 - w
                    total += wa * wb * wc * _slope(_hash(i + a, j + b, k + c, seed), x - a, y - b, z - c)
        out[n] = total


@njit(cache=True)
def _spots(
    points: FloatArray, cell: float, share: float, small: float, large: float, seed: int, out: FloatArray
) -> None:  # pragma: no cover - compiled
    for n in range(points.shape[0]):
        x, y, z = points[n, 0] / cell, points[n, 1] / cell, points[n, 2] / cell
        i, j, k = np.int64(np.floor(x)), np.int64(np.floor(y)), np.int64(np.floor(z))
        best = 0.0
        for a in range(-1, 2):
            for b in range(-1, 2):
                for c in range(-1, 2):
                    code = _hash(i + a, j + b, k + c, seed)
                    if (code & np.uint32(1023)) >= share * 1024:
                        continue
                    px = i + a + 0.2 + 0.6 * ((code >> np.uint32(10)) & np.uint32(127)) / 127.0
                    py = j + b + 0.2 + 0.6 * ((code >> np.uint32(17)) & np.uint32(127)) / 127.0
                    pz = k + c + 0.2 + 0.6 * ((code >> np.uint32(24)) & np.uint32(127)) / 127.0
                    radius = small + (large - small) * ((code >> np.uint32(4)) & np.uint32(63)) / 63.0
                    d2 = ((x - px) ** 2 + (y - py) ** 2 + (z - pz) ** 2) * cell * cell / (radius * radius)
                    if d2 < 1.0:
                        height = (1.0 - d2) * (1.0 - d2)
                        if height > best:
                            best = height
        out[n] = best


def gradient_noise(
    points: NDArray[np.floating], wavelength: float | tuple[float, float, float], seed: int
) -> FloatArray:
    """Gradient noise (N,) float32 of mean 0, standard deviation about 0.27 and range within -1..1.

    Parameters
    ----------
    points
        (N, 3) positions.
    wavelength
        Size of a lattice cell in the unit of the points; three numbers stretch the grain along the axes.
    seed
        Other seeds give independent noise.
    """
    sizes = np.broadcast_to(np.asarray(wavelength, dtype=np.float32), (3,))
    out = np.empty(len(points), dtype=np.float32)
    _gradient_noise(np.ascontiguousarray(points, dtype=np.float32), (1.0 / sizes).astype(np.float32), seed, out)
    return out


def spots(points: NDArray[np.floating], cell: float, share: float, radii: tuple[float, float], seed: int) -> FloatArray:
    """Round spots (N,) float32 in 0..1: 1 at a spot's centre, 0 outside.

    Parameters
    ----------
    points
        (N, 3) positions.
    cell
        Edge of the cubes that hold at most one spot each.
    share
        Share of the cubes that hold one.
    radii
        Smallest and largest radius, at most the cell.
    seed
        Other seeds give independent spots.
    """
    out = np.empty(len(points), dtype=np.float32)
    _spots(np.ascontiguousarray(points, dtype=np.float32), cell, share, radii[0], radii[1], seed, out)
    return out
