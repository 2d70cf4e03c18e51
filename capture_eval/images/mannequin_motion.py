"""Motions of the mannequin: every vertex turns about an axis by weight x amplitude x timing, so it moves on an arc.

Weights belong to the topology and are shared by all identities; the axes (jaw hinge, eye centres, ...) move with the
identity.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.linalg import spsolve

from capture_eval.errors import InputError
from capture_eval.images.mannequin_features import EYE_CREASE, LIP_BORDER, upper_and_lower
from capture_eval.images.mannequin_layout import vertex_adjacency
from capture_eval.images.mannequin_shape import EYE_CENTRE
from capture_eval.images.mannequin_topology import Topology

FloatArray = NDArray[np.float64]

MOTIONS = ("jaw_open", "grin", "blink_frown")
JAW_HINGE = np.array([0.0, -24.0, 16.0])
JAW_ANGLE = 22.0
SMILE_CENTRE = np.array([0.0, -66.0, 46.0])
BROW_CENTRE = np.array([0.0, 20.0, 0.0])


@dataclass(frozen=True)
class Turn:
    """One rotation of part of the skin: degrees per vertex about an axis through a point.

    Attributes
    ----------
    centre
        (3,) point on the axis, millimetres, canonical head.
    axis
        (3,) unit vector.
    degrees
        (V,) angle of every vertex at amount 1.
    """

    centre: FloatArray
    axis: FloatArray
    degrees: FloatArray


def rotate_about(points: FloatArray, centre: FloatArray, axis: FloatArray, radians: FloatArray) -> FloatArray:
    """Turn points (N, 3) about a line by one angle (N,) each (Rodrigues' formula)."""
    arms = points - centre
    cosine, sine = np.cos(radians)[:, None], np.sin(radians)[:, None]
    along = (arms @ axis)[:, None] * axis
    return np.asarray(centre + along + cosine * (arms - along) + sine * np.cross(axis, arms))


def apply_turns(points: FloatArray, turns: tuple[Turn, ...], amount: float) -> FloatArray:
    """Apply turns one after the other, each by `amount` times its full angle."""
    if not 0.0 <= amount <= 1.0:
        raise InputError(f"motion: the amount {amount} is outside 0..1")
    if amount == 0.0:
        return points.copy()
    for turn in turns:
        moving = turn.degrees != 0
        moved = points.copy()
        moved[moving] = rotate_about(points[moving], turn.centre, turn.axis, np.radians(amount * turn.degrees[moving]))
        points = moved
    return points


def bump(distance: FloatArray) -> FloatArray:
    """Smooth weight of compact support: 1 at 0, 0 with zero slope and curvature from 1 on."""
    rest = np.clip(1.0 - distance**2, 0.0, 1.0)
    return np.asarray(rest**3)


def jaw_weights(topology: Topology, positions: FloatArray) -> FloatArray:
    """(V,) share of the jaw's turn: 1 on chin and lower lip, 0 on upper lip, skull and lower neck, smooth between.

    The weights between the fixed vertices are harmonic (they solve Laplace's equation on the mesh's graph).
    """
    x, y, z = positions.T
    slope = np.degrees(np.arctan2(y - JAW_HINGE[1], z - JAW_HINGE[2]))
    weights = np.full(len(positions), np.nan)
    start, end = np.array([46.0, -70.0, 14.0]), np.array([10.0, -96.0, 74.0])
    folded = np.stack([np.abs(x), y, z], axis=1)
    along = np.clip((folded - start) @ (end - start) / np.sum((end - start) ** 2), 0, 1)
    near = np.linalg.norm(folded - start - along[:, None] * (end - start), axis=1)
    weights[(near < 24) & (along > 0.45) & (slope < -46) & (slope > -60)] = 1.0
    weights[(slope > -8) & (slope < 180)] = 0.0
    weights[(y < -105) & (np.abs(x) < 26) & (z < 26)] = 0.0
    weights[(y < -152) | (z < -48) | ((z < -22) & (y > -40)) | (slope > 150) | (slope < -150)] = 0.0
    rings = topology.rings["mouth"]
    for half, value in zip(upper_and_lower(6, 14), (0.0, 1.0), strict=True):
        inside = half[2:-2]
        weights[rings[LIP_BORDER:][:, inside]] = value
    middle = topology.face.shape[1] // 2
    weights[topology.face[:22, middle - 6 : middle + 7]] = 0.0
    grid = topology.inner["mouth"]
    weights[grid[: grid.shape[0] // 2]] = 0.0
    weights[grid[grid.shape[0] // 2 + 1 :]] = 1.0
    for name in ("eye_left", "eye_right", "nostril_left", "nostril_right", "ear_left", "ear_right"):
        weights[topology.rings[name]] = 0.0
        weights[topology.inner[name]] = 0.0
    return _fill_harmonic(topology, weights)


def _fill_harmonic(topology: Topology, weights: FloatArray) -> FloatArray:
    adjacency = vertex_adjacency(topology)
    free = np.isnan(weights)
    degree = np.asarray(adjacency.sum(axis=1)).ravel()
    matrix = (-adjacency[free][:, free]).tolil()
    matrix.setdiag(degree[free])
    filled = weights.copy()
    filled[free] = spsolve(matrix.tocsc(), adjacency[free][:, ~free] @ weights[~free])
    # a few rounds of smoothing take the kink at the fixed borders away; stretching gives the chin its exact 1 back
    for _ in range(8):
        filled = 0.5 * filled + 0.5 * (adjacency @ filled) / degree
    return np.asarray(np.clip((filled - 0.02) / 0.92, 0.0, 1.0))


def _smile_turns(topology: Topology, positions: FloatArray) -> tuple[Turn, ...]:
    x, y, z = positions.T
    side = np.tanh(x / 9.0)
    corner = np.sqrt(((np.abs(x) - 28) / 46) ** 2 + ((y + 62) / 46) ** 2 + ((z - 78) / 60) ** 2)
    outwards = Turn(SMILE_CENTRE, np.array([0.0, 1.0, 0.0]), 13.0 * bump(corner) * side)
    cheek = np.sqrt(((np.abs(x) - 34) / 40) ** 2 + ((y + 52) / 40) ** 2 + ((z - 76) / 50) ** 2)
    upwards = Turn(SMILE_CENTRE, np.array([0.0, 0.0, 1.0]), 11.0 * bump(cheek) * side)
    return (outwards, upwards, *_lid_turns(topology, positions, 0.0, 0.25))


def _lid_turns(topology: Topology, positions: FloatArray, upper_share: float, lower_share: float) -> tuple[Turn, ...]:
    """Lids turn about the eyes' centres; share 1 of both closes the eyes but for a slit of 0.4 mm."""
    rings = topology.rings["eye_left"]
    upper, lower = upper_and_lower(6, 8)
    arms = positions - EYE_CENTRE
    elevation = np.degrees(np.arctan2(arms[:, 1], np.maximum(arms[:, 2], 1.0)))
    top, bottom = elevation[rings[10][upper]], elevation[rings[10][lower]]
    meeting = bottom + 0.16 * (top - bottom)
    slit = np.degrees(0.2 / 13.9) * np.minimum(1.0, (top - bottom) / 10.0)
    degrees = np.zeros(len(positions))
    fall = {11: 1.0, 10: 1.0, 9: 0.95, 8: 0.82, EYE_CREASE: 0.60, 6: 0.32, 5: 0.10, 12: 0.5}
    for ring, weight in fall.items():
        degrees[rings[ring][upper]] = -upper_share * weight * (meeting + slit - top)
        degrees[rings[ring][lower]] += -lower_share * weight * (meeting - slit - bottom)
    axis = np.array([1.0, 0.0, 0.0])
    left = Turn(EYE_CENTRE, axis, degrees)
    right = Turn(EYE_CENTRE * [-1, 1, 1], axis, degrees[topology.mirror])
    return left, right


def _frown_turns(positions: FloatArray) -> tuple[Turn, ...]:
    x, y, z = positions.T
    inner = bump(np.sqrt(((np.abs(x) - 15) / 26) ** 2 + ((y - 19) / 18) ** 2 + ((z - 88) / 40) ** 2))
    whole = bump(np.sqrt(((np.abs(x) - 30) / 34) ** 2 + ((y - 19) / 17) ** 2 + ((z - 80) / 45) ** 2))
    down = Turn(BROW_CENTRE, np.array([1.0, 0.0, 0.0]), 1.6 * inner + 2.2 * whole)
    together = Turn(BROW_CENTRE, np.array([0.0, 1.0, 0.0]), -2.6 * inner * np.tanh(x / 8.0))
    return down, together


def skin_turns(topology: Topology, positions: FloatArray, motion: str) -> tuple[Turn, ...]:
    """Turns of a motion for the canonical vertex positions (V, 3).

    Raises
    ------
    InputError
        The motion is not one of `MOTIONS`.
    """
    if motion == "jaw_open":
        weights = jaw_weights(topology, positions)
        return (Turn(JAW_HINGE, np.array([1.0, 0.0, 0.0]), JAW_ANGLE * weights),)
    if motion == "grin":
        return _smile_turns(topology, positions)
    if motion == "blink_frown":
        return (*_lid_turns(topology, positions, 1.0, 1.0), *_frown_turns(positions))
    raise InputError(f"motion {motion!r} is unknown to the mannequin: choose one of {', '.join(MOTIONS)}")
