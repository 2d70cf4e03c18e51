"""How far each vertex of a registered mesh can be trusted, from what measured it.

Lengths are in the frame in which the template is 300 units large.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capture_eval.registration.deformation_solver import SurfaceConstraints
from capture_eval.registration.texture_rounds import vertex_sums
from capture_eval.triangle_geometry import triangle_areas

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


@dataclass(frozen=True)
class ConfidenceOptions:
    """When a vertex counts as fully measured.

    Parameters
    ----------
    full_density : float
        Density of constraints, relative to the median over all measured vertices, that is enough.
    residual_scale : float
        Residual at which confidence falls to a half.
    least_photos : int
        Vertices seen in fewer photos have no confidence.
    """

    full_density: float = 0.5
    residual_scale: float = 0.3
    least_photos: int = 3


@dataclass(frozen=True)
class VertexQuality:
    """Quality of one pose.

    Parameters
    ----------
    confidence : (V,) float64
        In [0, 1].
    residual : (V,) float64
        Mean distance that the constraints around a vertex still complain about; NaN where nothing measured.
    seen : (V,) bool
        In at least three photos.
    """

    confidence: Floats
    residual: Floats
    seen: NDArray[np.bool_]


def vertex_quality(
    vertices: Floats,
    triangles: Integers,
    flow: SurfaceConstraints | None,
    stereo: SurfaceConstraints | None,
    fallback: SurfaceConstraints | None,
    photo_count: Integers,
    skin: NDArray[np.bool_],
    options: ConfidenceOptions,
) -> VertexQuality:
    """Confidence from density and residuals of the measurements around each vertex.

    Parameters
    ----------
    flow, stereo : SurfaceConstraints or None
        Of the last round; None where that kind of measurement does not exist (the neutral has no flow).
    fallback : SurfaceConstraints or None
        Scan planes, used for the residual where nothing else measured.
    photo_count : (V,) int
        Photos that see each vertex.
    """
    count = len(vertices)
    area = vertex_areas(vertices, triangles)
    confidence = np.ones(count)
    squared = np.zeros(count)
    known = np.zeros(count, dtype=np.bool_)
    for rows in (flow, stereo):
        if rows is None:
            continue
        total = vertex_sums(rows, count)
        density = total / np.maximum(area, 1e-300)
        typical = float(np.median(density[total > 0])) if np.any(total > 0) else 1.0
        confidence *= np.clip(density / (options.full_density * typical), 0.0, 1.0)
        mean = np.divide(
            vertex_sums(rows, count, rows.residuals(vertices)), total, out=np.zeros(count), where=total > 0
        )
        squared += mean**2
        known |= total > 0
    if flow is None and stereo is None:
        confidence *= 0.5
    if fallback is not None:
        total = vertex_sums(fallback, count)
        mean = np.divide(
            vertex_sums(fallback, count, fallback.residuals(vertices)), total, out=np.zeros(count), where=total > 0
        )
        squared = np.where(known, squared, mean**2)
        known |= total > 0
    residual = np.where(known, np.sqrt(squared), np.nan)
    seen = photo_count >= options.least_photos
    confidence *= 1.0 / (1.0 + (np.nan_to_num(residual) / options.residual_scale) ** 2)
    return VertexQuality(np.where(seen & skin & known, confidence, 0.0), residual, seen)


def vertex_areas(vertices: Floats, triangles: Integers) -> Floats:
    """A third of the area of the triangles around each vertex, (V,)."""
    share = triangle_areas(vertices, triangles) / 3.0
    total = np.zeros(len(vertices))
    for corner in range(3):
        total += np.bincount(triangles[:, corner], share, minlength=len(vertices))
    return total
