"""The deformation solver: rigid motion costs nothing, a hinge is followed, constraints do what they say."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from capture_eval.errors import InputError
from capture_eval.registration.deformation_solver import (
    DeformationSolver,
    SurfaceConstraints,
    cauchy_weights,
    tukey_weights,
)
from capture_eval.registration.mesh_operators import (
    build_mesh_operators,
    local_rotations,
    nearest_rotations,
    ring_neighbourhood,
)

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


def _sheet(columns: int = 13, rows: int = 9, bend: float = 0.0) -> tuple[Floats, Integers]:
    """A grid of unit squares, optionally bent to a part of a cylinder, cut into triangles."""
    x, y = np.meshgrid(np.arange(columns, dtype=float), np.arange(rows, dtype=float))
    height = np.zeros_like(x) if bend == 0 else np.sqrt(np.maximum(bend**2 - (x - columns / 2) ** 2, 0))
    vertices = np.stack([x.ravel(), y.ravel(), height.ravel()], axis=1)
    index = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = index[:-1, :-1].ravel(), index[:-1, 1:].ravel(), index[1:, 1:].ravel(), index[1:, :-1].ravel()
    return vertices, np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]).astype(np.int64)


def _turn(axis: int, degrees: float) -> Floats:
    angle = np.radians(degrees)
    i, j = [k for k in range(3) if k != axis]
    rotation = np.eye(3)
    rotation[i, i] = rotation[j, j] = np.cos(angle)
    rotation[i, j], rotation[j, i] = -np.sin(angle), np.sin(angle)
    return rotation


@settings(max_examples=10, deadline=None)
@given(x=st.floats(-170, 170), y=st.floats(-80, 80), shift=st.floats(-50, 50))
def test_a_rigidly_moved_mesh_is_already_the_solution(x: float, y: float, shift: float) -> None:
    vertices, triangles = _sheet(bend=10.0)
    solver = DeformationSolver(build_mesh_operators(vertices, triangles))
    moved = vertices @ (_turn(0, x) @ _turn(1, y)).T + shift
    # no constraint but the anchor of 1e-9 holds the position: rounding over the anchor is the tolerance
    np.testing.assert_allclose(solver.solve(moved, 3.0, 0.05, []), moved, atol=1e-4)


def test_three_pinned_corners_carry_the_whole_sheet() -> None:
    vertices, triangles = _sheet(bend=10.0)
    solver = DeformationSolver(build_mesh_operators(vertices, triangles))
    rotation = _turn(2, 40.0)
    target = vertices @ rotation.T + [3.0, -2.0, 1.0]
    pins = np.array([0, 12, len(vertices) - 1, len(vertices) - 13, 58])
    constraint = SurfaceConstraints.at_vertices(pins, target[pins], np.full(len(pins), 10.0))
    positions = vertices
    for _ in range(100):
        positions = solver.solve(positions, 1.0, 1.0, [constraint])
    # the rigid motion has energy zero; the alternation of rotations and positions converges to it linearly
    np.testing.assert_allclose(positions, target, atol=1e-3)


def test_a_hinge_is_followed_and_both_leaves_stay_flat() -> None:
    vertices, triangles = _sheet(21, 5)
    solver = DeformationSolver(build_mesh_operators(vertices, triangles))
    leaf = vertices[:, 0] >= 14
    pivot = np.array([10.0, 0.0, 0.0])
    target = (vertices - pivot) @ _turn(1, -30.0).T + pivot
    fixed = np.flatnonzero(vertices[:, 0] <= 6)
    moved = np.flatnonzero(leaf)
    constraints = [
        SurfaceConstraints.at_vertices(fixed, vertices[fixed], np.full(len(fixed), 5.0)),
        SurfaceConstraints.at_vertices(moved, target[moved], np.full(len(moved), 5.0)),
    ]
    positions = vertices
    for _ in range(15):
        positions = solver.solve(positions, 1.0, 0.1, constraints)
    assert np.abs(positions[fixed] - vertices[fixed]).max() < 0.05
    assert np.abs(positions[moved] - target[moved]).max() < 0.05
    tail, head = solver.operators.edges.T
    lengths = np.linalg.norm(positions[head] - positions[tail], axis=1)
    rest = np.linalg.norm(vertices[head] - vertices[tail], axis=1)
    # the bend is spread over eight squares: no edge has to stretch by more than some per cent
    assert np.abs(lengths / rest - 1).max() < 0.08


def test_planes_leave_sliding_free_and_tangential_pulls_leave_height_free() -> None:
    vertices, triangles = _sheet()
    solver = DeformationSolver(build_mesh_operators(vertices, triangles))
    normal = np.tile([0.0, 0.0, 1.0], (len(triangles), 1))
    centre = np.full((len(triangles), 3), 1 / 3)
    places = vertices[triangles].mean(axis=1)
    ones = np.ones(len(triangles))
    lifted = SurfaceConstraints(triangles, centre, places + np.array([5.0, 0.0, 2.0]), normal, ones)
    result = solver.solve(vertices, 1.0, 0.1, [lifted], anchor=1e-6)
    np.testing.assert_allclose(result - vertices, np.tile([0, 0, 2.0], (len(vertices), 1)), atol=1e-4)
    slid = SurfaceConstraints(triangles, centre, places + np.array([0.7, 0.3, 9.0]), normal, ones, tangential=True)
    result = solver.solve(vertices, 1.0, 0.1, [slid], anchor=1e-6)
    np.testing.assert_allclose(result - vertices, np.tile([0.7, 0.3, 0], (len(vertices), 1)), atol=1e-4)
    np.testing.assert_allclose(slid.residuals(vertices), np.hypot(0.7, 0.3), atol=1e-12)
    np.testing.assert_allclose(lifted.residuals(vertices), 2.0, atol=1e-12)


def test_soft_vertices_do_not_tie_two_leaves_together() -> None:
    vertices, triangles = _sheet(21, 5)
    middle = (vertices[:, 0] > 7) & (vertices[:, 0] < 13)
    ends = np.array([0, 20])
    target = vertices[ends] + [[0, 0, 0], [0, 0, 6.0]]
    pins = SurfaceConstraints.at_vertices(ends, target, np.full(2, 0.01))
    stretches = []
    for stiffness in (1.0, 0.01):
        solver = DeformationSolver(build_mesh_operators(vertices, triangles), np.where(middle, stiffness, 1.0))
        result = solver.solve(vertices, 1.0, 0.5, [pins], anchor=1e-6)
        stretches.append(np.linalg.norm(result[ends] - target, axis=1).sum())
    assert stretches[1] < stretches[0]


def test_rotations_and_rings() -> None:
    vertices, triangles = _sheet(bend=10.0)
    operators = build_mesh_operators(vertices, triangles)
    rotation = _turn(0, 35.0) @ _turn(2, -70.0)
    found = local_rotations(operators, vertices @ rotation.T + 4.0)
    np.testing.assert_allclose(found, np.broadcast_to(rotation, found.shape), atol=1e-9)
    np.testing.assert_array_equal(nearest_rotations(np.zeros((1, 3, 3)))[0], np.eye(3))
    mirrored = nearest_rotations(np.diag([1.0, 1.0, -0.5])[None])[0]
    assert np.linalg.det(mirrored) == pytest.approx(1.0)
    rings = ring_neighbourhood(operators, 2)
    corner = np.flatnonzero(rings[0].toarray().ravel())
    assert set(corner) == {0, 1, 2, 13, 14, 15, 26, 27, 28}
    # linear functions are harmonic in the interior of an even grid
    flat = build_mesh_operators(*_sheet())
    inside = (flat.vertices[:, 0] % 12 > 0) & (flat.vertices[:, 1] % 8 > 0)
    np.testing.assert_allclose((flat.laplacian @ flat.vertices)[inside], 0.0, atol=1e-12)


def test_weights_at_hand_values() -> None:
    np.testing.assert_allclose(cauchy_weights(np.array([0.0, 2.0]), 2.0), [1.0, 0.5])
    np.testing.assert_allclose(tukey_weights(np.array([0.0, 1.0, 2.0, 3.0]), 2.0), [1.0, 0.5625, 0.0, 0.0])


def test_bad_input_is_named() -> None:
    vertices, triangles = _sheet()
    with pytest.raises(InputError, match="not finite"):
        build_mesh_operators(np.full_like(vertices, np.nan), triangles)
    with pytest.raises(InputError, match="outside"):
        build_mesh_operators(vertices[:5], triangles)
    operators = build_mesh_operators(vertices, triangles)
    with pytest.raises(InputError, match="stiffness"):
        DeformationSolver(operators, np.zeros(len(vertices)))
    with pytest.raises(InputError, match="weight"):
        SurfaceConstraints.at_vertices(np.array([0, 1]), vertices[:2], np.ones(3))


def test_constraints_that_are_not_numbers_are_refused() -> None:
    corners, weight = np.array([[0, 1, 2]]), np.array([1.0])
    barycentric = np.full((1, 3), 1 / 3)
    with pytest.raises(InputError, match="1 numbers of weight are not finite"):
        SurfaceConstraints(corners, barycentric, np.zeros((1, 3)), None, np.array([np.nan]))
    with pytest.raises(InputError, match="3 numbers of target are not finite"):
        SurfaceConstraints(corners, barycentric, np.full((1, 3), np.inf), None, weight)
