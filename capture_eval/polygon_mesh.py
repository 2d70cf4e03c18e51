"""Polygon meshes whose faces and vertex order are never touched."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from capture_eval.errors import InputError

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


@dataclass(frozen=True)
class PolygonMesh:
    """A mesh of polygons in compressed-row form.

    Parameters
    ----------
    vertices : (V, 3) float64
        Positions.
    face_offsets : (F + 1,) int64
        Face ``f`` has the corners ``face_offsets[f]:face_offsets[f + 1]``.
    face_vertices : (C,) int64
        Vertex of every corner.
    texture_coordinates : (T, 2) float64, optional
        Coordinates in [0, 1], v upwards as in OBJ.
    face_texture_indices : (C,) int64, optional
        Texture coordinate of every corner.

    Raises
    ------
    InputError
        Wrong shapes, numbers that are not finite, faces of fewer than three corners, or indices outside the mesh.
    """

    vertices: Floats
    face_offsets: Integers
    face_vertices: Integers
    texture_coordinates: Floats | None = None
    face_texture_indices: Integers | None = None

    def __post_init__(self) -> None:
        vertices = _as_points(self.vertices, 3, "vertices")
        offsets = np.ascontiguousarray(self.face_offsets, dtype=np.int64)
        corners = np.ascontiguousarray(self.face_vertices, dtype=np.int64)
        if offsets.ndim != 1 or len(offsets) < 1 or offsets[0] != 0 or offsets[-1] != len(corners):
            raise InputError(f"mesh: face offsets do not span the {len(corners)} face corners")
        if np.any(np.diff(offsets) < 3):
            face = int(np.argmax(np.diff(offsets) < 3))
            raise InputError(f"mesh: face {face} has fewer than three corners")
        _check_indices(corners, len(vertices), "vertex")
        object.__setattr__(self, "vertices", vertices)
        object.__setattr__(self, "face_offsets", offsets)
        object.__setattr__(self, "face_vertices", corners)
        if (self.texture_coordinates is None) != (self.face_texture_indices is None):
            raise InputError("mesh: texture coordinates and their face indices come together or not at all")
        if self.texture_coordinates is not None and self.face_texture_indices is not None:
            coordinates = _as_points(self.texture_coordinates, 2, "texture coordinates")
            indices = np.ascontiguousarray(self.face_texture_indices, dtype=np.int64)
            if indices.shape != corners.shape:
                raise InputError(
                    f"mesh: {indices.size} texture indices for {corners.size} face corners; one per corner is needed"
                )
            _check_indices(indices, len(coordinates), "texture coordinate")
            object.__setattr__(self, "texture_coordinates", coordinates)
            object.__setattr__(self, "face_texture_indices", indices)

    @classmethod
    def from_faces(
        cls,
        vertices: ArrayLike,
        faces: Iterable[Sequence[int] | NDArray[np.integer]],
        texture_coordinates: ArrayLike | None = None,
        face_textures: Iterable[Sequence[int] | NDArray[np.integer]] | None = None,
    ) -> Self:
        """Build a mesh from a list (or an (F, n) array) of polygons."""
        offsets, corners = _compress(faces)
        texture_indices = None if face_textures is None else _compress(face_textures)[1]
        coordinates = None if texture_coordinates is None else np.asarray(texture_coordinates, dtype=np.float64)
        return cls(np.asarray(vertices, dtype=np.float64), offsets, corners, coordinates, texture_indices)

    @property
    def face_count(self) -> int:
        """Number of polygons."""
        return len(self.face_offsets) - 1

    def faces(self) -> list[Integers]:
        """Vertex indices of every polygon."""
        return np.split(self.face_vertices, self.face_offsets[1:-1]) if self.face_count else []

    def quads(self) -> Integers:
        """Faces as an (F, 4) array.

        Raises
        ------
        InputError
            Some face is not a quadrilateral.
        """
        sizes = np.diff(self.face_offsets)
        if np.any(sizes != 4):
            raise InputError(f"mesh: {int(np.sum(sizes != 4))} of {len(sizes)} faces are not quadrilaterals")
        return self.face_vertices.reshape(-1, 4)

    def triangles(self) -> tuple[Integers, Integers, Integers]:
        """Cut every polygon into a fan of triangles.

        Returns
        -------
        triangles : (K, 3) int64
            Vertex indices.
        triangle_faces : (K,) int64
            Polygon that each triangle was cut from.
        triangle_corners : (K, 3) int64
            Position of each triangle corner in ``face_vertices``.
        """
        sizes = np.diff(self.face_offsets)
        triangle_faces = np.repeat(np.arange(len(sizes), dtype=np.int64), sizes - 2)
        first_of_face = np.repeat(np.cumsum(sizes - 2) - (sizes - 2), sizes - 2)
        step = np.arange(len(triangle_faces), dtype=np.int64) - first_of_face
        start = self.face_offsets[triangle_faces]
        triangle_corners = np.stack([start, start + step + 1, start + step + 2], axis=1)
        return self.face_vertices[triangle_corners], triangle_faces, triangle_corners

    def corner_texture_coordinates(self) -> Floats:
        """Texture coordinates of the corners of ``triangles()``, (K, 3, 2).

        Raises
        ------
        InputError
            The mesh has no texture coordinates.
        """
        if self.texture_coordinates is None or self.face_texture_indices is None:
            raise InputError("mesh: no texture coordinates")
        return self.texture_coordinates[self.face_texture_indices[self.triangles()[2]]]

    def with_vertices(self, vertices: ArrayLike) -> "PolygonMesh":
        """The same faces on other positions, (V, 3).

        Raises
        ------
        InputError
            The number of vertices differs.
        """
        positions = np.asarray(vertices, dtype=np.float64)
        if positions.shape != self.vertices.shape:
            raise InputError(f"mesh: positions {positions.shape} do not fit {self.vertices.shape} vertices")
        return PolygonMesh(
            positions,
            self.face_offsets,
            self.face_vertices,
            self.texture_coordinates,
            self.face_texture_indices,
        )


def _as_points(values: ArrayLike, width: int, what: str) -> Floats:
    points = np.ascontiguousarray(values, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != width:
        raise InputError(f"mesh: {what} have shape {points.shape}, expected (n, {width})")
    if not np.all(np.isfinite(points)):
        row = int(np.argmin(np.all(np.isfinite(points), axis=1)))
        raise InputError(f"mesh: {what} {row} is not finite")
    return points


def _check_indices(indices: Integers, count: int, what: str) -> None:
    if indices.size and (indices.min() < 0 or indices.max() >= count):
        worst = int(indices.min()) if indices.min() < 0 else int(indices.max())
        raise InputError(f"mesh: a face uses {what} {worst}, but there are {count}")


def _compress(faces: Iterable[Sequence[int] | NDArray[np.integer]]) -> tuple[Integers, Integers]:
    rows = [np.asarray(face, dtype=np.int64) for face in faces]
    offsets = np.concatenate([[0], np.cumsum([len(row) for row in rows], dtype=np.int64)]).astype(np.int64)
    return offsets, np.concatenate(rows) if rows else np.zeros(0, dtype=np.int64)
