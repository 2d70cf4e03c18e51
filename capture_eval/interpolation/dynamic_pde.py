"""Dynamic PDE interpolation of curves (paper 003): ``m w_tt + c w_t + κ (w − w0) + k w_uuuu = f``, force ê + ě t^R.

Every harmonic of the displacement goes its own way in time (`warps.py`). A closed curve is expanded by FFT, an open
one into a ramp between its ends plus a sine series (simply supported ends), since a periodic expansion of an open
curve does not converge. Points are placed at equal steps of u, in the order of the curve.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from capture_eval.errors import InputError, SolverError
from capture_eval.interpolation.curve_modes import SAMPLES, describe_warps, mode_count, spread_modes, wave_numbers
from capture_eval.interpolation.linear import follow_chord
from capture_eval.interpolation.method import check_curve_pair
from capture_eval.interpolation.warps import CLOSURES, check_order, harmonic_warps, zero_mode_warp

Floats = NDArray[np.float64]

_NAMES = {1: "linear", 2: "quadratic", 3: "cubic"}


@dataclass(frozen=True)
class DynamicPde:
    """Interpolation whose curves obey the dynamic PDE of paper 003.

    Only the ratios c/k, m/k, m/c and κ/k matter. With the default parameters the harmonics of closed curves follow
    t^R to 2e-3 and those of open ones (16 times less stiff) to 3e-2: the physics shows where c/k is 100 or more.

    Parameters
    ----------
    order : int
        R ≥ 1, the power of time in the force: 1 linear, 2 quadratic, 3 cubic.
    mass, damping, rigidity : float
        m, c and k of the PDE, not negative, per unit of the curve parameter u in [0, 1].
    foundation : float
        κ, stiffness against leaving the start shape; 0 is the paper's PDE. When it is positive, the mode without
        bending obeys the same formula as the others and ``closure`` is not used.
    closure : str
        What settles the third unknown of the mode without bending, see `zero_mode_warp`.
    closure_bend : float
        η of the closure ``fit``, whose value comes from a fit to poses (`evaluation/fitting.py`); 0 is ``linear``.
    harmonics : int, optional
        N, number of harmonics that follow the PDE; all by default.
    exact_ends : bool
        With ``harmonics``: the rest follows t^R, so both ends are met (default), or is left out as in the paper.

    Raises
    ------
    InputError
        A parameter outside its range.
    SolverError
        A closure that the parameters make unsolvable.
    """

    order: int = 2
    mass: float = 1.0
    damping: float = 1.0
    rigidity: float = 1.0
    foundation: float = 0.0
    closure: str = "stiff"
    closure_bend: float = 0.0
    harmonics: int | None = None
    exact_ends: bool = True

    def __post_init__(self) -> None:
        check_order(self.order)
        for name in ("mass", "damping", "rigidity", "foundation"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value >= 0):
                raise InputError(f"dynamic PDE: {name} = {value} must be finite and not negative")
        if self.rigidity == 0 and self.foundation == 0:
            raise InputError("dynamic PDE: rigidity and foundation are both 0; one must be positive")
        if self.harmonics is not None and (isinstance(self.harmonics, bool) or self.harmonics < 0):
            raise InputError(f"dynamic PDE: harmonics = {self.harmonics} must be 0 or more")
        if self.closure not in CLOSURES:
            raise InputError(f"unknown zero-mode closure '{self.closure}'; known are {', '.join(CLOSURES)}")
        if not np.isfinite(self.closure_bend):
            raise InputError(f"dynamic PDE: closure_bend = {self.closure_bend} must be finite")
        self._still_warp(np.array([0.0, 1.0]))

    @property
    def title(self) -> str:
        """Name for figures and tables."""
        return f"PDE {_NAMES.get(self.order, f'R = {self.order}')}"

    @property
    def reference(self) -> str:
        """Source."""
        return "paper 003, Eqs (5)-(33), with the errata and closures stated in the documentation"

    @property
    def options(self) -> Mapping[str, object]:
        """All parameters."""
        return {name: getattr(self, name) for name in self.__dataclass_fields__}

    def predict(self, start: ArrayLike, end: ArrayLike, closed: bool, times: ArrayLike) -> Floats:
        """Shapes (T, M, 3) at the times; see `InterpolationMethod.predict`.

        Raises
        ------
        InputError
            Bad arguments, or more harmonics than the points of the curve can hold.
        SolverError
            The parameters make a harmonic of this curve unsolvable; the text gives the numbers.
        """
        first, last, moments = check_curve_pair(start, end, closed, times)
        displacement = last - first
        still, moving = _kept_warps(self, len(first), bool(closed), moments.tobytes())
        if self.exact_ends:
            power = moments**self.order
            base = follow_chord(first, last, power)
            return base + spread_modes(displacement, closed, still - power, moving - power[:, None])
        return first + spread_modes(displacement, closed, still, moving)

    def mode_warps(self, point_count: int, closed: bool, times: Floats) -> tuple[Floats, Floats]:
        """Warps of the modes of a curve.

        Parameters
        ----------
        point_count : int
            M.
        closed : bool
            Fourier (n up to M/2) or sine modes (n up to M − 2).
        times : (T,)
            Moments.

        Returns
        -------
        still : (T,)
            Warp of the mode without bending: mean of a closed curve, ramp of an open one.
        moving : (T, N)
            Warps of the harmonics 1 … N that follow the PDE.
        """
        count = self._harmonic_count(point_count, closed)
        stiffness = self.foundation + self.rigidity * wave_numbers(count, closed) ** 4
        if count == 0:
            return self._still_warp(times), np.zeros((len(times), 0))
        try:
            moving = harmonic_warps(self.order, self.damping / stiffness, self.mass / stiffness, times)
        except SolverError as problem:
            numbers = f"m = {self.mass:g}, c = {self.damping:g}, k = {self.rigidity:g}, κ = {self.foundation:g}"
            raise SolverError(f"{self.title} with {numbers}: {problem}") from problem
        return self._still_warp(times), moving

    def _harmonic_count(self, point_count: int, closed: bool) -> int:
        most = mode_count(point_count, closed)
        if self.harmonics is None:
            return most
        if self.harmonics > most:
            kind = "a closed" if closed else "an open"
            raise InputError(
                f"{self.title}: {self.harmonics} harmonics on {kind} curve of {point_count} points, which holds {most}"
            )
        return self.harmonics

    def _still_warp(self, times: Floats) -> Floats:
        if self.foundation > 0:
            alpha, mu = self.damping / self.foundation, self.mass / self.foundation
            still: Floats = harmonic_warps(self.order, [alpha], [mu], times, first_harmonic=0)[:, 0]
            return still
        return zero_mode_warp(self.closure, self.order, self.mass, self.damping, times, self.closure_bend)

    def warnings(self, point_count: int, closed: bool) -> list[str]:
        """Modes of such a curve that run backwards or past their end, and zero-mode closures that leak."""
        still, moving = self.mode_warps(point_count, closed, SAMPLES)
        return describe_warps(self.title, still, moving)


@lru_cache(maxsize=8)
def _kept_warps(method: DynamicPde, point_count: int, closed: bool, moments: bytes) -> tuple[Floats, Floats]:
    """Kept, since curves of one size follow one after the other at the same times; few, as they can be large."""
    still, moving = method.mode_warps(point_count, closed, np.frombuffer(moments))
    still.setflags(write=False)
    moving.setflags(write=False)
    return still, moving
