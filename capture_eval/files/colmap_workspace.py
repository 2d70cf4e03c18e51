"""COLMAP dense workspaces: undistorted photos with their cameras, and depth and normal maps.

A workspace holds ``images/``, ``sparse/`` (pinhole cameras) and ``stereo/`` with
``depth_maps/``, ``normal_maps/`` and ``fusion.cfg``.  A map is the text ``W&H&C&`` followed by
float32 values, one channel after the other, row by row (COLMAP's documented layout).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture_eval.cameras import View
from capture_eval.errors import InputError
from capture_eval.files.atomic import atomic_path, write_bytes, write_text
from capture_eval.files.colmap_files import read_sparse_model

Singles = NDArray[np.float32]


@dataclass(frozen=True)
class DenseWorkspace:
    """What dense stereo needs to know of a workspace.

    Attributes
    ----------
    folder : Path
    views : tuple of View
        Photos with a pose, in the order of their names; pinhole cameras.
    points : (N, 3) array
        Sparse points, frame of the model.
    visible : tuple of (K,) int array
        For every photo the rows of `points` seen in it.
    """

    folder: Path
    views: tuple[View, ...]
    points: NDArray[np.float64]
    visible: tuple[NDArray[np.int64], ...]

    def image_path(self, index: int) -> Path:
        """Photo `index` on disk."""
        return self.folder / "images" / self.views[index].name


def read_workspace(folder: Path) -> DenseWorkspace:
    """Read and check a workspace.

    Raises
    ------
    InputError
        No folder ``sparse``; fewer than two photos with a pose; no sparse points; a photo that is missing; a camera
        that is not a pinhole.
    """
    folder = Path(folder)
    if not (folder / "sparse").is_dir():
        raise InputError(f"{folder}: no folder sparse/ here; expected a COLMAP dense workspace (image_undistorter)")
    model = read_sparse_model(folder / "sparse")
    views = tuple(model.views.values())
    if len(views) < 2:
        raise InputError(f"{folder}: {len(views)} photo(s) with a pose, stereo needs at least two")
    if len(model.points) == 0:
        raise InputError(f"{folder}: the sparse model has no points; triangulate points first (point_triangulator)")
    for view in views:
        if np.any(view.intrinsics.distortion):
            raise InputError(f"{folder}: the camera of {view.name} has lens distortion; undistort the workspace first")
        if not (folder / "images" / view.name).is_file():
            raise InputError(f"{folder / 'images' / view.name}: photo of the sparse model is missing")
    visible = tuple(np.unique(track[track >= 0]) for track in model.tracks.values())
    return DenseWorkspace(folder=folder, views=views, points=model.points, visible=visible)


def read_colours(path: Path, view: View) -> NDArray[np.uint8]:
    """Colours (H, W, 3) of a photo.

    Raises
    ------
    InputError
        The file is no image, or its size is not its camera's.
    """
    from PIL import Image

    try:
        with Image.open(path) as image:
            pixels = np.asarray(image.convert("RGB"), dtype=np.uint8)
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read as an image ({error})") from error
    _check_size(path, pixels.shape[:2], view)
    return pixels


def read_mask(path: Path, view: View) -> NDArray[np.bool_]:
    """Mask (H, W), true where the picture is not black.

    Raises
    ------
    InputError
        The file is no image, or its size is not its camera's.
    """
    from PIL import Image

    try:
        with Image.open(path) as image:
            pixels = np.asarray(image.convert("L"))
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read as a mask ({error})") from error
    _check_size(path, pixels.shape, view)
    return np.asarray(pixels > 0)


def write_mask(path: Path, mask: NDArray[np.bool_]) -> None:
    """Write a mask (H, W) as a black and white PNG."""
    from PIL import Image

    with atomic_path(path) as temporary:
        Image.fromarray(np.where(mask, 255, 0).astype(np.uint8)).save(temporary)


def _check_size(path: Path, shape: tuple[int, ...], view: View) -> None:
    expected = (view.intrinsics.height, view.intrinsics.width)
    if tuple(shape) != expected:
        raise InputError(
            f"{path}: {shape[1]}x{shape[0]} pixels, but its camera has {expected[1]}x{expected[0]}; "
            "undistort the photos again"
        )


def map_path(workspace: Path, kind: str, name: str, stage: str) -> Path:
    """Where a map is kept; kind `depth`, `normal` or `confidence`, stage `photometric` or `geometric`."""
    return Path(workspace) / "stereo" / f"{kind}_maps" / f"{name}.{stage}.bin"


def write_map(path: Path, values: NDArray[Any]) -> None:
    """Write a map (H, W) or (H, W, C) as float32 in COLMAP's layout."""
    array = np.asarray(values, dtype="<f4")
    if array.ndim == 2:
        array = array[:, :, None]
    if array.ndim != 3:
        raise InputError(f"{path}: a map has shape {array.shape}, expected (H, W) or (H, W, C)")
    height, width, channels = array.shape
    header = f"{width}&{height}&{channels}&".encode("ascii")
    write_bytes(path, header + np.ascontiguousarray(array.transpose(2, 0, 1)).tobytes())


def read_map(path: Path) -> Singles:
    """Read a map: (H, W), or (H, W, C) when it has more than one channel.

    Raises
    ------
    InputError
        The file is missing, has another header, or is cut off.
    """
    try:
        content = Path(path).read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from error
    fields = content[:64].split(b"&", 3)
    if len(fields) < 4 or not all(field.isdigit() for field in fields[:3]):
        raise InputError(f"{path}: not a COLMAP map (expected 'width&height&channels&')")
    width, height, channels = (int(field) for field in fields[:3])
    start = sum(len(field) + 1 for field in fields[:3])
    if len(content) - start != 4 * width * height * channels:
        raise InputError(f"{path}: {len(content) - start} bytes of values, expected {4 * width * height * channels}")
    planar = np.frombuffer(content, dtype="<f4", offset=start).reshape(channels, height, width)
    return np.ascontiguousarray(planar[0] if channels == 1 else planar.transpose(1, 2, 0), dtype=np.float32)


def write_fusion_configuration(workspace: Path, names: list[str]) -> None:
    """List the photos that fusion shall use, one name a line."""
    write_text(Path(workspace) / "stereo" / "fusion.cfg", "".join(f"{name}\n" for name in names))
