"""Still pictures of meshes: size, place, colours and cover are what geometry says."""

import numpy as np
import pytest
import textured_sphere

from capture_eval.cameras import project
from capture_eval.errors import InputError
from capture_eval.report.mesh_rendering import PRESETS, UNKNOWN_COLOUR, preset_rotation, render_mesh, vertex_colours

SQUARE = np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]])
TRIANGLES = np.array([[0, 1, 2], [0, 2, 3]])


def test_a_square_fills_the_share_of_the_picture_that_the_margin_leaves() -> None:
    picture = render_mesh(SQUARE, TRIANGLES, preset="front", size=(106, 106), background=None)
    cover = picture[..., 3] / 255.0
    assert picture.shape == (106, 106, 4)
    # 6 % margin: the square is 100 pixels wide; the border pixels may be partly covered.
    assert cover.sum() == pytest.approx(100.0**2, rel=0.01)


def test_flat_colours_are_given_back_and_up_is_up() -> None:
    colours = np.array([[1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, 1.0]])
    picture = render_mesh(SQUARE, TRIANGLES, colours=colours, preset="front", size=(64, 64), shading=0.0)
    assert picture[4, 32, 2] > 230
    assert picture[4, 32, 0] < 25
    assert picture[59, 32, 0] > 230
    assert picture[59, 32, 2] < 25


def test_the_subjects_left_is_on_the_right_of_a_front_view() -> None:
    colours = np.array([[0.0, 0.0, 0.0], [1.0, 1.0, 1.0], [1.0, 1.0, 1.0], [0.0, 0.0, 0.0]])
    picture = render_mesh(SQUARE, TRIANGLES, colours=colours, preset="front", size=(64, 64), shading=0.0)
    assert picture[32, 58].mean() > 200 > 60 > picture[32, 5].mean()


def test_a_photos_camera_puts_the_mesh_where_the_photo_has_it() -> None:
    vertices, triangles, _ = textured_sphere.mesh()
    view = textured_sphere.views()[0]
    picture = render_mesh(vertices, triangles, view=view, background=None, supersampling=2)
    assert picture.shape == (240, 320, 4)
    pixels, _ = project(view, vertices[[30 * 91 + 45]])
    column, row = np.floor(pixels[0]).astype(int)
    assert picture[row, column, 3] == 255
    rows, columns = np.nonzero(picture[..., 3])
    expected, _ = project(view, vertices)
    assert abs(rows.min() - expected[:, 1].min()) < 1.5
    assert abs(columns.max() - expected[:, 0].max()) < 1.5


def test_unknown_values_are_grey_and_the_ends_of_the_range_are_the_ends_of_the_map() -> None:
    colours = vertex_colours(4, np.array([0.0, 1.0, np.nan, 5.0]), colour_map="viridis", value_range=(0.0, 1.0))
    np.testing.assert_allclose(colours[2], UNKNOWN_COLOUR)
    np.testing.assert_allclose(colours[3], colours[1])
    np.testing.assert_allclose(colours[0], [0.267004, 0.004874, 0.329415], atol=1e-6)
    assert vertex_colours(2, np.full(2, np.nan)).shape == (2, 3)


@pytest.mark.parametrize("preset", list(PRESETS))
def test_presets_are_rotations_with_the_head_upright(preset: str) -> None:
    rotation = preset_rotation(preset)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1.0)
    assert rotation[1, 1] < -0.5  # the picture's down is the head's down


def test_wrong_shapes_are_refused() -> None:
    with pytest.raises(InputError, match=r"values \(3,\) for 4"):
        render_mesh(SQUARE, TRIANGLES, values=np.zeros(3))
    with pytest.raises(InputError, match="no preset"):
        render_mesh(SQUARE, TRIANGLES, preset="above")  # type: ignore[arg-type]
