"""Explicit vertex positions of the mannequin's features: lids, lips, nostrils, ears and what lies inside them.

Every function returns positions for the whole vertex array together with a mask of the vertices it has set; only the
subject's left side and the middle are set, the other side is the mirror image.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from capture_eval.images.mannequin_shape import (
    EYE_CENTRE,
    cast_to_skin,
    distance_gradient,
    head_distance,
    project_to_skin,
)
from capture_eval.images.mannequin_topology import Topology

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

MOUTH_HALF_WIDTH = 25.5
MOUTH_HEIGHT = -66.0
# the slit between the lips is this much narrower than the lip red, so that the corners do not pinch
LIP_NARROWING = 0.08
# eye rings: 4 orbit, 7 crease, 10 outer edge of the lid margin, 11 inner edge, 12.. socket
EYE_ORBIT, EYE_CREASE, EYE_MARGIN, EYE_MARGIN_INNER = 4, 7, 10, 11
# mouth rings: 5 border of the lip red, 9 front of the contact, 10 its back, 11.. mouth bag
LIP_BORDER, LIP_CONTACT, LIP_CONTACT_BACK = 5, 9, 10
# ear rings: (half width, half height, height above the skin, shift back), root on the skin first, canal last:
# 0, 1 root, 2 back of the pinna, 3..5 helix, 6, 7 scapha, 8 antihelix, 9 concha edge, 10, 11 concha
_EAR_PROFILE = (
    (11, 25, 0, 0),
    (10, 24, 5, 1),
    (14, 27.5, 13, 3.2),
    (16, 30, 17, 4),
    (15.2, 29.2, 19, 4),
    (13.6, 27.4, 18.5, 4),
    (12.4, 25.4, 15, 4),
    (11.0, 22.5, 13, 3.6),
    (8.6, 16, 13.5, 2.4),
    (7.0, 12, 9, 0.8),
    (5.4, 9, 3.5, -1.0),
    (3.4, 5.5, 1.0, -3.0),
)
_EAR_TILT = np.radians(12.0)


def upper_and_lower(rows: int, columns: int) -> tuple[IntArray, IntArray]:
    """Ring positions of the upper and of the lower half of a block's ring, both from its left middle to the right.

    Left is the smallest column. Both halves share their end points and have columns + rows + 1 entries; `rows` is
    even.
    """
    total = 2 * (rows + columns)
    start = total - rows // 2
    steps = np.arange(rows + columns + 1)
    return (start + steps) % total, (start - steps) % total


def _front_points(x: FloatArray, y: FloatArray) -> FloatArray:
    origins = np.stack([x, y, np.full_like(x, 20.0)], axis=1)
    return cast_to_skin(origins, np.broadcast_to([0.0, 0.0, 1.0], origins.shape), reach=110.0)


def eye_positions(topology: Topology) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Left eye: orbit, lids, lid margin and socket, (V, 3) millimetres and (V,) mask."""
    positions = np.zeros((topology.vertex_count, 3))
    rings = topology.rings["eye_left"]
    upper, lower = upper_and_lower(6, 8)
    share = np.linspace(0.0, 1.0, len(upper))
    along = 0.45 * share + 0.55 * (1 - np.cos(np.pi * share)) / 2
    margin_x, orbit_x = -15.5 + 30.0 * along, -19.5 + 37.0 * (1 - np.cos(np.pi * share)) / 2
    arch = np.sin(np.pi * np.clip(along, 0, 1)) ** 0.85
    fractions = {10: 0.0, 9: 0.13, 8: 0.27, 7: 0.40, 6: 0.57, 5: 0.77, 4: 1.0}
    for half, height, orbit_height in ((upper, 5.9, 16.5), (lower, -4.4, -15.0)):
        tilt = -1.8 + 2.6 * along
        margin_y = tilt + height * arch * (1.06 - 0.12 * along)
        orbit_y = orbit_height * np.sin(np.pi * share) ** 0.75 - 1.0 + 1.5 * share
        for ring, fraction in fractions.items():
            x = EYE_CENTRE[0] + (1 - fraction) * margin_x + fraction * orbit_x
            y = EYE_CENTRE[1] + (1 - fraction) * margin_y + fraction * orbit_y
            points = _front_points(x, y)
            points += _lid_relief(ring, half is upper, arch)[:, None] * _normals(points)
            positions[rings[ring][half]] = points
    _eye_socket(positions, topology)
    mask = np.zeros(topology.vertex_count, dtype=bool)
    mask[rings[4:]] = True
    mask[topology.inner["eye_left"]] = True
    return positions, mask


def _normals(points: FloatArray) -> FloatArray:
    gradient = distance_gradient(head_distance, points)[1]
    return np.asarray(gradient / np.linalg.norm(gradient, axis=1, keepdims=True))


def _lid_relief(ring: int, is_upper: bool, arch: FloatArray) -> FloatArray:
    """Height of the lid fold above the smooth skin, millimetres."""
    relief = {7: -1.1, 6: 0.9, 5: 0.7, 9: 0.1, 10: 0.2} if is_upper else {7: -0.4, 6: 0.3, 9: 0.1, 10: 0.2}
    return relief.get(ring, 0.0) * arch


def _eye_socket(positions: FloatArray, topology: Topology) -> None:
    """Inner lid edge and the bag behind it, between eyeball and lids, written into `positions`."""
    rings = topology.rings["eye_left"]
    margin = positions[rings[EYE_MARGIN]] - EYE_CENTRE
    positions[rings[EYE_MARGIN_INNER]] = EYE_CENTRE + margin * [0.985, 0.93, 0.905]
    angle = np.arctan2(margin[:, 1] + 0.3, margin[:, 0])
    for ring, (polar, radius) in {12: (58, 12.9), 13: (95, 13.0), 14: (138, 12.8)}.items():
        turn = np.radians(polar)
        circle = np.stack(
            [np.cos(angle) * np.sin(turn), np.sin(angle) * np.sin(turn), np.full_like(angle, np.cos(turn))]
        )
        positions[rings[ring]] = EYE_CENTRE + radius * circle.T
    _close_bag(positions, topology.inner["eye_left"], np.array([0.0, 0.0, -3.0]))


def _close_bag(positions: FloatArray, grid: IntArray, bulge: FloatArray) -> None:
    """Fill a grid from its border by bilinear transfinite interpolation, pushed out by `bulge` in the middle."""
    rows, columns = grid.shape[0] - 1, grid.shape[1] - 1
    u, v = np.meshgrid(np.linspace(0, 1, columns + 1), np.linspace(0, 1, rows + 1))
    u, v = u[..., None], v[..., None]
    border = positions[grid]
    corners = (1 - u) * (1 - v) * border[0, 0] + u * (1 - v) * border[0, -1]
    corners = corners + (1 - u) * v * border[-1, 0] + u * v * border[-1, -1]
    filled = (1 - v) * border[:1] + v * border[-1:] + (1 - u) * border[:, :1] + u * border[:, -1:] - corners
    filled = filled + 16 * u * (1 - u) * v * (1 - v) * bulge
    positions[grid[1:-1, 1:-1]] = filled[1:-1, 1:-1]


def mouth_positions(topology: Topology) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Lips, their contact and the mouth bag, (V, 3) millimetres and (V,) mask (both sides)."""
    positions = np.zeros((topology.vertex_count, 3))
    rings = topology.rings["mouth"]
    halves = upper_and_lower(6, 14)
    share = np.linspace(-1.0, 1.0, len(halves[0]))
    x = MOUTH_HALF_WIDTH * (0.6 * share + 0.4 * np.sin(np.pi * share / 2))
    lateral = np.abs(x) / MOUTH_HALF_WIDTH
    contact_y = MOUTH_HEIGHT - 0.7 * np.exp(-((x / 5) ** 2)) + 0.6 * np.exp(-(((np.abs(x) - 10) / 5) ** 2))
    contact_y = contact_y - 1.2 * lateral**3
    contact_z = 92.5 - 12.5 * lateral**2.0
    roundness = np.sqrt(np.clip(1 - lateral**2, 0, 1))
    bow = 1.3 * np.exp(-(((np.abs(x) - 5.5) / 3.2) ** 2)) - 0.6 * np.exp(-((x / 2.5) ** 2))
    heights = (6.6 * (1 - lateral**1.6) + bow * (1 - lateral), -8.6 * (1 - lateral**2.4))
    for half, height, is_upper in zip(halves, heights, (True, False), strict=True):
        sign = 1.0 if is_upper else -1.0
        border = _front_points(x, contact_y + height)
        border[:, 2] += 0.5 * roundness
        corner = 1 - roundness**0.5
        border[:, 2] += corner * (contact_z - 0.2 - border[:, 2])
        gap = sign * 0.12 * roundness
        positions[rings[LIP_BORDER][half]] = border
        fullness = 3.0 if is_upper else 4.0
        front = np.stack([x, contact_y + gap, contact_z], axis=1)
        for ring, fraction in {6: 0.25, 7: 0.52, 8: 0.79, LIP_CONTACT: 1.0}.items():
            point = (1 - fraction) * border + fraction * front
            point[:, 0] *= 1 - LIP_NARROWING * fraction
            point[:, 2] += fullness * roundness * np.sin(np.pi * fraction**1.1) ** 0.9 - fraction * corner
            point[:, 1] += sign * 0.7 * roundness * np.sin(np.pi * fraction) * fraction
            positions[rings[ring][half]] = point
        back = np.stack([x * (1 - LIP_NARROWING), contact_y, contact_z - corner], axis=1)
        _mouth_bag(positions, rings, half, back, sign, roundness)
    _close_bag(positions, topology.inner["mouth"], np.array([0.0, 0.0, -4.0]))
    mask = np.zeros(topology.vertex_count, dtype=bool)
    mask[rings[LIP_BORDER:]] = True
    mask[topology.inner["mouth"]] = True
    return positions, mask


def _mouth_bag(
    positions: FloatArray, rings: IntArray, half: IntArray, contact: FloatArray, sign: float, roundness: FloatArray
) -> None:
    """Back of one lip and the bag around the teeth; (gap, depth behind the contact) for every ring."""
    bag = {10: (0.18, 2.5), 11: (1.2, 5.0), 12: (7.5, 6.5), 13: (13.0, 8.5), 14: (16.0, 17.0), 15: (17.0, 27.0)}
    bag |= {16: (15.0, 36.0), 17: (11.0, 43.0)}
    for ring, (gap, depth) in bag.items():
        point = contact.copy()
        point[:, 1] += sign * gap * roundness**0.8
        point[:, 0] *= 1.0 + 0.10 * min(depth, 12.0) / 12.0
        point[:, 2] -= depth * (0.45 + 0.55 * roundness)
        positions[rings[ring][half]] = point


def nostril_positions(topology: Topology) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Left nostril: rim and the hole, (V, 3) millimetres and (V,) mask."""
    positions = np.zeros((topology.vertex_count, 3))
    rings = topology.rings["nostril_left"]
    centre = np.array([7.2, -42.5, 98.0])
    axis = np.array([0.20, -0.93, 0.30])
    axis /= np.linalg.norm(axis)
    long = np.array([-0.45, 0.25, 0.86])
    long -= (long @ axis) * axis
    long /= np.linalg.norm(long)
    wide = np.cross(long, axis)
    angle = np.radians(135.0 - 45.0 * np.arange(8))
    for ring, (scale, depth) in enumerate(((1.0, 0.0), (0.76, 1.0), (0.62, 4.0), (0.42, 7.0))):
        rim = 3.5 * np.cos(angle)[:, None] * wide + 5.8 * np.sin(angle)[:, None] * long
        points = centre + scale * rim
        points = project_to_skin(points) if ring < 2 else points
        positions[rings[ring]] = points - depth * axis
    _close_bag(positions, topology.inner["nostril_left"], np.zeros(3))
    mask = np.zeros(topology.vertex_count, dtype=bool)
    mask[rings] = True
    mask[topology.inner["nostril_left"]] = True
    return positions, mask


def ear_positions(topology: Topology) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Left ear from its root to the canal, (V, 3) millimetres and (V,) mask.

    Rings are egg-shaped outlines scaled and lifted along the ear's axis; lift fades towards the front, so that the
    pinna stands off the head at the back and top and grows out of the cheek at the front.
    """
    positions = np.zeros((topology.vertex_count, 3))
    rings = topology.rings["ear_left"]
    angle = 2 * np.pi * (np.arange(28) - 2.5) / 28
    back, up = np.sin(angle), np.cos(angle)
    stand = np.clip(0.52 + 0.55 * back + 0.22 * up, 0.0, 1.0) ** 0.8
    lobe = np.exp(-(((np.mod(angle, 2 * np.pi) - 1.02 * np.pi) / 0.62) ** 2))
    tragus = np.exp(-(((np.mod(angle, 2 * np.pi) - 1.50 * np.pi) / 0.30) ** 2))
    rear = np.clip(back + 0.3, 0.0, 1.0)
    front = np.clip((-back - 0.15) / 0.6, 0.0, 1.0)
    front = front * front * (3 - 2 * front)
    for ring, (wide, high, lift, shift) in enumerate(_EAR_PROFILE):
        # in front the pinna grows out of the cheek: there the rings only go inwards, without an overhang
        width = (1 - front) * wide * (1 + 0.16 * up - 0.05 * np.abs(up) ** 3) + front * (11.0 - 0.65 * ring)
        u, w = width * back + (1 - front) * shift, high * up - 0.05 * high
        z = -19 - (np.cos(_EAR_TILT) * u + np.sin(_EAR_TILT) * w)
        y = -9 + np.cos(_EAR_TILT) * w - np.sin(_EAR_TILT) * u
        rise = np.maximum(lift * np.maximum(stand, 0.6 * lobe), front * 0.18 * lift)
        if ring in (6, 7):
            rise = (1 - lobe) * rise + lobe * 0.6 * 15.0
        if ring == 8:
            rise = rise + 3.5 * rear * (1 - lobe)
        if ring in (8, 9):
            rise = rise + tragus * (4.0 if ring == 9 else 2.5)
        skin = _side_points(y, z)
        level = np.stack([np.full_like(y, skin[:, 0].mean()), y, z], axis=1)
        base = skin if ring < 2 else 0.5 * (skin + level)
        positions[rings[ring]] = base + rise[:, None] * np.array([0.84, 0.0, -0.5])
    _close_bag(positions, topology.inner["ear_left"], np.array([-5.0, 0.0, 0.0]))
    mask = np.zeros(topology.vertex_count, dtype=bool)
    mask[rings] = True
    mask[topology.inner["ear_left"]] = True
    return positions, mask


def _side_points(y: FloatArray, z: FloatArray) -> FloatArray:
    origins = np.stack([np.full_like(y, 10.0), y, z], axis=1)
    return cast_to_skin(origins, np.broadcast_to([1.0, 0.0, 0.0], origins.shape), reach=90.0)
