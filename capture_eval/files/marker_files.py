"""Markers on disk: a YAML file with places of named markers in photos or space, or the dictionary of printed tags."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture_eval.errors import InputError
from capture_eval.files.coordinate_lists import coordinates
from capture_eval.files.manifest_files import read_yaml

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class MarkerPlace:
    """Where one marker is in one pose.

    Parameters
    ----------
    photos : mapping of photo name to (2,) pixel
        The centre of the top-left pixel is (0.5, 0.5).
    point : (3,) or None
        Known place instead of pixels, in the frame of the pose's cameras.
    """

    photos: Mapping[str, Floats]
    point: Floats | None


@dataclass(frozen=True)
class MarkerFile:
    """Content of a marker file.

    Parameters
    ----------
    dictionary : str or None
        Family of printed tags to look for in all photos, as OpenCV names it without DICT_: `APRILTAG_36h11`.
    places : mapping of pose name to mapping of marker name to MarkerPlace
    """

    dictionary: str | None
    places: Mapping[str, Mapping[str, MarkerPlace]]


def read_markers(path: Path, pose_names: Sequence[str]) -> MarkerFile:
    """Read a marker file: ``dictionary: NAME``, or a list ``markers`` of ``{name, poses}``, or both.

    Under ``poses`` every pose has ``{PHOTO: [u, v], ...}`` or ``[x, y, z]``; a marker need not be in every pose.

    Raises
    ------
    InputError
        The file has neither key, names a pose that does not exist, or a place is no list of numbers.
    """
    document = read_yaml(path)
    if not isinstance(document, dict) or not set(document) <= {"dictionary", "markers"} or not document:
        raise InputError(f"{path}: needs the keys 'dictionary' or 'markers' (or both) and no others")
    dictionary = document.get("dictionary")
    if dictionary is not None and not isinstance(dictionary, str):
        raise InputError(f"{path}: dictionary is the name of a family of tags, not {dictionary!r}")
    rows = document.get("markers") or []
    if not isinstance(rows, list):
        raise InputError(f"{path}: 'markers' is not a list")
    places: dict[str, dict[str, MarkerPlace]] = {name: {} for name in pose_names}
    for number, row in enumerate(rows):
        if not isinstance(row, dict) or "name" not in row or not isinstance(row.get("poses"), dict):
            raise InputError(f"{path}: marker {number} needs 'name' and 'poses'")
        name = str(row["name"])
        for pose, place in row["poses"].items():
            if pose not in places:
                raise InputError(f"{path}: marker {name}: there is no pose {pose!r}")
            if name in places[pose]:
                raise InputError(f"{path}: marker {name} is listed twice")
            places[pose][name] = _place(path, name, place)
    return MarkerFile(None if dictionary is None else dictionary.removeprefix("DICT_"), places)


def _place(path: Path, name: str, place: Any) -> MarkerPlace:
    owner = f"marker {name}"
    if isinstance(place, dict):
        return MarkerPlace({str(photo): coordinates(path, owner, pixel, 2) for photo, pixel in place.items()}, None)
    return MarkerPlace({}, coordinates(path, owner, place, 3))
