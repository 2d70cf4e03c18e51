"""Pairs of shapes that mirror each other: found by a test that does not depend on the unit, or given by the user.

The test of Carrigan et al.'s published code compares a squared length with a length, so its pairs change with the
unit of the rig. Here both sides are squared lengths.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capture_eval.errors import InputError
from capture_eval.planning.blendshape_rig import BlendshapeRig

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Booleans = NDArray[np.bool_]
Pair = tuple[int, int]

SELF_SYMMETRIC_OVERLAP = 0.4
LARGEST_MISFIT = 0.1
_MIRROR_TOLERANCE = 0.005
_FEWEST_MIRRORED = 0.8


@dataclass(frozen=True)
class FoundPairs:
    """Result of the search.

    Attributes
    ----------
    pairs : tuple of (int, int)
        Shapes that mirror each other, the smaller number first.
    misfits : tuple of float
        Of every pair: mean squared difference over squared largest displacement; below `LARGEST_MISFIT`.
    self_symmetric : tuple of int
        Shapes that mirror themselves.
    """

    pairs: tuple[Pair, ...]
    misfits: tuple[float, ...]
    self_symmetric: tuple[int, ...]


def mirror_vertices(neutral: Floats) -> Integers:
    """For each vertex the one at its mirror image in x, (N,); -1 where there is none.

    The plane is x = 0 or the middle of the mesh, whichever mirrors more vertices. Two vertices mirror each other
    when each is the nearest to the other's image, within 0.5 % of the mesh's extent.

    Raises
    ------
    InputError
        Less than 80 % of the vertices have a mirror image.
    """
    from scipy.spatial import KDTree

    tree = KDTree(neutral)
    low, high = neutral.min(axis=0), neutral.max(axis=0)
    reach = _MIRROR_TOLERANCE * float(np.linalg.norm(high - low))
    middle = 0.5 * float(low[0] + high[0])
    best = np.full(len(neutral), -1, dtype=np.int64)
    for plane in (0.0, middle) if abs(middle) > 1e-9 * reach else (0.0,):
        image = neutral * [-1.0, 1.0, 1.0] + [2.0 * plane, 0.0, 0.0]
        distance, nearest = tree.query(image, distance_upper_bound=reach)
        found = np.where(np.isfinite(distance), nearest, -1).astype(np.int64)
        mutual = (found >= 0) & (found[np.maximum(found, 0)] == np.arange(len(neutral)))
        found = np.where(mutual, found, -1)
        if (found >= 0).sum() > (best >= 0).sum():
            best = found
        if (best >= 0).mean() >= _FEWEST_MIRRORED:
            return best
    share = float((best >= 0).mean())
    raise InputError(
        f"only {100 * share:.0f} % of the vertices have a mirror image in x: turn the rig so that x goes from side to "
        "side, name the pairs, or plan without symmetry"
    )


def find_pairs(rig: BlendshapeRig, active: Booleans, mirror: Integers | None = None) -> FoundPairs:
    """Shapes that are mirror images of each other, whatever the unit of the rig.

    A shape whose active vertices overlap their own mirror image by more than 0.4 (Jaccard) is self-symmetric and in no
    pair. In ascending order every other shape takes, among later free shapes whose mirror image it overlaps, the one
    with the smallest mean squared difference, if that is below 0.1 of the squared smaller largest displacement.

    Parameters
    ----------
    active : (K, N) bool
    mirror : (N,) int64, optional
        From `mirror_vertices`; vertices marked -1 are left out of the comparison.
    """
    mirror = mirror_vertices(rig.neutral) if mirror is None else mirror
    here = np.flatnonzero(mirror >= 0)
    there = mirror[here]
    own = active[:, here].astype(np.float32)
    image = active[:, there].astype(np.float32)
    overlap = own @ image.T
    size = own.sum(axis=1)
    union = size + image.sum(axis=1) - np.diag(overlap)
    itself = np.diag(overlap) > SELF_SYMMETRIC_OVERLAP * np.maximum(union, 1.0)
    free = np.flatnonzero(~itself).tolist()
    misfit = _misfits(rig, active, here, there, overlap, free)
    pairs: list[Pair] = []
    errors: list[float] = []
    taken: set[int] = set()
    for first in free:
        if first in taken:
            continue
        later = [k for k in free if k > first and k not in taken and misfit[first, k] < LARGEST_MISFIT]
        if later:
            second = min(later, key=lambda k: float(misfit[first, k]))
            pairs.append((first, second))
            errors.append(float(misfit[first, second]))
            taken |= {first, second}
    return FoundPairs(tuple(pairs), tuple(errors), tuple(np.flatnonzero(itself).tolist()))


def _misfits(
    rig: BlendshapeRig, active: Booleans, here: Integers, there: Integers, overlap: NDArray[np.float32], free: list[int]
) -> Floats:
    """Scale-free misfit of all free shapes, (K, K); infinite where nothing overlaps.

    All squared differences at once: ``|a - b|^2 = |a|^2 + |b|^2 - 2 a b``.
    """
    result = np.full((rig.shape_count, rig.shape_count), np.inf)
    if not free:
        return result
    strong = np.where(active[free, :, None], rig.displacements[free], 0.0)
    largest = np.where(active[free], rig.lengths[free], 0.0).max(axis=1)
    own = strong[:, here].reshape(len(free), -1)
    image = (strong[:, there] * [-1.0, 1.0, 1.0]).reshape(len(free), -1)
    squares = np.einsum("kn,kn->k", own, own)[:, None] + np.einsum("kn,kn->k", image, image)[None]
    shared = overlap[np.ix_(free, free)].astype(np.float64)
    error = np.maximum(squares - 2.0 * own @ image.T, 0.0) / np.maximum(shared, 1.0)
    scale = np.minimum(largest[:, None], largest[None]) ** 2
    result[np.ix_(free, free)] = np.where(shared > 0.0, error / scale, np.inf)
    return result


def check_pairs(pairs: Sequence[Sequence[int]], names: Sequence[str]) -> tuple[Pair, ...]:
    """Pairs given by a user.

    Raises
    ------
    InputError
        A pair that is not of two shapes, names a shape that is not there, pairs a shape with itself, or is repeated.
    """
    checked: list[Pair] = []
    for pair in pairs:
        if len(pair) != 2:
            raise InputError(f"pair {list(pair)}: a pair has two shapes")
        first, second = int(pair[0]), int(pair[1])
        for member in (first, second):
            if not 0 <= member < len(names):
                raise InputError(f"pair {list(pair)}: there is no shape {member}, only 0 to {len(names) - 1}")
        if first == second:
            raise InputError(f"pair {names[first]}, {names[second]}: a shape cannot be paired with itself")
        ordered = (min(first, second), max(first, second))
        if ordered in checked:
            raise InputError(f"pair {names[first]}, {names[second]} is given twice")
        checked.append(ordered)
    return tuple(checked)


def merge_pairs(given: Sequence[Pair], found: Sequence[Pair]) -> tuple[Pair, ...]:
    """The user's pairs, and those found ones that touch none of the user's shapes."""
    named = {shape for pair in given for shape in pair}
    return (*given, *(pair for pair in found if not named & set(pair)))
