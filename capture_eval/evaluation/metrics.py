"""The errors of the evaluation, defined once (paper 003, Eq 35).

For curve n at time t, with truth w, prediction w̄ and M counted points,

    E_A(n, t) = 1/M Σ_j |w̄_j − w_j| / D        E_M(n, t) = max_j |w̄_j − w_j| / D

and over all curves and in-between poses ``LAE = max E_A``, ``LME = max E_M``. D is the largest distance between two
vertices of the neutral model. All are fractions of D; they become per cent only in tables and figures.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from capture_eval.errors import InputError

Floats = NDArray[np.float64]
Booleans = NDArray[np.bool_]

METRICS_VERSION = 1


def point_errors(predicted: Floats, truth: Floats, diameter: float) -> Floats:
    """Distance of every predicted point from the true one as a fraction of D.

    Parameters
    ----------
    predicted, truth : (T, M, 3)
        Positions in one unit; NaN where there is none.
    diameter : float
        D in the same unit.

    Returns
    -------
    (T, M) float64

    Raises
    ------
    InputError
        Shapes differ, or D is not positive.
    """
    if predicted.shape != truth.shape or predicted.shape[-1] != 3:
        raise InputError(
            f"predicted {predicted.shape} and true {truth.shape} positions must be equal (times, points, 3)"
        )
    check_diameter(diameter)
    difference = predicted - truth
    errors: Floats = np.sqrt(np.einsum("tmi,tmi->tm", difference, difference)) / diameter
    return errors


def check_diameter(diameter: float) -> None:
    """Refuse a model of no extent.

    Raises
    ------
    InputError
        D is zero, negative or not finite.
    """
    if not (np.isfinite(diameter) and diameter > 0):
        raise InputError(f"D, the diameter of the neutral model, is {diameter}; the model has no extent")


def average_and_maximum(errors: Floats, counted: Booleans | None = None) -> tuple[Floats, Floats, NDArray[np.int64]]:
    """E_A, E_M and the number of points behind them.

    Parameters
    ----------
    errors : (T, M)
        Point errors of one curve; a row with NaN in a counted point has no value.
    counted : (M,) bool, optional
        Points that count; all by default.

    Returns
    -------
    average, maximum : (T,) float64
        NaN where there is no value.
    n_points : (T,) int64
        Points counted; 0 where there is no value.
    """
    chosen = errors if counted is None else errors[:, counted]
    times = len(errors)
    average, maximum = np.full(times, np.nan), np.full(times, np.nan)
    n_points = np.zeros(times, dtype=np.int64)
    valid = np.isfinite(chosen).all(axis=1) & (chosen.shape[1] > 0)
    if valid.any():
        average[valid] = chosen[valid].mean(axis=1)
        maximum[valid] = chosen[valid].max(axis=1)
        n_points[valid] = chosen.shape[1]
    return average, maximum, n_points
