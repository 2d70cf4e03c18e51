"""Similarities of many frames at once, from points that pairs of frames have in common.

Every pair of frames that shares points adds its residuals, so that no pose hangs on one comparison alone. The first
frame stays where it is. Rotations only ever turn: a mirror image cannot come out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capture_eval.errors import InputError
from capture_eval.similarity import Similarity

Floats = NDArray[np.float64]

_PARAMETERS = 7
_CONVERGED = 1e-12


@dataclass(frozen=True)
class PointLink:
    """The same points in two frames.

    Parameters
    ----------
    first, second : int
        Numbers of the frames.
    first_points, second_points : (N, 3) float64
        Each in its own frame, row by row the same point.
    """

    first: int
    second: int
    first_points: Floats
    second_points: Floats

    def __post_init__(self) -> None:
        shape = self.first_points.shape
        if shape != self.second_points.shape or len(shape) != 2 or shape[1] != 3:
            raise InputError(f"point link: point sets {shape} and {self.second_points.shape}")
        if self.first == self.second:
            raise InputError(f"point link: frame {self.first} is linked with itself")

    def residuals(self, frames: Sequence[Similarity | None]) -> Floats:
        """Differences (N, 3) of the points in the common frame."""
        first, second = frames[self.first], frames[self.second]
        if first is None or second is None:
            raise InputError(f"point link: frames {self.first} and {self.second} are not both placed")
        return np.asarray(first.apply(self.first_points) - second.apply(self.second_points), dtype=np.float64)


def solve_jointly(
    links: Sequence[PointLink], start: Sequence[Similarity | None], limit: float, steps: int = 30
) -> list[Similarity | None]:
    """Gauss-Newton over all frames with Tukey's weights, from a start that is right to about `limit`.

    Parameters
    ----------
    links : sequence of PointLink
    start : sequence of Similarity or None
        `common_from_frame`; the first frame is held, None stays None.
    limit : float
        Pairs farther apart than this in the common frame count nothing; unit of the common frame.

    Raises
    ------
    InputError
        The limit is not positive, or the first frame has no place.
    """
    if not limit > 0:
        raise InputError(f"joint similarity: limit {limit} must be positive")
    frames = list(start)
    if not frames or frames[0] is None:
        raise InputError("joint similarity: the first frame has no place")
    used = [link for link in links if frames[link.first] is not None and frames[link.second] is not None]
    linked = sorted({frame for link in used for frame in (link.first, link.second)} - {0})
    if not linked:
        return frames
    column = {frame: number * _PARAMETERS for number, frame in enumerate(linked)}
    centre, size = _middle(used, frames)
    for _ in range(steps):
        matrix, right = _normal_equations(used, frames, column, centre, size, limit)
        # a frame without any pair inside the limit stays where it is
        idle = np.diag(matrix) == 0.0
        matrix[idle, idle] = 1.0
        step: Floats = np.linalg.solve(matrix + 1e-12 * np.diag(np.diag(matrix)), -right).astype(np.float64)
        for frame, begin in column.items():
            present = frames[frame]
            if present is not None:
                frames[frame] = _small_similarity(step, begin, centre, size).compose(present)
        if np.max(np.abs(step)) < _CONVERGED:
            break
    return frames


def _middle(links: Sequence[PointLink], frames: Sequence[Similarity | None]) -> tuple[Floats, float]:
    places = []
    for link in links:
        frame = frames[link.first]
        if frame is not None:
            places.append(frame.apply(link.first_points))
    points = np.concatenate(places)
    centre = np.median(points, axis=0)
    size = float(np.sqrt(np.mean(np.sum((points - centre) ** 2, axis=1))))
    return centre, max(size, 1e-300)


def _normal_equations(
    links: Sequence[PointLink],
    frames: Sequence[Similarity | None],
    column: dict[int, int],
    centre: Floats,
    size: float,
    limit: float,
) -> tuple[Floats, Floats]:
    """Matrix and gradient for small similarities about `centre`; lengths in units of `size`."""
    count = _PARAMETERS * len(column)
    matrix, gradient = np.zeros((count, count)), np.zeros(count)
    for link in links:
        difference = link.residuals(frames)
        distance = np.linalg.norm(difference, axis=1)
        weight = np.maximum(1.0 - (distance / limit) ** 2, 0.0) ** 2
        blocks = []
        for frame, points, sign in ((link.first, link.first_points, 1.0), (link.second, link.second_points, -1.0)):
            place = frames[frame]
            if frame in column and place is not None:
                blocks.append((column[frame], sign * _derivatives((place.apply(points) - centre) / size)))
        for begin, derivative in blocks:
            rows = slice(begin, begin + _PARAMETERS)
            gradient[rows] += np.einsum("n,nip,ni->p", weight, derivative, difference / size)
            for other, second in blocks:
                columns = slice(other, other + _PARAMETERS)
                matrix[rows, columns] += np.einsum("n,nip,niq->pq", weight, derivative, second, optimize=True)
    return matrix, gradient


def _derivatives(places: Floats) -> Floats:
    """Of turning, scaling and shifting points (N, 3) about the origin: (N, 3, 7)."""
    result = np.zeros((len(places), 3, _PARAMETERS))
    x, y, z = places.T
    result[:, 0, 1], result[:, 0, 2] = z, -y
    result[:, 1, 0], result[:, 1, 2] = -z, x
    result[:, 2, 0], result[:, 2, 1] = y, -x
    result[:, :, 3] = places
    result[:, :, 4:] = np.eye(3)
    return result


def _small_similarity(steps: Floats, begin: int, centre: Floats, size: float) -> Similarity:
    """Similarity about `centre` from the seven numbers of `steps` at `begin`."""
    from scipy.spatial.transform import Rotation

    step = steps[begin : begin + _PARAMETERS]
    rotation = np.asarray(Rotation.from_rotvec(step[:3]).as_matrix(), dtype=np.float64)
    scale = float(np.exp(step[3]))
    return Similarity(scale, rotation, centre + size * step[4:] - scale * (rotation @ centre))
