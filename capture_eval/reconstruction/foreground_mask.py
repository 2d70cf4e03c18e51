"""Where a photo has anything to compare: plain surroundings are left out right up to the outlines they meet.

A patch at a plain backdrop next to an outline is matched by the outline alone, so every photo would give the backdrop
the depth of the outline, and all photos would agree: a fringe as wide as the patch that no comparison of depth maps
removes.  So large plain regions (no variation beyond the sensor's noise) are found first and then grown to the
outline, over pixels of their own colour.  No colour is assumed; a photo without plain regions loses nothing.
"""

import numpy as np
from numpy.typing import NDArray

Singles = NDArray[np.float32]
Flags = NDArray[np.bool_]

_LIKE_COLOUR = 24.0  # grey levels at which a neighbour no longer counts as of like colour
_NOISE_FROM_PLAINEST = 1.45  # from the 5th percentile of the variance of plain patches to its median
_ABOVE_NOISE = 1.6  # most patches of pure noise stay below, the median filter closes the rest
_PAD = 8


def plainness(grey: Singles, radius: int) -> Singles:
    """Variance (H, W) of the grey values around a pixel that are like its own, grey levels squared."""
    import cv2

    from capture_eval.reconstruction.plainness_kernels import plainness_rows

    padded = np.ascontiguousarray(np.pad(grey, _PAD, mode="edge"))
    centre = np.ascontiguousarray(cv2.GaussianBlur(grey, (3, 3), 0.7))
    variance = np.zeros(grey.shape, np.float32)
    plainness_rows(
        np.array([0, grey.shape[0]]), padded.ravel(), padded.shape[1], _PAD, centre,
        radius, np.float32(_LIKE_COLOUR), variance,
    )  # fmt: skip
    return variance


def plain_region(grey: Singles, radius: int, most_noise: float, smallest_share: float = 0.01) -> Flags:
    """Large regions (H, W) that do not vary beyond noise.

    The noise is taken from the plainest twentieth of the photo, but never above `most_noise` (standard deviation, grey
    levels): a photo without plain places must not lose its weakest texture.
    """
    import cv2

    variance = plainness(grey, radius)
    noise = min(_NOISE_FROM_PLAINEST * float(np.percentile(variance, 5.0)), most_noise**2)
    plain = cv2.medianBlur((variance <= _ABOVE_NOISE * noise).astype(np.uint8), 5)
    _, labels, numbers, _ = cv2.connectedComponentsWithStats(plain, connectivity=4)
    large = numbers[:, cv2.CC_STAT_AREA] >= smallest_share * grey.size
    large[0] = False
    return np.asarray(large[labels])


def textured_region(colour: NDArray[np.uint8], radius: int, most_noise: float = 1.6, tolerance: float = 9.0) -> Flags:
    """Pixels (H, W) that are worth matching.

    Parameters
    ----------
    colour : (H, W, 3) uint8
    radius : int
        Half width of the patches that will be compared, pixels: how far an outline reaches into plain surroundings.
    most_noise : float
        Largest standard deviation of sensor noise that is believed, grey levels of the mean of the channels.
    tolerance : float
        Largest difference of a channel from the plain region nearby, grey levels; covers JPEG's ringing at outlines.

    Returns
    -------
    (H, W) bool
    """
    import cv2

    values = colour.astype(np.float32)
    plain = plain_region(np.ascontiguousarray(values.mean(axis=2)), radius, most_noise)
    if not plain.any():
        return np.ones(plain.shape, np.bool_)
    share = plain.astype(np.float32)
    size = (8 * radius + 1, 8 * radius + 1)
    total = cv2.blur(share, size)
    mean = cv2.blur(values * share[..., None], size) / np.maximum(total, 1e-6)[..., None]
    alike = np.max(np.abs(cv2.blur(values, (3, 3)) - mean), axis=2) < tolerance
    near = cv2.dilate(plain.astype(np.uint8), np.ones((2 * radius + 5, 2 * radius + 5), np.uint8)) > 0
    return np.asarray(~(plain | (near & alike & (total > 0))))
