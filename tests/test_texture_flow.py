"""Texture flow: a known slide along the skin is found."""

import numpy as np
import pytest
import textured_sphere

from capture_eval.errors import InputError
from capture_eval.registration.texture_atlas import TextureAtlas, rasterise_atlas, texel_positions
from capture_eval.registration.texture_baking import BakedTexture
from capture_eval.registration.texture_flow import FlowOptions, flow_field, local_normalisation, texture_flow


def _texture(atlas: TextureAtlas, triangles: np.ndarray, skin_points: np.ndarray, gain: float = 1.0) -> BakedTexture:
    points = texel_positions(atlas, triangles, skin_points)
    mask = atlas.triangle >= 0
    image = np.where(mask, gain * textured_sphere.skin(np.nan_to_num(points)), 0.0).astype(np.float32)
    return BakedTexture(image, mask.astype(np.float32), mask)


def _turn(points: np.ndarray, degrees: float) -> np.ndarray:
    angle = np.deg2rad(degrees)
    matrix = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    return points @ matrix.T


@pytest.fixture(scope="module")
def ball() -> tuple:
    vertices, triangles, corner_uv = textured_sphere.mesh()
    return vertices, triangles, rasterise_atlas(corner_uv, 256)


@pytest.mark.parametrize("gain", [1.0, 0.6])
def test_a_ball_that_slid_under_its_mesh_is_turned_back(ball: tuple, gain: float) -> None:
    vertices, triangles, atlas = ball
    # The pose's mesh stayed, its skin turned by one degree (0.87 units, 1.7 texels): texel x shows what was at
    # turn(-1) x; a point p of the neutral's skin is now at turn(+1) p.
    neutral = _texture(atlas, triangles, vertices)
    pose = _texture(atlas, triangles, _turn(vertices, -1.0), gain)
    flow = texture_flow(neutral, pose, atlas, vertices, triangles, FlowOptions(consistency=1.2))
    start = (vertices[triangles[flow.triangle]] * flow.barycentric[:, :, None]).sum(axis=1)
    error = np.linalg.norm(flow.target - _turn(start, 1.0), axis=1)
    moved = np.linalg.norm(start - _turn(start, 1.0), axis=1)
    assert len(error) > 2500
    assert np.median(moved) > 0.6
    # A twentieth of a texel (0.5 units) in the median; single texels where the pattern is flat are worse.
    assert np.median(error) < 0.025
    assert np.average(error, weights=flow.weight) < 0.04
    assert np.all((flow.weight > 0) & (flow.weight <= 1))


def test_equal_textures_give_no_displacement(ball: tuple) -> None:
    vertices, triangles, atlas = ball
    texture = _texture(atlas, triangles, vertices)
    flow = texture_flow(texture, texture, atlas, vertices, triangles)
    start = (vertices[triangles[flow.triangle]] * flow.barycentric[:, :, None]).sum(axis=1)
    assert np.linalg.norm(flow.target - start, axis=1).max() < 1e-3


def test_borders_and_holes_give_no_constraints(ball: tuple) -> None:
    vertices, triangles, atlas = ball
    texture = _texture(atlas, triangles, vertices)
    mask = texture.mask.copy()
    mask[100:140, 100:140] = False
    holed = BakedTexture(np.where(mask, texture.image, 0).astype(np.float32), texture.weight, mask)
    options = FlowOptions(step=1)
    field = flow_field(texture, holed, atlas, options)
    assert field.distance[95, 120] == pytest.approx(5.0, abs=0.01)
    flow = texture_flow(texture, holed, atlas, vertices, triangles, options)
    used = np.zeros(atlas.triangle.shape, dtype=bool)
    used[np.isin(atlas.triangle, np.unique(flow.triangle))] = True
    assert not used[110:130, 110:130].any()
    assert np.all(atlas.border_distance[np.isin(atlas.triangle, flow.triangle)].max() > options.border_margin)


def test_skin_without_detail_is_not_believed(ball: tuple) -> None:
    vertices, triangles, atlas = ball
    mask = atlas.triangle >= 0
    generator = np.random.default_rng(1)
    noise = [np.where(mask, 128 + generator.normal(0, 1.0, mask.shape), 0).astype(np.float32) for _ in range(2)]
    first, second = (BakedTexture(n, mask.astype(np.float32), mask) for n in noise)
    blank = texture_flow(first, second, atlas, vertices, triangles)
    texture = _texture(atlas, triangles, vertices)
    known = texture_flow(texture, texture, atlas, vertices, triangles)
    assert blank.weight.sum() < 0.02 * known.weight.sum()


def test_no_common_texel_gives_no_constraints(ball: tuple) -> None:
    vertices, triangles, atlas = ball
    texture = _texture(atlas, triangles, vertices)
    empty = BakedTexture(texture.image, texture.weight, np.zeros_like(texture.mask))
    flow = texture_flow(texture, empty, atlas, vertices, triangles)
    assert flow.triangle.shape == (0,)
    assert flow.target.shape == (0, 3)
    assert flow.barycentric.shape == (0, 3)


def test_normalisation_ignores_gain_and_slow_shading() -> None:
    column, row = np.meshgrid(np.arange(96.0), np.arange(96.0))
    detail = 30.0 * np.sin(column / 1.7) * np.sin(row / 1.9)
    mask = np.ones((96, 96), dtype=bool)
    first = local_normalisation((100 + detail).astype(np.float32), mask, 8.0)
    second = local_normalisation((60 + 0.5 * column + 0.7 * detail).astype(np.float32), mask, 8.0)
    inner = (slice(24, -24), slice(24, -24))
    # The floor of one grey level on the deviation (15 and 10 here) leaves a few per cent.
    assert np.abs(first - second)[inner].max() < 0.12


def test_textures_of_another_size_are_refused(ball: tuple) -> None:
    vertices, triangles, atlas = ball
    texture = _texture(atlas, triangles, vertices)
    small = BakedTexture(texture.image[:128, :128], texture.weight[:128, :128], texture.mask[:128, :128])
    with pytest.raises(InputError, match="pose texture"):
        texture_flow(texture, small, atlas, vertices, triangles)
