"""PDE surfaces of paper 000: boundary, equation, singular set, joints, blending by the corrected coefficients."""

import re
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from capture_eval.errors import InputError, SolverError
from capture_eval.interpolation.methods import create_method
from capture_eval.interpolation.pde_surface_model import (
    PdeModel,
    blend_models,
    count_coefficients,
    strip_errors,
    strip_model,
    tessellate,
)
from capture_eval.interpolation.static_pde_surface import (
    CurveSeries,
    crossing_factors,
    curve_parameters,
    curve_series,
    patch_points,
)

seeds = st.integers(0, 2**32 - 1)
U = np.linspace(0, 1, 6)


def rings(seed: int, count: int, size: int = 24) -> list[np.ndarray]:
    """Closed curves round a tube, with bumps."""
    rng = np.random.default_rng(seed)
    v = 2 * np.pi * np.arange(size) / size
    circle = np.stack([np.cos(v), np.sin(v), 0 * v], axis=1)
    return [circle + [0, 0, i] + 0.1 * rng.normal(size=(size, 3)) for i in range(count)]


@settings(max_examples=40, deadline=None)
@given(seed=seeds, size=st.integers(3, 60), closed=st.booleans())
def test_full_series_go_through_every_point(seed: int, size: int, closed: bool) -> None:
    points = np.random.default_rng(seed).normal(size=(size, 3))
    series = curve_series(points, closed)
    assert len(series.coefficients) >= size  # an even closed curve has one sine that is nought at all points
    np.testing.assert_allclose(series.points(curve_parameters(size, closed)), points, atol=1e-12)


def test_a_circle_is_its_first_harmonic() -> None:
    v = 2 * np.pi * np.arange(12) / 12
    series = curve_series(np.stack([2 * np.cos(v), 3 * np.sin(v), 0 * v + 5], axis=1), True, 1)
    np.testing.assert_allclose(series.coefficients, [[0, 0, 5], [2, 0, 0], [0, 3, 0]], atol=1e-14)


@settings(max_examples=40, deadline=None)
@given(seed=seeds, ratio=st.floats(-0.0006, 100.0), closed=st.booleans())
def test_boundaries_are_met_and_the_equation_holds(seed: int, ratio: float, closed: bool) -> None:
    """P'' = ξ² P has P(u + s) + P(u − s) = 2 cosh(ξ s) P(u), cos for an imaginary ξ; hyperbolic ratios within
    |λ/β| < 1/(16 N²), N = 10. Each harmonic times its wave in v then solves β w_uu + λ w_vv = 0."""
    rng = np.random.default_rng(seed)
    first, second = (curve_series(rng.normal(size=(24, 3)), closed, 10) for _ in range(2))
    v = rng.random(7)
    surface = patch_points(first, second, ratio, U, v)
    np.testing.assert_array_equal(surface[0], first.points(v))
    np.testing.assert_array_equal(surface[-1], second.points(v))
    factors = crossing_factors(ratio, 10, closed, U)
    waves = (2 if closed else 1) * np.pi * np.arange(1, 11)
    squares = np.concatenate([[0.0], np.repeat(waves, 2)]) ** 2 if closed else np.concatenate([[0, 0], waves]) ** 2
    inner, step = U[1:-1], 0.1
    bend = np.sqrt(complex(ratio)) * np.sqrt(squares)
    sides = sum(crossing_factors(ratio, 10, closed, inner + k * step) for k in (1, -1))
    np.testing.assert_allclose(sides, 2 * np.cosh(bend * step).real * factors[1:-1], rtol=1e-9, atol=1e-300)


def test_the_elliptic_patch_neither_overflows_nor_leaves_the_range_of_its_boundary() -> None:
    """The factors of both boundaries are positive and add up to at most 1; sinh itself overflows from ξ = 710."""
    for ratio in (0.0, 1e-30, 0.01, 1.0, 1e6):
        factors = crossing_factors(ratio, 200, True, np.linspace(0, 1, 101))
        assert np.isfinite(factors).all()
        assert factors.min() >= 0
        assert (factors + factors[::-1]).max() <= 1 + 1e-15
        assert np.diff(factors, axis=0).min() >= 0
    np.testing.assert_allclose(crossing_factors(1e-30, 5, True, U), np.repeat(U[:, None], 11, axis=1), atol=1e-12)
    half = 2 * crossing_factors(1.0, 1, True, [0.5])[0, 1]
    assert half == pytest.approx(1 / np.cosh(np.pi), rel=1e-12)
    shrinking = [2 * crossing_factors(r, 1, True, [0.5])[0, 1] for r in (1.0, 0.25, 0.1, 0.01)]
    np.testing.assert_allclose(shrinking, [0.086, 0.40, 0.65, 0.953], atol=0.005)


@pytest.mark.parametrize(("ratio", "harmonic"), [(-1.0, 1), (-0.25, 1), (-1 / 16, 2), (-1 / 9, 3), (-1 / 100, 5)])
def test_hyperbolic_ratios_without_a_solution_are_refused(ratio: float, harmonic: int) -> None:
    with pytest.raises(SolverError, match=f"has no solution at harmonic {harmonic} "):
        crossing_factors(ratio, 20, True, U)
    safe = crossing_factors(-0.99 / (16 * 20**2), 20, True, np.linspace(0, 1, 51))
    assert np.abs(safe).max() <= 1
    assert np.abs(crossing_factors(-0.1, 20, True, np.linspace(0, 1, 51))).max() > 10


def test_patches_join_exactly_at_every_level_of_detail() -> None:
    model = strip_model(rings(1, 4), True, 8)
    v = np.linspace(0, 1, 50)
    for number in range(2):
        np.testing.assert_array_equal(model.patch(number, [1.0], v), model.patch(number + 1, [0.0], v))
    for across, along in ((1, 3), (2, 24), (5, 100)):
        mesh = tessellate(model, across, along)
        assert mesh.face_count == 3 * across * along
        assert len(mesh.vertices) == along * (3 * across + 1)
        np.testing.assert_array_equal(np.unique(mesh.face_vertices), np.arange(len(mesh.vertices)))
    series = tuple(curve_series(points[:9], False) for points in rings(1, 2))
    assert tessellate(PdeModel(series, ((0, 1),)), 2, 4).face_count == 8


@settings(max_examples=20, deadline=None)
@given(seed=seeds, t=st.floats(0, 1), closed=st.booleans())
def test_blending_coefficients_is_blending_surfaces(seed: int, t: float, closed: bool) -> None:
    """And joints stay joints; t = 0 is the source, t = 1 with one target that target."""
    source, *targets = (strip_model(rings(seed + i, 3), closed, 6) for i in range(4))
    weights = np.random.default_rng(seed).dirichlet(np.ones(3))
    blended = blend_models(source, targets, weights, t)
    v = np.linspace(0, 1, 9)
    for number in range(2):
        expected = (1 - t) * source.patch(number, U, v)
        expected += t * sum(w * target.patch(number, U, v) for w, target in zip(weights, targets, strict=True))
        np.testing.assert_allclose(blended.patch(number, U, v), expected, atol=1e-12)
    np.testing.assert_array_equal(blended.patch(0, [1.0], v), blended.patch(1, [0.0], v))
    last = blend_models(source, targets[:1], [1.0], 1.0)
    np.testing.assert_array_equal(last.curves[1].coefficients, targets[0].curves[1].coefficients)


def test_the_corrected_coefficients_of_equations_24_and_25() -> None:
    """Hyperbolic interpolation of two patches written out with the B and B̄ of Eq 24 as corrected."""
    ratio, n_max, t = -0.001, 5, 0.3
    pair = [[curve_series(ring, True, n_max) for ring in rings(seed, 2)] for seed in (3, 4)]
    (c10, c20), (c11, c21) = ([one.coefficients for one in curves] for curves in pair)
    v = np.linspace(0, 1, 11)[:, None]
    expected = np.zeros((len(U), 11, 3))
    for row, u in enumerate(U):
        expected[row] = c10[0] + (c11[0] - c10[0]) * t + (c20[0] - c10[0]) * u
        expected[row] += ((c21[0] - c11[0]) - (c20[0] - c10[0])) * u * t
        for n in range(1, n_max + 1):
            xi = 2 * np.pi * n * np.sqrt(-ratio)
            for index, wave in ((2 * n - 1, np.cos), (2 * n, np.sin)):
                b1, b1_bar = c10[index], c11[index] - c10[index]
                b2 = (c20[index] - c10[index] * np.cos(xi)) / np.sin(xi)
                last = c21[index] - c11[index] * np.cos(xi)
                b2_bar = (last - (c20[index] - c10[index] * np.cos(xi))) / np.sin(xi)
                across = (b1 + b1_bar * t) * np.cos(xi * u) + (b2 + b2_bar * t) * np.sin(xi * u)
                expected[row] += across * wave(2 * np.pi * n * v)
    models = [PdeModel(tuple(curves), ((0, 1),), ratio) for curves in pair]
    found = blend_models(models[0], [models[1]], [1.0], t).patch(0, U, v[:, 0])
    np.testing.assert_allclose(found, expected, atol=1e-12)


def test_counts_of_coefficients() -> None:
    count = count_coefficients(strip_model(rings(1, 4), True, 8))
    assert (count.vectors, count.scalars, count.vectors_per_patch_form) == (4 * 17, 12 * 17, 6 * 17)


def test_errors_fall_with_the_number_of_harmonics() -> None:
    """A smooth tube: all rings as boundaries leave the truncation only, which vanishes with all harmonics."""
    tube = rings(2, 7)
    largest = [strip_errors(tube, True, n, 1, 6.0, 0.01) for n in (3, 6, 9, 12)]
    assert all(a[1] > b[1] for a, b in pairwise(largest))
    assert max(largest[-1]) < 1e-14
    assert strip_errors(tube, True, 12, 3, 6.0, 0.01)[1] > 0.005


def test_as_a_method_it_is_linear_plus_what_truncation_leaves() -> None:
    start, end = rings(5, 2, 60)
    t = np.linspace(0, 1, 5)
    linear = create_method("linear").predict(start, end, True, t)
    exact = create_method("pde_surface", {"harmonics": 30})
    np.testing.assert_allclose(exact.predict(start, end, True, t), linear, atol=1e-12)
    assert exact.warnings(60, True) == []
    few = create_method("pde_surface", {"harmonics": 3})
    assert np.abs(few.predict(start, end, True, t) - linear).max() > 0.1
    assert "are not met" in few.warnings(60, True)[0]


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: curve_series(np.zeros((2, 3)), True), "a closed curve needs points (M, 3) with M of at least 3"),
        (lambda: curve_series(np.full((5, 3), np.nan), True), "a closed curve of 5 points holds positions that are"),
        (lambda: curve_series(np.zeros((9, 3)), True, 5), "5 harmonics on a closed curve of 9 points, which holds 4"),
        (lambda: curve_series(np.zeros((9, 3)), False, 8), "8 harmonics on an open curve of 9 points, which holds 7"),
        (lambda: CurveSeries(np.zeros((4, 3)), True), "coefficients have shape (4, 3)"),
        (lambda: crossing_factors(np.nan, 3, True, U), "λ/β = nan must be finite"),
        (lambda: crossing_factors(1.0, 3, True, [1.5]), "u must be a list of numbers in [0, 1]"),
        (lambda: strip_model(rings(1, 1), True), "needs at least two curves, got 1"),
        (lambda: strip_model([*rings(1, 1), rings(1, 1)[0][:5]], True, 8), "boundary curve 1: 8 harmonics"),
        (lambda: strip_errors(rings(1, 3), True, 3, 1, 0.0, 0.1), "D_max = 0.0: the model has no extent"),
        (lambda: tessellate(strip_model(rings(1, 2), True), 1, 2), "1 by 2 quads; at least 1 by 3"),
        (lambda: create_method("pde_surface", {"harmonics": 0}), "harmonics = 0 must be a whole number"),
    ],
)
def test_bad_input_is_refused(make: object, words: str) -> None:
    with pytest.raises(InputError, match=re.escape(words)):
        make()  # type: ignore[operator]


def test_bad_blends_are_refused() -> None:
    source, target = (strip_model(rings(i, 3), True, 6) for i in range(2))
    other = strip_model(rings(1, 3), True, 5)
    for targets, weights, t, words in (
        ([target], [0.5], 0.5, "must add up to 1, got 0.5"),
        ([target], [0.5, 0.5], 0.5, "1 target models with weights of shape (2,)"),
        ([target], [1.0], 1.5, "t = 1.5 must be in [0, 1]"),
        ([other], [1.0], 0.5, "target model 0 does not have the curves"),
    ):
        with pytest.raises(InputError, match=re.escape(words)):
            blend_models(source, targets, weights, t)
    with pytest.raises(InputError, match="patch 0: curves 0 and 0 of 1"):
        PdeModel(source.curves[:1], ((0, 0),))
    with pytest.raises(InputError, match="differ in kind or number"):
        PdeModel((source.curves[0], other.curves[0]), ((0, 1),))
