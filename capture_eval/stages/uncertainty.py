"""Error bars of the register stage: repeats the last texture round by halves of the photos, and the neutral's fit with
jittered landmarks."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from capture_eval.errors import CaptureEvalError
from capture_eval.files.colmap_files import read_sparse_model
from capture_eval.files.landmark_files import read_landmarks
from capture_eval.registration.deformation_solver import DeformationSolver
from capture_eval.registration.error_bar import ErrorBarOptions, error_bar
from capture_eval.registration.landmark_triangulation import triangulate_point
from capture_eval.registration.lifted_matches import MaterialMatches
from capture_eval.registration.nonrigid_icp import WORKING_SIZE, Landmarks, fit_template
from capture_eval.registration.registration_spread import (
    LEAST_PHOTOS,
    half_difference_spread,
    repeat_by_halves,
    repeat_spread,
)
from capture_eval.registration.surface_correspondence import Surface
from capture_eval.registration.texture_baking import BakedTexture
from capture_eval.registration.texture_rounds import PhotoSet, RoundOptions, TextureAtlases
from capture_eval.similarity import Similarity
from capture_eval.triangle_geometry import diameter

if TYPE_CHECKING:
    from capture_eval.stages.register_options import RegisterOptions
    from capture_eval.stages.registration_inputs import Template

logger = logging.getLogger("capture_eval.register")

Floats = NDArray[np.float64]
Booleans = NDArray[np.bool_]


@dataclass(frozen=True)
class UncertaintyOptions:
    """Options of the error bars.

    Attributes
    ----------
    photo_halves : bool
        Repeat every pose's last texture round with each half of its photos. Without it there are no error bars.
    landmark_repeats : int
        Fits of the neutral with jittered landmarks; 0 leaves them out.
    landmark_jitter : float or None
        Pixels; by default what the landmarks' own photos disagree by.
    seed : int
        Of the jitter.
    bars : ErrorBarOptions
    """

    photo_halves: bool = True
    landmark_repeats: int = 2
    landmark_jitter: float | None = None
    seed: int = 0
    bars: ErrorBarOptions = field(default_factory=ErrorBarOptions)


def photo_half_spread(
    solver: DeformationSolver,
    vertices: Floats,
    skin: Booleans,
    photos: PhotoSet,
    atlases: TextureAtlases,
    neutral_texture: BakedTexture | None,
    scan: Surface | None,
    matches: MaterialMatches | None,
    rounds: RoundOptions,
    options: UncertaintyOptions,
    settle: Callable[[Floats], Floats] | None = None,
) -> Floats:
    """Random error of each vertex (V,) from two halves of the photos; NaN where they are too few or it is switched off.

    Parameters
    ----------
    settle : function, optional
        What happens to a pose after its texture rounds; the halves get the same.
    """
    unknown = np.full(len(vertices), np.nan)
    if not options.photo_halves:
        return unknown
    if len(photos.views) < LEAST_PHOTOS:
        logger.info("register: no error bars, %d photos are too few for two halves", len(photos.views))
        return unknown
    halves = repeat_by_halves(solver, vertices, skin, photos, atlases, neutral_texture, scan, matches, rounds)
    first, second = halves if settle is None else (settle(half) for half in halves)
    return half_difference_spread(first, second, solver.operators.triangles)


def neutral_landmark_spread(
    neutral: Path,
    landmarks: Path,
    parts: Template,
    working: Similarity,
    skin: Booleans,
    scan: Surface,
    scan_trust: Floats,
    fitted: Floats,
    options: RegisterOptions,
) -> Floats:
    """How far the fitted neutral (V, 3) slides along itself when its landmarks move, (V,), working units.

    Root mean square tangential distance of the fits with jittered landmarks from the fit itself; NaN without repeats.
    It says which skin point a template vertex stands for. The evaluation is not affected: every pose follows that same
    skin point.
    """
    placed = jittered_landmarks(neutral, landmarks, working, len(parts.mesh.vertices), options.uncertainty)
    if not placed:
        return np.full(len(fitted), np.nan)
    rest = parts.working_from_head.apply(parts.mesh.vertices)
    repeats = [
        fit_template(rest, parts.triangles, skin, scan, one, options.neutral, scan_trust).vertices for one in placed
    ]
    return repeat_spread(fitted, repeats, parts.triangles)


def spread_figures(spread: Floats, mask: Booleans) -> dict[str, float | None]:
    """Median and p95 as fractions of D; None where nothing is known."""
    known = spread[mask & np.isfinite(spread)] / WORKING_SIZE
    if known.size == 0:
        return {"median": None, "p95": None}
    return {"median": float(np.median(known)), "p95": float(np.quantile(known, 0.95))}


def jittered_landmarks(
    neutral: Path, path: Path, working_from_neutral: Similarity, vertex_count: int, options: UncertaintyOptions
) -> list[Landmarks]:
    """The landmarks placed again from pixels with Gaussian noise, in the working frame, once per repeat.

    Landmarks given as points in space have no pixels and stay; so do those that cannot be placed.
    """
    if options.landmark_repeats <= 0:
        return []
    views = read_sparse_model(neutral / "sparse").views
    entries = read_landmarks(path, vertex_count)
    places = []
    for entry in entries:
        try:
            places.append(None if entry.point is not None else triangulate_point(views, entry.photos))
        except CaptureEvalError:
            places.append(None)
    errors = [place.reprojection_error for place in places if place is not None]
    if not errors:
        return []
    jitter = options.landmark_jitter or float(np.sqrt(np.mean(np.square(errors))))
    random = np.random.default_rng(options.seed)
    result = []
    for _ in range(options.landmark_repeats):
        vertices, points = [], []
        for entry, place in zip(entries, places, strict=True):
            if entry.point is not None:
                vertices.append(entry.vertex)
                points.append(entry.point)
            elif place is not None:
                pixels = {name: entry.photos[name] + random.normal(0.0, jitter, 2) for name in place.photos}
                vertices.append(entry.vertex)
                points.append(triangulate_point(views, pixels, np.inf).position)
        index = np.array(vertices, dtype=np.int64)
        result.append(Landmarks(index, working_from_neutral.apply(np.array(points)), np.ones(len(index))))
    logger.info("register neutral: landmarks jittered by %.2f pixels, %d times", jitter, len(result))
    return result


def bar_arrays(
    vertices: Floats, spread: Floats, confidence: Floats, seen: Booleans, options: UncertaintyOptions
) -> dict[str, NDArray[Any]]:
    """Arrays for ``registered.npz``: `spread`, `error_bar` and `motion_bar` (P, V), 95 %, in head units.

    NaN where the spread is unknown or too few photos see the vertex; the neutral has no motion and no error of it.
    """
    if not np.isfinite(spread).any():
        return {}
    size = diameter(vertices[0])
    known = np.where(seen, spread, np.nan)
    position = error_bar(known, confidence, size, options.bars.position)
    motion = error_bar(known, np.minimum(confidence, confidence[0]), size, options.bars.motion)
    motion[0] = np.where(np.isfinite(motion[0]), 0.0, np.nan)
    return {"spread": spread, "error_bar": position, "motion_bar": motion}
