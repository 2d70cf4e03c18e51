"""Landmarks on disk: a YAML list of template vertices with their pixels in photos, or with a point in space."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture_eval.errors import InputError
from capture_eval.files.atomic import write_text
from capture_eval.files.coordinate_lists import coordinates
from capture_eval.files.manifest_files import read_yaml


@dataclass(frozen=True)
class Landmark:
    """A named template vertex and where it is on the neutral face.

    Parameters
    ----------
    name : str
    vertex : int
        Of the template.
    photos : mapping of photo name to (2,) pixel
        The centre of the top-left pixel is (0.5, 0.5).
    point : (3,) or None
        Known place instead of pixels, in the frame of the neutral's cameras.
    """

    name: str
    vertex: int
    photos: Mapping[str, NDArray[np.float64]]
    point: NDArray[np.float64] | None


def read_landmarks(path: Path, vertex_count: int) -> list[Landmark]:
    """Read landmarks and check them against the template.

    Raises
    ------
    InputError
        The file is unreadable, a landmark lacks a key, names a vertex outside the template, or occurs twice.
    """
    document = read_yaml(path)
    rows = document.get("landmarks") if isinstance(document, dict) else None
    if not isinstance(rows, list) or not rows:
        raise InputError(f"{path}: no list 'landmarks'")
    landmarks = [_landmark(path, number, row, vertex_count) for number, row in enumerate(rows)]
    names = [landmark.name for landmark in landmarks]
    doubles = sorted({name for name in names if names.count(name) > 1})
    if doubles:
        raise InputError(f"{path}: landmark {doubles[0]} is listed twice")
    return landmarks


def read_landmark_rows(path: Path, vertex_count: int) -> list[dict[str, Any]]:
    """Read landmarks as they stand in the file, for changing them; rows without a place yet are allowed.

    Raises
    ------
    InputError
        As :func:`read_landmarks`, but for a missing place.
    """
    document = read_yaml(path)
    rows = document.get("landmarks") if isinstance(document, dict) else None
    if not isinstance(rows, list) or not rows:
        raise InputError(f"{path}: no list 'landmarks'")
    names = set[str]()
    for number, row in enumerate(rows):
        placed = not isinstance(row, dict) or bool(row.get("photos")) or row.get("point") is not None
        name = _landmark(path, number, row if placed else row | {"point": [0.0, 0.0, 0.0]}, vertex_count).name
        if name in names:
            raise InputError(f"{path}: landmark {name} is listed twice")
        names.add(name)
    return rows


def write_landmark_rows(path: Path, rows: list[dict[str, Any]]) -> None:
    """Write landmarks; the file is there whole or not at all."""
    import yaml

    text = yaml.safe_dump({"landmarks": rows}, sort_keys=False, default_flow_style=None, width=110, allow_unicode=True)
    write_text(path, text)


def _landmark(path: Path, number: int, row: Any, vertex_count: int) -> Landmark:
    if not isinstance(row, dict) or "name" not in row or "vertex" not in row:
        raise InputError(f"{path}: landmark {number} needs 'name' and 'vertex'")
    name, vertex = str(row["name"]), row["vertex"]
    if not isinstance(vertex, int) or not 0 <= vertex < vertex_count:
        raise InputError(f"{path}: landmark {name}: vertex {vertex!r} is not one of the template's {vertex_count}")
    photos = row.get("photos") or {}
    point = row.get("point")
    if not isinstance(photos, dict) or (point is None and not photos):
        raise InputError(f"{path}: landmark {name} needs 'photos' (photo: [u, v]) or 'point' ([x, y, z])")
    pixels = {str(photo): coordinates(path, f"landmark {name}", pixel, 2) for photo, pixel in photos.items()}
    return Landmark(name, vertex, pixels, None if point is None else coordinates(path, f"landmark {name}", point, 3))
