"""Texture-space multi-view stereo: how far the photographed surface is from a registered mesh, along its normals.

Patches follow the mesh instead of lying in planes, and all photos that see a texel vote together: both take away
the recession of convex skin that window-based stereo between pairs of photos has.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capture_eval.cameras import View
from capture_eval.errors import InputError
from capture_eval.registration.photo_visibility import (
    Blockers,
    camera_numbers,
    clear_of_edges,
    depth_tolerance,
    visible_points,
)
from capture_eval.registration.texture_atlas import TextureAtlas
from capture_eval.registration.texture_baking import check_photos, grey_photo, smooth_normals

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Picture = NDArray[np.float32]


@dataclass(frozen=True)
class OffsetConstraints:
    """Measured offsets of the photographed surface from the mesh.

    Parameters
    ----------
    triangle : (M,) int64
    barycentric : (M, 3) float64
    normal : (M, 3) float64
        Unit normal along which the offset was measured (interpolated vertex normals).
    offset : (M,) float64
        Signed distance along ``normal``; the plane constraint is ``normal . x = normal . (point + offset normal)``.
    weight : (M,) float64
        0..1 from score and sharpness.
    score : (M,) float64
        Photo consistency of all views at the offset, in [-1, 1].
    """

    triangle: Integers
    barycentric: Floats
    normal: Floats
    offset: Floats
    weight: Floats
    score: Floats


@dataclass(frozen=True)
class StereoOptions:
    """Options of :func:`texture_stereo`; sigmas in texels of the atlas.

    Parameters
    ----------
    offsets : int
        Number of offsets tried, odd.
    minimum_cosine : float
        Views that meet the surface at a lower cosine have no vote.
    views : int
        At most so many views vote at a texel, those that face it most.
    minimum_views : int
        Texels with fewer votes give no constraint.
    cosine_power : float
        Views weigh cosine^power.
    high_pass_sigma : float
        Brightness that varies more slowly than this on the skin is shading and is removed per view.
    window_sigma : float
        Width of the Gaussian window in which the views are compared.
    minimum_score : float
        Least photo consistency.
    edge_margin : int
        A photo has no vote within so many pixels of an occluding edge (lips, lids, nostrils, silhouettes).
    border_margin : float
        Texels nearer to a chart's border are not used.
    step : int
        Return every step-th row and column.
    """

    offsets: int = 11
    minimum_cosine: float = 0.25
    views: int = 16
    minimum_views: int = 4
    cosine_power: float = 1.0
    high_pass_sigma: float = 2.5
    window_sigma: float = 1.7
    minimum_score: float = 0.35
    edge_margin: int = 2
    border_margin: float = 1.0
    step: int = 1


@dataclass(frozen=True)
class OffsetField:
    """Stereo result per covered texel (M,), in the order of ``TextureAtlas.covered``; NaN where nothing was found.

    Parameters
    ----------
    offset : (M,) float64
        Units of the frame.
    score : (M,) float64
    sharpness : (M,) float64
        Bend of the score at its top, per squared texel length.
    normal : (M, 3) float64
    """

    offset: Floats
    score: Floats
    sharpness: Floats
    normal: Floats


def texture_stereo(
    vertices: Floats,
    triangles: Integers,
    atlas: TextureAtlas,
    views: Sequence[View],
    images: Sequence[NDArray[np.uint8]],
    half_range: float,
    occluders: Blockers | None = None,
    options: StereoOptions | None = None,
) -> OffsetConstraints:
    """Photo-consistent offsets along the normals in ``[-half_range, half_range]``.

    The caller shrinks the range from round to round (0.5 %, 0.27 %, 0.17 % of D) and moves the mesh in between.

    Parameters
    ----------
    vertices : (V, 3) float64
    triangles : (K, 3) int64
    atlas : TextureAtlas
        Of the same triangles, with texels about as large as the photos' pixels on the skin (512).
    views : sequence of View
        In the frame of ``vertices``.
    images : sequence of (H, W, 3) or (H, W) uint8
    half_range : float
        Units of the frame.
    occluders : (vertices, triangles), optional
    options : StereoOptions, optional

    Raises
    ------
    InputError
        Photos and views do not fit, or the options make no sense.
    """
    options = options or StereoOptions()
    field = offset_field(vertices, triangles, atlas, views, images, half_range, occluders, options)
    flat, triangle, barycentric = atlas.covered()
    row, column = np.divmod(flat, atlas.size)
    kept = (row % options.step == 0) & (column % options.step == 0) & np.isfinite(field.offset)
    kept &= (field.score > options.minimum_score) & (atlas.border_distance[row, column] > options.border_margin)
    weight = match_weight(field.score[kept], field.sharpness[kept])
    return OffsetConstraints(
        triangle[kept].astype(np.int64),
        barycentric[kept].astype(np.float64),
        field.normal[kept],
        field.offset[kept],
        weight,
        field.score[kept],
    )


def match_weight(score: Floats, sharpness: Floats) -> Floats:
    """Weight (M,) in 0..1 of best matches by the variance that their score and bend predict.

    The variance of a best match is (1 - score) / bend; measured against truth, the error grows with it steadily,
    and 0.7 is its middle on skin. The parabola through the scores may top 1 where they bend sharply.
    """
    doubt = np.maximum(1.0 - score, 0.0) + 0.02
    deviation = np.sqrt(doubt / np.maximum(sharpness, 1e-9))
    return np.asarray(1.0 / (1.0 + (deviation / 0.7) ** 4), dtype=np.float64)


def offset_field(
    vertices: Floats,
    triangles: Integers,
    atlas: TextureAtlas,
    views: Sequence[View],
    images: Sequence[NDArray[np.uint8]],
    half_range: float,
    occluders: Blockers | None,
    options: StereoOptions,
) -> OffsetField:
    """The search of :func:`texture_stereo` at every covered texel."""
    from capture_eval.registration import texture_kernels

    check_photos(views, images)
    if not half_range > 0 or options.offsets < 3 or options.offsets % 2 == 0:
        raise InputError(f"texture stereo: half range {half_range} and {options.offsets} offsets (odd, at least 3)")
    flat, triangle, barycentric = atlas.covered()
    vertices = np.ascontiguousarray(vertices, dtype=np.float64)
    triangles = np.ascontiguousarray(triangles, dtype=np.int64)
    points = texture_kernels.surface_points(triangle, barycentric, triangles, vertices)
    normals = smooth_normals(triangle, barycentric, triangles, vertices)
    votes = _votes(points, normals, vertices, triangles, views, occluders, options)
    offsets = np.linspace(-half_range, half_range, options.offsets)
    sums = np.zeros((3, options.offsets, atlas.size, atlas.size), dtype=np.float32)
    weight_sum = np.zeros((atlas.size, atlas.size), dtype=np.float32)
    for view, image, vote in zip(views, images, votes, strict=True):
        _add_view(view, grey_photo(image), vote, points, normals, flat, offsets, options, sums, weight_sum)
    scores = _scores(sums, weight_sum, options.window_sigma).reshape(options.offsets, -1)[:, flat]
    scores[:, np.count_nonzero(votes, axis=0) < options.minimum_views] = np.nan
    offset, score, sharpness = _peak(scores.astype(np.float64), offsets, _texel_length(points, flat, atlas.size))
    return OffsetField(offset, score, sharpness, normals)


def _votes(
    points: Floats,
    normals: Floats,
    vertices: Floats,
    triangles: Integers,
    views: Sequence[View],
    occluders: Blockers | None,
    options: StereoOptions,
) -> Picture:
    """Weight of every view at every texel, (views, M); 0 where it has no vote."""
    tolerance = depth_tolerance(vertices)
    cosines = np.empty((len(views), len(points)), dtype=np.float32)
    for row, view in enumerate(views):
        depth = clear_of_edges(view, vertices, triangles, occluders, options.edge_margin)
        cosines[row] = visible_points(view, depth, points, normals, options.minimum_cosine, tolerance)[0]
    if len(views) > options.views:
        least = np.partition(cosines, len(views) - options.views, axis=0)[len(views) - options.views]
        cosines[cosines < least] = 0.0
    return np.where(cosines > 0, cosines**options.cosine_power, np.float32(0.0)).astype(np.float32)


def _add_view(
    view: View,
    photo: Picture,
    vote: Picture,
    points: Floats,
    normals: Floats,
    flat: Integers,
    offsets: Floats,
    options: StereoOptions,
    sums: Picture,
    weight_sum: Picture,
) -> None:
    """Add one view's high-passed samples to ``sums`` and its weights to ``weight_sum`` (both in place)."""
    import cv2

    from capture_eval.registration import texture_kernels

    chosen = np.flatnonzero(vote > 0).astype(np.int32)
    if chosen.size == 0:
        return
    size = weight_sum.shape[0]
    rows, columns = np.divmod(flat[chosen], size)
    top, left = int(rows.min()), int(columns.min())
    height, width = int(rows.max()) - top + 1, int(columns.max()) - left + 1
    places = ((rows - top) * width + columns - left).astype(np.int32)
    weights = np.zeros((height, width), dtype=np.float32)
    weights.reshape(-1)[places] = vote[chosen]
    known = (weights > 0).astype(np.float32)
    share = np.maximum(cv2.GaussianBlur(known, (0, 0), options.high_pass_sigma), 1e-6)
    # Beside the border of what this view sees the mean is one-sided and would vote for a false offset.
    weights *= np.clip(2.0 * share - 1.0, 0.0, 1.0)
    sampled = np.zeros((len(offsets), height * width), dtype=np.float32)
    texture_kernels.sample_offsets(camera_numbers(view), photo, points, normals, chosen, places, offsets, sampled)
    box = (slice(top, top + height), slice(left, left + width))
    weight_sum[box] += weights
    for index in range(len(offsets)):
        picture = sampled[index].reshape(height, width)
        mean = cv2.GaussianBlur(picture, (0, 0), options.high_pass_sigma) / share
        texture_kernels.add_high_pass(picture, mean, weights, sums[(slice(None), index, *box)])


def _scores(sums: Picture, weight_sum: Picture, sigma: float) -> Picture:
    """Sum of the pairwise covariances over the sum of the pairwise energies in Gaussian windows, (O, S, S).

    With votes w and samples h, the sum over pairs i != j of w_i w_j h_i h_j is S^2 - A, and that of
    w_i w_j (h_i^2 + h_j^2) / 2 is W B - A, where S = sum w h, A = sum w^2 h^2, B = sum w h^2, W = sum w.
    """
    import cv2

    scores = np.empty(sums.shape[1:], dtype=np.float32)
    for index in range(sums.shape[1]):
        total, squares, energy = sums[0, index], sums[1, index], sums[2, index]
        covariance = cv2.GaussianBlur(total * total - squares, (0, 0), sigma)
        reference = cv2.GaussianBlur(weight_sum * energy - squares, (0, 0), sigma)
        scores[index] = covariance / np.maximum(reference, 1e-6)
    return scores


def _peak(scores: Floats, offsets: Floats, texel: float) -> tuple[Floats, Floats, Floats]:
    """Best offset by a parabola through the best score and its neighbours; NaN at the ends of the range."""
    spacing = offsets[1] - offsets[0]
    known = np.all(np.isfinite(scores), axis=0)
    best = np.argmax(np.where(known, scores, -np.inf), axis=0)
    inner = known & (best > 0) & (best < len(offsets) - 1)
    middle = np.clip(best, 1, len(offsets) - 2)
    column = np.arange(scores.shape[1])
    below, at, above = (scores[middle + shift, column] for shift in (-1, 0, 1))
    bend = np.where(inner, below - 2.0 * at + above, -1.0)
    bend = np.minimum(bend, -1e-9)
    shift = 0.5 * (below - above) / bend
    offset = np.where(inner, offsets[middle] + shift * spacing, np.nan)
    score = np.where(inner, at - 0.125 * (below - above) ** 2 / bend, np.nan)
    return offset, score, np.where(inner, -bend * (texel / spacing) ** 2, 0.0)


def _texel_length(points: Floats, flat: Integers, size: int) -> float:
    """Median distance on the mesh between horizontal neighbours in the atlas."""
    neighbours = np.flatnonzero((np.diff(flat) == 1) & (flat[1:] % size != 0))
    if neighbours.size == 0:
        return 1.0
    return float(np.median(np.linalg.norm(points[neighbours + 1] - points[neighbours], axis=1)))
