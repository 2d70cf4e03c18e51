"""Rigs for tests: a small sheet of a face with bumps as shapes, mirrored in x, and the case done by hand."""

from __future__ import annotations

import numpy as np

from capture_eval.planning.blendshape_rig import BlendshapeRig

TINY_HEIGHTS = (
    {0: 1.0, 1: 0.9, 2: 0.2},
    {0: 0.1, 1: 0.5, 2: 0.4, 5: 0.2},
    {2: 0.6, 3: 0.5},
    {3: 2.0, 4: 2.0},
    {5: 1.0, 6: 0.8, 7: 0.3},
    {6: 0.1, 7: 0.3, 8: 1.0, 9: 0.8},
)


def tiny_rig() -> BlendshapeRig:
    """Ten vertices, eight triangles, six shapes that move in z."""
    neutral = np.array([[i % 5, i // 5, 0.0] for i in range(10)])
    triangles = np.array([t for c in range(4) for t in ((c, c + 1, c + 6), (c, c + 6, c + 5))])
    return rig_of_heights(neutral, triangles, TINY_HEIGHTS)


def tiny_target() -> np.ndarray:
    """The tiny neutral at twice its width."""
    return tiny_rig().neutral * [2.0, 1.0, 1.0]


def rig_of_heights(neutral: np.ndarray, triangles: np.ndarray, heights: tuple[dict[int, float], ...]) -> BlendshapeRig:
    """Shapes that move some vertices in z."""
    shapes = np.repeat(neutral[None], len(heights), axis=0)
    for shape, moved in enumerate(heights):
        for vertex, height in moved.items():
            shapes[shape, vertex, 2] += height
    return BlendshapeRig(tuple(f"shape_{k}" for k in range(len(heights))), neutral, shapes, triangles)


def sheet(columns: int, rows: int) -> tuple[np.ndarray, np.ndarray]:
    """A curved sheet, symmetric in x, (N, 3), and its triangles."""
    x, y = np.meshgrid(np.linspace(-1.0, 1.0, columns), np.linspace(-1.3, 1.3, rows))
    depth = 0.6 * np.sqrt(2.8 - x**2 - y**2)
    vertices = np.stack([x.ravel(), y.ravel(), depth.ravel()], axis=1)
    index = np.arange(columns * rows).reshape(rows, columns)
    a, b, c, d = index[:-1, :-1].ravel(), index[:-1, 1:].ravel(), index[1:, 1:].ravel(), index[1:, :-1].ravel()
    return vertices, np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])


def bump_rig(columns: int, rows: int, pairs: int, middles: int, seed: int) -> BlendshapeRig:
    """Pairs of mirrored bumps (names end in _L and _R) and bumps on the middle line that mirror themselves."""
    vertices, triangles = sheet(columns, rows)
    random = np.random.default_rng(seed)
    names, shapes = [], []
    for number in range(pairs):
        centre = random.uniform([0.15, -1.0], [0.8, 1.0])
        radius, direction = random.uniform(0.15, 0.5), random.normal(size=3) * random.uniform(0.02, 0.1)
        for side, sign in (("L", 1.0), ("R", -1.0)):
            names.append(f"side{number:02d}_{side}")
            shapes.append(vertices + _bump(vertices, centre * [sign, 1.0], radius, direction * [sign, 1.0, 1.0]))
    for number in range(middles):
        centre = np.array([0.0, random.uniform(-1.0, 1.0)])
        direction = random.normal(size=3) * random.uniform(0.02, 0.1) * [0.0, 1.0, 1.0]
        names.append(f"middle{number:02d}")
        shapes.append(vertices + _bump(vertices, centre, random.uniform(0.15, 0.5), direction))
    return BlendshapeRig(tuple(names), vertices, np.array(shapes), triangles)


def _bump(vertices: np.ndarray, centre: np.ndarray, radius: float, direction: np.ndarray) -> np.ndarray:
    distance = ((vertices[:, :2] - centre) ** 2).sum(axis=1)
    return np.exp(-distance / radius**2)[:, None] * direction
