"""What the error bars of registered vertices do to the errors of the evaluation.

The error of an interpolation is the distance w' - w between a prediction from the first and last pose and the pose
itself. For straight even motion w' = (1 - t) w_0 + t w_P, and with motion errors measured from the neutral (so that the
neutral has none) and independent between poses, the error of w' - w at a point has the bar

    u_j(t)^2 = m_j(t)^2 + t^2 m_j(1)^2.

Other methods weigh the end poses a little differently; the same bar is used for them. For a curve, every point's error
is taken to be correlated in full with the others (they share smoothing, cameras and light), which is the worst case:
E_A is then uncertain by the mean of u_j, E_M by the largest. Independent points would give 1/sqrt(M) of it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture_eval.curves.extract import CurveSet
from capture_eval.errors import InputError
from capture_eval.evaluation.error_table import ErrorTable

Floats = NDArray[np.float64]
Booleans = NDArray[np.bool_]

# Mean true error over mean 95 % bar of confident vertices, on the capture that the bars were fitted to.
MEAN_OF_BAR = 0.40


@dataclass(frozen=True)
class CurveBars:
    """Bars of every curve and in-between pose, as fractions of D; NaN where the registration gave none.

    Parameters
    ----------
    curves : tuple of str
    t : (T,) float64
    n_points : (N, T) int64
    average, maximum : (N, T) float64
        95 % bars of E_A and E_M.
    """

    curves: tuple[str, ...]
    t: Floats
    n_points: NDArray[np.int64]
    average: Floats
    maximum: Floats

    @property
    def floor(self) -> Floats:
        """E_A that the ground truth's error alone shows on average, (N, T)."""
        return MEAN_OF_BAR * self.average

    def rows(self) -> list[tuple[str, float, int, float, float, float]]:
        """Rows (curve, t, n_points, E_A floor, E_A bar, E_M bar)."""
        return [
            (
                curve,
                float(self.t[i]),
                int(self.n_points[n, i]),
                float(self.floor[n, i]),
                float(self.average[n, i]),
                float(self.maximum[n, i]),
            )
            for n, curve in enumerate(self.curves)
            for i in range(len(self.t))
        ]

    def summary(self) -> dict[str, Any]:
        """Plain values for ``summary.json``."""
        known = np.isfinite(self.average)
        rows = self.average[known]
        return {
            "definition": "from the error bars of the registered vertices: E_A that the ground truth's own error shows",
            "assumption": "errors of poses independent, of the points of a curve fully correlated",
            "mean_E_A": float(self.floor[known].mean()) if rows.size else None,
            "largest_E_A": float(self.floor[known].max()) if rows.size else None,
            "bar_E_A_median": float(np.median(rows)) if rows.size else None,
            "bar_E_A_largest": float(rows.max()) if rows.size else None,
            "bar_E_M_median": float(np.median(self.maximum[known])) if rows.size else None,
            "bar_E_M_largest": float(self.maximum[known].max()) if rows.size else None,
        }


def curve_bars(
    motion_bar: Floats, curves: CurveSet, t: Floats, counted: tuple[Booleans, ...], diameter: float
) -> CurveBars:
    """Propagate the bars of vertices to E_A and E_M.

    Parameters
    ----------
    motion_bar : (P, V) float64
        95 % bars in the unit of the positions; NaN where unknown.
    curves : CurveSet
    t : (P,) float64
    counted : tuple of (M_n,) bool
        Points of every curve that count.
    diameter : float
        D in the same unit.

    Raises
    ------
    InputError
        Bars and times do not fit.
    """
    if motion_bar.ndim != 2 or len(motion_bar) != len(t):
        raise InputError(f"error bars: {motion_bar.shape} for {len(t)} poses")
    shape = (len(curves), len(t) - 2)
    average, maximum = np.full(shape, np.nan), np.full(shape, np.nan)
    n_points = np.zeros(shape, dtype=np.int64)
    inner = t[1:-1, None]
    for n, curve in enumerate(curves.curves):
        points = curve.vertices[counted[n]]
        if len(points) == 0:
            continue
        bars = motion_bar[:, points] / diameter
        combined = np.sqrt(bars[1:-1] ** 2 + (inner * bars[-1]) ** 2)
        whole = np.isfinite(combined).all(axis=1)
        average[n, whole], maximum[n, whole] = combined[whole].mean(axis=1), combined[whole].max(axis=1)
        n_points[n, whole] = len(points)
    return CurveBars(tuple(curve.name for curve in curves.curves), t[1:-1].copy(), n_points, average, maximum)


def curve_bar_coverage(bars: CurveBars, photos: ErrorTable, truth: ErrorTable) -> dict[str, dict[str, float | None]]:
    """Share of curves and poses, per method, whose E_A and E_M differ from the truth's by less than their bars."""
    result: dict[str, dict[str, float | None]] = {}
    for k, name in enumerate(photos.methods):
        row: dict[str, float | None] = {}
        for key, bar, one, other in (
            ("E_A", bars.average, photos.average, truth.average),
            ("E_M", bars.maximum, photos.maximum, truth.maximum),
        ):
            difference = np.abs(one[k] - other[k])
            known = np.isfinite(difference) & np.isfinite(bar)
            row[f"{key}_inside"] = float(np.mean(difference[known] <= bar[known])) if known.any() else None
        result[name] = row
    return result
