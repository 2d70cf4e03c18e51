"""Baking and visibility: a known skin comes back from analytic photos."""

import numpy as np
import pytest
import textured_sphere

from capture_eval.errors import InputError
from capture_eval.registration.photo_visibility import count_seen, depth_image, vertex_cosines
from capture_eval.registration.texture_atlas import rasterise_atlas, texel_positions
from capture_eval.registration.texture_baking import BakedTexture, BakingOptions, bake_texture, resized_texture


@pytest.fixture(scope="module")
def scene() -> tuple:
    vertices, triangles, corner_uv = textured_sphere.mesh()
    views = textured_sphere.views()
    return vertices, triangles, rasterise_atlas(corner_uv, 192), views, [textured_sphere.photograph(v) for v in views]


def test_baked_texture_is_the_skin(scene: tuple) -> None:
    vertices, triangles, atlas, views, photos = scene
    baked = bake_texture(vertices, triangles, atlas, views, photos)
    points = texel_positions(atlas, triangles, vertices)[baked.mask]
    points *= textured_sphere.RADIUS / np.linalg.norm(points, axis=1, keepdims=True)
    difference = baked.image[baked.mask] - textured_sphere.skin(points)
    # A pixel is 0.5 units wide and the finest detail 5 units: the box of a pixel lowers its contrast by 2 %, of a
    # deviation of 60 grey levels; oblique pixels are up to twice as long.
    assert np.median(np.abs(difference)) < 1.5
    assert np.quantile(np.abs(difference), 0.99) < 8.0
    assert abs(difference.mean()) < 0.2
    assert baked.mask.mean() > 0.5


def test_colour_photos_give_colour_and_their_luminance(scene: tuple) -> None:
    vertices, triangles, atlas, views, photos = scene
    colour = [np.stack([p, p // 2, np.full_like(p, 7)], axis=-1) for p in photos]
    baked = bake_texture(vertices, triangles, atlas, views, colour, options=BakingOptions(colour=True))
    grey = bake_texture(vertices, triangles, atlas, views, colour)
    np.testing.assert_allclose(baked.image[baked.mask][:, 2], 7.0, atol=1e-3)
    expected = baked.image[grey.mask] @ np.array([0.299, 0.587, 0.114])
    np.testing.assert_allclose(grey.image[grey.mask], expected, atol=1e-2)


def test_an_occluder_hides_what_lies_behind_it(scene: tuple) -> None:
    vertices, triangles, atlas, views, photos = scene
    wall = 4.0 * np.array([[-8.0, -8.0, 0.0], [8.0, -8.0, 0.0], [8.0, 8.0, 0.0], [-8.0, 8.0, 0.0]]) + [0.0, 0.0, 70.0]
    occluder = (wall, np.array([[0, 1, 2], [0, 2, 3]]))
    free = count_seen(vertices, triangles, views)
    hidden = count_seen(vertices, triangles, views, occluder)
    front = np.linalg.norm(vertices - [0.0, 0.0, textured_sphere.RADIUS], axis=1) < 8.0
    assert np.all(free[front] == 6)
    assert np.all(hidden[front] == 0)
    assert not bake_texture(vertices, triangles, atlas, views, photos, occluder).mask[96, 96]


def test_cosines_and_depths_are_those_of_the_ball(scene: tuple) -> None:
    vertices, triangles, _, views, _ = scene
    cosines = vertex_cosines(vertices, triangles, views[:1])[0]
    towards = views[0].center - vertices
    normal = vertices / textured_sphere.RADIUS
    expected = (towards * normal).sum(axis=1) / np.linalg.norm(towards, axis=1)
    seen = cosines > 0.3
    assert seen.sum() > 1000
    # Normals of the facets' average differ from the ball's by a small part of a facet's angle (1.8 degrees); at the
    # open border of the patch they lean to one side.
    assert np.abs(cosines - expected)[seen].max() < 0.02
    assert not np.any(cosines[expected < 0.1])
    depth = depth_image(views[0], vertices, triangles)
    middle = depth[120, 160]
    assert abs(middle - (320.0 - textured_sphere.RADIUS)) < 0.05


def test_bake_is_the_same_bit_for_bit(scene: tuple) -> None:
    vertices, triangles, atlas, views, photos = scene
    first = bake_texture(vertices, triangles, atlas, views, photos)
    second = bake_texture(vertices, triangles, atlas, views, photos)
    assert first.image.tobytes() == second.image.tobytes()


def test_photos_that_do_not_fit_are_refused(scene: tuple) -> None:
    vertices, triangles, atlas, views, photos = scene
    with pytest.raises(InputError, match="6 views but 5 photos"):
        bake_texture(vertices, triangles, atlas, views, photos[:5])
    with pytest.raises(InputError, match="view_00"):
        bake_texture(vertices, triangles, atlas, views, [p[:-1] for p in photos])


def test_a_resized_texture_averages_what_is_known() -> None:
    image = np.zeros((4, 4), dtype=np.float32)
    mask = np.zeros((4, 4), dtype=np.bool_)
    image[:2, :2], mask[:2, :2] = [[1, 2], [3, 6]], True
    image[2, 0], mask[2, 0] = 9.0, True  # one of four texels known: too few
    half = resized_texture(BakedTexture(image, mask.astype(np.float32), mask), 2)
    np.testing.assert_array_equal(half.mask, [[True, False], [False, False]])
    np.testing.assert_allclose(half.image, [[3.0, 0.0], [0.0, 0.0]], atol=1e-6)  # single precision
    np.testing.assert_allclose(half.weight, [[1.0, 0.0], [0.25, 0.0]], atol=1e-6)
