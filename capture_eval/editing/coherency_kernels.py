"""Compiled loops of an edit: coherency of all vertices with the control points in use, and blending the examples.

Imported only by the functions that use it, since numba is heavy. Vertices are independent of each other, so results do
not depend on the number of threads. The displacements are the only large table: an edit reads it once, vertex by
vertex, and all that is made of a vertex's row on the way stays in the cache.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Words = NDArray[np.uint64]

# sums over examples may be taken in any order, so that several are added at once; the input is finite
_SUMS = {"reassoc", "contract", "nsz", "nnan"}
_BLOCK = 64  # vertices that share work arrays; even
_X, _Y, _Z, _LENGTH, _INVERSE, _LINES = range(6)  # lines of a table of one point's displacements, and their number
_WORD = 64  # examples whose motion is told by one number


@numba.njit(cache=True, fastmath=_SUMS, error_model="numpy")
def _measure(displacements: Floats, vertex: int, still: float, table: Floats, moves: Words) -> None:
    """A vertex's displacements, their lengths, inverse squared lengths and in which examples it moves.

    The inverse is 0 where the point is still. The lines are copied one after the other, in the order of memory: reading
    three far lines at once would fetch them at a third of the speed.
    """
    for axis in range(3):
        for m in range(table.shape[1]):
            table[axis, m] = displacements[vertex, axis, m]
    for m in range(table.shape[1]):
        squared = table[_X, m] ** 2 + table[_Y, m] ** 2 + table[_Z, m] ** 2
        table[_LENGTH, m] = np.sqrt(squared)
        table[_INVERSE, m] = 1.0 / squared if squared > still * still else 0.0
    moves[:] = 0
    for m in range(table.shape[1]):
        moves[m // _WORD] |= np.uint64(table[_INVERSE, m] > 0.0) << np.uint64(m % _WORD)


@numba.njit(cache=True)
def _ones(word: np.uint64) -> np.uint64:
    """Number of ones in a word (sums of pairs, of fours, of bytes)."""
    word -= (word >> np.uint64(1)) & np.uint64(0x5555555555555555)
    word = (word & np.uint64(0x3333333333333333)) + ((word >> np.uint64(2)) & np.uint64(0x3333333333333333))
    word = (word + (word >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    return (word * np.uint64(0x0101010101010101)) >> np.uint64(56)


@numba.njit(cache=True)
def _both_move(one: Words, other: Words) -> float:
    """In how many examples both points move."""
    count = np.uint64(0)
    for word in range(len(one)):
        count += _ones(one[word] & other[word])
    return float(count)


@numba.njit(cache=True, fastmath=_SUMS, error_model="numpy")
def _consistency(pair: Floats, one: Floats, other: Floats) -> tuple[float, float, float, float]:
    """Sums over examples of 2·r·s of Eq 7 between two vertices (2, 5, K) and two control points (5, K) each.

    With lengths a and c and the dot product g of the two displacements, r·s = (1 + g/ac)/2 · min(a/c, c/a)
    = (ac + g)/2 · min(1/a², 1/c²), which is 0 here where one of them counts as zero. Four sums at once, since reading
    the tables takes longer than computing with them.
    """
    first_one, first_other, second_one, second_other = 0.0, 0.0, 0.0, 0.0
    for m in range(one.shape[1]):
        x, y, z, length, inverse = one[_X, m], one[_Y, m], one[_Z, m], one[_LENGTH, m], one[_INVERSE, m]
        u, v, w, size, reciprocal = other[_X, m], other[_Y, m], other[_Z, m], other[_LENGTH, m], other[_INVERSE, m]
        a, b, c, d, e = pair[0, _X, m], pair[0, _Y, m], pair[0, _Z, m], pair[0, _LENGTH, m], pair[0, _INVERSE, m]
        first_one += (a * x + b * y + c * z + d * length) * min(e, inverse)
        first_other += (a * u + b * v + c * w + d * size) * min(e, reciprocal)
        a, b, c, d, e = pair[1, _X, m], pair[1, _Y, m], pair[1, _Z, m], pair[1, _LENGTH, m], pair[1, _INVERSE, m]
        second_one += (a * x + b * y + c * z + d * length) * min(e, inverse)
        second_other += (a * u + b * v + c * w + d * size) * min(e, reciprocal)
    return first_one, first_other, second_one, second_other


@numba.njit(cache=True, fastmath=_SUMS, error_model="numpy")
def _coherency(neutral: Floats, vertex: int, other: int, diameter: float, consistency: float) -> float:
    """Eq 8 for a vertex and a control point, from their distance and the mean of r·s."""
    x, y, z = neutral[vertex, 0], neutral[vertex, 1], neutral[vertex, 2]
    apart = np.sqrt((x - neutral[other, 0]) ** 2 + (y - neutral[other, 1]) ** 2 + (z - neutral[other, 2]) ** 2)
    return float(min(max((1.0 - apart / diameter) * consistency, 0.0), 1.0))


@numba.njit(cache=True, fastmath=_SUMS, error_model="numpy")
def _share(coherency: Floats, vertex: int, sharpness: float, influence: Floats) -> None:
    """Eq 10's shares of a vertex: powers of its coherencies that sum to one, or zeros."""
    total = 0.0
    for control in range(coherency.shape[1]):
        value = coherency[vertex, control]
        if sharpness == 2.0:
            value = value * value
        elif sharpness != 1.0:
            value = value**sharpness
        influence[vertex, control] = value
        total += value
    if total > 0.0:
        for control in range(coherency.shape[1]):
            influence[vertex, control] /= total


@numba.njit(cache=True, fastmath=_SUMS, error_model="numpy")
def _move(displacements: Floats, influence: Floats, vertex: int, weights: Floats, own: Floats, motion: Floats) -> None:
    """Eq 10's motion of a vertex."""
    own[:] = 0.0
    for control in range(weights.shape[0]):
        share = influence[vertex, control]
        for m in range(weights.shape[1]):
            own[m] += share * weights[control, m]
    for axis in range(3):  # one after the other: in the order of memory
        total = 0.0
        for m in range(weights.shape[1]):
            total += own[m] * displacements[vertex, axis, m]
        motion[vertex, axis] = total


@numba.njit(cache=True, error_model="numpy", parallel=True)
def edit_vertices(
    displacements: Floats, used: int, neutral: Floats, diameter: float, still: float, controls: NDArray[np.int64],
    fresh: NDArray[np.int64], coherency: Floats, sharpness: float, influence: Floats, weights: Floats, motion: Floats,
) -> None:  # fmt: skip
    """Eqs 7, 8 and 10 for all vertices in one pass; writes ``coherency``, ``influence`` and ``motion``.

    Parameters
    ----------
    displacements : (N, 3, K)
        Those from ``used`` on are zero.
    used : int
    neutral : (N, 3)
    diameter, still : float
    controls : (L,)
        Vertices.
    fresh : (F,)
        Which columns of ``coherency`` are computed; the others are there already.
    coherency, influence : (N, L)
    sharpness : float
        0 where ``influence`` is there already.
    weights : (L, K)
    motion : (N, 3), or (0, 3)
        None is asked for where it is empty.
    """
    vertices, _, padded = displacements.shape
    tables, moves = np.empty((len(controls), _LINES, padded)), np.empty((len(controls), padded // _WORD + 1), np.uint64)
    for row in range(len(fresh)):
        _measure(displacements, controls[fresh[row]], still, tables[fresh[row]], moves[fresh[row]])
    for block in numba.prange((vertices + _BLOCK - 1) // _BLOCK):
        pair, own = np.empty((2, _LINES, padded)), np.empty(padded)
        pair_moves, sums = np.empty((2, padded // _WORD + 1), np.uint64), np.empty((2, 2))
        last = min(vertices, (block + 1) * _BLOCK) - 1
        for vertex in range(block * _BLOCK, last + 1, 2):
            members = (vertex, min(vertex + 1, last))  # a vertex without a partner is its own
            if len(fresh) > 0:
                _measure(displacements, members[0], still, pair[0], pair_moves[0])
                _measure(displacements, members[1], still, pair[1], pair_moves[1])
            for row in range(0, len(fresh), 2):
                ends = (fresh[row], fresh[min(row + 1, len(fresh) - 1)])
                sums[0, 0], sums[0, 1], sums[1, 0], sums[1, 1] = _consistency(pair, tables[ends[0]], tables[ends[1]])
                for k in range(2):
                    for j in range(2):
                        nothing = _both_move(pair_moves[k], moves[ends[j]])
                        mean = 1.0 + (0.5 * sums[k, j] - nothing) / used
                        coherency[members[k], ends[j]] = _coherency(
                            neutral, members[k], controls[ends[j]], diameter, mean
                        )
            for k in range(members[1] - members[0] + 1):
                if sharpness > 0.0:
                    _share(coherency, members[k], sharpness, influence)
                if len(motion) > 0:
                    _move(displacements, influence, members[k], weights, own, motion)
