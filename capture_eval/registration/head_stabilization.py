"""Head stabilisation: the similarity that brings what did not deform between two registered poses to one place."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capture_eval.errors import InputError
from capture_eval.similarity import Similarity, estimate_similarity
from capture_eval.triangle_geometry import diameter

Floats = NDArray[np.float64]

# Tukey's limits of the steps as fractions of D: from the error of an alignment by features to that of the texture.
LIMITS = (0.0075, 0.005, 0.0038, 0.0025, 0.0018) + (0.00125,) * 5


@dataclass(frozen=True)
class Stabilisation:
    """Result of :func:`stabilise_head`.

    Parameters
    ----------
    neutral_from_pose : Similarity
        The identity when ``accepted`` is false.
    accepted : bool
        False when too few vertices agree on one rigid motion.
    inlier_share : float
        Of the weight of all vertices.
    residual : float
        Median distance of the inliers afterwards, fraction of D.
    """

    neutral_from_pose: Similarity
    accepted: bool
    inlier_share: float
    residual: float


def stabilise_head(pose: Floats, neutral: Floats, weight: Floats, minimum_share: float = 0.25) -> Stabilisation:
    """Find the similarity under which most of two registered poses coincide (Tukey's biweight, shrinking).

    Features align two poses to a few hundredths of a per cent of D. Registered meshes are several times better
    and compare the same skin points; most of a head does not deform, and moving parts lose their weight.

    Parameters
    ----------
    pose, neutral : (V, 3) float64
        The same vertices in nearly the same frame.
    weight : (V,) float64
        Confidence; 0 for vertices that do not count.
    minimum_share : float
        Least share of the weight that must agree.

    Raises
    ------
    InputError
        Shapes that do not fit, or fewer than ten vertices with a weight.
    """
    if pose.shape != neutral.shape or weight.shape != (len(pose),):
        raise InputError(f"stabilisation: pose {pose.shape}, neutral {neutral.shape}, weight {weight.shape}")
    used = (weight > 0) & np.all(np.isfinite(pose), axis=1) & np.all(np.isfinite(neutral), axis=1)
    if np.count_nonzero(used) < 10:
        raise InputError(
            f"stabilisation: only {np.count_nonzero(used)} vertices with confidence, at least 10 are needed"
        )
    source, target, trust = pose[used], neutral[used], weight[used]
    size = diameter(target)
    identity = Similarity(1.0, np.eye(3), np.zeros(3))
    link, robust = identity, np.zeros(len(source))
    for limit in LIMITS:
        robust = _biweight(np.linalg.norm(link.apply(source) - target, axis=1) / (limit * size))
        if np.count_nonzero(robust) < 10:
            return Stabilisation(identity, False, 0.0, float("nan"))
        link = estimate_similarity(source, target, trust * robust)
    inlier = robust > 0
    share = float(trust[inlier].sum() / trust.sum())
    residual = float(np.median(np.linalg.norm(link.apply(source[inlier]) - target[inlier], axis=1)) / size)
    if share < minimum_share:
        return Stabilisation(identity, False, share, residual)
    return Stabilisation(link, True, share, residual)


def _biweight(ratio: Floats) -> Floats:
    return np.where(ratio < 1.0, (1.0 - ratio**2) ** 2, 0.0)
