"""What the align stage reads besides sparse points: markers, and points as the photos of a rig show them."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from capture_eval.cameras import View
from capture_eval.errors import RegistrationError
from capture_eval.files.atomic import read_json
from capture_eval.files.colmap_files import read_features, read_sparse_model
from capture_eval.files.jpeg_files import read_photo
from capture_eval.files.marker_files import MarkerFile, read_markers
from capture_eval.registration.landmark_triangulation import triangulate_point
from capture_eval.registration.marker_alignment import PlacedMarkers
from capture_eval.registration.marker_detection import detect_tags
from capture_eval.registration.rig_alignment import PhotographedPoints

logger = logging.getLogger("capture_eval.align")

Floats = NDArray[np.float64]


def load_photographed_points(pose_folder: Path) -> tuple[PhotographedPoints, dict[str, View]]:
    """Triangulated points of a pose with the pixels that show them, and its cameras."""
    model = read_sparse_model(pose_folder / "sparse")
    features = read_features(pose_folder / "database.db")
    pixels, rows = {}, {}
    for name in model.views:
        seen = model.tracks[name] >= 0
        pixels[name] = np.asarray(features[name].keypoints[seen][:, :2], dtype=np.float64)
        rows[name] = model.tracks[name][seen]
    return PhotographedPoints(model.points, pixels, rows), model.views


def load_markers(
    work: Path, pose_names: Sequence[str], usable: Sequence[bool], path: Path
) -> list[PlacedMarkers | None]:
    """Markers of every pose in space; None for poses without a reconstruction.

    Raises
    ------
    InputError
        The marker file is wrong, or a photo cannot be read.
    """
    content = read_markers(path, pose_names)
    return [
        _pose_markers(work / name, name, content) if good else None
        for name, good in zip(pose_names, usable, strict=True)
    ]


def _pose_markers(pose_folder: Path, name: str, content: MarkerFile) -> PlacedMarkers:
    views = read_sparse_model(pose_folder / "sparse").views
    points: dict[str, Floats] = {}
    pixels: dict[str, Mapping[str, Floats]] = {}
    for marker, place in content.places[name].items():
        if place.point is not None:
            points[marker] = place.point
        else:
            pixels[marker] = place.photos
    if content.dictionary is not None:
        pixels |= _detected(pose_folder, views, content.dictionary)
    for marker in sorted(pixels):
        try:
            points[marker] = triangulate_point(views, pixels[marker]).position
        except RegistrationError as error:
            logger.info("align %s: marker %s is left out: %s", name, marker, error)
    names = tuple(sorted(points))
    return PlacedMarkers(names, np.array([points[marker] for marker in names]).reshape(-1, 3))


def _detected(pose_folder: Path, views: Mapping[str, View], dictionary: str) -> dict[str, Mapping[str, Floats]]:
    """Pixels of all tags by name and photo."""
    folder = Path(read_json(pose_folder / "sparse.json")["photo_folder"])
    found: dict[str, dict[str, Floats]] = {}
    for photo in sorted(views):
        for marker, pixel in detect_tags(read_photo(folder / photo), dictionary).items():
            found.setdefault(f"tag {marker}", {})[photo] = pixel
    return {marker: photos for marker, photos in found.items() if len(photos) > 1}
