"""A blendshape rig as arrays: a neutral and shapes of one topology."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from capture_eval.errors import InputError

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


@dataclass(frozen=True)
class BlendshapeRig:
    """A neutral face and K shapes with the same vertices and triangles, any unit, absolute positions.

    Parameters
    ----------
    names : tuple of str
        Of the shapes, all different.
    neutral : (N, 3) float64
    shapes : (K, N, 3) float64
        Positions, not displacements; K may be 0.
    triangles : (T, 3) int64

    Raises
    ------
    InputError
        Shapes that do not fit, numbers that are not finite, names that repeat, triangles outside the mesh; the text
        names the shape.
    """

    names: tuple[str, ...]
    neutral: Floats
    shapes: Floats
    triangles: Integers

    def __post_init__(self) -> None:
        neutral = np.ascontiguousarray(self.neutral, dtype=np.float64)
        shapes = np.ascontiguousarray(self.shapes, dtype=np.float64)
        triangles = np.ascontiguousarray(self.triangles, dtype=np.int64)
        if neutral.ndim != 2 or neutral.shape[1:] != (3,) or len(neutral) == 0:
            raise InputError(f"rig: the neutral has the shape {neutral.shape}, expected (vertices, 3)")
        if shapes.size == 0:
            shapes = shapes.reshape(0, *neutral.shape)
        if shapes.ndim != 3 or shapes.shape[1:] != neutral.shape:
            raise InputError(
                f"rig: shapes {shapes.shape} do not fit a neutral {neutral.shape}; expected (K, {len(neutral)}, 3)"
            )
        if len(self.names) != len(shapes):
            raise InputError(f"rig: {len(self.names)} names for {len(shapes)} shapes")
        repeated = sorted({name for name in self.names if self.names.count(name) > 1})
        if repeated:
            raise InputError(f"rig: two shapes are called {repeated[0]}")
        if not np.all(np.isfinite(neutral)):
            raise InputError("rig: the neutral holds numbers that are not finite")
        for name, shape in zip(self.names, shapes, strict=True):
            if not np.isfinite(shape.sum()) and not np.all(np.isfinite(shape)):
                raise InputError(f"rig: shape {name} holds numbers that are not finite")
        check_triangles(triangles, len(neutral))
        for field, value in (("neutral", neutral), ("shapes", shapes), ("triangles", triangles)):
            object.__setattr__(self, field, value)

    @property
    def shape_count(self) -> int:
        """Number of shapes K."""
        return len(self.shapes)

    @cached_property
    def displacements(self) -> Floats:
        """``shapes - neutral``, (K, N, 3)."""
        return self.shapes - self.neutral

    @cached_property
    def lengths(self) -> Floats:
        """Length of every displacement, (K, N)."""
        moved = self.displacements
        return np.asarray(np.sqrt(np.einsum("kni,kni->kn", moved, moved)), dtype=np.float64)

    def index(self, name: str) -> int:
        """Number of a shape.

        Raises
        ------
        InputError
            There is none of that name.
        """
        if name not in self.names:
            raise InputError(f"the rig has no shape {name!r}; it has {', '.join(self.names) or 'none'}")
        return self.names.index(name)

    def combined(self, shapes: Sequence[int], neutral: Floats | None = None) -> Floats:
        """Positions (N, 3) of an expression: the neutral (or another one) and the displacements of some shapes."""
        base = self.neutral if neutral is None else neutral
        return np.asarray(base + self.displacements[list(shapes)].sum(axis=0), dtype=np.float64)


def check_triangles(triangles: Integers, vertex_count: int) -> None:
    """Refuse triangles of a wrong shape or outside the mesh.

    Raises
    ------
    InputError
        With the first wrong triangle.
    """
    if triangles.ndim != 2 or triangles.shape[1] != 3:
        raise InputError(f"rig: triangles have the shape {triangles.shape}, expected (T, 3)")
    wrong = np.any((triangles < 0) | (triangles >= vertex_count), axis=1)
    if wrong.any():
        row = int(np.argmax(wrong))
        raise InputError(f"rig: triangle {row} {triangles[row].tolist()} is outside the {vertex_count} vertices")


def check_target(rig: BlendshapeRig, target: ArrayLike) -> Floats:
    """A target neutral as (N, 3) float64.

    Raises
    ------
    InputError
        Its shape is not that of the rig's neutral, or a number is not finite.
    """
    positions = np.asarray(target, dtype=np.float64)
    if positions.shape != rig.neutral.shape:
        raise InputError(f"target neutral {positions.shape} does not fit the rig's neutral {rig.neutral.shape}")
    if not np.all(np.isfinite(positions)):
        raise InputError("target neutral holds numbers that are not finite")
    return positions
