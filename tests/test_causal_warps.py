"""The warp of the PDE started at rest against matrix exponentials, closed forms, limits and monotony."""

import math
import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

from capture_eval.errors import InputError
from capture_eval.interpolation.causal_warps import causal_warps

T = np.linspace(0, 1, 11)


def warp(order: float, mass: float, damping: float, stiffness: float, times: np.ndarray = T) -> np.ndarray:
    return causal_warps(order, mass, damping, [stiffness], times)[:, 0]


def by_matrix_exponential(order: int, mass: float, damping: float, stiffness: float) -> np.ndarray:
    """(g, g', t^R, …, t, 1) as one linear system; good for modes up to about |s| = 30."""
    system = np.zeros((order + 3, order + 3))
    system[0, 1] = 1.0
    system[1, :3] = [-stiffness / mass, -damping / mass, 1.0]
    for k in range(order):
        system[2 + k, 3 + k] = order - k
    start = np.zeros(order + 3)
    start[-1] = 1.0
    response = np.array([(expm(t * system) @ start)[0] for t in T])
    return response / response[-1]


@settings(max_examples=60, deadline=None)
@given(order=st.integers(1, 6), mass=st.floats(0.03, 30), damping=st.floats(0, 30), stiffness=st.floats(0, 20))
def test_agrees_with_matrix_exponentials(order: int, mass: float, damping: float, stiffness: float) -> None:
    expected = by_matrix_exponential(order, mass, damping, stiffness)
    np.testing.assert_allclose(warp(order, mass, damping, stiffness), expected, atol=1e-11)


def polynomial_and_modes(order: int, mass: float, damping: float, stiffness: float) -> np.ndarray:
    """Particular polynomial plus the two modes that put it at rest at t = 0; no cancellation when modes are fast."""
    system = np.zeros((order + 1, order + 1))
    for r in range(order + 1):
        system[r, r] += stiffness
        if r >= 1:
            system[r - 1, r] += damping * r
        if r >= 2:
            system[r - 2, r] += mass * r * (r - 1)
    particular = np.polynomial.Polynomial(np.linalg.solve(system, np.eye(order + 1)[order]))
    modes = np.roots([mass, damping, stiffness]).astype(complex)
    amounts = np.linalg.solve([[1, 1], modes], [-particular(0.0), -particular.deriv()(0.0)])
    response = particular(T) + (np.exp(T[:, None] * modes) @ amounts).real
    return response / response[-1]


@pytest.mark.parametrize("order", [1, 2, 3, 5])
@pytest.mark.parametrize(
    ("mass", "damping", "stiffness"),
    [
        (1e-3, 1e-3, 100.0),  # hardly damped, |s| = 316
        (1e-4, 0.0, 900.0),  # undamped, |s| = 3000
        (1e-3, 1.0, 50.0),  # one mode at 53, one at 947
        (1e-4, 1.0, 1.0),  # a slow mode and one at 10^4
        (1e-3, 2.0, 999.0),  # nearly equal modes, |s| = 1000
        (1.0, 300.0, 1.6e4),
        (1.0, 1.0, 1.6e9),
    ],
)
def test_agrees_with_polynomial_and_modes(order: int, mass: float, damping: float, stiffness: float) -> None:
    expected = polynomial_and_modes(order, mass, damping, stiffness)
    np.testing.assert_allclose(warp(order, mass, damping, stiffness), expected, atol=2e-11)


def test_equal_modes_are_the_limit_of_nearly_equal_ones() -> None:
    for rate in (0.3, 3.0, 30.0, 300.0):
        equal = warp(2.5, 1.0, 2 * rate, rate**2)
        nearly = warp(2.5, 1.0, 2 * rate * (1 + 1e-9), rate**2)
        np.testing.assert_allclose(equal, nearly, atol=1e-7)


@settings(max_examples=150, deadline=None)
@given(
    order=st.floats(1, 8),
    mass=st.floats(1e-6, 1e6),
    damping=st.one_of(st.just(0.0), st.floats(1e-6, 1e6)),
    stiffness=st.one_of(st.just(0.0), st.floats(1e-6, 1e10)),
)
def test_it_never_runs_backwards(order: float, mass: float, damping: float, stiffness: float) -> None:
    times = np.linspace(0, 1, 41)
    value = warp(order, mass, damping, stiffness, times)
    assert value[0] == 0.0
    assert value[-1] == 1.0
    assert np.diff(value).min() >= -1e-9


@settings(max_examples=60, deadline=None)
@given(order=st.floats(1, 8), reach=st.floats(0.2, 4), angle=st.floats(math.pi / 2, math.pi))
def test_the_regimes_of_evaluation_join(order: float, reach: float, angle: float) -> None:
    """Across the switch from quadrature to series (|s| t = 50 and 200) the warp is as smooth as elsewhere."""
    size = reach * 200.0
    stiffness, damping = size**2, -2 * size * math.cos(angle)
    times = np.array([1 - 1e-7, 1.0])
    switch = np.array([50.0, 200.0]) / size
    for t in switch[switch < 1]:
        times = np.array([t * (1 - 1e-10), t * (1 + 1e-10)])
        below, above = warp(order, 1.0, damping, stiffness, times)
        assert abs(above - below) <= 1e-9


@pytest.mark.parametrize("order", [1.0, 1.6, 2.0, 3.3])
def test_limits(order: float) -> None:
    np.testing.assert_allclose(warp(order, 1.0, 1.0, 1e14), T**order, atol=1e-6)
    np.testing.assert_allclose(warp(order, 0.0, 0.0, 1.0), T**order, atol=1e-15)
    np.testing.assert_allclose(warp(order, 1e-12, 1.0, 0.0), T ** (order + 1), atol=1e-10)
    np.testing.assert_allclose(warp(order, 0.0, 1.0, 0.0), T ** (order + 1), atol=1e-14)
    np.testing.assert_allclose(warp(order, 1.0, 1e-12, 0.0), T ** (order + 2), atol=1e-10)
    np.testing.assert_allclose(warp(order, 1.0, 0.0, 0.0), T ** (order + 2), atol=1e-14)
    np.testing.assert_allclose(warp(order, 1e-13, 1.0, 7.0), warp(order, 0.0, 1.0, 7.0), atol=1e-11)


@settings(max_examples=30, deadline=None)
@given(factor=st.floats(1e-3, 1e3), order=st.floats(1, 6))
def test_only_ratios_matter(factor: float, order: float) -> None:
    np.testing.assert_allclose(
        warp(order, factor * 0.3, factor * 2.0, factor * 90.0), warp(order, 0.3, 2.0, 90.0), atol=1e-11
    )


def test_bad_parameters_are_named() -> None:
    for order in (0.5, 21.0, math.nan, True):
        with pytest.raises(InputError, match="must be a real number from 1 to 20"):
            warp(order, 1.0, 1.0, 1.0)
    with pytest.raises(InputError, match=re.escape("mass, damping and stiffness are all 0")):
        warp(2.0, 0.0, 0.0, 0.0)
