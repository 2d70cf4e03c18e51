"""Statistics over poses by hand and against scipy; verdicts for pairs of methods; errors at best-fitting moments."""

import json
import re

import numpy as np
import pytest
from scipy import stats

from capture_eval.curves.extract import Curve, CurveSet, extract_curves
from capture_eval.errors import InputError
from capture_eval.evaluation.best_fit_time import best_fit_rows, best_fit_times
from capture_eval.evaluation.error_table import ErrorTable, evaluate_curves
from capture_eval.evaluation.method_comparison import CAVEAT, compare_methods
from capture_eval.evaluation.oracles import evaluate_oracles
from capture_eval.evaluation.statistics import (
    bootstrap_interval,
    bootstrap_maximum_interval,
    holm_correction,
    minimum_detectable_difference,
    sign_flip_test,
)
from capture_eval.interpolation.methods import create_method, create_methods
from capture_eval.report.method_intervals import interval_table
from capture_eval.report.pair_verdicts import pair_sentence, pair_table
from capture_eval.report.tables import to_markdown


def test_sign_flips_by_hand() -> None:
    """Two of the 2^n patterns reach the observed sum when all differences have one sign."""
    assert sign_flip_test([1.0, 2.0, 3.0]) == 2 / 8
    assert sign_flip_test([0.2] * 9) == 2 / 512
    assert sign_flip_test([3.0, -1.0]) == 1.0  # sums ±2, ±4: none is smaller than 2
    assert sign_flip_test([3.0, 1.0, -1.0]) == 6 / 8  # |sums| 3 3 5 1 1 5 3 3 against 3
    assert sign_flip_test([0.0, 0.0]) == 1.0


def test_sign_flips_match_scipy_and_random_signs_match_exact_ones() -> None:
    rng = np.random.default_rng(1)
    few = rng.normal(0.4, 1.0, 10)
    reference = stats.permutation_test(
        (few,), lambda x, axis: x.mean(axis=axis), permutation_type="samples", n_resamples=np.inf, vectorized=True
    )
    assert sign_flip_test(few) == pytest.approx(reference.pvalue, abs=1e-12)
    many = rng.normal(0.4, 1.0, 30)
    normal = 2 * stats.norm.sf(abs(many.sum()) / np.sqrt((many**2).sum()))
    assert sign_flip_test(many) == pytest.approx(normal, abs=0.01)  # 10,000 patterns, and a normal approximation
    assert sign_flip_test(many) == sign_flip_test(many)


def test_sign_flips_keep_their_level() -> None:
    """Without any difference p ≤ 0.05 occurs in at most 5 % of the cases, up to the scatter of 400 draws."""
    rng = np.random.default_rng(3)
    found = np.array([sign_flip_test(rng.normal(size=9)) for _ in range(400)])
    assert np.mean(found <= 0.05) <= 0.05 + 3 * np.sqrt(0.05 * 0.95 / 400)


def test_holm_by_hand() -> None:
    np.testing.assert_allclose(holm_correction([0.01, 0.04, 0.03]), [0.03, 0.06, 0.06])
    np.testing.assert_allclose(holm_correction([0.5, 0.6]), [1.0, 1.0])
    assert len(holm_correction([])) == 0


def test_bootstrap_covers_the_mean() -> None:
    """Percentile intervals of 20 normal values hold the mean about 93 times of 100."""
    rng = np.random.default_rng(2)
    hits = 0
    for _ in range(200):
        low, high = bootstrap_interval(rng.normal(size=20))  # type: ignore[misc]
        hits += low <= 0 <= high
    assert 0.86 <= hits / 200 <= 0.98
    assert bootstrap_interval([1.0]) is None
    assert bootstrap_interval([2.0, 2.0]) == (2.0, 2.0)


def test_intervals_of_largest_errors_end_at_what_was_seen() -> None:
    """Of 9 poses the worst is in a resample with probability 1 − (8/9)⁹ = 0.65, one of the worst two with 0.896, of
    the worst three with 0.974 and of the worst four with 0.995: the lower 2.5 % end is the fourth or third largest."""
    values = np.arange(1.0, 10.0)
    assert bootstrap_maximum_interval(values) in ((6.0, 9.0), (7.0, 9.0))
    assert bootstrap_maximum_interval([3.0]) is None
    one = bootstrap_maximum_interval([1.0] * 8 + [5.0])
    assert one == (1.0, 5.0)  # a figure that hangs on a single pose


def test_every_method_has_intervals_of_mean_lae_and_lme_by_pose() -> None:
    average = np.full((2, 2, 9), 0.01)
    average[0, 1] += 0.001 * np.arange(9)
    average[0, 1, 8] = np.nan  # LAE comes from the pose before; the other curve keeps this pose
    average[1] = np.nan
    found = compare_methods(table(average), None)
    first, second = found["methods"].values()
    assert (first["poses"], first["LAE"], first["LME"]) == (9, pytest.approx(0.017), pytest.approx(0.034))
    assert first["LAE_interval"][1] == first["LAE"]
    assert first["LAE_interval"][0] >= 0.01
    np.testing.assert_allclose(first["LME_interval"], 2 * np.array(first["LAE_interval"]))
    assert second == {"poses": 0} | dict.fromkeys(
        ("mean_E_A", "LAE", "LME", "interval", "LAE_interval", "LME_interval")
    )
    text = to_markdown(interval_table(found, {"m0": "linear"}))
    assert "| linear | 9" in text
    assert "1.700" in text
    assert interval_table({"methods": {"old": {"poses": 3}}}, {}).rows == ()


def test_least_detectable_difference() -> None:
    sample = [1.0, 2.0, 3.0, 4.0]
    quantiles = stats.t.ppf(0.975, 3) + stats.t.ppf(0.8, 3)
    expected = quantiles * np.std(sample, ddof=1) / 2
    assert minimum_detectable_difference(sample, None) == pytest.approx(expected)
    assert minimum_detectable_difference(sample, 50.0) == 50.0
    assert minimum_detectable_difference([1.0], 0.1) is None


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: bootstrap_interval([1.0, np.nan]), "list of finite numbers"),
        (lambda: bootstrap_interval([1.0, 2.0], 1.5), "confidence 1.5"),
        (lambda: sign_flip_test([]), "at least one difference"),
        (lambda: holm_correction([1.5]), "in [0, 1]"),
    ],
)
def test_bad_samples_are_refused(call: object, words: str) -> None:
    with pytest.raises(InputError, match=re.escape(words)):
        call()  # type: ignore[operator]


def table(average: np.ndarray) -> ErrorTable:
    """Errors (methods, curves, poses)."""
    methods, curves, poses = average.shape
    names = tuple(f"m{k}" for k in range(methods)), tuple(f"c{n}" for n in range(curves))
    t = np.arange(1, poses + 1) / (poses + 1)
    return ErrorTable(*names, t, np.full((curves, poses), 5), average, 2 * average)


def test_verdicts_and_their_reasons() -> None:
    rng = np.random.default_rng(4)
    base = 0.010 + 0.001 * rng.random((3, 9))
    mixed = base + 0.002 * np.where(np.arange(9) % 2, 1, -1)
    found = compare_methods(table(np.stack([base, base + 0.004, base, base + 0.0001, mixed])), 0.0005)
    json.dumps(found, allow_nan=False)
    verdicts = {(pair["first"], pair["second"]): (pair["verdict"], pair["reason"]) for pair in found["pairs"]}
    assert verdicts["m0", "m1"] == ("better", None)
    assert verdicts["m1", "m2"] == ("worse", None)
    assert verdicts["m0", "m2"] == ("not resolved", "equal")
    assert verdicts["m0", "m3"] == ("not resolved", "noise")
    assert verdicts["m0", "m4"] == ("not resolved", "significance")
    assert found["caveat"] == CAVEAT
    pair = found["pairs"][0]
    assert pair["difference"] == pytest.approx(-0.004)
    assert pair["p"] == 2 / 512
    assert pair["minimum_detectable"] == 0.0005
    assert found == compare_methods(table(np.stack([base, base + 0.004, base, base + 0.0001, mixed])), 0.0005)


def test_few_poses_resolve_nothing() -> None:
    found = compare_methods(table(np.array([[[0.1, 0.1]], [[0.9, 0.9]]])), None)
    assert (found["pairs"][0]["verdict"], found["pairs"][0]["reason"]) == ("not resolved", "few poses")
    empty = compare_methods(table(np.full((2, 1, 2), np.nan)), None)["pairs"][0]
    assert (empty["difference"], empty["verdict"], empty["reason"]) == (None, "not resolved", "few poses")
    assert "no pose has values of both" in pair_sentence(empty, {})


def test_pairs_use_the_poses_that_both_have() -> None:
    average = np.full((2, 1, 6), 0.1)
    average[1] = 0.2
    average[0, 0, :2] = np.nan
    average[1, 0, 5] = 99.0
    average[0, 0, 5] = np.nan
    pair = compare_methods(table(average), None)["pairs"][0]
    assert (pair["poses"], pair["difference"]) == (3, pytest.approx(-0.1))


def test_sentences_say_what_a_reader_needs() -> None:
    base = 0.010 + 0.001 * np.random.default_rng(4).random((3, 9))
    found = compare_methods(table(np.stack([base, base + 0.004, base])), 0.0005)
    titles = {"m0": "linear", "m1": "PDE cubic"}
    # the third method equals the first: one hypothesis, not two
    first, second, _ = (pair_sentence(pair, titles) for pair in found["pairs"])
    assert first.startswith("linear is better than PDE cubic (mean error 1.")
    assert "difference -0.4 %" in first
    assert "p = 0.0039 after Holm's correction, 9 poses; differences from 0.05 % could be seen" in first
    assert second.startswith("linear and m2: not resolved, they give the same errors")
    text = to_markdown(pair_table(found, titles))
    assert "| linear    | better               | PDE cubic |" in text


def arcs(share: np.ndarray, poses: int = 11) -> CurveSet:
    """Two curves turning about an axis, by ``share`` of a quarter of a right angle."""
    rng = np.random.default_rng(6)
    start = rng.normal(size=(20, 3))
    angle = np.deg2rad(22.5) * share[:, None]
    turned = np.stack(
        [
            start[:, 0] * np.cos(angle) - start[:, 1] * np.sin(angle),
            start[:, 0] * np.sin(angle) + start[:, 1] * np.cos(angle),
            np.repeat(start[None, :, 2], poses, axis=0),
        ],
        axis=-1,
    )
    return extract_curves([Curve("a", np.arange(12), True), Curve("b", np.arange(12, 20), False)], turned)


def test_best_fitting_moments_undo_any_timing() -> None:
    """Truth walked as t² is found by linear at t² (sin(θ t²/2) cos(θ(1 − t²)/2)/sin(θ/2) for an arc), and by the
    quadratic PDE at t; what is left is the bend, for both and for the oracle with a shared timing."""
    t = np.linspace(0, 1, 11)
    curves = arcs(t**2)
    counted = tuple(np.ones(len(curve.vertices), dtype=bool) for curve in curves.curves)
    theta = np.deg2rad(22.5)
    best = np.sin(theta * t**2 / 2) * np.cos(theta * (1 - t**2) / 2) / np.sin(theta / 2)
    found = best_fit_times(curves, create_method("linear"), counted)
    np.testing.assert_allclose(found, best[1:-1], atol=1e-10)
    np.testing.assert_allclose(best_fit_times(curves, create_method("power"), counted), t[1:-1], atol=2e-3)
    rows = best_fit_rows(curves, create_methods([("linear", {}), ("power", {})]), 1.0, counted)
    oracle = evaluate_oracles(curves, t, 1.0, counted).table.average[0]
    assert rows["linear"]["mean_E_A"] == pytest.approx(oracle.mean(), rel=1e-6)
    assert rows["power"]["mean_E_A"] == pytest.approx(oracle.mean(), rel=1e-3)
    nominal = evaluate_curves(curves, t, create_methods([("linear", {})]), 1.0).table.average
    assert rows["linear"]["mean_E_A"] < 0.2 * nominal.mean()


def test_best_fitting_moments_survive_missing_poses() -> None:
    t = np.linspace(0, 1, 11)
    curves = arcs(t)
    for positions in curves.positions:
        positions[4] = np.nan
    counted = tuple(np.ones(len(curve.vertices), dtype=bool) for curve in curves.curves)
    found = best_fit_times(curves, create_method("linear"), counted)
    assert np.isnan(found[3])
    assert np.isfinite(np.delete(found, 3)).all()
    row = best_fit_rows(curves, create_methods([("linear", {})]), 1.0, counted)["linear"]
    assert row["times"][3] is None
    json.dumps(row, allow_nan=False)
    for positions in curves.positions:
        positions[0] = np.nan
    row = best_fit_rows(curves, create_methods([("linear", {})]), 1.0, counted)["linear"]
    assert row["LME"] is None
    assert set(row["times"]) == {None}
