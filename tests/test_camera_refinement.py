"""Cameras bent by a wrong focal length and small turns come back from the texture of the surface they photographed."""

from dataclasses import replace

import numpy as np
import pytest
import textured_sphere

from capture_eval.cameras import View, pixel_rays, project
from capture_eval.errors import InputError
from capture_eval.registration.camera_refinement import RefinementOptions, refine_cameras
from capture_eval.registration.texture_atlas import rasterise_atlas
from capture_eval.registration.texture_observations import (
    ObservationOptions,
    PhotoObservations,
    TextureObservations,
    observe_texture,
)
from capture_eval.similarity import Similarity, estimate_similarity, transform_view

NO_OBSERVATION = PhotoObservations(np.zeros(0, dtype=np.int64), np.zeros((0, 2)), np.zeros(0))


def _bent(views: list[View], focal: float = 1.015, bend: float = -0.05, seed: int = 5) -> list[View]:
    """Views with a wrong focal length, set back by as much, a wrong bend, and turned by a third of a pixel."""
    generator = np.random.default_rng(seed)
    result = []
    for view in views:
        matrix = view.intrinsics.matrix.copy()
        matrix[[0, 1], [0, 1]] *= focal
        turn = np.eye(3) + np.cross(np.eye(3), generator.normal(0.0, 6e-4, 3))
        left, _, right = np.linalg.svd(turn)
        distortion = view.intrinsics.distortion + np.array([bend, 0.0, 0.0, 0.0])
        result.append(
            replace(
                view,
                intrinsics=replace(view.intrinsics, matrix=matrix, distortion=distortion),
                rotation=left @ right @ view.rotation,
                translation=left @ right @ view.translation * focal,
            )
        )
    return result


def _space_error(views: tuple[View, ...], truth: list[View], points: np.ndarray) -> float:
    """Root mean square distance of points triangulated from their true pixels, after a similarity."""
    normal = np.zeros((len(points), 3, 3))
    side = np.zeros((len(points), 3))
    for view, true in zip(views, truth, strict=True):
        pixels, _ = project(true, points)
        origin, direction = pixel_rays(view, pixels)
        across = np.eye(3) - direction[:, :, None] * direction[:, None, :]
        normal += across
        side += across @ origin
    found = np.linalg.solve(normal, side[:, :, None])[:, :, 0]
    link = estimate_similarity(found, points)
    return float(np.sqrt(np.mean(np.sum((link.apply(found) - points) ** 2, axis=1))))


def _exact_observations(views: list[View], points: np.ndarray, noise: float = 0.0) -> TextureObservations:
    generator = np.random.default_rng(3)
    photos = []
    for view in views:
        pixels, _ = project(view, points)
        pixels += generator.normal(0.0, noise, pixels.shape) if noise else 0.0
        photos.append(PhotoObservations(np.arange(len(points)), pixels, np.ones(len(points))))
    return TextureObservations(points, tuple(photos))


@pytest.fixture(scope="module")
def points() -> np.ndarray:
    vertices = textured_sphere.mesh(columns=30, rows=20)[0]
    return np.asarray(vertices[vertices[:, 2] > 25.0])


def test_exact_observations_give_the_cameras_back(points: np.ndarray) -> None:
    truth = textured_sphere.views()
    bent = _bent(truth)
    observed = _exact_observations(truth, points)
    result = refine_cameras(bent, observed, RefinementOptions(steps=8, minimum_observations=500))
    assert result.accepted
    assert result.residual_before > 0.3
    # Gauss-Newton: each step squares the smallness of the residual until the ridge and rounding.
    assert result.residual_after < 1e-4
    assert _space_error(tuple(bent), truth, points) > 0.01
    assert _space_error(result.views, truth, points) < 1e-4
    assert result.views[0].intrinsics.matrix[0, 0] == pytest.approx(600.0, rel=1e-4)


def test_the_frame_stays_that_of_the_points(points: np.ndarray) -> None:
    truth = textured_sphere.views()
    result = refine_cameras(
        _bent(truth), _exact_observations(truth, points), RefinementOptions(steps=8, minimum_observations=500)
    )
    for view, true in zip(result.views, truth, strict=True):
        np.testing.assert_allclose(project(view, points)[0], project(true, points)[0], atol=1e-3)


def test_errors_of_the_mesh_do_not_bend_the_cameras(points: np.ndarray) -> None:
    truth = textured_sphere.views()
    exact = _exact_observations(truth, points)
    bumps = 0.4 * np.sin(points[:, :1] / 4.0) * points / np.linalg.norm(points, axis=1, keepdims=True)
    bumpy = TextureObservations(points + bumps, exact.photos)
    free = RefinementOptions(steps=8, minimum_observations=500, mesh_error=1.0)
    assert _space_error(refine_cameras(_bent(truth), bumpy, free).views, truth, points) < 1e-3
    tied = RefinementOptions(steps=8, minimum_observations=500)
    # The bumps are 0.4 units high; the tie lets through less than a fiftieth.
    assert _space_error(refine_cameras(_bent(truth), bumpy, tied).views, truth, points) < 0.008


def test_a_ball_photographed_and_seen_through_turned_cameras() -> None:
    # Only the turns are wrong: a ball in a narrow field hardly tells focal length from distance.
    truth = textured_sphere.views(turns=(-45.0, -15.0, 15.0, 45.0), nods=(-20.0, 15.0))
    photos = [textured_sphere.photograph(view) for view in truth]
    vertices, triangles, corner_uv = textured_sphere.mesh()
    atlas = rasterise_atlas(corner_uv, 192)
    options = ObservationOptions(step=3, minimum_cosine=0.5)
    still = refine_cameras(truth, observe_texture(vertices, triangles, atlas, truth, photos, options=options))
    assert still.accepted
    assert still.observations > 3000
    points = vertices[::7]
    # True cameras of the true surface stay where they are: a hundredth of a pixel is 0.005 units.
    assert _space_error(still.views, truth, points) < 0.005
    turned = _bent(truth, focal=1.0, bend=0.0)
    result = refine_cameras(turned, observe_texture(vertices, triangles, atlas, turned, photos, options=options))
    assert result.accepted
    assert result.residual_after < 0.3 * result.residual_before


def test_too_few_observations_leave_the_cameras_alone() -> None:
    views = textured_sphere.views()
    empty = TextureObservations(np.zeros((0, 3)), (NO_OBSERVATION,) * 6)
    result = refine_cameras(views, empty)
    assert not result.accepted
    assert all(new is old for new, old in zip(result.views, views, strict=True))
    with pytest.raises(InputError, match="6 views but observations of 5"):
        refine_cameras(views, TextureObservations(np.zeros((0, 3)), (NO_OBSERVATION,) * 5))


def test_observations_of_nonsense_are_not_accepted(points: np.ndarray) -> None:
    views = textured_sphere.views()
    generator = np.random.default_rng(8)
    photos = tuple(
        PhotoObservations(np.arange(len(points)), generator.uniform(0, 240, (len(points), 2)), np.ones(len(points)))
        for _ in views
    )
    result = refine_cameras(views, TextureObservations(points, photos), RefinementOptions(minimum_observations=500))
    if result.accepted:  # whatever it did must at least not have torn the cameras apart
        assert abs(result.focal_change) < 0.1
    else:
        assert result.views == tuple(views)


def test_a_similar_frame_gives_the_similar_result(points: np.ndarray) -> None:
    truth = textured_sphere.views()
    link = Similarity(2.0, np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), np.array([3.0, 4.0, 5.0]))
    options = RefinementOptions(steps=6, minimum_observations=500)
    here = refine_cameras(_bent(truth), _exact_observations(truth, points), options)
    moved = [transform_view(view, link) for view in _bent(truth)]
    exact = _exact_observations(truth, points)
    there = refine_cameras(moved, TextureObservations(link.apply(points), exact.photos), options)
    for first, second in zip(here.views, there.views, strict=True):
        np.testing.assert_allclose(link.apply(first.center[None])[0], second.center, atol=1e-3)
