"""Templates of any size made from one: triangles by subdivision and decimation, quads by splitting triangles."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import yaml
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from capture_eval.files.atomic import write_text
from capture_eval.files.manifest_files import read_yaml
from capture_eval.files.mesh_files import read_mesh, write_mesh
from capture_eval.polygon_mesh import PolygonMesh
from capture_eval.registration.surface_correspondence import Surface

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


def write_template(source: Path, target: Path, vertices: int, kind: str) -> int:
    """Write template.obj, landmarks.yaml and rigid_region.yaml of about so many vertices; the number there are.

    The layout of the texture is not carried over, so the registration lays a cylinder round the head.
    """
    template = read_mesh(source / "template.obj")
    mesh = resized(template, vertices, kind)
    write_mesh(target / "template.obj", mesh)
    nearest = cKDTree(mesh.vertices)
    landmarks = read_yaml(source / "landmarks.yaml")
    for row in landmarks["landmarks"]:
        row["vertex"] = int(nearest.query(template.vertices[row["vertex"]])[1])
    taken: set[int] = set()
    rows = [row for row in landmarks["landmarks"] if not (row["vertex"] in taken or taken.add(row["vertex"]))]
    write_text(target / "landmarks.yaml", yaml.safe_dump({"landmarks": rows}, sort_keys=False))
    rigid = template.vertices[read_yaml(source / "rigid_region.yaml")]
    spacing = np.median(nearest.query(mesh.vertices, 2)[0][:, 1])
    distance, _ = cKDTree(rigid).query(mesh.vertices)
    steady = np.flatnonzero(distance < max(0.5 * spacing, 1e-6))
    write_text(target / "rigid_region.yaml", yaml.safe_dump([int(vertex) for vertex in steady]))
    return len(mesh.vertices)


def resized(template: PolygonMesh, vertices: int, kind: str) -> PolygonMesh:
    """The template's surface with about so many vertices, as `triangles` or `quads`."""
    positions, faces = template.vertices, template.triangles()[0]
    wanted = vertices if kind == "triangles" else round(vertices / 6)
    while len(positions) < wanted:
        positions, faces = _subdivided(positions, faces)
    if len(positions) > wanted:
        positions, faces = _decimated(positions, faces, wanted)
    if kind == "triangles":
        return PolygonMesh.from_faces(positions, faces)
    places, quads = _split(positions, faces)
    surface = Surface(template.vertices, template.triangles()[0])
    places = np.concatenate([positions, surface.closest(places[len(positions) :]).points])
    return PolygonMesh.from_faces(places, quads)


def _edges(faces: Integers) -> tuple[Integers, Integers]:
    """Edges (E, 2), and the edge of every side of every face (F, 3): corners 0-1, 1-2, 2-0."""
    sides = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    edges, index = np.unique(sides, axis=0, return_inverse=True)
    return edges, index.reshape(-1, 3)


def _subdivided(positions: Floats, faces: Integers) -> tuple[Floats, Integers]:
    edges, side = _edges(faces)
    side = side + len(positions)
    a, b, c = faces.T
    ab, bc, ca = side.T
    parts = [np.stack(corners, axis=1) for corners in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
    return np.concatenate([positions, positions[edges].mean(axis=1)]), np.concatenate(parts)


def _split(positions: Floats, faces: Integers) -> tuple[Floats, Integers]:
    """Three quads of every triangle: corner, middle of a side, centre, middle of the other side."""
    edges, side = _edges(faces)
    side = side + len(positions)
    centre = len(positions) + len(edges) + np.arange(len(faces))
    quads = [np.stack([faces[:, k], side[:, k], centre, side[:, k - 1]], axis=1) for k in range(3)]
    places = np.concatenate([positions, positions[edges].mean(axis=1), positions[faces].mean(axis=1)])
    return places, np.concatenate(quads)


def _decimated(positions: Floats, faces: Integers, vertices: int) -> tuple[Floats, Integers]:
    import open3d

    mesh = open3d.geometry.TriangleMesh(
        open3d.utility.Vector3dVector(positions), open3d.utility.Vector3iVector(faces.astype(np.int32))
    )
    triangles = round(len(faces) * vertices / len(positions))
    mesh = mesh.simplify_quadric_decimation(triangles)
    mesh.remove_degenerate_triangles()
    mesh.remove_duplicated_triangles()
    mesh.remove_unreferenced_vertices()
    return np.asarray(mesh.vertices).copy(), np.asarray(mesh.triangles).astype(np.int64)
