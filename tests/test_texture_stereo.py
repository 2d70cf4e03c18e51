"""Texture-space stereo: a mesh that is off along its normals is told by how much."""

import numpy as np
import pytest
import textured_sphere

from capture_eval.errors import InputError
from capture_eval.registration.texture_atlas import rasterise_atlas
from capture_eval.registration.texture_stereo import OffsetConstraints, StereoOptions, match_weight, texture_stereo

OPTIONS = StereoOptions(views=6, minimum_views=3)


@pytest.fixture(scope="module")
def photos() -> tuple:
    views = textured_sphere.views()
    return views, [textured_sphere.photograph(v) for v in views]


def _measure(photos: tuple, radius: float, half_range: float) -> tuple[OffsetConstraints, np.ndarray, np.ndarray]:
    """Measured offsets, the true ones, and which lie in the middle (within 40 degrees of the front)."""
    vertices, triangles, corner_uv = textured_sphere.mesh(radius)
    atlas = rasterise_atlas(corner_uv, 192)
    result = texture_stereo(vertices, triangles, atlas, *photos, half_range, options=OPTIONS)
    points = (vertices[triangles[result.triangle]] * result.barycentric[:, :, None]).sum(axis=1)
    length = np.linalg.norm(points, axis=1)
    return result, textured_sphere.RADIUS - length, points[:, 2] > np.cos(np.deg2rad(40.0)) * length


@pytest.mark.parametrize("error", [-0.8, 0.0, 0.8])
def test_offsets_bring_the_mesh_to_the_ball(photos: tuple, error: float) -> None:
    result, expected, middle = _measure(photos, textured_sphere.RADIUS + error, 1.5)
    difference = result.offset - expected
    assert len(difference) > 8000
    # A pixel is 0.5 units wide: a twentieth of a pixel for single texels, no bias to speak of where the views are
    # many; towards the rim only two or three oblique views are left.
    assert np.median(np.abs(difference)) < 0.025
    assert abs(np.median(difference[middle])) < 0.01
    assert np.quantile(np.abs(difference[middle]), 0.95) < 0.15
    assert np.all((result.weight > 0) & (result.weight <= 1))
    assert np.all(result.score > OPTIONS.minimum_score)
    np.testing.assert_allclose(np.linalg.norm(result.normal, axis=1), 1.0, atol=1e-9)


def test_a_smaller_range_on_a_better_mesh_is_more_exact(photos: tuple) -> None:
    far, far_truth, _ = _measure(photos, textured_sphere.RADIUS + 0.8, 1.5)
    near, near_truth, _ = _measure(photos, textured_sphere.RADIUS + 0.05, 0.4)
    assert np.median(np.abs(near.offset - near_truth)) < np.median(np.abs(far.offset - far_truth))


def test_weights_tell_good_texels_from_bad_ones(photos: tuple) -> None:
    result, expected, _ = _measure(photos, textured_sphere.RADIUS - 0.6, 1.5)
    error = np.abs(result.offset - expected)
    good = result.weight > np.median(result.weight)
    assert error[good].mean() < 0.8 * error[~good].mean()


def test_photos_of_something_else_give_next_to_nothing(photos: tuple) -> None:
    views, _ = photos
    strangers = [textured_sphere.photograph(view, seed=10 + index) for index, view in enumerate(views)]
    matched, _, _ = _measure(photos, textured_sphere.RADIUS, 1.0)
    mixed, _, _ = _measure((views, strangers), textured_sphere.RADIUS, 1.0)
    assert mixed.weight.sum() < 0.1 * matched.weight.sum()


def test_unequal_exposure_costs_precision_but_gives_no_bias(photos: tuple) -> None:
    views, pictures = photos
    dimmed = [np.rint(p * (0.6 + 0.08 * i)).astype(np.uint8) for i, p in enumerate(pictures)]
    result, expected, middle = _measure((views, dimmed), textured_sphere.RADIUS - 0.5, 1.5)
    difference = result.offset - expected
    assert len(difference) > 8000
    # Twice the error of equal photos: unequal contrasts weigh the pairs unequally, but the offset stays.
    assert np.median(np.abs(difference)) < 0.05
    assert abs(np.median(difference[middle])) < 0.01


def test_few_views_or_bad_options_are_refused_or_empty(photos: tuple) -> None:
    views, pictures = photos
    vertices, triangles, corner_uv = textured_sphere.mesh()
    atlas = rasterise_atlas(corner_uv, 64)
    two = texture_stereo(vertices, triangles, atlas, views[:2], pictures[:2], 1.0, options=OPTIONS)
    assert two.offset.shape == (0,)
    assert two.normal.shape == (0, 3)
    with pytest.raises(InputError, match="half range"):
        texture_stereo(vertices, triangles, atlas, views, pictures, 0.0)
    with pytest.raises(InputError, match="10 offsets"):
        texture_stereo(vertices, triangles, atlas, views, pictures, 1.0, options=StereoOptions(offsets=10))


def test_a_score_that_tops_one_is_a_perfect_match_not_a_missing_number() -> None:
    weight = match_weight(np.array([1.3, 1.0, 0.9, 0.5]), np.full(4, 2.0))
    assert np.all(np.isfinite(weight))
    assert weight[0] == weight[1]
    assert np.all(np.diff(weight[1:]) < 0)
