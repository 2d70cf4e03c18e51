"""One front view of every pose for the contact sheet."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..files.atomic import read_npz
from ..files.photo_files import list_photos

Floats = NDArray[np.float64]
WIDTH = 480


def front_photos(
    out: Path, poses: Sequence[Mapping[str, Any]], wanted: str | None, front: Floats
) -> list[NDArray[np.uint8] | None]:
    """Read one photo of every pose, small; None where there is none.

    The photo with the name ``wanted``; else the one whose solved camera stands most squarely before the face; else,
    where a pose has no solved cameras, the name that was chosen for another pose, or the middle one of the folder.
    """
    chosen: list[tuple[list[Path], str | None]] = []
    for pose in poses:
        folder = pose.get("photos")
        photos = list_photos(Path(folder)) if folder and Path(folder).is_dir() else []
        name = wanted if wanted is not None else _squarest_view(out / "work", str(pose["name"]), front)
        chosen.append((photos, name))
    usual = next((name for _, name in chosen if name is not None), None)
    return [_read_small(_pick(photos, name or usual)) for photos, name in chosen]


def _pick(photos: Sequence[Path], name: str | None) -> Path | None:
    named = [path for path in photos if path.name == name]
    return named[0] if named else photos[len(photos) // 2] if photos else None


def _squarest_view(work: Path, pose_name: str, front: Floats) -> str | None:
    """Name of the photo whose camera stands closest to the line on which the face looks."""
    model, link = work / pose_name / "sparse", work / "register" / "head_from_pose.npz"
    if not model.is_dir() or not link.is_file():
        return None
    from ..files.colmap_files import read_sparse_model

    try:
        views = read_sparse_model(model).views
        saved = read_npz(link)
    except InputError:
        return None
    names = [str(name) for name in saved.get("pose_names", [])]
    if pose_name not in names or "rotation" not in saved:
        return None
    rotation = saved["rotation"][names.index(pose_name)]
    if not np.all(np.isfinite(rotation)) or not views:
        return None
    # The optical axis is compared, not the place of the camera: it needs no origin.
    scores = {name: float(-(view.rotation[2] @ rotation.T) @ front) for name, view in sorted(views.items())}
    return max(scores, key=lambda name: scores[name])


def _read_small(path: Path | None) -> NDArray[np.uint8] | None:
    from PIL import Image, ImageOps, UnidentifiedImageError

    if path is None:
        return None
    try:
        with Image.open(path) as photo:
            upright = ImageOps.exif_transpose(photo).convert("RGB")
            upright.thumbnail((WIDTH, 2 * WIDTH), Image.Resampling.LANCZOS)
            return np.asarray(upright, dtype=np.uint8)
    except (OSError, UnidentifiedImageError, Image.DecompressionBombError):
        return None
