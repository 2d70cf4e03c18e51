"""Importance of shapes: how much a photo of each helps (Carrigan et al. 2020, Eqs 4 to 8)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from capture_eval.errors import InputError
from capture_eval.planning.blendshape_rig import BlendshapeRig, check_target

Floats = NDArray[np.float64]
Booleans = NDArray[np.bool_]


@dataclass(frozen=True)
class Importance:
    """The parts of the importance and how they are mixed.

    Attributes
    ----------
    displacement, distortion : (K,) float64
        I_dis (Eq 5) and I_TD (Eq 7), both in [0, 1].
    similarity : (K, K) float64 or None
        Cosines of the shapes, negative ones set to 0; None where uniqueness does not count.
    alpha, beta : float
        Eq 4.
    """

    displacement: Floats
    distortion: Floats
    similarity: Floats | None
    alpha: float
    beta: float

    def after(self, used: Sequence[int], remaining: Sequence[int]) -> Floats:
        """Importance I of all shapes (K,) when some are used already (Eq 4)."""
        mixed = self.alpha * self.displacement + (1.0 - self.alpha) * self.distortion
        if self.similarity is None:
            return np.asarray(mixed, dtype=np.float64)
        return np.asarray(mixed + self.beta * uniqueness(self.similarity, used, remaining), dtype=np.float64)


def shape_importance(
    rig: BlendshapeRig,
    active: Booleans,
    target: ArrayLike | None = None,
    alpha: float = 0.5,
    beta: float = 0.0,
    remove_scale: bool = False,
) -> Importance:
    """All parts of the importance that do not change from round to round.

    Parameters
    ----------
    active : (K, N) bool
        From `binary_shapes`.
    target : (N, 3), optional
        Neutral of the person who will be captured. Without it no triangle is distorted.
    alpha : float
        Share of displacement against distortion, in [0, 1].
    beta : float
        Weight of uniqueness, 0 or more.
    remove_scale : bool
        Divide the median edge ratio out of the distortion first. Not in the paper, whose term grows with the size of
        the target.

    Raises
    ------
    InputError
        alpha or beta outside their range, or a target that does not fit.
    """
    if not 0.0 <= alpha <= 1.0:
        raise InputError(f"alpha {alpha}: must be from 0 to 1")
    if not (beta >= 0.0 and np.isfinite(beta)):
        raise InputError(f"beta {beta}: must be 0 or more")
    displacement = displacement_strength(rig.lengths, active)
    distortion = np.zeros(rig.shape_count)
    if target is not None:
        stretch = triangle_stretch(rig.neutral, check_target(rig, target), rig.triangles, remove_scale)
        distortion = triangle_distortion(stretch, rig, active)
    return Importance(displacement, distortion, shape_similarity(rig) if beta > 0.0 else None, alpha, beta)


def displacement_strength(lengths: Floats, active: Booleans) -> Floats:
    """I_dis (Eq 5), (K,): mean displacement of the active vertices, divided by that of the strongest shape."""
    mean = np.einsum("kn,kn->k", lengths, active) / np.maximum(active.sum(axis=1), 1)
    return np.asarray(mean / mean.max(initial=1e-300), dtype=np.float64)


def triangle_stretch(
    template: Floats, target: Floats, triangles: NDArray[np.int64], remove_scale: bool = False
) -> Floats:
    """How differently two neutrals shape each triangle, s_t (Eq 6), (T,): 0 where the edges are of equal length.

    Both edges at the triangle's second corner count, each as the larger of the two ratios, minus 1. Edges of no
    length in both meshes have the ratio 1.

    Raises
    ------
    InputError
        An edge has no length in only one of the meshes.
    """
    corner = triangles[:, 1]
    ratios = []
    for other in (triangles[:, 0], triangles[:, 2]):
        first = np.linalg.norm(template[other] - template[corner], axis=1)
        second = np.linalg.norm(target[other] - target[corner], axis=1)
        lone = (first == 0.0) != (second == 0.0)
        if lone.any():
            row = int(np.argmax(lone))
            place = "template" if first[row] == 0.0 else "target"
            raise InputError(
                f"triangle {row}: the edge {corner[row]}-{other[row]} has no length in the {place} only; merge or "
                "part these vertices in both neutrals"
            )
        both = first == 0.0
        ratios.append(np.where(both, 1.0, second) / np.where(both, 1.0, first))
    if remove_scale and len(triangles):
        middle = float(np.median(np.concatenate(ratios)))
        ratios = [ratio / middle for ratio in ratios]
    return np.asarray(sum(np.maximum(r, 1.0 / r) for r in ratios) - 2.0, dtype=np.float64)


def triangle_distortion(stretch: Floats, rig: BlendshapeRig, active: Booleans) -> Floats:
    """I_TD (Eq 7), (K,): sum of the stretch of triangles with an active corner, divided by the largest such sum."""
    first, second, third = rig.triangles.T
    total = np.empty(rig.shape_count)
    for shape, row in enumerate(active):
        total[shape] = stretch @ (row[first] | row[second] | row[third])
    largest = total.max(initial=0.0)
    return total / largest if largest > 0.0 else np.zeros_like(total)


def shape_similarity(rig: BlendshapeRig) -> Floats:
    """Cosine between the displacements of all shapes (K, K), negative values set to 0."""
    flat = rig.displacements.reshape(rig.shape_count, -1)
    product = flat @ flat.T
    length = np.sqrt(np.diag(product))
    return np.asarray(np.clip(product / np.outer(length, length), 0.0, 1.0), dtype=np.float64)


def uniqueness(similarity: Floats, used: Sequence[int], remaining: Sequence[int]) -> Floats:
    """I_U (Eq 8), (K,): 1 for shapes unlike all used ones, 0 for the one most like them; 0 for all in round one.

    The largest similarity is taken over the remaining shapes (the paper leaves open over which).
    """
    result = np.zeros(len(similarity))
    rows = list(remaining)
    if not len(used) or not rows:
        return result
    mean = similarity[np.ix_(rows, list(used))].mean(axis=1)
    largest = mean.max()
    result[rows] = 1.0 - mean / largest if largest > 0.0 else 1.0
    return result
