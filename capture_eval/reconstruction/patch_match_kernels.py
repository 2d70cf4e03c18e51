"""Compiled passes of slanted-plane PatchMatch: one call works a range of image rows.

Rows share no state within a pass: pixels of one colour of a chequerboard read only pixels of the other, and random
numbers are a hash of the pixel, the pass and the seed.  So the result does not depend on how rows are divided among
threads.

References: Bleyer, Rhemann, Rother, "PatchMatch Stereo" (2011); Galliani, Lasinger, Schindler, "Massively Parallel
Multiview Stereopsis by Surface Normal Diffusion" (2015); Schoenberger et al., "Pixelwise View Selection for
Unstructured Multi-View Stereo" (2016).
"""

# mypy: disable-error-code="no-untyped-def,no-untyped-call,misc,untyped-decorator"

from typing import NamedTuple

import numpy as np

from capture_eval.reconstruction.patch_cost_kernels import WORST, inlined, load_patch, rows_kernel, view_cost

_ONE = np.float32(1.0)
_TWO = np.float32(2.0)
_HALF = np.float32(0.5)
_ZERO = np.float32(0.0)
_FIRST_NUMBER = 16
_TURN = np.float32(2.0 * np.pi)
_STEEPEST = np.float32(1.25)


class Search(NamedTuple):
    """What one half pass tries.

    colour: which squares of the chequerboard; key: of the random numbers; use_all, best_of: whether the mean of the
    best `best_of` of all sources is taken (coarsest level) or the chosen ones; changes, fresh: random changes and fresh
    planes per pixel; amplitude, tilt: of the changes (inverse depth; slope); skip: planes that differ by less (inverse
    depth) are not tried; nearest, farthest: inverse depths; focal: pixels; max_slope: steepest plane.
    """

    colour: int
    key: np.uint32
    use_all: bool
    best_of: int
    changes: int
    fresh: int
    amplitude: np.float32
    tilt: np.float32
    skip: np.float32
    nearest: np.float32
    farthest: np.float32
    focal: np.float32
    max_slope: np.float32


@inlined
def _hash(value):
    """Avalanche of a 32-bit counter (the finaliser of MurmurHash3)."""
    value = np.uint32(value)
    value = np.uint32(value ^ (value >> np.uint32(16)))
    value = np.uint32(value * np.uint32(0x85EBCA6B))
    value = np.uint32(value ^ (value >> np.uint32(13)))
    value = np.uint32(value * np.uint32(0xC2B2AE35))
    return np.uint32(value ^ (value >> np.uint32(16)))


@inlined
def _uniform(key, index):
    """Number in [0, 1) that depends on nothing but `key` and `index`."""
    bits = _hash(np.uint32(np.uint32(key) + np.uint32(np.uint32(index) * np.uint32(0x9E3779B9))))
    return np.float32(np.uint32(bits >> np.uint32(8))) * np.float32(1.0 / 16777216.0)


@inlined
def _symmetric(key, index):
    """Number in [-1, 1)."""
    return _TWO * _uniform(key, index) - _ONE


@inlined
def _random_plane(key, search):
    """Plane drawn from the depth range (uniform in inverse depth) and all visible tilts."""
    c = search.farthest + (search.nearest - search.farthest) * _uniform(key, 0)
    slope = np.tan(_STEEPEST * _uniform(key, 1)) * c / search.focal
    turn = _TURN * _uniform(key, 2)
    return slope * np.cos(turn), slope * np.sin(turn), c


@inlined
def _changed_plane(key, number, a, b, c, search):
    """The plane moved, tilted, or both, in turn and by less each time round."""
    kind = number % 3
    damp = _ONE / np.float32(1 + number // 3 * 3)
    index = np.uint32(_FIRST_NUMBER + 4 * number)
    ta, tb, tc = a, b, c
    if kind != 1:
        tc = c + search.amplitude * damp * _symmetric(key, index)
    if kind != 0:
        size = search.tilt * damp * c / search.focal
        ta = a + size * _symmetric(key, index + np.uint32(1))
        tb = b + size * _symmetric(key, index + np.uint32(2))
    return ta, tb, tc


@inlined
def _neighbour_plane(u, v, offset, active, planes, a, b, c, radius, skip):
    """The neighbour's plane continued to the pixel; false where there is none or it hardly differs."""
    height, width = active.shape
    un = u + offset[0]
    vn = v + offset[1]
    usable = (un >= 0) & (vn >= 0) & (un < width) & (vn < height)
    un = un if usable else u
    vn = vn if usable else v
    usable &= active[vn, un] != 0
    ta = planes[vn, un, 0]
    tb = planes[vn, un, 1]
    tc = planes[vn, un, 2] + ta * np.float32(u - un) + tb * np.float32(v - vn)
    usable &= abs(tc - c) + (abs(ta - a) + abs(tb - b)) * radius >= skip
    return usable, ta, tb, tc


@inlined
def _insert(best, length, value):
    """Keep the `length` smallest values sorted."""
    if value < best[length - 1]:
        place = length - 1
        while place > 0 and best[place - 1] > value:
            best[place] = best[place - 1]
            place -= 1
        best[place] = value


@inlined
def _trial_cost(sources, chosen, search, u, v, a, b, c, pattern, values, weights, best, mean, bar):
    """Mean cost of a plane; stops at chosen views as soon as `bar` is passed."""
    count = chosen.shape[0]
    if search.use_all:
        count = sources.width.shape[0]
        for k in range(search.best_of):
            best[k] = WORST
    total = _ZERO
    for k in range(count):
        view = k if search.use_all else np.int64(chosen[k])
        cost = view_cost(sources, view, np.float32(u), np.float32(v), a, b, c, pattern, values, weights, mean)
        if search.use_all:
            _insert(best, search.best_of, cost)
        else:
            total += cost
            if total >= bar * np.float32(count):
                break
    if search.use_all:
        for k in range(search.best_of):
            total += best[k]
        return total / np.float32(search.best_of)
    return total / np.float32(count)


@rows_kernel
def propagate_rows(rows, scratch, search, reference, pattern, sources, planes, costs, chosen, neighbours):
    """One red-black half pass: planes of neighbours, random changes and fresh planes are tried.

    rows (2,) first and past-last; planes (H, W, 3) a, b, c; costs (H, W) mean of the chosen views;
    chosen (H, W, k) view numbers; neighbours (N, 2) dx, dy of odd Manhattan length.
    """
    width = reference.active.shape[1]
    values, weights, best = scratch[0], scratch[1], scratch[2]
    near = neighbours.shape[0]
    for v in range(rows[0], rows[1]):
        for u in range((v + search.colour) & 1, width, 2):
            if reference.active[v, u] == 0:
                continue
            mean = load_patch(reference, pattern, u, v, values, weights)
            a, b, c = planes[v, u, 0], planes[v, u, 1], planes[v, u, 2]
            cost = costs[v, u]
            key = _hash(np.uint32(np.uint32(v * width + u) ^ search.key))
            for trial in range(near + search.changes + search.fresh):
                usable = True
                if trial < near:
                    usable, ta, tb, tc = _neighbour_plane(
                        u, v, neighbours[trial], reference.active, planes, a, b, c, pattern.radius, search.skip
                    )
                elif trial < near + search.changes:
                    ta, tb, tc = _changed_plane(key, trial - near, a, b, c, search)
                else:
                    ta, tb, tc = _random_plane(_hash(np.uint32(key + np.uint32(trial))), search)
                limit = search.max_slope * tc / search.focal
                usable &= (tc <= search.nearest) & (tc >= search.farthest) & (ta * ta + tb * tb <= limit * limit)
                if not usable:
                    continue
                trial_cost = _trial_cost(
                    sources, chosen[v, u], search, u, v, ta, tb, tc, pattern, values, weights, best, mean, cost
                )
                if trial_cost < cost:
                    cost, a, b, c = trial_cost, ta, tb, tc
            planes[v, u, 0], planes[v, u, 1], planes[v, u, 2] = a, b, c
            costs[v, u] = cost


@inlined
def _all_costs(sources, u, v, plane, pattern, values, weights, mean, found):
    for view in range(sources.width.shape[0]):
        found[view] = view_cost(
            sources, view, np.float32(u), np.float32(v), plane[0], plane[1], plane[2], pattern, values, weights, mean
        )


@rows_kernel
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
            mean = load_patch(reference, pattern, u, v, values, weights)
            _all_costs(sources, u, v, planes[v, u], pattern, values, weights, mean, found)
            total = _ZERO
            for k in range(kept):
                lowest = 0
                for view in range(1, views):
                    if found[view] < found[lowest]:
                        lowest = view
                total += found[lowest]
                chosen[v, u, k] = lowest
                found[lowest] = _TWO
            costs[v, u] = total / np.float32(kept)


@inlined
def _views_within(found, views, most, slack, used):
    """Numbers of the views whose cost is within `slack` of the best, best first; how many."""
    lowest = _TWO
    for view in range(views):
        lowest = min(lowest, found[view])
    bar = min(lowest + slack, np.float32(0.999))
    count = 0
    while count < most:
        place = -1
        value = bar
        for view in range(views):
            if found[view] <= value:
                value = found[view]
                place = view
        if place < 0:
            break
        used[count] = place
        found[place] = _TWO
        count += 1
    return count


@inlined
def _parabola_move(before, current, after):
    """Where the parabola through three costs at -1, 0, 1 is lowest, held within [-1, 1], and its curvature."""
    bend = before + after - _TWO * current
    move = -_ONE if before < after else _ONE
    if bend > np.float32(1e-6):
        move = min(max(_HALF * (before - after) / bend, -_ONE), _ONE)
    return move, bend


@inlined
def _descend(sources, used, count, u, v, plane, current, steps, rounds, pattern, values, weights, mean):
    """Improve `plane` along c, a and b in turn; the cost reached and its curvature along c."""
    curvature = _ZERO
    for turn in range(3 * rounds):
        axis = 2 - turn % 3
        step = steps[0] if axis == 2 else steps[1] * plane[2]
        start = plane[axis]
        before = _ZERO
        after = _ZERO
        move = -_ONE
        # one loop over the three trials keeps a single inlined copy of the cost
        for trial in range(3):
            plane[axis] = start + move * step
            total = _ZERO
            for k in range(count):
                total += view_cost(
                    sources, used[k], np.float32(u), np.float32(v), plane[0], plane[1], plane[2], pattern, values,
                    weights, mean,
                )  # fmt: skip
            if trial == 0:
                before = total
                move = _ONE
            elif trial == 1:
                after = total
                move, bend = _parabola_move(before, current, after)
                if axis == 2:
                    curvature = bend
            elif total <= current:
                current = total
            else:
                plane[axis] = start
    return current, curvature


@rows_kernel
def refine_rows(
    rows, scratch, reference, pattern, sources, planes, costs, steps, rounds, most_views, slack, used, quality
):
    """Sub-pixel refinement: a parabola through the cost along c, a and b in turn.

    All sources whose cost is within `slack` of the best take part (at most `most_views`), more than the propagation
    uses.  steps: inverse depth step; slope step divided by the focal length.  used (H, most_views) int64 is work space;
    quality (H, W, 3): number of views, their mean NCC, curvature of the mean cost along the inverse depth step.
    """
    width = reference.active.shape[1]
    views = sources.width.shape[0]
    values, weights, found = scratch[0], scratch[1], scratch[2]
    for v in range(rows[0], rows[1]):
        for u in range(width):
            if reference.active[v, u] == 0:
                continue
            mean = load_patch(reference, pattern, u, v, values, weights)
            plane = planes[v, u]
            _all_costs(sources, u, v, plane, pattern, values, weights, mean, found)
            for view in range(views):
                scratch[3, view] = found[view]
            count = _views_within(found, views, most_views, slack, used[v])
            if count == 0:
                quality[v, u, 0], quality[v, u, 1], quality[v, u, 2] = _ZERO, _ZERO, _ZERO
                costs[v, u] = WORST
                continue
            current = _ZERO
            for k in range(count):
                current += scratch[3, used[v, k]]
            current, curvature = _descend(
                sources, used[v], count, u, v, plane, current, steps, rounds, pattern, values, weights, mean
            )
            share = _ONE / np.float32(count)
            costs[v, u] = current * share
            quality[v, u, 0] = np.float32(count)
            quality[v, u, 1] = _ONE - current * share
            quality[v, u, 2] = curvature * share
