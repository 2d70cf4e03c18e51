"""Splines in time through key poses, and that an evaluation never counts what a method was given."""

import re

import numpy as np
import pytest

from capture_eval.curves.extract import Curve, CurveSet, extract_curves
from capture_eval.errors import InputError
from capture_eval.evaluation.error_table import evaluate_curves
from capture_eval.evaluation.summary import summarise
from capture_eval.interpolation.method import KeyPoseMethod
from capture_eval.interpolation.methods import create_method, create_methods

T = np.linspace(0, 1, 11)
KINDS = ("catmull_rom", "b_spline")


def keyed(kind: str, *times: float) -> KeyPoseMethod:
    method = create_method(kind, {"times": list(times)})
    assert isinstance(method, KeyPoseMethod)
    return method


@pytest.mark.parametrize("kind", KINDS)
def test_all_given_poses_are_met(kind: str) -> None:
    poses = np.random.default_rng(1).normal(size=(5, 7, 3))
    method = keyed(kind, 0.2, 0.3, 0.7)
    found = method.predict_with_keys(poses[0], poses[1:-1], poses[-1], True, [0.0, 0.2, 0.3, 0.7, 1.0])
    np.testing.assert_allclose(found, poses, atol=1e-13)


@pytest.mark.parametrize(("kind", "degree"), [("catmull_rom", 1), ("b_spline", 3)])
def test_polynomials_in_time_are_kept(kind: str, degree: int) -> None:
    """The B-spline is exact for cubics; uneven Catmull-Rom for straight even motion."""
    powers = np.random.default_rng(2).normal(size=(degree + 1, 4, 3))

    def at(t: np.ndarray) -> np.ndarray:
        return np.tensordot(np.power.outer(np.asarray(t), np.arange(degree + 1)), powers, axes=1)

    method = keyed(kind, 0.25, 0.4, 0.8)
    found = method.predict_with_keys(at(0.0), at([0.25, 0.4, 0.8]), at(1.0), False, T)
    np.testing.assert_allclose(found, at(T), atol=1e-12)


def test_catmull_rom_by_hand() -> None:
    """Through 0, 1, 0 at t = 0, ½, 1 the velocities are 2, 0 and −2."""
    shapes = [np.full((2, 3), value) for value in (0.0, 1.0, 0.0)]
    found = keyed("catmull_rom", 0.5).predict_with_keys(shapes[0], shapes[1:2], shapes[2], False, [0.25])
    # Hermite at the middle of an interval of length h: (p0 + p1)/2 + h (v0 − v1)/8 = ½ + ½·2/8
    np.testing.assert_allclose(found, 0.625)


def turning(t: np.ndarray) -> CurveSet:
    """A ring on a hinge, turning evenly."""
    rng = np.random.default_rng(3)
    start = rng.normal(size=(20, 3))
    angle = np.deg2rad(25) * t[:, None]
    moved = np.repeat(start[None], len(t), axis=0)
    moved[..., 0] = start[:, 0] * np.cos(angle) - start[:, 1] * np.sin(angle)
    moved[..., 1] = start[:, 0] * np.sin(angle) + start[:, 1] * np.cos(angle)
    return extract_curves([Curve("ring", np.arange(20), True)], moved)


def test_a_pose_in_the_middle_takes_most_of_the_error_and_is_not_counted() -> None:
    """The bend, which no timing of straight paths can remove. Its own pose is no prediction."""
    curves = turning(T)
    methods = create_methods([("linear", {}), ("power", {}), ("b_spline", {"times": [0.5]})])
    found = evaluate_curves(curves, T, methods, 2.0)
    assert np.isnan(found.table.average[2, :, 4]).all()
    assert np.isfinite(found.table.average[:2]).all()
    rows = [row for row in found.table.rows() if row[0] == "b_spline"]
    assert [row[3] for row in rows] == [20, 20, 20, 20, 0, 20, 20, 20, 20]
    summary = summarise(found, curves, methods, 2.0, np.ones(11, dtype=bool), "all")
    spline = summary["methods"]["b_spline"]
    assert spline["key_times"] == [0.5]
    assert "best_fit_time" not in spline
    assert spline["LME"] < 0.1 * summary["methods"]["linear"]["LME"]
    assert spline["rms"] ** 2 == pytest.approx(spline["rms_timing"] ** 2 + spline["rms_path"] ** 2)
    pairs = {(pair["first"], pair["second"]): pair["poses"] for pair in summary["statistics"]["pairs"]}
    assert (pairs["linear", "power"], pairs["linear", "b_spline"]) == (9, 8)
    assert any("which other methods must predict" in line for line in spline["warnings"])


def test_a_missing_key_pose_leaves_the_other_methods_alone() -> None:
    curves = turning(T)
    curves.positions[0][5] = np.nan
    methods = create_methods([("linear", {}), ("catmull_rom", {"times": [0.5]})])
    table = evaluate_curves(curves, T, methods, 2.0).table
    assert np.isnan(table.average[1]).all()
    assert np.isfinite(table.average[0]).sum() == 8
    assert table.n_points[0].tolist() == [20, 20, 20, 20, 0, 20, 20, 20, 20]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"times": [0.5, 0.5]}, "must rise inside (0, 1)"),
        ({"times": [0.0]}, "must rise inside (0, 1)"),
        ({"times": [1.5]}, "must rise inside (0, 1)"),
    ],
)
def test_bad_key_times_are_refused(options: dict[str, object], words: str) -> None:
    with pytest.raises(InputError, match=re.escape(words)):
        create_method("b_spline", options)


def test_key_times_without_a_pose_are_refused() -> None:
    with pytest.raises(InputError, match=r"method 'b_spline': no pose at its key time 0\.45"):
        evaluate_curves(turning(T), T, create_methods([("b_spline", {"times": [0.45]})]), 2.0)
    with pytest.raises(InputError, match="key poses must be finite and of shape"):
        keyed("b_spline", 0.5).predict_with_keys(np.zeros((3, 3)), np.zeros((2, 3, 3)), np.ones((3, 3)), True, T)
