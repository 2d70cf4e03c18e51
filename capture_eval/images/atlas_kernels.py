"""Compiled loop that fills a texture atlas; import only where it is used."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

Array = Any


@njit(cache=True, nogil=True)
def rasterize(uv: Array, values: Array, side: int, margin: float, owner: Array, out: Array) -> None:
    """Interpolate corner values (K, 3, C) at the texels of the triangles, then in a margin round the charts.

    `owner` (side, side) becomes 1 inside the charts and 2 in their margin; `out` is (side, side, C).
    """
    for outside in range(2):
        for triangle in range(uv.shape[0]):
            x0, y0 = uv[triangle, 0, 0] * side - 0.5, (1.0 - uv[triangle, 0, 1]) * side - 0.5
            x1, y1 = uv[triangle, 1, 0] * side - 0.5, (1.0 - uv[triangle, 1, 1]) * side - 0.5
            x2, y2 = uv[triangle, 2, 0] * side - 0.5, (1.0 - uv[triangle, 2, 1]) * side - 0.5
            area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)
            if area == 0.0:
                continue
            reach = margin if outside else 0.0
            left, right = max(0, int(np.ceil(min(x0, x1, x2) - reach))), min(side - 1, int(max(x0, x1, x2) + reach))
            top, bottom = max(0, int(np.ceil(min(y0, y1, y2) - reach))), min(side - 1, int(max(y0, y1, y2) + reach))
            for row in range(top, bottom + 1):
                for column in range(left, right + 1):
                    if owner[row, column] == 1:
                        continue
                    b = ((column - x0) * (y2 - y0) - (x2 - x0) * (row - y0)) / area
                    c = ((x1 - x0) * (row - y0) - (column - x0) * (y1 - y0)) / area
                    inside = b >= 0.0 and c >= 0.0 and b + c <= 1.0
                    if inside:
                        owner[row, column] = 1
                    elif outside and owner[row, column] == 0:
                        # Texels beside a chart take the nearest point of it, so that lookups at its edge do not mix
                        # in what is not skin.
                        b, c = min(max(b, 0.0), 1.0), min(max(c, 0.0), 1.0)
                        if b + c > 1.0:
                            b, c = b / (b + c), c / (b + c)
                        x = x0 + b * (x1 - x0) + c * (x2 - x0) - column
                        y = y0 + b * (y1 - y0) + c * (y2 - y0) - row
                        if x * x + y * y > reach * reach:
                            continue
                        owner[row, column] = 2
                    else:
                        continue
                    for channel in range(values.shape[2]):
                        out[row, column, channel] = (
                            (1.0 - b - c) * values[triangle, 0, channel]
                            + b * values[triangle, 1, channel]
                            + c * values[triangle, 2, channel]
                        )
