"""Landmarks as a person would click them: visible, in a few photos, a pixel off."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from capture_eval.cameras import View, project
from capture_eval.images.ray_casting import TriangleScene

FloatArray = NDArray[np.float64]


def visible_vertices(
    scene: TriangleScene,
    normals: FloatArray,
    view: View,
    vertices: NDArray[np.int64],
    least_cosine: float = 0.2,
    margin: float = 4.0,
) -> tuple[NDArray[np.bool_], FloatArray]:
    """Which vertices a view sees: in the picture, turned towards the camera, nothing in between.

    Parameters
    ----------
    scene
        All that can hide a vertex.
    normals
        (V, 3) unit normals of the scene's vertices.
    vertices
        (N,) vertices asked for.
    least_cosine
        Smallest cosine between normal and direction to the camera.
    margin
        Distance to the border of the picture, pixels.

    Returns
    -------
    visible
        (N,) bool.
    pixels
        (N, 2) exact place in the photo.
    """
    points = scene.vertices[vertices]
    pixels, depth = project(view, points)
    towards = view.center - points
    towards = towards / np.linalg.norm(towards, axis=1, keepdims=True)
    size = np.array([view.intrinsics.width, view.intrinsics.height])
    visible = (depth > 0) & np.all((pixels > margin) & (pixels < size - margin), axis=1)
    visible &= np.einsum("ij,ij->i", towards, normals[vertices]) > least_cosine
    starts = points + 0.3 * normals[vertices]
    visible &= ~scene.occluded(starts, np.broadcast_to(view.center, starts.shape))
    return visible, pixels


def click_landmarks(
    scene: TriangleScene,
    normals: FloatArray,
    views: Sequence[View],
    landmarks: Mapping[str, int],
    seed: int,
    noise: float = 1.0,
    most_photos: int = 5,
) -> dict[str, dict[str, tuple[float, float]]]:
    """Pixel of every landmark in some of the photos that see it, with Gaussian noise.

    Parameters
    ----------
    landmarks
        Name -> vertex of the scene.
    noise
        Standard deviation in pixels, per coordinate.
    most_photos
        Photos per landmark at most, drawn among those that see it.

    Returns
    -------
    Name -> photo name -> (u, v). A landmark seen by fewer than two photos has an empty entry.
    """
    random = np.random.default_rng([seed, 202])
    vertices = np.array(list(landmarks.values()), dtype=np.int64)
    seen = [visible_vertices(scene, normals, view, vertices) for view in views]
    clicks: dict[str, dict[str, tuple[float, float]]] = {}
    for number, name in enumerate(landmarks):
        able = [index for index, (visible, _) in enumerate(seen) if visible[number]]
        chosen = sorted(random.permutation(able)[:most_photos].tolist()) if len(able) >= 2 else []
        clicks[name] = {}
        for index in chosen:
            u, v = seen[index][1][number] + random.normal(0.0, noise, 2)
            clicks[name][views[index].name] = (float(u), float(v))
    return clicks
