"""Texture flow: where the skin of the neutral went on a pose's mesh, by dense optical flow between textures."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capture_eval.registration.texture_atlas import TextureAtlas
from capture_eval.registration.texture_baking import BakedTexture


@dataclass(frozen=True)
class FlowConstraints:
    """Points of the neutral's surface and where their skin is on the pose's mesh.

    The solver pulls the material point (``triangle``, ``barycentric``) of the pose's mesh to ``target`` within
    the tangent plane (the target lies on the pose's present mesh: it says nothing about the normal direction).

    Parameters
    ----------
    triangle : (M,) int64
    barycentric : (M, 3) float64
    target : (M, 3) float64
        Position on the pose's mesh that shows the same skin, in the frame of the pose's vertices.
    weight : (M,) float64
        0..1 from texture strength, correlation and forward/backward agreement.
    """

    triangle: NDArray[np.int64]
    barycentric: NDArray[np.float64]
    target: NDArray[np.float64]
    weight: NDArray[np.float64]


@dataclass(frozen=True)
class FlowOptions:
    """Options of :func:`texture_flow`; lengths in texels of the atlas."""

    normalisation_sigma: float = 8.0
    consistency: float = 0.6
    minimum_correlation: float = 0.6
    border_margin: float = 4.0
    step: int = 3


def texture_flow(
    neutral: BakedTexture,
    pose: BakedTexture,
    atlas: TextureAtlas,
    pose_vertices: NDArray[np.float64],
    triangles: NDArray[np.int64],
    options: FlowOptions | None = None,
) -> FlowConstraints:
    """Dense flow from the neutral's texture to a pose's texture (both baked in the same ``atlas``).

    For the first round pass ``FlowOptions(consistency=1.2)``.
    """
    raise NotImplementedError
