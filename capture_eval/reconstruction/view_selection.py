"""Which photos a photo is compared with, and between which depths the surface lies.

Both come from the sparse points: photos that share many points seen under a good angle make good partners, and the
depths of the points bound the search.  Score after Furukawa and Ponce's and Goesele et al.'s view selection (2007), in
the form of MVSNet (Yao et al. 2018): a piecewise Gaussian of the triangulation angle, summed over shared points.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from capture_eval.errors import InputError

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

_BEST_ANGLE = 12.0
_NARROW, _WIDE = 5.0, 12.0
_MARGIN = 0.15


def angle_weight(degrees: Floats) -> Floats:
    """Worth of a triangulation angle: 1 at 12 degrees, falling fast below and slowly above."""
    width = np.where(degrees < _BEST_ANGLE, _NARROW, _WIDE)
    return np.asarray(np.exp(-((degrees - _BEST_ANGLE) ** 2) / (2.0 * width**2)))


def pair_scores(centers: Floats, points: Floats, visible: Sequence[Integers]) -> Floats:
    """Worth of every pair of photos.

    Parameters
    ----------
    centers : (P, 3)
        Positions of the cameras.
    points : (N, 3)
        Sparse points, same frame.
    visible : sequence of P (K,) int arrays
        Points seen in every photo.

    Returns
    -------
    (P, P) float64
        Symmetric, zero on the diagonal.
    """
    count = len(centers)
    seen = np.zeros((count, len(points)), dtype=np.bool_)
    for row, indices in enumerate(visible):
        seen[row, indices] = True
    rays = points[None] - centers[:, None]
    rays /= np.maximum(np.linalg.norm(rays, axis=2, keepdims=True), 1e-300)
    scores = np.zeros((count, count))
    for first in range(count):
        for second in range(first + 1, count):
            shared = seen[first] & seen[second]
            cosine = np.sum(rays[first, shared] * rays[second, shared], axis=1)
            angles = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
            scores[first, second] = scores[second, first] = np.sum(angle_weight(angles))
    return scores


def choose_sources(scores: Floats, most: int) -> list[Integers]:
    """The best partners of every photo, best first; none where nothing is shared.

    Ties are broken by the photo's number, so the choice repeats.
    """
    chosen = []
    for row in range(len(scores)):
        order = np.argsort(-scores[row], kind="stable")
        chosen.append(order[scores[row, order] > 0][:most].astype(np.int64))
    return chosen


def depth_range(depths: Floats, name: str) -> tuple[float, float]:
    """Nearest and farthest depth to search, from the depths of the sparse points a photo sees.

    The span is widened by 15 % in inverse depth on both sides and never narrower than 10 % of the median depth.

    Raises
    ------
    InputError
        No point lies in front of the camera.
    """
    inverse = 1.0 / depths[depths > 0]
    if len(inverse) == 0:
        raise InputError(f"{name}: no sparse point lies in front of the camera, so the depth range is not known")
    low, high = np.percentile(inverse, [1.0, 99.0])
    middle = float(np.median(inverse))
    margin = max(_MARGIN * (high - low), 0.05 * middle)
    return float(1.0 / (high + margin)), float(1.0 / max(low - margin, 0.05 * low))
