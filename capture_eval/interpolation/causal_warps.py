"""The dynamic PDE started at rest: how far a harmonic has gone when nothing is left out of its solution.

Paper 003 keeps the polynomial particular solution only. With the homogeneous part, fixed by a start at rest and in
equilibrium, the response to the force t^R is ``p(t) = ∫₀ᵗ G(t − s) s^R ds`` with the impulse response G of
``m g'' + c g' + B g``, and ``φ = p(t)/p(1)``. For every m > 0, c ≥ 0, B ≥ 0 and real R ≥ 1 it rises from 0 to 1 and
is never singular. It is evaluated as

    p(t) = R t^R ∫₀¹ S(t x) (1 − x)^(R−1) dx,    S the step response,

by Gauss-Jacobi quadrature, which is exact for the end-point power of any real R, while the modes of S do not vary
faster than the nodes, and by the asymptotic series of the incomplete gamma function beyond that.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import gamma, roots_jacobi

from capture_eval.errors import InputError

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]

_TERMS = 30  # of the asymptotic series: the last is below 1e-20 where it is used
_NOTHING = 1e-15  # share of the other parameters below which one changes nothing in double precision
_NEGLIGIBLE = -45.0  # exponent below which e^z is nothing


def causal_warps(order: float, mass: float, damping: float, stiffness: ArrayLike, times: ArrayLike) -> Floats:
    """φ_n(t) of the PDE started at rest.

    Parameters
    ----------
    order : float
        R, real, from 1 to 20.
    mass, damping : float
        m and c, not negative.
    stiffness : (N,)
        B_n, not negative; m, c and B_n may not all be 0.
    times : (T,)
        In [0, 1].

    Returns
    -------
    (T, N) float64
        Rising from 0 at t = 0 to 1 at t = 1. t^R for B → ∞; t^(R+1) for B = m = 0; t^(R+2) for B = c = 0.

    Raises
    ------
    InputError
        R outside its range, or m = c = B = 0.
    """
    if isinstance(order, bool) or not (np.isfinite(order) and 1.0 <= order <= 20.0):
        raise InputError(f"order R = {order} of the causal warp must be a real number from 1 to 20")
    moments = tuple(np.asarray(times, dtype=np.float64).tolist())
    columns = [_warp(float(order), mass, damping, b, moments) for b in np.atleast_1d(stiffness).tolist()]
    return np.stack(columns, axis=1) if columns else np.zeros((len(moments), 0))


@lru_cache(maxsize=4096)  # curves share their harmonics, and every evaluation its times
def _warp(order: float, mass: float, damping: float, stiffness: float, times: tuple[float, ...]) -> Floats:
    moments = np.array([*times, 1.0])
    if stiffness > _NOTHING * max(mass, damping):
        share = _stiff_response(order, mass / stiffness, damping / stiffness, moments)
    elif damping > _NOTHING * mass:
        share = _free_response(order, mass / damping, moments)
    elif mass > 0:
        share = moments**2
    else:
        raise InputError("causal warp: mass, damping and stiffness are all 0; one must be positive")
    response = moments**order * share
    warp: Floats = response[:-1] / response[-1]
    warp.setflags(write=False)
    return warp


@lru_cache(maxsize=16)
def _quadrature(order: float) -> tuple[Floats, Floats]:
    """Nodes and weights on [0, 1] for the weight R (1 − x)^(R−1), whose integral is 1."""
    nodes, weights = roots_jacobi(int(2.4 * _far(order)) + 60, order - 1.0, 0.0)
    return 0.5 * (nodes + 1.0), weights / weights.sum()


def _far(order: float) -> float:
    """|z| from which the asymptotic series holds; quadrature holds to four times that."""
    return max(50.0, 6.0 * order)


def _stiff_response(order: float, mass_ratio: float, damping_ratio: float, times: Floats) -> Floats:
    """p(t)/t^R up to a factor, for B > 0: m/B and c/B are given."""
    if mass_ratio == 0:
        if damping_ratio == 0:
            return np.ones_like(times)
        return np.real(-_mean_exponential_less_one(order, (-times / damping_ratio).astype(np.complex128)))
    root = np.sqrt(complex(damping_ratio**2 - 4.0 * mass_ratio))
    slow_times_fast = -0.5 * (damping_ratio + root)
    fast, slow = slow_times_fast / mass_ratio, 1.0 / slow_times_fast
    result = np.zeros_like(times)
    for i, t in enumerate(times.tolist()):
        if t > 0:
            result[i] = _response_at(order, complex(slow), complex(fast), t)
    return result


def _response_at(order: float, slow: complex, fast: complex, t: float) -> float:
    """Mean of S(t x) under the weight R (1 − x)^(R−1), for two modes e^(slow t), e^(fast t), |slow| ≤ |fast|."""
    far = _far(order)
    if abs(fast) * t <= 4.0 * far:
        nodes, weights = _quadrature(order)
        along = (t * nodes).astype(np.complex128)
        return float(np.dot(weights, _step_response(slow * along, fast * along)))
    if abs(slow) * t >= far:
        return float(1.0 - _mean_decay(order, slow * t, fast * t).real)
    means = _mean_exponential_less_one(order, np.array([slow * t, fast * t]))
    return float(((slow * means[1] - fast * means[0]) / (fast - slow)).real)


def _step_response(slow: Complexes, fast: Complexes) -> Floats:
    """S = 1 − (z2 e^z1 − z1 e^z2)/(z2 − z1) at arguments z1, z2 along one ray, without cancellation."""
    largest = np.abs(fast[np.argmax(np.abs(fast))])
    if largest < 1.0:
        return _step_series(slow, fast)
    if abs(fast[-1] - slow[-1]) < 0.1 * abs(slow[-1]):
        middle, half = 0.5 * (slow + fast), 0.5 * (fast - slow)
        small = np.abs(half) < 1e-3
        safe = np.where(small, 1.0, half)
        sinhc = np.where(small, 1.0 + half**2 / 6.0, np.sinh(safe) / safe)
        return np.real(1.0 - np.exp(middle) * (np.cosh(half) - middle * sinhc))
    return np.real((slow * np.expm1(fast) - fast * np.expm1(slow)) / (fast - slow))


def _step_series(slow: Complexes, fast: Complexes) -> Floats:
    """The same for small arguments: z1 z2 Σ h_k(z1, z2)/(k + 2)!, h_k the complete symmetric polynomials."""
    symmetric, power = np.ones_like(slow), np.ones_like(fast)
    total, factorial = symmetric / 2.0, 2.0
    for k in range(1, 22):
        power = power * fast
        symmetric = slow * symmetric + power
        factorial *= k + 2
        total = total + symmetric / factorial
    return np.real(slow * fast * total)


def _mean_decay(order: float, slow: complex, fast: complex) -> complex:
    """Mean of 1 − S for two fast modes, by the asymptotic series in 1/z1 and 1/z2 (symmetric, so they may be equal)."""
    first, second = 1.0 / slow, 1.0 / fast
    symmetric, power, falling, total = first + second, second, 1.0, 0.0 + 0.0j
    for k in range(_TERMS):
        total -= falling * symmetric
        power *= second
        symmetric = first * symmetric + power
        falling *= order - 1.0 - k
    if slow.real > _NEGLIGIBLE:
        tails = [gamma(order) * np.exp(z) * z**-order for z in (slow, fast)]
        total += (fast * tails[0] - slow * tails[1]) / (fast - slow)
    return complex(order * total)


def _mean_exponential_less_one(order: float, arguments: Complexes) -> Complexes:
    """Mean of e^(z x) − 1 under the weight R (1 − x)^(R−1), for Re z ≤ 0."""
    nodes, weights = _quadrature(order)
    near = np.abs(arguments) <= 4.0 * _far(order)
    result = np.zeros(len(arguments), dtype=np.complex128)
    result[near] = np.expm1(arguments[near, None] * nodes) @ weights
    z = arguments[~near]
    total, power, falling = np.zeros_like(z), np.ones_like(z), 1.0
    for k in range(_TERMS):
        power = power / z
        total -= falling * power
        falling *= order - 1.0 - k
    total += np.where(z.real > _NEGLIGIBLE, gamma(order) * np.exp(z) * z**-order, 0.0)
    result[~near] = order * total - 1.0
    return result


def _free_response(order: float, lag: float, times: Floats) -> Floats:
    """p(t)/t^R up to a factor, for B = 0 and c > 0: the step response is r − τ (1 − e^(−r/τ)) with τ = m/c."""
    if lag < _NOTHING:
        return times.copy()
    nodes, weights = _quadrature(order)
    result = np.zeros_like(times)
    for i, t in enumerate(times.tolist()):
        if t == 0:
            continue
        if t / lag <= 4.0 * _far(order):
            y = nodes * t / lag
            result[i] = lag * float(weights @ np.where(y < 0.05, _lag_series(y), y + np.expm1(-y)))
        else:
            mean = _mean_exponential_less_one(order, np.array([-t / lag], dtype=np.complex128))[0].real
            result[i] = t / (order + 1.0) + lag * mean
    return result


def _lag_series(y: Floats) -> Floats:
    """y − 1 + e^(−y) for small y."""
    return y**2 / 2 * (1 - y / 3 * (1 - y / 4 * (1 - y / 5 * (1 - y / 6 * (1 - y / 7)))))
