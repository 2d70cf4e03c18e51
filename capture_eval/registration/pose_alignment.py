"""One frame and one scale for all poses, from what does not move between them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from capture_eval.errors import RegistrationError
from capture_eval.registration.cross_pose_matching import ObservedPoints, match_observed_points
from capture_eval.registration.joint_similarity import PointLink, solve_jointly
from capture_eval.registration.robust_similarity import SimilarityFit, fit_robust_similarity, refine_similarity
from capture_eval.similarity import Similarity

NEIGHBOURS = 2  # poses farther apart are compared through the neutral only


@dataclass(frozen=True)
class AlignmentOptions:
    """Limits of the alignment, in pixels at the distance of the face.

    One pixel of a 640x480 photo of a head is about .2 % of its size; slowly moving skin must stay outside of
    `final_pixels`, noise of triangulated points inside of it. `joint` adjusts all poses to all pairs of poses.
    """

    sampling_pixels: float = 1.0
    final_pixels: float = 0.5
    minimum_inliers: int = 25
    minimum_inlier_share: float = 0.12
    maximum_residual_pixels: float = 0.4
    trials: int = 4000
    seed: int = 0
    joint: bool = True


@dataclass(frozen=True)
class AlignedPose:
    """Where one pose lies in the frame of the neutral.

    Parameters
    ----------
    neutral_from_pose : Similarity or None
        None for a failed pose.
    residual : float
        Root mean square of the inliers of all comparisons that the pose took part in, unit of the neutral's frame;
        NaN when failed.
    matches, inliers : int
    through : str
        `neutral`, or the pose that the link went through, or `rig`.
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
    """Similarities of all poses against the first one, solved together.

    Every pose starts from its own comparison with the neutral, which tells the rigid points from the moving ones.
    A pose that cannot be aligned to the neutral directly is tried against its aligned neighbour, there with the
    neighbour's rigid points only: between neighbours slowly moving skin would pass for rigid. At the end the rigid
    points of all poses are compared pair by pair, and all similarities are adjusted to all pairs at once.

    Parameters
    ----------
    poses : sequence of ObservedPoints or None
        None for a pose without a reconstruction.
    rigid : (N,) bool, optional
        Points of the neutral on its rigid region. They decide; of the others those take part in the end that did not
        move with respect to them (three times as many points: the error of the similarity falls to less than half).

    Raises
    ------
    RegistrationError
        The neutral itself has no reconstruction.
    """
    neutral = poses[0]
    if neutral is None:
        raise RegistrationError("alignment: the neutral pose has no reconstruction; nothing can be aligned to it")
    results = [AlignedPose(Similarity.identity(), 0.0, 0, 0, "neutral", "")]
    own_links: list[_RigidPairs | None] = [None]
    limit = neutral.footprint
    for index, pose in enumerate(poses[1:], start=1):
        if pose is None:
            results.append(_failed("no reconstruction"))
            own_links.append(None)
            continue
        allowed = np.ones(len(neutral.points), dtype=np.bool_) if rigid is None else rigid
        start, grow = Similarity.identity(), rigid is not None
        result, rows = _align_one(pose, neutral, start, allowed, limit, "neutral", options, grow)
        found = None if rows is None else _RigidPairs(0, rows)
        previous, before = poses[index - 1], own_links[index - 1]
        link = results[index - 1].neutral_from_pose
        if found is None and previous is not None and link is not None and before is not None:
            still = np.zeros(len(previous.points), dtype=np.bool_)
            still[before.rows[:, 1]] = True
            chained, rows = _align_one(pose, previous, link, still, limit, f"pose {index - 1}", options)
            if rows is not None:
                result, found = chained, _RigidPairs(index - 1, rows)
        results.append(result)
        own_links.append(found)
    return _adjusted(poses, results, own_links, options.final_pixels * limit) if options.joint else results


@dataclass(frozen=True)
class _RigidPairs:
    """Rows (N, 2) of the points of a reference pose and of a pose that did not move between them."""

    reference: int
    rows: NDArray[np.int64]


def _adjusted(
    poses: Sequence[ObservedPoints | None],
    results: Sequence[AlignedPose],
    own_links: Sequence[_RigidPairs | None],
    limit: float,
) -> list[AlignedPose]:
    """The same poses with similarities that suit all pairs of poses; pairs farther apart than `limit` do not count."""
    links = []
    for index, (pose, own) in enumerate(zip(poses, own_links, strict=True)):
        if pose is None or own is None:
            continue
        reference = poses[own.reference]
        if reference is not None:
            places = reference.points[own.rows[:, 0]]
            links.append(PointLink(own.reference, index, places, pose.points[own.rows[:, 1]]))
        for other in range(max(1, index - NEIGHBOURS), index):
            earlier, theirs = poses[other], own_links[other]
            if earlier is not None and theirs is not None and other != own.reference:
                links.append(_rigid_link(other, index, earlier, theirs.rows[:, 1], pose, own.rows[:, 1]))
    frames = solve_jointly(links, [result.neutral_from_pose for result in results], limit)
    adjusted = [results[0]]
    for index in range(1, len(results)):
        row = replace(results[index], neutral_from_pose=frames[index])
        own_residuals = [link.residuals(frames) for link in links if index in (link.first, link.second)]
        if own_residuals:
            distance = np.linalg.norm(np.concatenate(own_residuals), axis=1)
            near = distance[distance < limit]
            row = replace(row, residual=float(np.sqrt(np.mean(near**2))) if len(near) else row.residual)
        adjusted.append(row)
    return adjusted


def _rigid_link(
    first: int,
    second: int,
    one: ObservedPoints,
    one_rows: NDArray[np.int64],
    other: ObservedPoints,
    other_rows: NDArray[np.int64],
) -> PointLink:
    """Matches between the rigid points of two poses."""
    mine, theirs = one.restricted(one_rows), other.restricted(other_rows)
    pairs, _ = match_observed_points(mine, theirs)
    return PointLink(first, second, mine.points[pairs[:, 0]], theirs.points[pairs[:, 1]])


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
    grow: bool = False,
) -> tuple[AlignedPose, NDArray[np.int64] | None]:
    """Align one pose to a reference; also the pairs of points that were rigid, None for a failed pose.

    With `grow`, pairs that are not among the allowed ones take part at the end where they agree with those.
    """
    every_pair, _ = match_observed_points(reference, pose)
    pairs = every_pair[allowed[every_pair[:, 0]]]
    limit = options.final_pixels * footprint
    try:
        fit = fit_robust_similarity(
            pose.points[pairs[:, 1]],
            neutral_from_reference.apply(reference.points[pairs[:, 0]]),
            options.sampling_pixels * footprint,
            limit,
            options.minimum_inliers,
            options.trials,
            options.seed,
        )
    except RegistrationError as error:
        return _failed(str(error), len(pairs)), None
    reason = _fault(fit, len(pairs), footprint, options)
    if reason:
        return _failed(reason, len(pairs)), None
    if grow:
        pairs = every_pair
        places = neutral_from_reference.apply(reference.points[pairs[:, 0]])
        fit = refine_similarity(pose.points[pairs[:, 1]], places, fit.target_from_source, limit)
    aligned = AlignedPose(
        fit.target_from_source,
        fit.root_mean_square,
        len(pairs),
        int(np.count_nonzero(fit.inliers)),
        through,
        "",
    )
    return aligned, pairs[fit.inliers]


def _fault(fit: SimilarityFit, matches: int, footprint: float, options: AlignmentOptions) -> str:
    share = np.count_nonzero(fit.inliers) / matches
    if share < options.minimum_inlier_share:
        return f"only {share:.0%} of {matches} matches are rigid, {options.minimum_inlier_share:.0%} are needed"
    pixels = fit.root_mean_square / footprint
    if pixels > options.maximum_residual_pixels:
        return f"rigid matches disagree by {pixels:.2f} pixels, limit {options.maximum_residual_pixels}"
    return ""
