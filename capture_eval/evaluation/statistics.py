"""What few poses can tell: bootstrap intervals, sign-flip tests, Holm's correction, detectable differences.

The unit is the pose: curves of one pose share its reconstruction and cannot be counted as separate evidence.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from capture_eval.errors import InputError

Floats = NDArray[np.float64]

SEED = 20240229
RESAMPLES = 4000
CONFIDENCE = 0.95
POWER = 0.8
_EXACT_POSES = 14  # up to so many poses all 2^n patterns of signs are tried
_RANDOM_SIGNS = 9999


def bootstrap_interval(values: ArrayLike, confidence: float = CONFIDENCE) -> tuple[float, float] | None:
    """Percentile interval of the mean over poses.

    Parameters
    ----------
    values : (P,)
        One finite value per pose.
    confidence : float
        In (0, 1).

    Returns
    -------
    (float, float) or None
        None for fewer than two poses. Seeded: equal values give equal intervals.

    Raises
    ------
    InputError
        Values that are not finite or not a list, or a confidence outside (0, 1).
    """
    sample = _sample(values)
    drawn = _resampled(len(sample), confidence)
    return None if drawn is None else _middle(drawn @ sample / len(sample), confidence)


def bootstrap_maximum_interval(values: ArrayLike, confidence: float = CONFIDENCE) -> tuple[float, float] | None:
    """Percentile interval of the largest value over poses, for LME and LAE.

    A resample holds no larger error than was seen, so that the upper end is at most the figure itself: the interval
    tells how far the figure hangs on single poses, and cannot tell how large errors of other poses would be.

    Parameters, returns and errors are those of `bootstrap_interval`.
    """
    sample = _sample(values)
    drawn = _resampled(len(sample), confidence)
    if drawn is None:
        return None
    return _middle(np.where(drawn > 0, sample, -np.inf).max(axis=1), confidence)


def _resampled(count: int, confidence: float) -> NDArray[np.int64] | None:
    """How often every pose is drawn in every resample, (RESAMPLES, P)."""
    if not 0.0 < confidence < 1.0:
        raise InputError(f"confidence {confidence} must be in (0, 1)")
    if count < 2:
        return None
    return np.random.default_rng(SEED).multinomial(count, np.full(count, 1.0 / count), size=RESAMPLES)


def _middle(values: Floats, confidence: float) -> tuple[float, float]:
    low, high = np.quantile(values, [0.5 - confidence / 2, 0.5 + confidence / 2])
    return float(low), float(high)


def sign_flip_test(differences: ArrayLike) -> float:
    """Two-sided p of paired differences under the hypothesis that their signs are chance.

    Exact over all 2^P patterns of signs up to 14 poses, else 9,999 seeded random ones besides the observed. The
    smallest attainable value is 2^(1 − P).

    Raises
    ------
    InputError
        Values that are not finite, or none.
    """
    sample = _sample(differences)
    count = len(sample)
    if count == 0:
        raise InputError("a sign-flip test needs at least one difference")
    if count <= _EXACT_POSES:
        patterns = 1.0 - 2.0 * ((np.arange(2**count)[:, None] >> np.arange(count)) & 1)
    else:
        patterns = np.random.default_rng(SEED).choice([-1.0, 1.0], size=(_RANDOM_SIGNS + 1, count))
        patterns[0] = 1.0
    flipped = np.abs(patterns @ sample)
    return float(np.mean(flipped >= flipped[0] * (1.0 - 1e-12)))


def holm_correction(p_values: ArrayLike) -> Floats:
    """p values corrected for their number by Holm's step-down rule, in the given order.

    Raises
    ------
    InputError
        Values outside [0, 1].
    """
    raw = _sample(p_values)
    if np.any((raw < 0) | (raw > 1)):
        raise InputError("p values must be in [0, 1]")
    order = np.argsort(raw, kind="stable")
    stepped = np.maximum.accumulate(raw[order] * np.arange(len(raw), 0, -1))
    corrected = np.empty_like(raw)
    corrected[order] = np.minimum(stepped, 1.0)
    return corrected


def minimum_detectable_difference(
    differences: ArrayLike, noise_floor: float | None, confidence: float = CONFIDENCE, power: float = POWER
) -> float | None:
    """The least mean difference that such data would show.

    The larger of two: what the scatter of the differences between poses allows at the given confidence and power
    (paired t test), and the noise floor of the ground truth, whose systematic part no number of poses averages out.

    Parameters
    ----------
    differences : (P,)
        Paired differences.
    noise_floor : float, optional
        Mean error of what does not move, in the same unit.
    confidence, power : float
        In (0, 1).

    Returns
    -------
    float or None
        None for fewer than two poses.

    Raises
    ------
    InputError
        Values that are not finite.
    """
    from scipy.stats import t as student

    sample = _sample(differences)
    count = len(sample)
    if count < 2:
        return None
    quantiles = float(student.ppf(0.5 + confidence / 2, count - 1)) + float(student.ppf(power, count - 1))
    scatter = quantiles * float(sample.std(ddof=1)) / float(np.sqrt(count))
    return max(scatter, noise_floor or 0.0)


def _sample(values: ArrayLike) -> Floats:
    sample = np.asarray(values, dtype=np.float64)
    if sample.ndim != 1 or not np.isfinite(sample).all():
        raise InputError(f"statistics need a list of finite numbers, got {np.array2string(sample, threshold=6)}")
    return sample
