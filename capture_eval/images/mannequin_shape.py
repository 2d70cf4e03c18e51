"""The canonical mannequin head as a signed distance field sculpted from smooth blends of ellipsoids and cones.

Blends are the polynomial smooth minimum (Inigo Quilez, "Smooth minimum", 2013); sizes are rounded adult head
measurements (breadth 153 mm, length 197 mm, menton to vertex 230 mm, interpupillary 64 mm). Frame: millimetres,
x = subject's left, y = up, z = front, origin midway between the pupils' height and the centre of the cranium.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]

EYE_CENTRE = np.array([32.0, 0.0, 63.5])
EYE_RADIUS = 12.0
NECK_HEIGHT = -158.0


def _ellipsoid(points: FloatArray, centre: ArrayLike, radii: ArrayLike) -> FloatArray:
    scaled = (points - np.asarray(centre, dtype=float)) / np.asarray(radii, dtype=float)
    first = np.sqrt(np.sum(scaled**2, axis=1)) + 1e-12
    second = np.sqrt(np.sum((scaled / np.asarray(radii, dtype=float)) ** 2, axis=1)) + 1e-12
    return np.asarray(first * (first - 1.0) / second)


def _cone(points: FloatArray, start: ArrayLike, end: ArrayLike, start_radius: float, end_radius: float) -> FloatArray:
    origin = np.asarray(start, dtype=float)
    axis = np.asarray(end, dtype=float) - origin
    along = np.clip((points - origin) @ axis / (axis @ axis), 0.0, 1.0)
    distance = np.sqrt(np.sum((points - origin - along[:, None] * axis) ** 2, axis=1))
    return np.asarray(distance - (start_radius + along * (end_radius - start_radius)))


def _blend(first: FloatArray, second: FloatArray, width: float) -> FloatArray:
    share = np.clip(0.5 + 0.5 * (second - first) / width, 0.0, 1.0)
    return np.asarray(second + share * (first - second) - width * share * (1.0 - share))


def _carve(first: FloatArray, second: FloatArray, width: float) -> FloatArray:
    return -_blend(-first, second, width)


def head_distance(points: FloatArray) -> FloatArray:
    """Approximate signed distance of points to the head without ears, lids and lips.

    Parameters
    ----------
    points
        (N, 3) millimetres.

    Returns
    -------
    (N,) millimetres, negative inside. The field is symmetric in x and its zero set is the skin; away from the skin
    it is a bound of the distance, not the distance.
    """
    folded = points.copy()
    folded[:, 0] = np.sqrt(points[:, 0] ** 2 + 1.0)
    return _nose(folded, _face(folded, _skull_and_neck(folded)))


def _skull_and_neck(points: FloatArray) -> FloatArray:
    distance = _ellipsoid(points, (0, 32, -8), (75.5, 84, 94))
    distance = _blend(distance, _ellipsoid(points, (0, 44, 28), (62, 52, 64)), 20)
    distance = _blend(distance, _ellipsoid(points, (0, 10, -52), (60, 48, 49)), 25)
    neck = _cone(points, (0, -60, -28), (0, -200, -34), 51, 55)
    neck = _blend(neck, _cone(points, (50, -50, -22), (18, -200, 10), 13, 11), 18)
    neck = _blend(neck, _ellipsoid(points, (0, -146, 21), (9, 13, 9)), 14)
    return _blend(distance, neck, 22)


def _face(points: FloatArray, distance: FloatArray) -> FloatArray:
    distance = _blend(distance, _ellipsoid(points, (0, -28, 28), (59, 72, 56)), 24)
    distance = _blend(distance, _cone(points, (54, -22, 8), (47, -64, 12), 12, 12), 24)
    distance = _blend(distance, _cone(points, (46, -67, 12), (15, -97, 70), 12, 15), 18)
    distance = _blend(distance, _cone(points, (61, -18, 14), (46, -25, 58), 8, 15), 22)
    distance = _blend(distance, _ellipsoid(points, (36, -52, 52), (24, 30, 26)), 16)
    distance = _blend(distance, _ellipsoid(points, (0, -62, 60), (33, 30, 35)), 14)
    distance = _blend(distance, _ellipsoid(points, (0, -99, 77), (19, 15, 18)), 14)
    distance = _blend(distance, _cone(points, (9, 17, 84), (46, 19, 63), 9, 8), 14)
    distance = _carve(distance, _ellipsoid(points, (33, -3, 85), (19, 14, 18)), 12)
    distance = _blend(distance, _ellipsoid(points, EYE_CENTRE, (19.0, 13.9, 13.9)), 5)
    distance = _carve(distance, _ellipsoid(points, (0, -84, 103), (17, 5, 9)), 8)
    return _carve(distance, _ellipsoid(points, (82, 18, 52), (14, 26, 24)), 14)


def _nose(points: FloatArray, distance: FloatArray) -> FloatArray:
    distance = _blend(distance, _cone(points, (0, 10, 83), (0, -32, 102), 6.5, 7.5), 10)
    # side walls: without them the bridge would stand on a narrower foot
    distance = _blend(distance, _cone(points, (4.5, 4, 76), (7.5, -32, 90), 6, 8), 8)
    distance = _blend(distance, _ellipsoid(points, (0, -35, 104), (9.5, 8.5, 9.5)), 6)
    distance = _blend(distance, _ellipsoid(points, (11.5, -38, 94), (6.5, 7.5, 10)), 5)
    distance = _blend(distance, _cone(points, (0, -41, 103), (0, -46, 92), 4, 5), 4)
    return distance


def distance_gradient(field: Callable[[FloatArray], FloatArray], points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Value (N,) and gradient (N, 3) of a field by four samples on a tetrahedron.

    Source: I. Quilez, "Normals for an SDF" (tetrahedron technique).
    """
    corners = np.array([[1.0, -1, -1], [-1, -1, 1], [-1, 1, -1], [1, 1, 1]])
    step = 0.2
    values = np.stack([field(points + step * corner) for corner in corners])
    return values.mean(axis=0), np.asarray(np.tensordot(values.T, corners, axes=1) / (4 * step))


def project_to_skin(points: FloatArray, steps: int = 3, offset: float = 0.0) -> FloatArray:
    """Move points (N, 3) along the gradient onto the level `offset` (mm) of the head's distance field."""
    for _ in range(steps):
        value, gradient = distance_gradient(head_distance, points)
        norm = np.maximum(np.sum(gradient**2, axis=1), 0.05)
        points = points - np.clip((value - offset) / norm, -4.0, 4.0)[:, None] * gradient
    return points


def cast_to_skin(origins: FloatArray, directions: FloatArray, reach: float = 220.0) -> FloatArray:
    """Last crossing of the skin along rays from inside, (N, 3) -> (N, 3), by marching inwards and bisection."""
    far = np.full(len(origins), reach)
    near = np.zeros(len(origins))
    open_rays = np.ones(len(origins), dtype=bool)
    position = far.copy()
    for _ in range(60):
        value = head_distance(origins + position[:, None] * directions)
        open_rays &= value > 0.05
        position = np.where(open_rays, position - 0.7 * np.maximum(value, 0.05), position)
        position = np.maximum(position, near)
    return np.asarray(origins + position[:, None] * directions)
