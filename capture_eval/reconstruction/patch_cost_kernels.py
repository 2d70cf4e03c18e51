"""Compiled likeness of a patch of one photo and its image in another, through a plane of inverse depth.

A hypothesis is a plane of inverse depth around a pixel (u, v) of the reference photo,
``1/z(u + dx, v + dy) = c + a dx + b dy``; the pixel it sees in a source photo is then
``M (u + dx, v + dy, 1) + m (c + a dx + b dy)`` up to scale, so neither trigonometry nor a matrix inverse is needed.
Source photos are packed: one uint32 holds the four grey values of a bilinear cell, so a sample costs one gather.

The loops over the samples have a constant length, no branches and unsigned 32-bit indices below 2^31, and the
functions are compiled with ``error_model="numpy"``: without all of these LLVM leaves them scalar or gathers by 64-bit
addresses.  They are compiled without the run-time's reference counts (`_nrt`), whose atomic additions cost as much as
the sampling itself; so no kernel allocates, and `scratch` comes from the caller, one a thread.

A change here does not renew the cached machine code of the modules that call these functions: delete
``__pycache__`` after editing.
"""

# mypy: disable-error-code="no-untyped-def,no-untyped-call,misc,untyped-decorator"

from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

SAMPLES = 32
MAX_VIEWS = 64

_ONE = np.float32(1.0)
_HALF = np.float32(0.5)
_ZERO = np.float32(0.0)
_TINY = np.float32(1e-12)
WORST = np.float32(1.0)
_MAX_STRETCH = np.float32(4.0)
_POSITIVE = np.uint32(0x7FFFFFFF)

# Without the run-time's reference counts: their atomic additions cost as much as the sampling itself.
# So no kernel allocates; `scratch` (5, MAX_VIEWS) float32 comes from the caller, one a thread.
rows_kernel = numba.njit(cache=True, nogil=True, _nrt=False, fastmath=True, error_model="numpy")
inlined = numba.njit(cache=True, nogil=True, _nrt=False, fastmath=True, error_model="numpy", forceinline=True)


class Sources(NamedTuple):
    """Packed source photos of one pyramid level and their maps from the reference.

    `maps` (n, 12): the nine entries of M, then the three of m.
    """

    texels: NDArray[np.uint32]
    offset: NDArray[np.uint32]
    width: NDArray[np.int32]
    height: NDArray[np.int32]
    maps: NDArray[np.float32]


class Reference(NamedTuple):
    """Reference photo of one level; `padded` has `pad` replicated pixels on every side."""

    padded: NDArray[np.float32]
    stride: int
    pad: int
    centre: NDArray[np.float32]
    active: NDArray[np.uint8]


class Pattern(NamedTuple):
    """Where a patch is sampled: pixel offsets, spatial weights, steps in `padded`."""

    dx: NDArray[np.float32]
    dy: NDArray[np.float32]
    spatial: NDArray[np.float32]
    shift: NDArray[np.int32]
    radius: np.float32
    colour_scale: np.float32
    noise: np.float32


@inlined
def load_patch(reference, pattern, u, v, values, weights):
    """Fill `weights` (bilateral, sum one) and `values` (weights times standardised greys).

    Returns the weighted mean of the patch.
    """
    base = (v + reference.pad) * reference.stride + u + reference.pad
    centre = reference.centre[v, u]
    total = _ZERO
    first = _ZERO
    second = _ZERO
    for s in range(SAMPLES):
        value = reference.padded[np.uint32(base + pattern.shift[s])] - centre
        fall = _ONE / (_ONE + value * value * pattern.colour_scale)
        weight = pattern.spatial[s] * fall * fall
        values[s] = value
        weights[s] = weight
        total += weight
        first += weight * value
        second += weight * value * value
    scale = _ONE / total
    mean = first * scale
    variance = max(second * scale - mean * mean, _TINY)
    deviation = _ONE / np.sqrt(variance + pattern.noise)
    for s in range(SAMPLES):
        weight = weights[s] * scale
        weights[s] = weight
        values[s] = (values[s] - mean) * weight * deviation
    return mean + centre


@inlined
def view_cost(sources, view, u, v, a, b, c, pattern, values, weights, mean):
    """One minus the weighted NCC of the patch in one source; the worst cost where it leaves the photo."""
    m = sources.maps[view]
    base_w = m[6] * u + m[7] * v + m[8] + m[11] * c
    if base_w <= _TINY:
        return WORST
    scale = _ONE / base_w
    x0 = (m[0] * u + m[1] * v + m[2] + m[9] * c) * scale
    y0 = (m[3] * u + m[4] * v + m[5] + m[10] * c) * scale
    wx = (m[6] + m[11] * a) * scale
    wy = (m[7] + m[11] * b) * scale
    xx = (m[0] + m[9] * a) * scale - x0 * wx
    xy = (m[1] + m[9] * b) * scale - x0 * wy
    yx = (m[3] + m[10] * a) * scale - y0 * wx
    yy = (m[4] + m[10] * b) * scale - y0 * wy
    reach_x = (abs(xx) + abs(xy)) * pattern.radius * np.float32(1.05)
    reach_y = (abs(yx) + abs(yy)) * pattern.radius * np.float32(1.05)
    width = sources.width[view]
    height = sources.height[view]
    inside = (
        (x0 - reach_x >= _ZERO)
        & (y0 - reach_y >= _ZERO)
        & (x0 + reach_x < np.float32(width - 1))
        & (y0 + reach_y < np.float32(height - 1))
        & (reach_x + reach_y < _MAX_STRETCH * np.float32(2.0) * pattern.radius)
    )
    if not inside:
        return WORST
    offset = sources.offset[view]
    stride = np.uint32(width)
    first = _ZERO
    second = _ZERO
    product = _ZERO
    for s in range(SAMPLES):
        dx = pattern.dx[s]
        dy = pattern.dy[s]
        shrink = _ONE - (wx * dx + wy * dy)
        x = x0 + (xx * dx + xy * dy) * shrink
        y = y0 + (yx * dx + yy * dy) * shrink
        column = np.int32(x)
        row = np.int32(y)
        fx = x - np.float32(column)
        fy = y - np.float32(row)
        place = np.uint32(np.uint32(offset + np.uint32(np.uint32(row) * stride) + np.uint32(column)) & _POSITIVE)
        texel = sources.texels[place]
        p00 = np.float32(np.uint8(texel))
        p10 = np.float32(np.uint8(texel >> np.uint32(8)))
        p01 = np.float32(np.uint8(texel >> np.uint32(16)))
        p11 = np.float32(np.uint8(texel >> np.uint32(24)))
        top = p00 + fx * (p10 - p00)
        low = p01 + fx * (p11 - p01)
        value = top + fy * (low - top) - mean
        weighted = weights[s] * value
        first += weighted
        second += weighted * value
        product += values[s] * value
    variance = max(second - first * first, _ZERO) + pattern.noise
    return min(max(_ONE - product / np.sqrt(variance), _ZERO), WORST)
