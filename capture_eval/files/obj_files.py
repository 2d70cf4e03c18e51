"""Wavefront OBJ with polygons of any size: vertex order, face order and texture coordinates are kept.

Only ``v``, ``vt`` and ``f`` lines are read; everything else (normals, groups, materials, smoothing, free-form
curves) is ignored. Indices may be negative, as the format allows. Numbers are written with the shortest text
that reads back as the same double, so a mesh survives the round trip bit for bit.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from capture_eval.errors import InputError
from capture_eval.files.atomic import atomic_path
from capture_eval.polygon_mesh import PolygonMesh

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


def read_obj(path: Path) -> PolygonMesh:
    """Read a polygon mesh from an OBJ file.

    Parameters
    ----------
    path : Path
        File to read.

    Returns
    -------
    PolygonMesh
        Vertices (V, 3) float64 in the file's unit and frame, faces as written, texture coordinates when every
        corner has one.

    Raises
    ------
    InputError
        The file cannot be read, has no vertices or faces, holds a number that is not finite, a face with fewer
        than three corners or an index that does not exist; the message names file and line.
    """
    path = Path(path)
    lines = _lines(path)
    vertex_lines: list[int] = []
    texture_lines: list[int] = []
    face_lines: list[int] = []
    counts_at_face: list[tuple[int, int]] = []
    for number, line in enumerate(lines):
        head = line[:2]
        if head in (b"v ", b"v\t"):
            vertex_lines.append(number)
        elif head in (b"f ", b"f\t"):
            face_lines.append(number)
            counts_at_face.append((len(vertex_lines), len(texture_lines)))
        elif line[:3] in (b"vt ", b"vt\t"):
            texture_lines.append(number)
    if not vertex_lines:
        raise InputError(f"{path}: no vertices (no line starts with 'v'); is it an OBJ file?")
    if not face_lines:
        raise InputError(f"{path}: {len(vertex_lines)} vertices but no faces")
    vertices = _numbers(path, lines, vertex_lines, 3, "vertex")
    texture = _numbers(path, lines, texture_lines, 2, "texture coordinate") if texture_lines else None
    offsets, corners, texture_corners = _faces(
        path, lines, face_lines, counts_at_face, len(vertex_lines), len(texture_lines)
    )
    if texture_corners is None:
        texture = None
    try:
        return PolygonMesh(vertices, offsets, corners, texture, texture_corners)
    except InputError as problem:
        raise InputError(f"{path}: {problem}") from problem


def _lines(path: Path) -> list[bytes]:
    try:
        data = path.read_bytes()
    except OSError as problem:
        raise InputError(f"{path}: cannot be read ({problem.strerror or problem})") from problem
    if b"\\\n" in data or b"\\\r\n" in data:
        data = data.replace(b"\\\r\n", b" ").replace(b"\\\n", b" ")
    return [line.strip() for line in data.split(b"\n")]


def _numbers(path: Path, lines: Sequence[bytes], numbers: Sequence[int], width: int, what: str) -> Floats:
    """First ``width`` numbers of the lines; colours, weights and third texture coordinates are left out."""
    rows = [lines[number].split()[1 : width + 1] for number in numbers]
    if min(map(len, rows)) < width:
        bad = next(number for number, row in zip(numbers, rows, strict=True) if len(row) < width)
        raise InputError(f"{path}: line {bad + 1}: a {what} needs {width} numbers; is the file cut off?")
    try:
        values = np.array([float(token) for row in rows for token in row], dtype=np.float64)
    except ValueError as problem:
        bad = next(number for number, row in zip(numbers, rows, strict=True) if not _all_numbers(row))
        raise InputError(f"{path}: line {bad + 1}: a {what} holds text that is not a number") from problem
    values = values.reshape(-1, width)
    finite = np.isfinite(values).all(axis=1)
    if not finite.all():
        bad = numbers[int(np.argmin(finite))]
        raise InputError(f"{path}: line {bad + 1}: a {what} is not finite (NaN or infinite)")
    return values


def _all_numbers(row: Iterable[bytes]) -> bool:
    try:
        for token in row:
            float(token)
    except ValueError:
        return False
    return True


def _faces(
    path: Path,
    lines: Sequence[bytes],
    numbers: Sequence[int],
    counts_at_face: Sequence[tuple[int, int]],
    vertex_count: int,
    texture_count: int,
) -> tuple[Integers, Integers, Integers | None]:
    """Face offsets, corner vertices and corner texture indices (None when no corner has one), all 0-based."""
    rows = [lines[number].partition(b"#")[0].split()[1:] for number in numbers]
    sizes = np.array([len(row) for row in rows], dtype=np.int64)
    if sizes.min() < 3:
        bad = numbers[int(np.argmax(sizes < 3))]
        raise InputError(f"{path}: line {bad + 1}: a face needs at least three corners; is the file cut off?")
    offsets = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
    parts = [token.split(b"/") for row in rows for token in row]
    line_of_corner = np.repeat(np.array(numbers, dtype=np.int64), sizes)
    counts = np.repeat(np.array(counts_at_face, dtype=np.int64), sizes, axis=0)
    vertex_text = [part[0] for part in parts]
    corners = _indices(path, vertex_text, line_of_corner, counts[:, 0], vertex_count, "vertex")
    has_texture = np.array([len(part) > 1 and part[1] != b"" for part in parts])
    if not has_texture.any():
        return offsets, corners, None
    if not has_texture.all():
        bad_line = int(line_of_corner[int(np.argmin(has_texture))]) + 1
        raise InputError(f"{path}: line {bad_line}: corner without a texture coordinate while others have one")
    texture_text = [part[1] for part in parts]
    kind = "texture coordinate"
    texture = _indices(path, texture_text, line_of_corner, counts[:, 1], texture_count, kind)
    return offsets, corners, texture


def _indices(
    path: Path, text: Sequence[bytes], line_of_corner: Integers, count_so_far: Integers, total: int, what: str
) -> Integers:
    """1-based or negative indices in text to 0-based ones, checked against the number of entries."""
    try:
        values = np.array(list(map(int, text)), dtype=np.int64)
    except (ValueError, OverflowError) as problem:
        bad = next(i for i, token in enumerate(text) if not token.lstrip(b"-+").isdigit())
        raise InputError(
            f"{path}: line {line_of_corner[bad] + 1}: face index {text[bad].decode(errors='replace')!r} "
            "is not a whole number"
        ) from problem
    zero_based = np.where(values > 0, values - 1, count_so_far + values)
    wrong = (values == 0) | (zero_based < 0) | (zero_based >= total)
    if wrong.any():
        bad = int(np.argmax(wrong))
        raise InputError(
            f"{path}: line {line_of_corner[bad] + 1}: {what} index {values[bad]} does not exist (the file has {total})"
        )
    return zero_based


def write_obj(path: Path, mesh: PolygonMesh, comments: Sequence[str] = (), material_library: str | None = None) -> None:
    """Write a polygon mesh as OBJ, atomically; the numbers read back exactly.

    Parameters
    ----------
    path : Path
        File to write.
    mesh : PolygonMesh
        Mesh; texture coordinates are written when it has them.
    comments : sequence of str
        Lines put behind ``#`` at the top (units, source, licence).
    material_library : str, optional
        Name of an MTL file to refer to; its first material is expected to be called ``skin``.
    """
    out = [f"# {line}" for comment in comments for line in comment.splitlines()]
    if material_library is not None:
        out += [f"mtllib {material_library}", "usemtl skin"]
    out += [f"v {x!r} {y!r} {z!r}" for x, y, z in mesh.vertices.tolist()]
    corner_text = [str(index + 1) for index in mesh.face_vertices.tolist()]
    if mesh.texture_coordinates is not None and mesh.face_texture_indices is not None:
        out += [f"vt {u!r} {v!r}" for u, v in mesh.texture_coordinates.tolist()]
        texture = mesh.face_texture_indices.tolist()
        corner_text = [f"{a}/{b + 1}" for a, b in zip(corner_text, texture, strict=True)]
    offsets = mesh.face_offsets.tolist()
    out += ["f " + " ".join(corner_text[first:last]) for first, last in pairwise(offsets)]
    with atomic_path(Path(path)) as temporary:
        temporary.write_text("\n".join(out) + "\n", encoding="utf-8")
