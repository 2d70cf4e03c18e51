"""Fits: statistics against plain sums, recovery of known parameters, and honesty about held-out poses."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from capture_eval.curves.extract import Curve, CurveSet, extract_curves
from capture_eval.errors import InputError, SolverError
from capture_eval.evaluation.fit_report import fit_report, training_poses
from capture_eval.evaluation.fitting import fit_beta, fit_dynamic_pde, fit_power
from capture_eval.evaluation.mode_statistics import add_statistics, curve_statistics
from capture_eval.interpolation.dynamic_pde import DynamicPde
from capture_eval.interpolation.method import InterpolationMethod
from capture_eval.interpolation.methods import create_method

T = np.linspace(0, 1, 11)
TRAIN = np.array([1, 3, 5, 7, 9])


def shapes(seed: int, count: int) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(2, count, 3))


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10**6), count=st.integers(3, 30), closed=st.booleans(), damping=st.floats(0, 1e4))
def test_the_cost_is_the_sum_of_squared_errors(seed: int, count: int, closed: bool, damping: float) -> None:
    truth = np.random.default_rng(seed).normal(size=(11, count, 3))
    method = DynamicPde(2, damping=damping, rigidity=2.0, closure="linear")
    try:
        predicted = method.predict(truth[0], truth[-1], closed, T[TRAIN])
    except SolverError:
        return
    statistics = curve_statistics(truth, closed, TRAIN)
    warps = method.mode_warps(count, closed, T[TRAIN])
    expected = float(((predicted - truth[TRAIN]) ** 2).sum())
    assert statistics.cost(*warps) == pytest.approx(expected, rel=1e-9, abs=1e-9)


def test_statistics_of_curves_add_up() -> None:
    rng = np.random.default_rng(3)
    truths = [(rng.normal(size=(11, count, 3)), closed) for count, closed in ((8, True), (13, True), (6, False))]
    parts = [curve_statistics(truth, closed, TRAIN) for truth, closed in truths]
    sums = add_statistics(parts)
    assert [(part.closed, part.points) for part in sums] == [(True, 21), (False, 6)]
    method = DynamicPde(3, damping=500.0, mass=3.0)
    together = sum(part.cost(*method.mode_warps(part.point_count, part.closed, T[TRAIN])) for part in sums)
    alone = sum(
        part.cost(*method.mode_warps(len(truth[0]), closed, T[TRAIN]))
        for part, (truth, closed) in zip(parts, truths, strict=True)
    )
    assert together == pytest.approx(alone, rel=1e-12)


def moved(method: InterpolationMethod, seed: int = 1) -> CurveSet:
    """Two curves, one closed, that move exactly as a method says."""
    first, second = shapes(seed, 24), shapes(seed + 1, 15)
    positions = np.concatenate(
        [method.predict(*first, True, T), method.predict(*second, False, T)],
        axis=1,
    )
    return extract_curves([Curve("ring", np.arange(24), True), Curve("line", np.arange(24, 39), False)], positions)


def statistics_of(curves: CurveSet) -> tuple:
    return add_statistics(
        curve_statistics(positions, curve.closed, TRAIN)
        for curve, positions in zip(curves.curves, curves.positions, strict=True)
    )


def test_known_parameters_are_found_again() -> None:
    for exponent in (0.7, 1.6, 3.0):
        fit = fit_power(statistics_of(moved(create_method("power", {"exponent": exponent}))), T[TRAIN])
        assert fit.method.options["exponent"] == pytest.approx(exponent, abs=1e-5)
        assert fit.train_rms < 1e-5
    fit = fit_beta(statistics_of(moved(create_method("beta", {"rise": 2.5, "settle": 1.5}))), T[TRAIN])
    assert fit.method.options["rise"] == pytest.approx(2.5, abs=1e-3)
    assert fit.method.options["settle"] == pytest.approx(1.5, abs=1e-3)
    soft = DynamicPde(3, mass=200.0, damping=2000.0, closure="linear")
    fit = fit_dynamic_pde(statistics_of(moved(soft)), T[TRAIN], orders=(2, 3), closures=("stiff", "linear"))
    assert (fit.method.options["order"], fit.method.options["closure"]) == (3, "linear")
    assert fit.method.options["damping"] == pytest.approx(2000.0, rel=0.02)
    assert fit.train_rms < 1e-3


def test_the_free_closure_has_its_best_bend_in_closed_form() -> None:
    """No other η is better, and a mode without bending that mixes t and t² is met, which no other closure does."""
    true = DynamicPde(1, mass=2.0, damping=10.0, closure="fit", closure_bend=0.7)
    statistics = statistics_of(moved(true))
    fit = fit_dynamic_pde(statistics, T[TRAIN], orders=(1,), closures=("fit",))
    assert fit.train_rms < 1e-6  # R = 1: ψ = t + η(t² − t)/2 whatever τ, so that η is found exactly
    assert fit.method.options["closure_bend"] == pytest.approx(0.7, rel=1e-6)
    others = fit_dynamic_pde(statistics, T[TRAIN], orders=(1,), closures=("stiff", "linear"))
    assert others.train_rms > 0.01

    def cost(bend: float) -> float:
        method = replace(fit.method, closure_bend=bend)
        return sum(part.cost(*method.mode_warps(part.point_count, part.closed, T[TRAIN])) for part in statistics)

    assert cost(0.7) < min(cost(0.69), cost(0.71))
    with pytest.raises(InputError, match="closure_bend = nan must be finite"):
        DynamicPde(2, closure="fit", closure_bend=np.nan)


def test_reports_state_errors_of_held_out_poses_only() -> None:
    """Training poses that are spoiled change the fit, held-out ones the errors; neither the other."""
    curves = moved(create_method("power"))
    counted = (np.ones(24, dtype=bool), np.ones(15, dtype=bool))

    def report(of: CurveSet) -> dict:
        return fit_report(of, T, 5.0, counted, TRAIN, per_curve=False, orders=(1, 2), closures=("stiff",))

    clean = report(curves)
    json.dumps(clean, allow_nan=False)
    assert clean["training_t"] == T[TRAIN].tolist()
    np.testing.assert_allclose(clean["held_out_t"], [0.2, 0.4, 0.6, 0.8])
    assert clean["ends_used"] == [0.0, 1.0]
    rows = {row["name"]: row for row in clean["rows"]}
    assert rows["t^p"]["LME"] < 1e-6
    assert rows["linear"]["train_rms"] is None
    spoiled = CurveSet(curves.curves, tuple(positions.copy() for positions in curves.positions))
    for positions in spoiled.positions:
        positions[2] += 0.5
    other = {row["name"]: row for row in report(spoiled)["rows"]}
    assert other["t^p"]["train_rms"] == rows["t^p"]["train_rms"]
    assert other["t^p"]["LAE"] == pytest.approx(0.5 * np.sqrt(3) / 5.0, rel=1e-4)


def test_curves_of_their_own_parameters() -> None:
    """A ring that moves as t and a line that moves as t³: only parameters per curve follow both."""
    first, second = moved(create_method("linear")), moved(create_method("power", {"exponent": 3.0}))
    curves = CurveSet(first.curves, (first.positions[0], second.positions[1]))
    counted = (np.ones(24, dtype=bool), np.ones(15, dtype=bool))
    found = fit_report(curves, T, 5.0, counted, TRAIN, orders=(1, 2, 3), closures=("stiff",))
    rows = {row["name"]: row for row in found["rows"]}
    assert [options["order"] for options in rows["PDE, per curve"]["options"]] == [1, 3]
    assert rows["PDE, per curve"]["rms"] < 0.05 * rows["PDE, shared parameters"]["rms"]


def test_training_poses_are_every_second_usable_one() -> None:
    ok = np.ones(11, dtype=bool)
    np.testing.assert_array_equal(training_poses(ok), [1, 3, 5, 7, 9])
    ok[[1, 4]] = False
    np.testing.assert_array_equal(training_poses(ok), [2, 5, 7, 9])
    with pytest.raises(InputError, match="at least two in-between poses"):
        training_poses(np.array([True, True, True]))


@pytest.mark.parametrize(
    ("training", "words"),
    [
        ([0, 3], "must be different in-between poses, 1 to 9"),
        ([3, 3], "must be different"),
        ([], "must be different"),
        (list(range(1, 10)), "no in-between pose is held out"),
    ],
)
def test_dishonest_fits_are_refused(training: list[int], words: str) -> None:
    counted = (np.ones(24, dtype=bool), np.ones(15, dtype=bool))
    with pytest.raises(InputError, match=re.escape(words)):
        fit_report(moved(create_method("linear")), T, 5.0, counted, training)


def test_missing_poses_are_named() -> None:
    curves = moved(create_method("linear"))
    for positions in curves.positions:
        positions[3] = np.nan
    counted = (np.ones(24, dtype=bool), np.ones(15, dtype=bool))
    with pytest.raises(InputError, match="training pose 3 is missing"):
        fit_report(curves, T, 5.0, counted, TRAIN)
    with pytest.raises(InputError, match="D, the diameter"):
        fit_report(curves, T, 0.0, counted, [1])
