"""The figures one compares: LME and LAE per method, where they occur, what they are worth against the noise."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture_eval.curves.extract import CurveSet
from capture_eval.evaluation.best_fit_time import best_fit_rows
from capture_eval.evaluation.error_propagation import CurveBars
from capture_eval.evaluation.error_table import ErrorTable, Evaluation
from capture_eval.evaluation.method_comparison import compare_methods
from capture_eval.evaluation.metrics import METRICS_VERSION, average_and_maximum, point_errors
from capture_eval.evaluation.oracles import ORACLES, evaluate_oracles
from capture_eval.evaluation.timing_path import split_timing_and_path
from capture_eval.interpolation.linear import LinearInterpolation
from capture_eval.interpolation.method import InterpolationMethod, KeyPoseMethod

Floats = NDArray[np.float64]

SUMMARY_SCHEMA = "capture_eval.summary/1"
STILL_SHARE = 0.003  # of D: a curve whose points moved less on average counts as resting


def largest_errors(table: ErrorTable, method: str) -> dict[str, Any]:
    """LME and LAE of one method with the curve and time where they occur; None without any value.

    Ties go to the first curve, then the first time.
    """
    k = table.methods.index(method)
    found: dict[str, Any] = {}
    for key, values in (("LME", table.maximum[k]), ("LAE", table.average[k])):
        if not np.isfinite(values).any():
            found |= {key: None, f"{key}_curve": None, f"{key}_t": None}
            continue
        n, i = np.unravel_index(int(np.nanargmax(values)), values.shape)
        found |= {key: float(values[n, i]), f"{key}_curve": table.curves[n], f"{key}_t": float(table.t[i])}
    return found


def summarise(
    evaluation: Evaluation,
    curves: CurveSet,
    methods: Mapping[str, InterpolationMethod],
    diameter: float,
    pose_ok: NDArray[np.bool_],
    evaluation_vertices: str,
    bars: CurveBars | None = None,
) -> dict[str, Any]:
    """Everything for ``summary.json``, as plain values that JSON can hold.

    Parameters
    ----------
    evaluation : Evaluation
        Errors and predictions.
    curves : CurveSet
        True positions.
    methods : mapping of name to InterpolationMethod
        The same methods in the same order.
    diameter : float
        D.
    pose_ok : (P,) bool
        Poses that were reconstructed and registered.
    evaluation_vertices : str
        Which vertices count: ``confident``, ``seen`` or ``all``.
    bars : CurveBars, optional
        What the registration's error bars do to the curves. The noise floor is the larger of theirs and that of the
        curves that rest: the first knows the moving parts, the second knows what no repeat of a registration shows.

    Returns
    -------
    dict
        Errors as fractions of D; missing values are None.
    """
    table = evaluation.table
    rows = {name: _method_row(evaluation, curves, name, method, diameter) for name, method in methods.items()}
    oracles, best_timing = _oracle_rows(evaluation, curves, diameter)
    _add_ratios(rows, rows | oracles)
    noise = _noise_floor(evaluation, curves, diameter)
    noise["error_bars"] = None if bars is None else bars.summary()
    floors = [noise["mean_E_A"], (noise["error_bars"] or {}).get("mean_E_A")]
    floor = max((value for value in floors if value is not None), default=None)
    free = {name: method for name, method in methods.items() if not isinstance(method, KeyPoseMethod)}
    for name, fitted in best_fit_rows(curves, free, diameter, evaluation.counted).items():
        rows[name]["best_fit_time"] = fitted
    used: NDArray[np.bool_] = np.any(table.n_points > 0, axis=1)
    return {
        "schema": SUMMARY_SCHEMA,
        "metrics_version": METRICS_VERSION,
        "D": float(diameter),
        "unit_of_errors": "fraction of D",
        "evaluation_vertices": evaluation_vertices,
        "methods": rows,
        "oracles": oracles,
        "best_timing": best_timing,
        "noise_floor": floor,
        "noise": noise,
        "statistics": compare_methods(table, floor),
        "counts": {
            "poses": len(pose_ok),
            "poses_failed": int(np.sum(~pose_ok)),
            "in_between": len(table.t),
            "in_between_failed": int(np.sum(~pose_ok[1:-1])),
            "curves": len(table.curves),
            "curves_used": int(used.sum()),
            "curves_failed": [name for name, kept in zip(table.curves, used.tolist(), strict=True) if not kept],
            "points": int(sum(len(counted) for counted in evaluation.counted)),
            "points_used": int(sum(counted.sum() for counted in evaluation.counted)),
        },
        "coverage": {
            name: float(counted.mean()) for name, counted in zip(table.curves, evaluation.counted, strict=True)
        },
    }


def _method_row(
    evaluation: Evaluation, curves: CurveSet, name: str, method: InterpolationMethod, diameter: float
) -> dict[str, Any]:
    table = evaluation.table
    k = table.methods.index(name)
    kinds = dict.fromkeys((len(curve.vertices), curve.closed) for curve in curves.curves)
    warned = [line for count, closed in kinds for line in method.warnings(count, closed)]
    return {
        "title": method.title,
        "reference": method.reference,
        "options": dict(method.options),
        "key_times": list(method.key_times) if isinstance(method, KeyPoseMethod) else [],
        **largest_errors(table, name),
        "LME_ratio_to_linear": None,
        "LAE_ratio_to_linear": None,
        "mean_E_M": _mean(table.maximum[k]),
        "mean_E_A": _mean(table.average[k]),
        **_root_mean_squares(evaluation, curves, name, diameter),
        "warnings": list(dict.fromkeys(warned)),
    }


def _mean(values: Floats) -> float | None:
    finite = values[np.isfinite(values)]
    return float(finite.mean()) if finite.size else None


def _root_mean_squares(evaluation: Evaluation, curves: CurveSet, name: str, diameter: float) -> dict[str, float | None]:
    """RMS over all counted points and in-between poses, and its parts: ``rms² = rms_timing² + rms_path²``."""
    k = evaluation.table.methods.index(name)
    timing, path = [], []
    for n, truth in enumerate(curves.positions):
        predicted = evaluation.predictions[name][n][1:-1]
        split = split_timing_and_path(predicted, truth[1:-1], truth[0], truth[-1], diameter)
        valid = (evaluation.table.n_points[n] > 0) & np.isfinite(evaluation.table.average[k, n])
        timing.append(split.timing[valid][:, evaluation.counted[n]].ravel() ** 2)
        path.append(split.path[valid][:, evaluation.counted[n]].ravel() ** 2)
    squares = [np.concatenate(part) for part in (timing, path)]
    if squares[0].size == 0:
        return {"rms": None, "rms_timing": None, "rms_path": None}
    means = [float(part.mean()) for part in squares]
    return {"rms": sum(means) ** 0.5, "rms_timing": means[0] ** 0.5, "rms_path": means[1] ** 0.5}


def _oracle_rows(
    evaluation: Evaluation, curves: CurveSet, diameter: float
) -> tuple[dict[str, dict[str, Any]], list[dict[str, float | None]]]:
    """Bounds computed from the truth: what is left when timing is perfect. They are no methods and have no rank."""
    times = np.concatenate([[0.0], evaluation.table.t, [1.0]])
    found = evaluate_oracles(curves, times, diameter, evaluation.counted)
    titles = {
        ORACLES[0]: "oracle: straight paths, best timing shared by all points",
        ORACLES[1]: "oracle: straight paths, best timing of every point",
    }
    rows = {
        name: {
            "title": titles[name],
            **largest_errors(found.table, name),
            "LME_ratio_to_linear": None,
            "LAE_ratio_to_linear": None,
            "mean_E_M": _mean(found.table.maximum[k]),
            "mean_E_A": _mean(found.table.average[k]),
        }
        for k, name in enumerate(ORACLES)
    }
    best = [
        {"t": float(t), "share": float(share) if np.isfinite(share) else None}
        for t, share in zip(found.table.t.tolist(), found.best_timing.tolist(), strict=True)
    ]
    return rows, best


def _add_ratios(methods: dict[str, dict[str, Any]], rows: dict[str, dict[str, Any]]) -> None:
    """Error over the error of geometric linear: below 1 is better (paper 003 states the reciprocal)."""
    base = methods.get("linear")
    for row in rows.values():
        for key in ("LME", "LAE"):
            if base is not None and base[key] and row[key] is not None:
                row[f"{key}_ratio_to_linear"] = row[key] / base[key]


def _noise_floor(evaluation: Evaluation, curves: CurveSet, diameter: float) -> dict[str, Any]:
    """Errors of straight, even motion on curves that hardly move: what the ground truth itself is uncertain by."""
    averages, maxima, names = [], [], []
    for n, (curve, truth) in enumerate(zip(curves.curves, curves.positions, strict=True)):
        counted = evaluation.counted[n]
        moved = np.linalg.norm(truth[-1] - truth[0], axis=1)[counted]
        if not counted.any() or not np.isfinite(moved).all() or moved.mean() > STILL_SHARE * diameter:
            continue
        times = np.concatenate([[0.0], evaluation.table.t, [1.0]])
        predicted = LinearInterpolation().predict(truth[0], truth[-1], curve.closed, times)[1:-1]
        average, maximum, n_points = average_and_maximum(point_errors(predicted, truth[1:-1], diameter), counted)
        if (n_points > 0).any():
            averages.append(average[n_points > 0])
            maxima.append(maximum[n_points > 0])
            names.append(curve.name)
    return {
        "definition": f"E_A and E_M of straight even motion on curves whose points move less than {STILL_SHARE} D",
        "curves": names,
        "mean_E_A": float(np.concatenate(averages).mean()) if names else None,
        "largest_E_A": float(np.concatenate(averages).max()) if names else None,
        "largest_E_M": float(np.concatenate(maxima).max()) if names else None,
    }
