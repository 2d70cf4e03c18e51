"""Coherency of vertices with control points, influence maps and soft regions (Eqs 7, 8 and 10 of paper 001).

Only the columns of the control points in use are computed: O(N·L·M) instead of the printed O(N²·M).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capture_eval.errors import InputError
from capture_eval.triangle_geometry import diameter

Floats = NDArray[np.float64]

STILL = 1e-9  # share of D below which a displacement is rounding, not motion


@dataclass(frozen=True)
class ExampleMotion:
    """Examples laid out for editing: computed once, used by every edit.

    Attributes
    ----------
    neutral : (N, 3) float64
        V[0].
    displacements : (N, 3, K) float64
        ``V[m] − V[0]`` of the K = M − 1 expressions, those of one vertex next to each other.
    diameter : float
        D, the largest distance between two vertices of the neutral.
    """

    neutral: Floats
    displacements: Floats
    diameter: float

    @property
    def expressions(self) -> int:
        """K, the number of examples without the neutral."""
        return int(self.displacements.shape[2])

    def positions(self, vertices: Sequence[int] | NDArray[np.integer]) -> Floats:
        """Where all M examples have some vertices, (L, M, 3), the neutral first."""
        rows = np.asarray(vertices, dtype=np.int64)
        rest = self.neutral[rows][:, None]
        moved = rest + np.swapaxes(self.displacements[rows], 1, 2)
        return np.concatenate([rest, moved], axis=1)


def example_motion(examples: Floats) -> ExampleMotion:
    """Lay out examples (M, N, 3), the neutral first.

    Raises
    ------
    InputError
        No or one example, wrong shape, or numbers that are not finite.
    """
    meshes = np.asarray(examples, dtype=np.float64)
    if meshes.ndim != 3 or meshes.shape[2] != 3:
        raise InputError(f"editing: examples {meshes.shape}, expected (meshes, vertices, 3)")
    if len(meshes) < 2:
        count = "no example" if len(meshes) == 0 else "one example"
        raise InputError(f"editing: {count}; give the neutral face and at least one expression")
    if not np.all(np.isfinite(meshes)):
        row, vertex = np.argwhere(~np.all(np.isfinite(meshes), axis=2))[0]
        raise InputError(f"editing: vertex {vertex} of example {row} is not finite")
    displacements = np.ascontiguousarray((meshes[1:] - meshes[0]).transpose(1, 2, 0))
    return ExampleMotion(np.ascontiguousarray(meshes[0]), displacements, diameter(meshes[0]))


def coherency_columns(motion: ExampleMotion, controls: Sequence[int], still: float = STILL) -> Floats:
    """Coherency b of all vertices with some control points (Eqs 7 and 8), (N, L) in [0, 1].

    Parameters
    ----------
    motion : ExampleMotion
    controls : sequence of L vertices
    still : float
        Displacements up to this share of D count as zero, for which Eq 7 sets r = s = 1. Not exactly zero, because
        rounding makes nothing out of no motion; larger for examples with measurement noise.
    """
    from capture_eval.editing.coherency_kernels import mean_consistency

    rows = np.asarray(controls, dtype=np.int64)
    columns = np.ascontiguousarray(motion.displacements[rows])
    consistency = mean_consistency(motion.displacements, columns, still * motion.diameter)
    proximity = 1.0 - np.linalg.norm(motion.neutral[:, None] - motion.neutral[rows][None], axis=2) / motion.diameter
    return np.asarray(np.clip(proximity * consistency, 0.0, 1.0), dtype=np.float64)


def influence_maps(coherency: Floats, sharpness: float = 1.0) -> Floats:
    """Shares B of the control points in every vertex's motion (Eq 10), (N, L); rows sum to one.

    A vertex that is coherent with none has zeros: it keeps its neutral position.

    Parameters
    ----------
    coherency : (N, L)
    sharpness : float
        Power of the coherency; 1 is Eq 10.
    """
    coherency = coherency**sharpness
    total = coherency.sum(axis=1, keepdims=True)
    return np.asarray(np.where(total > 0, coherency / np.where(total > 0, total, 1.0), 0.0), dtype=np.float64)


def soft_regions(influence: Floats, share: float = 0.5) -> NDArray[np.bool_]:
    """Which vertices belong to the region of which control point, (N, L); regions overlap.

    A vertex belongs to every control point whose influence is at least ``share`` of the largest one on that vertex. The
    paper does not say where a soft region ends; this choice gives each vertex with any influence at least one region.
    """
    largest = influence.max(axis=1, keepdims=True, initial=0.0)
    return np.asarray((influence >= share * largest) & (largest > 0), dtype=np.bool_)


def blend(motion: ExampleMotion, influence: Floats, weights: Floats) -> Floats:
    """Motion (N, 3) of every vertex: the examples' displacements with the weights ``Σ_l B[i, l] W_l`` (Eq 10).

    Parameters
    ----------
    motion : ExampleMotion
    influence : (N, L)
    weights : (L, K)
        Of the expressions, without the neutral.
    """
    from capture_eval.editing.coherency_kernels import blend_displacements

    shares, rows = np.ascontiguousarray(influence), np.ascontiguousarray(weights)
    return np.asarray(blend_displacements(motion.displacements, shares, rows), dtype=np.float64)
