"""Pinhole cameras with OpenCV distortion, in COLMAP's conventions.

A view looks along its +z axis with y downwards; the centre of the top-left pixel has the coordinates (0.5, 0.5).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from capture_eval.errors import InputError

Floats = NDArray[np.float64]

_UNDISTORTION_STEPS = 20  # the fixed point contracts by about the distortion itself, so 20 steps reach rounding


@dataclass(frozen=True)
class Intrinsics:
    """What a lens and sensor do.

    Parameters
    ----------
    width, height : int
        Pixels.
    matrix : (3, 3) float64
        Calibration matrix, pixels.
    distortion : (4,) float64
        k1, k2, p1, p2 of OpenCV.

    Raises
    ------
    InputError
        Sizes or focal lengths that are not positive, or numbers that are not finite.
    """

    width: int
    height: int
    matrix: Floats
    distortion: Floats

    def __post_init__(self) -> None:
        matrix = np.ascontiguousarray(self.matrix, dtype=np.float64)
        distortion = np.ascontiguousarray(self.distortion, dtype=np.float64)
        if matrix.shape != (3, 3) or distortion.shape != (4,):
            raise InputError(
                f"camera: matrix {matrix.shape} and distortion {distortion.shape}, expected (3, 3) and (4,)"
            )
        if not (np.all(np.isfinite(matrix)) and np.all(np.isfinite(distortion))):
            raise InputError("camera: intrinsics are not finite")
        if self.width < 1 or self.height < 1 or matrix[0, 0] <= 0 or matrix[1, 1] <= 0:
            raise InputError(f"camera: size {self.width}x{self.height}, focal lengths {matrix[0, 0]}, {matrix[1, 1]}")
        object.__setattr__(self, "matrix", matrix)
        object.__setattr__(self, "distortion", distortion)


@dataclass(frozen=True)
class View:
    """A photo's camera and where it stood.

    Parameters
    ----------
    name : str
        Photo.
    intrinsics : Intrinsics
    rotation : (3, 3) float64
        view_from_world.
    translation : (3,) float64
        view_from_world, in the unit of the world.

    Raises
    ------
    InputError
        The rotation is not a proper rotation (to 1e-6), or numbers are not finite.
    """

    name: str
    intrinsics: Intrinsics
    rotation: Floats
    translation: Floats

    def __post_init__(self) -> None:
        rotation = np.ascontiguousarray(self.rotation, dtype=np.float64)
        translation = np.ascontiguousarray(self.translation, dtype=np.float64)
        if rotation.shape != (3, 3) or translation.shape != (3,):
            raise InputError(f"view {self.name}: rotation {rotation.shape}, translation {translation.shape}")
        if not np.all(np.isfinite(translation)) or not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-6):
            raise InputError(f"view {self.name}: not a rotation and a finite translation")
        if np.linalg.det(rotation) < 0:
            raise InputError(f"view {self.name}: the rotation is a reflection")
        object.__setattr__(self, "rotation", rotation)
        object.__setattr__(self, "translation", translation)

    @property
    def center(self) -> Floats:
        """Position of the camera in the world, (3,)."""
        return np.asarray(-self.rotation.T @ self.translation, dtype=np.float64)


def distort(normalized: Floats, distortion: Floats) -> Floats:
    """Bend ideal image coordinates (..., 2), x/z and y/z, as the lens does (OpenCV, four coefficients)."""
    k1, k2, p1, p2 = distortion
    x, y = normalized[..., 0], normalized[..., 1]
    squared = x * x + y * y
    radial = 1.0 + squared * (k1 + squared * k2)
    bent_x = x * radial + 2.0 * p1 * x * y + p2 * (squared + 2.0 * x * x)
    bent_y = y * radial + p1 * (squared + 2.0 * y * y) + 2.0 * p2 * x * y
    return np.stack([bent_x, bent_y], axis=-1)


def undistort(bent: Floats, distortion: Floats) -> Floats:
    """Inverse of :func:`distort` by fixed-point iteration, (..., 2)."""
    if not np.any(distortion):
        return bent.copy()
    straight = bent.copy()
    for _ in range(_UNDISTORTION_STEPS):
        straight = bent - (distort(straight, distortion) - straight)
    return straight


def project(view: View, points: ArrayLike) -> tuple[Floats, Floats]:
    """Where world points fall in a photo.

    Parameters
    ----------
    view : View
    points : (N, 3)
        World.

    Returns
    -------
    pixels : (N, 2) float64
        u to the right, v down; meaningless where the depth is not positive.
    depth : (N,) float64
        Along the optical axis, world unit.
    """
    local = np.asarray(points, dtype=np.float64) @ view.rotation.T + view.translation
    depth = local[:, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        normalized = local[:, :2] / depth[:, None]
    bent = distort(normalized, view.intrinsics.distortion)
    matrix = view.intrinsics.matrix
    u = matrix[0, 0] * bent[:, 0] + matrix[0, 1] * bent[:, 1] + matrix[0, 2]
    v = matrix[1, 1] * bent[:, 1] + matrix[1, 2]
    return np.stack([u, v], axis=1), depth


def pixel_rays(view: View, pixels: ArrayLike) -> tuple[Floats, Floats]:
    """Rays through pixels (N, 2): origin (3,) and unit directions (N, 3) in the world."""
    places = np.asarray(pixels, dtype=np.float64)
    matrix = view.intrinsics.matrix
    y = (places[:, 1] - matrix[1, 2]) / matrix[1, 1]
    x = (places[:, 0] - matrix[0, 2] - matrix[0, 1] * y) / matrix[0, 0]
    straight = undistort(np.stack([x, y], axis=1), view.intrinsics.distortion)
    directions = np.concatenate([straight, np.ones((len(straight), 1))], axis=1) @ view.rotation
    return view.center, directions / np.linalg.norm(directions, axis=1, keepdims=True)
