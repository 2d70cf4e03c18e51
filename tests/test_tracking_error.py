"""Tracking error: nought for a perfect track, the slide when a mesh slides, and never the other lip."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from capture_eval.errors import InputError
from capture_eval.evaluation.tracking_error import (
    closest_on_triangles,
    nearest_on_mesh,
    refine_similarity_by_surface,
    skin_points,
    tracking_error,
)
from capture_eval.similarity import Similarity

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


def _sphere(rings: int = 24, segments: int = 48, radius: float = 100.0) -> tuple[Floats, Integers]:
    """An open band of a sphere, 120 degrees high, as triangles."""
    height, around = np.meshgrid(np.radians(np.linspace(-60, 60, rings)), np.arange(segments), indexing="ij")
    angle = 2 * np.pi * around / segments
    vertices = np.stack(
        [np.cos(height) * np.cos(angle), np.sin(height), -np.cos(height) * np.sin(angle)], axis=-1
    ).reshape(-1, 3)
    index = np.arange(rings * segments).reshape(rings, segments)
    a, b = index[:-1], np.roll(index[:-1], -1, axis=1)
    d, c = index[1:], np.roll(index[1:], -1, axis=1)
    triangles = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    return radius * vertices, triangles.astype(np.int64)


def _about_y(degrees: float) -> Floats:
    angle = np.radians(degrees)
    return np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])


@settings(max_examples=12, deadline=None)
@given(turn=st.floats(-60, 60), seed=st.integers(0, 100))
def test_points_that_stay_on_their_skin_have_no_error(turn: float, seed: int) -> None:
    vertices, triangles = _sphere()
    random = np.random.default_rng(seed)
    chosen = random.integers(0, len(triangles), 200)
    weights = random.dirichlet([1, 1, 1], 200)
    registered = np.einsum("nk,nki->ni", weights, vertices[triangles[chosen]])
    moved, posed = registered @ _about_y(turn).T, vertices @ _about_y(turn).T
    faces = np.array([[0, 1, 2]])
    found = skin_points(registered, faces, vertices, triangles, triangles[chosen, 0])
    error = tracking_error(moved, registered, found, posed, vertices, triangles)
    # closest points in float64 on triangles of 13 units
    assert error.total.max() < 1e-9
    assert error.relative.max() < 1e-9


@pytest.mark.parametrize("slide", [0.5, 2.0])
def test_a_mesh_that_slides_by_delta_has_that_tangential_error(slide: float) -> None:
    vertices, triangles = _sphere(48, 96)
    degrees = np.degrees(slide / 100.0)
    band = np.abs(vertices[:, 1]) < 10
    moved = vertices @ _about_y(degrees).T
    found = skin_points(vertices, triangles, vertices, triangles, np.arange(len(vertices)))
    error = tracking_error(moved, vertices, found, vertices, vertices, triangles)
    distance = 2 * np.hypot(vertices[:, 0], vertices[:, 2]) * np.sin(np.radians(degrees) / 2)
    np.testing.assert_allclose(error.total, distance, atol=1e-9)
    # the facets of 6.5 units deviate from the sphere by less than their sagitta, .06
    assert np.abs(error.tangential[band] - slide).max() < 0.07
    assert error.surface[band].max() < 0.07


def test_an_offset_along_the_normal_is_normal_and_not_relative() -> None:
    vertices, triangles = _sphere(48, 96)
    shell = 1.01 * vertices
    pose = vertices @ _about_y(20.0).T
    found = skin_points(shell, triangles, vertices, triangles, np.arange(len(vertices)))
    error = tracking_error(shell @ _about_y(20.0).T, shell, found, pose, vertices, triangles)
    inside = np.abs(vertices[:, 1]) < 80
    np.testing.assert_allclose(error.normal[inside], 1.0, atol=0.05)
    assert error.tangential[inside].max() < 0.05
    # it was there in the neutral too: interpolation errors do not see it
    assert error.relative[inside].max() < 1e-9


def test_the_other_lip_is_not_taken() -> None:
    upper, triangles = _sphere(12, 24, 10.0)
    lower = upper + np.array([0.0, 17.4, 0.0])
    both = np.concatenate([upper, lower])
    faces = np.concatenate([triangles, triangles + len(upper)])
    top = np.argmax(upper[:, 1])
    place = upper[top] + np.array([0.0, 0.05, 0.0])
    plain, _ = nearest_on_mesh(place[None], both, faces)
    near, _ = nearest_on_mesh(place[None], both, faces, np.array([[0.0, 1.0, 0.0]]))
    assert plain.triangle[0] >= 0
    assert near.triangle[0] < len(triangles)
    anchored = skin_points(place[None], np.array([[0, 0, 0]]), both, faces, np.array([top]))
    assert anchored.triangle[0] < len(triangles)


def test_closest_points_of_one_triangle_at_hand_values() -> None:
    triangle = np.array([[0.0, 0, 0], [4, 0, 0], [0, 4, 0]])
    points = np.array([[1.0, 1, 3], [-2, -2, 0], [2, -5, 0], [4, 4, 0]])
    weights, distance = closest_on_triangles(points, np.repeat(triangle[None], 4, axis=0))
    np.testing.assert_allclose(distance, [3.0, np.sqrt(8), 5.0, np.sqrt(8)])
    np.testing.assert_allclose(weights, [[0.5, 0.25, 0.25], [1, 0, 0], [0.5, 0.5, 0], [0, 0.5, 0.5]], atol=1e-12)


def test_the_neutral_is_brought_to_the_truth_by_its_surface() -> None:
    vertices, triangles = _sphere(48, 96)
    vertices = vertices * [1.0, 1.3, 0.8]
    true = Similarity(2.0, _about_y(30.0), np.array([5.0, -3.0, 8.0]))
    scan = true.inverse().apply(vertices)
    start = Similarity(2.02, _about_y(31.0), np.array([6.0, -3.0, 8.0]))
    fit = refine_similarity_by_surface(
        scan, triangles, vertices, triangles, np.ones(len(scan), dtype=bool), start, steps=25
    )
    assert np.linalg.norm(fit.apply(scan) - vertices, axis=1).max() < 0.05


def test_bad_input_is_named() -> None:
    vertices, triangles = _sphere()
    with pytest.raises(InputError, match="anchors"):
        skin_points(vertices, triangles, vertices, triangles, np.zeros(3, dtype=np.int64))
    with pytest.raises(InputError, match="seen vertices"):
        refine_similarity_by_surface(
            vertices, triangles, vertices, triangles, np.zeros(len(vertices), dtype=bool), Similarity.identity()
        )
