"""PLY with polygons of any size: ASCII, binary little endian and binary big endian.

Vertex order, face order, per-face texture coordinates (MeshLab's ``texcoord`` list) and further numbers per vertex
(``support``, normals, …) are kept; elements and properties that are not known are stepped over.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from capture_eval.errors import InputError
from capture_eval.files.atomic import write_bytes
from capture_eval.files.ply_body import Column, ListColumn, read_ascii_body, read_binary_body, read_header
from capture_eval.polygon_mesh import PolygonMesh

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


def read_ply(path: Path) -> PolygonMesh:
    """Read a polygon mesh from a PLY file (see `read_ply_with_properties`)."""
    return read_ply_with_properties(path)[0]


def read_ply_with_properties(path: Path) -> tuple[PolygonMesh, dict[str, Floats]]:
    """Read a polygon mesh and its further numbers per vertex from a PLY file.

    Parameters
    ----------
    path : Path
        ASCII or binary PLY file.

    Returns
    -------
    mesh : PolygonMesh
        Vertices (V, 3) float64 in the file's unit and frame; faces as written. Texture coordinates come from a
        face property ``texcoord`` when every face has one pair per corner (then one entry per corner).
    properties : dict of str to array (V,)
        Every scalar vertex property besides x, y, z, float64.

    Raises
    ------
    InputError
        The file cannot be read, is cut off, has no vertices or faces, holds coordinates that are not finite or
        indices that do not exist; the message names the file.
    """
    path = Path(path)
    elements, order, body = read_header(path)
    columns = read_binary_body(path, elements, order, body) if order else read_ascii_body(path, elements, body)
    vertex = columns.get("vertex", {})
    coordinates = [vertex.get(axis) for axis in "xyz"]
    scalars = [column for column in coordinates if isinstance(column, np.ndarray)]
    if len(scalars) < 3 or len(scalars[0]) == 0:
        raise InputError(f"{path}: no vertices with x, y and z")
    vertices = np.stack(scalars, axis=1)
    if not np.isfinite(vertices).all():
        bad = int(np.argmin(np.isfinite(vertices).all(axis=1)))
        raise InputError(f"{path}: vertex {bad} is not finite (NaN or infinite)")
    offsets, corners = _face_corners(path, columns.get("face", {}), len(vertices))
    texture, texture_indices = _texture(columns.get("face", {}), offsets)
    properties = {
        name: column
        for name, column in vertex.items()
        if name not in ("x", "y", "z") and isinstance(column, np.ndarray)
    }
    try:
        return PolygonMesh(vertices, offsets, corners, texture, texture_indices), properties
    except InputError as problem:
        raise InputError(f"{path}: {problem}") from problem


def _face_corners(path: Path, face: Mapping[str, Column], vertex_count: int) -> tuple[Integers, Integers]:
    lists = face.get("vertex_indices", face.get("vertex_index"))
    if not isinstance(lists, ListColumn) or len(lists.offsets) < 2:
        raise InputError(f"{path}: {vertex_count} vertices but no faces")
    sizes = np.diff(lists.offsets)
    if sizes.min() < 3:
        raise InputError(f"{path}: face {int(np.argmin(sizes))} has {sizes.min()} corners; at least 3 are needed")
    corners = lists.values.astype(np.int64)
    wrong = (corners < 0) | (corners >= vertex_count)
    if wrong.any():
        corner = int(np.argmax(wrong))
        bad_face = int(np.searchsorted(lists.offsets, corner, side="right")) - 1
        raise InputError(
            f"{path}: face {bad_face} uses vertex {corners[corner]}, but the file has {vertex_count} vertices"
        )
    return lists.offsets, corners


def _texture(face: Mapping[str, Column], offsets: Integers) -> tuple[Floats | None, Integers | None]:
    lists = face.get("texcoord")
    if not isinstance(lists, ListColumn) or not np.array_equal(lists.offsets, 2 * offsets):
        return None, None
    return lists.values.reshape(-1, 2), np.arange(int(offsets[-1]), dtype=np.int64)


def write_ply(
    path: Path,
    mesh: PolygonMesh,
    vertex_properties: Mapping[str, NDArray[np.float64]] | None = None,
    binary: bool = True,
) -> None:
    """Write a polygon mesh as PLY, atomically, with coordinates as doubles that read back exactly.

    Parameters
    ----------
    path : Path
        File to write.
    mesh : PolygonMesh
        Mesh; texture coordinates go into a ``texcoord`` list per face.
    vertex_properties : mapping of name to array (V,), optional
        Further numbers per vertex, written as doubles.
    binary : bool
        Little endian binary (default) or ASCII.

    Raises
    ------
    InputError
        A property has another length than the mesh has vertices.
    """
    path = Path(path)
    extra = {name: np.asarray(values, dtype=np.float64) for name, values in (vertex_properties or {}).items()}
    for name, values in extra.items():
        if values.shape != (len(mesh.vertices),):
            raise InputError(f"{path}: property '{name}' has shape {values.shape}, not ({len(mesh.vertices)},)")
    table = np.column_stack([mesh.vertices, *extra.values()])
    sizes = np.diff(mesh.face_offsets)
    texture: Floats | None = None
    if mesh.texture_coordinates is not None and mesh.face_texture_indices is not None:
        texture = mesh.texture_coordinates[mesh.face_texture_indices]
    lines = ["ply", f"format {'binary_little_endian' if binary else 'ascii'} 1.0"]
    lines += [f"element vertex {len(table)}"]
    lines += [f"property double {name}" for name in ("x", "y", "z", *extra)]
    count = "uchar" if len(sizes) == 0 or 2 * sizes.max() < 256 else "uint"
    lines += [f"element face {len(sizes)}", f"property list {count} int vertex_indices"]
    if texture is not None:
        lines += [f"property list {count} double texcoord"]
    header = "\n".join([*lines, "end_header", ""]).encode("ascii")
    if binary:
        body = table.astype("<f8").tobytes() + _binary_faces(mesh, sizes, texture, count)
    else:
        body = _ascii_table(table) + _ascii_faces(mesh, texture)
    write_bytes(path, header + body)


def _ascii_table(table: Floats) -> bytes:
    return "".join(" ".join(map(repr, row)) + "\n" for row in table.tolist()).encode("ascii")


def _ascii_faces(mesh: PolygonMesh, texture: Floats | None) -> bytes:
    corners = mesh.face_vertices.tolist()
    pairs = None if texture is None else texture.tolist()
    offsets = mesh.face_offsets.tolist()
    rows = []
    for first, last in pairwise(offsets):
        words = [str(last - first), *map(str, corners[first:last])]
        if pairs is not None:
            words += [str(2 * (last - first)), *(repr(value) for pair in pairs[first:last] for value in pair)]
        rows.append(" ".join(words) + "\n")
    return "".join(rows).encode("ascii")


def _binary_faces(mesh: PolygonMesh, sizes: Integers, texture: Floats | None, count: str) -> bytes:
    """Rows of (count, corners, count, texture pairs), written in runs of faces with equal corner counts."""
    kind = "u1" if count == "uchar" else "<u4"
    runs = np.flatnonzero(np.diff(sizes)) + 1
    pieces = []
    for block in np.split(np.arange(len(sizes)), runs):
        if len(block) == 0:
            continue
        size = int(sizes[block[0]])
        corners = slice(int(mesh.face_offsets[block[0]]), int(mesh.face_offsets[block[-1] + 1]))
        fields: list[tuple[str, str] | tuple[str, str, tuple[int]]] = [("n", kind), ("v", "<i4", (size,))]
        if texture is not None:
            fields += [("m", kind), ("t", "<f8", (2 * size,))]
        rows = np.zeros(len(block), dtype=fields)
        rows["n"] = size
        rows["v"] = mesh.face_vertices[corners].reshape(-1, size)
        if texture is not None:
            rows["m"] = 2 * size
            rows["t"] = texture[corners].reshape(-1, 2 * size)
        pieces.append(rows.tobytes())
    return b"".join(pieces)
