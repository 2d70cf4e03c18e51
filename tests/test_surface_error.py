"""Errors of a reconstruction where the right answer is known: spheres, and a screen that hides half of one."""

import numpy as np
import pytest

pytest.importorskip("open3d")

from capture_eval.cameras import Intrinsics, View
from capture_eval.errors import InputError
from capture_eval.evaluation.surface_error import (
    TrueScene,
    closest_distance,
    cloud_error,
    count_photos,
    face_proper,
    join_scene,
    mesh_error,
    sample_surface,
    share_within,
    true_places,
)

RADIUS = 50.0


def sphere(radius: float = RADIUS, rings: int = 48) -> tuple[np.ndarray, np.ndarray]:
    """Vertices on latitude rings, poles apart, counter-clockwise from outside."""
    heights = np.linspace(0, np.pi, rings + 1)[1:-1]
    turns = np.arange(2 * rings) * np.pi / rings
    ring = np.stack(
        [
            np.outer(np.sin(heights), np.cos(turns)),
            np.outer(np.sin(heights), np.sin(turns)),
            np.outer(np.cos(heights), np.ones(2 * rings)),
        ],
        axis=-1,
    )
    vertices = radius * np.concatenate([ring.reshape(-1, 3), [[0, 0, 1.0], [0, 0, -1.0]]])
    row, column = np.meshgrid(np.arange(rings - 2), np.arange(2 * rings), indexing="ij")
    a, b = row * 2 * rings + column, row * 2 * rings + (column + 1) % (2 * rings)
    c, d = a + 2 * rings, b + 2 * rings
    sides = np.concatenate([np.stack([a, c, b], axis=-1).reshape(-1, 3), np.stack([b, c, d], axis=-1).reshape(-1, 3)])
    around = np.arange(2 * rings)
    top = np.stack([np.full(2 * rings, len(vertices) - 2), around, np.roll(around, -1)], axis=1)
    last = (rings - 2) * 2 * rings + around
    bottom = np.stack([np.full(2 * rings, len(vertices) - 1), np.roll(last, -1), last], axis=1)
    return vertices, np.concatenate([sides, top, bottom]).astype(np.int64)


def views(count: int = 3) -> list[View]:
    """Cameras on the +z side, looking at the origin along -z (y down in the photo)."""
    matrix = np.array([[400.0, 0, 160], [0, 400, 120], [0, 0, 1]])
    intrinsics = Intrinsics(320, 240, matrix, np.zeros(4))
    rotation = np.diag([1.0, -1.0, -1.0])
    return [
        View(f"view_{k}.jpg", intrinsics, rotation, -rotation @ np.array([10.0 * (k - 1), 0, 400.0]))
        for k in range(count)
    ]


def scene(*others: tuple[np.ndarray, np.ndarray]) -> TrueScene:
    return join_scene(sphere(), others, views())


def test_samples_lie_on_the_surface_evenly() -> None:
    vertices, triangles = sphere()
    points, normals, owners = sample_surface(vertices, triangles, 20000)
    assert closest_distance(points, vertices, triangles).max() < 1e-4  # single precision of the ray caster
    assert np.all(np.sum(points * normals, axis=1) > 0.99 * RADIUS * np.cos(np.pi / 96) ** 2)
    assert owners.max() < len(triangles)
    # a third of a sphere's area lies above z = R / 3; 20000 draws have a deviation of .0033
    assert abs(np.mean(points[:, 2] > RADIUS / 3) - 1 / 3) < 0.015


def test_what_photos_see_is_the_side_towards_them() -> None:
    places = true_places(scene(), 20000)
    towards = places.points[:, 2] / RADIUS
    # at 75 degrees from an axis the ray from 350 mm away leans further, so the limit lies above cos 75
    assert not places.regions["head"][towards < np.cos(np.radians(75))].any()
    assert places.regions["head"][towards > 0.45].all()
    assert places.incidence[places.points[:, 2] > 0.999 * RADIUS].max() < 6.0
    assert np.all(places.incidence[places.photos == 0] == 180.0)


def test_what_stands_before_the_skin_hides_it() -> None:
    screen = np.array([[-60.0, -60, 60], [0, -60, 60], [0, 60, 60], [-60, 60, 60]])
    hidden = scene((screen, np.array([[0, 1, 2], [0, 2, 3]])))
    points = RADIUS * np.array([[-0.5, 0, np.sqrt(0.75)], [0.5, 0, np.sqrt(0.75)]])
    assert count_photos(points, points / RADIUS, scene())[0].tolist() == [3, 3]
    assert count_photos(points, points / RADIUS, hidden)[0].tolist() == [0, 3]
    # a reconstruction of the screen is no error, and nobody is asked for it
    cloud = cloud_error(screen[:1] * 0.5 + screen[2:3] * 0.5, hidden, true_places(hidden, 2000))
    assert cloud["everything"].to_truth.max() < 1e-6
    assert len(cloud["head"].to_truth) == 0


def test_a_sphere_a_percent_too_large_is_wrong_by_that() -> None:
    truth = scene()
    places = true_places(truth, 10000)
    vertices, triangles = sphere(1.01 * RADIUS)
    errors = mesh_error(vertices, triangles, truth, places, 10000)
    # 1 % of the radius is half a percent of D; facets of 96 to a turn add or hide up to 0.05 % of the radius
    for values in (errors["head"].to_truth, errors["head"].to_reconstruction, errors["everything"].to_truth):
        np.testing.assert_allclose(values, 0.005, atol=0.0004)
    assert len(errors["head"].index) == np.count_nonzero(places.regions["head"])
    assert errors["everything"].share == 1.0
    assert 0.2 < errors["head"].share < 0.5


def test_what_is_missing_shows_from_the_truth_only() -> None:
    truth = scene()
    places = true_places(truth, 10000)
    vertices, triangles = sphere()
    half = triangles[np.all(vertices[triangles][:, :, 0] > 0, axis=1)]
    errors = mesh_error(vertices, half, truth, places, 5000)["head"]
    assert errors.to_truth.max() < 1e-6
    assert 0.4 < np.mean(errors.to_reconstruction > 1e-6) < 0.6


def test_the_face_proper_ends_at_the_ears() -> None:
    vertices = np.array([[0, 0, 9.0], [0, 0, 5.0], [0, 0, -2.0], [7, 0, 1.0], [8, 0, -1.0]])
    regions = {name: np.array([0, 1, 2]) for name in ("lips", "chin", "cheeks", "forehead", "eyes", "nose")}
    assert face_proper(vertices, {**regions, "ears": np.array([3, 4])}).tolist() == [0, 1]
    with pytest.raises(InputError, match="no region ears"):
        face_proper(vertices, regions)


def test_shares_of_normal_errors() -> None:
    generator = np.random.default_rng(0)
    deviation = generator.uniform(0.1, 2.0, 40000)
    one, two = share_within(generator.normal(0, deviation), deviation)
    # deviations of a share of 40000: .0023 and .0010
    assert abs(one - 0.683) < 0.008
    assert abs(two - 0.954) < 0.004


def test_bad_scenes_are_refused() -> None:
    vertices, triangles = sphere()
    with pytest.raises(InputError, match="are skin"):
        TrueScene(vertices, triangles, 0, 1.0, views())
    with pytest.raises(InputError, match="without area"):
        sample_surface(vertices, triangles[:0], 10)
