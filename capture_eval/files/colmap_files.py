"""Reading of COLMAP models and databases into arrays.

COLMAP's pixel convention is kept: the centre of the top-left pixel is (0.5, 0.5).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from capture_eval.cameras import Intrinsics, View
from capture_eval.errors import InputError

if TYPE_CHECKING:
    import pycolmap


@dataclass(frozen=True)
class SparseModel:
    """A solved structure-from-motion model.

    Attributes
    ----------
    views : dict of str to View
        Registered photos by name, in the order of their names.
    points : (N, 3) array
        Triangulated points in the model's own frame.
    tracks : dict of str to (K,) int array
        For every photo and every keypoint of the database: the row of `points` or -1.
    """

    views: dict[str, View]
    points: NDArray[np.float64]
    tracks: dict[str, NDArray[np.int64]]


def read_sparse_model(folder: Path) -> SparseModel:
    """Read a COLMAP model folder (cameras.bin, images.bin, points3D.bin).

    Raises
    ------
    InputError
        When the folder holds no readable model.
    """
    import pycolmap

    try:
        reconstruction = pycolmap.Reconstruction(str(folder))
    except (ValueError, RuntimeError, OSError) as error:
        raise InputError(f"{folder}: no readable COLMAP model ({error}); run the sparse stage first") from error
    point_ids = sorted(reconstruction.points3D)
    row_of_point = {point_id: row for row, point_id in enumerate(point_ids)}
    points = np.array([reconstruction.points3D[point_id].xyz for point_id in point_ids], dtype=np.float64)
    images = sorted((image for image in reconstruction.images.values() if image.has_pose), key=lambda image: image.name)
    views: dict[str, View] = {}
    tracks: dict[str, NDArray[np.int64]] = {}
    for image in images:
        views[image.name] = _view_from_colmap(image, reconstruction.cameras[image.camera_id])
        tracks[image.name] = np.array(
            [row_of_point[p.point3D_id] if p.has_point3D() else -1 for p in image.points2D], dtype=np.int64
        )
    return SparseModel(views=views, points=points.reshape(-1, 3), tracks=tracks)


def _view_from_colmap(image: pycolmap.Image, camera: pycolmap.Camera) -> View:
    pose = image.cam_from_world()
    return View(
        name=image.name,
        intrinsics=intrinsics_from_colmap(camera),
        rotation=np.array(pose.rotation.matrix(), dtype=np.float64),
        translation=np.array(pose.translation, dtype=np.float64),
    )


def intrinsics_from_colmap(camera: pycolmap.Camera) -> Intrinsics:
    """Pinhole matrix and OpenCV distortion of a COLMAP camera without fisheye terms.

    Raises
    ------
    InputError
        For a camera model other than SIMPLE_PINHOLE, PINHOLE, SIMPLE_RADIAL, RADIAL or OPENCV.
    """
    model = str(camera.model_name)
    values = [float(value) for value in camera.params]
    if model in ("SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL"):
        focal_x, focal_y, centre_x, centre_y = values[0], values[0], values[1], values[2]
        distortion = values[3:]
    elif model in ("PINHOLE", "OPENCV"):
        focal_x, focal_y, centre_x, centre_y = values[:4]
        distortion = values[4:]
    else:
        raise InputError(f"camera model {model} is not supported; use SIMPLE_RADIAL, RADIAL, PINHOLE or OPENCV")
    padded = np.zeros(4)
    padded[: len(distortion)] = distortion
    matrix = np.array([[focal_x, 0.0, centre_x], [0.0, focal_y, centre_y], [0.0, 0.0, 1.0]])
    return Intrinsics(width=int(camera.width), height=int(camera.height), matrix=matrix, distortion=padded)


@dataclass(frozen=True)
class PhotoFeatures:
    """SIFT features of one photo: keypoints (K, 2) in pixels, descriptors (K, 128) float32 of unit length."""

    keypoints: NDArray[np.float64]
    descriptors: NDArray[np.float32]


def read_features(database: Path) -> dict[str, PhotoFeatures]:
    """Keypoints and descriptors of every photo in a COLMAP database, by photo name.

    Raises
    ------
    InputError
        When the database does not exist.
    """
    import pycolmap

    if not database.is_file():
        raise InputError(f"{database}: no feature database; run the sparse stage first")
    features = {}
    handle = pycolmap.Database.open(str(database))
    try:
        for image in handle.read_all_images():
            keypoints = np.asarray(handle.read_keypoints(image.image_id), dtype=np.float64)
            raw = handle.read_descriptors(image.image_id)
            descriptors = np.asarray(getattr(raw, "data", raw)).view(np.uint8).astype(np.float32)
            descriptors = descriptors.reshape(len(keypoints), -1)
            lengths = np.linalg.norm(descriptors, axis=1, keepdims=True)
            features[image.name] = PhotoFeatures(
                keypoints=keypoints[:, :2].copy(), descriptors=descriptors / np.maximum(lengths, 1e-12)
            )
    finally:
        handle.close()
    return features
