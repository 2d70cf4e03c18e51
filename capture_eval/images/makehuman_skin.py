"""Skin colour of a MakeHuman head: a function of the place on a neutral reference head, so it has no seams.

Places are those of the average head (millimetres, x = subject's left, y up, z front, origin at the head joint), the
same for all identities: brows and lips stay where the anatomy has them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capture_eval.images.head import Contrast

FloatArray = NDArray[np.floating]
SingleArray = NDArray[np.float32]
ByteArray = NDArray[np.uint8]

# Hair grows above this line: depth z (front positive) against height y.
_HAIRLINE_Z = (-95.0, -60.0, -44.0, -36.0, -28.0, 14.0, 20.0, 28.0, 36.0, 50.0, 66.0, 100.0)
_HAIRLINE_Y = (-44.0, -42.0, -30.0, 10.0, 48.0, 48.0, 14.0, 18.0, 56.0, 80.0, 95.0, 95.0)
_LIP_TINT = (0.86, 0.70, 0.76)
# Mean of the default skin colour, for which the sizes of all variations are written.
_USUAL_BRIGHTNESS = 169.0
# The subject's left brow from the nose outwards: x, y, half width, hair direction in degrees from outwards.
_BROW = np.array(
    [
        [9.0, 50.5, 2.6, 75.0],
        [15.0, 53.0, 3.3, 55.0],
        [24.0, 55.5, 3.2, 28.0],
        [35.0, 56.5, 2.7, 8.0],
        [44.0, 54.0, 2.0, -22.0],
        [50.0, 50.0, 1.0, -40.0],
    ]
)


@dataclass(frozen=True)
class SkinTone:
    """Colours of one person, sRGB.

    Attributes
    ----------
    skin, hair
        Mean colours; the lips are a redder, darker skin.
    freckles
        0 = none, 1 = many.
    seed
        Of all random detail.
    """

    skin: tuple[float, float, float] = (209.0, 162.0, 136.0)
    hair: tuple[float, float, float] = (92.0, 70.0, 55.0)
    freckles: float = 0.7
    seed: int = 0


@dataclass(frozen=True)
class SkinPlaces:
    """What the colour depends on, for N texels.

    Attributes
    ----------
    points
        (N, 3) place on the reference head, millimetres.
    lips, inside, lid
        (N,) in [0, 1]: red of the lips, lining of mouth and eye sockets, edge of the lids.
    """

    points: FloatArray
    lips: FloatArray
    inside: FloatArray
    lid: FloatArray


def skin_colors(places: SkinPlaces, tone: SkinTone, contrast: Contrast) -> ByteArray:
    """sRGB colour (N, 3) of the skin at the given places.

    Parameters
    ----------
    contrast
        ``weak`` reduces freckles, moles, pores and blotches to 0.4 of ``normal``.
    """
    strength = 0.4 if contrast == "weak" else 1.0
    points = np.ascontiguousarray(places.points, dtype=np.float32)
    brightness = np.float32(np.mean(tone.skin) / _USUAL_BRIGHTNESS)
    colors = np.asarray(tone.skin, dtype=np.float32) + brightness * _large_variation(points)
    colors += brightness * np.float32(strength) * _fine_variation(points, tone)
    _spot(colors, points, tone, strength)
    for chosen, paint in (
        (np.flatnonzero(points[:, 1] > hairline(points[:, 2]) - 8.0), _paint_hair),
        (np.flatnonzero(_near_brows(points)), _paint_brows),
    ):
        colors[chosen] = paint(colors[chosen], points[chosen], tone)
    for mask, paint_masked in ((places.lips, _paint_lips), (places.inside, _paint_inside)):
        chosen = np.flatnonzero(mask > 0.0)
        colors[chosen] = paint_masked(colors[chosen], points[chosen], mask[chosen], tone)
    # The dark edge of the lids stands in for lashes.
    colors *= (1.0 - 0.6 * np.clip(1.6 * places.lid - 0.6, 0.0, 1.0))[:, None].astype(np.float32)
    return np.asarray(np.clip(np.rint(colors), 0.0, 255.0), dtype=np.uint8)


def hairline(depth: FloatArray) -> FloatArray:
    """Height y above which hair grows, for the depth z (front positive), millimetres on the reference head."""
    return np.interp(depth, _HAIRLINE_Z, _HAIRLINE_Y)


def _noise(points: SingleArray, wavelength: float | tuple[float, float, float], seed: int) -> SingleArray:
    from capture_eval.images.solid_noise_kernels import gradient_noise

    return gradient_noise(points, wavelength, seed)


def _blob(points: SingleArray, center: tuple[float, float, float], radii: tuple[float, float, float]) -> SingleArray:
    """Gaussian bump at a place and its mirror image."""
    x, y, z = (np.float32(1.0 / radius) for radius in radii)
    squared = ((np.abs(points[:, 0]) - np.float32(center[0])) * x) ** 2
    squared += ((points[:, 1] - np.float32(center[1])) * y) ** 2
    squared += ((points[:, 2] - np.float32(center[2])) * z) ** 2
    return np.asarray(np.exp(np.float32(-0.5) * squared), dtype=np.float32)


def _colored(amount: SingleArray, color: tuple[float, float, float]) -> SingleArray:
    return amount[:, None] * np.asarray(color, dtype=np.float32)


def _large_variation(points: SingleArray) -> SingleArray:
    """Redder cheeks, nose and ears, darker below the eyes, a shade of beard."""
    red = 0.8 * _blob(points, (41.0, 2.0, 78.0), (14.0, 12.0, 30.0)) + 0.8 * _blob(
        points, (0.0, 3.0, 114.0), (12.0, 9.0, 14.0)
    )
    red += 0.6 * _blob(points, (79.0, 15.0, -12.0), (7.0, 30.0, 30.0))
    shade = _blob(points, (28.0, 26.0, 88.0), (13.0, 5.0, 20.0))
    beard = _blob(points, (20.0, -55.0, 88.0), (26.0, 20.0, 34.0))
    variation = _colored(red, (2.0, -20.0, -17.0)) + _colored(shade, (-22.0, -20.0, -12.0))
    return variation + _colored(beard, (-9.0, -4.0, 0.0))


def _fine_variation(points: SingleArray, tone: SkinTone) -> SingleArray:
    """Blotches, relief and pores from 40 mm down to half a millimetre; light and a little colour."""
    light = np.zeros(len(points), dtype=np.float32)
    for octave, (cell, amount) in enumerate(
        ((38.0, 8.0), (15.0, 5.0), (7.0, 4.0), (3.6, 5.0), (1.9, 8.0), (1.05, 11.0), (0.62, 11.0))
    ):
        light += np.float32(amount) * _noise(points, cell, tone.seed + 11 + octave)
    blush = 7.0 * _noise(points, 10.0, tone.seed + 31) + 4.0 * _noise(points, 2.6, tone.seed + 32)
    pores = np.minimum(_noise(points, 0.8, tone.seed + 33) + 0.12, 0.0)
    return _colored(light, (0.95, 1.0, 0.98)) + _colored(blush, (0.2, -0.8, -0.7)) + _colored(pores, (26.0, 29.0, 29.0))


def _spot(colors: SingleArray, points: SingleArray, tone: SkinTone, strength: float) -> None:
    """Freckles in two sizes and a few moles, painted into `colors` (which is changed)."""
    from capture_eval.images.solid_noise_kernels import spots

    shift = np.stack([_noise(points, 1.1, tone.seed + 41 + axis) for axis in range(3)], axis=1)
    ragged = points + np.float32(0.75) * shift
    sunny = 0.35 + 1.0 * _blob(points, (24.0, 10.0, 95.0), (24.0, 16.0, 40.0))
    sunny += 0.65 * _blob(points, (0.0, 74.0, 88.0), (48.0, 20.0, 40.0))
    patches = np.clip(0.8 + 1.6 * _noise(points, 13.0, tone.seed + 44), 0.0, 1.5)
    amount = np.clip(tone.freckles * sunny * patches, 0.0, 1.0).astype(np.float32) * np.float32(strength)
    for layer, (cell, radii, depth) in enumerate(((4.6, (1.0, 2.3), 0.42), (2.5, (0.6, 1.2), 0.36))):
        cover = np.minimum(1.6 * spots(ragged, cell, 0.55, radii, tone.seed + 50 + layer), 1.0) * amount * depth
        colors *= 1.0 - _colored(cover, (0.75, 1.15, 1.3))
    mole = np.minimum(3.0 * spots(ragged, 12.0, 0.22, (0.9, 2.2), tone.seed + 57), 1.0) * np.float32(0.75 * strength)
    colors += mole[:, None] * (np.array([88.0, 56.0, 44.0], dtype=np.float32) - colors)


def _paint_hair(colors: SingleArray, points: SingleArray, tone: SkinTone) -> SingleArray:
    """Hair cropped to a few millimetres: dark, with grain along the head."""
    above = points[:, 1] - hairline(points[:, 2])
    above += 5.0 * _noise(points, 9.0, tone.seed + 71) + 5.0 * _noise(points, 1.6, tone.seed + 72)
    cover = np.clip(above / 9.0 + 0.5, 0.0, 1.0)
    ear = (np.abs(points[:, 0]) > 71.0) & (points[:, 1] < 49.0) & (points[:, 2] > -52.0) & (points[:, 2] < 20.0)
    cover[ear] = 0.0
    strands = _noise(points, (0.55, 1.5, 1.5), tone.seed + 73)
    grain = (
        1.0 + 0.60 * strands + 0.50 * _noise(points, 1.3, tone.seed + 74) + 0.2 * _noise(points, 9.0, tone.seed + 75)
    )
    cover *= np.clip(0.78 + 0.9 * strands + 0.5 * _noise(points, 2.1, tone.seed + 76), 0.25, 0.96)
    hair = np.asarray(tone.hair, dtype=np.float32) * grain[:, None]
    return np.asarray(colors + cover[:, None] * (hair - colors), dtype=np.float32)


def _near_brows(points: SingleArray) -> NDArray[np.bool_]:
    x = np.abs(points[:, 0])
    near = (points[:, 2] > 55.0) & (x > 3.0) & (x < 56.0) & (np.abs(points[:, 1] - 53.0) < 13.0)
    return np.asarray(near, dtype=np.bool_)


def _paint_brows(colors: SingleArray, points: SingleArray, tone: SkinTone) -> SingleArray:
    """Single hairs along the brows."""
    x, y = np.abs(points[:, 0]), points[:, 1]
    middle, half, lean = (np.interp(x, _BROW[:, 0], _BROW[:, column]) for column in (1, 2, 3))
    angle = np.radians(lean)
    along = x * np.cos(angle) + (y - middle) * np.sin(angle)
    across = -x * np.sin(angle) + (y - middle) * np.cos(angle)
    side = np.where(points[:, 0] > 0.0, 0.0, 40.0)
    grid = np.stack([along, across, side], axis=1).astype(np.float32)
    hairs = _noise(grid, (8.0, 0.75, 1.0), tone.seed + 81) + 0.6 * _noise(grid, (5.0, 0.45, 1.0), tone.seed + 82)
    reach = np.clip(1.5 - np.abs(y - middle) / np.maximum(half, 0.1), -1.0, 1.0)
    reach *= np.clip((x - 6.5) / 3.0, 0.0, 1.0) * np.clip((53.0 - x) / 4.0, 0.0, 1.0)
    cover = np.clip(0.2 + 2.2 * (hairs + 0.75 * reach - 0.28), 0.0, 0.9) * (reach > 0.0)
    hair = 0.62 * np.asarray(tone.hair)
    return np.asarray(colors + cover[:, None] * (hair - colors), dtype=np.float32)


def _paint_lips(colors: SingleArray, points: SingleArray, mask: FloatArray, tone: SkinTone) -> SingleArray:
    furrows = _noise(points, (1.3, 9.0, 9.0), tone.seed + 91) + 0.7 * _noise(points, (0.65, 4.0, 4.0), tone.seed + 92)
    shade = (
        1.0 + 0.22 * furrows + 0.10 * _noise(points, 4.0, tone.seed + 93) + 0.12 * _noise(points, 1.1, tone.seed + 95)
    )
    lips = np.asarray(tone.skin) * np.asarray(_LIP_TINT) * shade[:, None]
    cover = np.clip((mask - 0.45 + 0.10 * _noise(points, 1.6, tone.seed + 94)) / 0.3, 0.0, 1.0)
    cover = cover * cover * (3.0 - 2.0 * cover)
    return np.asarray(colors + cover[:, None] * (lips - colors), dtype=np.float32)


def _paint_inside(colors: SingleArray, points: SingleArray, mask: FloatArray, tone: SkinTone) -> SingleArray:
    """Moist lining of mouth and eye sockets."""
    lining = np.array([150.0, 66.0, 62.0]) * (1.0 + 0.25 * _noise(points, 3.0, tone.seed + 61))[:, None]
    return np.asarray(colors + mask[:, None] * (lining - colors), dtype=np.float32)
