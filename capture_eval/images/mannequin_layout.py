"""Vertex positions of the canonical mannequin: features are placed explicitly, the skin between them relaxes.

The free vertices first get the coordinates of a harmonic map (Tutte, "How to draw a graph", 1963) in the plane of
meridian angle and height, are cast on the sculpted skin, and are then evened out on it by Laplacian smoothing.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix, csr_matrix
from scipy.sparse.linalg import spsolve

from capture_eval.images.mannequin_features import ear_positions, eye_positions, mouth_positions, nostril_positions
from capture_eval.images.mannequin_shape import NECK_HEIGHT, cast_to_skin, project_to_skin
from capture_eval.images.mannequin_topology import CAP, COLUMNS, FACE_COLUMNS, ROWS, Topology

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

_AXIS_Z = -15.0
_CAP_HEIGHT = 0.20
_KNOTS = [0.0, 0.3, 0.5, 0.68, 0.8, 0.88, 1.0]
_ORIGIN_Y = [25.0, 20.0, 0.0, -15.0, -62.0, -120.0, NECK_HEIGHT]
_ELEVATION = [90.0, 20.0, -5.0, -46.0, -46.0, -20.0, 0.0]


def meridian_rays(angle: FloatArray, height: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Rays (origins, unit directions) from the head's axis; angle 0 is the front, height 0 the crown, 1 the neck.

    The rays point up at the crown and down below the chin, so that they meet the skin nowhere at a flat angle.
    """
    origin_y = np.interp(height, _KNOTS, _ORIGIN_Y)
    frontal = np.where(height < 0.3, 1.0, 0.35 + 0.65 * (0.5 + 0.5 * np.cos(angle)))
    elevation = np.radians(np.interp(height, _KNOTS, _ELEVATION) * frontal)
    origins = np.stack([np.zeros_like(angle), origin_y, np.full_like(angle, _AXIS_Z)], axis=1)
    flat = np.cos(elevation)
    return origins, np.stack([flat * np.sin(angle), np.sin(elevation), flat * np.cos(angle)], axis=1)


def meridian_coordinates(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Angle and height whose ray passes through points (N, 3), by bisection in the meridian plane."""
    angle = np.arctan2(points[:, 0], points[:, 2] - _AXIS_Z)
    radius = np.hypot(points[:, 0], points[:, 2] - _AXIS_Z)
    low, high = np.full(len(points), 1e-3), np.ones(len(points))
    for _ in range(30):
        middle = 0.5 * (low + high)
        origins, directions = meridian_rays(angle, middle)
        flat = np.hypot(directions[:, 0], directions[:, 2])
        above = (points[:, 1] - origins[:, 1]) * flat - radius * directions[:, 1] > 0
        low, high = np.where(above, low, middle), np.where(above, middle, high)
    return angle, 0.5 * (low + high)


def vertex_adjacency(topology: Topology) -> csr_matrix:
    """(V, V) sparse matrix with 1 for every edge of the mesh."""
    quads = topology.quads
    start = quads.ravel()
    end = np.roll(quads, -1, axis=1).ravel()
    ones = np.ones(len(start))
    count = topology.vertex_count
    both = coo_matrix((np.concatenate([ones, ones]), (np.r_[start, end], np.r_[end, start])), shape=(count, count))
    adjacency = both.tocsr()
    adjacency.data[:] = 1.0
    return adjacency


def _layout_weights(topology: Topology) -> csr_matrix:
    """Edge weights of the layout: stiff spokes round the eyes keep the rings there in order."""
    weights = vertex_adjacency(topology).tolil()
    for side in ("right", "left"):
        for outer, inner in zip(topology.rings[f"eye_{side}"][:4], topology.rings[f"eye_{side}"][1:5], strict=True):
            weights[outer, inner] = 4.0
            weights[inner, outer] = 4.0
    return weights.tocsr()


def _face_oval(topology: Topology) -> tuple[FloatArray, NDArray[np.int64]]:
    """Outer border of the face: from the hairline past the temple and before the ear along the jaw."""
    ring = topology.rings["face"][0]
    width, height = FACE_COLUMNS[1] - FACE_COLUMNS[0], (len(ring) // 2) - (FACE_COLUMNS[1] - FACE_COLUMNS[0])
    top = np.array([[-60, 58, 40], [-34, 78, 64], [0, 86, 70], [34, 78, 64], [60, 58, 40]], dtype=float)
    side = np.array([[60, 58, 40], [70, 30, 24], [70, 0, 18], [66, -34, 8], [58, -64, 2], [49, -86, 16]], dtype=float)
    under = np.array([[49, -86, 16], [32, -108, 42], [0, -120, 58], [-32, -108, 42], [-49, -86, 16]], dtype=float)
    pieces = [(top, width), (side, height), (under, width), (side[::-1] * [-1, 1, 1], height)]
    points = np.concatenate([_resample(curve, steps)[:-1] for curve, steps in pieces])
    return project_to_skin(points, steps=6), ring


def _resample(curve: FloatArray, steps: int) -> FloatArray:
    from scipy.interpolate import CubicSpline

    length = np.r_[0, np.cumsum(np.linalg.norm(np.diff(curve, axis=0), axis=1))]
    return np.asarray(CubicSpline(length, curve)(np.linspace(0, length[-1], steps + 1)))


# face row -> (midline y, z), (x, y, z) of the foot of the nose's side and the columns from the midline to it; where
# that is short of column 6, the cheek's (x, y, z) there
_NOSE: dict[int, tuple[tuple[float, float], tuple[float, float, float], int, tuple[float, float, float]]] = {
    13: ((-23.5, 107.5), (8.5, -23.0, 94.0), 3, (19.0, -22.0, 82.0)),
    14: ((-27.5, 110.0), (12.5, -28.0, 91.5), 4, (21.0, -26.5, 82.0)),
    15: ((-31.5, 112.5), (16.5, -32.0, 90.5), 5, (22.0, -31.0, 82.0)),
    16: ((-35.5, 113.8), (19.3, -35.5, 91.0), 6, (0.0, 0.0, 0.0)),
    17: ((-39.2, 112.5), (19.8, -39.0, 91.0), 6, (0.0, 0.0, 0.0)),
    18: ((-43.2, 107.0), (19.0, -42.5, 90.5), 6, (0.0, 0.0, 0.0)),
    19: ((-45.0, 102.0), (18.0, -45.5, 89.5), 6, (0.0, 0.0, 0.0)),
    20: ((-46.5, 98.8), (17.0, -48.4, 89.0), 6, (0.0, 0.0, 0.0)),
    21: ((-48.3, 96.3), (16.5, -51.2, 89.0), 6, (0.0, 0.0, 0.0)),
}
_NOSE_COLUMNS = 6


def _nose_row(row: int) -> FloatArray:
    """Points (7, 3) near the skin from the midline over the side of the nose to its sixth column."""
    (y, z), foot, count, cheek = _NOSE[row]
    start, end = np.array([0.0, y, z]), np.array(foot)
    control = np.array([0.78 * foot[0], 0.6 * y + 0.4 * foot[1], z - 2.0])
    t = np.linspace(0.0, 1.0, count + 1)[:, None]
    side = (1 - t) ** 2 * start + 2 * t * (1 - t) * control + t**2 * end
    beyond = np.linspace(0.0, 1.0, _NOSE_COLUMNS - count + 1)[1:, None]
    return np.concatenate([side, (1 - beyond) * end + beyond * np.array(cheek)])


def _profile(topology: Topology) -> tuple[FloatArray, NDArray[np.int64]]:
    """Bridge, tip and wings of the nose: (N, 3) positions on the skin and their vertices."""
    face = topology.face
    middle = face.shape[1] // 2
    points = [np.array([0.0, 6.0 - 3.9 * (row - 6), 86 + 2.4 * (row - 6)]) for row in range(6, 13)]
    vertices = [int(face[row, middle]) for row in range(6, 13)]
    for row in _NOSE:
        for column, point in enumerate(_nose_row(row)):
            for side in (1, -1) if column else (1,):
                points.append(point * [side, 1.0, 1.0])
                vertices.append(int(face[row, middle + side * column]))
    points.append(np.array([0.0, -51.5, 95.0]))
    vertices.append(int(face[22, middle]))
    return project_to_skin(np.array(points), steps=6), np.array(vertices)


def canonical_positions(topology: Topology) -> FloatArray:
    """(V, 3) vertices in millimetres of the canonical person, symmetric in x up to rounding."""
    positions = np.zeros((topology.vertex_count, 3))
    placed = np.zeros(topology.vertex_count, dtype=bool)
    for values, vertices in (_face_oval(topology), _profile(topology)):
        positions[vertices], placed[vertices] = values, True
    for feature in (eye_positions, ear_positions, nostril_positions, mouth_positions):
        values, mask = feature(topology)
        positions[mask], placed[mask] = values[mask], True
        mirrored = topology.mirror[mask]
        positions[mirrored], placed[mirrored] = values[mask] * [-1, 1, 1], True
    adjacency = _layout_weights(topology)
    _place_harmonic(topology, adjacency, positions, placed)
    positions = _relax(topology, adjacency, positions, placed, steps=30)
    placed[_softened(topology)] = False
    positions = _relax(topology, adjacency, positions, placed, steps=12)
    return 0.5 * (positions + positions[topology.mirror] * [-1, 1, 1])


def _softened(topology: Topology) -> NDArray[np.int64]:
    """Placed vertices that may give way at the end: the orbits and the roots of the ears."""
    rings = topology.rings
    return np.concatenate(
        [rings[f"{part}_{side}"][ring] for side in ("right", "left") for part, ring in (("eye", 4), ("ear", 0))]
    )


def _place_harmonic(topology: Topology, adjacency: csr_matrix, positions: FloatArray, placed: BoolArray) -> None:
    """Give the vertices that are not placed a first position on the skin (in place)."""
    count = topology.vertex_count
    angle, height = np.zeros(count), np.zeros(count)
    angle[placed], height[placed] = meridian_coordinates(positions[placed])
    fixed = placed.copy()
    columns = 2 * np.pi * (np.arange(COLUMNS) - COLUMNS / 2) / COLUMNS
    for row, level in ((0, _CAP_HEIGHT), (ROWS, 1.0)):
        angle[topology.skull[row]], height[topology.skull[row]] = columns, level
        fixed[topology.skull[row]] = True
    cap = topology.cap[1:-1, 1:-1]
    across, down = np.meshgrid(np.linspace(-1, 1, CAP + 1)[1:-1], np.linspace(-1, 1, CAP + 1)[1:-1])
    radius = np.maximum(np.abs(across), np.abs(down))
    stretch = radius / np.maximum(np.hypot(across, down), 1e-9)
    angle[cap] = np.arctan2(across * stretch, down * stretch)
    height[cap] = _CAP_HEIGHT * radius + 1e-4
    fixed[cap] = True
    free = ~fixed
    degree = np.asarray(adjacency.sum(axis=1)).ravel()
    matrix = -adjacency[free][:, free]
    matrix.setdiag(degree[free])
    # the back column is the seam of the angle: neighbours across it are seen one turn further
    jump = adjacency[free].tocoo()
    side = np.flatnonzero(free)[jump.row]
    turn = np.round((_first_angle(topology)[side] - _first_angle(topology)[jump.col]) / (2 * np.pi)) * 2 * np.pi
    wrap = np.bincount(jump.row, weights=turn * jump.data, minlength=int(free.sum()))
    coupling = adjacency[free][:, fixed]
    angle[free] = spsolve(matrix.tocsc(), coupling @ angle[fixed] + wrap)
    height[free] = spsolve(matrix.tocsc(), coupling @ height[fixed])
    new = ~placed
    positions[new] = cast_to_skin(*meridian_rays(angle[new], np.clip(height[new], 0, 1)))


def _first_angle(topology: Topology) -> FloatArray:
    """Rough meridian angle per vertex, used only to see which edges cross the back seam."""
    angle = np.zeros(topology.vertex_count)
    angle[topology.skull] = 2 * np.pi * (np.arange(COLUMNS) - COLUMNS / 2) / COLUMNS
    for name, sign in (("ear_left", 1.0), ("ear_right", -1.0)):
        angle[topology.rings[name]] = sign * np.pi / 2
    angle[topology.cap] = np.where(angle[topology.cap] == 0, 0.0, angle[topology.cap])
    return angle


def _relax(
    topology: Topology, adjacency: csr_matrix, positions: FloatArray, placed: BoolArray, steps: int
) -> FloatArray:
    """Even out the free vertices on the skin; the neck border stays in its plane."""
    degree = np.asarray(adjacency.sum(axis=1)).ravel()[:, None]
    free = np.flatnonzero(~placed)
    neck = topology.skull[-1]
    positions = positions.copy()
    for step in range(steps):
        moved = positions + 0.6 * (adjacency @ positions / degree - positions)
        moved[neck] = positions[neck]
        positions[free] = moved[free] if step % 3 else project_to_skin(moved[free], steps=1)
    positions[free] = project_to_skin(positions[free], steps=3)
    positions[neck, 1] = NECK_HEIGHT
    return positions
