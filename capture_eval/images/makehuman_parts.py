"""What is seen of a MakeHuman head besides skin: eyes with iris and pupil, teeth, tongue, the collar below the neck."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
ByteArray = NDArray[np.uint8]

TEETH = (226, 216, 196)
TONGUE = (184, 98, 98)
COLLAR = (58, 60, 66)
# Angles from the axis of the eye, degrees.
_PUPIL, _IRIS = 10.0, 25.0


def split_quads(faces: IntArray, vertices: int) -> tuple[Any, IntArray]:
    """Cut every quad into four at its edge and face midpoints.

    Returns
    -------
    matrix
        Sparse (new vertices, vertices); fine positions = matrix @ coarse positions.
    faces
        (4 F, 4).
    """
    from scipy.sparse import csr_matrix

    edges = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
    unique, edge_of = np.unique(edges, axis=0, return_inverse=True)
    middle = vertices + edge_of.reshape(-1, 4)
    center = vertices + len(unique) + np.arange(len(faces))
    fine = np.stack(
        [np.stack([faces[:, k], middle[:, k], center, middle[:, k - 1]], axis=1) for k in range(4)], axis=1
    ).reshape(-1, 4)
    count = vertices + len(unique) + len(faces)
    rows = np.concatenate([np.arange(vertices), np.repeat(vertices + np.arange(len(unique)), 2), np.repeat(center, 4)])
    columns = np.concatenate([np.arange(vertices), unique.ravel(), faces.ravel()])
    weights = np.concatenate([np.ones(vertices), np.full(2 * len(unique), 0.5), np.full(4 * len(faces), 0.25)])
    return csr_matrix((weights, (rows, columns)), shape=(count, vertices)), fine


def eye_colors(vertices: FloatArray, iris: tuple[int, int, int], seed: int) -> ByteArray:
    """sRGB colours (V, 3) of one eyeball that looks along +z: sclera with faint vessels, iris, pupil."""
    middle = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
    direction = vertices - middle
    direction = direction / np.linalg.norm(direction, axis=1, keepdims=True)
    angle = np.degrees(np.arccos(np.clip(direction[:, 2], -1.0, 1.0)))
    around = np.arctan2(direction[:, 1], direction[:, 0])
    phases = np.random.default_rng([seed, 401]).uniform(0.0, 2.0 * np.pi, 4)
    rays = 0.5 + 0.25 * (np.sin(31 * around + phases[0]) + np.sin(17 * around + phases[1]))
    vessels = np.clip(np.sin(9 * around + phases[2] + angle / 9.0) * np.sin(23 * around + phases[3]) - 0.2, 0.0, 1.0)
    colors = np.tile(np.array([[228.0, 224.0, 218.0]]), (len(vertices), 1))
    pink = np.clip((angle - 36.0) / 30.0, 0.0, 1.0) * (0.35 + 0.65 * vessels)
    colors -= pink[:, None] * np.array([10.0, 62.0, 58.0])
    in_iris = np.clip((_IRIS - angle) / 2.0 + 0.5, 0.0, 1.0)
    ring = 1.0 - 0.6 * np.exp(-(((angle - _IRIS) / 2.5) ** 2))
    colors += in_iris[:, None] * (np.asarray(iris) * (0.75 + 0.5 * rays)[:, None] - colors)
    colors *= ring[:, None]
    in_pupil = np.clip((_PUPIL - angle) / 2.0 + 0.5, 0.0, 1.0)
    colors += in_pupil[:, None] * (np.array([16.0, 13.0, 12.0]) - colors)
    return np.asarray(np.clip(np.rint(colors), 0.0, 255.0), dtype=np.uint8)
