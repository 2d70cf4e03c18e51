"""Influence by distance alone: normalised radial basis functions, Zhang's method in section 5 of paper 001."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from capture_eval.editing.expression_editor import Edit, EditOptions, ExpressionEditor

Floats = NDArray[np.float64]


def radial_functions(neutral: Floats, controls: NDArray[np.int64]) -> Floats:
    """Gaussians (N, L) of the distance to each control point, as wide as the way to the nearest other one.

    A single control point moves the whole face alike.
    """
    places = neutral[controls]
    between = np.linalg.norm(places[:, None] - places[None], axis=2)
    np.fill_diagonal(between, np.inf)
    radius = between.min(axis=1)
    distance = np.linalg.norm(neutral[:, None] - places[None], axis=2)
    squared = (distance / radius) ** 2
    # the nearest point's function is taken as one: the shares are the same, and far away they are no longer 0/0
    return np.asarray(np.exp(-(squared - squared.min(axis=1, keepdims=True))), dtype=np.float64)


class RadialInfluenceEditor(ExpressionEditor):
    """The editor with influence maps by distance alone; weights are solved in the same way."""

    def __init__(self, examples: Floats, options: EditOptions | None = None) -> None:
        super().__init__(examples, replace(options or EditOptions(), sharpness=1.0))

    def _known_columns(self, vertices: NDArray[np.int64], previous: Edit | None) -> dict[int, Floats]:
        del previous  # radii change with the set of control points
        columns = radial_functions(self.motion.neutral, vertices)
        return {int(vertex): columns[:, column] for column, vertex in enumerate(vertices)}
