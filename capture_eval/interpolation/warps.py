"""How far each harmonic of a curve has gone at time t under the dynamic PDE.

The particular solution of paper 003 for force ``ê + ě t^R`` moves harmonic n from its start to its end value by a
factor φ_n(t) that does not depend on the shape. With α = c/B_n, μ = m/B_n and ``Σ γ_j z^j = 1/(1 + α z + μ z²)``,

    φ_n(t) = Σ_j T_j t^(R−j) / Σ_j T_j,   T_j = γ_j R!/(R−j)!,   j = 0 … R−1.

(Eqs (11)-(14), (18)-(22), (26)-(27) of the paper for R = 1, 2, 3.) The zero mode has three unknowns for two boundary
conditions; what settles the third is called its closure.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from capture_eval.errors import InputError, SolverError

Floats = NDArray[np.float64]

CLOSURES = ("stiff", "linear", "ebar0", "rest", "minforce", "fit")
NEAR_SINGULAR = 1e-9  # share of the largest term below which their sum is cancellation, not a number


def check_order(order: int) -> int:
    """The order R of the force as a whole number ≥ 1.

    Raises
    ------
    InputError
        R is not a whole number or is below 1.
    """
    if isinstance(order, bool) or order != int(order) or order < 1:
        raise InputError(f"order R = {order} must be a whole number, 1 or more")
    return int(order)


def harmonic_warps(
    order: int, damping_ratio: ArrayLike, mass_ratio: ArrayLike, times: ArrayLike, first_harmonic: int = 1
) -> Floats:
    """φ_n(t) of harmonics with stiffness.

    Parameters
    ----------
    order : int
        R, the power of time in the force.
    damping_ratio, mass_ratio : (N,)
        α_n = c/B_n and μ_n = m/B_n, not negative.
    times : (T,)
        Moments.
    first_harmonic : int
        Number of the first one, for messages.

    Returns
    -------
    (T, N) float64
        0 at t = 0 and 1 at t = 1.

    Raises
    ------
    SolverError
        The boundary conditions do not fix a harmonic (|ΣT_j| below 1e-9 of the largest term); the text gives its
        number and ratios.
    """
    order = check_order(order)
    alpha = np.atleast_1d(np.asarray(damping_ratio, dtype=np.float64))
    mu = np.atleast_1d(np.asarray(mass_ratio, dtype=np.float64))
    moments = np.asarray(times, dtype=np.float64)[:, None]
    terms = _warp_terms(order, alpha, mu)
    total = terms.sum(axis=0)
    bad = np.abs(total) < NEAR_SINGULAR * np.abs(terms).max(axis=0)
    if bad.any():
        n = int(np.argmax(bad))
        raise SolverError(
            f"order {order} is singular at harmonic {n + first_harmonic}: c/B = {alpha[n]:.6g}, m/B = {mu[n]:.6g} "
            "make the end condition unsolvable; change damping or rigidity"
        )
    value: Floats = np.zeros((len(moments), len(alpha)))
    for term in terms:  # Horner, highest power first
        value = value * moments + term
    result: Floats = value * moments / total
    return result


def _warp_terms(order: int, alpha: Floats, mu: Floats) -> Floats:
    """T_j up to a common factor, (R, N), by the scaled recurrence γ_j = −α γ_(j−1) − μ γ_(j−2)."""
    scale = np.maximum(1.0, np.maximum(alpha, np.sqrt(mu)))
    first, second = alpha / scale, mu / scale**2
    gamma = [np.ones_like(alpha), -first]
    for _ in range(2, order):
        gamma.append(-first * gamma[-1] - second * gamma[-2])
    rows = [
        gamma[j] * (math.factorial(order) / math.factorial(order - j)) * scale ** float(j - order + 1)
        for j in range(order)
    ]
    return np.array(rows)


def zero_mode_warp(
    closure: str, order: int, mass: float, damping: float, times: ArrayLike, bend: float = 0.0
) -> Floats:
    """ψ(t), the warp of the mode without stiffness (mean of a closed curve, end points of an open one).

    Parameters
    ----------
    closure : str
        ``stiff``: t^R, what a foundation that stiffens without bound gives; no point at rest moves.
        ``linear``: no time-dependent force (e̿ = 0), t.
        ``ebar0``: no constant force (ē = 0).
        ``rest``: starts at rest (ψ'(0) = 0).
        ``minforce``: the least ∫ f² dt.
        ``fit``: ``t + η h(t)``, the whole family, of which the others (without ``stiff``) are members.
    order : int
        R.
    mass, damping : float
        m and c; only τ = m/c matters. The last four closures divide by c.
    times : (T,)
        Moments.
    bend : float
        η of ``fit``, for ``h = q̃(t) − q̃(1) t``, ``q̃ = Σ_r (−τ)^(R+1−r) (R!/r!) t^r``.

    Returns
    -------
    (T,) float64
        0 at t = 0 and 1 at t = 1.

    Raises
    ------
    InputError
        Unknown closure.
    SolverError
        c = 0 for a closure that divides by it, or a ratio m/c at which the closure is singular.
    """
    order = check_order(order)
    moments = np.asarray(times, dtype=np.float64)
    if closure not in CLOSURES:
        raise InputError(f"unknown zero-mode closure '{closure}'; known are {', '.join(CLOSURES)}")
    if closure == "stiff":
        return moments**order
    if closure == "linear":
        return moments.copy()
    if damping == 0:
        raise SolverError(f"closure '{closure}' divides by the damping, which is 0; use 'stiff' or 'linear'")
    ratio = mass / damping
    scale = max(1.0, ratio)
    # q̃(t) = Σ_r (−τ)^(R+1−r) (R!/r!) t^r, here divided by scale^R; entry r − 1 belongs to t^r
    terms = np.array(
        [
            (-ratio / scale) ** (order + 1 - r) * scale ** (1.0 - r) * math.factorial(order) / math.factorial(r)
            for r in range(1, order + 2)
        ]
    )
    if closure == "fit":
        return moments + bend * scale**order * (_polynomial(terms, moments) - float(terms.sum()) * moments)
    if closure == "minforce":
        return _least_force(order, terms, scale, moments)
    if closure == "rest":
        terms[0] = 0.0  # ψ'(0) is the coefficient of t
    return _ratio_of_polynomial(terms, moments, closure, order, ratio)


def _ratio_of_polynomial(terms: Floats, moments: Floats, closure: str, order: int, ratio: float) -> Floats:
    total = terms.sum()
    if abs(total) < NEAR_SINGULAR * np.abs(terms).max():
        raise SolverError(
            f"closure '{closure}' with order {order} is singular at m/c = {ratio:.9g}; change mass or damping"
        )
    return _polynomial(terms, moments) / float(total)


def _polynomial(terms: Floats, moments: Floats) -> Floats:
    value = np.zeros_like(moments)
    for term in terms[::-1]:
        value = (value + term) * moments
    return value


def _least_force(order: int, terms: Floats, scale: float, moments: Floats) -> Floats:
    """ψ = t + η h with η = δ/(δ² + R²/((2R+1)(R+1)²)), h = q̃ − Q t, δ = Q − 1/(R+1); all divided by scale^R."""
    end = float(terms.sum())
    shrink = scale ** float(-order)
    difference = end - shrink / (order + 1)
    floor = order**2 / ((2 * order + 1) * (order + 1) ** 2) * shrink**2
    bend = _polynomial(terms, moments) - end * moments
    result: Floats = moments + difference * bend / (difference**2 + floor)
    return result
