"""Texture-space multi-view stereo: how far the true surface is from a registered mesh, along its normals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capture_eval.cameras import View
from capture_eval.registration.texture_atlas import TextureAtlas


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

    triangle: NDArray[np.int64]
    barycentric: NDArray[np.float64]
    normal: NDArray[np.float64]
    offset: NDArray[np.float64]
    weight: NDArray[np.float64]
    score: NDArray[np.float64]


@dataclass(frozen=True)
class StereoOptions:
    """Options of :func:`texture_stereo`; sigmas in texels of the atlas."""

    offsets: int = 11
    minimum_cosine: float = 0.25
    views: int = 16
    high_pass_sigma: float = 3.5
    window_sigma: float = 1.7
    minimum_score: float = 0.35
    step: int = 1


def texture_stereo(
    vertices: NDArray[np.float64],
    triangles: NDArray[np.int64],
    atlas: TextureAtlas,
    views: Sequence[View],
    images: Sequence[NDArray[np.uint8]],
    half_range: float,
    occluders: tuple[NDArray[np.float64], NDArray[np.int64]] | None = None,
    options: StereoOptions | None = None,
) -> OffsetConstraints:
    """Photo-consistent offsets along the normals in ``[-half_range, half_range]`` (units of the frame).

    The caller shrinks the range from round to round: 0.5 %, 0.27 %, 0.17 % of D in the study; atlas of 512.
    """
    raise NotImplementedError
