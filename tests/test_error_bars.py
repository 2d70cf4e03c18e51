"""Error bars: what halves of the photos say about the whole, what bars promise, and what they do to curves."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import textured_sphere

from capture_eval.curves.extract import Curve, CurveSet
from capture_eval.errors import InputError
from capture_eval.evaluation.bar_calibration import bar_coverage, fit_bar_model
from capture_eval.evaluation.error_propagation import MEAN_OF_BAR, curve_bar_coverage, curve_bars
from capture_eval.evaluation.error_table import ErrorTable
from capture_eval.registration.deformation_solver import DeformationSolver
from capture_eval.registration.error_bar import BarModel, error_bar
from capture_eval.registration.mesh_operators import build_mesh_operators
from capture_eval.registration.registration_spread import (
    half_difference_spread,
    neighbour_mean,
    repeat_by_halves,
    repeat_spread,
    split_photos,
)
from capture_eval.registration.texture_atlas import rasterise_atlas
from capture_eval.registration.texture_rounds import PhotoSet, RoundOptions, TextureAtlases, refine_by_texture
from capture_eval.registration.texture_stereo import StereoOptions


def _photos(count: int) -> PhotoSet:
    turns = tuple(np.linspace(-30.0, 30.0, count // 2))
    views = textured_sphere.views(turns=turns)
    return PhotoSet(tuple(views), tuple(np.full((2, 2), k, dtype=np.uint8) for k in range(len(views))))


@pytest.mark.parametrize("count", [6, 12, 24])
def test_halves_share_no_photo_and_see_the_same_sides(count: int) -> None:
    photos = _photos(count)
    first, second = split_photos(photos)
    names = {view.name for view in first.views} | {view.name for view in second.views}
    assert len(names) == count
    assert abs(len(first.views) - len(second.views)) <= 2
    means = [np.mean([view.rotation[2] for view in half.views], axis=0) for half in (first, second)]
    # the mean axes of halves differ by less than two neighbouring cameras do
    step = np.linalg.norm(photos.views[1].rotation[2] - photos.views[0].rotation[2])
    assert np.linalg.norm(means[0] - means[1]) < step
    for half in (first, second):
        for view, image in zip(half.views, half.images, strict=True):
            assert photos.images[[v.name for v in photos.views].index(view.name)] is image


def test_the_spread_of_halves_is_the_error_of_the_whole() -> None:
    """Full set: mean of both halves. With errors of variance 2 s^2 per half its error has the variance s^2."""
    vertices, triangles, _ = textured_sphere.mesh(columns=40, rows=30)
    generator = np.random.default_rng(5)
    halves = vertices + np.sqrt(2.0) * 0.1 * generator.normal(size=(2, *vertices.shape))
    spread = half_difference_spread(halves[0], halves[1], triangles)
    true = np.linalg.norm(halves.mean(axis=0) - vertices, axis=1)
    # 1,271 vertices of three coordinates: the root mean squares repeat within 2 %
    assert np.sqrt(np.mean(spread**2)) == pytest.approx(np.sqrt(np.mean(true**2)), rel=0.06)
    assert np.sqrt(np.mean(spread**2)) == pytest.approx(0.1 * np.sqrt(3.0), rel=0.04)
    with pytest.raises(InputError, match="halves"):
        half_difference_spread(vertices, vertices[:-1], triangles)


def test_neighbour_means_keep_constants_and_stay_local() -> None:
    vertices, triangles, _ = textured_sphere.mesh(columns=10, rows=8)
    np.testing.assert_allclose(neighbour_mean(np.full(len(vertices), 2.0), triangles, 3), 2.0)
    peak = np.zeros(len(vertices))
    peak[0] = 1.0
    assert np.count_nonzero(neighbour_mean(peak, triangles, 1)) <= 7


def test_a_repeat_that_moves_along_the_surface_counts_and_one_across_does_not() -> None:
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]])
    triangles = np.array([[0, 1, 2], [1, 3, 2]])
    along, across = (vertices + np.array(way) for way in ([0.3, 0.4, 0.0], [0.0, 0.0, 9.0]))
    np.testing.assert_allclose(repeat_spread(vertices, [along], triangles), 0.5)
    np.testing.assert_allclose(repeat_spread(vertices, [across], triangles), 0.0, atol=1e-12)
    np.testing.assert_allclose(repeat_spread(vertices, [along, across], triangles), 0.5 / np.sqrt(2.0))
    with pytest.raises(InputError, match="0 repeats"):
        repeat_spread(vertices, [], triangles)


def test_halves_of_noisy_photos_foretell_the_error() -> None:
    """A ball in photos with sensor noise: the spread is of the size of what noise does to the registered mesh."""
    vertices, triangles, corner_uv = textured_sphere.mesh(columns=24, rows=16)
    views = textured_sphere.views(turns=(-28.0, -10.0, 10.0, 28.0))
    clean = [textured_sphere.photograph(view) for view in views]
    atlases = TextureAtlases(rasterise_atlas(corner_uv, 64), rasterise_atlas(corner_uv, 128))
    solver = DeformationSolver(build_mesh_operators(vertices, triangles), np.ones(len(vertices)))
    skin = np.ones(len(vertices), dtype=bool)
    options = RoundOptions(
        half_ranges=(1.0,), solves=2, use_flow=False, stereo=StereoOptions(views=8, minimum_views=4), stiffness=0.3
    )

    def registered(images: list[np.ndarray]) -> tuple[np.ndarray, PhotoSet]:
        photos = PhotoSet(tuple(views), tuple(images))
        found = refine_by_texture(solver, vertices, skin, photos, atlases, None, None, None, options)
        return found.vertices, photos

    def noisy(seed: int) -> list[np.ndarray]:
        generator = np.random.default_rng(seed)
        return [np.clip(image + generator.normal(0.0, 6.0, image.shape), 0, 255).astype(np.uint8) for image in clean]

    reference, _ = registered(clean)
    found, photos = registered(noisy(1))
    halves = repeat_by_halves(solver, found, skin, photos, atlases, None, None, None, options)
    spread = half_difference_spread(*halves, triangles)
    middle = vertices[:, 2] > 0.8 * textured_sphere.RADIUS
    true = np.sqrt(np.mean(np.sum((found - reference)[middle] ** 2, axis=1)))
    expected = np.sqrt(np.mean(spread[middle] ** 2))
    # halves also differ by their viewing directions, so the spread may be larger than what noise alone does
    assert 0.7 * true < expected < 4.0 * true
    with pytest.raises(InputError, match="at least 6"):
        repeat_by_halves(solver, found, skin, PhotoSet(photos.views[:5], photos.images[:5]), atlases, None, None, None,
                         options)  # fmt: skip


def test_the_bar_adds_its_parts_in_squares() -> None:
    model = BarModel(floor=0.003, factor=2.0, doubt=0.012)
    spread, confidence = np.array([0.0, 2.0, 0.0, np.nan]), np.array([1.0, 1.0, 0.0, 1.0])
    bar = error_bar(spread, confidence, 100.0, model)
    np.testing.assert_allclose(bar[:3], [0.3, np.hypot(0.3, 4.0), np.hypot(0.3, 1.2)])
    assert np.isnan(bar[3])
    with pytest.raises(InputError, match="differ"):
        error_bar(spread, confidence[:2], 1.0, model)
    with pytest.raises(InputError, match="D is"):
        error_bar(spread, confidence, 0.0, model)
    with pytest.raises(InputError, match="must be"):
        BarModel(-1.0, 1.0, 1.0)


def test_a_fitted_bar_covers_what_it_promises() -> None:
    generator = np.random.default_rng(2)
    spread = np.exp(generator.normal(-9.0, 0.5, 20000))
    confidence = generator.uniform(0.0, 1.0, 20000)
    true = BarModel(0.0003, 2.0, 0.001)
    scale = error_bar(spread, confidence, 1.0, true) / 1.96
    error = np.abs(scale * generator.normal(size=20000))
    model = fit_bar_model(error, spread, confidence)
    inside = bar_coverage(error, error_bar(spread, confidence, 1.0, model), {"all": np.ones(20000, dtype=bool)})
    # 20,000 draws: the standard deviation of the share is 0.15 %
    assert inside["all"]["inside"] == pytest.approx(0.95, abs=0.006)
    # each part is found again: its 95 % quantile is fixed by about a thousand draws
    for part in dataclasses.fields(model):
        assert getattr(model, part.name) == pytest.approx(getattr(true, part.name), rel=0.25)
    with pytest.raises(InputError, match="100 are needed"):
        fit_bar_model(error[:50], spread[:50], confidence[:50])


def test_coverage_counts_groups_and_leaves_unknown_out() -> None:
    error, bar = np.array([[1.0, 2.0, 3.0, 4.0]]), np.array([[2.0, 2.0, 2.0, np.nan]])
    masks = {"all": np.ones(4, dtype=bool), "last": np.arange(4) == 3}
    found = bar_coverage(error, bar, masks)
    assert found["all"]["inside"] == pytest.approx(2.0 / 3.0)
    assert found["all"]["count"] == 3
    assert found["last"] == {"inside": None, "count": 0, "bar_median": None, "error_p95": None}


def _two_curves() -> CurveSet:
    curves = (Curve("a", np.array([0, 1]), False), Curve("b", np.array([2, 0]), False))
    positions = (np.zeros((3, 2, 3)), np.zeros((3, 2, 3)))
    return CurveSet(curves, positions)


def test_bars_of_curves_by_hand() -> None:
    """t = 0.5: u^2 = m(0.5)^2 + 0.25 m(1)^2; vertex 0: 3 and 8 -> 5, vertex 1: 6 and 16 -> 10; D = 100."""
    bars = np.array([[0.0, 0.0, 0.0], [3.0, 6.0, np.nan], [8.0, 16.0, 1.0]])
    counted = (np.array([True, True]), np.array([True, False]))
    found = curve_bars(bars, _two_curves(), np.array([0.0, 0.5, 1.0]), counted, 100.0)
    np.testing.assert_allclose(found.average, [[0.075], [np.nan]])
    np.testing.assert_allclose(found.maximum, [[0.10], [np.nan]])
    assert found.n_points.tolist() == [[2], [0]]
    assert found.summary()["mean_E_A"] == pytest.approx(MEAN_OF_BAR * 0.075)
    assert found.rows()[0][:3] == ("a", 0.5, 2)
    with pytest.raises(InputError, match="poses"):
        curve_bars(bars[:2], _two_curves(), np.array([0.0, 0.5, 1.0]), counted, 100.0)

    def table(error: float) -> ErrorTable:
        values = np.full((1, 2, 1), error)
        return ErrorTable(("linear",), ("a", "b"), np.array([0.5]), np.ones((2, 1), dtype=np.int64), values, values)

    assert curve_bar_coverage(found, table(0.2), table(0.13))["linear"] == {"E_A_inside": 1.0, "E_M_inside": 1.0}
    assert curve_bar_coverage(found, table(0.2), table(0.11))["linear"] == {"E_A_inside": 0.0, "E_M_inside": 1.0}
