"""Whole-face example blending, the method that paper 001 starts from: one set of weights for all vertices."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capture_eval.editing.blend_weights import invariant_system, minimise_multipliers, proximity_penalties
from capture_eval.editing.coherency import ExampleMotion
from capture_eval.editing.control_targets import ControlPoint
from capture_eval.editing.expression_editor import EditOptions, check_controls, scaled_targets
from capture_eval.editing.projection import Projection

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class WholeFaceEdit:
    """A face from one set of coefficients: vertices (N, 3), weights (K,), misses (L,) in pixels or model units."""

    vertices: Floats
    weights: Floats
    misses: Floats


def blend_whole_face(
    motion: ExampleMotion,
    controls: Sequence[ControlPoint],
    projection: Projection | None = None,
    options: EditOptions | None = None,
) -> WholeFaceEdit:
    """Displacements of the examples with the same weights everywhere.

    The energy is Eq 6 summed over the control points; the proximity of an example is the mean over them.

    Raises
    ------
    InputError
        Control points as for the editor.
    """
    options = options or EditOptions()
    check_controls(controls, len(motion.neutral))
    system = invariant_system(motion.positions([control.vertex for control in controls]))
    targets = scaled_targets(controls, projection, motion.diameter, options)
    penalties = proximity_penalties(system, targets).mean(axis=0)
    flat = np.swapaxes(system.basis, 1, 2).reshape(-1, motion.expressions)
    weighted = flat / penalties
    gram = weighted @ flat.T
    multiplier = minimise_multipliers(gram[None], system.origin[None], system.rest[None], targets, options.balance)[0]
    weights = multiplier @ weighted
    vertices = motion.neutral + motion.displacements @ weights
    return WholeFaceEdit(vertices, weights, targets.distances(vertices[[control.vertex for control in controls]]))
