"""A texture layout for the head: the upstream islands, repacked so that the face gets most of the texels.

The upstream layout is made for a whole body; the head's main island covers a fifth of it. Islands are only moved and
stretched along the axes (the main island more at the face than at scalp and neck), so no triangle is flipped.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

# The main island takes the square right of this line; the small ones are stacked on its left.
_COLUMN = 0.14
_GAP = 0.004
# Place along the main island (upstream proportions, 0 to 1) -> place in the atlas: u runs from the crown to the chin,
# v from the right to the left ear.
_STRETCH_U = ((0.0, 0.38, 0.52, 0.90, 1.0), (0.0, 0.21, 0.34, 0.93, 1.0))
_STRETCH_V = ((0.0, 0.28, 0.72, 1.0), (0.0, 0.20, 0.80, 1.0))


def texture_islands(face_textures: IntArray, count: int) -> IntArray:
    """Island of every texture coordinate (count,), the one with the most quads first."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    starts = face_textures[:, [0, 1, 2]].ravel()
    ends = face_textures[:, [1, 2, 3]].ravel()
    graph = coo_matrix((np.ones(len(starts)), (starts, ends)), shape=(count, count))
    number, label = connected_components(graph, directed=False)
    quads = np.bincount(label[face_textures[:, 0]], minlength=number)
    rank = np.empty(number, dtype=np.int64)
    rank[np.argsort(-quads, kind="stable")] = np.arange(number)
    return rank[label]


def repack_islands(coordinates: FloatArray, islands: IntArray) -> FloatArray:
    """Coordinates (T, 2) in [0, 1] of the repacked islands.

    Parameters
    ----------
    coordinates
        (T, 2), v up.
    islands
        (T,) from `texture_islands`; island 0 becomes the large one.
    """
    packed = np.empty_like(coordinates)
    rest = [island for island in range(islands.max() + 1) if island != 0]
    heights = {}
    for island in rest:
        low, high = coordinates[islands == island].min(axis=0), coordinates[islands == island].max(axis=0)
        # Tall islands stand, wide ones are turned by a quarter (no mirror image) to fill the column.
        heights[island] = max(high - low) / min(high - low)
    room = 1.0 - _GAP * (len(rest) + 1)
    total = sum(heights.values())
    bottom = _GAP
    main = coordinates[islands == 0]
    main = (main - main.min(axis=0)) / np.ptp(main, axis=0)
    main = np.stack([np.interp(main[:, 0], *_STRETCH_U), np.interp(main[:, 1], *_STRETCH_V)], axis=1)
    packed[islands == 0] = np.array([_COLUMN, _GAP]) + main * np.array([1.0 - _GAP - _COLUMN, 1.0 - 2.0 * _GAP])
    for island in rest:
        height = room * heights[island] / total
        _place(coordinates, islands == island, (_GAP, bottom, _COLUMN - _GAP, bottom + height), packed)
        bottom += height + _GAP
    return packed


def _place(
    coordinates: FloatArray, chosen: NDArray[np.bool_], box: tuple[float, float, float, float], packed: FloatArray
) -> None:
    """Stretch an island into a box (left, bottom, right, top); wide islands are turned by a quarter into tall boxes."""
    island = coordinates[chosen]
    size = np.ptp(island, axis=0)
    left, bottom, right, top = box
    if (size[0] > size[1]) != (right - left > top - bottom) and abs(np.log(size[0] / size[1])) > 0.1:
        island = np.stack([-island[:, 1], island[:, 0]], axis=1)
    low, size = island.min(axis=0), np.ptp(island, axis=0)
    packed[chosen] = np.array([left, bottom]) + (island - low) / size * np.array([right - left, top - bottom])


def rasterize_atlas(
    uv: FloatArray, values: FloatArray, side: int, margin: float = 6.0
) -> tuple[NDArray[np.bool_], NDArray[np.float32]]:
    """Values given at triangle corners, interpolated at the texels of an atlas.

    Parameters
    ----------
    uv
        (K, 3, 2) texture coordinates of the corners, v up.
    values
        (K, 3, C).
    side
        Side of the atlas in texels.
    margin
        Texels this far outside a chart get the value of the chart's edge.

    Returns
    -------
    filled
        (side, side) bool, row 0 at v = 1.
    image
        (side, side, C), zero where not filled.
    """
    from capture_eval.images.atlas_kernels import rasterize

    owner = np.zeros((side, side), dtype=np.uint8)
    out = np.zeros((side, side, values.shape[2]), dtype=np.float32)
    corners = np.ascontiguousarray(values, dtype=np.float64)
    rasterize(np.ascontiguousarray(uv, dtype=np.float64), corners, side, margin, owner, out)
    return owner > 0, out
