"""Errors when every pose may be compared with the moment of a method that fits it best.

The time t of a photographed pose is its number in the sequence: nobody measured how far the movement had gone. What
is left at the best-fitting moment is what a method gets wrong however the poses were timed.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture_eval.curves.extract import CurveSet
from capture_eval.evaluation.metrics import average_and_maximum, point_errors
from capture_eval.interpolation.method import InterpolationMethod

Floats = NDArray[np.float64]
Booleans = NDArray[np.bool_]

MOMENTS = 65


def best_fit_times(
    curves: CurveSet, method: InterpolationMethod, counted: tuple[Booleans, ...], moments: int = MOMENTS
) -> Floats:
    """The moment in [0, 1] at which a method is closest to each in-between pose, over all curves together, (T,).

    Least sum of squared distances over the counted points, on a grid of moments and then by a parabola through the
    best and its neighbours. NaN where a pose has no value.
    """
    grid = np.linspace(0.0, 1.0, moments)
    cost = np.zeros((moments, len(curves.positions[0]) - 2))
    seen = np.zeros(cost.shape[1], dtype=bool)
    for curve, truth, chosen in zip(curves.curves, curves.positions, counted, strict=True):
        known = np.isfinite(truth[1:-1][:, chosen]).all(axis=(1, 2)) & bool(chosen.any())
        if not (known.any() and np.isfinite(truth[[0, -1]]).all()):
            continue
        path = method.predict(truth[0], truth[-1], curve.closed, grid)
        shown = (path - truth[0])[:, chosen].reshape(moments, -1)  # small numbers keep their digits in the product
        wanted = (truth[1:-1] - truth[0])[known][:, chosen].reshape(int(known.sum()), -1)
        cost[:, known] += (shown**2).sum(axis=1)[:, None] - 2.0 * shown @ wanted.T + (wanted**2).sum(axis=1)
        seen |= known
    best = np.argmin(cost, axis=0)
    middle = np.clip(best, 1, moments - 2)
    pose = np.arange(cost.shape[1])
    before, here, after = (cost[middle + step, pose] for step in (-1, 0, 1))
    bend = before - 2.0 * here + after
    shift = np.divide(before - after, 2.0 * bend, out=np.zeros_like(bend), where=bend > 0)
    refined = np.clip(grid[middle] + np.clip(shift, -1.0, 1.0) * grid[1], 0.0, 1.0)
    result: Floats = np.where(seen, np.where(bend > 0, refined, grid[best]), np.nan)
    return result


def best_fit_rows(
    curves: CurveSet, methods: Mapping[str, InterpolationMethod], diameter: float, counted: tuple[Booleans, ...]
) -> dict[str, dict[str, Any]]:
    """Per method: the best-fitting moments and the errors there, as plain values for ``summary.json``.

    Parameters
    ----------
    curves : CurveSet
        True positions.
    methods : mapping of name to InterpolationMethod
        Methods.
    diameter : float
        D.
    counted : tuple of (M_n,) bool
        Points that count.

    Returns
    -------
    dict
        ``times`` (None where a pose has no value), ``LME``, ``LAE``, ``mean_E_A``.
    """
    rows = {}
    for name, method in methods.items():
        times = best_fit_times(curves, method, counted)
        usable = np.nan_to_num(times)
        averages, maxima = [], []
        for curve, truth, chosen in zip(curves.curves, curves.positions, counted, strict=True):
            if not np.isfinite(truth[[0, -1]]).all():
                continue
            predicted = method.predict(truth[0], truth[-1], curve.closed, usable)
            average, maximum, n_points = average_and_maximum(point_errors(predicted, truth[1:-1], diameter), chosen)
            averages.append(average[n_points > 0])
            maxima.append(maximum[n_points > 0])
        average, maximum = (np.concatenate(values) if values else np.zeros(0) for values in (averages, maxima))
        rows[name] = {
            "times": [float(t) if np.isfinite(t) else None for t in times.tolist()],
            "LME": float(maximum.max()) if len(maximum) else None,
            "LAE": float(average.max()) if len(average) else None,
            "mean_E_A": float(average.mean()) if len(average) else None,
        }
    return rows
