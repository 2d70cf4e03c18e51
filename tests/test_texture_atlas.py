"""Texture atlas: every texel belongs to one triangle, and to the right point of it."""

import numpy as np
import pytest
import textured_sphere
from hypothesis import given, settings
from hypothesis import strategies as st

from capture_eval.errors import InputError
from capture_eval.registration.texture_atlas import (
    chart_of_triangles,
    cylindrical_texture_coordinates,
    rasterise_atlas,
    texel_positions,
)


def _texel_uv(size: int) -> np.ndarray:
    column, row = np.meshgrid(np.arange(size), np.arange(size))
    return np.stack([(column + 0.5) / size, 1.0 - (row + 0.5) / size], axis=-1)


@settings(max_examples=40, deadline=None)
@given(st.lists(st.tuples(st.floats(0, 1), st.floats(0, 1)), min_size=1, max_size=6), st.sampled_from([8, 31, 64]))
def test_a_square_cut_at_any_points_is_covered_exactly_once(inner: list[tuple[float, float]], size: int) -> None:
    # A fan around any inner point tiles the whole square: each texel must lie in exactly one triangle, also where
    # points fall on texel centres or several coincide (the degenerate triangles then own nothing).
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    for point in inner:
        fan = np.array([[corners[i], corners[(i + 1) % 4], point] for i in range(4)])
        atlas = rasterise_atlas(fan, size)
        assert np.all(atlas.triangle >= 0)
        assert atlas.overlap == 0.0


def test_barycentric_weights_give_the_texels_own_coordinates() -> None:
    corner_uv = textured_sphere.mesh()[2]
    atlas = rasterise_atlas(corner_uv, 128)
    inside = atlas.triangle >= 0
    place = (corner_uv[atlas.triangle[inside]] * atlas.barycentric[inside][:, :, None]).sum(axis=1)
    # Corners are rounded to 1/4096 texel and weights to single precision.
    assert np.abs(place - _texel_uv(128)[inside]).max() < 1e-5
    assert np.all(atlas.barycentric[inside] >= 0)
    assert 0.90**2 < inside.mean() < 0.94**2  # the layout spans 0.04..0.96 in both directions


def test_two_triangles_on_top_of_each_other_are_reported() -> None:
    twice = np.tile(np.array([[[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]]), (2, 1, 1))
    atlas = rasterise_atlas(twice, 32)
    assert atlas.overlap == 1.0
    assert atlas.triangle.max() == 0


def test_border_distance_grows_inwards_and_separates_touching_charts() -> None:
    left = np.array([[[0.0, 0.0], [0.5, 0.0], [0.5, 1.0]], [[0.0, 0.0], [0.5, 1.0], [0.0, 1.0]]])
    right = left + np.array([0.5 + 1e-9, 0.0])
    right[..., 0] = np.minimum(right[..., 0], 1.0)
    corner_uv = np.concatenate([left, right])
    assert len(np.unique(chart_of_triangles(corner_uv))) == 2
    atlas = rasterise_atlas(corner_uv, 64)
    row = atlas.border_distance[32]
    assert row[31] == 0
    assert row[32] == 0
    np.testing.assert_allclose(row[:16], np.arange(1, 17))


def test_texel_positions_interpolate_linear_functions_exactly() -> None:
    vertices, triangles, corner_uv = textured_sphere.mesh(columns=8, rows=6)
    atlas = rasterise_atlas(corner_uv, 64)
    positions = texel_positions(atlas, triangles, vertices)
    doubled = texel_positions(atlas, triangles, 2.0 * vertices + 1.0)
    inside = atlas.triangle >= 0
    np.testing.assert_allclose(doubled[inside], 2.0 * positions[inside] + 1.0, atol=1e-5)
    assert np.all(np.isnan(positions[~inside]))


def test_cylinder_layout_of_a_ball_covers_the_square_once() -> None:
    # An open-topped ball around the upright axis: the angle and the height, cut at the back.
    angle, height = np.meshgrid(np.linspace(-np.pi, np.pi, 41)[:-1], np.linspace(-0.9, 0.9, 21))
    radius = np.sqrt(1.0 - height**2)
    vertices = np.stack([radius * np.sin(angle), height, radius * np.cos(angle)], axis=-1).reshape(-1, 3)
    first = np.arange(20)[:, None] * 40 + np.arange(40)[None, :]
    second = np.arange(20)[:, None] * 40 + (np.arange(40)[None, :] + 1) % 40
    triangles = np.concatenate(
        [
            np.stack([first, second, second + 40], -1).reshape(-1, 3),
            np.stack([first, second + 40, first + 40], -1).reshape(-1, 3),
        ]
    )
    corner_uv = cylindrical_texture_coordinates(vertices, triangles)
    atlas = rasterise_atlas(corner_uv, 128)
    assert atlas.overlap == 0.0
    # Of 40 columns only the one behind the head is cut, and the layout keeps a margin of 1 % on each side.
    assert (atlas.triangle >= 0).mean() > 0.98**2 * (39 / 40) - 0.02
    face = atlas.triangle[64, 64]
    assert vertices[triangles[face]].mean(axis=0)[2] > 0.99


@pytest.mark.parametrize(
    ("corner_uv", "size"),
    [(np.zeros((4, 3)), 64), (np.full((1, 3, 2), 1.5), 64), (np.full((1, 3, 2), np.nan), 64), (np.zeros((1, 3, 2)), 4)],
)
def test_bad_layouts_are_refused(corner_uv: np.ndarray, size: int) -> None:
    with pytest.raises(InputError, match="texture atlas"):
        rasterise_atlas(corner_uv, size)
