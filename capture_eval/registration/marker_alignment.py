"""One frame and one scale for all poses from markers: points that carry the same name in every pose."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capture_eval.errors import InputError, RegistrationError
from capture_eval.registration.joint_similarity import PointLink, solve_jointly
from capture_eval.registration.pose_alignment import AlignedPose, AlignmentOptions
from capture_eval.registration.robust_similarity import fit_robust_similarity
from capture_eval.similarity import Similarity

Floats = NDArray[np.float64]

LEAST_MARKERS = 3
THINNEST = 0.05  # extent across a row of markers, relative to its length, that still tells a rotation about it


@dataclass(frozen=True)
class PlacedMarkers:
    """Markers of one pose in space.

    Parameters
    ----------
    names : tuple of str
    points : (N, 3) float64
        The pose's own frame.
    """

    names: tuple[str, ...]
    points: Floats

    def __post_init__(self) -> None:
        if self.points.shape != (len(self.names), 3) or len(set(self.names)) != len(self.names):
            raise InputError(f"markers: {len(set(self.names))} names for points {self.points.shape}")


def align_by_markers(
    poses: Sequence[PlacedMarkers | None], footprint: float, options: AlignmentOptions
) -> list[AlignedPose]:
    """Similarities of all poses against the first one, solved together.

    A pose that shares too few markers with the neutral goes through any aligned pose that it shares enough with.

    Parameters
    ----------
    poses : sequence of PlacedMarkers or None
        None for a pose without a reconstruction.
    footprint : float
        Length of a pixel in the frame of the neutral; the limits of `options` are in pixels.

    Raises
    ------
    RegistrationError
        The neutral has fewer than three markers.
    """
    neutral = poses[0]
    if neutral is None or len(neutral.names) < LEAST_MARKERS:
        found = 0 if neutral is None else len(neutral.names)
        raise RegistrationError(f"markers: the neutral pose shows {found}, at least {LEAST_MARKERS} are needed")
    starts: list[Similarity | None] = [None] * len(poses)
    starts[0] = Similarity.identity()
    reasons, through = ["" for _ in poses], ["neutral" for _ in poses]
    progress = True
    while progress:
        progress = False
        for index, pose in enumerate(poses):
            if pose is None or starts[index] is not None:
                continue
            for other in sorted(range(len(poses)), key=lambda number: (number != 0, abs(number - index))):
                starts[index], reason = _start(pose, poses[other], starts[other], footprint, options)
                reasons[index] = reasons[index] or reason
                if starts[index] is not None:
                    through[index] = "neutral" if other == 0 else f"pose {other}"
                    progress = True
                    break
    return _solved(poses, starts, reasons, through, footprint, options)


def _start(
    pose: PlacedMarkers,
    reference: PlacedMarkers | None,
    neutral_from_reference: Similarity | None,
    footprint: float,
    options: AlignmentOptions,
) -> tuple[Similarity | None, str]:
    if reference is None or neutral_from_reference is None:
        return None, ""
    mine, theirs = common_markers(pose, reference)
    if len(mine) < LEAST_MARKERS:
        return None, f"{len(mine)} markers in common with the neutral, {LEAST_MARKERS} are needed"
    if _on_a_line(mine):
        return None, f"the {len(mine)} markers in common lie on a line: they tell no rotation about it"
    limit = 2.0 * options.sampling_pixels * footprint
    try:
        fit = fit_robust_similarity(
            mine, neutral_from_reference.apply(theirs), limit, limit, LEAST_MARKERS, options.trials, options.seed
        )
    except RegistrationError as error:
        return None, str(error)
    if 2 * np.count_nonzero(fit.inliers) < len(mine):
        return None, f"only {np.count_nonzero(fit.inliers)} of {len(mine)} markers are where they are in the neutral"
    return fit.target_from_source, ""


def common_markers(first: PlacedMarkers, second: PlacedMarkers) -> tuple[Floats, Floats]:
    """Places of the markers that both poses have, row by row the same marker."""
    common = [name for name in first.names if name in set(second.names)]
    rows = [first.names.index(name) for name in common]
    other = [second.names.index(name) for name in common]
    return first.points[rows].reshape(-1, 3), second.points[other].reshape(-1, 3)


def _on_a_line(points: Floats) -> bool:
    singular = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(singular[1] < THINNEST * singular[0])


def _solved(
    poses: Sequence[PlacedMarkers | None],
    starts: Sequence[Similarity | None],
    reasons: Sequence[str],
    through: Sequence[str],
    footprint: float,
    options: AlignmentOptions,
) -> list[AlignedPose]:
    limit = 2.0 * options.sampling_pixels * footprint
    links = []
    for first, one in enumerate(poses):
        for second in range(first + 1, len(poses)):
            other = poses[second]
            if one is not None and other is not None and starts[first] is not None and starts[second] is not None:
                links.append(PointLink(first, second, *common_markers(one, other)))
    frames = solve_jointly([link for link in links if len(link.first_points)], starts, limit)
    results = [AlignedPose(Similarity.identity(), 0.0, len(poses[0].names) if poses[0] else 0, 0, "neutral", "")]
    for index in range(1, len(poses)):
        link, pose = frames[index], poses[index]
        if link is None or pose is None:
            reason = "no reconstruction" if pose is None else reasons[index]
            results.append(AlignedPose(None, float("nan"), 0 if pose is None else len(pose.names), 0, "", reason))
            continue
        distance = np.concatenate(
            [np.linalg.norm(row.residuals(frames), axis=1) for row in links if index in (row.first, row.second)]
        )
        near = distance < limit
        residual = float(np.sqrt(np.mean(distance[near] ** 2))) if near.any() else float("nan")
        results.append(AlignedPose(link, residual, len(distance), int(np.count_nonzero(near)), through[index], ""))
    return results
