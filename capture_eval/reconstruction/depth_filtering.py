"""Depth maps made consistent: what other photos do not confirm is removed, what they confirm is averaged.

A pixel survives when enough other depth maps meet the same surface; its depth becomes the weighted mean of the depths
at which its ray meets their planes.  This removes what has no texture (a plain backdrop gives depths that agree with
nobody) and the fringe that correlation windows leave beyond a silhouette (its depth depends on the photo).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capture_eval.errors import InputError

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]


@dataclass(frozen=True)
class FilterOptions:
    """What counts as the same surface.

    Parameters
    ----------
    least_supporters : int
        Other depth maps that must agree.
    relative_tolerance : float
        Largest difference of depth along the ray, as a share of the depth.
    normal_tolerance : float
        Largest angle between the normals, degrees.
    minimum_likeness : float
        Smallest mean NCC of a pixel.
    """

    least_supporters: int = 2
    relative_tolerance: float = 0.004
    normal_tolerance: float = 40.0
    minimum_likeness: float = 0.4


@dataclass(frozen=True)
class DepthMap:
    """A depth map and the camera it belongs to.

    Parameters
    ----------
    depth : (H, W) float32
        0 where nothing is known.
    normal : (H, W, 3) float32
        Camera frame.
    weight : (H, W) float32
        Inverse variance of the depth or any other positive worth; 0 where nothing is known.
    matrix, rotation, translation : (3, 3), (3, 3), (3,) float64
        Calibration (centre of the top-left pixel at (0.5, 0.5)) and view_from_world.
    """

    depth: Singles
    normal: Singles
    weight: Singles
    matrix: Floats
    rotation: Floats
    translation: Floats

    def __post_init__(self) -> None:
        if self.normal.shape != (*self.depth.shape, 3) or self.weight.shape != self.depth.shape:
            raise InputError(f"depth map {self.depth.shape}, normals {self.normal.shape}, weights {self.weight.shape}")


@dataclass(frozen=True)
class ConsistentDepth:
    """A filtered depth map.

    Parameters
    ----------
    depth, normal : (H, W), (H, W, 3) float32
        0 where removed.
    supporters : (H, W) uint8
        Other maps that agreed.
    weight : (H, W) float32
        Sum of the weights that were averaged.
    """

    depth: Singles
    normal: Singles
    supporters: NDArray[np.uint8]
    weight: Singles


def make_consistent(reference: DepthMap, others: Sequence[DepthMap], options: FilterOptions) -> ConsistentDepth:
    """Keep and average what `others` confirm in `reference`."""
    from capture_eval.reconstruction.depth_filtering_kernels import OtherMap, Sums, support_rows

    shape = reference.depth.shape
    worth = reference.weight.astype(np.float64)
    sums = Sums(
        agree=np.zeros(shape, np.int32),
        through=np.zeros(shape, np.int32),
        weight=worth,
        depth=worth * reference.depth,
        normal=worth[..., None] * reference.normal,
    )
    inverse = np.linalg.inv(reference.matrix)
    least_cosine = float(np.cos(np.radians(options.normal_tolerance)))
    for other in others:
        rotation = np.ascontiguousarray(other.rotation @ reference.rotation.T)
        translation = other.translation - rotation @ reference.translation
        asked = OtherMap(other.depth, other.normal, other.weight, other.matrix, rotation, translation)
        support_rows(
            np.array([0, shape[0]]),
            reference.depth,
            reference.normal,
            inverse,
            asked,
            options.relative_tolerance,
            least_cosine,
            sums,
        )
    needed = min(options.least_supporters, len(others))
    kept = (reference.depth > 0) & (sums.agree >= needed) & (sums.through <= sums.agree) & (sums.weight > 0)
    length = np.maximum(np.linalg.norm(sums.normal, axis=2), 1e-300)
    return ConsistentDepth(
        depth=np.where(kept, sums.depth / np.where(kept, sums.weight, 1.0), 0.0).astype(np.float32),
        normal=np.where(kept[..., None], sums.normal / length[..., None], 0.0).astype(np.float32),
        supporters=np.where(kept, np.minimum(sums.agree, 255), 0).astype(np.uint8),
        weight=np.where(kept, sums.weight, 0.0).astype(np.float32),
    )


def points_of_depth(depth: Singles, normal: Singles, view: DepthMap) -> tuple[Floats, Floats]:
    """World points and normals (N, 3) of the pixels with a depth, row by row."""
    rows, columns = np.nonzero(depth > 0)
    pixels = np.stack([columns + 0.5, rows + 0.5, np.ones(len(rows))])
    local = (np.linalg.inv(view.matrix) @ pixels) * depth[rows, columns].astype(np.float64)
    points = (local - view.translation[:, None]).T @ view.rotation
    return np.asarray(points), np.asarray(normal[rows, columns].astype(np.float64) @ view.rotation)
