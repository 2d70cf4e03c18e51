"""A ball with known skin, photographed analytically: what the texture-space steps should find is known exactly."""

import numpy as np
from numpy.typing import NDArray

from capture_eval.cameras import Intrinsics, View, pixel_rays

Floats = NDArray[np.float64]

RADIUS = 50.0


def skin(points: Floats, seed: int = 0) -> Floats:
    """Grey 40..215 of a pattern in space, detail of 5 to 15 units, (...)."""
    generator = np.random.default_rng(seed)
    total = np.zeros(points.shape[:-1])
    for _ in range(24):
        direction = generator.normal(size=3)
        direction *= 2.0 * np.pi / generator.uniform(5.0, 15.0) / np.linalg.norm(direction)
        total += np.sin(points @ direction + generator.uniform(0.0, 2.0 * np.pi))
    return np.clip(128.0 + 18.0 * total, 40.0, 215.0)


def mesh(radius: float = RADIUS, columns: int = 90, rows: int = 60) -> tuple[Floats, NDArray[np.int64], Floats]:
    """The front of the ball (+z) as vertices, triangles and the texture coordinates of their corners."""
    u, v = np.meshgrid(np.linspace(0.0, 1.0, columns + 1), np.linspace(0.0, 1.0, rows + 1))
    longitude, latitude = (u - 0.5) * np.deg2rad(150.0), (v - 0.5) * np.deg2rad(110.0)
    points = radius * np.stack(
        [np.sin(longitude) * np.cos(latitude), np.sin(latitude), np.cos(longitude) * np.cos(latitude)], axis=-1
    )
    corner = np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)[None, :]
    a, b, c, d = corner, corner + 1, corner + columns + 2, corner + columns + 1
    triangles = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    uv = np.stack([0.04 + 0.92 * u, 0.04 + 0.92 * v], axis=-1).reshape(-1, 2)
    return points.reshape(-1, 3), triangles.astype(np.int64), uv[triangles]


def views(
    width: int = 320,
    height: int = 240,
    turns: tuple[float, ...] = (-28.0, 0.0, 28.0),
    nods: tuple[float, ...] = (-14.0, 14.0),
) -> list[View]:
    """Cameras in rows, by default six in two, all looking at the ball's centre."""
    result = []
    for row, nod in enumerate(nods):
        for column, turn in enumerate(turns):
            a, b = np.deg2rad([turn, nod])
            centre = 320.0 * np.array([np.sin(a) * np.cos(b), np.sin(b), np.cos(a) * np.cos(b)])
            forward = -centre / np.linalg.norm(centre)
            right = np.cross(forward, [0.0, 1.0, 0.0])
            right /= np.linalg.norm(right)
            rotation = np.stack([right, np.cross(forward, right), forward])
            matrix = np.array([[600.0, 0.0, width / 2], [0.0, 600.0, height / 2], [0.0, 0.0, 1.0]])
            lens = Intrinsics(width, height, matrix, np.array([0.02, -0.01, 0.0, 0.0]))
            result.append(View(f"view_{len(turns) * row + column:02d}", lens, rotation, -rotation @ centre))
    return result


def photograph(view: View, radius: float = RADIUS, seed: int = 0) -> NDArray[np.uint8]:
    """The ball as the view sees it, four rays a pixel, on grey."""
    width, height = view.intrinsics.width, view.intrinsics.height
    total = np.zeros((height, width))
    for du, dv in ((0.25, 0.25), (0.75, 0.25), (0.25, 0.75), (0.75, 0.75)):
        u, v = np.meshgrid(np.arange(width) + du, np.arange(height) + dv)
        origin, direction = pixel_rays(view, np.stack([u.ravel(), v.ravel()], axis=1))
        along = direction @ origin
        under = along**2 - (origin @ origin - radius**2)
        hit = under > 0
        points = origin + (-along - np.sqrt(np.maximum(under, 0.0)))[:, None] * direction
        total += np.where(hit, skin(points, seed), 110.0).reshape(height, width)
    return np.rint(total / 4.0).astype(np.uint8)
