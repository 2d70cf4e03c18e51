"""Many depth maps become one cloud: points that fall into one small cell are averaged by their worth."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capture_eval.errors import InputError

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
# Cells are halved up to three times where photos are near and doubled up to twelve times where they are far.
_FINEST, _COARSEST = -3, 12
_MOST_CELLS = 2.0**48  # so that the number of a cell and its level fit into 63 bits


@dataclass(frozen=True)
class PointCloud:
    """Points with normals and what is known about each.

    Parameters
    ----------
    points, normals : (N, 3) float64
        World; unit normals.
    weight : (N,) float64
        Worth of a point in averages.
    supporters : (N,) float64
        Photos that agreed on the point (mean of the cell).
    deviation : (N,) float64, optional
        Standard deviation along the normal (mean of the cell), world unit; NaN where it is not known.
    """

    points: Floats
    normals: Floats
    weight: Floats
    supporters: Floats
    deviation: Floats | None = None

    def __post_init__(self) -> None:
        count = len(self.points)
        if self.points.shape != (count, 3) or self.normals.shape != (count, 3):
            raise InputError(f"point cloud: points {self.points.shape}, normals {self.normals.shape}")
        if self.weight.shape != (count,) or self.supporters.shape != (count,):
            raise InputError(f"point cloud: weights {self.weight.shape}, supporters {self.supporters.shape}")
        if self.deviation is not None and self.deviation.shape != (count,):
            raise InputError(f"point cloud: {count} points, deviations {self.deviation.shape}")

    def table(self) -> Floats:
        """All but the weight as one (N, 8) array: points, normals, supporters, deviation."""
        deviation = np.full(len(self.points), np.nan) if self.deviation is None else self.deviation
        return np.column_stack([self.points, self.normals, self.supporters, deviation])


def concatenate(clouds: list[PointCloud]) -> PointCloud:
    """All points of several clouds, in order."""
    table = np.concatenate([cloud.table() for cloud in clouds])
    return _from_table(table, np.concatenate([cloud.weight for cloud in clouds]))


def _from_table(table: Floats, weight: Floats) -> PointCloud:
    return PointCloud(table[:, :3], table[:, 3:6], weight, table[:, 6], table[:, 7])


class CellFusion:
    """Running averages in cubic cells, one cloud after the other.

    What it holds grows with the surface and not with the number of clouds. The result does not depend on how many
    cores there are, and on the order of the clouds only by rounding.

    Parameters
    ----------
    low, high : (3,)
        Box that holds all the points to come.
    spacing : float
        Edge of the cells; doubled while the box would hold more than 2^48 of them.

    Raises
    ------
    InputError
        A spacing that is not positive.
    """

    def __init__(self, low: Floats, high: Floats, spacing: float) -> None:
        if not spacing > 0:
            raise InputError(f"point fusion: spacing {spacing}, expected a positive length")
        while np.prod((high - low) / spacing + 1.0) > _MOST_CELLS:
            spacing *= 2.0
        self._low = low
        self._spacing = spacing
        self._size = (np.floor((high - low) / spacing).astype(np.int64) + 1) * 2**-_FINEST
        self._keys: Integers = np.zeros(0, np.int64)
        self._weight: Floats = np.zeros(0)
        self._sums: Floats = np.zeros((0, 8))

    def add(self, cloud: PointCloud, widths: Floats | None = None) -> None:
        """Average another cloud in.

        Parameters
        ----------
        cloud : PointCloud
        widths : (N,), optional
            Width of a pixel at each point: where it is far from the spacing, cells are halved or doubled until they fit
            (what is near keeps its detail, what is far does not stay a cloud of noise).
        """
        levels = np.zeros(len(cloud.points), np.int64)
        if widths is not None:
            levels = np.rint(np.log2(np.maximum(widths, 1e-300) / self._spacing)).astype(np.int64)
            levels = np.clip(levels, _FINEST, _COARSEST)
        cells = np.floor((cloud.points - self._low) / (self._spacing * 2.0**levels)[:, None]).astype(np.int64)
        keys = (cells[:, 0] * self._size[1] + cells[:, 1]) * self._size[2] + cells[:, 2]
        keys = keys * (_COARSEST - _FINEST + 1) + levels - _FINEST
        weight = np.maximum(cloud.weight, 1e-300)
        self._merge(keys, weight, cloud.table() * weight[:, None])

    def _merge(self, keys: Integers, weight: Floats, sums: Floats) -> None:
        keys = np.concatenate([self._keys, keys])
        order = np.argsort(keys, kind="stable")
        keys = keys[order]
        starts = np.concatenate([[0], np.nonzero(np.diff(keys))[0] + 1]) if len(keys) else np.zeros(0, np.int64)
        self._keys = keys[starts]
        self._weight = np.add.reduceat(np.concatenate([self._weight, weight])[order], starts)
        self._sums = np.add.reduceat(np.concatenate([self._sums, sums])[order], starts, axis=0)

    def edges(self) -> Floats:
        """Edge of the cell (N,) of every point of `cloud`."""
        levels = self._keys % (_COARSEST - _FINEST + 1) + _FINEST
        return np.asarray(self._spacing * 2.0**levels)

    def cloud(self) -> PointCloud:
        """One point per cell, ordered by cell."""
        table = self._sums / np.maximum(self._weight, 1e-300)[:, None]
        table[:, 3:6] /= np.maximum(np.linalg.norm(table[:, 3:6], axis=1, keepdims=True), 1e-12)
        return _from_table(table, self._weight.copy())


def clearly_uncertain(deviation: Floats, edges: Floats, times: float) -> NDArray[np.bool_]:
    """Points (N,) whose deviation, in cells, is more than so many times the median.

    Depth maps that continue an outline into the backdrop, or a rim over a hollow, agree only roughly: such points are
    a few percent of a cloud and most of its crust.
    """
    relative = deviation / edges
    usual = float(np.median(relative))
    return np.asarray((relative > times * usual) & (usual > 0))


def average_in_cells(cloud: PointCloud, spacing: float) -> PointCloud:
    """One point per cubic cell of edge `spacing`: the weighted mean of the points in it.

    Raises
    ------
    InputError
        A spacing that is not positive.
    """
    if len(cloud.points) == 0:
        if not spacing > 0:
            raise InputError(f"point fusion: spacing {spacing}, expected a positive length")
        return cloud
    fusion = CellFusion(cloud.points.min(axis=0), cloud.points.max(axis=0), spacing)
    fusion.add(cloud)
    return fusion.cloud()
