"""Interpolation of PDE surfaces (paper 000) as a method on curves.

On the boundary curves of its patches the surface is the truncated series of the curve, and two models are
interpolated linearly coefficient by coefficient. What a curve gets is therefore the geometric linear interpolation of
its first N harmonics: its errors are those of geometric linear plus what the truncation leaves out.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from capture_eval.errors import InputError
from capture_eval.interpolation.curve_modes import mode_count
from capture_eval.interpolation.linear import follow_chord
from capture_eval.interpolation.method import check_curve_pair
from capture_eval.interpolation.static_pde_surface import curve_parameters, curve_series

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class PdeSurfaceInterpolation:
    """Curves on PDE surfaces that are interpolated linearly (paper 000, Eqs 22-25).

    It does not meet the given shapes at t = 0 and t = 1 when a curve has more harmonics than N: that is its error.

    Parameters
    ----------
    harmonics : int
        N of the series of every curve, 1 or more; a curve that holds fewer is represented exactly.

    Raises
    ------
    InputError
        N is below 1.
    """

    harmonics: int = 20

    def __post_init__(self) -> None:
        if isinstance(self.harmonics, bool) or self.harmonics != int(self.harmonics) or self.harmonics < 1:
            raise InputError(f"PDE surface: harmonics = {self.harmonics} must be a whole number, 1 or more")

    @property
    def title(self) -> str:
        """Name for figures and tables."""
        return f"PDE surface, N = {self.harmonics}"

    @property
    def reference(self) -> str:
        """Source."""
        return "paper 000, Eqs (13), (22)-(25), on the boundary curves of the patches"

    @property
    def options(self) -> Mapping[str, object]:
        """N."""
        return {"harmonics": self.harmonics}

    def predict(self, start: ArrayLike, end: ArrayLike, closed: bool, times: ArrayLike) -> Floats:
        """Shapes (T, M, 3) at the times; see `InterpolationMethod.predict`."""
        first, last, moments = check_curve_pair(start, end, closed, times)
        count = min(self.harmonics, mode_count(len(first), closed))
        v = curve_parameters(len(first), closed)
        shown = [curve_series(shape, closed, count).points(v) for shape in (first, last)]
        return follow_chord(shown[0], shown[1], moments)

    def warnings(self, point_count: int, closed: bool) -> list[str]:
        """A curve whose first and last shape are not met."""
        if mode_count(point_count, closed) <= self.harmonics:
            return []
        kind = "closed" if closed else "open"
        return [
            f"{self.title}: {kind} curves of {point_count} points hold more harmonics; their given first and last "
            "shapes are not met"
        ]
