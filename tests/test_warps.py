"""The time warps of the dynamic PDE against closed formulas, limits and symmetries (no tolerance is fitted)."""

import math
import re

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from capture_eval.errors import InputError, SolverError
from capture_eval.interpolation.warps import CLOSURES, harmonic_warps, zero_mode_warp

T = np.linspace(0.0, 1.0, 21)
ratios = st.floats(1e-6, 1e6)


def warp(order: int, alpha: float, mu: float = 0.0) -> np.ndarray:
    return harmonic_warps(order, [alpha], [mu], T)[:, 0]


@settings(deadline=None)
@given(order=st.integers(1, 12), alpha=ratios, mu=ratios)
def test_warps_start_at_zero_and_end_at_one(order: int, alpha: float, mu: float) -> None:
    try:
        value = warp(order, alpha, mu)
    except SolverError:
        assume(False)
    assert value[0] == 0.0
    assert abs(value[-1] - 1.0) <= 1e-6  # the singular guard allows nine digits of cancellation


@settings(deadline=None)
@given(alpha=ratios, mu=ratios)
def test_low_orders_match_the_closed_formulas(alpha: float, mu: float) -> None:
    """R = 1: t; R = 2: t(t − 2α)/(1 − 2α), without m; R = 3: a cubic. Written in a form that does not overflow."""
    np.testing.assert_array_equal(warp(1, alpha, mu), T)
    assume(abs(1 - 2 * alpha) > 1e-3 * max(1, alpha))
    np.testing.assert_allclose(warp(2, alpha, mu), T * (T - 2 * alpha) / (1 - 2 * alpha), rtol=1e-9, atol=1e-12)
    end = 1 - 3 * alpha + 6 * alpha**2 - 6 * mu
    assume(abs(end) > 1e-3 * max(1, 6 * alpha**2, 6 * mu))
    expected = (T**3 - 3 * alpha * T**2 + 6 * (alpha**2 - mu) * T) / end
    np.testing.assert_allclose(warp(3, alpha, mu), expected, rtol=1e-8, atol=1e-10)


@settings(deadline=None)
@given(alpha=ratios, mu=ratios, other=ratios)
def test_mass_does_not_matter_for_order_two(alpha: float, mu: float, other: float) -> None:
    assume(abs(1 - 2 * alpha) > 1e-3 * max(1, alpha))
    np.testing.assert_allclose(warp(2, alpha, mu), warp(2, alpha, other), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(
    ("order", "alpha", "mu", "expected"),
    [  # at t = 1/4, 1/2, 3/4
        (2, 1e-4, 0, (0.063, 0.250, 0.563)),
        (2, 0.1, 0, (0.016, 0.188, 0.516)),
        (2, 0.4, 0, (-0.69, -0.75, -0.19)),
        (2, 0.6, 0, (1.19, 1.75, 1.69)),
        (2, 5, 0, (0.27, 0.53, 0.77)),
        (3, 0.1, 0, (0.016, 0.105, 0.392)),
        (3, 0.1, 0.1, (-0.86, -1.38, -0.95)),
        (3, 0.5, 0.25, (0.156, 0.5, 0.844)),
    ],
)
def test_known_shapes(order: int, alpha: float, mu: float, expected: tuple[float, ...]) -> None:
    value = harmonic_warps(order, [alpha], [mu], [0.25, 0.5, 0.75])[:, 0]
    np.testing.assert_allclose(value, expected, atol=0.0051)  # the table has two to three digits


@settings(deadline=None)
@given(order=st.integers(2, 6), alpha=st.floats(1e-9, 1e-5), share=st.floats(0, 1))
def test_stiff_limit_is_the_power_of_time(order: int, alpha: float, share: float) -> None:
    assert np.abs(warp(order, alpha, share * alpha) - T**order).max() <= 4 * order**2 * alpha


@settings(deadline=None)
@given(order=st.integers(1, 6), alpha=st.floats(1e6, 1e10))
def test_soft_damped_limit_is_even_time(order: int, alpha: float) -> None:
    assert np.abs(warp(order, alpha, 0.0) - T).max() <= 10 * order**2 / alpha


@pytest.mark.parametrize(("order", "limit"), [(1, T), (2, T**2), (3, T), (4, T**2)])
def test_soft_undamped_limit(order: int, limit: np.ndarray) -> None:
    np.testing.assert_allclose(warp(order, 0.0, 1e9), limit, atol=1e-7)


def test_order_two_is_singular_at_one_half() -> None:
    with pytest.raises(SolverError, match=re.escape("order 2 is singular at harmonic 1: c/B = 0.5, m/B = 3")):
        warp(2, 0.5, 3.0)
    singular_mass = 1 / 6 * (1 - 0.3 + 0.06)  # zero of 1 − 3α + 6α² − 6μ at α = 0.1
    with pytest.raises(SolverError, match="order 3 is singular"):
        warp(3, 0.1, singular_mass)


@settings(deadline=None)
@given(order=st.integers(1, 6), tau=st.floats(1e-3, 1e3), closure=st.sampled_from(CLOSURES))
def test_zero_mode_warps_meet_both_ends(order: int, tau: float, closure: str) -> None:
    try:
        value = zero_mode_warp(closure, order, tau, 1.0, T)
    except SolverError:
        assume(False)
    assert value[0] == 0.0
    assert abs(value[-1] - 1.0) <= 1e-6


@pytest.mark.parametrize("tau", [1e-3, 0.07, 0.9, 20.0])
def test_zero_mode_closures_match_their_formulas(tau: float) -> None:
    def same(closure: str, order: int, expected: np.ndarray) -> None:
        np.testing.assert_allclose(zero_mode_warp(closure, order, tau, 1.0, T), expected, rtol=1e-9, atol=1e-11)

    same("ebar0", 1, T * (T - 2 * tau) / (1 - 2 * tau))
    same("ebar0", 2, T * (T**2 - 3 * tau * T + 6 * tau**2) / (1 - 3 * tau + 6 * tau**2))
    end = 1 - 4 * tau + 12 * tau**2 - 24 * tau**3
    same("ebar0", 3, T * (T**3 - 4 * tau * T**2 + 12 * tau**2 * T - 24 * tau**3) / end)
    same("rest", 1, T**2)
    same("rest", 2, T**2 * (T - 3 * tau) / (1 - 3 * tau))
    same("rest", 3, T**2 * (T**2 - 4 * tau * T + 12 * tau**2) / (1 - 4 * tau + 12 * tau**2))
    same("minforce", 1, T - 6 * tau * (T**2 - T) / (1 + 12 * tau**2))
    for order in (1, 2, 3):
        same("linear", order, T)
        same("stiff", order, T**order)


@pytest.mark.parametrize("order", [1, 2, 3, 5])
def test_least_force_closure_has_the_least_force(order: int) -> None:
    """Among ψ = t + η h the force m ψ'' + c ψ' has the smallest ∫ f² at the closure's η."""
    mass, damping = 0.3, 1.0
    basis = np.polynomial.polynomial.Polynomial.basis
    tau = mass / damping
    q = sum(
        (-tau) ** (order + 1 - r) * math.factorial(order) / math.factorial(r) * basis(r) for r in range(1, order + 2)
    )
    bend = q - q(1.0) * basis(1)

    def cost(eta: float) -> float:
        psi = basis(1) + eta * bend
        force = mass * psi.deriv(2) + damping * psi.deriv(1)
        return float((force**2).integ()(1.0))

    value = zero_mode_warp("minforce", order, mass, damping, T)
    inner = 1 + int(np.argmax(np.abs(bend(T[1:-1]))))
    eta = (value[inner] - T[inner]) / bend(T[inner])
    np.testing.assert_allclose(value, T + eta * bend(T), atol=1e-12)
    assert cost(eta) <= min(cost(eta * 1.001), cost(eta * 0.999), cost(0.0))


@pytest.mark.parametrize(
    ("closure", "order", "tau"), [("ebar0", 1, 0.5), ("ebar0", 3, 0.359031), ("rest", 2, 1 / 3), ("rest", 4, 0.259622)]
)
def test_singular_ratios_of_closures(closure: str, order: int, tau: float) -> None:
    """The roots are known to six digits: near them the warp is huge, at the exact ones it is refused."""
    if closure in ("ebar0", "rest") and order in (1, 2):
        with pytest.raises(SolverError, match=r"singular at m/c"):
            zero_mode_warp(closure, order, tau, 1.0, T)
    else:
        assert np.abs(zero_mode_warp(closure, order, tau, 1.0, T)).max() > 1e4


def test_closures_that_divide_by_the_damping_refuse_zero() -> None:
    for closure in ("ebar0", "rest", "minforce"):
        with pytest.raises(SolverError, match="divides by the damping"):
            zero_mode_warp(closure, 2, 1.0, 0.0, T)
    np.testing.assert_array_equal(zero_mode_warp("stiff", 2, 1.0, 0.0, T), T**2)


@pytest.mark.parametrize("order", [0, -1, 1.5, True])
def test_orders_below_one_or_broken_are_refused(order: float) -> None:
    with pytest.raises(InputError, match="must be a whole number, 1 or more"):
        harmonic_warps(order, [0.1], [0.1], T)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="unknown zero-mode closure 'free'"):
        zero_mode_warp("free", 2, 1.0, 1.0, T)
