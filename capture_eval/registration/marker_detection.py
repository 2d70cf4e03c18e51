"""Corners of printed tags (ArUco, AprilTag) in photos."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from capture_eval.errors import InputError

Floats = NDArray[np.float64]


def detect_tags(image: NDArray[np.uint8], dictionary: str) -> dict[str, Floats]:
    """Corners of all tags in a photo.

    Parameters
    ----------
    image : (H, W, 3) or (H, W) uint8
    dictionary : str
        OpenCV's name of the family without DICT_, for example `APRILTAG_36h11`.

    Returns
    -------
    dict of str to (2,) float64
        `NUMBER:CORNER` (corners 0 to 3, clockwise from the tag's own top left) and the pixel, the centre of the
        top-left pixel being (0.5, 0.5). A tag that is seen twice in one photo is left out.

    Raises
    ------
    InputError
        OpenCV knows no such family.
    """
    import cv2

    number = getattr(cv2.aruco, f"DICT_{dictionary}", None)
    if number is None:
        raise InputError(f"markers: OpenCV knows no tags called {dictionary}; APRILTAG_36h11 and 4X4_50 are examples")
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(number), parameters)
    grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    corners, numbers, _ = detector.detectMarkers(grey)
    if numbers is None:
        return {}
    found = [int(tag) for tag in np.asarray(numbers).ravel()]
    result: dict[str, Floats] = {}
    for tag, pixels in zip(found, corners, strict=True):
        if found.count(tag) > 1:
            continue
        for corner, pixel in enumerate(np.asarray(pixels, dtype=np.float64).reshape(4, 2)):
            result[f"{tag}:{corner}"] = pixel + 0.5
    return result
