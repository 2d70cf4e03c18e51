"""Similarity from point pairs of which many are wrong or move: RANSAC, then Tukey weights; never a reflection."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capture_eval.errors import InputError, RegistrationError
from capture_eval.similarity import Similarity, estimate_similarity

Floats = NDArray[np.float64]

_BATCH = 256


@dataclass(frozen=True)
class SimilarityFit:
    """A robust similarity.

    Parameters
    ----------
    target_from_source : Similarity
    inliers : (N,) bool
        Pairs nearer than the last Tukey limit.
    residual : (N,) float64
        Distance of every pair after the fit, unit of the target.
    """

    target_from_source: Similarity
    inliers: NDArray[np.bool_]
    residual: Floats

    @property
    def median_residual(self) -> float:
        """Median distance of the inliers."""
        return float(np.median(self.residual[self.inliers]))

    @property
    def root_mean_square(self) -> float:
        """Root mean square distance of the inliers."""
        return float(np.sqrt(np.mean(self.residual[self.inliers] ** 2)))


def fit_robust_similarity(
    source: Floats,
    target: Floats,
    sampling_limit: float,
    final_limit: float,
    minimum_inliers: int = 12,
    trials: int = 2000,
    seed: int = 0,
) -> SimilarityFit:
    """Similarity that the largest rigid group of pairs agrees on.

    Parameters
    ----------
    source, target : (N, 3)
        Corresponding points.
    sampling_limit : float
        Distance up to which a pair supports a sampled hypothesis, unit of the target.
    final_limit : float
        Limit at which the Tukey weights end.
    trials : int
        Samples of three pairs.

    Raises
    ------
    InputError
        Shapes that differ or limits that are not positive.
    RegistrationError
        Fewer pairs agree than `minimum_inliers`.
    """
    if source.shape != target.shape or source.ndim != 2 or source.shape[1] != 3:
        raise InputError(f"similarity: point sets {source.shape} and {target.shape}")
    if not (sampling_limit > 0 and final_limit > 0):
        raise InputError(f"similarity: limits {sampling_limit} and {final_limit} must be positive")
    if len(source) < max(minimum_inliers, 3):
        raise RegistrationError(f"similarity: {len(source)} point pairs, at least {minimum_inliers} are needed")
    support, start = _sample(source, target, sampling_limit, trials, seed)
    if support < minimum_inliers:
        raise RegistrationError(
            f"similarity: the best of {trials} samples is supported by {support} of {len(source)} pairs, "
            f"at least {minimum_inliers} are needed"
        )
    fit, residual = _tukey(source, target, start, 2.0 * sampling_limit, final_limit)
    inliers = residual < final_limit
    if np.count_nonzero(inliers) < minimum_inliers:
        raise RegistrationError(
            f"similarity: {np.count_nonzero(inliers)} of {len(source)} pairs agree to {final_limit:.3g}, "
            f"at least {minimum_inliers} are needed"
        )
    return SimilarityFit(fit, inliers, residual)


def refine_similarity(source: Floats, target: Floats, start: Similarity, limit: float) -> SimilarityFit:
    """Similarity of all pairs (N, 3) that agree with a start to within `limit` (Tukey)."""
    fit, residual = _tukey(source, target, start, limit, limit)
    return SimilarityFit(fit, residual < limit, residual)


def _sample(source: Floats, target: Floats, limit: float, trials: int, seed: int) -> tuple[int, Similarity]:
    """Hypothesis of three pairs with the largest truncated support."""
    random = np.random.default_rng(seed)
    best_cost, best_support, best = np.inf, 0, Similarity.identity()
    for _ in range(0, trials, _BATCH):
        rows = np.stack([random.choice(len(source), 3, replace=False) for _ in range(_BATCH)])
        scale, rotation, translation, usable = _batch_similarities(source[rows], target[rows])
        moved = np.einsum("hij,nj->hni", scale[:, None, None] * rotation, source) + translation[:, None, :]
        squared = np.sum((moved - target) ** 2, axis=2)
        cost = np.minimum(squared, limit**2).sum(axis=1)
        cost[~usable] = np.inf
        index = int(np.argmin(cost))
        if cost[index] < best_cost:
            best_cost = float(cost[index])
            best_support = int(np.count_nonzero(squared[index] < limit**2))
            best = Similarity(float(scale[index]), rotation[index], translation[index])
    return best_support, best


def _batch_similarities(source: Floats, target: Floats) -> tuple[Floats, Floats, Floats, NDArray[np.bool_]]:
    """Least-squares similarities (Umeyama 1991) of many small point sets (H, 3, 3) at once."""
    source_mean, target_mean = source.mean(axis=1), target.mean(axis=1)
    from_centered = source - source_mean[:, None]
    to_centered = target - target_mean[:, None]
    covariance = np.einsum("hni,hnj->hij", to_centered, from_centered)
    left, singular, right = np.linalg.svd(covariance)
    signs = np.ones_like(singular)
    signs[:, 2] = np.where(np.linalg.det(left @ right) < 0, -1.0, 1.0)
    rotation = (left * signs[:, None, :]) @ right
    spread = np.sum(from_centered**2, axis=(1, 2))
    usable = (singular[:, 1] > 1e-6 * singular[:, 0]) & (spread > 0)
    scale = np.where(usable, np.sum(singular * signs, axis=1) / np.where(spread > 0, spread, 1.0), 1.0)
    translation = target_mean - scale[:, None] * np.einsum("hij,hj->hi", rotation, source_mean)
    return scale, rotation, translation, usable & (scale > 0)


def _tukey(
    source: Floats, target: Floats, start: Similarity, first_limit: float, last_limit: float, steps: int = 12
) -> tuple[Similarity, Floats]:
    """Reweighted least squares with Tukey's biweight, its limit shrinking geometrically, then kept."""
    fit = start
    residual = np.linalg.norm(fit.apply(source) - target, axis=1)
    limits = np.concatenate([np.geomspace(first_limit, last_limit, steps), np.full(8, last_limit)])
    for limit in limits:
        weight = np.where(residual < limit, (1.0 - (residual / limit) ** 2) ** 2, 0.0)
        if np.count_nonzero(weight) < 3:
            break
        fit = estimate_similarity(source, target, weight)
        residual = np.linalg.norm(fit.apply(source) - target, axis=1)
    return fit, residual
