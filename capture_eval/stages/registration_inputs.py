"""What the register stage reads: template, cameras, features, photos and scans, all brought to the working frame.

Working frame: the head frame (the template's own frame) scaled so that the template is 300 units large.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture_eval.cameras import View
from capture_eval.errors import InputError, RegistrationError
from capture_eval.files.atomic import read_json, read_npz, write_npz
from capture_eval.files.colmap_files import read_features, read_sparse_model
from capture_eval.files.jpeg_files import read_photo
from capture_eval.files.landmark_files import read_landmarks
from capture_eval.files.mesh_files import read_mesh, read_ply_with_properties
from capture_eval.polygon_mesh import PolygonMesh
from capture_eval.registration.landmark_triangulation import landmark_similarity, triangulate_point
from capture_eval.registration.lifted_matches import PosePhotos
from capture_eval.registration.nonrigid_icp import WORKING_SIZE, Landmarks
from capture_eval.registration.surface_correspondence import Surface
from capture_eval.registration.texture_atlas import cylindrical_texture_coordinates, rasterise_atlas
from capture_eval.registration.texture_rounds import PhotoSet, TextureAtlases
from capture_eval.similarity import Similarity, transform_view
from capture_eval.triangle_geometry import diameter

logger = logging.getLogger("capture_eval.register")

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

LARGEST_OVERLAP = 0.02


@dataclass(frozen=True)
class Template:
    """The template as the registration uses it.

    Parameters
    ----------
    mesh : PolygonMesh
        Head frame.
    triangles : (K, 3) int64
    corner_uv : (K, 3, 2) float64
    own_layout : bool
        Whether `corner_uv` is the template's own; a cylinder stands in when it has none that can be used.
    occluders : (vertices, triangles) or None
        Head frame.
    unit : float
        Length of one working unit in the head frame.
    """

    mesh: PolygonMesh
    triangles: Integers
    corner_uv: Floats
    own_layout: bool
    occluders: tuple[Floats, Integers] | None
    unit: float

    @property
    def working_from_head(self) -> Similarity:
        """Scales the head frame to the working frame."""
        return Similarity(1.0 / self.unit, np.eye(3), np.zeros(3))

    def atlases(self, flow_size: int, stereo_size: int) -> TextureAtlases:
        """Rasterised layouts."""
        return TextureAtlases(rasterise_atlas(self.corner_uv, flow_size), rasterise_atlas(self.corner_uv, stereo_size))


def load_template(path: Path, occluders: Path | None) -> Template:
    """Read a template and what hides its skin.

    Raises
    ------
    InputError
        The mesh is unreadable or flat.
    """
    mesh = read_mesh(path)
    triangles, _, _ = mesh.triangles()
    if len(triangles) == 0:
        raise InputError(f"{path}: the template has no faces")
    blockers = None
    if occluders is not None:
        blocking = read_mesh(occluders)
        blockers = (blocking.vertices, blocking.triangles()[0])
    corner_uv, own = _layout(mesh, triangles)
    return Template(mesh, triangles, corner_uv, own, blockers, diameter(mesh.vertices) / WORKING_SIZE)


def _layout(mesh: PolygonMesh, triangles: Integers) -> tuple[Floats, bool]:
    """The template's UV layout, or a cylinder when it has none, leaves the unit square, or overlaps itself."""
    if mesh.texture_coordinates is not None:
        corner_uv = mesh.corner_texture_coordinates()
        inside = corner_uv.min() >= -1e-6 and corner_uv.max() <= 1.0 + 1e-6
        if inside and rasterise_atlas(corner_uv, 512).overlap <= LARGEST_OVERLAP:
            return corner_uv, True
    return cylindrical_texture_coordinates(mesh.vertices, triangles), False


def place_landmarks(neutral: Path, path: Path, parts: Template) -> tuple[Similarity, Landmarks, list[dict[str, Any]]]:
    """Landmarks of the neutral in space.

    Returns
    -------
    head_from_neutral : Similarity
        From the frame of the neutral's cameras to the template's frame.
    placed : Landmarks
        In the working frame.
    rows : list of dict
        One per landmark, those left out included.

    Raises
    ------
    InputError, RegistrationError
        Too few landmarks can be placed, or they do not fit the template.
    """
    views = read_sparse_model(neutral / "sparse").views
    rows: list[dict[str, Any]] = []
    vertices, places, names = [], [], []
    for landmark in read_landmarks(path, len(parts.mesh.vertices)):
        row: dict[str, Any] = {"name": landmark.name, "vertex": landmark.vertex, "used": True, "reason": ""}
        if landmark.point is not None:
            place = landmark.point
        else:
            try:
                found = triangulate_point(views, landmark.photos)
                place, row["reprojection_error_px"] = found.position, found.reprojection_error
            except RegistrationError as error:
                rows.append(row | {"used": False, "reason": str(error)})
                logger.info("landmark %s is left out: %s", landmark.name, error)
                continue
        rows.append(row)
        vertices.append(landmark.vertex)
        places.append(place)
        names.append(landmark.name)
    if len(places) < 4:
        raise InputError(f"{path}: only {len(places)} landmarks could be placed in space, at least 4 are needed")
    index = np.array(vertices, dtype=np.int64)
    head_from_neutral, residual = landmark_similarity(np.array(places), parts.mesh.vertices[index], names)
    size = parts.unit * WORKING_SIZE
    for row, distance in zip([row for row in rows if row["used"]], residual, strict=True):
        row["residual"] = float(distance / size)
    working = parts.working_from_head.compose(head_from_neutral)
    placed = Landmarks(index, working.apply(np.array(places)), np.ones(len(index)))
    return head_from_neutral, placed, rows


def load_views(pose_folder: Path, working_from_pose: Similarity) -> dict[str, View]:
    """Solved cameras of a pose by photo name, in the working frame."""
    model = read_sparse_model(pose_folder / "sparse")
    return {name: transform_view(view, working_from_pose) for name, view in model.views.items()}


def load_pose_photos(pose_folder: Path, working_from_pose: Similarity) -> PosePhotos:
    """Cameras and features of a pose, the views in the order of their names."""
    views = load_views(pose_folder, working_from_pose)
    features = read_features(pose_folder / "database.db")
    names = sorted(views)
    return PosePhotos(
        tuple(views[name] for name in names),
        tuple(features[name].keypoints for name in names),
        tuple(features[name].descriptors for name in names),
    )


def load_photo_set(pose_folder: Path, working_from_pose: Similarity) -> PhotoSet:
    """Cameras and photos of a pose.

    Raises
    ------
    InputError
        A photo is gone or has changed its size.
    """
    views = load_views(pose_folder, working_from_pose)
    folder = Path(read_json(pose_folder / "sparse.json")["photo_folder"])
    names = sorted(views)
    return PhotoSet(tuple(views[name] for name in names), tuple(read_photo(folder / name) for name in names))


def load_scan(pose_folder: Path, working_from_pose: Similarity) -> Surface:
    """The pose's scan with its support.

    Raises
    ------
    InputError
        The scan is missing or empty.
    """
    path = pose_folder / "scan.ply"
    mesh, properties = read_ply_with_properties(path)
    triangles, _, _ = mesh.triangles()
    if len(triangles) == 0:
        raise InputError(f"{path}: the scan has no faces")
    support = properties.get("support")
    return Surface(working_from_pose.apply(mesh.vertices), triangles, _relative_support(support))


def _relative_support(support: Floats | None) -> Floats | None:
    """Support in [0, 1]: counts of supporting points are measured against their upper quartile."""
    if support is None:
        return None
    top = float(np.quantile(support, 0.75))
    if top <= 0:
        return None
    return np.clip(support / top, 0.0, 1.0)


def save_similarities(path: Path, names: Sequence[str], links: Sequence[Similarity | None]) -> None:
    """Write one similarity per pose; rows of failed poses are NaN."""
    nothing = np.full((3, 3), np.nan)
    write_npz(
        path,
        {
            "pose_names": np.array(list(names)),
            "scale": np.array([np.nan if link is None else link.scale for link in links]),
            "rotation": np.array([nothing if link is None else link.rotation for link in links]),
            "translation": np.array([nothing[0] if link is None else link.translation for link in links]),
            "ok": np.array([link is not None for link in links]),
        },
    )


def load_similarities(path: Path) -> dict[str, Similarity | None]:
    """Read one similarity per pose by name; None for failed poses."""
    saved = read_npz(path)
    links: dict[str, Similarity | None] = {}
    for index, name in enumerate(saved["pose_names"]):
        links[str(name)] = (
            Similarity(float(saved["scale"][index]), saved["rotation"][index], saved["translation"][index])
            if saved["ok"][index]
            else None
        )
    return links
