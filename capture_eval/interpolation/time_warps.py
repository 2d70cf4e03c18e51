"""Straight paths walked with another timing: cosine, powers of time, Beta distributions, monotone cubics."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import PchipInterpolator
from scipy.special import betainc

from capture_eval.errors import InputError
from capture_eval.interpolation.linear import follow_chord
from capture_eval.interpolation.method import check_curve_pair

Floats = NDArray[np.float64]


class TimeWarp(ABC):
    """``w(t) = w0 + φ(t) (w1 − w0)`` with one timing φ for all points; φ(0) = 0 and φ(1) = 1."""

    @abstractmethod
    def progress(self, times: Floats) -> Floats:
        """φ at the times."""

    @property
    def options(self) -> Mapping[str, object]:
        """All parameters."""
        fields: Mapping[str, object] = getattr(self, "__dataclass_fields__", {})
        return {name: getattr(self, name) for name in fields}

    def predict(self, start: ArrayLike, end: ArrayLike, closed: bool, times: ArrayLike) -> Floats:
        """Shapes (T, M, 3) at the times; see `InterpolationMethod.predict`."""
        first, last, moments = check_curve_pair(start, end, closed, times)
        return follow_chord(first, last, self.progress(moments))

    def warnings(self, point_count: int, closed: bool) -> list[str]:
        """Nothing to warn of: these timings neither run back nor past the end."""
        del point_count, closed
        return []


@dataclass(frozen=True)
class CosineInterpolation(TimeWarp):
    """φ = (1 − cos πt)/2: slow at both ends."""

    @property
    def title(self) -> str:
        """Name for figures and tables."""
        return "cosine"

    @property
    def reference(self) -> str:
        """Source."""
        return "cosine ease in and out of the straight path"

    def progress(self, times: Floats) -> Floats:
        """φ at the times."""
        # sin² keeps the symmetry about t = 1/2 to the last bit, 1 − cos loses it near 0
        return np.sin(0.5 * np.pi * times) ** 2


@dataclass(frozen=True)
class PowerInterpolation(TimeWarp):
    """φ = t^p with a real exponent p > 0.

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

    def progress(self, times: Floats) -> Floats:
        """φ at the times."""
        result: Floats = times**self.exponent
        return result


@dataclass(frozen=True)
class BetaInterpolation(TimeWarp):
    """φ is the distribution function of the Beta distribution: two parameters ease in and out.

    Parameters
    ----------
    rise, settle : float
        a and b, positive. (p, 1) is t^p, (2, 2) is 3t² − 2t³; the larger b, the softer the arrival.

    Raises
    ------
    InputError
        A parameter is not positive and finite.
    """

    rise: float = 2.0
    settle: float = 2.0

    def __post_init__(self) -> None:
        for name in ("rise", "settle"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0):
                raise InputError(f"beta: {name} {value} must be positive and finite")

    @property
    def title(self) -> str:
        """Name for figures and tables."""
        return f"Beta({self.rise:g}, {self.settle:g})"

    @property
    def reference(self) -> str:
        """Source."""
        return "regularised incomplete Beta function of time on the straight path"

    def progress(self, times: Floats) -> Floats:
        """φ at the times."""
        return np.asarray(betainc(self.rise, self.settle, times), dtype=np.float64)


@dataclass(frozen=True)
class MonotoneInterpolation(TimeWarp):
    """φ is a monotone cubic through given points (Fritsch and Carlson's PCHIP).

    Parameters
    ----------
    times : tuple of float
        Rising, inside (0, 1).
    shares : tuple of float
        Share of the way at these times, not falling, in [0, 1].

    Raises
    ------
    InputError
        Unequal numbers, times out of order, or shares that fall.
    """

    times: tuple[float, ...] = (0.5,)
    shares: tuple[float, ...] = (0.5,)

    def __post_init__(self) -> None:
        object.__setattr__(self, "times", tuple(float(value) for value in self.times))
        object.__setattr__(self, "shares", tuple(float(value) for value in self.shares))
        if len(self.times) != len(self.shares):
            raise InputError(f"monotone: {len(self.times)} times for {len(self.shares)} shares")
        if not np.all(np.diff([0.0, *self.times, 1.0]) > 0):
            raise InputError(f"monotone: times {self.times} must rise inside (0, 1)")
        if not np.all(np.diff([0.0, *self.shares, 1.0]) >= 0):
            raise InputError(f"monotone: shares {self.shares} must not fall and lie in [0, 1]")

    @property
    def title(self) -> str:
        """Name for figures and tables."""
        return "monotone cubic timing"

    @property
    def reference(self) -> str:
        """Source."""
        return "Fritsch and Carlson (1980), monotone piecewise cubic interpolation, of time on the straight path"

    def progress(self, times: Floats) -> Floats:
        """φ at the times."""
        curve = _monotone_cubic((0.0, *self.times, 1.0), (0.0, *self.shares, 1.0))
        return np.asarray(curve(times), dtype=np.float64)


@lru_cache(maxsize=8)
def _monotone_cubic(times: tuple[float, ...], shares: tuple[float, ...]) -> PchipInterpolator:
    """Kept, since making one takes longer than moving a curve by it."""
    return PchipInterpolator(times, shares)
