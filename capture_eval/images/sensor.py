"""From light to pixel values: sRGB coding and sensor noise."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]
ByteArray = NDArray[np.uint8]


def srgb_from_linear(linear: ArrayLike) -> FloatArray:
    """sRGB value in [0, 1] of linear light, clipped to [0, 1] (IEC 61966-2-1)."""
    light = np.clip(np.asarray(linear, dtype=np.float64), 0.0, 1.0)
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1.0 / 2.4) - 0.055)


def linear_from_srgb(coded: ArrayLike) -> FloatArray:
    """Linear light in [0, 1] of sRGB values in [0, 1] (IEC 61966-2-1)."""
    value = np.clip(np.asarray(coded, dtype=np.float64), 0.0, 1.0)
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)


def expose(linear: ArrayLike, noise: float, seed: Sequence[int]) -> ByteArray:
    """The photo a camera makes of linear light: sRGB coding, Gaussian noise, rounding.

    Parameters
    ----------
    linear
        (H, W, 3) linear light, 1 = white.
    noise
        Standard deviation of the noise in grey levels of 255, independent per pixel and channel.
    seed
        Numbers that name the photo; the same numbers give the same noise.

    Returns
    -------
    (H, W, 3) uint8.
    """
    coded = 255.0 * srgb_from_linear(linear)
    if noise > 0.0:
        random = np.random.default_rng(list(seed))
        coded = coded + noise * random.standard_normal(coded.shape, dtype=np.float32)
    return np.clip(np.rint(coded), 0.0, 255.0).astype(np.uint8)
