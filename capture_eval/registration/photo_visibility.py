"""Which points of a mesh are seen in which photo."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from capture_eval.cameras import View


def count_seen(
    vertices: NDArray[np.float64],
    triangles: NDArray[np.int64],
    views: Sequence[View],
    occluders: tuple[NDArray[np.float64], NDArray[np.int64]] | None = None,
    minimum_cosine: float = 0.15,
) -> NDArray[np.int64]:
    """Number of photos that see each vertex, (V,) int64."""
    raise NotImplementedError
