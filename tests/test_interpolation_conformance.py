"""What every interpolation method must do, and what those that claim it must do besides."""

import re
from importlib import metadata

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from capture_eval.errors import InputError
from capture_eval.interpolation.dynamic_pde import DynamicPde
from capture_eval.interpolation.method import InterpolationMethod
from capture_eval.interpolation.methods import METHODS, PAPER_METHODS, create_method, known_methods

TABLE = {
    **{name: create_method(name) for name in METHODS},
    "soft": DynamicPde(order=3, damping=4e4, rigidity=1.0),
    "foundation": DynamicPde(order=2, mass=0.1, foundation=50.0),
    "order 5": DynamicPde(order=5, damping=20.0),
    "few harmonics": DynamicPde(order=2, damping=100.0, harmonics=1),
    "closure linear": DynamicPde(order=2, closure="linear"),
    "closure ebar0": DynamicPde(order=2, mass=0.01, closure="ebar0"),
    "closure rest": DynamicPde(order=3, mass=0.01, closure="rest"),
    "closure minforce": DynamicPde(order=2, closure="minforce"),
    "causal 1.7": create_method("pde_causal", {"order": 1.7, "damping": 5e3, "foundation": 0.0}),
    "monotone late": create_method("monotone", {"times": [0.3, 0.6], "shares": [0.1, 0.2]}),
    "beta 3 1": create_method("beta", {"rise": 3.0, "settle": 1.0}),
    "power 1.6": create_method("power", {"exponent": 1.6}),
}
everyone = pytest.mark.parametrize("method", TABLE.values(), ids=TABLE.keys())
TIMES = np.array([0.0, 0.1, 0.35, 0.5, 0.8, 1.0])
EPS = 1e-12  # rounding of sums over up to 60 points of size 1


def shapes(seed: int, count: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return rng.normal(size=(count, 3)), rng.normal(size=(count, 3))


seeds = st.integers(0, 2**32 - 1)
counts = st.integers(3, 40)


@everyone
@settings(max_examples=25, deadline=None)
@given(seed=seeds, count=counts, closed=st.booleans())
def test_both_ends_are_met(method: InterpolationMethod, seed: int, count: int, closed: bool) -> None:
    start, end = shapes(seed, count)
    before = start.copy(), end.copy()
    found = method.predict(start, end, closed, TIMES)
    assert found.shape == (len(TIMES), count, 3)
    assert found.dtype == np.float64
    np.testing.assert_array_equal(start, before[0])
    np.testing.assert_array_equal(end, before[1])
    if any("are not met" in line for line in method.warnings(count, closed)):
        return  # a method that represents shapes by few harmonics says so
    assert np.abs(found[0] - start).max() <= EPS
    assert np.abs(found[-1] - end).max() <= EPS


@everyone
@settings(max_examples=15, deadline=None)
@given(seed=seeds, count=counts, closed=st.booleans())
def test_affine_maps_of_both_shapes_commute(method: InterpolationMethod, seed: int, count: int, closed: bool) -> None:
    start, end = shapes(seed, count)
    rng = np.random.default_rng(seed)
    matrix, shift = rng.normal(size=(3, 3)), rng.normal(size=3)
    mapped = method.predict(start @ matrix.T + shift, end @ matrix.T + shift, closed, TIMES)
    np.testing.assert_allclose(mapped, method.predict(start, end, closed, TIMES) @ matrix.T + shift, atol=1e-11)


@everyone
@settings(max_examples=15, deadline=None)
@given(seed=seeds, count=counts, closed=st.booleans(), shift=st.integers(0, 39))
def test_naming_of_points_does_not_matter(
    method: InterpolationMethod, seed: int, count: int, closed: bool, shift: int
) -> None:
    """Reversal of every curve, and another first point of a closed one."""
    start, end = shapes(seed, count)
    found = method.predict(start, end, closed, TIMES)
    np.testing.assert_allclose(method.predict(start[::-1], end[::-1], closed, TIMES), found[:, ::-1], atol=EPS)
    if closed:
        rolled = method.predict(np.roll(start, shift, 0), np.roll(end, shift, 0), True, TIMES)
        np.testing.assert_allclose(rolled, np.roll(found, shift, 1), atol=EPS)


@everyone
@settings(max_examples=15, deadline=None)
@given(seed=seeds, count=counts, closed=st.booleans())
def test_swapping_the_shapes_at_the_same_time(method: InterpolationMethod, seed: int, count: int, closed: bool) -> None:
    """w(b, a) = a + b − w(a, b) for methods linear in the displacement; not a reversal of time. a and b as the method
    shows them when they do not move."""
    start, end = shapes(seed, count)
    there = method.predict(start, end, closed, TIMES)
    both = sum(method.predict(shape, shape, closed, TIMES) for shape in (start, end))
    np.testing.assert_allclose(method.predict(end, start, closed, TIMES), both - there, atol=EPS)


@everyone
@settings(max_examples=10, deadline=None)
@given(seed=seeds, count=counts, closed=st.booleans())
def test_blending_commutes(method: InterpolationMethod, seed: int, count: int, closed: bool) -> None:
    """Interpolating a blend of targets is blending the interpolated targets, weights adding up to 1."""
    start, first = shapes(seed, count)
    second = shapes(seed + 1, count)[0]
    blended = method.predict(start, 0.3 * first + 0.7 * second, closed, TIMES)
    parts = 0.3 * method.predict(start, first, closed, TIMES) + 0.7 * method.predict(start, second, closed, TIMES)
    np.testing.assert_allclose(blended, parts, atol=EPS)


@everyone
@pytest.mark.parametrize("closed", [True, False])
def test_a_curve_at_rest_stays(method: InterpolationMethod, closed: bool) -> None:
    start, _ = shapes(5, 12)
    np.testing.assert_allclose(method.predict(start, start, closed, TIMES), [start] * len(TIMES), atol=EPS)


@everyone
def test_it_says_what_it_is(method: InterpolationMethod) -> None:
    assert isinstance(method, InterpolationMethod)
    assert method.title
    assert method.reference
    assert hash(method) == hash(type(method)(**method.options))  # type: ignore[call-arg]
    assert method == type(method)(**method.options)  # type: ignore[call-arg]
    assert all("\n" not in line for line in method.warnings(20, True))


@everyone
def test_small_curves(method: InterpolationMethod) -> None:
    few = method.predict(*shapes(1, 2), False, TIMES) if getattr(method, "harmonics", None) is None else None
    assert few is None or np.isfinite(few).all()
    assert np.isfinite(method.predict(*shapes(1, 3), True, TIMES)).all()


@everyone
@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"end": np.zeros((5, 3))}, "two shapes (points, 3) of equal size, got (6, 3) and (5, 3)"),
        ({"start": np.zeros((2, 3)), "end": np.zeros((2, 3))}, "a closed curve of 2 points; at least 3"),
        ({"start": np.full((6, 3), np.nan)}, "positions that are not finite"),
        ({"times": [0.5, 1.5]}, "times must be a list of numbers in [0, 1]"),
        ({"times": [[0.5]]}, "times must be a list"),
        ({"times": [float("nan")]}, "times must be a list"),
    ],
)
def test_bad_arguments_are_refused(method: InterpolationMethod, change: dict[str, object], words: str) -> None:
    arguments = {"start": np.zeros((6, 3)), "end": np.ones((6, 3)), "closed": True, "times": [0.5], **change}
    with pytest.raises(InputError, match=re.escape(words)):
        method.predict(**arguments)  # type: ignore[arg-type]


def test_the_table_of_methods() -> None:
    assert set(PAPER_METHODS) <= set(METHODS)
    assert create_method("pde_cubic", {"damping": 2}).options["order"] == 3
    with pytest.raises(InputError, match="unknown interpolation method 'spline'; known are linear"):
        create_method("spline")
    with pytest.raises(InputError, match="method 'pde_cubic': unknown option 'order'; known are mass"):
        create_method("pde_cubic", {"order": 2})
    with pytest.raises(InputError, match="method 'linear': unknown option 'x'; it has none"):
        create_method("linear", {"x": 2})
    with pytest.raises(InputError, match="method 'pde': dynamic PDE: mass = -1 must be"):
        create_method("pde", {"mass": -1})
    with pytest.raises(InputError, match="method 'power': options"):
        create_method("power", {"exponent": "two"})


def test_a_rotation_needs_more_than_timing() -> None:
    """No warp of straight paths follows a turning curve: the chord misses the arc by 1 − cos(θ/2) of the radius."""
    angle = np.deg2rad(25)
    circle = np.stack([np.cos(u := np.linspace(0, 2 * np.pi, 30, endpoint=False)), np.sin(u), 0 * u], axis=1)
    turned = Rotation.from_rotvec([0, 0, angle]).apply(circle)
    truth = Rotation.from_rotvec([0, 0, angle / 2]).apply(circle)
    for name in PAPER_METHODS:
        found = create_method(name).predict(circle, turned, True, [0.5])[0]
        assert np.linalg.norm(found - truth, axis=1).mean() >= 1 - np.cos(angle / 2) - 1e-12


def test_timings_have_their_closed_forms() -> None:
    """Beta(p, 1) is t^p, Beta(2, 2) is 3t² − 2t³; PCHIP goes through its points and never runs back."""
    t = np.linspace(0, 1, 101)

    def progress(name: str, **options: object) -> np.ndarray:
        path = create_method(name, options).predict(np.zeros((2, 3)), np.ones((2, 3)), False, t)
        return path[:, 0, 0]

    np.testing.assert_allclose(progress("beta", rise=2.5, settle=1.0), t**2.5, atol=1e-14)
    np.testing.assert_allclose(progress("beta"), 3 * t**2 - 2 * t**3, atol=1e-14)
    np.testing.assert_allclose(progress("power", exponent=0.7), t**0.7, atol=1e-15)
    np.testing.assert_allclose(progress("cosine"), (1 - np.cos(np.pi * t)) / 2, atol=1e-15)
    cubic = progress("monotone", times=[0.25, 0.5], shares=[0.5, 0.5])
    np.testing.assert_allclose(cubic[[0, 25, 50, 100]], [0, 0.5, 0.5, 1], atol=1e-15)
    assert np.diff(cubic).min() >= -1e-15


@pytest.mark.parametrize(
    ("name", "options", "words"),
    [
        ("power", {"exponent": 0}, "exponent 0 must be positive"),
        ("beta", {"rise": -1.0}, "rise -1.0 must be positive"),
        ("monotone", {"times": [0.5], "shares": []}, "1 times for 0 shares"),
        ("monotone", {"times": [0.5, 0.4], "shares": [0.1, 0.2]}, "must rise inside (0, 1)"),
        ("monotone", {"times": [0.5], "shares": [1.2]}, "must not fall and lie in [0, 1]"),
    ],
)
def test_timings_refuse_bad_parameters(name: str, options: dict[str, object], words: str) -> None:
    with pytest.raises(InputError, match=re.escape(words)):
        create_method(name, options)


def test_causal_curves_keep_resting_points_with_a_foundation_and_warn_without() -> None:
    start = shapes(3, 60)[0]
    end = start.copy()
    end[20:40, 2] += 1.0
    still = np.r_[0:10, 50:60]
    firm = create_method("pde_causal", {"rigidity": 1e4, "foundation": 1e6})
    assert np.abs(firm.predict(start, end, True, TIMES)[:, still] - start[still]).max() < 1e-5
    assert firm.warnings(60, True) == []
    loose = create_method("pde_causal", {"foundation": 0.0})
    assert np.abs(loose.predict(start, end, True, TIMES)[:, still] - start[still]).max() > 0.03
    assert any("points that do not move" in line for line in loose.warnings(60, True))
    with pytest.raises(InputError, match="rigidity and foundation are both 0"):
        create_method("pde_causal", {"rigidity": 0.0, "foundation": 0.0})
    with pytest.raises(InputError, match="real number from 1 to 20"):
        create_method("pde_causal", {"order": 0.5})


def test_methods_of_other_packages_come_by_entry_point(monkeypatch: pytest.MonkeyPatch) -> None:
    def entry(name: str, value: str) -> metadata.EntryPoint:
        return metadata.EntryPoint(name, value, "capture_eval.methods")

    offered = metadata.EntryPoints(
        [
            entry("theirs", "capture_eval.interpolation.time_warps:BetaInterpolation"),
            entry("linear", "no.such:thing"),
            entry("broken", "no.such:thing"),
            entry("odd", "fractions:Fraction"),
            entry("module", "fractions:_hashlib_does_not_exist"),
            entry("builtin", "builtins:dict"),
        ]
    )
    monkeypatch.setattr(metadata, "entry_points", lambda **chosen: offered.select(**chosen))
    assert known_methods() == [*METHODS, "broken", "builtin", "module", "odd", "theirs"]
    assert create_method("theirs", {"rise": 3.0}).title == "Beta(3, 2)"
    assert create_method("linear") == METHODS["linear"]()
    with pytest.raises(InputError, match=r"method 'broken' \(no.such:thing\) cannot be loaded: No module named 'no'"):
        create_method("broken")
    with pytest.raises(InputError, match="method 'odd': Fraction does not keep the contract"):
        create_method("odd")
    with pytest.raises(InputError, match=r"method 'module' .* cannot be loaded: module 'fractions' has no attribute"):
        create_method("module")
    with pytest.raises(InputError, match="method 'builtin' is not made by a factory with named options"):
        create_method("builtin")
