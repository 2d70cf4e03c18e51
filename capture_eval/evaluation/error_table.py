"""Every method on every curve: predictions, and one row of errors per method, curve and in-between pose."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capture_eval.curves.extract import CurveSet
from capture_eval.errors import InputError
from capture_eval.evaluation.metrics import average_and_maximum, check_diameter, point_errors
from capture_eval.interpolation.method import InterpolationMethod, KeyPoseMethod

Floats = NDArray[np.float64]
Booleans = NDArray[np.bool_]


@dataclass(frozen=True)
class ErrorTable:
    """Errors of all methods on all curves at all in-between poses, as fractions of D.

    Parameters
    ----------
    methods, curves : tuple of str
        Names, K and N of them, in order.
    t : (T,) float64
        Times of the in-between poses.
    n_points : (N, T) int64
        Points that count; 0 where a pose, an end pose or all points of a curve are missing.
    average, maximum : (K, N, T) float64
        E_A and E_M; NaN where ``n_points`` is 0, and at poses that a method was given.
    """

    methods: tuple[str, ...]
    curves: tuple[str, ...]
    t: Floats
    n_points: NDArray[np.int64]
    average: Floats
    maximum: Floats

    def __post_init__(self) -> None:
        shape = (len(self.methods), len(self.curves), len(self.t))
        if self.average.shape != shape or self.maximum.shape != shape or self.n_points.shape != shape[1:]:
            raise InputError(
                f"error table: E_A {self.average.shape}, E_M {self.maximum.shape} and n_points {self.n_points.shape} "
                f"do not fit {shape[0]} methods, {shape[1]} curves and {shape[2]} times"
            )

    def rows(self) -> list[tuple[str, str, float, int, float, float]]:
        """Rows (method, curve, t, n_points, E_A, E_M) in order of method, curve, time."""
        return [
            (
                method,
                curve,
                float(self.t[i]),
                int(self.n_points[n, i]) if np.isfinite(self.average[k, n, i]) else 0,
                float(self.average[k, n, i]),
                float(self.maximum[k, n, i]),
            )
            for k, method in enumerate(self.methods)
            for n, curve in enumerate(self.curves)
            for i in range(len(self.t))
        ]


@dataclass(frozen=True)
class Evaluation:
    """Errors and the predictions they were measured on.

    Parameters
    ----------
    table : ErrorTable
        The errors.
    predictions : mapping of method to tuple of (P, M_n, 3)
        Predicted positions of every curve at all P pose times; NaN when an end pose is missing.
    counted : tuple of (M_n,) bool
        Points of every curve that count.
    """

    table: ErrorTable
    predictions: Mapping[str, tuple[Floats, ...]]
    counted: tuple[Booleans, ...]


def check_pose_times(t: Sequence[float] | Floats, pose_count: int) -> Floats:
    """Times of the poses as an array.

    Raises
    ------
    InputError
        Another number of times than poses, fewer than two, not rising, or not from 0 to 1.
    """
    times = np.asarray(t, dtype=np.float64)
    if times.ndim != 1 or len(times) != pose_count:
        raise InputError(f"{len(times)} times for {pose_count} poses")
    if len(times) < 2 or times[0] != 0.0 or times[-1] != 1.0 or not np.all(np.diff(times) > 0):
        raise InputError(f"times of the poses must rise from 0 to 1, got {np.array2string(times, threshold=12)}")
    return times


def evaluate_curves(
    curves: CurveSet,
    t: Sequence[float] | Floats,
    methods: Mapping[str, InterpolationMethod],
    diameter: float,
    counted_vertices: Booleans | None = None,
) -> Evaluation:
    """Predict all curves from their first and last pose and measure the errors in between.

    Parameters
    ----------
    curves : CurveSet
        True positions in P poses; NaN in poses that failed.
    t : (P,)
        Times of the poses, rising from 0 to 1.
    methods : mapping of name to InterpolationMethod
        K methods.
    diameter : float
        D, in the unit of the positions.
    counted_vertices : (V,) bool, optional
        Template vertices that count in the errors; predictions always use whole curves.

    Returns
    -------
    Evaluation
        A pose or curve without a value is a row with ``n_points`` 0, never left out.

    Raises
    ------
    InputError
        Times, D or a curve that a method refuses; the text names method and curve.
    """
    if not curves.curves:
        raise InputError("there are no curves to evaluate")
    times = check_pose_times(t, len(curves.positions[0]))
    check_diameter(diameter)
    counted = tuple(
        np.ones(len(curve.vertices), dtype=bool) if counted_vertices is None else counted_vertices[curve.vertices]
        for curve in curves.curves
    )
    shape = (len(methods), len(curves), len(times) - 2)
    average, maximum = np.full(shape, np.nan), np.full(shape, np.nan)
    n_points = np.zeros(shape[1:], dtype=np.int64)
    predictions: dict[str, tuple[Floats, ...]] = {}
    known = [np.atleast_1d(np.isfinite(positions).all(axis=(1, 2))) for positions in curves.positions]
    for k, (name, method) in enumerate(methods.items()):
        keys = _key_poses(name, method, times)
        given = [0, len(times) - 1, *keys.tolist()]
        predict = _predictor(method, keys, times)
        predictions[name] = tuple(
            _predict(curves, n, name, predict) if known[n][given].all() else np.full(curves.positions[n].shape, np.nan)
            for n in range(len(curves))
        )
        for n, predicted in enumerate(predictions[name]):
            errors = point_errors(predicted[1:-1], curves.positions[n][1:-1], diameter)
            average[k, n], maximum[k, n], found = average_and_maximum(errors, counted[n])
            n_points[n] = np.maximum(n_points[n], found)  # a method may lack a key pose that others do not need
        average[k][:, keys - 1] = maximum[k][:, keys - 1] = np.nan  # what a method was given is no prediction
    names = tuple(curve.name for curve in curves.curves)
    table = ErrorTable(tuple(methods), names, times[1:-1].copy(), n_points, average, maximum)
    return Evaluation(table, predictions, counted)


def _key_poses(name: str, method: InterpolationMethod, times: Floats) -> NDArray[np.int64]:
    """Indices of the poses that a method must be given besides the ends."""
    wanted = np.asarray(method.key_times if isinstance(method, KeyPoseMethod) else (), dtype=np.float64)
    nearest = np.abs(times[:, None] - wanted).argmin(axis=0) if len(wanted) else np.zeros(0, dtype=np.int64)
    missing = np.abs(times[nearest] - wanted) > 1e-9
    if missing.any():
        listed = np.array2string(times[1:-1], threshold=12)
        raise InputError(f"method '{name}': no pose at its key time {wanted[missing][0]:g}; in-between poses: {listed}")
    return np.asarray(nearest, dtype=np.int64)


def _predictor(method: InterpolationMethod, keys: NDArray[np.int64], times: Floats) -> Callable[[Floats, bool], Floats]:
    """Prediction of a curve from its true positions; what kind of method it is takes longer to ask than to predict."""
    if isinstance(method, KeyPoseMethod):
        splines = method
        return lambda positions, closed: splines.predict_with_keys(
            positions[0], positions[keys], positions[-1], closed, times
        )
    return lambda positions, closed: method.predict(positions[0], positions[-1], closed, times)


def _predict(curves: CurveSet, n: int, name: str, predict: Callable[[Floats, bool], Floats]) -> Floats:
    curve = curves.curves[n]
    try:
        return predict(curves.positions[n], curve.closed)
    except ValueError as problem:
        raise type(problem)(f"method '{name}', curve '{curve.name}': {problem}") from problem
