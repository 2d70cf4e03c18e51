"""Polygon meshes on disk: OBJ and PLY by file ending, quads, order and texture coordinates untouched."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from capture_eval.errors import InputError
from capture_eval.files.obj_files import read_obj, write_obj
from capture_eval.files.ply_files import read_ply, read_ply_with_properties, write_ply
from capture_eval.polygon_mesh import PolygonMesh

__all__ = [
    "read_mesh",
    "read_obj",
    "read_ply",
    "read_ply_with_properties",
    "write_mesh",
    "write_obj",
    "write_ply",
]


def read_mesh(path: Path) -> PolygonMesh:
    """Read a polygon mesh; the ending (``.obj`` or ``.ply``) decides the format.

    Parameters
    ----------
    path : Path
        File to read.

    Returns
    -------
    PolygonMesh
        Vertices (V, 3) float64, faces in the order and with the number of corners of the file.

    Raises
    ------
    InputError
        Unknown ending, unreadable or damaged file; one line that names the file.
    """
    ending = Path(path).suffix.lower()
    if ending == ".obj":
        return read_obj(path)
    if ending == ".ply":
        return read_ply(path)
    raise InputError(f"{path}: unknown mesh format '{ending}'; use .obj or .ply")


def write_mesh(
    path: Path, mesh: PolygonMesh, vertex_properties: Mapping[str, NDArray[np.float64]] | None = None
) -> None:
    """Write a polygon mesh; the ending (``.obj`` or ``.ply``) decides the format.

    Parameters
    ----------
    path : Path
        File to write, atomically.
    mesh : PolygonMesh
        Mesh to write.
    vertex_properties : mapping of name to array (V,), optional
        Extra numbers per vertex (PLY only), for example ``support`` or ``nx``, ``ny``, ``nz``.

    Raises
    ------
    InputError
        Unknown ending, or properties asked for in an OBJ file.
    """
    ending = Path(path).suffix.lower()
    if ending == ".obj":
        if vertex_properties:
            raise InputError(f"{path}: OBJ cannot hold {sorted(vertex_properties)} per vertex; write a .ply")
        write_obj(path, mesh)
    elif ending == ".ply":
        write_ply(path, mesh, vertex_properties)
    else:
        raise InputError(f"{path}: unknown mesh format '{ending}'; use .obj or .ply")
