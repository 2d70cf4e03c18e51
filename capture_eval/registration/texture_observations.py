"""Where each photo shows the points of a registered mesh, to a twentieth of a pixel, by the mesh's own texture.

A photo's texture is compared with the blend of all the other photos. What is left between them comes from the
camera and from the surface; feature points tell either only to a third of a pixel.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capture_eval.cameras import View
from capture_eval.registration.photo_visibility import Blockers, clear_of_edges, depth_tolerance, visible_points
from capture_eval.registration.texture_atlas import TextureAtlas
from capture_eval.registration.texture_baking import check_photos, grey_photo, smooth_normals
from capture_eval.registration.texture_flow import (
    distance_to_holes,
    local_normalisation,
    refine_flow,
    texture_strength,
    warp,
    windowed_correlation,
)

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Picture = NDArray[np.float32]


@dataclass(frozen=True)
class PhotoObservations:
    """Pixels at which one photo shows material points.

    Parameters
    ----------
    point : (M,) int64
        Index into the points of :class:`TextureObservations`.
    pixel : (M, 2) float64
    weight : (M,) float64
        0..1 from texture strength and correlation.
    """

    point: Integers
    pixel: Floats
    weight: Floats


@dataclass(frozen=True)
class TextureObservations:
    """Material points of a mesh and where the photos show them.

    Parameters
    ----------
    points : (N, 3) float64
        Places of the points on the mesh.
    photos : tuple of PhotoObservations
        One for each view.
    """

    points: Floats
    photos: tuple[PhotoObservations, ...]


@dataclass(frozen=True)
class ObservationOptions:
    """Options of :func:`observe_texture`; lengths in texels.

    Parameters
    ----------
    minimum_cosine : float
    edge_margin : int
        Pixels beside occluding edges that are not used.
    window_sigma : float
        Width of the windows in which a photo is shifted against the blend.
    largest_shift : float
    minimum_correlation : float
    border_margin : float
    step : int
        Every step-th row and column of the atlas becomes a point.
    """

    minimum_cosine: float = 0.35
    edge_margin: int = 2
    window_sigma: float = 5.0
    largest_shift: float = 2.0
    minimum_correlation: float = 0.7
    border_margin: float = 5.0
    step: int = 4


def observe_texture(
    vertices: Floats,
    triangles: Integers,
    atlas: TextureAtlas,
    views: Sequence[View],
    images: Sequence[NDArray[np.uint8]],
    occluders: Blockers | None = None,
    options: ObservationOptions | None = None,
) -> TextureObservations:
    """Find the points of a mesh in its photos by shifting every photo's texture against all the others'.

    Parameters
    ----------
    vertices : (V, 3) float64
        Right to about a pixel's width; drift along the skin does not matter, since all photos are of one pose.
    triangles : (K, 3) int64
    atlas : TextureAtlas
        With texels about as large as the photos' pixels on the skin.
    views, images : sequences
        In the frame of ``vertices``; (H, W, 3) or (H, W) uint8.
    """
    from capture_eval.registration import texture_kernels

    options = options or ObservationOptions()
    check_photos(views, images)
    flat, triangle, barycentric = atlas.covered()
    vertices = np.ascontiguousarray(vertices, dtype=np.float64)
    triangles = np.ascontiguousarray(triangles, dtype=np.int64)
    points = texture_kernels.surface_points(triangle, barycentric, triangles, vertices)
    normals = smooth_normals(triangle, barycentric, triangles, vertices)
    tolerance = depth_tolerance(vertices)
    samples = np.zeros((len(views), len(flat)), dtype=np.float32)
    weights = np.zeros((len(views), len(flat)), dtype=np.float32)
    pixels = np.zeros((len(views), len(flat), 2), dtype=np.float32)
    for index, (view, image) in enumerate(zip(views, images, strict=True)):
        depth = clear_of_edges(view, vertices, triangles, occluders, options.edge_margin)
        cosine, pixels[index] = visible_points(view, depth, points, normals, options.minimum_cosine, tolerance)
        unused = np.zeros(len(flat), dtype=np.int16)
        texture_kernels.blend_photo(
            grey_photo(image)[:, :, None], cosine, pixels[index], 2.0, samples[index, :, None], weights[index], unused
        )
    row, column = np.divmod(flat, atlas.size)
    chosen = np.flatnonzero((row % options.step == 0) & (column % options.step == 0))
    sums = samples.sum(axis=0), weights.sum(axis=0)
    photos = tuple(
        _observe_photo(atlas, flat, chosen, samples[index], weights[index], pixels[index], sums, options)
        for index in range(len(views))
    )
    return TextureObservations(points[chosen], photos)


def _observe_photo(
    atlas: TextureAtlas,
    flat: Integers,
    chosen: Integers,
    samples: Picture,
    weights: Picture,
    pixels: Picture,
    sums: tuple[Picture, Picture],
    options: ObservationOptions,
) -> PhotoObservations:
    """Shift one photo's texture against the blend of the others; ``samples`` are weighted sums."""
    size = atlas.size
    known = (weights > 0) & (sums[1] - weights > 0.8)  # at least one other photo from nearly straight ahead, or two
    own, others = np.zeros(size * size, dtype=np.float32), np.zeros(size * size, dtype=np.float32)
    own[flat[known]] = samples[known] / weights[known]
    others[flat[known]] = (sums[0][known] - samples[known]) / (sums[1][known] - weights[known])
    mask = np.zeros(size * size, dtype=np.bool_)
    mask[flat[known]] = True
    known_there = mask.reshape(size, size)
    place = np.zeros((size * size, 2), dtype=np.float32)
    place[flat] = pixels
    first = local_normalisation(others.reshape(size, size), known_there, 5.0)
    second = local_normalisation(own.reshape(size, size), known_there, 5.0)
    flow = refine_flow(first, second, np.zeros((size, size, 2), dtype=np.float32), options.window_sigma, 3)
    correlation = windowed_correlation(first, warp(second, flow), known_there.astype(np.float32), 4.0)
    strength = texture_strength(first)
    distance = np.minimum(distance_to_holes(known_there), atlas.border_distance)
    good = (distance > options.border_margin) & (correlation > options.minimum_correlation)
    good &= np.linalg.norm(flow, axis=-1) < options.largest_shift
    texel = flat[chosen]
    point = np.flatnonzero(good.reshape(-1)[texel])
    texel = texel[point]
    moved = warp(place.reshape(size, size, 2), flow).reshape(-1, 2)[texel]
    span = 1.0 - options.minimum_correlation
    weight = (correlation.reshape(-1)[texel] - options.minimum_correlation) / span * 0.75 + 0.25
    weight *= strength.reshape(-1)[texel] / (strength.reshape(-1)[texel] + 0.004)
    return PhotoObservations(point, moved.astype(np.float64), weight.astype(np.float64))
