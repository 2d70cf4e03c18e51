"""What a plan is worth: error of the personal rig against the truth after every captured expression."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from capture_eval.errors import InputError
from capture_eval.planning.blendshape_rig import BlendshapeRig
from capture_eval.planning.deformation_transfer import TransferSolver
from capture_eval.planning.importance import Importance
from capture_eval.planning.packing_rules import PackingRules
from capture_eval.planning.personalised_blendshapes import personalise
from capture_eval.planning.planner import PlanOptions, PreparedRig, pack_prepared
from capture_eval.triangle_geometry import diameter

Floats = NDArray[np.float64]
Expressions = Sequence[Sequence[int]]


@dataclass(frozen=True)
class PlanValue:
    """Errors of the shapes, as fractions of D (the largest distance in the target's neutral).

    Attributes
    ----------
    after : (J + 1, K) float64
        Mean distance of a shape's vertices from the truth, after 0, 1, … captured expressions.
    """

    after: Floats

    @property
    def remaining(self) -> Floats:
        """Mean over all shapes after 0, 1, … captures, (J + 1,)."""
        return np.asarray(self.after.mean(axis=1), dtype=np.float64)

    @property
    def removed(self) -> Floats:
        """Share of the generic rig's error that is gone after 0, 1, … captures, (J + 1,)."""
        return np.asarray(1.0 - self.remaining / max(float(self.remaining[0]), 1e-300), dtype=np.float64)


def generic_errors(solver: TransferSolver, truth: Floats) -> Floats:
    """Error of every shape (K,) without any capture, fraction of D.

    Raises
    ------
    InputError
        The truth does not fit the rig.
    """
    generic = np.array([solver.transfer(shape) for shape in range(solver.rig.shape_count)])
    return shape_errors(generic, _checked(solver.rig, truth), solver.target)


def measure_plan(
    solver: TransferSolver, truth: Floats, expressions: Expressions, generic: Floats | None = None
) -> PlanValue:
    """Capture the expressions one by one and measure the personal rig each time.

    No shape stands in two expressions, so a shape's error changes once: when its expression is captured.

    Parameters
    ----------
    solver : TransferSolver
        Of the template and the target's neutral.
    truth : (K, N, 3) float64
        The target's own shapes. They make the captured expressions and are then held out.
    expressions : sequence of sets of shapes
        In the order of capture.
    generic : (K,), optional
        From `generic_errors`, when several plans are measured.

    Raises
    ------
    InputError
        The truth does not fit, or a shape stands in two expressions.
    """
    truth = _checked(solver.rig, truth)
    used = [shape for shapes in expressions for shape in shapes]
    if len(set(used)) < len(used):
        raise InputError("plan value: a shape stands in two expressions")
    moved = truth - solver.target
    captured = np.array([solver.target + moved[list(shapes)].sum(axis=0) for shapes in expressions])
    personal = personalise(solver, expressions, captured.reshape(len(expressions), *solver.target.shape))
    errors = shape_errors(personal, truth, solver.target)
    start = generic_errors(solver, truth) if generic is None else generic
    after = np.tile(start, (len(expressions) + 1, 1))
    for number, shapes in enumerate(expressions):
        after[number + 1 :, list(shapes)] = errors[list(shapes)]
    return PlanValue(after)


def shape_errors(found: Floats, truth: Floats, neutral: Floats) -> Floats:
    """Mean distance over the vertices of each shape (K,), as fraction of D."""
    return np.asarray(np.linalg.norm(found - truth, axis=2).mean(axis=1) / diameter(neutral), dtype=np.float64)


def plan_by_weights(
    rig: BlendshapeRig, prepared: PreparedRig, weights: Floats, options: PlanOptions
) -> tuple[tuple[int, ...], ...]:
    """Expressions of a plan with other importances, for example equal or random ones, to compare with."""
    other = Importance(np.asarray(weights, dtype=np.float64), np.zeros(rig.shape_count), None, 1.0, 0.0)
    plan = pack_prepared(rig, replace(prepared, importance=other), options, PackingRules())
    return tuple(expression.shapes for expression in plan.expressions)


def _checked(rig: BlendshapeRig, truth: Floats) -> Floats:
    truth = np.asarray(truth, dtype=np.float64)
    if truth.shape != rig.shapes.shape:
        raise InputError(f"true shapes {truth.shape} do not fit the rig's {rig.shapes.shape}")
    return truth
