"""What the user asks of control points: pixels on a screen or points in space, as residuals with derivatives.

Residuals of both kinds have three components (the third of a pixel is zero), so that one drag may mix them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from capture_eval.editing.projection import Projection
from capture_eval.errors import InputError

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class ControlPoint:
    """A vertex and where it is to go.

    Attributes
    ----------
    vertex : int
    target : tuple of two or three float
        Pixel (u, v), where the centre of the top-left pixel is (0.5, 0.5), or point (x, y, z) in the model's frame
        and unit.

    Raises
    ------
    InputError
        A target of another length or with numbers that are not finite.
    """

    vertex: int
    target: tuple[float, ...]

    def __post_init__(self) -> None:
        if len(self.target) not in (2, 3):
            raise InputError(f"control {self.vertex}: {len(self.target)} numbers as target, expected x,y or x,y,z")
        if not np.all(np.isfinite(self.target)):
            raise InputError(f"control {self.vertex}: the target {self.target} is not finite")
        object.__setattr__(self, "target", tuple(float(value) for value in self.target))


@dataclass(frozen=True)
class Targets:
    """Targets of L control points.

    Attributes
    ----------
    values : (L, 3) float64
        Pixels (third number zero) or points.
    on_screen : (L,) bool
        Which are pixels.
    projection : Projection or None
        Needed by pixels.
    pixel_unit, length_unit : float
        Residuals are divided by these: 1 for the printed Eqs 5 and 6.
    """

    values: Floats
    on_screen: NDArray[np.bool_]
    projection: Projection | None
    pixel_unit: float = 1.0
    length_unit: float = 1.0

    def select(self, chosen: NDArray[np.bool_]) -> Targets:
        """The targets of some control points."""
        return replace(self, values=self.values[chosen], on_screen=self.on_screen[chosen])

    def residuals(self, points: Floats) -> Floats:
        """What is missing at points (L, ..., 3) of the control points, in units, (L, ..., 3)."""
        values = self.values.reshape(len(points), *([1] * (points.ndim - 2)), 3)
        result = (points - values) / self.length_unit
        if np.any(self.on_screen):
            pixels = self._screen().project(points[self.on_screen])
            result[self.on_screen, ..., :2] = (pixels - values[self.on_screen][..., :2]) / self.pixel_unit
            result[self.on_screen, ..., 2] = 0.0
        return result

    def residuals_with_jacobian(self, points: Floats) -> tuple[Floats, Floats]:
        """Residuals (L, 3) at one point (L, 3) each, and their derivatives (L, 3, 3)."""
        residual = (points - self.values) / self.length_unit
        jacobian = np.tile(np.eye(3) / self.length_unit, (len(points), 1, 1))
        if np.any(self.on_screen):
            pixels, slope = self._screen().project_with_jacobian(points[self.on_screen])
            residual[self.on_screen, :2] = (pixels - self.values[self.on_screen, :2]) / self.pixel_unit
            residual[self.on_screen, 2] = 0.0
            jacobian[self.on_screen, :2] = slope / self.pixel_unit
            jacobian[self.on_screen, 2] = 0.0
        return residual, jacobian

    def distances(self, points: Floats) -> Floats:
        """Distances (L,) of points (L, 3) from their targets, in pixels or the unit of the model."""
        unit = np.where(self.on_screen, self.pixel_unit, self.length_unit)
        return np.asarray(np.linalg.norm(self.residuals(points), axis=1) * unit, dtype=np.float64)

    def depths(self, points: Floats) -> Floats:
        """Depths (L,) of the points (L, 3) with pixel targets in front of the camera; 1 for targets in space."""
        result = np.ones(len(points))
        if np.any(self.on_screen):
            screen = self._screen()
            depth = points @ screen.rotation[2] + screen.translation[2]
            result[self.on_screen] = depth[self.on_screen]
        return result

    def limited(self, rest: Floats, examples: Floats, reach: float) -> tuple[Targets, NDArray[np.bool_]]:
        """Targets no farther from rest than ``reach`` times what the farthest example reaches, and which were moved.

        Parameters
        ----------
        rest : (L, 3)
            Control points of the neutral face.
        examples : (L, M, 3)
            Control points in the examples.
        reach : float
        """
        start = self.residuals(rest)  # of pixels too, distances are taken on the screen
        farthest = np.linalg.norm(self.residuals(examples) - start[:, None], axis=-1).max(axis=1)
        asked = np.linalg.norm(start, axis=-1)
        moved = asked > reach * farthest
        share = np.where(moved, reach * farthest / np.maximum(asked, 1e-300), 1.0)
        unit = np.where(self.on_screen, self.pixel_unit, self.length_unit)[:, None]
        return replace(self, values=self.values + unit * start * (1.0 - share)[:, None]), moved

    def _screen(self) -> Projection:
        if self.projection is None:
            raise InputError("control points with pixel targets need a camera; give one, or targets x,y,z")
        return self.projection


def gather_targets(
    controls: Sequence[ControlPoint],
    projection: Projection | None,
    pixel_unit: float = 1.0,
    length_unit: float = 1.0,
) -> Targets:
    """Targets of control points as arrays.

    Raises
    ------
    InputError
        A pixel without a camera, or a point in space that lies behind the camera that is given.
    """
    values = np.zeros((len(controls), 3))
    for row, control in enumerate(controls):
        values[row, : len(control.target)] = control.target
    on_screen = np.array([len(control.target) == 2 for control in controls], dtype=np.bool_)
    if np.any(on_screen) and projection is None:
        vertex = controls[int(np.argmax(on_screen))].vertex
        raise InputError(f"control {vertex}: a pixel as target needs a camera; give one, or a target x,y,z")
    if projection is not None:
        depth = values @ projection.rotation[2] + projection.translation[2]
        behind = ~on_screen & (depth <= 0)
        if np.any(behind):
            raise InputError(f"control {controls[int(np.argmax(behind))].vertex}: the target lies behind the camera")
    return Targets(values, on_screen, projection, pixel_unit, length_unit)
