"""Fitted methods judged on poses that the fit has not seen, beside methods that were not fitted at all."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture_eval.curves.extract import CurveSet
from capture_eval.errors import InputError
from capture_eval.evaluation.fitting import ORDERS, Fit, fit_beta, fit_dynamic_pde, fit_power
from capture_eval.evaluation.metrics import average_and_maximum, check_diameter, point_errors
from capture_eval.evaluation.mode_statistics import ModeStatistics, add_statistics, curve_statistics
from capture_eval.interpolation.linear import LinearInterpolation
from capture_eval.interpolation.method import InterpolationMethod
from capture_eval.interpolation.warps import CLOSURES

Floats = NDArray[np.float64]
Booleans = NDArray[np.bool_]
Integers = NDArray[np.int64]

PER_CURVE_ORDERS, PER_CURVE_CLOSURES = (1, 2, 3), ("stiff", "rest")


def training_poses(pose_ok: Booleans) -> Integers:
    """Every second usable in-between pose, from the first on: (T,) indices.

    Raises
    ------
    InputError
        Fewer than two usable in-between poses: none would be left to judge by.
    """
    usable = np.flatnonzero(pose_ok[1:-1]) + 1
    if len(usable) < 2:
        raise InputError(
            f"a fit needs at least two in-between poses, one to learn and one to judge; {len(usable)} usable"
        )
    return usable[::2].astype(np.int64)


def fit_report(
    curves: CurveSet,
    t: Floats,
    diameter: float,
    counted: tuple[Booleans, ...],
    training: Sequence[int] | Integers,
    per_curve: bool = True,
    orders: Sequence[int] = ORDERS,
    closures: Sequence[str] = CLOSURES,
) -> dict[str, Any]:
    """Fit on the training poses, judge on the others.

    Parameters
    ----------
    curves : CurveSet
        True positions in P poses.
    t : (P,)
        Times.
    diameter : float
        D.
    counted : tuple of (M_n,) bool
        Points that count in the errors; the fit uses whole curves.
    training : sequence of int
        Indices of in-between poses to fit to.
    per_curve : bool
        Also give every curve parameters of its own.
    orders, closures
        Tried for the parameters shared by all curves.

    Returns
    -------
    dict
        ``training_t``, ``held_out_t``, ``rows``: name, parameters, RMS on the training poses and LME, LAE, mean E_A and
        RMS on the held-out poses, all as fractions of D. Plain values.

    Raises
    ------
    InputError
        A training pose that is an end, missing or given twice, or no pose left to judge by.
    """
    check_diameter(diameter)
    poses = np.asarray(training, dtype=np.int64)
    held_out = _held_out(curves, poses, len(t))
    usable = [n for n, truth in enumerate(curves.positions) if np.isfinite(truth[[0, -1, *poses.tolist()]]).all()]
    if not usable:
        raise InputError("a fit needs a curve with values in the first, the last and every training pose")
    parts = [curve_statistics(curves.positions[n], curves.curves[n].closed, poses) for n in usable]
    shared, moments = add_statistics(parts), t[poses]
    rows = [_row("linear", [LinearInterpolation()] * len(usable), None, curves, usable, t, held_out, diameter, counted)]
    for name, fit in (
        ("PDE, shared parameters", fit_dynamic_pde(shared, moments, orders, closures)),
        ("t^p", fit_power(shared, moments)),
        ("Beta timing", fit_beta(shared, moments)),
    ):
        methods: list[InterpolationMethod] = [fit.method] * len(usable)
        rows.append(_row(name, methods, fit.train_rms, curves, usable, t, held_out, diameter, counted))
    if per_curve:
        fits = [fit_dynamic_pde([part], moments, PER_CURVE_ORDERS, PER_CURVE_CLOSURES, 1) for part in parts]
        rms = _together(fits, parts)
        methods = [fit.method for fit in fits]
        rows.append(_row("PDE, per curve", methods, rms, curves, usable, t, held_out, diameter, counted))
    return {
        "ends_used": [float(t[0]), float(t[-1])],
        "training_t": moments.tolist(),
        "held_out_t": t[held_out].tolist(),
        "curves": [curves.curves[n].name for n in usable],
        "rows": rows,
    }


def _held_out(curves: CurveSet, poses: Integers, count: int) -> Integers:
    inside = np.arange(1, count - 1)
    if len(poses) == 0 or not np.isin(poses, inside).all() or len(np.unique(poses)) != len(poses):
        raise InputError(f"training poses {poses.tolist()} must be different in-between poses, 1 to {count - 2}")
    known = np.zeros(count, dtype=bool)
    for truth in curves.positions:
        known |= np.isfinite(truth).all(axis=(1, 2))
    held_out = np.setdiff1d(inside[known[1:-1]], poses)
    if len(held_out) == 0:
        raise InputError("no in-between pose is held out; a fit may not be judged on the poses it was made from")
    if not known[poses].all():
        raise InputError(f"training pose {int(poses[~known[poses]][0])} is missing")
    return held_out.astype(np.int64)


def _together(fits: Sequence[Fit], parts: Sequence[ModeStatistics]) -> float:
    points = np.array([part.points for part in parts], dtype=np.float64)
    squares = np.array([fit.train_rms for fit in fits]) ** 2
    return float(np.sqrt((points * squares).sum() / points.sum()))


def _row(
    name: str,
    methods: Sequence[InterpolationMethod],
    train_rms: float | None,
    curves: CurveSet,
    usable: Sequence[int],
    t: Floats,
    held_out: Integers,
    diameter: float,
    counted: tuple[Booleans, ...],
) -> dict[str, Any]:
    averages, maxima, squares = [], [], []
    for n, method in zip(usable, methods, strict=True):
        truth = curves.positions[n]
        predicted = method.predict(truth[0], truth[-1], curves.curves[n].closed, t[held_out])
        errors = point_errors(predicted, truth[held_out], diameter)
        average, maximum, n_points = average_and_maximum(errors, counted[n])
        averages.append(average[n_points > 0])
        maxima.append(maximum[n_points > 0])
        squares.append((errors[n_points > 0][:, counted[n]] ** 2).ravel())
    average, maximum, square = (np.concatenate(values) for values in (averages, maxima, squares))
    shared = all(method == methods[0] for method in methods)
    return {
        "name": name,
        "options": dict(methods[0].options) if shared else [dict(method.options) for method in methods],
        "train_rms": None if train_rms is None else train_rms / diameter,
        "LME": float(maximum.max()) if len(maximum) else None,
        "LAE": float(average.max()) if len(average) else None,
        "mean_E_A": float(average.mean()) if len(average) else None,
        "rms": float(np.sqrt(square.mean())) if len(square) else None,
    }
