"""Compiled loops of an edit: coherency of all vertices with the control points in use, and blending the examples.

Imported only by the functions that use it, since numba is heavy. Vertices are independent of each other, so results do
not depend on the number of threads.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

# sums over examples may be taken in any order, so that several are added at once; the input is finite
_SUMS = {"reassoc", "contract", "nsz", "nnan"}


@numba.njit(cache=True, fastmath=_SUMS, error_model="numpy")
def _control_table(columns: Floats, still: float) -> Floats:
    """Displacement, length and inverse squared length (0 where still) of every control point, (L, 5, K)."""
    controls, _, examples = columns.shape
    table = np.zeros((controls, 5, examples))
    for control in range(controls):
        for m in range(examples):
            x, y, z = columns[control, 0, m], columns[control, 1, m], columns[control, 2, m]
            squared = x * x + y * y + z * z
            table[control, 0, m], table[control, 1, m], table[control, 2, m] = x, y, z
            table[control, 3, m] = np.sqrt(squared)
            table[control, 4, m] = 1.0 / squared if squared > still * still else 0.0
    return table


@numba.njit(cache=True, fastmath=_SUMS, error_model="numpy", parallel=True)
def mean_consistency(displacements: Floats, columns: Floats, still: float) -> Floats:
    """Mean over examples of r·s of Eq 7 for every vertex and control point, (N, L).

    ``displacements`` is (N, 3, K), ``columns`` (L, 3, K) those of the control points. With lengths a and c and the dot
    product g of the two displacements, r·s = (1 + g/ac)/2 · min(a/c, c/a) = (ac + g)/2 · min(1/a², 1/c²); displacements
    no longer than ``still`` count as zero and give 1.
    """
    vertices, _, examples = displacements.shape
    table = _control_table(columns, still)
    controls = len(table)
    mean = np.empty((vertices, controls))
    for i in numba.prange(vertices):
        x, y, z = displacements[i, 0], displacements[i, 1], displacements[i, 2]
        length = np.empty(examples)
        inverse = np.empty(examples)
        for m in range(examples):
            squared = x[m] * x[m] + y[m] * y[m] + z[m] * z[m]
            length[m] = np.sqrt(squared)
            inverse[m] = 1.0 / squared if squared > still * still else 0.0
        for control in range(controls):
            u, v, w = table[control, 0], table[control, 1], table[control, 2]
            other, other_inverse = table[control, 3], table[control, 4]
            total = 0.0
            for m in range(examples):
                both = length[m] * other[m] + x[m] * u[m] + y[m] * v[m] + z[m] * w[m]
                smaller = min(inverse[m], other_inverse[m])
                total += both * smaller if smaller > 0.0 else 2.0
            mean[i, control] = 0.5 * total / examples
    return mean


@numba.njit(cache=True, fastmath=_SUMS, error_model="numpy", parallel=True)
def blend_displacements(displacements: Floats, influence: Floats, weights: Floats) -> Floats:
    """Eq 10 for displacements (N, 3, K), influence (N, L) and weights (L, K): motion of every vertex, (N, 3)."""
    vertices, _, examples = displacements.shape
    controls = weights.shape[0]
    motion = np.empty((vertices, 3))
    for i in numba.prange(vertices):
        own = np.zeros(examples)
        for control in range(controls):
            share = influence[i, control]
            row = weights[control]
            for m in range(examples):
                own[m] += share * row[m]
        for axis in range(3):
            line = displacements[i, axis]
            total = 0.0
            for m in range(examples):
                total += own[m] * line[m]
            motion[i, axis] = total
    return motion
