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

# sums over examples may be taken in any order, so that several are added at once; the input is finite
_SUMS = {"reassoc", "contract", "nsz", "nnan"}
_BLOCK = 64  # vertices that share work arrays
_X, _Y, _Z, _LENGTH, _INVERSE, _MOVES = range(6)  # lines of a table of one point's displacements


@numba.njit(cache=True, fastmath=_SUMS, error_model="numpy")
def _copy(displacements: Floats, vertex: int, table: Floats) -> None:
    """Displacements of a vertex into the table's first lines, in the order of memory.

    Reading three far lines at once would fetch them at a third of the speed.
    """
    for axis in range(3):
        for m in range(displacements.shape[2]):
            table[axis, m] = displacements[vertex, axis, m]


@numba.njit(cache=True, fastmath=_SUMS, error_model="numpy")
def _measure(table: Floats, still: float) -> None:
    """Length, inverse squared length and whether there is motion; the last two are 0 where the point is still."""
    for m in range(table.shape[1]):
        squared = table[_X, m] ** 2 + table[_Y, m] ** 2 + table[_Z, m] ** 2
        table[_LENGTH, m] = np.sqrt(squared)
        table[_INVERSE, m] = 1.0 / squared if squared > still * still else 0.0
        table[_MOVES, m] = 1.0 if squared > still * still else 0.0


@numba.njit(cache=True, fastmath=_SUMS, error_model="numpy")
def _consistency(one: Floats, tables: Floats, control: int) -> float:
    """Sum over examples of 2·r·s − 2 of Eq 7 between a vertex (6, K) and a control point of (L, 6, K).

    With lengths a and c and the dot product g of the two displacements, r·s = (1 + g/ac)/2 · min(a/c, c/a)
    = (ac + g)/2 · min(1/a², 1/c²). Where one of them counts as zero r·s = 1, which adds nothing here.
    """
    total = 0.0
    for m in range(one.shape[1]):
        both = (
            one[_LENGTH, m] * tables[control, _LENGTH, m]
            + one[_X, m] * tables[control, _X, m]
            + one[_Y, m] * tables[control, _Y, m]
            + one[_Z, m] * tables[control, _Z, m]
        )
        smaller = min(one[_INVERSE, m], tables[control, _INVERSE, m])
        total += both * smaller - 2.0 * one[_MOVES, m] * tables[control, _MOVES, m]
    return total


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
    tables = np.empty((len(controls), 6, padded))
    for row in range(len(fresh)):
        _copy(displacements, controls[fresh[row]], tables[fresh[row]])
        _measure(tables[fresh[row]], still)
    for block in numba.prange((vertices + _BLOCK - 1) // _BLOCK):
        one, own = np.empty((6, padded)), np.empty(padded)
        for vertex in range(block * _BLOCK, min(vertices, (block + 1) * _BLOCK)):
            if len(fresh) > 0:
                _copy(displacements, vertex, one)
                _measure(one, still)
            for row in range(len(fresh)):
                control = fresh[row]
                mean = 1.0 + 0.5 * _consistency(one, tables, control) / used
                coherency[vertex, control] = _coherency(neutral, vertex, controls[control], diameter, mean)
            if sharpness > 0.0:
                _share(coherency, vertex, sharpness, influence)
            if len(motion) > 0:
                _move(displacements, influence, vertex, weights, own, motion)
