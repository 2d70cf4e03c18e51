"""Depth maps made consistent: what other photos do not confirm is removed, what they confirm is averaged.

A pixel survives when enough other depth maps meet the same surface; its depth becomes the weighted mean of the depths
at which its ray meets their planes.  This removes what has no texture (a plain backdrop gives depths that agree with
nobody) and the fringe that correlation windows leave beyond a silhouette (its depth depends on the photo).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from capture_eval.errors import InputError

if TYPE_CHECKING:
    from capture_eval.reconstruction.depth_filtering_kernels import Sums

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]

# The maps that are averaged compare largely the same photos and smooth over patches of the same size, so their mean is
# more uncertain than that of as many independent ones: by this factor on a head of known shape (MakeHuman identity 0,
# 24 photos of 640x480), where it was found nearly constant from the most to the least certain eighth of the points.
KINSHIP = 2.5


@dataclass(frozen=True)
class FilterOptions:
    """What counts as the same surface.

    Parameters
    ----------
    least_supporters : int
        Other depth maps that must agree.
    pixel_tolerance : float
        Largest difference of depth along the ray, in widths of a pixel at the surface (of the coarser photo).
    normal_tolerance : float
        Largest angle between the normals, degrees.
    minimum_likeness : float
        Smallest mean NCC of a pixel.
    """

    least_supporters: int = 2
    pixel_tolerance: float = 2.0
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
    deviation : (H, W) float32
        Standard deviation, along the ray, of the mean of the depths that were averaged: from their own spread, with
        allowance for what they have in common.
    """

    depth: Singles
    normal: Singles
    supporters: NDArray[np.uint8]
    weight: Singles
    deviation: Singles


def make_consistent(reference: DepthMap, others: Sequence[DepthMap], options: FilterOptions) -> ConsistentDepth:
    """Keep and average what `others` confirm in `reference`.

    The others are asked twice, about the depth of the map and about the mean of the first answers, so that a map that
    is itself a little off is not the judge of the others.
    """
    needed = min(options.least_supporters, len(others))
    first = _ask(reference, reference.depth, others, options)
    kept = (reference.depth > 0) & (first.agree >= needed) & (first.through <= first.agree) & (first.weight > 0)
    share = first.difference / np.where(kept, first.weight, 1.0)
    mean = np.where(kept, reference.depth + share, 0.0).astype(np.float32)
    sums = _ask(reference, mean, others, options)
    kept &= (sums.agree >= needed) & (sums.weight > 0)
    total = np.where(kept, sums.weight, 1.0)
    move = sums.difference / total
    # n maps have n - 1 degrees of freedom, and their mean has a variance n times smaller
    spread = np.maximum(sums.square / total - move**2, 0.0) / np.maximum(sums.agree, 1)
    length = np.maximum(np.linalg.norm(sums.normal, axis=2), 1e-300)
    return ConsistentDepth(
        depth=np.where(kept, mean + move, 0.0).astype(np.float32),
        normal=np.where(kept[..., None], sums.normal / length[..., None], 0.0).astype(np.float32),
        supporters=np.where(kept, np.minimum(sums.agree, 255), 0).astype(np.uint8),
        weight=np.where(kept, sums.weight, 0.0).astype(np.float32),
        deviation=np.where(kept, KINSHIP * np.sqrt(spread), 0.0).astype(np.float32),
    )


def _ask(reference: DepthMap, depth: Singles, others: Sequence[DepthMap], options: FilterOptions) -> "Sums":
    """What the reference itself and the others say about `depth` along the rays of the reference."""
    from capture_eval.reconstruction.depth_filtering_kernels import OtherMap, Sums, support_rows

    shape = reference.depth.shape
    own = reference.depth.astype(np.float64) - depth
    focal = float(reference.matrix[0, 0])
    worth = np.where(np.abs(own) * focal <= options.pixel_tolerance * depth, reference.weight.astype(np.float64), 0.0)
    sums = Sums(
        agree=np.zeros(shape, np.int32),
        through=np.zeros(shape, np.int32),
        weight=worth.copy(),
        difference=worth * own,
        square=worth * own**2,
        normal=worth[..., None] * reference.normal,
    )
    inverse = np.linalg.inv(reference.matrix)
    least_cosine = float(np.cos(np.radians(options.normal_tolerance)))
    for other in others:
        rotation = np.ascontiguousarray(other.rotation @ reference.rotation.T)
        translation = other.translation - rotation @ reference.translation
        asked = OtherMap(other.depth, other.normal, other.weight, other.matrix, rotation, translation)
        tolerance = options.pixel_tolerance / min(focal, float(other.matrix[0, 0]))
        support_rows(np.array([0, shape[0]]), depth, reference.normal, inverse, asked, tolerance, least_cosine, sums)
    return sums


def points_of_depth(depth: Singles, normal: Singles, view: DepthMap) -> tuple[Floats, Floats]:
    """World points and normals (N, 3) of the pixels with a depth, row by row."""
    rows, columns = np.nonzero(depth > 0)
    pixels = np.stack([columns + 0.5, rows + 0.5, np.ones(len(rows))])
    local = (np.linalg.inv(view.matrix) @ pixels) * depth[rows, columns].astype(np.float64)
    points = (local - view.translation[:, None]).T @ view.rotation
    return np.asarray(points), np.asarray(normal[rows, columns].astype(np.float64) @ view.rotation)


def point_deviation(depth: Singles, normal: Singles, spread: Floats, matrix: Floats) -> Floats:
    """Standard deviation (N,) along their normals of the points of a filtered depth map, row by row.

    Parameters
    ----------
    depth, normal : (H, W), (H, W, 3)
        0 where nothing is known; camera frame.
    spread : (H, W)
        Standard deviation along the ray.
    matrix : (3, 3)
        Calibration.
    """
    rows, columns = np.nonzero(depth > 0)
    rays = np.linalg.inv(matrix) @ np.stack([columns + 0.5, rows + 0.5, np.ones(len(rows))])
    lean = np.abs(np.sum(rays.T * normal[rows, columns].astype(np.float64), axis=1))
    return np.asarray(spread[rows, columns] * lean)
