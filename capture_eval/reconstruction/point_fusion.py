"""Many depth maps become one cloud: points that fall into one small cell are averaged by their worth."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capture_eval.errors import InputError

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class PointCloud:
    """Points with normals and what is known about each.

    Parameters
    ----------
    points, normals : (N, 3) float64
        World; unit normals.
    weight : (N,) float64
        Sum of inverse variances of the depths that were averaged, 1 / world unit squared.
    supporters : (N,) float64
        Photos that agreed on the point (mean of the cell).
    """

    points: Floats
    normals: Floats
    weight: Floats
    supporters: Floats

    def __post_init__(self) -> None:
        count = len(self.points)
        if self.points.shape != (count, 3) or self.normals.shape != (count, 3):
            raise InputError(f"point cloud: points {self.points.shape}, normals {self.normals.shape}")
        if self.weight.shape != (count,) or self.supporters.shape != (count,):
            raise InputError(f"point cloud: weights {self.weight.shape}, supporters {self.supporters.shape}")


def concatenate(clouds: list[PointCloud]) -> PointCloud:
    """All points of several clouds, in order."""
    return PointCloud(
        np.concatenate([cloud.points for cloud in clouds]),
        np.concatenate([cloud.normals for cloud in clouds]),
        np.concatenate([cloud.weight for cloud in clouds]),
        np.concatenate([cloud.supporters for cloud in clouds]),
    )


def average_in_cells(cloud: PointCloud, spacing: float) -> PointCloud:
    """One point per cubic cell of edge `spacing`: the weighted mean of the points in it.

    The order of the result is that of the cells, so it does not depend on the order of the photos beyond rounding.

    Raises
    ------
    InputError
        A spacing that is not positive.
    """
    if not spacing > 0:
        raise InputError(f"point fusion: spacing {spacing}, expected a positive length")
    if len(cloud.points) == 0:
        return cloud
    cells = np.floor((cloud.points - cloud.points.min(axis=0)) / spacing).astype(np.int64)
    size = cells.max(axis=0) + 1
    keys = (cells[:, 0] * size[1] + cells[:, 1]) * size[2] + cells[:, 2]
    order = np.argsort(keys, kind="stable")
    starts = np.concatenate([[0], np.nonzero(np.diff(keys[order]))[0] + 1])
    weight = cloud.weight[order]
    total = np.add.reduceat(weight, starts)
    safe = np.maximum(total, 1e-300)

    def mean(values: Floats) -> Floats:
        return np.asarray(np.add.reduceat(values[order] * weight[:, None], starts, axis=0) / safe[:, None])

    normals = mean(cloud.normals)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    supporters = mean(cloud.supporters[:, None])[:, 0]
    return PointCloud(mean(cloud.points), normals, total, supporters)
