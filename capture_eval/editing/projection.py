"""Where points fall on a screen, and how that changes when they move: Eq 2 of paper 001 with its analytic Jacobian.

One type serves the paper's screen and the cameras of photos, lens distortion included.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from capture_eval.cameras import View, distort
from capture_eval.errors import InputError

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Projection:
    """A pinhole screen: world to pixels.

    Attributes
    ----------
    width, height : int
        Pixels.
    rotation : (3, 3) float64
        local_from_world, orthonormal; a reflection is allowed, because Eq 2 with r3 pointing forwards and r2 upwards
        is one when the picture is not to be mirrored.
    translation : (3,) float64
        local_from_world, unit of the world. Points in front of the camera have a positive third coordinate.
    matrix : (2, 3) float64
        Pixels from (x/z, y/z, 1).
    distortion : (4,) float64
        k1, k2, p1, p2 of OpenCV; zero for the paper's screen.

    Raises
    ------
    InputError
        Wrong shapes, numbers that are not finite, no rotation, or an empty screen.
    """

    width: int
    height: int
    rotation: Floats
    translation: Floats
    matrix: Floats
    distortion: Floats

    def __post_init__(self) -> None:
        shapes = {"rotation": (3, 3), "translation": (3,), "matrix": (2, 3), "distortion": (4,)}
        for name, shape in shapes.items():
            values = np.ascontiguousarray(getattr(self, name), dtype=np.float64)
            if values.shape != shape or not np.all(np.isfinite(values)):
                raise InputError(f"projection: {name} {values.shape} must be finite and {shape}")
            object.__setattr__(self, name, values)
        if not np.allclose(self.rotation @ self.rotation.T, np.eye(3), atol=1e-6):
            raise InputError("projection: the rotation's rows are not orthonormal")
        if self.width < 1 or self.height < 1:
            raise InputError(f"projection: a screen of {self.width}x{self.height} pixels")

    @classmethod
    def from_view(cls, view: View) -> Projection:
        """The screen of a photo's camera."""
        lens = view.intrinsics
        return cls(lens.width, lens.height, view.rotation, view.translation, lens.matrix[:2], lens.distortion)

    @classmethod
    def from_screen(
        cls, rotation: ArrayLike, translation: ArrayLike, focal: float, width: int, height: int
    ) -> Projection:
        """The paper's screen (Eq 2).

        ``u = ((f r1·q + f t1)/(r3·q + t3) + 1) w/2`` and ``v = (1 − (f r2·q + f t2)/(r3·q + t3)) h/2``; one focal
        length in half-image units for both axes, so that pixels are square only on a square screen.
        """
        matrix = np.array([[focal * width / 2, 0.0, width / 2], [0.0, -focal * height / 2, height / 2]])
        return cls(width, height, np.asarray(rotation), np.asarray(translation), matrix, np.zeros(4))

    def project(self, points: ArrayLike) -> Floats:
        """Pixels (..., 2) of world points (..., 3).

        Raises
        ------
        InputError
            A point lies behind the camera.
        """
        local = self._local(points)
        bent = distort(local[..., :2] / local[..., 2:], self.distortion)
        return np.asarray(bent @ self.matrix[:, :2].T + self.matrix[:, 2], dtype=np.float64)

    def project_with_jacobian(self, points: ArrayLike) -> tuple[Floats, Floats]:
        """Pixels (..., 2) and their derivatives by the world point (..., 2, 3), pixels per unit of the world.

        Raises
        ------
        InputError
            A point lies behind the camera.
        """
        local = self._local(points)
        ideal = local[..., :2] / local[..., 2:]
        pixels = distort(ideal, self.distortion) @ self.matrix[:, :2].T + self.matrix[:, 2]
        ideal_by_local = np.zeros((*local.shape[:-1], 2, 3))
        ideal_by_local[..., 0, 0] = ideal_by_local[..., 1, 1] = 1.0 / local[..., 2]
        ideal_by_local[..., 2] = -ideal / local[..., 2:]
        by_ideal = self.matrix[:, :2] @ _distortion_jacobian(ideal, self.distortion)
        return pixels, np.asarray(by_ideal @ ideal_by_local @ self.rotation, dtype=np.float64)

    def _local(self, points: ArrayLike) -> Floats:
        local = np.asarray(points, dtype=np.float64) @ self.rotation.T + self.translation
        depth = local[..., 2]
        if not np.all(depth > 0):
            raise InputError(f"projection: a point lies behind the camera (depth {np.min(depth):.6g})")
        return np.asarray(local, dtype=np.float64)


def _distortion_jacobian(ideal: Floats, distortion: Floats) -> Floats:
    """Derivative (..., 2, 2) of :func:`capture_eval.cameras.distort` by the ideal image coordinates (..., 2)."""
    k1, k2, p1, p2 = distortion
    x, y = ideal[..., 0], ideal[..., 1]
    squared = x * x + y * y
    radial = 1.0 + squared * (k1 + squared * k2)
    slope = 2.0 * (k1 + 2.0 * squared * k2)
    jacobian = np.empty((*ideal.shape, 2))
    jacobian[..., 0, 0] = radial + slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x
    jacobian[..., 1, 1] = radial + slope * y * y + 6.0 * p1 * y + 2.0 * p2 * x
    jacobian[..., 0, 1] = jacobian[..., 1, 0] = slope * x * y + 2.0 * p1 * x + 2.0 * p2 * y
    return jacobian
