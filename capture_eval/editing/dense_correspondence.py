"""Which point of a template every vertex of another face is: radial-basis morph of landmarks, then projection.

Noh and Neumann 2001, section 2, as paper 001 uses it in its section 4.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capture_eval.errors import InputError
from capture_eval.polygon_mesh import PolygonMesh
from capture_eval.registration.surface_correspondence import Surface, barycentric_of
from capture_eval.triangle_geometry import vertex_normals

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

LEAST_LANDMARKS = 4
_NEAREST = 12  # template triangles looked at around a target vertex, so that one that faces the same way is found


@dataclass(frozen=True)
class SurfaceMap:
    """Points of a template's surface, one for each of N vertices of another face.

    Attributes
    ----------
    corners : (N, 3) int64
        Template vertices of the triangle.
    barycentric : (N, 3) float64
        Place in it.
    distance : (N,) float64
        From the vertex to the morphed template, in the unit of the other face: how far the morph was off.
    """

    corners: Integers
    barycentric: Floats
    distance: Floats

    @property
    def nearest(self) -> Integers:
        """The template vertex closest in the triangle, (N,)."""
        row = np.arange(len(self.corners))
        return np.asarray(self.corners[row, np.argmax(self.barycentric, axis=1)], dtype=np.int64)

    def carry(self, values: Floats) -> Floats:
        """Values of template vertices (V, ...) at the points, (N, ...)."""
        return np.asarray(np.einsum("nk,nk...->n...", self.barycentric, values[self.corners]), dtype=np.float64)


def morph_by_landmarks(points: Floats, landmarks: Floats, goals: Floats) -> Floats:
    """Points (N, 3) moved so that landmarks (P, 3) reach their goals (P, 3).

    Thin-plate radial basis functions ``r² log r`` with an affine part, through all landmarks.

    Raises
    ------
    InputError
        Fewer than four landmarks, two in one place, all in one plane, or shapes that differ.
    """
    from scipy.interpolate import RBFInterpolator

    if landmarks.shape != goals.shape or landmarks.ndim != 2 or landmarks.shape[1] != 3:
        raise InputError(f"correspondence: landmarks {landmarks.shape} and goals {goals.shape}")
    if len(landmarks) < LEAST_LANDMARKS:
        raise InputError(f"correspondence: {len(landmarks)} landmarks; at least {LEAST_LANDMARKS} are needed")
    try:
        morph = RBFInterpolator(landmarks, goals - landmarks, kernel="thin_plate_spline", degree=1)
    except (np.linalg.LinAlgError, ValueError):
        raise InputError("correspondence: landmarks are in one plane, or two are in one place") from None
    return np.asarray(points + morph(points), dtype=np.float64)


def dense_correspondence(template: PolygonMesh, target: PolygonMesh, pairs: Integers) -> SurfaceMap:
    """Template points of all vertices of a target face.

    Parameters
    ----------
    template, target : PolygonMesh
        Neutral faces, in any frames and units.
    pairs : (P, 2) int64
        Landmarks: template vertex and target vertex.

    Raises
    ------
    InputError
        Too few or degenerate landmarks, or vertices outside the meshes.
    """
    marks = np.asarray(pairs, dtype=np.int64)
    if marks.ndim != 2 or marks.shape[1] != 2:
        raise InputError(f"correspondence: pairs {marks.shape}, expected (n, 2)")
    for column, mesh, name in ((0, template, "template"), (1, target, "target")):
        bad = (marks[:, column] < 0) | (marks[:, column] >= len(mesh.vertices))
        if np.any(bad):
            raise InputError(f"correspondence: the {name} has no vertex {marks[int(np.argmax(bad)), column]}")
    morphed = morph_by_landmarks(template.vertices, template.vertices[marks[:, 0]], target.vertices[marks[:, 1]])
    triangles = template.triangles()[0]
    normals = vertex_normals(target.vertices, target.triangles()[0])
    return _project(morphed, triangles, target.vertices, normals)


def _project(vertices: Floats, triangles: Integers, points: Floats, normals: Floats) -> SurfaceMap:
    """Closest points of a surface that face the same way: lips and lids lie on each other, facing each other."""
    from scipy.spatial import KDTree

    surface = Surface(vertices, triangles)
    closest = surface.closest(points)
    triangle, barycentric = closest.triangle.copy(), closest.barycentric.copy()
    distance = np.linalg.norm(closest.points - points, axis=1)
    wrong = np.flatnonzero(np.einsum("ni,ni->n", closest.normals, normals) < 0)
    if len(wrong):
        centres = vertices[triangles].mean(axis=1)
        _, near = KDTree(centres).query(points[wrong], k=min(_NEAREST, len(triangles)))
        near = near.reshape(len(wrong), -1)
        corners = vertices[triangles[near]]
        repeated = np.repeat(points[wrong], near.shape[1], axis=0)
        places = barycentric_of(repeated, corners.reshape(-1, 3, 3)).reshape(*near.shape, 3)
        hits = np.einsum("nkc,nkci->nki", places, corners)
        faces = np.cross(corners[..., 1, :] - corners[..., 0, :], corners[..., 2, :] - corners[..., 0, :])
        agrees = np.einsum("nki,ni->nk", faces, normals[wrong]) > 0
        away = np.where(agrees, np.linalg.norm(hits - points[wrong][:, None], axis=2), np.inf)
        best = np.argmin(away, axis=1)
        row = np.arange(len(wrong))
        found = np.isfinite(away[row, best])
        chosen, row, best = wrong[found], row[found], best[found]
        triangle[chosen], barycentric[chosen] = near[row, best], places[row, best]
        distance[chosen] = away[row, best]
    return SurfaceMap(triangles[triangle], barycentric, distance)
