"""SIFT matches between photos of different poses, by descriptors alone (Lowe 2004: mutual best and ratio test)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capture_eval.cameras import View
from capture_eval.errors import InputError

_BLOCK_ROWS = 1024


def mutual_matches(
    first: NDArray[np.float32],
    second: NDArray[np.float32],
    ratio: float = 0.8,
    first_groups: NDArray[np.int64] | None = None,
    second_groups: NDArray[np.int64] | None = None,
) -> NDArray[np.int64]:
    """Pairs that are each other's best match and clearly better than the runner-up.

    Parameters
    ----------
    first, second : (N, C), (M, C) float32
        Descriptors of unit length.
    ratio : float
        Largest quotient of the distances (angles) to the best and to the second best.
    first_groups, second_groups : (N,), (M,) int, optional
        Descriptors of one group show the same point: they are no rivals of each other in the ratio test.

    Returns
    -------
    (K, 2) int64
        Rows of `first` and `second`, in the order of `first`.

    Raises
    ------
    InputError
        Descriptors of different lengths.
    """
    if first.ndim != 2 or second.ndim != 2 or first.shape[1] != second.shape[1]:
        raise InputError(f"matching: descriptors of shapes {first.shape} and {second.shape} do not compare")
    if len(first) == 0 or len(second) == 0:
        return np.zeros((0, 2), dtype=np.int64)
    groups = np.arange(len(first)) if first_groups is None else first_groups
    forward = np.zeros(len(first), dtype=np.int64)
    clear = np.zeros(len(first), dtype=np.bool_)
    best_value = np.full(len(second), -np.inf, dtype=np.float32)
    backward = np.zeros(len(second), dtype=np.int64)
    columns = np.arange(len(second))
    for start in range(0, len(first), _BLOCK_ROWS):
        block = first[start : start + _BLOCK_ROWS] @ second.T
        rows = slice(start, start + len(block))
        top_row = np.argmax(block, axis=0)
        top = block[top_row, columns]
        better = top > best_value
        best_value[better], backward[better] = top[better], top_row[better] + start
        forward[rows], clear[rows] = _best_with_ratio(block, second_groups, ratio)
    mutual = groups[backward[forward]] == groups
    rows_kept = np.flatnonzero(clear & mutual)
    return np.stack([rows_kept, forward[rows_kept]], axis=1).astype(np.int64)


def _best_with_ratio(
    similarity: NDArray[np.float32], groups: NDArray[np.int64] | None, ratio: float
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Best column of each row, and whether it beats the best of any other group; destroys `similarity`."""
    rows = np.arange(len(similarity))
    best = np.argmax(similarity, axis=1)
    top = similarity[rows, best].copy()
    if groups is None:
        similarity[rows, best] = -1.0
    else:
        similarity[groups[None, :] == groups[best][:, None]] = -1.0
    runner_up = similarity.max(axis=1)
    angles = np.arccos(np.clip(np.stack([top, runner_up]), -1.0, 1.0))
    return best, angles[0] < ratio * angles[1]


@dataclass(frozen=True)
class ObservedPoints:
    """Triangulated points of one pose with the descriptors they were seen by.

    Parameters
    ----------
    points : (N, 3) float64
        The pose's own frame.
    descriptors : (K, C) float32
        One row per observation.
    point_of_descriptor : (K,) int64
    footprint : float
        Length that one pixel covers at the median point, in the unit of `points`.
    """

    points: NDArray[np.float64]
    descriptors: NDArray[np.float32]
    point_of_descriptor: NDArray[np.int64]
    footprint: float

    @property
    def extent(self) -> float:
        """Twice the distance from the median point that holds 90 % of the points."""
        distance = np.linalg.norm(self.points - np.median(self.points, axis=0), axis=1)
        return float(2.0 * np.quantile(distance, 0.9))

    def restricted(self, rows: NDArray[np.int64]) -> ObservedPoints:
        """Only the points of some rows, each once."""
        chosen = np.unique(rows)
        number = np.full(len(self.points), -1, dtype=np.int64)
        number[chosen] = np.arange(len(chosen))
        owner = number[self.point_of_descriptor]
        kept = owner >= 0
        return ObservedPoints(self.points[chosen], self.descriptors[kept], owner[kept], self.footprint)


def match_observed_points(
    first: ObservedPoints, second: ObservedPoints, ratio: float = 0.85
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Point pairs of two poses that their descriptors agree on.

    Returns
    -------
    pairs : (K, 2) int64
        Rows of the two point lists; every point occurs at most once.
    votes : (K,) int64
        Number of observations that support the pair.
    """
    matches = mutual_matches(
        first.descriptors, second.descriptors, ratio, first.point_of_descriptor, second.point_of_descriptor
    )
    if len(matches) == 0:
        return np.zeros((0, 2), dtype=np.int64), np.zeros(0, dtype=np.int64)
    linked = np.stack([first.point_of_descriptor[matches[:, 0]], second.point_of_descriptor[matches[:, 1]]], axis=1)
    pairs, votes = np.unique(linked, axis=0, return_counts=True)
    order = np.lexsort((pairs[:, 1], pairs[:, 0], -votes))
    taken_first = np.zeros(len(first.points), dtype=np.bool_)
    taken_second = np.zeros(len(second.points), dtype=np.bool_)
    keep = []
    for row in order:
        left, right = pairs[row]
        if not taken_first[left] and not taken_second[right]:
            taken_first[left] = taken_second[right] = True
            keep.append(row)
    kept = np.sort(np.array(keep, dtype=np.int64))
    return pairs[kept], votes[kept].astype(np.int64)


def near_view_pairs(
    first: Sequence[View],
    second: Sequence[View],
    maximum_angle: float = 25.0,
    per_view: int = 4,
) -> list[tuple[int, int]]:
    """For every view of `first` the views of `second` that look from nearly the same side.

    Both lists are in one frame. Angles are between the optical axes, in degrees.
    """
    if not first or not second:
        return []
    axes_first = np.array([view.rotation[2] for view in first])
    axes_second = np.array([view.rotation[2] for view in second])
    angles = np.degrees(np.arccos(np.clip(axes_first @ axes_second.T, -1.0, 1.0)))
    pairs: list[tuple[int, int]] = []
    for row in range(len(first)):
        order = np.argsort(angles[row], kind="stable")[:per_view]
        pairs.extend((row, int(column)) for column in order if angles[row, column] <= maximum_angle)
    return pairs
