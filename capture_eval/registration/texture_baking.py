"""Texture baking: all photos of a pose, blended onto its mesh in the UV layout."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capture_eval.cameras import View
from capture_eval.registration.texture_atlas import TextureAtlas


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
    """Options of :func:`bake_texture`; lengths are in the frame's units."""

    cosine_power: float = 6.0
    minimum_cosine: float = 0.15
    minimum_views: int = 2
    colour: bool = False


def bake_texture(
    vertices: NDArray[np.float64],
    triangles: NDArray[np.int64],
    atlas: TextureAtlas,
    views: Sequence[View],
    images: Sequence[NDArray[np.uint8]],
    occluders: tuple[NDArray[np.float64], NDArray[np.int64]] | None = None,
    options: BakingOptions | None = None,
) -> BakedTexture:
    """Blend all photos of a pose onto its mesh.

    ``views`` are in the frame of ``vertices``; ``images`` are the photos as taken (distorted, (H, W, 3) RGB or
    (H, W) grey); ``occluders`` are (vertices, triangles) of things that hide the skin without being part of it.
    """
    raise NotImplementedError
