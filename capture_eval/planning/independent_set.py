"""Heaviest set of items without a conflict: the 0/1 programme of one round (Carrigan et al. 2020, Eq 3), by HiGHS."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capture_eval.errors import SolverError

Floats = NDArray[np.float64]
Booleans = NDArray[np.bool_]

# HiGHS stops at an absolute gap of 1e-6; weights are brought to this size so that the gap is 1e-9 of the largest.
_SOLVER_SCALE = 1000.0


@dataclass(frozen=True)
class HeaviestSet:
    """Solution of one round.

    Attributes
    ----------
    items : tuple of int
        Chosen, ascending.
    value, bound : float
        Sum of their weights, and the solver's proven upper bound of any such sum.
    """

    items: tuple[int, ...]
    value: float
    bound: float


def heaviest_set(
    weights: Floats,
    rows: Booleans,
    *,
    include: Sequence[int] = (),
    exclude: Sequence[int] = (),
    hit: Sequence[Sequence[int]] = (),
) -> HeaviestSet:
    """Maximise the sum of weights over sets that take at most one item of every row.

    Parameters
    ----------
    weights : (I,) float64
        0 or more; where all that are free are 0, the number of items is maximised instead (the value stays 0).
    rows : (R, I) bool
    include, exclude : sequences of int
        Items that must and must not be taken.
    hit : sequence of sets of items
        At least one of each must be taken.

    Raises
    ------
    SolverError
        There is no such set, or the solver did not prove its answer optimal.
    """
    from scipy.optimize import Bounds, LinearConstraint, milp
    from scipy.sparse import csr_array

    count = len(weights)
    lower, upper = np.zeros(count), np.ones(count)
    lower[list(include)] = 1.0
    upper[list(exclude)] = 0.0
    free = np.flatnonzero(upper > 0.0)
    used = weights if np.any(weights[free] > 0.0) else np.ones(count)
    scale = _SOLVER_SCALE / float(used[free].max(initial=1e-300))
    short = rows[:, free]
    short = short[short.sum(axis=1) >= 2]
    constraints = []
    if len(short):
        constraints.append(LinearConstraint(csr_array(short.astype(np.float64)), -np.inf, 1.0))
    if len(hit):
        needed = np.zeros((len(hit), count))
        for row, items in enumerate(hit):
            needed[row, list(items)] = 1.0
        constraints.append(LinearConstraint(csr_array(needed[:, free]), 1.0, np.inf))
    if not len(free):
        if len(hit) or len(include):
            raise SolverError("plan: no set of shapes fulfils the rules of this expression")
        return HeaviestSet((), 0.0, 0.0)
    found = milp(
        -scale * used[free],
        integrality=np.ones(len(free), dtype=np.int64),
        bounds=Bounds(lower[free], upper[free]),
        constraints=constraints,
        options={"mip_rel_gap": 0.0},
    )
    if found.status == 2:
        raise SolverError("plan: no set of shapes fulfils the rules of this expression")
    if found.status != 0 or found.x is None:
        raise SolverError(f"plan: HiGHS did not prove an optimum ({found.message})")
    chosen = free[np.asarray(found.x) > 0.5]
    if len(rows) and rows[:, chosen].sum(axis=1).max(initial=0) > 1:
        raise SolverError("plan: HiGHS returned a set with a conflict")
    chosen = _with_weightless(chosen, free, weights, rows)
    value = float(weights[chosen].sum())
    bound = value
    if used is weights and found.mip_dual_bound is not None:
        bound = max(-float(found.mip_dual_bound) / scale, value)
    return HeaviestSet(tuple(int(item) for item in chosen), value, bound)


def _with_weightless(
    chosen: NDArray[np.int64], free: NDArray[np.int64], weights: Floats, rows: Booleans
) -> NDArray[np.int64]:
    """Add items of weight 0 that fit: the value stays, and they need no expression of their own."""
    taken = rows[:, chosen].any(axis=1)
    result = set(chosen.tolist())
    for item in free.tolist():
        if item not in result and weights[item] == 0.0 and not np.any(taken & rows[:, item]):
            result.add(item)
            taken |= rows[:, item]
    return np.array(sorted(result), dtype=np.int64)
