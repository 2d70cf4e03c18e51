"""Curves of a mesh file: all maximal edge loops to choose from, and the check of a curves file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from capture_eval.curves.edge_loops import EdgeTopology, edge_topology, maximal_loops
from capture_eval.curves.extract import curve_problems, resolve_curves
from capture_eval.errors import InputError
from capture_eval.files.atomic import atomic_path
from capture_eval.files.curve_files import read_curves
from capture_eval.files.mesh_files import read_mesh
from capture_eval.polygon_mesh import PolygonMesh


@dataclass(frozen=True)
class ListedLoop:
    """A loop of a mesh.

    Attributes
    ----------
    label : str
        Its number in the list, or the name of the curve.
    vertices : (M,) int64
        In order; the first two are the start edge that walks the loop again.
    closed, border : bool
        Whether it comes back to its start, and whether it is a rim of the mesh.
    length : float
        In the mesh's unit.
    """

    label: str
    vertices: NDArray[np.int64]
    closed: bool
    border: bool
    length: float

    def as_dict(self) -> dict[str, object]:
        """Plain values for JSON."""
        return {
            "label": self.label,
            "closed": self.closed,
            "border": self.border,
            "vertex_count": len(self.vertices),
            "length": self.length,
            "start_edge": self.vertices[:2].tolist(),
            "vertices": self.vertices.tolist(),
        }


def list_loops(mesh_path: Path, min_length: int = 2, picture: Path | None = None) -> list[ListedLoop]:
    """All maximal edge loops of a mesh, numbered; closed ones first, long ones first.

    Parameters
    ----------
    mesh_path : Path
        OBJ or PLY.
    min_length : int
        Loops with fewer vertices are left out; numbers do not depend on it.
    picture : Path, optional
        Where to draw them (PNG, PDF or SVG).

    Raises
    ------
    InputError
        The mesh cannot be read or is not manifold, or no loop is that long.
    """
    mesh = read_mesh(mesh_path)
    topology = _topology(mesh_path, mesh)
    loops = [
        _listed(str(number), loop.vertices, loop.closed, loop.border, mesh)
        for number, loop in enumerate(maximal_loops(topology), 1)
        if len(loop.vertices) >= min_length
    ]
    if not loops:
        raise InputError(f"{mesh_path}: no edge loop has {min_length} or more vertices")
    if picture is not None:
        title = f"{mesh_path.name}: {len(loops)} maximal edge loops of {min_length} or more vertices"
        _draw(picture, mesh, topology, loops, title)
    return loops


def check_curves(mesh_path: Path, curves_path: Path, picture: Path | None = None) -> tuple[list[str], list[ListedLoop]]:
    """Problems of a curves file on a mesh, one line each, and the curves that are there.

    Parameters
    ----------
    mesh_path : Path
        OBJ or PLY.
    curves_path : Path
        YAML or JSON.
    picture : Path, optional
        Where to draw the good curves.

    Raises
    ------
    InputError
        One of the files cannot be read at all.
    """
    mesh = read_mesh(mesh_path)
    topology = _topology(mesh_path, mesh)
    specifications = read_curves(curves_path)
    problems, good = [], []
    for specification in specifications:
        found = curve_problems([specification], topology)
        problems += [f"{curves_path}: {line}" for line in found]
        if not found:
            (curve,) = resolve_curves([specification], topology)
            good.append(_listed(curve.name, curve.vertices, curve.closed, False, mesh))
    if picture is not None and good:
        _draw(picture, mesh, topology, good, f"{curves_path.name}: {len(good)} curves on {mesh_path.name}")
    return problems, good


def _topology(path: Path, mesh: PolygonMesh) -> EdgeTopology:
    try:
        return edge_topology(mesh)
    except InputError as problem:
        raise InputError(f"{path}: {problem}") from problem


def _listed(label: str, vertices: NDArray[np.int64], closed: bool, border: bool, mesh: PolygonMesh) -> ListedLoop:
    points = mesh.vertices[np.append(vertices, vertices[0]) if closed else vertices]
    length = float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
    return ListedLoop(label, vertices, closed, border, length)


def _draw(path: Path, mesh: PolygonMesh, topology: EdgeTopology, loops: Sequence[ListedLoop], title: str) -> None:
    from capture_eval.report.loop_figures import DrawnLoop, draw_loops

    if path.suffix.lower() not in (".png", ".pdf", ".svg"):
        raise InputError(f"{path}: pictures are written as .png, .pdf or .svg")
    drawn = [DrawnLoop(loop.label, loop.vertices, loop.closed) for loop in loops]
    figure = draw_loops(mesh.vertices, mesh.triangles()[0], topology.edges, drawn, title)
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=200)
