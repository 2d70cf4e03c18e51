"""Why a prediction is wrong: too early or late on its way (timing), or off the way (path).

The error of a point is split along and across the straight line from its first to its last position. The two parts
add up exactly in squares. A warp of time can only remove the first; the second is left to every method that moves
points straight.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capture_eval.evaluation.metrics import check_diameter

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class TimingPathSplit:
    """Parts of the point errors as fractions of D.

    Parameters
    ----------
    timing : (T, M)
        Along the chord, signed: positive when the prediction is ahead of the truth.
    path : (T, M)
        Across the chord, not negative. All of the error for points that end where they began.
    """

    timing: Floats
    path: Floats


def split_timing_and_path(
    predicted: Floats, truth: Floats, start: Floats, end: Floats, diameter: float
) -> TimingPathSplit:
    """Split the errors of one curve.

    Parameters
    ----------
    predicted, truth : (T, M, 3)
        Positions.
    start, end : (M, 3)
        True first and last positions.
    diameter : float
        D.

    Returns
    -------
    TimingPathSplit
        ``timing² + path² = error²`` for every point and time.
    """
    check_diameter(diameter)
    chord = end - start
    length = np.linalg.norm(chord, axis=-1, keepdims=True)
    direction = np.divide(chord, length, out=np.zeros_like(chord), where=length > 0)
    difference = (predicted - truth) / diameter
    timing: Floats = np.einsum("tmi,mi->tm", difference, direction)
    path: Floats = np.linalg.norm(difference - timing[..., None] * direction, axis=-1)
    return TimingPathSplit(timing, path)
