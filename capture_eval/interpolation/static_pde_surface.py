"""Surface patches between two curves that solve ``β w_uu + λ w_vv = 0`` (paper 000, Eqs 1-21).

v runs along the curves and u from the first to the second. Each harmonic of the curves goes across the patch by a
factor that does not depend on the shape,

    w_n(u) = C1_n P(1 − u) + C2_n P(u),   P(u) = sinh ξu / sinh ξ   for λ/β > 0 (elliptic, the default),
                                          P(u) = sin ξu / sin ξ     for λ/β < 0 (hyperbolic, the paper's),
                                          P(u) = u                  for λ = 0 and for the mean (ruled surface),

with ξ_n = 2πn √|λ/β| for closed curves and πn √|λ/β| for open ones, which are a ramp between their ends plus a sine
series: a periodic series of an open curve does not converge. The elliptic patch never leaves the range of its
boundary; the hyperbolic one has no solution where sin ξ_n = 0.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import fft

from capture_eval.errors import InputError, SolverError
from capture_eval.interpolation.curve_modes import mode_count, wave_numbers

Floats = NDArray[np.float64]

NEAR_SINGULAR = 1e-6  # |sin ξ| below which a hyperbolic patch amplifies its boundary a million times


@dataclass(frozen=True)
class CurveSeries:
    """A curve as coefficients (paper 000, Eqs 13-14).

    Parameters
    ----------
    coefficients : (2N + 1, 3) float64 of a closed curve, (N + 2, 3) of an open one
        Closed: mean, then cosine and sine of 2πnv for n = 1 … N. Open: first point, last point, then sine of πnv.
    closed : bool
        Which of the two.

    Raises
    ------
    InputError
        Another shape, or numbers that are not finite.
    """

    coefficients: Floats
    closed: bool

    def __post_init__(self) -> None:
        values = np.ascontiguousarray(self.coefficients, dtype=np.float64)
        fits = values.ndim == 2 and values.shape[1] == 3 and (len(values) % 2 == 1 if self.closed else len(values) >= 2)
        if not fits:
            kind = "a closed" if self.closed else "an open"
            raise InputError(f"series of {kind} curve: coefficients have shape {values.shape}")
        if not np.isfinite(values).all():
            raise InputError("series of a curve: coefficients are not finite")
        object.__setattr__(self, "coefficients", values)

    @property
    def harmonics(self) -> int:
        """N."""
        return (len(self.coefficients) - 1) // 2 if self.closed else len(self.coefficients) - 2

    def points(self, v: ArrayLike) -> Floats:
        """Positions (V, 3) at the parameters v (V,) in [0, 1]."""
        return series_basis(self.harmonics, self.closed, np.asarray(v, dtype=np.float64)) @ self.coefficients


def curve_parameters(point_count: int, closed: bool) -> Floats:
    """v of the points of a curve, (M,): equal steps from 0, to 1 when the curve is open."""
    return np.arange(point_count) / (point_count if closed else point_count - 1)


def curve_series(points: ArrayLike, closed: bool, harmonics: int | None = None) -> CurveSeries:
    """The first N harmonics of a curve whose points lie at equal steps of v.

    Parameters
    ----------
    points : (M, 3)
        The curve.
    closed : bool
        Whether the last point joins the first.
    harmonics : int, optional
        N; all that the curve holds by default: with them the series goes through every point.

    Raises
    ------
    InputError
        Too few points, numbers that are not finite, or more harmonics than the points hold.
    """
    places = np.asarray(points, dtype=np.float64)
    least, kind = (3, "a closed") if closed else (2, "an open")
    if places.ndim != 2 or places.shape[1] != 3 or len(places) < least:
        raise InputError(f"{kind} curve needs points (M, 3) with M of at least {least}, got {places.shape}")
    if not np.isfinite(places).all():
        raise InputError(f"{kind} curve of {len(places)} points holds positions that are not finite")
    most = mode_count(len(places), closed)
    count = most if harmonics is None else harmonics
    if not 0 <= count <= most:
        raise InputError(f"{count} harmonics on {kind} curve of {len(places)} points, which holds {most}")
    if closed:
        return CurveSeries(_closed_coefficients(places, count), True)
    ramp = np.linspace(places[0], places[-1], len(places))
    ramp[-1] = places[-1]
    sines = fft.dst((places - ramp)[1:-1], type=1, axis=0)[:count] / (len(places) - 1) if count else np.zeros((0, 3))
    return CurveSeries(np.concatenate([places[[0, -1]], sines]), False)


def _closed_coefficients(places: Floats, count: int) -> Floats:
    modes = fft.rfft(places, axis=0)[: count + 1] / len(places)
    if 2 * count < len(places):
        modes[1:] *= 2.0
    else:
        modes[1:-1] *= 2.0  # at the highest frequency of an even number of points both halves are one
    coefficients = np.empty((2 * count + 1, 3))
    coefficients[0] = modes[0].real
    coefficients[1::2], coefficients[2::2] = modes[1:].real, -modes[1:].imag
    return coefficients


def series_basis(harmonics: int, closed: bool, v: Floats) -> Floats:
    """What multiplies the coefficients of a `CurveSeries` at the parameters v: (V, number of coefficients)."""
    angle = v[:, None] * wave_numbers(harmonics, closed)
    if closed:
        basis = np.empty((len(v), 2 * harmonics + 1))
        basis[:, 0] = 1.0
        basis[:, 1::2], basis[:, 2::2] = np.cos(angle), np.sin(angle)
        return basis
    return np.column_stack([1.0 - v, v, np.sin(angle)])


def crossing_factors(ratio: float, harmonics: int, closed: bool, u: ArrayLike) -> Floats:
    """P_n(u): the share of the second boundary curve in each coefficient of the row at u.

    Parameters
    ----------
    ratio : float
        λ/β: positive elliptic, negative hyperbolic, 0 ruled.
    harmonics : int
        N.
    closed : bool
        Kind of the curves.
    u : (U,)
        In [0, 1].

    Returns
    -------
    (U, number of coefficients) float64
        Exactly 0 at u = 0 and 1 at u = 1. The share of the first curve is P_n(1 − u).

    Raises
    ------
    InputError
        The ratio is not finite or u leaves [0, 1].
    SolverError
        A hyperbolic patch without a solution; the text gives the harmonic and the ratios that are safe.
    """
    places = np.asarray(u, dtype=np.float64)
    if not np.isfinite(ratio):
        raise InputError(f"static PDE: λ/β = {ratio} must be finite")
    if places.ndim != 1 or not np.isfinite(places).all() or np.any((places < 0) | (places > 1)):
        raise InputError(
            f"static PDE: u must be a list of numbers in [0, 1], got {np.array2string(places, threshold=6)}"
        )
    waves = wave_numbers(harmonics, closed) * np.sqrt(abs(ratio))
    shares = _elliptic(waves, places) if ratio >= 0 else _hyperbolic(waves, places, ratio, harmonics, closed)
    shares[places == 0.0], shares[places == 1.0] = 0.0, 1.0
    still = places[:, None]
    return np.hstack([still, np.repeat(shares, 2, axis=1)]) if closed else np.hstack([still, still, shares])


def _elliptic(waves: Floats, u: Floats) -> Floats:
    """sinh ξu / sinh ξ as e^(−ξ(1−u)) (1 − e^(−2ξu)) / (1 − e^(−2ξ)), which neither overflows nor cancels."""
    shares = np.repeat(u[:, None], len(waves), axis=1)
    bent = waves > 1e-8  # below, the quotient is u to double precision
    xi, place = waves[bent], u[:, None]
    shares[:, bent] = np.exp(-xi * (1.0 - place)) * np.expm1(-2.0 * xi * place) / np.expm1(-2.0 * xi)
    return shares


def _hyperbolic(waves: Floats, u: Floats, ratio: float, harmonics: int, closed: bool) -> Floats:
    bottom = np.sin(waves)
    bad = np.abs(bottom) < NEAR_SINGULAR * np.minimum(waves, 1.0)  # as ξ → 0 the quotient is u
    if bad.any():
        n = int(np.argmax(bad)) + 1
        safe = (0.5 if closed else 1.0) / harmonics
        raise SolverError(
            f"static PDE: λ/β = {ratio:g} has no solution at harmonic {n} (sin ξ = {bottom[n - 1]:.1e}); with "
            f"{harmonics} harmonics every ratio above {-(safe**2):.3g} is safe, and every positive one"
        )
    shares: Floats = np.sin(waves * u[:, None]) / bottom
    return shares


def patch_points(first: CurveSeries, second: CurveSeries, ratio: float, u: ArrayLike, v: ArrayLike) -> Floats:
    """Points of the patch between two curves (paper 000, Eq 19 and its elliptic counterpart).

    Parameters
    ----------
    first, second : CurveSeries
        Boundary curves at u = 0 and u = 1, of one kind and with equally many harmonics.
    ratio : float
        λ/β.
    u : (U,)
        In [0, 1].
    v : (V,)
        Along the curves.

    Returns
    -------
    (U, V, 3) float64
        The rows at u = 0 and u = 1 are `CurveSeries.points` of the boundary curves to the last bit.

    Raises
    ------
    InputError
        Curves that do not fit, see also `crossing_factors`.
    SolverError
        See `crossing_factors`.
    """
    if first.closed != second.closed or first.harmonics != second.harmonics:
        kinds = [f"{'closed' if one.closed else 'open'} with {one.harmonics} harmonics" for one in (first, second)]
        raise InputError(f"a patch needs two boundary curves of one kind, got {kinds[0]} and {kinds[1]}")
    rows = np.asarray(u, dtype=np.float64)
    far = crossing_factors(ratio, first.harmonics, first.closed, rows)
    near = crossing_factors(ratio, first.harmonics, first.closed, 1.0 - rows)
    coefficients = near[:, :, None] * first.coefficients + far[:, :, None] * second.coefficients
    basis = series_basis(first.harmonics, first.closed, np.asarray(v, dtype=np.float64))
    result: Floats = np.stack([basis @ row for row in coefficients]) if len(rows) else np.zeros((0, len(basis), 3))
    return result
