"""The meshes part of `validate`: template, landmarks, rigid region, curves, truth, and the meshes of poses."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from capture_eval.errors import InputError
from capture_eval.files.manifest_files import read_yaml
from capture_eval.stages.validate_photos import Problem

if TYPE_CHECKING:
    from capture_eval.files.manifest_files import Capture
    from capture_eval.polygon_mesh import PolygonMesh

FEWEST_LANDMARKS = 6
LARGEST_LANDMARK_BYTES = 50_000_000


def validate_template(capture: Capture) -> list[Problem]:
    """Template, landmarks, rigid region and curves of a manifest with `template`."""
    template = capture.manifest.template
    if template is None:
        return []
    path = capture.resolve(template.mesh)
    mesh, problems = validate_mesh(path)
    if mesh is not None and mesh.texture_coordinates is None:
        problems.append(
            Problem(str(path), "no texture coordinates; tracking works in texture space, so add UVs", fatal=True)
        )
    problems += _validate_landmarks(capture, mesh)
    problems += _validate_rigid_region(capture, mesh)
    problems += validate_curves(capture, mesh)
    if template.occluders is not None:
        problems += _validate_readable(capture.resolve(template.occluders))
    return problems


def validate_mesh(path: Path) -> tuple[PolygonMesh | None, list[Problem]]:
    """Whether a mesh can carry curves: readable, finite, with quads, manifold, without faces of no area."""
    from capture_eval.curves.edge_loops import edge_topology
    from capture_eval.files.mesh_files import read_mesh

    try:
        mesh = read_mesh(path)
    except InputError as error:
        return None, [_of_error(path, error)]
    problems = []
    corners = np.diff(mesh.face_offsets)
    if len(corners) == 0:
        return mesh, [Problem(str(path), "has no faces", fatal=True)]
    if not np.any(corners == 4):
        problems.append(
            Problem(
                str(path), f"no quads among {len(corners)} faces; edge loops run on quads, so export them", fatal=True
            )
        )
    try:
        edge_topology(mesh)
    except InputError as error:
        problems.append(_of_error(path, error))
    flat = _flat_faces(mesh)
    if flat.size:
        problems.append(Problem(str(path), f"{flat.size} faces have no area, the first is face {flat[0]}"))
    unused = len(mesh.vertices) - len(np.unique(mesh.face_vertices))
    if unused:
        problems.append(Problem(str(path), f"{unused} vertices belong to no face; delete them"))
    return mesh, problems


def _flat_faces(mesh: PolygonMesh) -> np.ndarray[Any, np.dtype[np.int64]]:
    """Faces all of whose triangles have (nearly) no area."""
    from capture_eval.triangle_geometry import triangle_areas

    triangles, faces, _ = mesh.triangles()
    areas = np.bincount(faces, triangle_areas(mesh.vertices, triangles), minlength=len(mesh.face_offsets) - 1)
    return np.flatnonzero(areas <= 1e-9 * np.median(areas))


def _validate_landmarks(capture: Capture, mesh: PolygonMesh | None) -> list[Problem]:
    template = capture.manifest.template
    if template is None:
        return []
    path = capture.resolve(template.landmarks)
    where = str(path)
    try:
        content = read_yaml(path, LARGEST_LANDMARK_BYTES)
    except InputError as error:
        return [_of_error(path, error)]
    rows = content.get("landmarks") if isinstance(content, dict) else None
    if not isinstance(rows, list):
        return [Problem(where, "needs a key `landmarks` with a list", fatal=True)]
    photos = _neutral_photos(capture)
    problems: list[Problem] = []
    names: list[Any] = []
    for index, row in enumerate(rows):
        text = _landmark_fault(row, mesh, photos)
        name = row.get("name", index) if isinstance(row, dict) else index
        if text is None and name in names:
            text = "is given twice"
        names.append(name)
        if text is not None:
            problems.append(Problem(where, f"landmark {name}: {text}", fatal=True))
    usable = len(rows) - len(problems)
    if usable < FEWEST_LANDMARKS:
        problems.append(Problem(where, f"{usable} usable landmarks; {FEWEST_LANDMARKS} or more are needed", fatal=True))
    return problems


def _neutral_photos(capture: Capture) -> set[str] | None:
    from capture_eval.files.photo_files import list_photos

    folder = capture.manifest.poses[0].photos
    try:
        return None if folder is None else {path.name for path in list_photos(capture.resolve(folder))}
    except InputError:
        return None


def _landmark_fault(row: Any, mesh: PolygonMesh | None, photos: set[str] | None) -> str | None:
    """What is wrong with one landmark, or None."""
    if not isinstance(row, dict) or not isinstance(row.get("name"), str):
        return "must be a mapping with name, vertex, and photos or point"
    unknown = set(row) - {"name", "vertex", "photos", "point", "weight"}
    if unknown:
        return f"unknown key {sorted(map(str, unknown))[0]}"
    vertex = row.get("vertex")
    if not isinstance(vertex, int) or isinstance(vertex, bool) or vertex < 0:
        return f"vertex {vertex!r} is not a vertex number"
    if mesh is not None and vertex >= len(mesh.vertices):
        return f"vertex {vertex} is not in the template, which has {len(mesh.vertices)}"
    if row.get("point") is not None:
        return None if _finite_numbers(row["point"], 3) else f"point {row['point']!r} is not three numbers"
    clicks = row.get("photos")
    if not isinstance(clicks, dict) or len(clicks) < 2:
        return "needs pixels in 2 or more photos of the neutral pose, or a 3D point"
    for photo, pixel in clicks.items():
        if photos is not None and photo not in photos:
            return f"photo {photo} is not among the photos of the neutral pose"
        if not _finite_numbers(pixel, 2) or min(pixel) < 0:
            return f"pixel {pixel!r} in {photo} is not two numbers from 0"
    return None


def _finite_numbers(value: Any, count: int) -> bool:
    if not isinstance(value, Sequence) or isinstance(value, str) or len(value) != count:
        return False
    return all(isinstance(x, (int, float)) and not isinstance(x, bool) and np.isfinite(x) for x in value)


def _validate_rigid_region(capture: Capture, mesh: PolygonMesh | None) -> list[Problem]:
    region = capture.manifest.rigid_region
    where = f"{capture.path}: rigid_region"
    if isinstance(region, str):
        path = capture.resolve(region)
        where = str(path)
        try:
            region = read_yaml(path)
        except InputError as error:
            return [_of_error(path, error)]
    if region is None or mesh is None:
        return []
    if not isinstance(region, list) or not all(isinstance(v, int) and v >= 0 for v in region):
        return [Problem(where, "must be a list of vertex numbers", fatal=True)]
    outside = [vertex for vertex in region if vertex >= len(mesh.vertices)]
    if outside:
        return [
            Problem(where, f"vertex {outside[0]} is not in the template, which has {len(mesh.vertices)}", fatal=True)
        ]
    return []


def validate_curves(capture: Capture, mesh: PolygonMesh | None) -> list[Problem]:
    """Whether every curve exists on the mesh."""
    from capture_eval.curves.curve_specification import resolve_curve
    from capture_eval.curves.edge_loops import edge_topology
    from capture_eval.curves.extract import Curve
    from capture_eval.files.curve_files import read_curves

    if capture.manifest.curves is None:
        text = "no `curves`, so nothing is evaluated; `capture-eval curves list` shows the loops to choose from"
        return [Problem(str(capture.path), text, fatal=capture.manifest.source == "meshes")]
    path = capture.resolve(capture.manifest.curves)
    try:
        specifications = read_curves(path)
        topology = None if mesh is None else edge_topology(mesh)
    except InputError as error:
        return [_of_error(path, error)] if str(path) in str(error) else []
    if mesh is None or topology is None:
        return []
    problems = []
    for specification in specifications:
        try:
            loop = resolve_curve(specification, topology)
            curve = Curve(specification.name, loop.vertices, loop.closed)
        except InputError as error:
            problems.append(_of_error(path, error))
            continue
        if curve.vertices.max() >= len(mesh.vertices):
            text = f"vertex {curve.vertices.max()} is not in the mesh, which has {len(mesh.vertices)}"
            problems.append(Problem(str(path), f"curve '{curve.name}': {text}", fatal=True))
    return problems


def validate_pose_meshes(capture: Capture) -> list[Problem]:
    """Meshes of a `source: meshes` manifest: each readable, all of one topology."""
    problems: list[Problem] = []
    first: PolygonMesh | None = None
    first_path: Path | None = None
    for pose in capture.manifest.poses:
        path = capture.resolve(pose.mesh or "")
        if first is None:
            first, found = validate_mesh(path)
            first_path = path
            problems += found
            continue
        problems += _validate_same_topology(path, first, first_path)
    return problems + validate_curves(capture, first)


def _validate_same_topology(path: Path, first: PolygonMesh, first_path: Path | None) -> list[Problem]:
    from capture_eval.files.mesh_files import read_mesh

    try:
        mesh = read_mesh(path)
    except InputError as error:
        return [_of_error(path, error)]
    if len(mesh.vertices) != len(first.vertices):
        text = f"{len(mesh.vertices)} vertices, but {first_path} has {len(first.vertices)}; all poses need one topology"
        return [Problem(str(path), text, fatal=True)]
    same = np.array_equal(mesh.face_offsets, first.face_offsets) and np.array_equal(
        mesh.face_vertices, first.face_vertices
    )
    return [] if same else [Problem(str(path), f"other faces or vertex order than {first_path}", fatal=True)]


def validate_truth(capture: Capture) -> list[Problem]:
    """Truth files: there, readable, with a row for every pose."""
    from capture_eval.files.atomic import read_npz

    truth = capture.manifest.truth
    if truth is None:
        return []
    problems: list[Problem] = []
    if truth.mesh is not None:
        problems += _validate_readable(capture.resolve(truth.mesh))
    if truth.vertices is not None:
        path = capture.resolve(truth.vertices)
        try:
            arrays = read_npz(path)
        except InputError as error:
            return [*problems, _of_error(path, error)]
        times = [pose.t for pose in capture.manifest.poses]
        shape = arrays["vertices"].shape if "vertices" in arrays else ()
        if len(shape) != 3 or shape[0] != len(times) or shape[2] != 3:
            problems.append(Problem(str(path), f"vertices {shape}, expected ({len(times)}, V, 3)", fatal=True))
        elif not np.allclose(arrays.get("t", times), times):
            problems.append(Problem(str(path), "t differs from the manifest's", fatal=True))
    if truth.cameras is not None and not capture.resolve(truth.cameras).is_file():
        problems.append(Problem(str(capture.resolve(truth.cameras)), "no such file", fatal=True))
    return problems


def _validate_readable(path: Path) -> list[Problem]:
    from capture_eval.files.mesh_files import read_mesh

    try:
        read_mesh(path)
    except InputError as error:
        return [_of_error(path, error)]
    return []


def _of_error(path: Path, error: InputError) -> Problem:
    return Problem(str(path), str(error).removeprefix(f"{path}: "), fatal=True)
