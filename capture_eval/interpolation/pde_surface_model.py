"""Models made of PDE patches that share their boundary curves; interpolation and blending by coefficients.

(Paper 000, Sections 5 and 6, with Eqs 22-29 as corrected in the documentation.) A patch is linear in its boundary
curves: blending the coefficients of the curves blends every point of every patch, and patches that shared a curve
before share one afterwards.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from capture_eval.errors import InputError
from capture_eval.interpolation.curve_modes import mode_count
from capture_eval.interpolation.static_pde_surface import (
    CurveSeries,
    crossing_factors,
    curve_parameters,
    curve_series,
    patch_points,
)
from capture_eval.polygon_mesh import PolygonMesh

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

DEFAULT_RATIO = 0.01  # λ/β: a tube keeps 95 % of its radius half way between its boundary circles


@dataclass(frozen=True)
class PdeModel:
    """A list of patches, each between two of the model's curves.

    Parameters
    ----------
    curves : tuple of CurveSeries
        Boundary curves.
    patches : tuple of (int, int)
        First and second boundary curve of every patch. A curve named by several patches joins them exactly.
    ratio : float
        λ/β of all patches.

    Raises
    ------
    InputError
        No patch, a curve that is not there, a patch from a curve to itself, or boundary curves of unequal kind or
        number of harmonics.
    SolverError
        A hyperbolic ratio without a solution for these curves.
    """

    curves: tuple[CurveSeries, ...]
    patches: tuple[tuple[int, int], ...]
    ratio: float = DEFAULT_RATIO

    def __post_init__(self) -> None:
        if not self.patches:
            raise InputError("a PDE model needs at least one patch")
        for number, (first, second) in enumerate(self.patches):
            if first == second or not all(0 <= one < len(self.curves) for one in (first, second)):
                raise InputError(f"patch {number}: curves {first} and {second} of {len(self.curves)}")
            if _kind(self.curves[first]) != _kind(self.curves[second]):
                raise InputError(
                    f"patch {number}: curves {first} and {second} differ in kind or number of harmonics: "
                    f"{_kind(self.curves[first])} and {_kind(self.curves[second])}"
                )
            crossing_factors(self.ratio, self.curves[first].harmonics, self.curves[first].closed, [0.5])

    def patch(self, number: int, u: ArrayLike, v: ArrayLike) -> Floats:
        """Points (U, V, 3) of one patch; see `patch_points`."""
        first, second = self.patches[number]
        return patch_points(self.curves[first], self.curves[second], self.ratio, u, v)


def _kind(curve: CurveSeries) -> tuple[str, int]:
    return ("closed" if curve.closed else "open", curve.harmonics)


def strip_model(
    curves: Sequence[ArrayLike], closed: bool, harmonics: int | None = None, ratio: float = DEFAULT_RATIO
) -> PdeModel:
    """Model of patches between curves that follow each other, like rings round a mouth.

    Parameters
    ----------
    curves : sequence of (M_i, 3)
        At least two curves, corresponding at equal v; they may have unequal numbers of points.
    closed : bool
        Kind of all curves.
    harmonics : int, optional
        N of all curves; by default as many as the smallest holds.
    ratio : float
        λ/β.

    Raises
    ------
    InputError
        Fewer than two curves, or one that holds fewer harmonics; the text names it.
    """
    if len(curves) < 2:
        raise InputError(f"a strip of patches needs at least two curves, got {len(curves)}")
    shapes = [np.asarray(points, dtype=np.float64) for points in curves]
    count = min(mode_count(len(points), closed) for points in shapes) if harmonics is None else harmonics
    series = []
    for number, points in enumerate(shapes):
        try:
            series.append(curve_series(points, closed, count))
        except InputError as problem:
            raise InputError(f"boundary curve {number}: {problem}") from problem
    return PdeModel(tuple(series), tuple((i, i + 1) for i in range(len(series) - 1)), ratio)


def blend_models(source: PdeModel, targets: Sequence[PdeModel], weights: ArrayLike, t: float) -> PdeModel:
    """Blend of a source with J targets at t: ``C = Σ_j w_j (C⁰ + t (Cʲ − C⁰))`` for every coefficient (Eqs 22-29).

    One target with weight 1 is the interpolation of two models.

    Parameters
    ----------
    source : PdeModel
        Met at t = 0.
    targets : sequence of PdeModel
        With the curves, patches and ratio of the source.
    weights : (J,)
        w_j, j ≥ 1, adding up to 1. (The paper sums from j = 0 in Eq 26 and from j = 1 in Eq 27; this is Eq 27, whose
        result is a face only if these weights add up to 1.)
    t : float
        In [0, 1].

    Raises
    ------
    InputError
        No target, models that do not correspond, weights of another number or sum, or t outside [0, 1].
    """
    shares = np.asarray(weights, dtype=np.float64)
    if not targets or shares.shape != (len(targets),):
        raise InputError(f"{len(targets)} target models with weights of shape {shares.shape}; one weight per target")
    if not np.isfinite(shares).all() or abs(float(shares.sum()) - 1.0) > 1e-9:
        raise InputError(f"weights of the target models must add up to 1, got {shares.sum():g}")
    if not 0.0 <= t <= 1.0:
        raise InputError(f"t = {t} must be in [0, 1]")
    for number, target in enumerate(targets):
        same = target.patches == source.patches and target.ratio == source.ratio
        if not same or [_kind(c) for c in target.curves] != [_kind(c) for c in source.curves]:
            raise InputError(f"target model {number} does not have the curves, patches and ratio of the source")
    curves = []
    for number, curve in enumerate(source.curves):
        blended = sum(
            (w * model.curves[number].coefficients for w, model in zip(shares, targets, strict=True)),
            np.zeros_like(curve.coefficients),
        )
        start = curve.coefficients
        curves.append(CurveSeries(start + t * (blended - start) if t < 1.0 else blended, curve.closed))
    return PdeModel(tuple(curves), source.patches, source.ratio)


def tessellate(model: PdeModel, across: int, along: int) -> PolygonMesh:
    """Quads of the whole model at any resolution (level of detail); patches share the vertices of their curves.

    Parameters
    ----------
    model : PdeModel
        Model.
    across : int
        Quads from one boundary curve of a patch to the other, 1 or more.
    along : int
        Quads along every curve, 1 or more, 3 or more when curves are closed.

    Returns
    -------
    PolygonMesh
        Vertices of the curves first, ``along`` (closed) or ``along + 1`` (open) for each curve, then the inner rows
        of the patches.

    Raises
    ------
    InputError
        Too few quads.
    """
    least = 3 if any(curve.closed for curve in model.curves) else 1
    if across < 1 or along < least:
        raise InputError(f"tessellation of {across} by {along} quads; at least 1 by {least} needed")
    vertices: list[Floats] = []
    first_of_curve, total = [], 0
    for curve in model.curves:
        v = curve_parameters(along if curve.closed else along + 1, curve.closed)
        vertices.append(curve.points(v))
        first_of_curve.append(total)
        total += len(v)
    quads = []
    u = np.arange(1, across) / across
    for number, (first, second) in enumerate(model.patches):
        curve = model.curves[first]
        v = curve_parameters(along if curve.closed else along + 1, curve.closed)
        inner = model.patch(number, u, v).reshape(-1, 3)
        rows = total + np.arange(len(inner), dtype=np.int64).reshape(across - 1, len(v))
        ends = [first_of_curve[end] + np.arange(len(v), dtype=np.int64) for end in (first, second)]
        quads.append(_grid_quads(np.vstack([ends[0][None], rows, ends[1][None]]), curve.closed))
        vertices.append(inner)
        total += len(inner)
    return PolygonMesh.from_faces(np.concatenate(vertices), np.concatenate(quads))


def _grid_quads(grid: Integers, closed: bool) -> Integers:
    following = np.roll(grid, -1, axis=1) if closed else grid[:, 1:]
    here = grid if closed else grid[:, :-1]
    corners = [here[:-1], following[:-1], following[1:], here[1:]]
    return np.stack([corner.ravel() for corner in corners], axis=1)


@dataclass(frozen=True)
class CoefficientCount:
    """How many numbers describe a model.

    Attributes
    ----------
    vectors : int
        Coefficients with three components each, shared curves counted once: to be compared with vertices.
    scalars : int
        Numbers: three per vector, to be compared with coordinates.
    vectors_per_patch_form : int
        Vectors C1 and C2 of every patch, shared curves counted in each (the form of Eq 19).
    """

    vectors: int
    scalars: int
    vectors_per_patch_form: int


def count_coefficients(model: PdeModel) -> CoefficientCount:
    """Coefficients of a model (paper 000, Table 1, which does not say whether it counts vectors or numbers)."""
    vectors = sum(len(curve.coefficients) for curve in model.curves)
    repeated = sum(len(model.curves[end].coefficients) for patch in model.patches for end in patch)
    return CoefficientCount(vectors, 3 * vectors, repeated)


def strip_errors(
    rings: Sequence[ArrayLike], closed: bool, harmonics: int, every: int, largest_distance: float, ratio: float
) -> tuple[float, float]:
    """ErM and ErA of paper 000, Eq 30: what a model of patches misses of the vertices it was made from.

    Parameters
    ----------
    rings : sequence of (M_i, 3)
        Rings of vertices that follow each other.
    closed : bool
        Kind of the rings.
    harmonics : int
        N, at most what each boundary ring holds.
    every : int
        Every so many rings (and the last) is a boundary curve, the others lie inside patches at equal steps of u.
        With 1 all rings are boundary curves.
    largest_distance : float
        D_max; the paper does not define it. Here: the largest distance between two vertices of the model.
    ratio : float
        λ/β.

    Returns
    -------
    largest, average : float
        ErM and ErA as fractions of D_max over all vertices of the rings.

    Raises
    ------
    InputError
        D_max is not positive, or ``every`` is below 1.
    """
    if not (np.isfinite(largest_distance) and largest_distance > 0):
        raise InputError(f"D_max = {largest_distance}: the model has no extent")
    if every < 1:
        raise InputError(f"every = {every} must be 1 or more")
    shapes = [np.asarray(ring, dtype=np.float64) for ring in rings]
    chosen = sorted({*range(0, len(shapes), every), len(shapes) - 1})
    model = strip_model([shapes[i] for i in chosen], closed, harmonics, ratio)
    errors = []
    for number, (first, last) in enumerate(pairwise(chosen)):
        for ring in range(first, last + (last == chosen[-1])):
            v = curve_parameters(len(shapes[ring]), closed)
            found = model.patch(number, [(ring - first) / (last - first)], v)[0]
            errors.append(np.linalg.norm(found - shapes[ring], axis=1))
    distances = np.concatenate(errors) / largest_distance
    return float(distances.max()), float(distances.mean())
