"""Geometric linear interpolation: every point goes straight and evenly."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from capture_eval.interpolation.method import check_curve_pair

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class LinearInterpolation:
    """``w(t) = (1 − t) w0 + t w1``, the baseline of paper 003 (its Eq 34)."""

    @property
    def title(self) -> str:
        """Name for figures and tables."""
        return "geometric linear"

    @property
    def reference(self) -> str:
        """Source."""
        return "linear interpolation, the baseline of paper 003, Eq (34)"

    @property
    def options(self) -> Mapping[str, object]:
        """No parameters."""
        return {}

    def predict(self, start: ArrayLike, end: ArrayLike, closed: bool, times: ArrayLike) -> Floats:
        """Shapes (T, M, 3) at the times; see `InterpolationMethod.predict`."""
        first, last, moments = check_curve_pair(start, end, closed, times)
        return follow_chord(first, last, moments)

    def warnings(self, point_count: int, closed: bool) -> list[str]:
        """Nothing to warn of."""
        del point_count, closed
        return []


def follow_chord(start: Floats, end: Floats, progress: Floats) -> Floats:
    """Points on the straight paths, (T, M, 3), at the share ``progress`` (T,) of the way; both ends are met exactly."""
    share, chord = progress[:, None, None], end - start
    early = progress < 0.5
    found = np.empty((len(progress), *chord.shape))
    found[early] = start + share[early] * chord
    found[~early] = end - (1.0 - share[~early]) * chord
    return found
