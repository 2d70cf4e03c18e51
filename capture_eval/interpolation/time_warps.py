"""Straight paths walked with another timing: cosine ease and powers of time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from capture_eval.errors import InputError
from capture_eval.interpolation.linear import follow_chord
from capture_eval.interpolation.method import check_curve_pair

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class CosineInterpolation:
    """``w(t) = w0 + (1 − cos πt)/2 · (w1 − w0)``: slow at both ends."""

    @property
    def title(self) -> str:
        """Name for figures and tables."""
        return "cosine"

    @property
    def reference(self) -> str:
        """Source."""
        return "cosine ease in and out of the straight path"

    @property
    def options(self) -> Mapping[str, object]:
        """No parameters."""
        return {}

    def predict(self, start: ArrayLike, end: ArrayLike, closed: bool, times: ArrayLike) -> Floats:
        """Shapes (T, M, 3) at the times; see `InterpolationMethod.predict`."""
        first, last, moments = check_curve_pair(start, end, closed, times)
        # sin² keeps the symmetry about t = 1/2 to the last bit, 1 − cos loses it near 0
        return follow_chord(first, last, np.sin(0.5 * np.pi * moments) ** 2)

    def warnings(self, point_count: int, closed: bool) -> list[str]:
        """Nothing to warn of."""
        del point_count, closed
        return []


@dataclass(frozen=True)
class PowerInterpolation:
    """``w(t) = w0 + t^p (w1 − w0)`` with a real exponent p > 0.

    Parameters
    ----------
    exponent : float
        p; 1 is geometric linear, 2 and 3 are the limits of the quadratic and cubic PDE for stiff curves.

    Raises
    ------
    InputError
        The exponent is not positive and finite.
    """

    exponent: float = 2.0

    def __post_init__(self) -> None:
        if not (np.isfinite(self.exponent) and self.exponent > 0):
            raise InputError(f"power: exponent {self.exponent} must be positive and finite")

    @property
    def title(self) -> str:
        """Name for figures and tables."""
        return f"t^{self.exponent:g}"

    @property
    def reference(self) -> str:
        """Source."""
        return "power of time on the straight path"

    @property
    def options(self) -> Mapping[str, object]:
        """The exponent."""
        return {"exponent": self.exponent}

    def predict(self, start: ArrayLike, end: ArrayLike, closed: bool, times: ArrayLike) -> Floats:
        """Shapes (T, M, 3) at the times; see `InterpolationMethod.predict`."""
        first, last, moments = check_curve_pair(start, end, closed, times)
        return follow_chord(first, last, moments**self.exponent)

    def warnings(self, point_count: int, closed: bool) -> list[str]:
        """Nothing to warn of."""
        del point_count, closed
        return []
