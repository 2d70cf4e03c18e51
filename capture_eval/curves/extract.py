"""Curves of registered meshes: indices on the template times positions in every pose."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from capture_eval.curves.curve_specification import CurveSpecification, resolve_curve
from capture_eval.curves.edge_loops import EdgeTopology
from capture_eval.errors import InputError

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


@dataclass(frozen=True)
class Curve:
    """A named curve on the template.

    Parameters
    ----------
    name : str
        Name in the curves file.
    vertices : (M,) int64
        Template vertices in order, no repeats; M ≥ 3 when closed, else M ≥ 2.
    closed : bool
        Whether the last vertex joins the first.
    extra : mapping
        Further keys of the curves file (region, …).

    Raises
    ------
    InputError
        Too few or repeated vertices; names the curve.
    """

    name: str
    vertices: Integers
    closed: bool
    extra: Mapping[str, object] = field(default_factory=dict)

    def __post_init__(self) -> None:
        vertices = np.ascontiguousarray(self.vertices, dtype=np.int64)
        object.__setattr__(self, "vertices", vertices)
        least = 3 if self.closed else 2
        if vertices.ndim != 1 or len(vertices) < least:
            kind = "a closed curve" if self.closed else "an open curve"
            raise InputError(f"curve '{self.name}': {vertices.size} points; {kind} needs at least {least}")
        values, counts = np.unique(vertices, return_counts=True)
        if counts.max() > 1:
            twice = int(values[np.argmax(counts > 1)])
            hint = ""
            if vertices[0] == vertices[-1] and not self.closed:
                hint = "; it ends where it began: close it with a turn at that vertex, or stop it one vertex before"
            raise InputError(f"curve '{self.name}': vertex {twice} occurs {counts.max()} times{hint}")
        if values[0] < 0:
            raise InputError(f"curve '{self.name}': vertex {values[0]} is negative")


@dataclass(frozen=True)
class CurveSet:
    """Curves with their positions in every pose.

    Parameters
    ----------
    curves : tuple of Curve
        N curves.
    positions : tuple of (P, M_n, 3) float64
        Positions of each curve in each pose; NaN where a pose failed.
    """

    curves: tuple[Curve, ...]
    positions: tuple[Floats, ...]

    def __post_init__(self) -> None:
        if len(self.curves) != len(self.positions):
            raise InputError(f"{len(self.curves)} curves with {len(self.positions)} arrays of positions")

    def __len__(self) -> int:
        return len(self.curves)


def resolve_curves(specifications: Sequence[CurveSpecification], topology: EdgeTopology) -> tuple[Curve, ...]:
    """Walk every specified curve on the mesh.

    Raises
    ------
    InputError
        A curve does not exist on the mesh, repeats vertices or has too few; names the curve.
    """
    curves = []
    for specification in specifications:
        loop = resolve_curve(specification, topology)
        curve = Curve(specification.name, loop.vertices, loop.closed, specification.extra)
        _check_inside(curve, topology.vertex_count)
        curves.append(curve)
    return tuple(curves)


def _check_inside(curve: Curve, vertex_count: int) -> None:
    worst = int(curve.vertices.max())
    if worst >= vertex_count:
        raise InputError(f"curve '{curve.name}': vertex {worst} is not in the mesh, which has {vertex_count} vertices")


def curve_problems(specifications: Sequence[CurveSpecification], topology: EdgeTopology) -> list[str]:
    """Everything wrong with the curves on this mesh, one line each; empty when all is well.

    Besides what `resolve_curves` refuses, listed curves whose neighbours are not joined by an edge are named: they
    leave the mesh.
    """
    problems = []
    for specification in specifications:
        try:
            (curve,) = resolve_curves([specification], topology)
        except InputError as problem:
            problems.append(str(problem))
            continue
        following = np.roll(curve.vertices, -1) if curve.closed else curve.vertices[1:]
        pairs = zip(curve.vertices.tolist(), following.tolist(), strict=False)
        missing = [(a, b) for a, b in pairs if not topology.has_edge(a, b)]
        if missing:
            a, b = missing[0]
            problems.append(
                f"curve '{curve.name}': leaves the mesh at {len(missing)} of its steps, first between {a} and {b}"
            )
    return problems


def extract_curves(curves: Sequence[Curve], vertices: Floats) -> CurveSet:
    """Positions of curves in all poses.

    Parameters
    ----------
    curves : sequence of Curve
        On the template.
    vertices : (P, V, 3) of float32 or float64
        Registered vertices of all poses; NaN for a failed pose.

    Returns
    -------
    CurveSet
        Copies of the positions in the order of the curves.

    Raises
    ------
    InputError
        Wrong shape, or a curve that runs through a vertex the meshes do not have; names the curve.
    """
    positions = np.asarray(vertices)  # a large file of single precision is not copied as a whole
    if positions.ndim != 3 or positions.shape[2] != 3:
        raise InputError(f"vertices have shape {positions.shape}, expected (poses, vertices, 3)")
    for curve in curves:
        _check_inside(curve, positions.shape[1])
    return CurveSet(tuple(curves), tuple(positions[:, c.vertices].astype(np.float64) for c in curves))
