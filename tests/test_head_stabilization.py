"""Head stabilisation: the rigid part decides, moving parts do not."""

import numpy as np
import pytest

from capture_eval.errors import InputError
from capture_eval.registration.head_stabilization import stabilise_head
from capture_eval.similarity import Similarity


def _head(seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-100.0, 100.0, (800, 3))


def _small_motion() -> Similarity:
    angle = 1e-3
    turn = np.array([[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]])
    return Similarity(1.0006, turn, np.array([0.08, -0.05, 0.1]))


def test_a_turning_jaw_does_not_pull_the_skull() -> None:
    neutral = _head()
    moved = neutral.copy()
    jaw = neutral[:, 1] < -30.0  # a third of the vertices, by up to several units, slowly growing from the hinge
    moved[jaw, 2] += 0.1 * (-30.0 - neutral[jaw, 1])
    motion = _small_motion()
    result = stabilise_head(motion.apply(moved), neutral, np.ones(800))
    assert result.accepted
    back = result.neutral_from_pose.apply(motion.apply(moved))
    # Vertices beside the hinge move by less than the last limit (0.4 units) and pull a little.
    assert np.linalg.norm(back - moved, axis=1).max() < 0.02
    assert 0.6 < result.inlier_share < 0.75


def test_noise_averages_out() -> None:
    neutral, motion = _head(), _small_motion()
    noisy = motion.apply(neutral) + np.random.default_rng(1).normal(0.0, 0.05, neutral.shape)
    result = stabilise_head(noisy, neutral, np.ones(800))
    error = np.linalg.norm(result.neutral_from_pose.apply(motion.apply(neutral)) - neutral, axis=1)
    # Seven parameters from 2400 numbers with 0.05 units of noise: about 0.05 sqrt(7 / 800).
    assert np.sqrt(np.mean(error**2)) < 0.01


def test_heads_without_a_common_part_are_left_alone() -> None:
    result = stabilise_head(_head(1), _head(2), np.ones(800))
    assert not result.accepted
    assert result.neutral_from_pose.scale == 1.0
    np.testing.assert_array_equal(result.neutral_from_pose.translation, np.zeros(3))


def test_vertices_without_confidence_or_place_do_not_count() -> None:
    neutral, motion = _head(), _small_motion()
    pose = motion.apply(neutral)
    weight = np.ones(800)
    pose[:500] += 0.5
    weight[:500] = 0.0
    pose[500:520] = np.nan
    result = stabilise_head(pose, neutral, weight)
    np.testing.assert_allclose(result.neutral_from_pose.apply(pose[520:]), neutral[520:], atol=1e-9)
    assert result.inlier_share == 1.0


def test_bad_input_is_refused() -> None:
    with pytest.raises(InputError, match="stabilisation"):
        stabilise_head(np.zeros((5, 3)), np.zeros((6, 3)), np.ones(5))
    with pytest.raises(InputError, match="only 0 vertices"):
        stabilise_head(np.zeros((20, 3)), np.zeros((20, 3)), np.zeros(20))
