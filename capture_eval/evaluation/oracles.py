"""Bounds that no method of a class can beat, computed from the truth itself: marked as oracles and never ranked.

Geometric linear, cosine, powers of time and the stiff PDE all move points along straight lines; they differ in
timing only. The first oracle is the best one timing shared by all points, the second lets every point choose its
own timing. What they leave is the bend of the true paths.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capture_eval.curves.extract import CurveSet
from capture_eval.evaluation.error_table import ErrorTable
from capture_eval.evaluation.metrics import average_and_maximum, point_errors
from capture_eval.interpolation.linear import follow_chord

Floats = NDArray[np.float64]
Booleans = NDArray[np.bool_]

ORACLES = ("oracle_best_timing", "oracle_nearest_on_chord")


@dataclass(frozen=True)
class OracleResult:
    """Errors of the oracles and the timing that the first one found.

    Parameters
    ----------
    table : ErrorTable
        Rows of ``ORACLES``.
    best_timing : (T,) float64
        Share of the way at every in-between pose, rising; NaN where a pose is missing.
    """

    table: ErrorTable
    best_timing: Floats


def evaluate_oracles(curves: CurveSet, t: Floats, diameter: float, counted: tuple[Booleans, ...]) -> OracleResult:
    """Errors of the two oracles, on the same points as the methods.

    Parameters
    ----------
    curves : CurveSet
        True positions in P poses; NaN in poses that failed.
    t : (P,)
        Times of the poses.
    diameter : float
        D.
    counted : tuple of (M_n,) bool
        Points that count.

    Returns
    -------
    OracleResult
    """
    timing = best_shared_timing(curves, counted)
    shape = (len(ORACLES), len(curves), len(t) - 2)
    average, maximum = np.full(shape, np.nan), np.full(shape, np.nan)
    n_points = np.zeros(shape[1:], dtype=np.int64)
    for n, truth in enumerate(curves.positions):
        predictions = (_shared(truth, timing), nearest_on_chord(truth))
        for k, predicted in enumerate(predictions):
            errors = point_errors(predicted, truth[1:-1], diameter)
            average[k, n], maximum[k, n], n_points[n] = average_and_maximum(errors, counted[n])
    names = tuple(curve.name for curve in curves.curves)
    return OracleResult(ErrorTable(ORACLES, names, t[1:-1].copy(), n_points, average, maximum), timing)


def best_shared_timing(curves: CurveSet, counted: tuple[Booleans, ...]) -> Floats:
    """The rising timing in [0, 1] of all straight paths together that has the least squared error, (T,).

    The free optimum at each time is Σ (w − w0)·d / Σ d·d over all points, d = w1 − w0; pooling neighbours that run
    backwards makes it the best rising one (isotonic regression with equal weights, since Σ d·d is the same at all
    times).
    """
    along = np.zeros(len(curves.positions[0]) - 2)
    across = 0.0
    for truth, chosen in zip(curves.positions, counted, strict=True):
        chord = (truth[-1] - truth[0])[chosen]
        along += np.einsum("tmi,mi->t", truth[1:-1][:, chosen] - truth[0, chosen], chord)
        across += float((chord**2).sum())
    if not across > 0:
        return np.full(len(along), np.nan)
    free = along / across
    known = np.isfinite(free)
    timing = np.full(len(free), np.nan)
    if known.any():
        from scipy.optimize import isotonic_regression

        timing[known] = np.clip(isotonic_regression(free[known]).x, 0.0, 1.0)
    return timing


def _shared(truth: Floats, timing: Floats) -> Floats:
    if np.isnan(timing).all() and np.isfinite(truth[[0, -1]]).all():
        return np.repeat(truth[:1], len(timing), axis=0)  # nothing moves, so timing has no meaning
    return follow_chord(truth[0], truth[-1], timing)


def nearest_on_chord(truth: Floats) -> Floats:
    """Nearest point of every point's straight path to its true position, (T, M, 3) for P poses (P, M, 3)."""
    chord = truth[-1] - truth[0]
    squared = (chord**2).sum(axis=-1)
    along = np.einsum("tmi,mi->tm", truth[1:-1] - truth[0], chord)
    share = np.divide(along, squared, out=np.zeros_like(along), where=squared > 0)
    result: Floats = truth[0] + np.clip(share, 0.0, 1.0)[..., None] * chord
    return result
