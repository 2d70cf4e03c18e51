"""The dynamic PDE: its own equation, its limits, its symmetries, and what it refuses."""

import math
import re
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from numpy.polynomial import Polynomial, chebyshev

from capture_eval.errors import InputError, SolverError
from capture_eval.interpolation.dynamic_pde import DynamicPde
from capture_eval.interpolation.linear import LinearInterpolation

TIMES = np.linspace(0, 1, 11)


def curve(seed: int, count: int, harmonics: int = 8) -> tuple[np.ndarray, np.ndarray]:
    """Two smooth closed curves with up to ``harmonics`` harmonics."""
    rng = np.random.default_rng(seed)
    u = 2 * np.pi * np.arange(count) / count
    basis = np.stack([f(n * u) / (1 + n) ** 2 for n in range(harmonics + 1) for f in (np.cos, np.sin)], axis=1)
    return basis @ rng.normal(size=(basis.shape[1], 3)), basis @ rng.normal(size=(basis.shape[1], 3))


def particular_solution(order: int, mass: float, damping: float, stiffness: float) -> Polynomial:
    """Response to the force t^R by undetermined coefficients, straight from m g'' + c g' + B g = t^R."""
    operator = np.zeros((order + 1, order + 1))
    for r in range(order + 1):  # column: what t^r gives
        operator[r, r] += stiffness
        if r >= 1:
            operator[r - 1, r] += damping * r
        if r >= 2:
            operator[r - 2, r] += mass * r * (r - 1)
    return Polynomial(np.linalg.solve(operator, np.eye(order + 1)[order]))


@pytest.mark.parametrize("order", [1, 2, 3])
@pytest.mark.parametrize("numbers", [(1.0, 1.0, 1.0), (0.01, 1.0, 0.02), (0.3, 40.0, 0.5), (2.0, 0.0, 0.3)])
@pytest.mark.parametrize("foundation", [0.0, 3.0])
def test_the_pde_holds(order: int, numbers: tuple[float, float, float], foundation: float) -> None:
    """Residual of m w_tt + c w_t + κ(w − w0) + k w_uuuu − f, relative to f, at Chebyshev times and all points.

    Time derivatives are those of the interpolating polynomial, derivatives in u come from the FFT of the printed
    result, the force from the boundary values of each harmonic. The mode without bending is left out where κ = 0,
    because the closure `stiff` is not of the paper's force family.
    """
    mass, damping, rigidity = numbers
    start, end = curve(order, 40)
    start -= start.mean(axis=0) * (foundation == 0)
    end -= end.mean(axis=0) * (foundation == 0)
    times = 0.5 - 0.5 * np.cos(np.pi * np.arange(order + 3) / (order + 2))
    method = DynamicPde(order, mass, damping, rigidity, foundation)
    shapes = method.predict(start, end, True, times).reshape(len(times), -1)
    series = chebyshev.chebfit(2 * times - 1, shapes, order + 2)
    velocity = 2 * chebyshev.chebval(2 * times - 1, chebyshev.chebder(series)).T.reshape(len(times), -1, 3)
    acceleration = 4 * chebyshev.chebval(2 * times - 1, chebyshev.chebder(series, 2)).T.reshape(len(times), -1, 3)
    shapes = shapes.reshape(len(times), -1, 3)

    n = np.fft.rfftfreq(40, 1 / 40)
    bending = (2 * np.pi * n) ** 4 * rigidity
    first, last = np.fft.rfft(start, axis=0), np.fft.rfft(end, axis=0)
    force = np.zeros((len(times), len(n), 3), dtype=complex)
    for index in range(len(n)):
        stiffness = bending[index] + foundation
        if stiffness == 0:
            continue
        power = particular_solution(order, mass, damping, stiffness)
        gain = (last[index] - first[index]) / (power(1.0) - power(0.0))
        steady = bending[index] * first[index] - gain * stiffness * power(0.0)
        force[:, index] = steady + times[:, None] ** order * gain
    spectrum = np.fft.rfft(shapes, axis=1)
    left = np.fft.rfft(mass * acceleration + damping * velocity, axis=1)
    left += bending[:, None] * spectrum + foundation * (spectrum - first)
    assert np.abs(left - force).max() <= 1e-10 * np.abs(force).max()


def test_open_curves_obey_the_pde_between_their_ends() -> None:
    """One sine mode of an open curve: B = k (nπ)⁴ and the same warp; the ramp follows the closure."""
    u = np.linspace(0, 1, 33)[:, None]
    start = np.hstack([u, 0 * u, 0 * u])
    end = start + np.array([[0.0, 1.0, 0.0]]) * np.sin(3 * np.pi * u)
    method = DynamicPde(2, mass=1.0, damping=50.0, rigidity=0.02)
    alpha = 50.0 / (0.02 * (3 * np.pi) ** 4)
    found = method.predict(start, end, False, TIMES)
    expected = TIMES * (TIMES - 2 * alpha) / (1 - 2 * alpha)
    np.testing.assert_allclose(found[:, :, 1], expected[:, None] * np.sin(3 * np.pi * u[:, 0]), atol=1e-12)
    np.testing.assert_allclose(found[:, :, 0], np.repeat(u.T, len(TIMES), 0), atol=1e-15)


@settings(max_examples=30, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    count=st.integers(3, 40),
    closed=st.booleans(),
    closure=st.sampled_from(["stiff", "linear"]),
)
def test_order_one_is_geometric_linear(seed: int, count: int, closed: bool, closure: str) -> None:
    rng = np.random.default_rng(seed)
    start, end = rng.normal(size=(2, count, 3))
    found = DynamicPde(1, mass=3.0, damping=0.2, rigidity=0.7, closure=closure).predict(start, end, closed, TIMES)
    np.testing.assert_array_equal(found, LinearInterpolation().predict(start, end, closed, TIMES))


@settings(max_examples=30, deadline=None)
@given(
    order=st.integers(1, 4),
    numbers=st.tuples(*[st.floats(0.01, 100)] * 4),
    factor=st.floats(1e-3, 1e3),
    closed=st.booleans(),
)
def test_only_ratios_of_the_parameters_matter(
    order: int, numbers: tuple[float, float, float, float], factor: float, closed: bool
) -> None:
    start, end = curve(3, 20)
    try:
        found = DynamicPde(order, *numbers).predict(start, end, closed, TIMES)
        scaled = DynamicPde(order, *(factor * value for value in numbers)).predict(start, end, closed, TIMES)
    except SolverError:
        assume(False)
    assume(np.abs(found).max() < 100)  # away from singular parameters rounding is not amplified
    np.testing.assert_allclose(scaled, found, atol=1e-10)


@pytest.mark.parametrize("closed", [True, False])
def test_mass_does_not_matter_for_the_quadratic_stiff_method(closed: bool) -> None:
    start, end = curve(4, 21)
    light = DynamicPde(2, mass=0.0, damping=30.0).predict(start, end, closed, TIMES)
    heavy = DynamicPde(2, mass=1e3, damping=30.0).predict(start, end, closed, TIMES)
    np.testing.assert_allclose(light, heavy, atol=1e-13)


@pytest.mark.parametrize("closed", [True, False])
def test_limits_are_power_of_time_at_rate_alpha(closed: bool) -> None:
    start, end = curve(5, 30)
    gaps = []
    for rigidity in (1e2, 1e3, 1e4):
        found = DynamicPde(3, rigidity=rigidity).predict(start, end, closed, TIMES)
        gaps.append(np.abs(found - (start + TIMES[:, None, None] ** 3 * (end - start))).max())
    ratios = np.array(gaps[:-1]) / gaps[1:]
    np.testing.assert_allclose(ratios, 10, rtol=0.01)  # first order in α = c/B


def test_resting_points_stay_with_the_stiff_closure_and_leak_with_others() -> None:
    """A third of a closed curve moves; the rest must not be dragged along."""
    start, _ = curve(6, 60)
    end = start.copy()
    end[20:40, 2] += np.hanning(20)
    still = np.r_[0:15, 45:60]

    def leak(**options: float | str) -> float:
        found = DynamicPde(2, **options).predict(start, end, True, TIMES)  # type: ignore[arg-type]
        return float(np.abs(found[:, still] - start[still]).max())

    assert leak(rigidity=1e3) < 1e-5
    mean = np.hanning(20).sum() / 60
    assert leak(rigidity=1e3, closure="linear") == pytest.approx(0.25 * mean, rel=0.01)
    assert leak(rigidity=1e6, mass=1e-6, closure="ebar0") == pytest.approx(4 / 27 * mean, rel=0.03)
    foundation = [leak(mass=0.1, foundation=value) for value in (1.0, 10.0, 100.0)]
    assert foundation[0] > 5 * foundation[1] > 25 * foundation[2]


def test_truncation_converges_and_exact_ends_are_exact() -> None:
    start, end = curve(7, 64, harmonics=20)
    errors = []
    for harmonics in (2, 8, 20):
        plain = DynamicPde(2, harmonics=harmonics, exact_ends=False).predict(start, end, True, [0.0, 1.0])
        np.testing.assert_allclose(plain[0], start, atol=1e-15)
        errors.append(np.abs(plain[1] - end).max())
        exact = DynamicPde(2, damping=90.0, harmonics=harmonics).predict(start, end, True, [1.0])
        np.testing.assert_array_equal(exact[0], end)
    assert errors[0] > 3 * errors[1]
    assert errors[2] < 1e-14  # band-limited data: all harmonics are there


def test_truncated_open_curves_converge_faster_than_their_periodic_series() -> None:
    """Ramp plus sine: coefficients fall like n⁻³, so the end error falls at least fourfold when N doubles."""
    u = np.linspace(0, 1, 257)
    start = np.stack([u, 0 * u, 0 * u], axis=1)
    end = np.stack([u, u**2, np.exp(u)], axis=1)
    errors = [
        np.abs(DynamicPde(2, harmonics=n, exact_ends=False).predict(start, end, False, [1.0])[0] - end).max()
        for n in (4, 8, 16, 32)
    ]
    assert all(before > 3.5 * after for before, after in pairwise(errors))


def test_all_harmonics_warn_or_not_as_they_run() -> None:
    assert DynamicPde(2).warnings(40, True) == []
    assert DynamicPde(3).warnings(40, False) == []
    base = 16 * math.pi**4
    assert "harmonic 1 first runs backwards" in DynamicPde(2, damping=0.3 * base).warnings(40, True)[0]
    assert "harmonic 1 overshoots" in DynamicPde(2, damping=0.7 * base).warnings(40, True)[0]
    assert any("points that do not move" in line for line in DynamicPde(2, closure="linear").warnings(40, True))


def test_singular_parameters_are_refused_with_their_numbers() -> None:
    damping = 8 * math.pi**4  # α = 1/2 for harmonic 1 of a closed curve with k = 1
    with pytest.raises(SolverError, match=re.escape("c = 779.273, k = 1, κ = 0: order 2 is singular at harmonic 1")):
        DynamicPde(2, damping=damping).predict(*curve(1, 9), True, TIMES)
    with pytest.raises(SolverError, match=r"closure 'ebar0' with order 1 is singular at m/c = 0\.5"):
        DynamicPde(1, mass=0.5, damping=1.0, closure="ebar0")
    with pytest.raises(SolverError, match="divides by the damping"):
        DynamicPde(2, damping=0.0, closure="rest")
    with pytest.raises(SolverError, match="singular at harmonic 0"):
        DynamicPde(2, damping=1.0, foundation=2.0)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"order": 0}, "order R = 0 must be"),
        ({"order": 1.5}, "order R = 1.5 must be"),
        ({"mass": -1}, "mass = -1 must be finite and not negative"),
        ({"damping": math.nan}, "damping = nan"),
        ({"rigidity": 0}, "rigidity and foundation are both 0"),
        ({"closure": "free"}, "unknown zero-mode closure 'free'"),
        ({"harmonics": -1}, "harmonics = -1 must be 0 or more"),
    ],
)
def test_bad_parameters_are_named(options: dict[str, float], words: str) -> None:
    with pytest.raises(InputError, match=re.escape(words)):
        DynamicPde(**options)  # type: ignore[arg-type]


def test_harmonics_beyond_the_points_are_refused() -> None:
    method = DynamicPde(2, harmonics=5)
    with pytest.raises(InputError, match="5 harmonics on a closed curve of 9 points, which holds 4"):
        method.predict(*curve(1, 9), True, TIMES)
    with pytest.raises(InputError, match="5 harmonics on an open curve of 6 points, which holds 4"):
        method.predict(*curve(1, 6), False, TIMES)


@settings(max_examples=30, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    degrees=st.floats(1, 170),
    t=st.floats(0.05, 0.95),
    order=st.integers(1, 4),
    damping=st.floats(0, 1e4),
)
def test_no_warp_per_harmonic_follows_a_rotation(
    seed: int, degrees: float, t: float, order: int, damping: float
) -> None:
    """A rigid rotation by θ about the centre: for every scalar warp per harmonic the RMS error is at least
    2 sin(θt/2) sin(θ(1 − t)/2) times the RMS distance from the axis, because chord and true displacement differ by a
    rotation by θ(1 − t)/2."""
    theta = math.radians(degrees)
    start, _ = curve(seed, 32)
    radius = math.sqrt(float((start[:, :2] ** 2).sum(axis=1).mean()))

    def turned(angle: float) -> np.ndarray:
        c, s = math.cos(angle), math.sin(angle)
        return start @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]).T

    bound = 2 * math.sin(theta * t / 2) * math.sin(theta * (1 - t) / 2) * radius
    truth, end = turned(theta * t), turned(theta)
    try:
        found = DynamicPde(order, damping=damping).predict(start, end, True, [t])[0]
    except SolverError:
        assume(False)
    error = math.sqrt(float(((found - truth) ** 2).sum(axis=1).mean()))
    assert error >= bound * (1 - 1e-9) - 1e-12
    share = math.sin(theta * t / 2) * math.cos(theta * (1 - t) / 2) / math.sin(theta / 2)
    best = start + share * (end - start)
    attained = math.sqrt(float(((best - truth) ** 2).sum(axis=1).mean()))
    assert attained == pytest.approx(bound, rel=1e-9, abs=1e-12)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10**6), order=st.integers(1, 5), damping=st.floats(0, 1e4), mass=st.floats(0, 1e3))
def test_no_parameters_beat_a_free_warp_of_every_harmonic(seed: int, order: int, damping: float, mass: float) -> None:
    """The best real factor of each harmonic, by Parseval, bounds the RMS error of every such PDE from below."""
    rng = np.random.default_rng(seed)
    start, end = curve(seed, 24)
    truth = start + rng.normal(size=(24, 3)) * 0.3 + 0.4 * (end - start)
    modes, goal = np.fft.fft(end - start, axis=0), np.fft.fft(truth - start, axis=0)
    overlap = (np.conj(modes) * goal).real.sum(axis=1)
    pairs = overlap + np.roll(overlap[::-1], 1)  # n and −n share one warp
    size = (np.abs(modes) ** 2).sum(axis=1)
    free = pairs / np.maximum(size + np.roll(size[::-1], 1), 1e-300)
    bound = float((np.abs(goal - free[:, None] * modes) ** 2).sum()) / 24
    try:
        found = DynamicPde(order, mass=mass, damping=damping).predict(start, end, True, [0.5])[0]
    except SolverError:
        assume(False)
    assert float(((found - truth) ** 2).sum()) >= bound * (1 - 1e-9)
