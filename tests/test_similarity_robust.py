"""Robust similarities: outliers, moving points, mirror images; matching by descriptors."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from capture_eval.errors import InputError, RegistrationError
from capture_eval.registration.cross_pose_matching import (
    ObservedPoints,
    match_observed_points,
    mutual_matches,
)
from capture_eval.registration.landmark_triangulation import landmark_similarity
from capture_eval.registration.pose_alignment import AlignmentOptions, align_all_poses
from capture_eval.registration.robust_similarity import fit_robust_similarity
from capture_eval.similarity import Similarity

Floats = NDArray[np.float64]


def _rotation(random: np.random.Generator) -> Floats:
    left, _, right = np.linalg.svd(random.normal(size=(3, 3)))
    rotation = left @ right
    return rotation * np.linalg.det(rotation)


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 10_000), scale=st.floats(0.2, 5.0))
def test_forty_percent_outliers_change_nothing(seed: int, scale: float) -> None:
    random = np.random.default_rng(seed)
    source = random.normal(size=(200, 3))
    true = Similarity(scale, _rotation(random), random.normal(size=3))
    target = true.apply(source)
    wrong = random.permutation(200)[:80]
    target[wrong] += scale * random.normal(size=(80, 3)) + 0.2 * scale
    fit = fit_robust_similarity(source, target, 0.02 * scale, 0.01 * scale, seed=seed)
    # right pairs are exact, so the fit is too, to rounding
    np.testing.assert_allclose(fit.target_from_source.apply(source), true.apply(source), atol=1e-9 * scale)
    assert np.all(fit.inliers[np.setdiff1d(np.arange(200), wrong)])


def test_the_rigid_majority_wins_over_slowly_turning_points() -> None:
    random = np.random.default_rng(5)
    source = random.uniform(-100, 100, (400, 3))
    moving = source[:, 1] < -30
    pivot = np.array([0.0, 30.0, 0.0])
    angle = np.radians(25)
    turn = np.array([[1, 0, 0], [0, np.cos(angle), -np.sin(angle)], [0, np.sin(angle), np.cos(angle)]])
    target = np.where(moving[:, None], (source + pivot) @ turn.T - pivot, source)
    target = target + 0.1 * random.normal(size=target.shape)
    fit = fit_robust_similarity(source, target, 0.6, 0.5)
    still = ~moving
    error = np.linalg.norm(fit.target_from_source.apply(source[still]) - source[still], axis=1)
    # noise of .1 in each of ~260 points leaves hundredths in six parameters
    assert error.max() < 0.05


def test_a_mirror_image_is_refused() -> None:
    source = np.random.default_rng(0).normal(size=(100, 3))
    with pytest.raises(RegistrationError, match="supported by"):
        fit_robust_similarity(source, source * [-1, 1, 1], 0.02, 0.01)


def test_mirrored_landmarks_are_named_as_such() -> None:
    random = np.random.default_rng(1)
    template = random.normal(size=(12, 3)) * [40, 60, 25]
    names = [f"landmark {index}" for index in range(12)]
    true = Similarity(0.01, _rotation(random), np.array([1.0, 2.0, 3.0]))
    scan = true.inverse().apply(template)
    fit, residual = landmark_similarity(scan, template, names)
    np.testing.assert_allclose(fit.apply(scan), template, atol=1e-9)
    assert residual.max() < 1e-9
    with pytest.raises(RegistrationError, match="left and right are swapped"):
        landmark_similarity(scan, template * [-1, 1, 1], names)
    with pytest.raises(InputError, match="at least 4"):
        landmark_similarity(scan[:3], template[:3], names[:3])


def test_one_wrong_landmark_does_not_turn_the_head() -> None:
    random = np.random.default_rng(2)
    template = random.normal(size=(14, 3)) * [40, 60, 25]
    scan = template.copy()
    scan[4] += [60.0, 0.0, 0.0]
    fit, residual = landmark_similarity(scan, template, [str(index) for index in range(14)])
    others = np.arange(14) != 4
    assert np.argmax(residual) == 4
    # a landmark off by the size of the face moves the others by under 2 % of it, not by 1/14 of its error and a tilt
    assert np.linalg.norm(fit.apply(scan[others]) - template[others], axis=1).max() < 1.2


def test_bad_input_is_named() -> None:
    points = np.zeros((10, 3))
    with pytest.raises(InputError, match="point sets"):
        fit_robust_similarity(points, points[:5], 0.1, 0.1)
    with pytest.raises(InputError, match="positive"):
        fit_robust_similarity(points, points, 0.0, 0.1)
    with pytest.raises(RegistrationError, match="at least 12"):
        fit_robust_similarity(points, points, 0.1, 0.1)


def _descriptors(random: np.random.Generator, count: int) -> NDArray[np.float32]:
    values = np.abs(random.normal(size=(count, 32))).astype(np.float32)
    return np.asarray(values / np.linalg.norm(values, axis=1, keepdims=True), dtype=np.float32)


def test_mutual_matches_find_a_permutation_and_refuse_doubles() -> None:
    random = np.random.default_rng(3)
    first = _descriptors(random, 1500)  # more than one block
    order = random.permutation(1500)
    matches = mutual_matches(first, first[order], ratio=0.8)
    assert len(matches) == 1500
    np.testing.assert_array_equal(order[matches[:, 1]], matches[:, 0])
    doubled = np.concatenate([first[:5], first[:5]])
    assert len(mutual_matches(first[:5], doubled)) == 0  # two equal candidates: no clear best
    groups = np.tile(np.arange(5), 2)
    grouped = mutual_matches(first[:5], doubled, second_groups=groups)
    np.testing.assert_array_equal(groups[grouped[:, 1]], grouped[:, 0])


def _observed(points: Floats, descriptors: NDArray[np.float32]) -> ObservedPoints:
    return ObservedPoints(points, descriptors, np.arange(len(points)), footprint=0.01)


def test_poses_are_aligned_through_their_neighbour_when_the_neutral_is_too_different() -> None:
    random = np.random.default_rng(4)
    base = random.normal(size=(300, 3))
    names = _descriptors(random, 600)
    true = Similarity(1.3, _rotation(random), np.array([0.5, 0.0, 2.0]))
    neutral = _observed(base, names[:300])
    middle = _observed(true.inverse().apply(base), names[:300])
    # the last pose shares no descriptor with the neutral, half of them with the middle pose
    both = ObservedPoints(
        middle.points,
        np.concatenate([names[:300], names[300:]]),
        np.concatenate([np.arange(300), np.arange(300)]),
        0.01,
    )
    last = _observed(base, names[300:])
    results = align_all_poses([neutral, both, last, None], AlignmentOptions())
    assert [result.through for result in results] == ["neutral", "neutral", "pose 1", ""]
    link = results[1].neutral_from_pose
    assert link is not None
    np.testing.assert_allclose(link.apply(middle.points), base, atol=1e-9)
    assert results[3].neutral_from_pose is None
    assert results[3].reason == "no reconstruction"


def test_a_stranger_is_a_failed_row() -> None:
    random = np.random.default_rng(6)
    neutral = _observed(random.normal(size=(200, 3)), _descriptors(random, 200))
    stranger = _observed(random.normal(size=(200, 3)), _descriptors(random, 200))
    result = align_all_poses([neutral, stranger], AlignmentOptions())[1]
    assert result.neutral_from_pose is None
    assert "pairs" in result.reason


def test_a_point_is_matched_once() -> None:
    random = np.random.default_rng(7)
    names = _descriptors(random, 40)
    points = random.normal(size=(20, 3))
    first = ObservedPoints(points, names, np.tile(np.arange(20), 2), 0.01)
    pairs, votes = match_observed_points(first, first)
    np.testing.assert_array_equal(pairs[:, 0], pairs[:, 1])
    assert len(pairs) == 20
    assert votes.sum() == 40
