"""An edit from files: examples, camera and drags to a mesh and its pictures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture_eval.cameras import View
from capture_eval.editing.control_targets import ControlPoint
from capture_eval.editing.dense_correspondence import dense_correspondence
from capture_eval.editing.expression_cloning import edit_through_template, motion_transfer
from capture_eval.editing.expression_editor import Edit, EditOptions, ExpressionEditor
from capture_eval.editing.picking import VertexPicker
from capture_eval.editing.projection import Projection
from capture_eval.errors import InputError
from capture_eval.files.atomic import atomic_path, read_npz
from capture_eval.files.camera_files import read_cameras
from capture_eval.files.manifest_files import read_yaml
from capture_eval.files.mesh_files import read_mesh, write_mesh
from capture_eval.polygon_mesh import PolygonMesh

Floats = NDArray[np.float64]
MESH_ENDINGS = (".obj", ".ply")


@dataclass(frozen=True)
class DragRequest:
    """What a user asks for.

    Attributes
    ----------
    controls : tuple of ControlPoint
        Vertices with targets.
    drags : tuple of (from pixel, to pixel)
        Pixels of the view; the vertex under the first is picked.
    view : View or None
        The camera of all pixels.
    onto, pairs : Path or None
        A face without examples, and its landmark pairs with the examples' mesh.
    options : EditOptions
    """

    controls: tuple[ControlPoint, ...]
    drags: tuple[tuple[tuple[float, float], tuple[float, float]], ...] = ()
    view: View | None = None
    onto: Path | None = None
    pairs: Path | None = None
    options: EditOptions = field(default_factory=EditOptions)


def read_examples(source: Path, template: Path | None = None) -> tuple[Floats, PolygonMesh, list[str]]:
    """Registered examples (M, N, 3), the neutral first, their mesh, and their names.

    Parameters
    ----------
    source : Path
        Folder of OBJ or PLY files of one topology (``neutral.*`` or else the first by name is the neutral), or an npz:
        ``vertices`` (M, N, 3) as a run writes it (poses that failed are left out), or one (N, 3) array per expression.
    template : Path, optional
        Mesh with the faces, where the npz has none.

    Raises
    ------
    InputError
        Nothing to read, meshes of different topology, or no faces.
    """
    if source.is_dir():
        return _read_folder(source)
    if source.suffix != ".npz":
        raise InputError(f"{source}: examples are a folder of OBJ or PLY meshes, or an npz")
    saved = read_npz(source)
    if "vertices" in saved:
        vertices = np.asarray(saved["vertices"], dtype=np.float64)
        if vertices.ndim != 3:
            raise InputError(f"{source}: vertices {vertices.shape}, expected (meshes, vertices, 3)")
        good = ~np.all(np.isnan(vertices), axis=(1, 2))
        names = [f"pose {row}" for row in np.flatnonzero(good)]
        vertices = vertices[good]
    else:
        shapes = {name: array for name, array in saved.items() if array.ndim == 2 and array.shape[1] == 3}
        count = len(shapes["neutral"]) if "neutral" in shapes else 0
        names = ["neutral", *(name for name, array in shapes.items() if len(array) == count and name != "neutral")]
        if not count:
            raise InputError(f"{source}: neither `vertices` (meshes, vertices, 3) nor an array named `neutral`")
        vertices = np.array([shapes[name] for name in names], dtype=np.float64)
    return vertices, _mesh_of(source, saved, vertices, template), names


def _read_folder(folder: Path) -> tuple[Floats, PolygonMesh, list[str]]:
    paths = sorted(path for path in folder.iterdir() if path.suffix.lower() in MESH_ENDINGS)
    paths.sort(key=lambda path: path.stem != "neutral")
    if not paths:
        raise InputError(f"{folder}: no .obj or .ply files in it")
    meshes = [read_mesh(path) for path in paths]
    for path, mesh in zip(paths, meshes, strict=True):
        if len(mesh.vertices) != len(meshes[0].vertices) or not np.array_equal(
            mesh.face_vertices, meshes[0].face_vertices
        ):
            raise InputError(f"{path}: not the topology of {paths[0].name}; examples must be registered meshes")
    return np.array([mesh.vertices for mesh in meshes]), meshes[0], [path.stem for path in paths]


def _mesh_of(source: Path, saved: dict[str, NDArray[Any]], vertices: Floats, template: Path | None) -> PolygonMesh:
    if template is not None:
        mesh = read_mesh(template)
        if len(mesh.vertices) != vertices.shape[1]:
            raise InputError(f"{template}: {len(mesh.vertices)} vertices; the examples have {vertices.shape[1]}")
        return mesh.with_vertices(vertices[0])
    if "face_offsets" in saved and "face_vertices" in saved:
        return PolygonMesh(vertices[0], saved["face_offsets"], saved["face_vertices"])
    raise InputError(f"{source}: no faces in it; give --template MESH")


def read_view(path: Path, name: str | None) -> View:
    """A camera of a cameras file: the first, or the one named PHOTO or POSE/PHOTO.

    Raises
    ------
    InputError
        Unreadable, empty, or no such photo.
    """
    cameras = read_cameras(path)
    for pose, views in cameras.items():
        for view in views:
            if name in (None, view.name, f"{pose}/{view.name}"):
                return view
    raise InputError(f"{path}: " + (f"no photo {name!r}" if cameras and name else "no camera in it"))


def read_pairs(path: Path) -> NDArray[np.int64]:
    """Landmark pairs (P, 2) from YAML or JSON: a list named ``pairs`` of [example vertex, target vertex].

    Raises
    ------
    InputError
        Unreadable, or not such a list.
    """
    document = read_yaml(path)
    rows = document.get("pairs") if isinstance(document, dict) else None
    try:
        pairs = np.array(rows, dtype=np.int64)
    except (TypeError, ValueError):
        pairs = np.zeros(0, dtype=np.int64)
    if pairs.ndim != 2 or pairs.shape[1] != 2:
        raise InputError(f"{path}: expected `pairs:` with a list of [example vertex, target vertex]")
    return pairs


def edit_expression(
    source: Path,
    out: Path,
    request: DragRequest,
    template: Path | None = None,
    picture: Path | None = None,
) -> Edit:
    """Edit a face and write the mesh, and a picture of drags, result and soft regions where asked for.

    Raises
    ------
    InputError
        Any input is bad; nothing is written then.
    """
    for path, endings in ((out, MESH_ENDINGS), (picture, (".png", ".pdf", ".svg"))):
        if path is not None and path.suffix.lower() not in endings:
            raise InputError(f"{path}: the ending must be one of {', '.join(endings)}")
    examples, mesh, _ = read_examples(source, template)
    editor = ExpressionEditor(examples, request.options)
    face = mesh if request.onto is None else read_mesh(request.onto)
    controls = [*request.controls, *_picked(request, face)]
    projection = None if request.view is None else Projection.from_view(request.view)
    if request.onto is None:
        edit = editor.edit(controls, projection)
        vertices = edit.vertices
    else:
        if request.pairs is None:
            raise InputError(f"{request.onto}: a face without examples needs landmark pairs; give --pairs FILE")
        correspondence = dense_correspondence(mesh, face, read_pairs(request.pairs))
        transfer = motion_transfer(mesh, face, correspondence)
        vertices, edit = edit_through_template(editor, transfer, controls, projection)
    if picture is not None:
        _draw(picture, mesh, edit, request)
    write_mesh(out, face.with_vertices(vertices))
    return edit


def _picked(request: DragRequest, face: PolygonMesh) -> Sequence[ControlPoint]:
    if not request.drags:
        return []
    if request.view is None:
        raise InputError("a drag from pixel to pixel needs a camera; give --camera FILE")
    rows = VertexPicker(face).pick(request.view, [start for start, _ in request.drags])
    return [ControlPoint(int(row), end) for row, (_, end) in zip(rows, request.drags, strict=True)]


def _draw(picture: Path, mesh: PolygonMesh, edit: Edit, request: DragRequest) -> None:
    from capture_eval.report.editing_sheet import drag_panels, draw_edit_sheet
    from capture_eval.report.face_figures import look_at
    from capture_eval.report.figure_style import paper_style

    view = request.view
    if view is None:
        view = look_at(mesh.vertices, np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0]), 0.0, (420, 500))
    with paper_style(), atomic_path(picture) as temporary:
        figure = draw_edit_sheet([drag_panels(mesh.vertices, edit, view, "drags")], mesh.triangles()[0], view)
        figure.savefig(temporary, dpi=200)
