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
_LANES = 8  # float64 numbers in the widest registers
_CHUNK = 2048  # vertices laid out at once


@dataclass(frozen=True)
class ExampleMotion:
    """Examples laid out for editing: computed once, used by every edit.

    Attributes
    ----------
    neutral : (N, 3) float64
        V[0].
    padded : (N, 3, P) float64
        Displacements, followed by zeros up to a multiple of what a processor adds at once.
    expressions : int
        K = M − 1, the number of examples without the neutral.
    diameter : float
        D, the largest distance between two vertices of the neutral.
    """

    neutral: Floats
    padded: Floats
    expressions: int
    diameter: float

    @property
    def displacements(self) -> Floats:
        """``V[m] − V[0]`` of the K expressions, those of one vertex next to each other, (N, 3, K)."""
        return self.padded[:, :, : self.expressions]

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
    for row, mesh in enumerate(meshes):
        if not np.all(np.isfinite(mesh)):
            vertex = np.flatnonzero(~np.all(np.isfinite(mesh), axis=1))[0]
            raise InputError(f"editing: vertex {vertex} of example {row} is not finite")
    neutral, expressions = np.ascontiguousarray(meshes[0]), len(meshes) - 1
    padded = np.zeros((len(neutral), 3, -(-expressions // _LANES) * _LANES))
    for start in range(0, len(neutral), _CHUNK):  # piece by piece: the whole difference would be as large as its copy
        piece = slice(start, start + _CHUNK)
        padded[piece, :, :expressions] = (meshes[1:, piece] - neutral[piece]).transpose(1, 2, 0)
    return ExampleMotion(neutral, padded, expressions, diameter(neutral))


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
    rows = np.asarray(controls, dtype=np.int64)
    coherency = np.empty((len(motion.neutral), len(rows)))
    _one_pass(motion, rows, np.arange(len(rows)), coherency, 1.0, np.empty_like(coherency), None, still)
    return coherency


def coherency_of(
    motion: ExampleMotion, vertices: NDArray[np.int64], controls: NDArray[np.int64], still: float = STILL
) -> Floats:
    """Coherency of some vertices with some control points, (V, L); the same numbers as in all columns."""
    both, place = np.unique(np.concatenate([vertices, controls]), return_inverse=True)
    small = ExampleMotion(motion.neutral[both], motion.padded[both], motion.expressions, motion.diameter)
    return coherency_columns(small, place[len(vertices) :].tolist(), still)[place[: len(vertices)]]


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
    nobody = np.zeros(0, dtype=np.int64)
    shares = np.array(influence, dtype=np.float64)  # powers of one of shares that sum to one: themselves
    return _one_pass(motion, nobody, nobody, shares, None, shares, weights, STILL)


def coherent_motion(
    motion: ExampleMotion,
    controls: NDArray[np.int64],
    weights: Floats,
    sharpness: float = 1.0,
    still: float = STILL,
    known: dict[int, Floats] | None = None,
) -> tuple[Floats, Floats, Floats]:
    """Coherency, influence and motion of all vertices in one pass over the examples (Eqs 7, 8 and 10).

    Parameters
    ----------
    motion : ExampleMotion
    controls : (L,) vertices
    weights : (L, K)
        Of the expressions, without the neutral.
    sharpness, still : float
        As in :func:`influence_maps` and :func:`coherency_columns`.
    known : mapping of vertex to (N,), optional
        Columns of the coherency that need not be computed again.

    Returns
    -------
    coherency, influence : (N, L)
    motion : (N, 3)
    """
    known = known or {}
    coherency = np.empty((len(motion.neutral), len(controls)))
    influence = np.empty_like(coherency)
    for column, vertex in enumerate(controls):
        if int(vertex) in known:
            coherency[:, column] = known[int(vertex)]
    fresh = np.array([row for row, vertex in enumerate(controls) if int(vertex) not in known], dtype=np.int64)
    moved = _one_pass(motion, controls, fresh, coherency, sharpness, influence, weights, still)
    return coherency, influence, moved


def _one_pass(
    motion: ExampleMotion, controls: NDArray[np.int64], fresh: NDArray[np.int64], coherency: Floats,
    sharpness: float | None, influence: Floats, weights: Floats | None, still: float,
) -> Floats:  # fmt: skip
    """Fills coherency and, with a sharpness, influence; the motion is (N, 3), or (0, 3) without weights."""
    from capture_eval.editing.coherency_kernels import edit_vertices

    wide = np.zeros((influence.shape[1], motion.padded.shape[2]))
    moved = np.empty((0 if weights is None else len(motion.neutral), 3))
    if weights is not None:
        wide[:, : motion.expressions] = weights
    edit_vertices(
        motion.padded, motion.expressions, motion.neutral, motion.diameter, still * motion.diameter, controls, fresh,
        coherency, sharpness or 0.0, influence, wide, moved,
    )  # fmt: skip
    return moved
