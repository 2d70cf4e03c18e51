"""Repeat-registration spread: how far a registered pose moves when only half of its photos measure it.

The last texture round is repeated with each of two halves of the photos. The halves share the skin, the mesh, the
cameras and the neutral's texture, and differ in sensor noise, sampling and viewing directions: half of their
difference estimates the random error of the full set. What both halves share (smoothing, cameras, light) is not in
it; `capture_eval.registration.error_bar` adds that. Lengths are in the frame of the vertices.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from capture_eval.errors import InputError
from capture_eval.registration.deformation_solver import DeformationSolver
from capture_eval.registration.lifted_matches import MaterialMatches
from capture_eval.registration.surface_correspondence import Surface
from capture_eval.registration.texture_baking import BakedTexture
from capture_eval.registration.texture_rounds import PhotoSet, RoundOptions, TextureAtlases, refine_by_texture
from capture_eval.triangle_geometry import unique_edges, vertex_normals

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

LEAST_PHOTOS = 6  # three per half: with two the stereo has a single pair to compare
_LEAST_HALF_VIEWS = 3


def split_photos(photos: PhotoSet) -> tuple[PhotoSet, PhotoSet]:
    """Two halves of a photo set that see the same skin: of every two neighbouring cameras one goes to each.

    Neighbours are paired greedily by the angle between their optical axes, in the order of the photos, so that equal
    input gives equal halves (a last single photo goes to either).
    """
    axes = np.array([view.rotation[2] for view in photos.views])
    left = list(range(len(axes)))
    halves: tuple[list[int], list[int]] = ([], [])
    turn = 0
    while left:
        first = left.pop(0)
        halves[turn].append(first)
        if left:
            nearest = int(np.argmax(axes[left] @ axes[first]))
            halves[1 - turn].append(left.pop(nearest))
        turn = 1 - turn
    return _chosen(photos, sorted(halves[0])), _chosen(photos, sorted(halves[1]))


def _chosen(photos: PhotoSet, rows: list[int]) -> PhotoSet:
    return PhotoSet(tuple(photos.views[row] for row in rows), tuple(photos.images[row] for row in rows))


def repeat_by_halves(
    solver: DeformationSolver,
    vertices: Floats,
    skin: NDArray[np.bool_],
    photos: PhotoSet,
    atlases: TextureAtlases,
    neutral_texture: BakedTexture | None,
    scan: Surface | None,
    matches: MaterialMatches | None,
    options: RoundOptions,
) -> tuple[Floats, Floats]:
    """The mesh after one more round with each half of the photos, (V, 3) each.

    Parameters
    ----------
    vertices : (V, 3) float64
        The pose as registered with all photos.
    solver, skin, photos, atlases, neutral_texture, scan, matches, options
        As for `refine_by_texture`; of the rounds only the last is repeated.

    Raises
    ------
    InputError
        Fewer than six photos.
    """
    if len(photos.views) < LEAST_PHOTOS:
        raise InputError(f"registration spread: {len(photos.views)} photos, at least {LEAST_PHOTOS} are needed")
    views = max(_LEAST_HALF_VIEWS, options.stereo.minimum_views // 2)
    last = dataclasses.replace(
        options,
        half_ranges=options.half_ranges[-1:],
        search_rounds=0,  # the mesh is where it should be
        flow_consistency=(options.flow_consistency[1], options.flow_consistency[1]),
        stereo=dataclasses.replace(options.stereo, minimum_views=views),
    )
    first, second = (
        refine_by_texture(solver, vertices, skin, half, atlases, neutral_texture, scan, matches, last).vertices
        for half in split_photos(photos)
    )
    return first, second


def half_difference_spread(first: Floats, second: Floats, triangles: Integers, rings: int = 3) -> Floats:
    """Root mean square random error of the full set at each vertex, (V,), from two halves (V, 3).

    With independent errors of variance 2 s^2 in each half, the difference has variance 4 s^2, so s is half of it (the
    1/sqrt(2) law twice). One difference is one draw: its square is averaged over the vertex and its neighbours,
    `rings` times.

    Raises
    ------
    InputError
        Shapes differ.

    Examples
    --------
    >>> one = np.zeros((3, 3))
    >>> two = one + np.array([2.0, 0.0, 0.0])
    >>> half_difference_spread(one, two, np.array([[0, 1, 2]]))
    array([1., 1., 1.])
    """
    if first.shape != second.shape or first.ndim != 2 or first.shape[1] != 3:
        raise InputError(f"registration spread: halves have shapes {first.shape} and {second.shape}")
    squared = 0.25 * np.sum((first - second) ** 2, axis=1)
    return np.sqrt(neighbour_mean(squared, triangles, rings))


def repeat_spread(reference: Floats, repeats: Sequence[Floats], triangles: Integers) -> Floats:
    """Root mean square distance along the surface, (V,), of repeated fits (V, 3) from a reference fit (V, 3).

    Raises
    ------
    InputError
        No repeats, or shapes that differ.
    """
    if not repeats or any(repeat.shape != reference.shape for repeat in repeats):
        raise InputError(f"registration spread: {len(repeats)} repeats for a reference of shape {reference.shape}")
    normals = vertex_normals(reference, triangles)
    squared = np.zeros(len(reference))
    for repeat in repeats:
        way = repeat - reference
        along = way - np.sum(way * normals, axis=1, keepdims=True) * normals
        squared += np.sum(along**2, axis=1)
    return np.sqrt(squared / len(repeats))


def neighbour_mean(values: Floats, triangles: Integers, rings: int) -> Floats:
    """Mean of values (V,) over each vertex and its neighbours, `rings` times over."""
    edges = unique_edges(triangles)
    count = len(values)
    degree = 1.0 + np.bincount(edges.ravel(), minlength=count)
    mean = np.asarray(values, dtype=np.float64)
    for _ in range(rings):
        total = mean + np.bincount(edges[:, 0], mean[edges[:, 1]], count)
        mean = (total + np.bincount(edges[:, 1], mean[edges[:, 0]], count)) / degree
    return mean
