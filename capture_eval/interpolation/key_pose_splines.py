"""Splines in time through further known poses: what knowing poses between the ends is worth.

These methods look at poses that the others have to predict. They are judged on the remaining poses only.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicHermiteSpline, make_interp_spline

from capture_eval.errors import InputError
from capture_eval.interpolation.linear import follow_chord
from capture_eval.interpolation.method import check_curve_pair

Floats = NDArray[np.float64]

KINDS = {"catmull_rom": "Catmull-Rom", "b_spline": "B-spline"}


@dataclass(frozen=True)
class KeyPoseSpline:
    """A curve in time through the first, the key and the last pose of every point.

    Parameters
    ----------
    kind : str
        ``catmull_rom``: cubic pieces whose velocity at a pose is the slope between its neighbours in time (one-sided
        at the ends). ``b_spline``: the interpolating cubic B-spline (quadratic through three poses).
    times : tuple of float
        t of the key poses, rising, inside (0, 1). Without any, points go straight and evenly.

    Raises
    ------
    InputError
        Unknown kind, or times out of order.
    """

    kind: str = "catmull_rom"
    times: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "times", tuple(float(value) for value in self.times))
        if self.kind not in KINDS:
            raise InputError(f"unknown kind of spline '{self.kind}'; known are {', '.join(KINDS)}")
        if not np.all(np.diff([0.0, *self.times, 1.0]) > 0):
            raise InputError(f"{self.kind}: times {self.times} of the key poses must rise inside (0, 1)")

    @property
    def title(self) -> str:
        """Name for figures and tables."""
        through = ", ".join(f"{t:g}" for t in self.times)
        return f"{KINDS[self.kind]} through t = {through}" if through else f"{KINDS[self.kind]} without key poses"

    @property
    def reference(self) -> str:
        """Source."""
        return (
            "Catmull and Rom (1974)" if self.kind == "catmull_rom" else "de Boor (1978), interpolating cubic B-spline"
        )

    @property
    def options(self) -> Mapping[str, object]:
        """Kind and key times."""
        return {"kind": self.kind, "times": self.times}

    @property
    def key_times(self) -> tuple[float, ...]:
        """t of the poses that the method must be given."""
        return self.times

    def predict(self, start: ArrayLike, end: ArrayLike, closed: bool, times: ArrayLike) -> Floats:
        """Shapes (T, M, 3) without key poses: straight and even; see `InterpolationMethod.predict`."""
        first, last, moments = check_curve_pair(start, end, closed, times)
        return follow_chord(first, last, moments)

    def predict_with_keys(
        self, start: ArrayLike, keys: ArrayLike, end: ArrayLike, closed: bool, times: ArrayLike
    ) -> Floats:
        """Shapes (T, M, 3) at the times; see `KeyPoseMethod.predict_with_keys`."""
        first, last, moments = check_curve_pair(start, end, closed, times)
        between = np.asarray(keys, dtype=np.float64)
        if between.shape != (len(self.times), *first.shape) or not np.isfinite(between).all():
            wanted = (len(self.times), *first.shape)
            raise InputError(f"{self.title}: key poses must be finite and of shape {wanted}, got {between.shape}")
        if not len(between):
            return follow_chord(first, last, moments)
        knots = np.array([0.0, *self.times, 1.0])
        poses = np.concatenate([first[None], between, last[None]])
        if self.kind == "b_spline":
            return np.asarray(make_interp_spline(knots, poses, k=min(3, len(knots) - 1))(moments), dtype=np.float64)
        slopes = np.empty_like(poses)
        slopes[1:-1] = (poses[2:] - poses[:-2]) / (knots[2:] - knots[:-2])[:, None, None]
        slopes[0], slopes[-1] = (
            (poses[1] - poses[0]) / (knots[1] - knots[0]),
            (poses[-1] - poses[-2]) / (knots[-1] - knots[-2]),
        )
        return np.asarray(CubicHermiteSpline(knots, poses, slopes)(moments), dtype=np.float64)

    def warnings(self, point_count: int, closed: bool) -> list[str]:
        """That the method knows more than others."""
        del point_count, closed
        if not self.times:
            return []
        through = ", ".join(f"{t:g}" for t in self.times)
        return [
            f"{self.title}: is given the poses at t = {through} besides the ends, which other methods must predict, "
            "and is judged on the remaining ones"
        ]
