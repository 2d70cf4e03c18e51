"""Cross-pose matches in three dimensions: pixels of two poses lifted by rays to their surfaces.

On one side the registered mesh gives the material point (triangle and barycentric coordinates), on the other the
scan of the pose gives the place that it has gone to. Lengths are in the frame in which the template is 300 large.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from capture_eval.cameras import View, pixel_rays
from capture_eval.registration.cross_pose_matching import mutual_matches, near_view_pairs
from capture_eval.registration.surface_correspondence import Surface, SurfacePoints

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


@dataclass(frozen=True)
class PosePhotos:
    """Cameras and features of one pose, in the working frame, the views in the order of their names.

    Parameters
    ----------
    views : tuple of View
    keypoints : tuple of (K, 2) float64
    descriptors : tuple of (K, C) float32
    """

    views: tuple[View, ...]
    keypoints: tuple[Floats, ...]
    descriptors: tuple[NDArray[np.float32], ...]

    def lift(self, surface: Surface) -> tuple[SurfacePoints, ...]:
        """Hits of all keypoints' rays, one entry per view."""
        hits = []
        for view, pixels in zip(self.views, self.keypoints, strict=True):
            origin, directions = pixel_rays(view, pixels)
            hits.append(surface.cast(origin, directions))
        return tuple(hits)


@dataclass(frozen=True)
class MaterialMatches:
    """Where points of the mesh have gone.

    Parameters
    ----------
    triangle : (M,) int64
    barycentric : (M, 3) float64
        Material point on the registered mesh.
    target : (M, 3) float64
        Its place on the scan of the pose.
    weight : (M,) float64
    """

    triangle: Integers
    barycentric: Floats
    target: Floats
    weight: Floats

    def select(self, rows: NDArray[np.bool_] | Integers) -> MaterialMatches:
        """Some of the rows."""
        return MaterialMatches(self.triangle[rows], self.barycentric[rows], self.target[rows], self.weight[rows])

    def points(self, vertices: Floats, triangles: Integers) -> Floats:
        """Places of the material points on given vertices, (M, 3)."""
        places = np.einsum("mk,mki->mi", self.barycentric, vertices[triangles[self.triangle]])
        return np.asarray(places, dtype=np.float64)


@dataclass(frozen=True)
class LiftingOptions:
    """How matches are made and thinned; angles in degrees, lengths in units of the 300-unit head."""

    maximum_angle: float = 25.0
    pairs_per_view: int = 4
    ratio: float = 0.85
    minimum_cosine: float = 0.25
    voxel: float = 1.2
    agreement: float = 1.0
    minimum_agreeing: int = 2


def empty_matches() -> MaterialMatches:
    """No matches."""
    return MaterialMatches(np.zeros(0, dtype=np.int64), np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0))


def concatenate_matches(parts: Sequence[MaterialMatches]) -> MaterialMatches:
    """All rows of several match lists."""
    if not parts:
        return empty_matches()
    return MaterialMatches(
        np.concatenate([part.triangle for part in parts]),
        np.concatenate([part.barycentric for part in parts]),
        np.concatenate([part.target for part in parts]),
        np.concatenate([part.weight for part in parts]),
    )


def lift_matches(
    reference: PosePhotos,
    reference_hits: Sequence[SurfacePoints],
    pose: PosePhotos,
    pose_hits: Sequence[SurfacePoints],
    options: LiftingOptions,
) -> MaterialMatches:
    """SIFT matches of near views whose both rays meet their surface."""
    reference_good = [
        _usable(view, hits, options.minimum_cosine, supported=False)
        for view, hits in zip(reference.views, reference_hits, strict=True)
    ]
    pose_good = [
        _usable(view, hits, options.minimum_cosine, supported=True)
        for view, hits in zip(pose.views, pose_hits, strict=True)
    ]
    parts = []
    for left, right in near_view_pairs(reference.views, pose.views, options.maximum_angle, options.pairs_per_view):
        left_rows, right_rows = np.flatnonzero(reference_good[left]), np.flatnonzero(pose_good[right])
        matches = mutual_matches(
            reference.descriptors[left][left_rows], pose.descriptors[right][right_rows], options.ratio
        )
        left_hits, right_hits = reference_hits[left], pose_hits[right]
        from_rows, to_rows = left_rows[matches[:, 0]], right_rows[matches[:, 1]]
        parts.append(
            MaterialMatches(
                left_hits.triangle[from_rows],
                left_hits.barycentric[from_rows],
                right_hits.points[to_rows],
                np.ones(len(matches)),
            )
        )
    return concatenate_matches(parts)


def _usable(view: View, hits: SurfacePoints, minimum_cosine: float, supported: bool) -> NDArray[np.bool_]:
    toward = view.center - hits.points
    toward /= np.maximum(np.linalg.norm(toward, axis=1, keepdims=True), 1e-300)
    facing = np.sum(toward * hits.normals, axis=1) > minimum_cosine
    good = hits.hit & facing
    return np.asarray(good & (hits.support > 0) if supported else good, dtype=np.bool_)


def merge_agreeing(
    matches: MaterialMatches, vertices: Floats, triangles: Integers, options: LiftingOptions
) -> MaterialMatches:
    """One match per voxel of the reference mesh: the mean of those that agree with the voxel's median.

    Voxels in which fewer than `minimum_agreeing` agree are dropped.
    """
    if len(matches.triangle) == 0:
        return matches
    origin = matches.points(vertices, triangles)
    displacement = matches.target - origin
    cells = np.floor(origin / options.voxel).astype(np.int64)
    _, group = np.unique(cells, axis=0, return_inverse=True)
    group = group.ravel()
    near = np.linalg.norm(displacement - _group_medians(displacement, group)[group], axis=1) < options.agreement
    count = np.bincount(group, near)
    near &= count[group] >= options.minimum_agreeing
    rows = np.flatnonzero(near)
    if len(rows) == 0:
        return empty_matches()
    members = group[rows]
    off_centre = np.linalg.norm(origin[rows] - _group_means(origin[rows], members)[members], axis=1)
    order = np.lexsort((rows, off_centre, members))
    first = np.flatnonzero(np.diff(members[order], prepend=-1))
    centre = rows[order[first]]
    mean = _group_means(displacement[rows], members)[group[centre]]
    weight = 0.5 + 0.5 * np.minimum(1.0, count[group[centre]] / 4.0)
    return MaterialMatches(matches.triangle[centre], matches.barycentric[centre], origin[centre] + mean, weight)


def _group_means(values: Floats, group: Integers) -> Floats:
    """Mean of the rows (N, 3) of each group; zero for groups without rows."""
    count = np.maximum(np.bincount(group), 1)
    return np.stack([np.bincount(group, values[:, axis]) / count for axis in range(3)], axis=1)


def _group_medians(values: Floats, group: Integers) -> Floats:
    """Median per axis of the rows (N, 3) of each group; groups are numbered without gaps."""
    count = np.bincount(group)
    start = np.cumsum(count) - count
    medians = np.empty((len(count), 3))
    for axis in range(3):
        ordered = values[np.lexsort((values[:, axis], group)), axis]
        medians[:, axis] = 0.5 * (ordered[start + (count - 1) // 2] + ordered[start + count // 2])
    return medians


def consistent_with_prediction(
    matches: MaterialMatches,
    rest: Floats,
    predicted: Floats,
    triangles: Integers,
    neighbours: int = 10,
    tolerance: float = 0.8,
    growth: float = 0.3,
) -> NDArray[np.bool_]:
    """Rows whose deviation from a prediction agrees with most of their neighbours' deviations.

    A plain comparison of displacements would throw a turning jaw away; the deviation from the prediction
    (the previous pose) varies slowly.

    Parameters
    ----------
    rest, predicted : (V, 3)
        Mesh on which the material points lie, and where it is expected.
    tolerance, growth : float
        Two matches at distance d on the mesh may deviate by `tolerance + growth d`.
    """
    count = len(matches.triangle)
    if count <= neighbours:
        return np.zeros(count, dtype=np.bool_)
    origin = matches.points(rest, triangles)
    deviation = matches.target - matches.points(predicted, triangles)
    found = cKDTree(origin).query(origin, neighbours + 1)
    distance, index = np.asarray(found[0]), np.asarray(found[1])
    difference = np.linalg.norm(deviation[index[:, 1:]] - deviation[:, None, :], axis=2)
    agreeing = difference < tolerance + growth * distance[:, 1:]
    return np.asarray(np.count_nonzero(agreeing, axis=1) * 2 > neighbours, dtype=np.bool_)


def near_present_fit(
    matches: MaterialMatches, positions: Floats, triangles: Integers, limit: float
) -> NDArray[np.bool_]:
    """Rows whose target lies within `limit` of where the present fit puts the material point."""
    residual = np.linalg.norm(matches.points(positions, triangles) - matches.target, axis=1)
    return np.asarray(residual < limit, dtype=np.bool_)
