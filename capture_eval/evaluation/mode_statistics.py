"""Everything a fit of a warp per harmonic needs to know of the curves, in a few numbers per harmonic.

With displacement D and truth X(t) − w0 in the modes of the curve, the squared error of warps φ_n over all points is

    Σ_t [ E(t) − 2 Σ_n φ_n(t) C_n(t) + Σ_n φ_n(t)² S_n + 2 ψ(t) Σ_n φ_n(t) G_n ]

with S_n = |D_n|², C_n(t) = ⟨D_n, X_n(t)⟩, E = |X|², and G_n the product of the ramp of an open curve with its sine
modes (0 for closed curves, whose modes are orthogonal). Index 0 belongs to ψ, the mode without bending. Statistics of
curves of one kind add up, so that the cost of a fit does not depend on the number of points.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from capture_eval.errors import InputError
from capture_eval.interpolation.curve_modes import mode_count

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class ModeStatistics:
    """Sums over curves of one kind.

    Attributes
    ----------
    closed : bool
        Kind.
    size, cross : (N + 1,)
        S and G.
    along : (T, N + 1)
        C.
    total : (T,)
        E.
    points : int
        Number of points behind them.
    """

    closed: bool
    size: Floats
    cross: Floats
    along: Floats
    total: Floats
    points: int

    @property
    def point_count(self) -> int:
        """Points of the largest curve such harmonics belong to, for `DynamicPde.mode_warps`."""
        count = len(self.size) - 1
        return max(3, 2 * count) if self.closed else count + 2

    def cost(self, still: Floats, moving: Floats) -> float:
        """Sum of squared errors over points and times of warps ψ (T,) and φ (T, N or more)."""
        warps = np.column_stack([still, moving[:, : len(self.size) - 1]])
        squares = self.total - 2.0 * (warps * self.along).sum(axis=1) + warps**2 @ self.size
        return float((squares + 2.0 * still * (warps @ self.cross)).sum())


def curve_statistics(truth: Floats, closed: bool, poses: NDArray[np.int64]) -> ModeStatistics:
    """Statistics of one curve.

    Parameters
    ----------
    truth : (P, M, 3)
        Positions in all poses.
    closed : bool
        Kind.
    poses : (T,)
        Indices of the poses to fit.

    Raises
    ------
    InputError
        Positions that are not finite in the first, the last or a chosen pose.
    """
    chosen = truth[[0, -1, *poses.tolist()]]
    if not np.isfinite(chosen).all():
        raise InputError("a fit needs the first, the last and every chosen pose; one is missing")
    displacement, moved = truth[-1] - truth[0], truth[poses] - truth[0]
    total = (moved**2).sum(axis=(1, 2))
    if closed:
        weight = np.full(len(displacement) // 2 + 1, 2.0 / len(displacement))
        weight[0] /= 2.0
        if len(displacement) % 2 == 0:
            weight[-1] /= 2.0
        modes, goal = fft.rfft(displacement, axis=0), fft.rfft(moved, axis=1)
        size = weight * (np.abs(modes) ** 2).sum(axis=1)
        along = weight * (np.conj(modes) * goal).real.sum(axis=2)
        return ModeStatistics(True, size, np.zeros_like(size), along, total, len(displacement))
    place = np.linspace(0.0, 1.0, len(displacement))[:, None]
    ramp = (1.0 - place) * displacement[0] + place * displacement[-1]
    size, cross = np.zeros((2, mode_count(len(displacement), False) + 1))
    along = np.zeros((len(poses), len(size)))
    size[0] = (ramp**2).sum()
    along[:, 0] = (ramp * moved).sum(axis=(1, 2))
    if len(size) > 1:
        modes = fft.dst((displacement - ramp)[1:-1], type=1, axis=0, norm="ortho")
        size[1:] = (modes**2).sum(axis=1)
        cross[1:] = (modes * fft.dst(ramp[1:-1], type=1, axis=0, norm="ortho")).sum(axis=1)
        along[:, 1:] = (modes * fft.dst(moved[:, 1:-1], type=1, axis=1, norm="ortho")).sum(axis=2)
    return ModeStatistics(False, size, cross, along, total, len(displacement))


def add_statistics(parts: Iterable[ModeStatistics]) -> tuple[ModeStatistics, ...]:
    """One sum for the closed and one for the open curves among the parts (harmonics that a curve lacks are 0)."""
    sums = []
    every = list(parts)
    for closed in (True, False):
        chosen = [part for part in every if part.closed == closed]
        if not chosen:
            continue
        length = max(len(part.size) for part in chosen)
        size, cross = np.zeros((2, length))
        along = np.zeros((len(chosen[0].total), length))
        for part in chosen:
            kept = len(part.size)
            size[:kept] += part.size
            cross[:kept] += part.cross
            along[:, :kept] += part.along
        total = np.sum([part.total for part in chosen], axis=0)
        sums.append(ModeStatistics(closed, size, cross, along, total, sum(part.points for part in chosen)))
    return tuple(sums)
