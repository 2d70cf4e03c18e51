"""Blendshapes of registered expressions at any time of their motion (paper 003, Section 5).

Every target j moves from the neutral shape as an interpolation method says, to ``w_j(t) = w0 + d_j(t)``, and

    w_b(t) = w0 + Σ_j ξ_j d_j(t)                                               (Eqs 36 and 38)

With Σξ = 1 this is ``Σ_j ξ_j w_j(t)``, Eq (38), which is a face only then. The methods are linear in the displacement,
so that blending shapes is blending the coefficients of their curves (Eqs 39 and 40). At t = 1 all methods give the
linear blend of the targets.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from capture_eval.curves.extract import Curve
from capture_eval.errors import InputError
from capture_eval.interpolation.mesh_extension import MeshExtension
from capture_eval.interpolation.method import InterpolationMethod
from capture_eval.interpolation.weight_grid import check_weights

Floats = NDArray[np.float64]
Booleans = NDArray[np.bool_]

BLOCK_MODELS = 64
BLOCK_BYTES = 2_000_000  # a checksum and a copy of larger blocks wait for memory (benchmarks/blendshapes.py)


def vertices_on_curves(curves: Sequence[Curve], vertex_count: int) -> Booleans:
    """Mask (V,) of the vertices that some curve runs through.

    Raises
    ------
    InputError
        No curve, or one that leaves the mesh; names it.
    """
    if not curves:
        raise InputError("blending needs at least one curve")
    mask = np.zeros(vertex_count, dtype=bool)
    for curve in curves:
        if curve.vertices.max() >= vertex_count:
            raise InputError(f"curve '{curve.name}': vertex {curve.vertices.max()} of a mesh with {vertex_count}")
        mask[curve.vertices] = True
    return mask


def expression_motion(
    neutral: Floats,
    target: Floats,
    curves: Sequence[Curve],
    method: InterpolationMethod,
    t: float,
    extension: MeshExtension,
) -> Floats:
    """Displacement d(t) of every vertex on its way from neutral to target.

    Vertices on curves go where the method takes their curve (the mean where curves cross). All others share the
    timing that fits the curves best, φ(t) = Σ d·d(t) / Σ d·d over their vertices; what the curves deviate from it is
    extended to them. At t = 0 and t = 1 the shapes are therefore met everywhere.

    Parameters
    ----------
    neutral, target : (V, 3)
        Shapes.
    curves : sequence of Curve
        At least one.
    method : InterpolationMethod
        Method.
    t : float
        In [0, 1].
    extension : MeshExtension
        Made for `vertices_on_curves`.

    Returns
    -------
    (V, 3) float64

    Raises
    ------
    InputError
        Shapes that do not fit or are not finite, t outside [0, 1], or a curve that the method refuses.
    """
    first, last = (np.asarray(shape, dtype=np.float64) for shape in (neutral, target))
    if first.shape != last.shape or first.ndim != 2 or first.shape[1] != 3:
        raise InputError(f"neutral {first.shape} and target {last.shape} must be equal (vertices, 3)")
    if not (np.isfinite(first).all() and np.isfinite(last).all()):
        raise InputError("a shape to blend holds positions that are not finite")
    total, visits = np.zeros_like(first), np.zeros(len(first))
    for curve in curves:
        ends = first[curve.vertices], last[curve.vertices]
        try:
            total[curve.vertices] += method.predict(*ends, curve.closed, [t])[0] - ends[0]
        except ValueError as problem:
            raise type(problem)(f"curve '{curve.name}': {problem}") from problem
        visits[curve.vertices] += 1
    on = visits > 0
    displacement = last - first
    moved = total[on] / visits[on, None]
    length = float((displacement[on] ** 2).sum())
    share = float((displacement[on] * moved).sum()) / length if length > 0 else t
    result: Floats = share * displacement + extension.extend(moved - share * displacement[on])
    result[on] = moved
    return result


def blend_basis(neutral: Floats, motions: Sequence[Floats], precision: DTypeLike = np.float64) -> NDArray[np.floating]:
    """Rows d_1 … d_J and the neutral shape last, (J + 1, 3 V): a blend is ``[ξ, 1] @ basis``.

    Raises
    ------
    InputError
        No motion, or one of another shape.
    """
    if not motions:
        raise InputError("blending needs at least one target")
    for number, motion in enumerate(motions):
        if motion.shape != neutral.shape:
            raise InputError(f"motion {number} has shape {motion.shape}, the neutral shape {neutral.shape}")
    return np.stack([*motions, neutral]).reshape(len(motions) + 1, -1).astype(precision)


def block_size(basis: NDArray[np.floating]) -> int:
    """Models that are made at once: few enough to stay in the processor's cache and to bound the memory."""
    return int(max(1, min(BLOCK_MODELS, BLOCK_BYTES // max(1, basis.shape[1] * basis.itemsize))))


def blend_blocks(weights: ArrayLike, basis: NDArray[np.floating]) -> Iterator[NDArray[np.floating]]:
    """Blended models, some at a time, in the order of the weights and with bounded memory.

    Parameters
    ----------
    weights : (K, J)
        ξ, not negative.
    basis : (J + 1, 3 V)
        From `blend_basis`; its precision is that of the result.

    Yields
    ------
    (B, V, 3)
        The **same** array again and again: copy or write it before the next one is asked for.

    Raises
    ------
    InputError
        Weights of another number of targets, negative or not finite.
    """
    rows = check_weights(weights, len(basis) - 1)
    step = block_size(basis)
    buffer = np.empty((min(step, len(rows)), basis.shape[1]), dtype=basis.dtype)
    full = np.ones((len(rows), len(basis)), dtype=basis.dtype)
    full[:, :-1] = rows
    for first in range(0, len(rows), step):
        part = full[first : first + step]
        block = np.matmul(part, basis, out=buffer[: len(part)])
        yield block.reshape(len(part), -1, 3)


def blend_into(weights: ArrayLike, basis: NDArray[np.floating], out: NDArray[np.floating]) -> None:
    """Fill ``out`` (K, V, 3) with all blended models, block by block.

    Raises
    ------
    InputError
        ``out`` has another shape or precision, or is not contiguous; see also `blend_blocks`.
    """
    rows = check_weights(weights, len(basis) - 1)
    if out.shape != (len(rows), basis.shape[1] // 3, 3) or out.dtype != basis.dtype or not out.flags.c_contiguous:
        wanted = f"contiguous {(len(rows), basis.shape[1] // 3, 3)} of {basis.dtype}"
        raise InputError(f"blend: out is {out.shape} of {out.dtype}, expected {wanted}")
    full = np.ones((len(rows), len(basis)), dtype=basis.dtype)
    full[:, :-1] = rows
    flat, step = out.reshape(len(rows), -1), block_size(basis)
    for first in range(0, len(rows), step):
        np.matmul(full[first : first + step], basis, out=flat[first : first + step])
