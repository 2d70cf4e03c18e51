"""Which way a head looks, from the names of its curves: templates may stand turned in their frame."""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import NDArray

from .saved_results import CurvePositions

Floats = NDArray[np.float64]

_SIDES = {"l": "r", "left": "right"}
_ABOVE = frozenset({"eye", "eyes", "brow", "brows", "lid", "lids", "eyelid", "forehead"})
_BELOW = frozenset({"lip", "lips", "mouth", "chin"})
_LARGEST_TILT = 0.7
"""Cosine (45 degrees) beyond which the line from mouth to eyes is believed more than the given upward direction."""


def find_head_axes(curves: CurvePositions, up: Floats, front: Floats) -> tuple[Floats, Floats]:
    """Refine rough axes of a head by the pairs of its curves.

    The line between curves whose names differ in left and right (``eye_1_L``, ``eye_1_R``; ``brow_left``, …) goes
    across the face. The given upward direction, set at right angles to it, is kept unless the line from the mouth's
    to the eyes' curves lies more than 45 degrees off; that line, leaning back on any face, only replaces it then.

    Parameters
    ----------
    curves
        True positions; the first pose with finite ones is used.
    up, front : (3,) arrays
        Rough unit vectors at right angles: upwards, and the way the face looks.

    Returns
    -------
    up, front : (3,) arrays
        Refined unit vectors at right angles; the given ones where the names tell nothing.
    """
    known = [row for row in range(len(curves.t)) if np.all(np.isfinite(curves.truth[row]))]
    if not known:
        return up, front
    centres = np.array([curves.truth[known[0]][rows].mean(axis=0) for rows in curves.slices()])
    words = [re.findall(r"[a-z]+|[0-9]+", name.lower()) for name in curves.names]
    left = _across(words, centres)
    if left is None:
        return up, front
    upward = _upward(words, centres)
    if upward is not None and _at_right_angles(upward, left) @ _at_right_angles(up, left) < _LARGEST_TILT:
        up = upward
    elif left @ np.cross(up, front) < 0.0:
        left = -left  # sides named as the viewer sees them
    up = _at_right_angles(up, left)
    return up, np.cross(left, up)


def _across(words: list[list[str]], centres: Floats) -> Floats | None:
    """Unit vector from the right curves to the left ones; None without a pair."""
    total = np.zeros(3)
    places = {tuple(name): index for index, name in enumerate(words)}
    for name, index in places.items():
        other = tuple(_SIDES.get(word, word) for word in name)
        if other != name and other in places:
            total += centres[index] - centres[places[other]]
    length = float(np.linalg.norm(total))
    return total / length if length > 0.0 else None


def _upward(words: list[list[str]], centres: Floats) -> Floats | None:
    above = [index for index, name in enumerate(words) if _ABOVE & set(name) and not _BELOW & set(name)]
    below = [index for index, name in enumerate(words) if _BELOW & set(name) and not _ABOVE & set(name)]
    if not above or not below:
        return None
    line: Floats = centres[above].mean(axis=0) - centres[below].mean(axis=0)
    return line


def _at_right_angles(vector: Floats, axis: Floats) -> Floats:
    """Unit vector of the part of a vector that is at right angles to an axis."""
    part = vector - (vector @ axis) * axis
    result: Floats = part / max(float(np.linalg.norm(part)), 1e-300)
    return result
