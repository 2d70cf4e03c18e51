"""Landmarks from pixels in several photos, and the similarity that they give."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capture_eval.cameras import View, pixel_rays, project
from capture_eval.errors import InputError, RegistrationError
from capture_eval.similarity import Similarity, estimate_similarity

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class TriangulatedPoint:
    """A point met by the rays of several photos.

    Parameters
    ----------
    position : (3,) float64
        World.
    reprojection_error : float
        Root mean square over the photos used, pixels.
    photos : tuple of str
        Photos used.
    """

    position: Floats
    reprojection_error: float
    photos: tuple[str, ...]


def triangulate_point(
    views: Mapping[str, View], pixels: Mapping[str, Floats], maximum_error: float = 8.0
) -> TriangulatedPoint:
    """Place that a point seen at `pixels` has.

    While the reprojection error exceeds `maximum_error` and more than two photos are left, the worst is dropped.

    Raises
    ------
    RegistrationError
        Fewer than two photos with a camera, parallel rays, or a point behind a camera.
    """
    names = [name for name in sorted(pixels) if name in views]
    while True:
        if len(names) < 2:
            raise RegistrationError(f"{len(names)} of its photos have a solved camera, at least 2 are needed")
        position = _intersect([views[name] for name in names], [pixels[name] for name in names])
        errors = np.array([_reprojection_error(views[name], position, pixels[name]) for name in names])
        worst = int(np.argmax(errors))
        if errors[worst] <= maximum_error:
            return TriangulatedPoint(position, float(np.sqrt(np.mean(errors**2))), tuple(names))
        if len(names) == 2:
            raise RegistrationError(f"its photos disagree by {errors[worst]:.1f} pixels, limit {maximum_error:g}")
        # The photo whose absence mends the rest most is the wrong one, not the one with the largest residual.
        names.remove(names[_most_harmful(views, pixels, names)])


def _intersect(views: Sequence[View], pixels: Sequence[Floats], steps: int = 3) -> Floats:
    """Point with the least squared distances from the rays, in pixels of each photo after the first step."""
    origins, directions = [], []
    for view, pixel in zip(views, pixels, strict=True):
        origin, direction = pixel_rays(view, np.asarray(pixel, dtype=np.float64)[None])
        origins.append(origin)
        directions.append(direction[0])
    origin_array, direction_array = np.array(origins), np.array(directions)
    projectors = np.eye(3) - direction_array[:, :, None] * direction_array[:, None, :]
    weight = np.ones(len(views))
    position = np.zeros(3)
    for _ in range(steps):
        matrix = np.einsum("n,nij->ij", weight, projectors)
        if np.linalg.cond(matrix) > 1e8:
            raise RegistrationError("its rays are parallel")
        position = np.linalg.solve(matrix, np.einsum("n,nij,nj->i", weight, projectors, origin_array))
        depth = np.maximum(np.sum((position - origin_array) * direction_array, axis=1), 1e-12)
        focal = np.array([view.intrinsics.matrix[0, 0] for view in views])
        weight = (focal / depth) ** 2
        weight = weight / weight.max()
    return position


def _reprojection_error(view: View, position: Floats, pixel: Floats) -> float:
    place, depth = project(view, position[None])
    if depth[0] <= 0:
        return float("inf")
    return float(np.linalg.norm(place[0] - pixel))


def _most_harmful(views: Mapping[str, View], pixels: Mapping[str, Floats], names: Sequence[str]) -> int:
    worst = []
    for index in range(len(names)):
        rest = [name for row, name in enumerate(names) if row != index]
        position = _intersect([views[name] for name in rest], [pixels[name] for name in rest])
        worst.append(max(_reprojection_error(views[name], position, pixels[name]) for name in rest))
    return int(np.argmin(worst))


def landmark_similarity(
    source: Floats, target: Floats, names: Sequence[str], maximum_residual: float = 0.12
) -> tuple[Similarity, Floats]:
    """`target_from_source` from landmarks, one bad landmark among many not mattering; also their residuals.

    Parameters
    ----------
    source, target : (N, 3)
        Landmarks on the scan and on the template (or the reverse), N >= 4.
    maximum_residual : float
        Median residual, as a fraction of the target landmarks' extent, above which they do not fit.

    Raises
    ------
    InputError
        Fewer than four landmarks.
    RegistrationError
        The landmarks do not fit, or fit far better as a mirror image (left and right are swapped).
    """
    if len(source) < 4 or source.shape != target.shape:
        raise InputError(f"landmarks: {len(source)} usable, at least 4 are needed ({', '.join(names)})")
    fit, residual = _reweighted_similarity(source, target)
    mirror = np.array([-1.0, 1.0, 1.0])
    _, mirrored = _reweighted_similarity(source * mirror, target)
    extent = float(np.linalg.norm(np.ptp(target, axis=0)))
    median = float(np.median(residual))
    if float(np.median(mirrored)) < 0.5 * median and median > 0.02 * extent:
        raise RegistrationError(
            f"landmarks fit as a mirror image only (median residual {median / extent:.1%} of their extent, "
            f"mirrored {np.median(mirrored) / extent:.1%}): left and right are swapped"
        )
    if median > maximum_residual * extent:
        worst = names[int(np.argmax(residual))]
        raise RegistrationError(
            f"landmarks do not fit the template: median residual {median / extent:.1%} of their extent, worst {worst}"
        )
    return fit, residual


def _reweighted_similarity(source: Floats, target: Floats, steps: int = 20) -> tuple[Similarity, Floats]:
    weight = np.ones(len(source))
    fit = estimate_similarity(source, target, weight)
    for _ in range(steps):
        residual = np.linalg.norm(fit.apply(source) - target, axis=1)
        spread = max(float(np.median(residual)), 1e-12)
        weight = 1.0 / (1.0 + (residual / (2.0 * spread)) ** 2)
        fit = estimate_similarity(source, target, weight)
    return fit, np.linalg.norm(fit.apply(source) - target, axis=1)
