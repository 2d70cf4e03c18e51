"""One frame and one scale for all poses from a rig whose cameras stay where they are.

Camera centres of a small reconstruction are known to a few thousandths of the head, points on the head ten times
better. So the points of a pose are placed once more, with the cameras of the neutral, and the similarity is taken
between the two places of thousands of points instead of between two dozen centres.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capture_eval.cameras import View, pixel_rays
from capture_eval.errors import InputError, RegistrationError
from capture_eval.registration.pose_alignment import AlignedPose, AlignmentOptions
from capture_eval.registration.robust_similarity import fit_robust_similarity

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

LEAST_CAMERAS = 3


@dataclass(frozen=True)
class PhotographedPoints:
    """Points of one pose, and where its photos show them.

    Parameters
    ----------
    points : (N, 3) float64
        The pose's own frame.
    pixels : mapping of photo name to (K, 2) float64
    rows : mapping of photo name to (K,) int64
        Which point each pixel shows.
    """

    points: Floats
    pixels: Mapping[str, Floats]
    rows: Mapping[str, Integers]


def place_points(views: Mapping[str, View], seen: PhotographedPoints) -> tuple[Floats, NDArray[np.bool_]]:
    """Points nearest to the rays through their pixels, with the given cameras.

    Returns
    -------
    places : (N, 3) float64
        In the frame of the cameras.
    placed : (N,) bool
        At least two of the cameras see the point, along rays that are not parallel.
    """
    count = len(seen.points)
    matrix, right, rays = np.zeros((count, 3, 3)), np.zeros((count, 3)), np.zeros(count, dtype=np.int64)
    for name in sorted(set(views) & set(seen.pixels)):
        origin, directions = pixel_rays(views[name], seen.pixels[name])
        projector = np.eye(3) - directions[:, :, None] * directions[:, None, :]
        rows = seen.rows[name]
        np.add.at(matrix, rows, projector)
        np.add.at(right, rows, projector @ origin)
        np.add.at(rays, rows, 1)
    smallest = np.linalg.eigvalsh(matrix)[:, 0]
    placed = (rays >= 2) & (smallest > 1e-4 * rays)
    places = np.full((count, 3), np.nan)
    places[placed] = np.linalg.solve(matrix[placed], right[placed][:, :, None])[:, :, 0]
    return places, np.asarray(placed, dtype=np.bool_)


def align_by_rig(
    neutral_views: Mapping[str, View],
    pose: PhotographedPoints | None,
    footprint: float,
    options: AlignmentOptions,
) -> AlignedPose:
    """Similarity of one pose to the frame of the neutral's cameras; photos of one name share a camera.

    Every pose is tied to the same rig, not to its neighbours, so all are solved together by being solved one by one.

    Parameters
    ----------
    neutral_views : mapping of photo name to View
    footprint : float
        Length of a pixel in the frame of the neutral.

    Raises
    ------
    InputError
        The footprint is not positive.
    """
    if not footprint > 0:
        raise InputError(f"rig: a pixel of length {footprint}")
    if pose is None:
        return AlignedPose(None, float("nan"), 0, 0, "", "no reconstruction")
    common = sorted(set(neutral_views) & set(pose.pixels))
    if len(common) < LEAST_CAMERAS:
        reason = f"{len(common)} photos carry the name of a photo of the neutral, {LEAST_CAMERAS} are needed"
        return AlignedPose(None, float("nan"), 0, 0, "", reason)
    places, placed = place_points(neutral_views, pose)
    try:
        fit = fit_robust_similarity(
            pose.points[placed],
            places[placed],
            options.sampling_pixels * footprint,
            options.final_pixels * footprint,
            options.minimum_inliers,
            options.trials,
            options.seed,
        )
    except RegistrationError as error:
        return AlignedPose(None, float("nan"), int(np.count_nonzero(placed)), 0, "", f"the rig moved: {error}")
    inliers, matches = int(np.count_nonzero(fit.inliers)), int(np.count_nonzero(placed))
    if 2 * inliers < matches:
        reason = f"the rig moved: only {inliers} of {matches} points lie where the neutral's cameras see them"
        return AlignedPose(None, float("nan"), matches, inliers, "", reason)
    return AlignedPose(fit.target_from_source, fit.root_mean_square, matches, inliers, "rig", "")
