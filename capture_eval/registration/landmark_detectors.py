"""Detectors of facial landmarks that other packages offer, by name, and what they may return.

A package offers one under the entry point group ``capture_eval.landmarks``::

    [project.entry-points."capture_eval.landmarks"]
    my_detector = "my_package:detect"

    def detect(image):                      # (height, width, 3) uint8 RGB
        return {"nose_tip": (312.5, 201.0), "chin": (300.0, 350.0, 0.4)}

The result maps names of the template's landmarks to pixels x, y (the centre of the top-left pixel is (0.5, 0.5)) and,
if known, a confidence in [0, 1]. A landmark that is not seen is left out; a photo without a face gives an empty
mapping. The suite itself brings no detector and downloads no model.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib import metadata
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture_eval.errors import InputError, ToolError

ENTRY_POINT_GROUP = "capture_eval.landmarks"

LandmarkDetector = Callable[[NDArray[np.uint8]], Mapping[str, Sequence[float]]]


@dataclass(frozen=True)
class Detection:
    """A detected landmark: pixel (x, y) and confidence in [0, 1], 1 where the detector gives none."""

    pixel: tuple[float, float]
    confidence: float = 1.0


def known_detectors() -> list[str]:
    """Names of the detectors that installed packages offer."""
    return sorted({entry.name for entry in metadata.entry_points(group=ENTRY_POINT_GROUP)})


def load_detector(name: str) -> LandmarkDetector:
    """A detector by its name.

    Raises
    ------
    InputError
        No installed package offers it, its import fails, or it is no function.
    """
    for entry in metadata.entry_points(group=ENTRY_POINT_GROUP, name=name):
        try:
            detector = entry.load()
        except Exception as problem:  # whatever another package's import may raise
            raise InputError(f"landmark detector '{name}' ({entry.value}) cannot be loaded: {problem}") from problem
        if not callable(detector):
            raise InputError(f"landmark detector '{name}' ({entry.value}) is not a function of an image")
        found: LandmarkDetector = detector
        return found
    offered = ", ".join(known_detectors()) or "none"
    raise InputError(
        f"no landmark detector '{name}' is installed (offered: {offered}); install a package with the entry point "
        f"group {ENTRY_POINT_GROUP}, or give pixels by hand"
    )


def detect_landmarks(detector: LandmarkDetector, image: NDArray[np.uint8], where: str) -> dict[str, Detection]:
    """What a detector finds in a photo, checked.

    Parameters
    ----------
    detector : callable
    image : (H, W, 3) uint8
        A copy is handed over.
    where : str
        Detector and photo, for errors.

    Raises
    ------
    ToolError
        The detector raises, or returns something else than names with pixels inside the photo.
    """
    try:
        result = detector(image.copy())
    except Exception as problem:  # whatever another package may raise
        raise ToolError(f"{where}: the detector failed: {type(problem).__name__}: {problem}") from problem
    if not isinstance(result, Mapping):
        raise ToolError(f"{where}: the detector returned {type(result).__name__}, expected name: (x, y[, confidence])")
    return {_name(name, where): _detection(name, value, image.shape, where) for name, value in result.items()}


def _name(name: Any, where: str) -> str:
    if not isinstance(name, str) or not name:
        raise ToolError(f"{where}: the detector returned the name {name!r}, expected text")
    return name


def _detection(name: str, value: Any, shape: tuple[int, ...], where: str) -> Detection:
    try:
        numbers = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        numbers = np.zeros(0)
    if numbers.shape not in ((2,), (3,)) or not np.all(np.isfinite(numbers)):
        raise ToolError(f"{where}: the detector returned {name}: {value!r}, expected x, y and maybe a confidence")
    x, y, *confidence = numbers.tolist()
    if not (0 <= x <= shape[1] and 0 <= y <= shape[0]):
        raise ToolError(f"{where}: the detector put {name} at {x:g},{y:g}, outside the photo of {shape[1]}x{shape[0]}")
    if confidence and not 0 <= confidence[0] <= 1:
        raise ToolError(f"{where}: the detector gave {name} the confidence {confidence[0]:g}, expected 0 to 1")
    return Detection((x, y), *confidence)
