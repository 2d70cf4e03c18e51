"""Texture baking: all photos of a pose, blended onto its mesh in the UV layout."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capture_eval.cameras import View
from capture_eval.errors import InputError
from capture_eval.registration.photo_visibility import Blockers, clear_of_edges, depth_tolerance, visible_points
from capture_eval.registration.texture_atlas import TextureAtlas
from capture_eval.triangle_geometry import vertex_normals

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

LUMINANCE = np.array([0.299, 0.587, 0.114], dtype=np.float32)


@dataclass(frozen=True)
class BakedTexture:
    """Photos of one pose in the UV layout.

    Parameters
    ----------
    image : (S, S) or (S, S, 3) float32
        Blended grey or colour, 0..255; 0 where nothing was seen.
    weight : (S, S) float32
        Sum of the views' weights.
    mask : (S, S) bool
        Texels seen by at least the asked number of views.
    """

    image: NDArray[np.float32]
    weight: NDArray[np.float32]
    mask: NDArray[np.bool_]


@dataclass(frozen=True)
class BakingOptions:
    """Options of :func:`bake_texture`.

    Parameters
    ----------
    cosine_power : float
        Views weigh cosine^power: the steeper, the more a texel is taken from the few views that face it.
    minimum_cosine : float
        Views that meet the surface at a lower cosine are not used.
    minimum_views : int
        Texels seen by fewer views are outside of the mask.
    edge_margin : int
        A photo is not used within so many pixels of an occluding edge, where it mixes two surfaces; 0 for pictures
        that are only to look at.
    colour : bool
        Bake the three channels instead of the luminance.
    """

    cosine_power: float = 6.0
    minimum_cosine: float = 0.15
    minimum_views: int = 2
    edge_margin: int = 2
    colour: bool = False


def bake_texture(
    vertices: Floats,
    triangles: Integers,
    atlas: TextureAtlas,
    views: Sequence[View],
    images: Sequence[NDArray[np.uint8]],
    occluders: Blockers | None = None,
    options: BakingOptions | None = None,
) -> BakedTexture:
    """Blend all photos of a pose onto its mesh.

    Parameters
    ----------
    vertices : (V, 3) float64
    triangles : (K, 3) int64
    atlas : TextureAtlas
        Of the same triangles.
    views : sequence of View
        In the frame of ``vertices``.
    images : sequence of (H, W, 3) or (H, W) uint8
        The photos as taken, with the lens's distortion.
    occluders : (vertices, triangles), optional
        Things that hide the skin without being part of it, in the same frame.
    options : BakingOptions, optional

    Raises
    ------
    InputError
        Photos and views do not fit.
    """
    from capture_eval.registration import texture_kernels

    options = options or BakingOptions()
    check_photos(views, images)
    flat, triangle, barycentric = atlas.covered()
    vertices = np.ascontiguousarray(vertices, dtype=np.float64)
    triangles = np.ascontiguousarray(triangles, dtype=np.int64)
    points = texture_kernels.surface_points(triangle, barycentric, triangles, vertices)
    normals = smooth_normals(triangle, barycentric, triangles, vertices)
    tolerance = depth_tolerance(vertices)
    channels = 3 if options.colour else 1
    colour_sum = np.zeros((len(flat), channels), dtype=np.float32)
    weight_sum = np.zeros(len(flat), dtype=np.float32)
    count = np.zeros(len(flat), dtype=np.int16)
    for view, image in zip(views, images, strict=True):
        depth = clear_of_edges(view, vertices, triangles, occluders, options.edge_margin)
        cosine, pixel = visible_points(view, depth, points, normals, options.minimum_cosine, tolerance)
        photo = colour_photo(image) if options.colour else grey_photo(image)[:, :, None]
        texture_kernels.blend_photo(photo, cosine, pixel, options.cosine_power, colour_sum, weight_sum, count)
    return _to_texture(atlas.size, flat, colour_sum, weight_sum, count >= options.minimum_views, options.colour)


def resized_texture(texture: BakedTexture, size: int) -> BakedTexture:
    """A grey texture at another size: averages of the known texels under each new one, known where most are."""
    import cv2

    def averaged(values: NDArray[np.float32]) -> NDArray[np.float32]:
        return np.asarray(cv2.resize(values, (size, size), interpolation=cv2.INTER_AREA), dtype=np.float32)

    share = averaged(texture.mask.astype(np.float32))
    image = averaged(np.where(texture.mask, texture.image, np.float32(0.0)))
    known = share > 0.5
    image = np.where(known, image / np.maximum(share, np.float32(0.5)), np.float32(0.0))
    return BakedTexture(image, averaged(texture.weight), known)


def grey_photo(image: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Luminance (H, W) float32, 0..255."""
    if image.ndim == 2:
        return np.ascontiguousarray(image, dtype=np.float32)
    return np.ascontiguousarray(image.astype(np.float32) @ LUMINANCE)


def colour_photo(image: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Three channels (H, W, 3) float32, 0..255."""
    if image.ndim == 2:
        return np.repeat(image[:, :, None], 3, axis=2).astype(np.float32)
    return np.ascontiguousarray(image, dtype=np.float32)


def check_photos(views: Sequence[View], images: Sequence[NDArray[np.uint8]]) -> None:
    """Raise InputError unless every view has one photo of the camera's size."""
    if len(views) != len(images):
        raise InputError(f"texture: {len(views)} views but {len(images)} photos")
    for view, image in zip(views, images, strict=True):
        expected = (view.intrinsics.height, view.intrinsics.width)
        if image.shape[:2] != expected or image.ndim not in (2, 3):
            raise InputError(f"texture: photo of view {view.name} is {image.shape}, its camera says {expected}")


def smooth_normals(
    triangle: NDArray[np.int32], barycentric: NDArray[np.float32], triangles: Integers, vertices: Floats
) -> Floats:
    """Unit normals (M, 3) at surface points, interpolated between the vertices' normals."""
    from capture_eval.registration import texture_kernels

    normals = texture_kernels.surface_points(triangle, barycentric, triangles, vertex_normals(vertices, triangles))
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.asarray(normals / np.where(length > 0, length, 1.0), dtype=np.float64)


def _to_texture(
    size: int,
    flat: Integers,
    colour_sum: NDArray[np.float32],
    weight_sum: NDArray[np.float32],
    seen: NDArray[np.bool_],
    colour: bool,
) -> BakedTexture:
    image = np.zeros((size * size, colour_sum.shape[1]), dtype=np.float32)
    weight = np.zeros(size * size, dtype=np.float32)
    mask = np.zeros(size * size, dtype=np.bool_)
    image[flat] = colour_sum / np.maximum(weight_sum, np.float32(1e-20))[:, None]
    weight[flat] = weight_sum
    mask[flat] = seen
    shape = (size, size, 3) if colour else (size, size)
    return BakedTexture(image.reshape(shape), weight.reshape(size, size), mask.reshape(size, size))
