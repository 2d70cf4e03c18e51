"""Blendshape rigs on disk: a folder of meshes of one topology (OBJ, PLY, NPZ), one of them the neutral."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture_eval.errors import InputError
from capture_eval.files.atomic import read_npz
from capture_eval.files.mesh_files import read_mesh
from capture_eval.planning.blendshape_rig import BlendshapeRig
from capture_eval.polygon_mesh import PolygonMesh

Floats = NDArray[np.float64]
_MESHES = (".obj", ".ply")
_FACE_KEYS = ("faces", "triangles", "quads")


@dataclass(frozen=True)
class RigFiles:
    """A rig and the polygons of its neutral."""

    rig: BlendshapeRig
    neutral: PolygonMesh


@dataclass
class _Collected:
    """Meshes found so far: name -> (file, positions), and the faces with the file they are from."""

    positions: dict[str, tuple[Path, Floats]] = field(default_factory=dict)
    meshes: dict[str, PolygonMesh] = field(default_factory=dict)
    faces: list[tuple[Path, NDArray[np.int64]]] = field(default_factory=list)

    def add(self, name: str, path: Path, positions: NDArray[Any]) -> None:
        if name in self.positions:
            raise InputError(f"{path}: a mesh called {name} was read from {self.positions[name][0].name} already")
        self.positions[name] = (path, np.asarray(positions, dtype=np.float64))


def read_rig(place: Path, neutral: str = "neutral", progress: Callable[[int, int], None] | None = None) -> RigFiles:
    """Read a rig.

    Parameters
    ----------
    place : Path
        A folder, or one NPZ file. In a folder every OBJ and PLY file is a mesh that is called like the file. An NPZ
        file holds one mesh (``vertices``, ``faces``) or many: arrays (N, 3) that are called like the shapes, or
        ``shapes`` (K, N, 3) with ``names`` (K,), and ``faces`` (F, 3 or 4) unless an OBJ or PLY has them.
    neutral : str
        Name of the neutral; all others are shapes, in alphabetic order.
    progress : function (done, total), optional

    Raises
    ------
    InputError
        Nothing to read, no neutral, two meshes of one name, or meshes of different topology; the text names the file.
    """
    paths = _paths(place)
    found = _Collected()
    for number, path in enumerate(paths):
        if path.suffix.lower() in _MESHES:
            mesh = read_mesh(path)
            found.add(path.stem, path, mesh.vertices)
            found.meshes[path.stem] = mesh
        else:
            _add_npz(path, found)
        if progress is not None:
            progress(number + 1, len(paths))
    if neutral not in found.positions:
        listed = ", ".join(sorted(found.positions)) or "no mesh"
        raise InputError(f"{place}: no mesh is called '{neutral}' (found {listed}); name it with --neutral")
    base = _neutral_mesh(place, found, neutral)
    names = sorted(name for name in found.positions if name != neutral)
    for name in names:
        _check_shape(found, name, neutral, base)
    shapes = np.array([found.positions[name][1] for name in names]).reshape(len(names), *base.vertices.shape)
    try:
        return RigFiles(BlendshapeRig(tuple(names), base.vertices, shapes, base.triangles()[0]), base)
    except InputError as problem:
        raise InputError(f"{place}: {problem}") from problem


def read_positions(path: Path) -> Floats:
    """Vertices (N, 3) of one mesh file: OBJ, PLY, or NPZ with ``vertices``.

    Raises
    ------
    InputError
        The file cannot be read as a mesh.
    """
    if path.suffix.lower() != ".npz":
        return read_mesh(path).vertices
    arrays = read_npz(path)
    if "vertices" not in arrays:
        raise InputError(f"{path}: no array 'vertices'")
    return np.asarray(arrays["vertices"], dtype=np.float64)


def _paths(place: Path) -> list[Path]:
    if place.is_file():
        if place.suffix.lower() != ".npz":
            raise InputError(f"{place}: a rig is a folder of meshes, or one .npz file")
        return [place]
    if not place.is_dir():
        raise InputError(f"{place}: there is no such folder")
    paths = sorted(
        path for path in place.iterdir() if path.suffix.lower() in (*_MESHES, ".npz") and not path.name.startswith(".")
    )
    if not paths:
        raise InputError(f"{place}: no .obj, .ply or .npz file in this folder")
    return paths


def _add_npz(path: Path, found: _Collected) -> None:
    arrays = read_npz(path)
    for key in _FACE_KEYS:
        if key in arrays:
            found.faces.append((path, np.asarray(arrays[key], dtype=np.int64)))
    if "vertices" in arrays:
        found.add(path.stem, path, arrays["vertices"])
        return
    before = len(found.positions)
    for name, array in arrays.items():
        if name not in (*_FACE_KEYS, "shapes", "names") and array.ndim == 2 and array.shape[1] == 3:
            found.add(name, path, array)
    if "shapes" in arrays:
        shapes = arrays["shapes"]
        names = [str(name) for name in arrays.get("names", np.arange(len(shapes)))]
        if shapes.ndim != 3 or len(names) != len(shapes):
            raise InputError(f"{path}: 'shapes' {shapes.shape} needs (K, N, 3) and as many 'names' ({len(names)})")
        for name, shape in zip(names, shapes, strict=True):
            found.add(name, path, shape)
    if len(found.positions) == before and not any(key in arrays for key in _FACE_KEYS):
        raise InputError(f"{path}: neither 'vertices', 'shapes' nor arrays (N, 3)")


def _neutral_mesh(place: Path, found: _Collected, neutral: str) -> PolygonMesh:
    path, positions = found.positions[neutral]
    try:
        if neutral in found.meshes:
            return found.meshes[neutral]
        if found.meshes:
            return next(iter(found.meshes.values())).with_vertices(positions)
        if found.faces:
            return PolygonMesh.from_faces(positions, found.faces[0][1])
    except InputError as problem:
        raise InputError(f"{path}: {problem}") from problem
    raise InputError(f"{place}: no faces; add an array 'faces' to the .npz, or the neutral as .obj or .ply")


def _check_shape(found: _Collected, name: str, neutral: str, base: PolygonMesh) -> None:
    path, positions = found.positions[name]
    if positions.shape != base.vertices.shape:
        raise InputError(
            f"{path}: {name} has {len(positions)} vertices, {neutral} has {len(base.vertices)}; a rig has one topology"
        )
    mesh = found.meshes.get(name)
    if mesh is not None and not (
        np.array_equal(mesh.face_offsets, base.face_offsets) and np.array_equal(mesh.face_vertices, base.face_vertices)
    ):
        raise InputError(f"{path}: {name} has other faces than {neutral}; a rig has one topology")
