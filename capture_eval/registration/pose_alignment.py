"""One frame and one scale for all poses, from what does not move between them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capture_eval.errors import RegistrationError
from capture_eval.registration.cross_pose_matching import ObservedPoints, match_observed_points
from capture_eval.registration.robust_similarity import SimilarityFit, fit_robust_similarity
from capture_eval.similarity import Similarity


@dataclass(frozen=True)
class AlignmentOptions:
    """Limits of the alignment, in pixels at the distance of the face.

    One pixel of a 640x480 photo of a head is about .2 % of its size; slowly moving skin must stay outside of
    `final_pixels`, noise of triangulated points inside of it.
    """

    sampling_pixels: float = 1.0
    final_pixels: float = 0.5
    minimum_inliers: int = 25
    minimum_inlier_share: float = 0.12
    maximum_residual_pixels: float = 0.4
    trials: int = 4000
    seed: int = 0


@dataclass(frozen=True)
class AlignedPose:
    """Where one pose lies in the frame of the neutral.

    Parameters
    ----------
    neutral_from_pose : Similarity or None
        None for a failed pose.
    residual : float
        Root mean square of the inliers, unit of the neutral's frame; NaN when failed.
    matches, inliers : int
    through : str
        `neutral`, or the pose that the link went through.
    reason : str
        Why it failed.
    """

    neutral_from_pose: Similarity | None
    residual: float
    matches: int
    inliers: int
    through: str
    reason: str


def align_all_poses(
    poses: Sequence[ObservedPoints | None],
    options: AlignmentOptions,
    rigid: NDArray[np.bool_] | None = None,
) -> list[AlignedPose]:
    """Similarities of all poses against the first one.

    A pose that cannot be aligned to the neutral directly is tried against its aligned neighbour, there with the
    neighbour's rigid points only: between neighbours slowly moving skin would pass for rigid.

    Parameters
    ----------
    poses : sequence of ObservedPoints or None
        None for a pose without a reconstruction.
    rigid : (N,) bool, optional
        Points of the neutral on its rigid region; all others are left out.

    Raises
    ------
    RegistrationError
        The neutral itself has no reconstruction.
    """
    neutral = poses[0]
    if neutral is None:
        raise RegistrationError("alignment: the neutral pose has no reconstruction; nothing can be aligned to it")
    identity = AlignedPose(Similarity.identity(), 0.0, 0, 0, "neutral", "")
    results = [identity]
    rigid_rows: list[NDArray[np.int64]] = [np.zeros(0, dtype=np.int64)]
    limit = neutral.footprint
    for index, pose in enumerate(poses[1:], start=1):
        if pose is None:
            results.append(_failed("no reconstruction"))
            rigid_rows.append(np.zeros(0, dtype=np.int64))
            continue
        allowed = np.ones(len(neutral.points), dtype=np.bool_) if rigid is None else rigid
        result, rows = _align_one(pose, neutral, Similarity.identity(), allowed, limit, "neutral", options)
        previous = poses[index - 1]
        link = results[index - 1].neutral_from_pose
        if result.neutral_from_pose is None and index > 1 and previous is not None and link is not None:
            still = np.zeros(len(previous.points), dtype=np.bool_)
            still[rigid_rows[index - 1]] = True
            chained, chained_rows = _align_one(pose, previous, link, still, limit, f"pose {index - 1}", options)
            if chained.neutral_from_pose is not None:
                result, rows = chained, chained_rows
        results.append(result)
        rigid_rows.append(rows)
    return results


def _failed(reason: str, matches: int = 0) -> AlignedPose:
    return AlignedPose(None, float("nan"), matches, 0, "", reason)


def _align_one(
    pose: ObservedPoints,
    reference: ObservedPoints,
    neutral_from_reference: Similarity,
    allowed: NDArray[np.bool_],
    footprint: float,
    through: str,
    options: AlignmentOptions,
) -> tuple[AlignedPose, NDArray[np.int64]]:
    """Align one pose to a reference; also the rows of its points that were rigid."""
    pairs, _ = match_observed_points(reference, pose)
    pairs = pairs[allowed[pairs[:, 0]]]
    nothing = np.zeros(0, dtype=np.int64)
    try:
        fit = fit_robust_similarity(
            pose.points[pairs[:, 1]],
            neutral_from_reference.apply(reference.points[pairs[:, 0]]),
            options.sampling_pixels * footprint,
            options.final_pixels * footprint,
            options.minimum_inliers,
            options.trials,
            options.seed,
        )
    except RegistrationError as error:
        return _failed(str(error), len(pairs)), nothing
    reason = _fault(fit, len(pairs), footprint, options)
    if reason:
        return _failed(reason, len(pairs)), nothing
    aligned = AlignedPose(
        fit.target_from_source,
        fit.root_mean_square,
        len(pairs),
        int(np.count_nonzero(fit.inliers)),
        through,
        "",
    )
    return aligned, pairs[fit.inliers, 1]


def _fault(fit: SimilarityFit, matches: int, footprint: float, options: AlignmentOptions) -> str:
    share = np.count_nonzero(fit.inliers) / matches
    if share < options.minimum_inlier_share:
        return f"only {share:.0%} of {matches} matches are rigid, {options.minimum_inlier_share:.0%} are needed"
    pixels = fit.root_mean_square / footprint
    if pixels > options.maximum_residual_pixels:
        return f"rigid matches disagree by {pixels:.2f} pixels, limit {options.maximum_residual_pixels}"
    return ""
