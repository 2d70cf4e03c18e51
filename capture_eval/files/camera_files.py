"""Known cameras on disk (``cameras.json``): one entry per pose and photo, in COLMAP's convention."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from capture_eval.cameras import Intrinsics, View
from capture_eval.errors import InputError
from capture_eval.files.atomic import read_json, write_json


def write_cameras(path: Path, views_of_pose: Mapping[str, Sequence[View]]) -> None:
    """Write the cameras of all poses; `View.name` is the photo's file name."""
    rows = [
        {
            "pose": pose,
            "photo": view.name,
            "width": view.intrinsics.width,
            "height": view.intrinsics.height,
            "matrix": view.intrinsics.matrix.tolist(),
            "distortion": view.intrinsics.distortion.tolist(),
            "rotation": view.rotation.tolist(),
            "translation": view.translation.tolist(),
        }
        for pose, views in views_of_pose.items()
        for view in views
    ]
    write_json(path, {"convention": "view_from_world; first pixel centre (0.5, 0.5); millimetres", "views": rows})


def read_cameras(path: Path) -> dict[str, list[View]]:
    """Read the cameras of all poses: pose name -> views in the order of the file.

    Raises
    ------
    InputError
        The file is missing or an entry is incomplete or no camera.
    """
    data = read_json(path)
    cameras: dict[str, list[View]] = {}
    rows = data.get("views") if isinstance(data, dict) else None
    if not isinstance(rows, list):
        raise InputError(f"{path}: no list named views")
    for number, row in enumerate(rows):
        try:
            intrinsics = Intrinsics(
                int(row["width"]),
                int(row["height"]),
                np.array(row["matrix"], dtype=np.float64),
                np.array(row["distortion"], dtype=np.float64),
            )
            view = View(
                str(row["photo"]),
                intrinsics,
                np.array(row["rotation"], dtype=np.float64),
                np.array(row["translation"], dtype=np.float64),
            )
            cameras.setdefault(str(row["pose"]), []).append(view)
        except (KeyError, TypeError, ValueError) as error:
            raise InputError(f"{path}: view {number} is no camera ({error})") from None
    return cameras
