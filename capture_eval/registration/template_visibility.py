"""Which vertices of a template are skin that a camera could see: the inside of the mouth and sockets are not."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from capture_eval.triangle_geometry import diameter, vertex_normals

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


def sphere_directions(count: int) -> Floats:
    """Nearly even directions on the unit sphere (Fibonacci lattice), (count, 3)."""
    index = np.arange(count) + 0.5
    height = 1.0 - 2.0 * index / count
    azimuth = np.pi * (1.0 + np.sqrt(5.0)) * index
    radius = np.sqrt(1.0 - height**2)
    return np.stack([radius * np.cos(azimuth), radius * np.sin(azimuth), height], axis=1)


def visible_direction_share(
    vertices: Floats,
    triangles: Integers,
    occluders: tuple[Floats, Integers] | None = None,
    directions: int = 300,
) -> Floats:
    """Share of all directions from which each vertex is seen, (V,).

    Parameters
    ----------
    occluders : (vertices, triangles), optional
        Eyes, teeth, tongue of the same template.
    """
    import open3d

    library = cast("Any", open3d)
    tensor = library.core.Tensor
    scene = library.t.geometry.RaycastingScene(nthreads=1)
    for places, faces in [(vertices, triangles)] + ([] if occluders is None else [occluders]):
        scene.add_triangles(tensor(places.astype(np.float32)), tensor(faces.astype(np.uint32)))
    size = diameter(vertices)
    normals = vertex_normals(vertices, triangles)
    origins = vertices + 1e-3 * size * normals
    seen = np.zeros(len(vertices))
    for direction in sphere_directions(directions):
        facing = np.flatnonzero(normals @ direction > 0.0)
        rays = np.concatenate([origins[facing], np.broadcast_to(direction, (len(facing), 3))], axis=1)
        blocked = scene.test_occlusions(tensor(rays.astype(np.float32)), tfar=4.0 * size, nthreads=1).numpy()
        seen[facing[~blocked]] += 1.0
    return seen / directions


def skin_vertices(
    vertices: Floats,
    triangles: Integers,
    occluders: tuple[Floats, Integers] | None = None,
    minimum_share: float = 0.02,
) -> NDArray[np.bool_]:
    """Vertices seen from more than the stated share of all directions, (V,) bool."""
    return visible_direction_share(vertices, triangles, occluders) > minimum_share
