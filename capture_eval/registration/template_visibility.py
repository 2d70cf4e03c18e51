"""Which vertices of a template are skin that a camera could see: the inside of the mouth and sockets are not."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from capture_eval.triangle_geometry import diameter, vertex_normals

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

SKIN_SHARE = 0.02  # vertices seen from fewer of all directions are no skin
SCAN_TRUST = (0.18, 0.35)  # open skin is seen from half of all directions, nostrils and folds from a fifth


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
    minimum_share: float = SKIN_SHARE,
) -> NDArray[np.bool_]:
    """Vertices seen from more than the stated share of all directions, (V,) bool."""
    return visible_direction_share(vertices, triangles, occluders) > minimum_share


def scan_trust(share: Floats, limits: tuple[float, float] = SCAN_TRUST) -> Floats:
    """How far a scan is believed at each vertex, (V,) in [0, 1], by the share of directions that see the template.

    A scan closes nostrils, the folds of the ears and the slits beside the eyes with a smooth skin. There the
    template's own shape, carried on from the skin around, is nearer to the truth.
    """
    rise = np.clip((share - limits[0]) / (limits[1] - limits[0]), 0.0, 1.0)
    return np.asarray(rise * rise * (3.0 - 2.0 * rise), dtype=np.float64)
