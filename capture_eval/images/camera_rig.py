"""Where the cameras of a synthetic capture stand: arcs at two or three heights round the face, slightly jittered.

A real session walks one camera round the subject (or uses hand-mounted ones); no two poses are photographed from
exactly the same places. So the jitter depends on the seed *and* the pose.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from capture_eval.cameras import Intrinsics, View
from capture_eval.errors import InputError

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class RigOptions:
    """Geometry of the camera positions.

    Lengths in millimetres, angles in degrees; azimuth 0 is straight ahead of the face (+z), positive towards the
    subject's left (+x), elevation positive upwards (+y).

    Attributes
    ----------
    azimuth_limit
        The arcs run from minus to plus this angle.
    distances
        Least and largest distance between camera and aim point.
    focal_per_width
        Focal length divided by the larger picture side (1000 px at 640 px).
    position_jitter, aim_jitter
        Standard deviation of camera position and of the aim point, per axis.
    roll_jitter
        Standard deviation of the roll angle.
    """

    azimuth_limit: float = 70.0
    distances: tuple[float, float] = (600.0, 640.0)
    focal_per_width: float = 1000.0 / 640.0
    position_jitter: float = 6.0
    aim_jitter: float = 4.0
    roll_jitter: float = 1.2


def intrinsics_for(
    width: int, height: int, distortion: Sequence[float] = (0.0, 0.0, 0.0, 0.0), options: RigOptions | None = None
) -> Intrinsics:
    """Pin-hole intrinsics of the rig's camera for a picture size.

    The principal point is the middle of the picture (the centre of the top-left pixel is (0.5, 0.5)).

    Raises
    ------
    InputError
        The picture is smaller than 32 x 32 pixels.
    """
    if min(width, height) < 32:
        raise InputError(f"picture size {width}x{height} is too small; use at least 32x32")
    focal = (options or RigOptions()).focal_per_width * max(width, height)
    matrix = np.array([[focal, 0.0, width / 2.0], [0.0, focal, height / 2.0], [0.0, 0.0, 1.0]])
    return Intrinsics(width, height, matrix, np.asarray(distortion, dtype=np.float64))


def arc_directions(count: int, azimuth_limit: float = 70.0) -> FloatArray:
    """Azimuth and elevation of `count` cameras on arcs at two or three heights, staggered between the arcs.

    Up to three cameras share one arc at eye height; fewer than 15 stand on two arcs (-10 and 16 degrees), more on
    three (-18, 2 and 22 degrees), with the middle arc getting what does not divide.

    Returns
    -------
    (count, 2) degrees.
    """
    if count < 1:
        raise InputError(f"{count} views asked for; at least 1 is needed")
    elevations = (2.0,) if count < 4 else (16.0, -10.0) if count < 15 else (22.0, 2.0, -18.0)
    sizes = [count // len(elevations)] * len(elevations)
    extra = count - sum(sizes)
    order = [1, 0, 2] if len(elevations) == 3 else list(range(len(elevations)))
    for arc in order[:extra]:
        sizes[arc] += 1
    directions = []
    for arc, (elevation, size) in enumerate(zip(elevations, sizes, strict=True)):
        # Arcs are shifted by half a step against each other so that neighbours of neighbouring arcs are close too.
        step = 2.0 * azimuth_limit / (size - 0.5 if len(elevations) > 1 else max(size - 1, 1))
        first = -azimuth_limit + (0.5 * step if arc % 2 else 0.0)
        if size == 1:
            first = 0.0
        directions += [(first + step * k, elevation) for k in range(size)]
    return np.array(directions)


def look_at(position: ArrayLike, aim: ArrayLike, roll: float = 0.0) -> tuple[FloatArray, FloatArray]:
    """Rotation (view_from_world) and translation of a camera at `position` that looks at `aim`, +y up in the world.

    Raises
    ------
    InputError
        The camera would look straight up or down, or stands on its aim point.
    """
    position, aim = np.asarray(position, dtype=np.float64), np.asarray(aim, dtype=np.float64)
    forward = aim - position
    length = float(np.linalg.norm(forward))
    right = np.cross(forward, [0.0, 1.0, 0.0])
    if length == 0.0 or np.linalg.norm(right) < 1e-9 * length:
        raise InputError(f"a camera at {position} cannot look at {aim}: no sideways direction")
    forward = forward / length
    right = right / np.linalg.norm(right)
    down = np.cross(forward, right)
    cosine, sine = np.cos(roll), np.sin(roll)
    rotation = np.stack([cosine * right + sine * down, -sine * right + cosine * down, forward])
    return rotation, -rotation @ position


def place_cameras(
    count: int,
    intrinsics: Intrinsics,
    aim: ArrayLike,
    seed: int,
    pose_index: int = 0,
    options: RigOptions | None = None,
) -> list[View]:
    """Cameras of one pose, named ``view_00.jpg``, ``view_01.jpg``, ...

    Parameters
    ----------
    count
        Number of photos.
    intrinsics
        Shared by all of them.
    aim
        (3,) point all cameras look at, millimetres, head frame (x left, y up, z front).
    seed, pose_index
        The same pair gives the same cameras.
    """
    options = options or RigOptions()
    random = np.random.default_rng([seed, 101, pose_index])
    aim = np.asarray(aim, dtype=np.float64)
    views = []
    for number, (azimuth, elevation) in enumerate(np.radians(arc_directions(count, options.azimuth_limit))):
        distance = random.uniform(*options.distances)
        outward = np.array(
            [np.sin(azimuth) * np.cos(elevation), np.sin(elevation), np.cos(azimuth) * np.cos(elevation)]
        )
        position = aim + distance * outward + random.normal(0.0, options.position_jitter, 3)
        target = aim + random.normal(0.0, options.aim_jitter, 3)
        roll = np.radians(random.normal(0.0, options.roll_jitter))
        rotation, translation = look_at(position, target, roll)
        views.append(View(f"view_{number:02d}.jpg", intrinsics, rotation, translation))
    return views
