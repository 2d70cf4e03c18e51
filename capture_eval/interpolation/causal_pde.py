"""The dynamic PDE of paper 003 with its homogeneous solutions kept: curves that start at rest and in equilibrium.

Its warps rise without running back and are never singular, for every real R ≥ 1 (`causal_warps.py`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from capture_eval.errors import InputError
from capture_eval.interpolation.causal_warps import causal_warps
from capture_eval.interpolation.curve_modes import SAMPLES, describe_warps, mode_count, spread_modes, wave_numbers
from capture_eval.interpolation.linear import follow_chord
from capture_eval.interpolation.method import check_curve_pair

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class CausalPde:
    """``m w_tt + c w_t + κ (w − w0) + k w_uuuu = f`` from rest, force ∝ t^R.

    Without a foundation (κ = 0) the mode without bending lags behind the stiff ones and drags resting points along;
    the default κ keeps them in place.

    Parameters
    ----------
    order : float
        R, real, from 1 to 20.
    mass, damping, rigidity, foundation : float
        m, c, k and κ, not negative; only their ratios matter.

    Raises
    ------
    InputError
        A parameter outside its range, or all of them 0.
    """

    order: float = 2.0
    mass: float = 1.0
    damping: float = 1.0
    rigidity: float = 1.0
    foundation: float = 1000.0

    def __post_init__(self) -> None:
        for name in ("mass", "damping", "rigidity", "foundation"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value >= 0):
                raise InputError(f"causal PDE: {name} = {value} must be finite and not negative")
        if self.rigidity == 0 and self.foundation == 0:
            raise InputError("causal PDE: rigidity and foundation are both 0; one must be positive")
        causal_warps(self.order, self.mass, self.damping, [self.foundation], [1.0])

    @property
    def title(self) -> str:
        """Name for figures and tables."""
        return f"PDE from rest, R = {self.order:g}"

    @property
    def reference(self) -> str:
        """Source."""
        return "the PDE of paper 003, Eq (5), solved with its homogeneous part from a start at rest"

    @property
    def options(self) -> Mapping[str, object]:
        """All parameters."""
        return {name: getattr(self, name) for name in self.__dataclass_fields__}

    def predict(self, start: ArrayLike, end: ArrayLike, closed: bool, times: ArrayLike) -> Floats:
        """Shapes (T, M, 3) at the times; see `InterpolationMethod.predict`."""
        first, last, moments = check_curve_pair(start, end, closed, times)
        still, moving = self._mode_warps(len(first), closed, moments)
        power = moments**self.order
        base = follow_chord(first, last, power)
        return base + spread_modes(last - first, closed, still - power, moving - power[:, None])

    def _mode_warps(self, point_count: int, closed: bool, times: Floats) -> tuple[Floats, Floats]:
        waves = wave_numbers(mode_count(point_count, closed), closed)
        stiffness = self.foundation + self.rigidity * np.concatenate([[0.0], waves]) ** 4
        warps = causal_warps(self.order, self.mass, self.damping, stiffness, times)
        return warps[:, 0], warps[:, 1:]

    def warnings(self, point_count: int, closed: bool) -> list[str]:
        """A mode without bending that leaks; these warps never run backwards."""
        return describe_warps(self.title, *self._mode_warps(point_count, closed, SAMPLES[::10]))
