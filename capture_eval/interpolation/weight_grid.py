"""Weights of blendshapes: the grid of all combinations of levels, normalisation, and which combinations are equal.

(Paper 003, Section 5: five targets with six levels give 6⁵ − 1 = 7,775 combinations without the one of only zeros, of
which 7,471 are distinct once they are scaled to add up to 1.)
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from capture_eval.errors import InputError

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

LARGEST_GRID = 50_000_000  # combinations held at once; more is a slip of the pen
_DIGITS = 12  # after which normalised weights count as equal


def check_weights(weights: ArrayLike, targets: int) -> Floats:
    """Weights (K, J) as float64.

    Raises
    ------
    InputError
        Another number of targets, no row, or weights that are negative or not finite; names the first.
    """
    rows = np.atleast_2d(np.asarray(weights, dtype=np.float64))
    if rows.ndim != 2 or rows.shape[1] != targets or not len(rows):
        raise InputError(f"weights have shape {rows.shape}, expected one row of {targets} for every shape")
    bad = ~np.isfinite(rows) | (rows < 0)
    if bad.any():
        row, column = np.argwhere(bad)[0]
        raise InputError(f"weight {rows[row, column]} of target {column} in row {row} must be finite and not negative")
    return rows


def weight_grid(levels: Sequence[float], targets: int) -> Floats:
    """All combinations of levels, (L^J, J) without the combination of only zeros; the last target varies fastest.

    Parameters
    ----------
    levels : sequence of float
        Rising, not negative.
    targets : int
        J.

    Raises
    ------
    InputError
        Levels out of order, no target, or more combinations than can be held.

    Examples
    --------
    >>> len(weight_grid([0, 0.2, 0.4, 0.6, 0.8, 1], 5))
    7775
    """
    values = np.asarray(levels, dtype=np.float64)
    if values.ndim != 1 or not len(values) or not np.isfinite(values).all() or values[0] < 0:
        raise InputError(f"levels {list(levels)} must be numbers, not negative")
    if not np.all(np.diff(values) > 0):
        raise InputError(f"levels {list(levels)} must rise")
    if targets < 1:
        raise InputError(f"a grid of weights needs at least one target, got {targets}")
    count = len(values) ** targets
    if count > LARGEST_GRID:
        raise InputError(f"{len(values)} levels for {targets} targets are {count:,} shapes; more than {LARGEST_GRID:,}")
    rows = values[np.stack(np.unravel_index(np.arange(count), (len(values),) * targets), axis=1)]
    result: Floats = rows[1:] if values[0] == 0 else rows
    if not len(result):
        raise InputError("the only level is 0; no shape is asked for")
    return result


def normalise_weights(weights: ArrayLike, targets: int) -> Floats:
    """Weights scaled to add up to 1.

    Raises
    ------
    InputError
        A row of only zeros, or see `check_weights`.
    """
    rows = check_weights(weights, targets)
    total = rows.sum(axis=1, keepdims=True)
    if np.any(total <= 0):
        raise InputError(f"row {int(np.argmin(total[:, 0]))} of the weights has only zeros and cannot add up to 1")
    result: Floats = rows / total
    return result


def first_of_equals(weights: Floats) -> Integers:
    """Numbers of the rows that differ (to 12 digits) from all before them, in order: (distinct,) int64."""
    _, first = np.unique(np.round(weights, _DIGITS), axis=0, return_index=True)
    return np.sort(first).astype(np.int64)
