"""Compiled kernels of slanted-plane PatchMatch: one call works a range of image rows.

A hypothesis is a plane of inverse depth around a pixel (u, v) of the reference photo,
``1/z(u + dx, v + dy) = c + a dx + b dy``; the pixel it sees in a source photo is then
``M (u + dx, v + dy, 1) + m (c + a dx + b dy)`` up to scale, so neither trigonometry nor a
matrix inverse is needed.  Source photos are packed: one uint32 holds the four grey values
of a bilinear cell, so a sample costs one gather.

The loops over the samples have a constant length, no branches and unsigned 32-bit
indices, and the functions are compiled with ``error_model="numpy"``: without all of these
LLVM leaves them scalar.  Rows share no state within a pass (red-black order, counter-based
random numbers), so the result does not depend on how rows are divided among threads.

References: Bleyer, Rhemann, Rother, "PatchMatch Stereo" (2011); Schoenberger et al.,
"Pixelwise View Selection for Unstructured Multi-View Stereo" (2016).
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
_WORST = np.float32(1.0)
_MAX_STRETCH = np.float32(4.0)
_POSITIVE = np.uint32(0x7FFFFFFF)

# Without the run-time's reference counts: their atomic additions cost as much as the sampling itself.
# So no kernel allocates; `scratch` (5, MAX_VIEWS) float32 comes from the caller, one a thread.
_jit = numba.njit(cache=True, nogil=True, _nrt=False, fastmath=True, error_model="numpy")
_inline = numba.njit(cache=True, nogil=True, _nrt=False, fastmath=True, error_model="numpy", forceinline=True)


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
    """Where a patch is sampled: pixel offsets, spatial weights, index offsets in `padded`."""

    dx: NDArray[np.float32]
    dy: NDArray[np.float32]
    spatial: NDArray[np.float32]
    index: NDArray[np.int32]
    radius: np.float32
    colour_scale: np.float32
    noise: np.float32


@_inline
def _hash(value):
    """Avalanche of a 32-bit counter (the finaliser of MurmurHash3)."""
    value = np.uint32(value)
    value = np.uint32(value ^ (value >> np.uint32(16)))
    value = np.uint32(value * np.uint32(0x85EBCA6B))
    value = np.uint32(value ^ (value >> np.uint32(13)))
    value = np.uint32(value * np.uint32(0xC2B2AE35))
    return np.uint32(value ^ (value >> np.uint32(16)))


@_inline
def _uniform(key, index):
    """Number in [0, 1) that depends on nothing but `key` and `index`."""
    bits = _hash(np.uint32(np.uint32(key) + np.uint32(np.uint32(index) * np.uint32(0x9E3779B9))))
    return np.float32(np.uint32(bits >> np.uint32(8))) * np.float32(1.0 / 16777216.0)


@_inline
def _load_patch(reference, pattern, u, v, values, weights):
    """Fill `weights` (bilateral, sum one) and `values` (weights times standardised greys).

    Returns the patch's weighted mean and variance.
    """
    base = (v + reference.pad) * reference.stride + u + reference.pad
    centre = reference.centre[v, u]
    total = _ZERO
    first = _ZERO
    second = _ZERO
    for s in range(SAMPLES):
        value = reference.padded[np.uint32(base + pattern.index[s])] - centre
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
    return mean + centre, variance


@_inline
def _view_cost(sources, view, u, v, a, b, c, pattern, values, weights, mean):
    """One minus the weighted NCC of the patch in one source; the worst cost where it leaves the photo."""
    m = sources.maps[view]
    base_w = m[6] * u + m[7] * v + m[8] + m[11] * c
    if base_w <= _TINY:
        return _WORST
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
        return _WORST
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
    return min(max(_ONE - product / np.sqrt(variance), _ZERO), _WORST)


@_inline
def _insert(best, length, value):
    """Keep the `length` smallest values sorted."""
    if value >= best[length - 1]:
        return
    place = length - 1
    while place > 0 and best[place - 1] > value:
        best[place] = best[place - 1]
        place -= 1
    best[place] = value


@_inline
def _random_plane(key, nearest, farthest, focal):
    """Plane drawn from the depth range (uniform in inverse depth) and all visible tilts."""
    c = farthest + (nearest - farthest) * _uniform(key, 0)
    slope = np.tan(np.float32(1.25) * _uniform(key, 1)) * c / focal
    turn = np.float32(2.0 * np.pi) * _uniform(key, 2)
    return slope * np.cos(turn), slope * np.sin(turn), c


@_jit
def propagate_rows(
    rows, scratch, colour, key0, reference, pattern, sources, planes, costs, chosen, use_all, best_of,
    neighbours, search, limits,
):
    """One red-black half pass: planes of neighbours, random changes and fresh planes are tried.

    rows (2,) first and past-last; planes (H, W, 3) a, b, c; costs (H, W) mean of the chosen views;
    chosen (H, W, k) view numbers; neighbours (N, 2) dx, dy of odd Manhattan length;
    search: (inverse depth amplitude, tilt amplitude (slope), number of changes, number of fresh planes,
    inverse depth of one pixel's disparity times the skip threshold);
    limits: (nearest inverse depth, farthest inverse depth, focal length, largest slope).
    """
    height, width = reference.active.shape
    views = sources.width.shape[0]
    kept = chosen.shape[2]
    values, weights, best = scratch[0], scratch[1], scratch[2]
    amplitude, tilt, changes, fresh, skip = search
    nearest, farthest, focal, max_slope = limits
    count = neighbours.shape[0]
    total = count + int(changes) + int(fresh)
    for v in range(rows[0], rows[1]):
        for u in range((v + colour) & 1, width, 2):
            if reference.active[v, u] == 0:
                continue
            mean, variance = _load_patch(reference, pattern, u, v, values, weights)
            a = planes[v, u, 0]
            b = planes[v, u, 1]
            c = planes[v, u, 2]
            cost = costs[v, u]
            key = _hash(np.uint32(np.uint32(v * width + u) ^ np.uint32(key0)))
            for trial in range(total):
                if trial < count:
                    un = u + neighbours[trial, 0]
                    vn = v + neighbours[trial, 1]
                    if un < 0 or vn < 0 or un >= width or vn >= height:
                        continue
                    if reference.active[vn, un] == 0:
                        continue
                    ta = planes[vn, un, 0]
                    tb = planes[vn, un, 1]
                    tc = planes[vn, un, 2] + ta * np.float32(u - un) + tb * np.float32(v - vn)
                    moved = abs(tc - c) + (abs(ta - a) + abs(tb - b)) * pattern.radius
                    if moved < skip:
                        continue
                elif trial < count + int(changes):
                    number = np.uint32(16 + 4 * trial)
                    kind = (trial - count) % 3
                    damp = np.float32(1.0 / (1 + (trial - count) // 3 * 3))
                    ta = a
                    tb = b
                    tc = c
                    if kind != 1:
                        tc = c + amplitude * damp * (np.float32(2.0) * _uniform(key, number) - _ONE)
                    if kind != 0:
                        size = tilt * damp * c / focal
                        ta = a + size * (np.float32(2.0) * _uniform(key, number + np.uint32(1)) - _ONE)
                        tb = b + size * (np.float32(2.0) * _uniform(key, number + np.uint32(2)) - _ONE)
                else:
                    ta, tb, tc = _random_plane(_hash(np.uint32(key + np.uint32(trial))), nearest, farthest, focal)
                if tc > nearest or tc < farthest:
                    continue
                slope = focal / tc
                if (ta * ta + tb * tb) * slope * slope > max_slope * max_slope:
                    continue
                if use_all:
                    for k in range(best_of):
                        best[k] = _WORST
                    for view in range(views):
                        _insert(best, best_of, _view_cost(
                            sources, view, np.float32(u), np.float32(v), ta, tb, tc, pattern, values, weights,
                            mean - _ZERO))
                    trial_cost = _ZERO
                    for k in range(best_of):
                        trial_cost += best[k]
                    trial_cost /= np.float32(best_of)
                else:
                    trial_cost = _ZERO
                    bar = cost * np.float32(kept)
                    for k in range(kept):
                        trial_cost += _view_cost(
                            sources, chosen[v, u, k], np.float32(u), np.float32(v), ta, tb, tc, pattern, values,
                            weights, mean)
                        if trial_cost >= bar:
                            break
                    trial_cost /= np.float32(kept)
                if trial_cost < cost:
                    cost = trial_cost
                    a = ta
                    b = tb
                    c = tc
            planes[v, u, 0] = a
            planes[v, u, 1] = b
            planes[v, u, 2] = c
            costs[v, u] = cost


@_jit
def choose_views_rows(rows, scratch, reference, pattern, sources, planes, costs, chosen):
    """Choose for every pixel the sources in which its present plane looks most alike."""
    width = reference.active.shape[1]
    views = sources.width.shape[0]
    kept = chosen.shape[2]
    values, weights, found = scratch[0], scratch[1], scratch[2]
    for v in range(rows[0], rows[1]):
        for u in range(width):
            if reference.active[v, u] == 0:
                continue
            mean, variance = _load_patch(reference, pattern, u, v, values, weights)
            for view in range(views):
                found[view] = _view_cost(
                    sources, view, np.float32(u), np.float32(v), planes[v, u, 0], planes[v, u, 1],
                    planes[v, u, 2], pattern, values, weights, mean)
            total = _ZERO
            for k in range(kept):
                lowest = 0
                for view in range(1, views):
                    if found[view] < found[lowest]:
                        lowest = view
                total += min(found[lowest], _WORST)
                chosen[v, u, k] = lowest
                found[lowest] = np.float32(2.0)
            costs[v, u] = total / np.float32(kept)


@_inline
def _mean_cost(sources, views, count, u, v, a, b, c, pattern, values, weights, mean):
    total = _ZERO
    for k in range(count):
        total += _view_cost(
            sources, views[k], np.float32(u), np.float32(v), a, b, c, pattern, values, weights, mean)
    return total


@_jit
def refine_rows(rows, scratch, reference, pattern, sources, planes, costs, steps, rounds, most_views, slack, used, quality):
    """Sub-pixel refinement: a parabola through the cost along c, a and b in turn.

    All sources whose cost is within `slack` of the best take part (at most `most_views`), more than the
    propagation uses: their number and the curvature of the cost make the confidence.
    steps: (inverse depth step, slope step times focal length); used (H, most_views) int64 is work space; quality (H, W, 3): number of views, mean NCC of
    them, curvature of the cost along the inverse depth times the squared step.
    """
    width = reference.active.shape[1]
    views = sources.width.shape[0]
    values, weights, found, plane, step = scratch[0], scratch[1], scratch[2], scratch[3], scratch[4]
    for v in range(rows[0], rows[1]):
        for u in range(width):
            if reference.active[v, u] == 0:
                continue
            mean, variance = _load_patch(reference, pattern, u, v, values, weights)
            lowest = np.float32(2.0)
            for k in range(3):
                plane[k] = planes[v, u, k]
            for view in range(views):
                found[view] = _view_cost(
                    sources, view, np.float32(u), np.float32(v), plane[0], plane[1], plane[2], pattern, values,
                    weights, mean)
                lowest = min(lowest, found[view])
            count = 0
            bar = lowest + slack
            while count < most_views:
                place = -1
                value = min(bar, np.float32(0.999))
                for view in range(views):
                    if found[view] <= value:
                        value = found[view]
                        place = view
                if place < 0:
                    break
                used[v, count] = place
                found[place] = np.float32(2.0)
                count += 1
            quality[v, u, 0] = np.float32(count)
            if count == 0:
                quality[v, u, 1] = _ZERO
                quality[v, u, 2] = _ZERO
                costs[v, u] = _WORST
                continue
            current = _mean_cost(
                sources, used[v], count, u, v, plane[0], plane[1], plane[2], pattern, values, weights, mean)
            curvature = _ZERO
            for turn in range(rounds):
                step[0] = steps[1] * plane[2]
                step[1] = step[0]
                step[2] = steps[0]
                for turn_axis in range(3):
                    axis = 2 - turn_axis
                    start = plane[axis]
                    plane[axis] = start - step[axis]
                    before = _mean_cost(
                        sources, used[v], count, u, v, plane[0], plane[1], plane[2], pattern, values, weights, mean)
                    plane[axis] = start + step[axis]
                    after = _mean_cost(
                        sources, used[v], count, u, v, plane[0], plane[1], plane[2], pattern, values, weights, mean)
                    bend = before + after - np.float32(2.0) * current
                    if bend > np.float32(1e-6):
                        move = _HALF * (before - after) / bend
                        move = min(max(move, -_ONE), _ONE)
                    elif before < after:
                        move = -_ONE
                    else:
                        move = _ONE
                    if axis == 2:
                        curvature = bend
                    plane[axis] = start + move * step[axis]
                    moved = _mean_cost(
                        sources, used[v], count, u, v, plane[0], plane[1], plane[2], pattern, values, weights, mean)
                    if moved <= current:
                        current = moved
                    else:
                        plane[axis] = start
            for k in range(3):
                planes[v, u, k] = plane[k]
            costs[v, u] = current / np.float32(count)
            quality[v, u, 1] = _ONE - current / np.float32(count)
            quality[v, u, 2] = curvature / np.float32(count)


@_jit
def plainness_rows(rows, scratch, padded, stride, pad, centre, radius, reach, variance):
    """Grey variance among the pixels around a pixel that look like it (biweight of width `reach`).

    What lies beyond an outline does not count, so a plain backdrop stays plain right up to it.
    """
    height, width = centre.shape
    inverse = _ONE / (reach * reach)
    for v in range(rows[0], rows[1]):
        for u in range(width):
            middle = centre[v, u]
            total = _ZERO
            first = _ZERO
            second = _ZERO
            for dy in range(-radius, radius + 1):
                base = np.uint32((v + dy + pad) * stride + u + pad - radius)
                for k in range(np.uint32(2 * radius + 1)):
                    value = padded[np.uint32(base + np.uint32(k))] - middle
                    weight = max(_ONE - value * value * inverse, _ZERO)
                    weight *= weight
                    total += weight
                    first += weight * value
                    second += weight * value * value
            mean = first / total
            variance[v, u] = second / total - mean * mean
