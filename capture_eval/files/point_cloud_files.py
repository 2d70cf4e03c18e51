"""Point clouds in PLY: coordinates, normals and further numbers per point."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from capture_eval.errors import InputError
from capture_eval.files.atomic import write_bytes
from capture_eval.files.ply_body import read_ascii_body, read_binary_body, read_header

Floats = NDArray[np.float64]


def write_point_cloud(path: Path, points: Floats, properties: Mapping[str, Floats]) -> None:
    """Write points (N, 3) and further numbers per point (N,) as binary PLY of doubles.

    Raises
    ------
    InputError
        A property has another length than there are points.
    """
    for name, values in properties.items():
        if np.shape(values) != (len(points),):
            raise InputError(f"{path}: property '{name}' has shape {np.shape(values)}, not ({len(points)},)")
    names = ("x", "y", "z", *properties)
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {len(points)}"]
    lines += [f"property double {name}" for name in names]
    table = np.column_stack([points, *properties.values()]).astype("<f8")
    write_bytes(Path(path), "\n".join([*lines, "end_header", ""]).encode("ascii") + table.tobytes())


def read_point_cloud(path: Path) -> tuple[Floats, dict[str, Floats]]:
    """Points (N, 3) and every further number per point of a PLY file, with or without faces.

    Raises
    ------
    InputError
        The file cannot be read, or has no points.
    """
    path = Path(path)
    elements, order, body = read_header(path)
    columns = read_binary_body(path, elements, order, body) if order else read_ascii_body(path, elements, body)
    vertex = {name: value for name, value in columns.get("vertex", {}).items() if isinstance(value, np.ndarray)}
    if not all(axis in vertex for axis in "xyz") or len(vertex["x"]) == 0:
        raise InputError(f"{path}: no points with x, y and z")
    points = np.stack([vertex.pop(axis).astype(np.float64) for axis in "xyz"], axis=1)
    return points, {name: value.astype(np.float64) for name, value in vertex.items()}
