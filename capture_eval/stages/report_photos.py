"""Photos for the report: one front view of every pose, alone and with its solved camera."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..cameras import Intrinsics, View
from ..errors import InputError
from ..files.photo_files import list_photos
from ..similarity import transform_view

Floats = NDArray[np.float64]
WIDTH = 480
OVERLAY_WIDTH = 960


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
    return [_read_small(_pick(photos, name or usual), WIDTH) for photos, name in chosen]


@dataclass(frozen=True)
class PlacedPhoto:
    """A photo of a pose and its solved camera in the head frame."""

    row: int
    image: NDArray[np.uint8]
    view: View


def placed_photos(
    out: Path, poses: Sequence[Mapping[str, Any]], rows: Sequence[int], wanted: str | None, front: Floats
) -> list[PlacedPhoto]:
    """Read one photo with a solved camera for each of the chosen poses; poses without one are passed over."""
    found = []
    for row in rows:
        name, folder = str(poses[row]["name"]), poses[row].get("photos")
        views = _views_in_head_frame(out / "work", name)
        if not views or not folder:
            continue
        chosen = wanted if wanted in views else _squarest(views, front)
        image = _read_small(Path(folder) / chosen, OVERLAY_WIDTH, upright=False)
        if image is not None:
            found.append(PlacedPhoto(row, image, _scaled(views[chosen], image.shape[1], image.shape[0])))
    return found


def _scaled(view: View, width: int, height: int) -> View:
    """Fit a camera to a photo that was made smaller; COLMAP's pixel coordinates scale about the corner."""
    camera = view.intrinsics
    scale = np.array([[width / camera.width], [height / camera.height], [1.0]])
    return replace(view, intrinsics=Intrinsics(width, height, camera.matrix * scale, camera.distortion))


def _pick(photos: Sequence[Path], name: str | None) -> Path | None:
    named = [path for path in photos if path.name == name]
    return named[0] if named else photos[len(photos) // 2] if photos else None


def _squarest_view(work: Path, pose_name: str, front: Floats) -> str | None:
    """Name of the photo whose camera looks most squarely at the face; None for a pose without solved cameras."""
    views = _views_in_head_frame(work, pose_name)
    return _squarest(views, front) if views else None


def _squarest(views: Mapping[str, View], front: Floats) -> str:
    # The optical axis is compared, not the place of the camera: it needs no origin.
    return max(sorted(views), key=lambda name: float(-views[name].rotation[2] @ front))


def _views_in_head_frame(work: Path, pose_name: str) -> dict[str, View]:
    """Solved cameras of a pose in the head frame; empty when the pose was not solved or not aligned."""
    model, links = work / pose_name / "sparse", work / "register" / "head_from_pose.npz"
    if not model.is_dir() or not links.is_file():
        return {}
    from ..files.colmap_files import read_sparse_model
    from .registration_inputs import load_similarities

    try:
        views = read_sparse_model(model).views
        link = load_similarities(links).get(pose_name)
    except (InputError, KeyError):
        return {}
    return {} if link is None else {name: transform_view(view, link) for name, view in views.items()}


def _read_small(path: Path | None, width: int, upright: bool = True) -> NDArray[np.uint8] | None:
    from PIL import Image, ImageOps, UnidentifiedImageError

    if path is None:
        return None
    try:
        with Image.open(path) as photo:
            small = (ImageOps.exif_transpose(photo) if upright else photo).convert("RGB")
            small.thumbnail((width, 2 * width), Image.Resampling.LANCZOS)
            return np.asarray(small, dtype=np.uint8)
    except (OSError, UnidentifiedImageError, Image.DecompressionBombError):
        return None
