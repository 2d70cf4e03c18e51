"""Deformation transfer, personal blendshapes and the value of a plan: identities and known truths."""

from __future__ import annotations

import numpy as np
import pytest
from synthetic_rigs import bump_rig, sheet

from capture_eval.errors import InputError
from capture_eval.planning.blendshape_rig import BlendshapeRig
from capture_eval.planning.deformation_transfer import (
    TransferSolver,
    deformation_gradients,
    face_gradients,
    transfer_deformation,
)
from capture_eval.planning.packing_rules import PackingRules
from capture_eval.planning.personalised_blendshapes import fit_gradients, personalise
from capture_eval.planning.plan_value import generic_errors, measure_plan, plan_by_weights
from capture_eval.planning.planner import PlanOptions, plan_captures, prepare_rig


def _rotation() -> np.ndarray:
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_rotvec([0.3, -0.5, 0.2]).as_matrix())


def test_gradients_of_linear_functions_are_exact() -> None:
    vertices, triangles = sheet(9, 11)
    gradients = face_gradients(vertices, triangles)
    matrix = np.array([[1.0, 0.2, 0.0], [0.1, 0.7, -0.3], [0.0, 0.4, 1.3]])
    assert gradients.of(vertices @ matrix.T + 5.0) == pytest.approx(matrix @ gradients.axes, abs=1e-12)
    # A rotation of the mesh is its own deformation gradient, normal included.
    turned = deformation_gradients(gradients, vertices @ _rotation().T)
    assert turned == pytest.approx(np.broadcast_to(_rotation(), turned.shape), abs=1e-12)
    # Scale s: in the plane s; along the normal the fourth vertex goes with the root of the area, which is s as well.
    assert deformation_gradients(gradients, 3.0 * vertices) == pytest.approx(
        np.broadcast_to(3.0 * np.eye(3), turned.shape), abs=1e-12
    )


def test_transfer_to_the_same_neutral_gives_the_shapes_back() -> None:
    rig = bump_rig(15, 19, 3, 2, 0)
    assert transfer_deformation(rig, rig.neutral) == pytest.approx(rig.shapes, abs=1e-9)


def test_transfer_goes_with_a_similarity_of_the_target() -> None:
    rig = bump_rig(15, 19, 3, 2, 0)
    # Uniform scale and shift: the target's shapes are the scaled ones.
    found = transfer_deformation(rig, 2.5 * rig.neutral + 7.0)
    assert found == pytest.approx(2.5 * rig.shapes + 7.0, abs=1e-5)  # the weak pull of 1e-6


def test_transfer_keeps_loose_parts_in_place_and_still_vertices_still() -> None:
    vertices, triangles = sheet(9, 11)
    count = len(vertices)
    two = np.concatenate([vertices, vertices + np.array([5.0, 0.0, 0.0])])
    faces = np.concatenate([triangles, triangles + count])
    lifted = two.copy()
    lifted[count:] += [0.0, 0.3, 0.0]  # the second part moves as a whole
    rig = BlendshapeRig(("lift",), two, lifted[None], faces)
    found = transfer_deformation(rig, 2.0 * two)[0]
    assert found[:count] == pytest.approx(2.0 * two[:count], abs=1e-9)
    assert found[count:] == pytest.approx(2.0 * lifted[count:], abs=1e-9)


def test_triangles_without_area_do_no_harm() -> None:
    rig = bump_rig(11, 13, 2, 1, 0)
    flat = np.concatenate([rig.triangles, [[0, 0, 1], [3, 4, 4]]])
    again = BlendshapeRig(rig.names, rig.neutral, rig.shapes, flat)
    assert transfer_deformation(again, rig.neutral) == pytest.approx(rig.shapes, abs=1e-9)
    with pytest.raises(InputError, match="no triangle has an area"):
        face_gradients(rig.neutral, np.array([[0, 0, 1]]))


def test_the_small_system_equals_the_least_squares_problem() -> None:
    random = np.random.default_rng(1)
    generic, wanted = random.normal(size=(4, 5, 3, 2)), random.normal(size=(2, 5, 3, 2))
    weights = np.array([[1.0, 1.0, 0.0, 0.0], [0.0, 1.0, 1.0, 0.0]])
    found = fit_gradients(generic, weights, wanted, 0.1)
    for triangle in range(5):
        size = np.linalg.norm(generic[:, triangle], axis=(1, 2))
        hold = 0.1 * ((1 + size) / (0.01 + size)) ** 2
        left = weights.T @ weights + np.diag(hold)
        right = np.einsum("jk,jab->kab", weights, wanted[:, triangle]) + hold[:, None, None] * generic[:, triangle]
        direct = np.linalg.solve(left, right.reshape(4, 6)).reshape(4, 3, 2)
        assert found[:, triangle] == pytest.approx(direct, abs=1e-10)
    assert found[3] == pytest.approx(generic[3], abs=1e-14)  # in no expression


def _person(rig: BlendshapeRig) -> tuple[np.ndarray, np.ndarray]:
    """Another neutral and the true shapes of that person: copied displacements, some turned and made larger."""
    target = rig.neutral * [1.25, 0.9, 1.1] + 0.03 * np.sin(4.0 * rig.neutral[:, [1, 2, 0]])
    random = np.random.default_rng(5)
    strength = random.uniform(0.6, 1.5, size=rig.shape_count)[:, None, None]
    truth = target + strength * (rig.displacements @ _rotation().T)
    return target, truth


def test_one_photo_for_every_shape_almost_gives_the_truth() -> None:
    rig = bump_rig(21, 27, 4, 3, 2)
    target, truth = _person(rig)
    solver = TransferSolver(rig, target)
    alone = [(shape,) for shape in range(rig.shape_count)]
    value = measure_plan(solver, truth, alone)
    # What is not gone: where the generic shape hardly moves a triangle, half of the change is believed.
    assert value.removed[-1] > 0.6
    tight = personalise(solver, alone, truth, regularisation=1e-9)
    assert tight == pytest.approx(truth, abs=1e-3 * np.abs(truth - target).max())


def test_capture_by_capture_equals_all_at_once() -> None:
    rig = bump_rig(21, 27, 4, 3, 2)
    target, truth = _person(rig)
    solver = TransferSolver(rig, target)
    plan = plan_captures(rig, target=target)
    expressions = [expression.shapes for expression in plan.expressions]
    value = measure_plan(solver, truth, expressions)
    assert value.after[0] == pytest.approx(generic_errors(solver, truth))
    for count in (1, 2, len(expressions)):
        again = measure_plan(solver, truth, expressions[:count])
        assert value.after[count] == pytest.approx(again.after[-1], rel=1e-9)
    # Wide Gaussian bumps overlap below the threshold, so not all of the error can go.
    assert value.remaining[-1] < 0.85 * value.remaining[0]
    with pytest.raises(InputError, match="stands in two expressions"):
        measure_plan(solver, truth, [(0,), (0, 1)])


def test_a_plan_by_other_weights() -> None:
    rig = bump_rig(21, 27, 4, 3, 2)
    options = PlanOptions()
    prepared = prepare_rig(rig, options, None, (), PackingRules(), None)
    expressions = plan_by_weights(rig, prepared, np.ones(rig.shape_count), options)
    assert sorted(shape for shapes in expressions for shape in shapes) == list(range(rig.shape_count))


def test_bad_training_expressions() -> None:
    rig = bump_rig(11, 13, 2, 1, 0)
    solver = TransferSolver(rig, rig.neutral)
    with pytest.raises(InputError, match=r"captured expressions \(1, 3\)"):
        personalise(solver, [(0,)], np.zeros((1, 3)))
    with pytest.raises(InputError, match="there is no shape 9"):
        personalise(solver, [(9,)], rig.shapes[:1])
    with pytest.raises(InputError, match="training expression 1 has no shapes"):
        personalise(solver, [()], rig.shapes[:1])
    with pytest.raises(InputError, match="not finite"):
        personalise(solver, [(0,)], np.full((1, *rig.neutral.shape), np.nan))
    with pytest.raises(InputError, match="regularisation 0"):
        personalise(solver, [(0,)], rig.shapes[:1], regularisation=0.0)
    with pytest.raises(InputError, match="target neutral"):
        TransferSolver(rig, rig.neutral[:4])
    with pytest.raises(InputError, match="true shapes"):
        generic_errors(solver, rig.shapes[:1])
