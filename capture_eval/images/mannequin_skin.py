"""Albedo of the mannequin's skin: a solid texture in the neutral canonical head, baked into the chart.

Every colour is a function of the neutral position (and of smooth masks per vertex: lips, lashes, insides), so there is
no seam, and no part of skin, scalp or neck repeats another.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture_eval.errors import InputError
from capture_eval.images.mannequin_topology import Topology

FloatArray = NDArray[np.float64]
SingleArray = NDArray[np.float32]
IntArray = NDArray[np.int64]
ByteArray = NDArray[np.uint8]

CONTRAST = {"normal": 1.0, "weak": 0.4}
_SKIN = np.array([201.0, 158.0, 136.0])
_LIP = np.array([168.0, 96.0, 92.0])
_HAIR = np.array([86.0, 69.0, 56.0])
_INSIDE = np.array([84.0, 34.0, 32.0])
_HAIRLINE_Z = (-110.0, -62.0, -46.0, -36.0, 2.0, 10.0, 20.0, 32.0, 48.0, 70.0, 110.0)
_HAIRLINE_Y = (-78.0, -72.0, -50.0, -26.0, -22.0, -14.0, 6.0, 38.0, 60.0, 74.0, 76.0)


def vertex_masks(topology: Topology) -> FloatArray:
    """(V, 5) masks in 0..1: lips, insides, lashes, ears (no hair), red rims of the eyes."""
    masks = np.zeros((topology.vertex_count, 5))
    mouth = topology.rings["mouth"]
    masks[mouth[5], 0] = 0.55
    masks[mouth[6:11], 0] = 1.0
    masks[mouth[11:], 1] = 1.0
    masks[topology.inner["mouth"], 1] = 1.0
    for side in ("right", "left"):
        eye, nostril, ear = (topology.rings[f"{part}_{side}"] for part in ("eye", "nostril", "ear"))
        masks[eye[10], 2] = 1.0
        masks[eye[9], 2] = 0.25
        masks[eye[11], 4] = 1.0
        masks[eye[12:], 1] = 0.6
        masks[topology.inner[f"eye_{side}"], 1] = 0.6
        masks[nostril[1], 1] = 0.35
        masks[nostril[2:], 1] = 1.0
        masks[topology.inner[f"nostril_{side}"], 1] = 1.0
        masks[ear, 3] = 1.0
        masks[topology.inner[f"ear_{side}"], 3] = 1.0
        masks[topology.inner[f"ear_{side}"][1:-1, 1:-1], 1] = 0.5
    return masks


def bake_albedo(
    topology: Topology,
    positions: FloatArray,
    coordinates: FloatArray,
    corners: IntArray,
    size: int,
    contrast: str,
    seed: int,
) -> ByteArray:
    """Bake the skin into its chart.

    Parameters
    ----------
    topology, positions
        Canonical skin, millimetres.
    coordinates, corners
        Texture coordinates (T, 2) and corners (F, 4) of the chart, which is convex.
    size
        Edge of the image in texels.
    contrast
        ``normal`` or ``weak`` (0.4 of normal).
    seed
        Person: other spots, blotches, hairs.

    Returns
    -------
    (size, size, 3) uint8 sRGB, row 0 at v = 1. Texels outside the chart repeat its border.
    """
    if contrast not in CONTRAST:
        raise InputError(f"skin contrast {contrast!r} is unknown: choose one of {', '.join(CONTRAST)}")
    if size < 16:
        raise InputError(f"skin texture of {size} texels: at least 16 are needed")
    attributes = np.concatenate([positions, vertex_masks(topology)], axis=1).astype(np.float32)
    image = np.empty((size, size, 3), dtype=np.uint8)
    scene = _chart_scene(coordinates, corners)
    rows = max(1, (1 << 19) // size)
    for first in range(0, size, rows):
        last = min(first + rows, size)
        values = _texel_attributes(scene, topology, attributes, size, first, last)
        colors = skin_color(values[:, :3], values[:, 3:], CONTRAST[contrast], seed)
        image[first:last] = np.clip(colors + 0.5, 0, 255).astype(np.uint8).reshape(last - first, size, 3)
    return image


def _chart_scene(coordinates: FloatArray, corners: IntArray) -> Any:
    import open3d

    flat = np.concatenate([coordinates, np.zeros((len(coordinates), 1))], axis=1).astype(np.float32)
    triangles = np.concatenate([corners[:, [0, 1, 2]], corners[:, [0, 2, 3]]]).astype(np.uint32)
    tensor: Any = open3d.core.Tensor
    scene = open3d.t.geometry.RaycastingScene(nthreads=1)
    scene.add_triangles(tensor(flat), tensor(triangles))
    return scene


def _texel_attributes(
    scene: Any, topology: Topology, attributes: SingleArray, size: int, first: int, last: int
) -> SingleArray:
    """Attributes (texels, k) of image rows first..last, interpolated over the chart's triangles."""
    import open3d

    tensor: Any = open3d.core.Tensor
    v, u = np.meshgrid(1 - (np.arange(first, last) + 0.5) / size, (np.arange(size) + 0.5) / size, indexing="ij")
    points = np.stack([u.ravel(), v.ravel()], axis=1)
    rays = np.empty((len(points), 6), dtype=np.float32)
    rays[:, :2], rays[:, 2], rays[:, 3:] = points, 1.0, (0.0, 0.0, -1.0)
    hits = scene.cast_rays(tensor(rays), nthreads=1)
    missing = ~np.isfinite(hits["t_hit"].numpy())
    triangle = hits["primitive_ids"].numpy().astype(np.int64)
    weights = hits["primitive_uvs"].numpy()
    step = 1.0
    while missing.any() and step > 0.5:
        # the chart is convex and centred: towards the middle a texel outside meets its border
        step -= 0.002
        rays[missing, :2] = 0.5 + step * (points[missing] - 0.5)
        again = scene.cast_rays(tensor(rays[missing]), nthreads=1)
        found = np.isfinite(again["t_hit"].numpy())
        index = np.flatnonzero(missing)[found]
        triangle[index] = again["primitive_ids"].numpy()[found]
        weights[index] = again["primitive_uvs"].numpy()[found]
        missing[index] = False
    quads = topology.quads
    triangles = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])[triangle]
    share = np.stack([1 - weights.sum(axis=1), weights[:, 0], weights[:, 1]], axis=1)
    result = share[:, :1] * attributes[triangles[:, 0]]
    result += share[:, 1:2] * attributes[triangles[:, 1]]
    result += share[:, 2:] * attributes[triangles[:, 2]]
    return np.asarray(result)


def skin_color(points: SingleArray, masks: SingleArray, contrast: float, seed: int) -> SingleArray:
    """sRGB colour (N, 3), 0..255, of neutral canonical positions (N, 3) with their masks (N, 5)."""
    from capture_eval.images.solid_noise_kernels import gradient_noise, spots

    base = 101 * seed
    blotch = gradient_noise(points, 34.0, base + 1) + 0.6 * gradient_noise(points, 12.0, base + 2)
    mottle = gradient_noise(points, 5.0, base + 3)
    grain = gradient_noise(points, 2.6, base + 4)
    pores = gradient_noise(points, 1.3, base + 5) + 0.6 * gradient_noise(points, 0.7, base + 6)
    freckles = spots(points, 6.0, 0.5, (0.7, 1.7), base + 7)
    moles = spots(points, 34.0, 0.3, (1.2, 2.4), base + 8)
    light = contrast * (6.0 * blotch + 7.5 * mottle + 10.0 * grain + 10.0 * pores)
    redness = contrast * 9.0 * blotch + 10.0 * _flush(points)
    color = np.empty((len(points), 3), dtype=np.float32)
    for channel, (tint, spot) in enumerate(((0.35, 26.0), (-0.85, 34.0), (-0.55, 34.0))):
        color[:, channel] = _SKIN[channel] + light + tint * redness
        color[:, channel] -= contrast * spot * freckles + contrast * (50.0 + 12 * channel) * moles
    _paint_lips(color, points, masks[:, 0], contrast, base)
    _paint_hair(color, points, masks, contrast, base)
    inside = np.clip(masks[:, 1] + 0.15 * grain * (masks[:, 1] > 0), 0, 1)[:, None]
    color += inside * (_INSIDE.astype(np.float32) + light[:, None] * 0.6 - color)
    color += 0.6 * masks[:, 4:5] * (np.array([196, 122, 116], dtype=np.float32) - color)
    color += 0.8 * masks[:, 2:3] * (np.array([58, 42, 38], dtype=np.float32) - color)
    return color


def _smooth_step(low: float, high: float, value: NDArray[np.floating]) -> SingleArray:
    share = np.clip((value - low) / (high - low), 0, 1)
    return np.asarray(share * share * (3 - 2 * share), dtype=np.float32)


def _flush(points: SingleArray) -> SingleArray:
    """Redder cheeks, nose tip, ears and chin, 0..1."""
    x, y, z = np.abs(points[:, 0]), points[:, 1], points[:, 2]
    cheek = np.exp(-(((x - 42) / 18) ** 2) - ((y + 32) / 18) ** 2 - ((z - 68) / 25) ** 2)
    nose = np.exp(-((x / 15) ** 2) - ((y + 36) / 10) ** 2 - ((z - 106) / 14) ** 2)
    ear = np.exp(-(((x - 80) / 9) ** 2) - ((y + 9) / 34) ** 2 - ((z + 20) / 26) ** 2)
    chin = np.exp(-((x / 16) ** 2) - ((y + 100) / 12) ** 2 - ((z - 92) / 14) ** 2)
    return np.asarray(cheek + 0.8 * nose + 0.8 * ear + 0.4 * chin, dtype=np.float32)


def _paint_lips(color: SingleArray, points: SingleArray, mask: SingleArray, contrast: float, base: int) -> None:
    """Redder lips with vertical creases (in place)."""
    from capture_eval.images.solid_noise_kernels import gradient_noise

    inside = mask > 0
    if not inside.any():
        return
    there = points[inside]
    crease = gradient_noise(there, (1.1, 6.0, 4.0), base + 21) + 0.5 * gradient_noise(there, 1.0, base + 22)
    edge = _smooth_step(0.25, 0.8, mask[inside] + 0.12 * gradient_noise(there, 2.0, base + 23))[:, None]
    target = _LIP.astype(np.float32) + (contrast * 20.0 * crease)[:, None]
    color[inside] += edge * (target - color[inside])


def _paint_hair(color: SingleArray, points: SingleArray, masks: SingleArray, contrast: float, base: int) -> None:
    """Cropped hair on the scalp, eyebrows and a shade of beard (in place)."""
    from capture_eval.images.solid_noise_kernels import gradient_noise, spots

    x, y, z = np.abs(points[:, 0]), points[:, 1], points[:, 2]
    scalp = y - np.interp(z, _HAIRLINE_Z, _HAIRLINE_Y).astype(np.float32)
    scalp = _smooth_step(-5, 5, scalp + 5.0 * gradient_noise(points, 7.0, base + 31)) * (1 - masks[:, 3])
    brow = _eyebrow(x, y, z)
    beard = _beard(x, y, z) * (1 - masks[:, 0])
    hairy = (scalp > 0) | (brow > 0) | (beard > 0)
    there = points[hairy]
    strand = gradient_noise(there, (0.9, 2.6, 2.6), base + 32) + 0.7 * gradient_noise(there, 0.8, base + 33)
    lock = gradient_noise(there, (4.0, 8.0, 8.0), base + 34)
    cover = scalp[hairy] * (0.80 + 0.16 * contrast * _smooth_step(-0.5, 0.5, strand + lock))
    brow_strand = gradient_noise(there, (2.8, 0.9, 2.0), base + 35) + 0.5 * gradient_noise(there, 0.9, base + 36)
    dense = np.sqrt(brow[hairy])
    cover = np.maximum(cover, dense * (0.42 + 0.5 * _smooth_step(-0.45, 0.25, brow_strand + 0.7 * dense - 0.4)))
    dots = spots(there, 1.7, 0.7, (0.30, 0.55), base + 37)
    cover = np.maximum(cover, beard[hairy] * (0.09 + contrast * 0.34 * dots))
    shade = _HAIR.astype(np.float32) + (contrast * (44.0 * strand + 26.0 * lock))[:, None]
    color[hairy] += cover[:, None] * (shade - color[hairy])


def _eyebrow(x: SingleArray, y: SingleArray, z: SingleArray) -> SingleArray:
    centre = np.interp(x, [9, 20, 34, 44, 53], [17.0, 19.5, 22.5, 21.5, 17.0])
    half = np.interp(x, [8, 11, 20, 40, 53, 56], [0.1, 3.6, 4.4, 3.2, 1.4, 0.1])
    mask = np.clip(1 - ((y - centre) / half) ** 2, 0, 1) * np.clip((x - 8) / 5, 0.0, 1.0)
    return np.asarray(mask * (x > 8) * (x < 56) * (z > 40), dtype=np.float32)


def _beard(x: SingleArray, y: SingleArray, z: SingleArray) -> SingleArray:
    line = np.interp(x, [0, 14, 26, 40, 62, 80], [-50, -51, -62, -58, -30, -20]).astype(np.float32)
    under = _smooth_step(-140, -118, y) * _smooth_step(-8, 8, z)
    return np.asarray(_smooth_step(4, -6, y - line) * under, dtype=np.float32)
