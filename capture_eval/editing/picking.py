"""Picking: pixels to vertices of a mesh, by rays (section 3.1 of paper 001)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from capture_eval.cameras import View, pixel_rays
from capture_eval.errors import InputError
from capture_eval.polygon_mesh import PolygonMesh
from capture_eval.registration.surface_correspondence import Surface


class VertexPicker:
    """Finds the vertex under a pixel; built once per mesh.

    Parameters
    ----------
    mesh : PolygonMesh
        The neutral face, in the frame of the cameras.
    """

    def __init__(self, mesh: PolygonMesh) -> None:
        triangles, self._face_of_triangle, _ = mesh.triangles()
        self._mesh = mesh
        self._surface = Surface(mesh.vertices, triangles)

    def pick(self, view: View, pixels: ArrayLike) -> NDArray[np.int64]:
        """Vertex of the first face that each pixel's ray (N, 2) hits, the one nearest to the hit, (N,).

        Raises
        ------
        InputError
            A pixel that is not finite, or whose ray hits nothing.
        """
        places = np.atleast_2d(np.asarray(pixels, dtype=np.float64))
        if places.ndim != 2 or places.shape[1] != 2 or not np.all(np.isfinite(places)):
            raise InputError(f"picking: pixels {places.shape} must be finite and (n, 2)")
        origin, directions = pixel_rays(view, places)
        hits = self._surface.cast(origin, directions)
        if not np.all(hits.hit):
            x, y = places[int(np.argmin(hits.hit))]
            raise InputError(f"picking: the pixel ({x:g}, {y:g}) of {view.name} hits nothing; choose one on the face")
        offsets, corners = self._mesh.face_offsets, self._mesh.face_vertices
        vertices = np.zeros(len(places), dtype=np.int64)
        for row, (triangle, point) in enumerate(zip(hits.triangle, hits.points, strict=True)):
            face = self._face_of_triangle[triangle]
            around = corners[offsets[face] : offsets[face + 1]]
            vertices[row] = around[np.argmin(np.linalg.norm(self._mesh.vertices[around] - point, axis=1))]
        return vertices
