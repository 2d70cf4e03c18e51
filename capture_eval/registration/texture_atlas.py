"""Texture atlas: which triangle, and which point of it, every texel of a UV layout shows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class TextureAtlas:
    """Texels of a square UV layout.

    Row 0 is the top of the picture: the centre of texel ``(row, column)`` lies at
    ``u = (column + 0.5) / size``, ``v = 1 - (row + 0.5) / size``.

    Parameters
    ----------
    triangle : (S, S) int32
        Triangle that covers the centre of the texel, -1 where none does.
    barycentric : (S, S, 3) float32
        Weights of the triangle's three corners at the texel's centre; zero outside of the charts.
    border_distance : (S, S) float32
        Distance in texels to the nearest texel outside of the chart (0 outside). Charts that touch in the
        picture without sharing the edge on the mesh are kept apart by it too.
    """

    triangle: NDArray[np.int32]
    barycentric: NDArray[np.float32]
    border_distance: NDArray[np.float32]

    @property
    def size(self) -> int:
        """Texels along one side."""
        return int(self.triangle.shape[0])


def rasterise_atlas(corner_uv: NDArray[np.float64], size: int) -> TextureAtlas:
    """Rasterise the triangles of a UV layout.

    Parameters
    ----------
    corner_uv : (K, 3, 2) float64
        Texture coordinates of every triangle corner in [0, 1], v upwards as in OBJ files.
    size : int
        Texels along one side of the square atlas.
    """
    raise NotImplementedError
