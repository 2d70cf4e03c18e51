"""Fit of principal components, the other method that paper 001 compares with."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capture_eval.editing.blend_weights import Balance, minimise_multipliers
from capture_eval.editing.coherency import ExampleMotion
from capture_eval.editing.control_targets import ControlPoint
from capture_eval.editing.example_blending import WholeFaceEdit
from capture_eval.editing.expression_editor import EditOptions, check_controls, scaled_targets
from capture_eval.editing.projection import Projection
from capture_eval.errors import InputError

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class PrincipalComponents:
    """Directions in which examples move away from the neutral.

    Attributes
    ----------
    components : (C, N, 3) float64
        Of unit length over all numbers, largest first.
    deviations : (C,) float64
        Root mean square coefficient of the examples along each, unit of the model.
    """

    components: Floats
    deviations: Floats


def principal_components(motion: ExampleMotion, share: float = 0.999) -> PrincipalComponents:
    """The fewest components that hold a share of the examples' squared displacement from the neutral.

    Taken about the neutral face, not the mean one, so that a face without drags stays neutral.

    Raises
    ------
    InputError
        The share is not in (0, 1], or nothing moves.
    """
    if not 0.0 < share <= 1.0:
        raise InputError(f"principal components: share {share} must be above 0 and at most 1")
    flat = motion.displacements.reshape(-1, motion.expressions)
    values, axes = np.linalg.eigh(flat.T @ flat)
    values, axes = np.maximum(values[::-1], 0.0), axes[:, ::-1]
    if values[0] <= 0.0:
        raise InputError("principal components: no example moves")
    count = int(np.searchsorted(np.cumsum(values) / values.sum(), min(share, 1.0 - 1e-12))) + 1
    components = (flat @ axes[:, :count] / np.sqrt(values[:count])).T.reshape(count, -1, 3)
    return PrincipalComponents(components, np.sqrt(values[:count] / motion.expressions))


def fit_components(
    motion: ExampleMotion,
    model: PrincipalComponents,
    controls: Sequence[ControlPoint],
    projection: Projection | None = None,
    likelihood: float = 1e-3,
    options: EditOptions | None = None,
) -> WholeFaceEdit:
    """The likeliest coefficients (normal distribution) that meet the targets.

    Parameters
    ----------
    likelihood : float
        Weight of the squared coefficients, each in standard deviations, against the squared misses; small values meet
        the targets whatever the face looks like, as in the comparison of the paper.

    Raises
    ------
    InputError
        Control points as for the editor.
    """
    options = options or EditOptions()
    check_controls(controls, len(motion.neutral))
    vertices = [control.vertex for control in controls]
    targets = scaled_targets(controls, projection, motion.diameter, options)
    scaled = model.components[:, vertices] * model.deviations[:, None, None]
    flat = scaled.reshape(len(scaled), -1).T
    rest = motion.neutral[vertices][None]
    balance = Balance(options.balance.fit, likelihood)
    multiplier = minimise_multipliers((flat @ flat.T)[None], rest, rest, targets, balance)[0]
    weights = model.deviations * (multiplier @ flat)
    moved = motion.neutral + np.einsum("c,cni->ni", weights, model.components)
    return WholeFaceEdit(moved, weights, targets.distances(moved[vertices]))
