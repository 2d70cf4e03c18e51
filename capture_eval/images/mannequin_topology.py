"""Quads of the mannequin: a cylinder grid with a cap, into which face, eyes, mouth, ears and nostrils are inset.

An inset copies the border of a rectangular block of quads and joins copy and original by a ring of quads, so every
feature is surrounded by concentric closed edge loops, and the only vertices of valence other than 4 are the four
corners of each block (5 outside, 3 at the corners of the innermost grid): away from the loops that carry names.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

IntArray = NDArray[np.int64]

COLUMNS = 72
ROWS = 48
CAP = COLUMNS // 4
FACE_ROWS = (3, 38)
FACE_COLUMNS = (20, 52)
FACE_RINGS = 6


@dataclass(frozen=True)
class Topology:
    """Connectivity of the mannequin's skin.

    Attributes
    ----------
    quads
        (F, 4) vertices, counter-clockwise seen from outside.
    vertex_count
        Number of vertices.
    skull
        (ROWS + 1, COLUMNS) vertices of the cylinder grid; row 0 is the cap's rim, the last row the neck border;
        column 0 is the back, columns run over the subject's right side to the front (COLUMNS / 2) and left side.
    cap
        (CAP + 1, CAP + 1) vertices of the crown; row 0 at the back, column 0 at the subject's right.
    face
        Vertices of the grid inside the face rings; row 0 at the forehead, column 0 at the subject's right.
    rings
        Inset name -> (rings + 1, n) vertices; row 0 is the block's own border, later rows go inwards. A ring starts
        at the upper right corner of the subject's view (smallest column, smallest row) and runs clockwise seen from
        outside.
    inner
        Inset name -> vertices of the grid inside the last ring (its border included).
    mirror
        (V,) vertex on the other side of the median plane.
    """

    quads: IntArray
    vertex_count: int
    skull: IntArray
    cap: IntArray
    face: IntArray
    rings: dict[str, IntArray]
    inner: dict[str, IntArray]
    mirror: IntArray


def block_border(block: IntArray) -> IntArray:
    """Border of a (R, C) block clockwise from its first vertex, 2 (R - 1) + 2 (C - 1) entries."""
    return np.concatenate([block[0, :-1], block[:-1, -1], block[-1, :0:-1], block[:0:-1, 0]])


@dataclass
class _Builder:
    """Quads while they are being built."""

    quads: list[IntArray] = field(default_factory=list)
    vertex_count: int = 0

    def new_vertices(self, count: int) -> IntArray:
        vertices = np.arange(self.vertex_count, self.vertex_count + count, dtype=np.int64)
        self.vertex_count += count
        return vertices

    def add(self, quads: IntArray) -> None:
        self.quads.append(quads.reshape(-1, 4).copy())

    def replace(self, block: IntArray, old: IntArray, new: IntArray) -> None:
        """Give the quads inside a block the new border vertices."""
        table = np.arange(self.vertex_count, dtype=np.int64)
        table[old] = new
        inside = np.zeros(self.vertex_count, dtype=bool)
        inside[block] = True
        cells = {tuple(sorted(cell)) for cell in grid_quads(block).tolist()}
        for quads in self.quads:
            for row in np.flatnonzero(inside[quads].all(axis=1)):
                if tuple(sorted(quads[row].tolist())) in cells:
                    quads[row] = table[quads[row]]

    def inset(self, block: IntArray, rings: int) -> tuple[IntArray, IntArray]:
        """Surround a block by rings; returns the rings (rings + 1, n) and the block with its new border."""
        border = block_border(block)
        levels = [border]
        for _ in range(rings):
            copy = self.new_vertices(len(border))
            last = levels[-1]
            levels.append(copy)
            self.quads.append(np.stack([last, copy, np.roll(copy, -1), np.roll(last, -1)], axis=1))
        self.replace(block, border, levels[-1])
        table = np.arange(self.vertex_count, dtype=np.int64)
        table[border] = levels[-1]
        return np.stack(levels), table[block]


def grid_quads(grid: IntArray) -> IntArray:
    """Quads (n, 4) of a grid of vertices, counter-clockwise when rows run down and columns to the right."""
    corners = [grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]]
    return np.stack(corners, axis=-1).reshape(-1, 4)


# name -> (rows, columns) in the face grid (or the skull grid for the ears), number of rings
_FACE_INSETS: dict[str, tuple[tuple[int, int], tuple[int, int], int]] = {
    "eye_right": ((5, 11), (5, 13), 14),
    "eye_left": ((5, 11), (19, 27), 14),
    "nostril_right": ((18, 20), (13, 15), 3),
    "nostril_left": ((18, 20), (17, 19), 3),
    "mouth": ((22, 28), (9, 23), 17),
}
_EAR_INSETS: dict[str, tuple[tuple[int, int], tuple[int, int], int]] = {
    "ear_right": ((12, 21), (11, 16), 11),
    "ear_left": ((12, 21), (56, 61), 11),
}


def build_topology() -> Topology:
    """Connectivity of the mannequin; the same for every identity and motion."""
    builder = _Builder()
    skull = builder.new_vertices((ROWS + 1) * COLUMNS).reshape(ROWS + 1, COLUMNS)
    builder.add(grid_quads(np.concatenate([skull, skull[:, :1]], axis=1)))
    cap = _build_cap(builder, skull[0])
    rings: dict[str, IntArray] = {}
    inner: dict[str, IntArray] = {}
    top, bottom = FACE_ROWS
    right, left = FACE_COLUMNS
    rings["face"], face = builder.inset(skull[top : bottom + 1, right : left + 1], FACE_RINGS)
    for insets, grid in ((_FACE_INSETS, face), (_EAR_INSETS, skull)):
        for name, (rows, columns, count) in insets.items():
            block = grid[rows[0] : rows[1] + 1, columns[0] : columns[1] + 1]
            rings[name], inner[name] = builder.inset(block, count)
    quads = np.concatenate(builder.quads)
    mirror = _mirror_vertices(builder.vertex_count, skull, cap, face, rings, inner)
    return Topology(quads, builder.vertex_count, skull, cap, face, rings, inner, mirror)


def _build_cap(builder: _Builder, rim: IntArray) -> IntArray:
    cap = np.full((CAP + 1, CAP + 1), -1, dtype=np.int64)
    order = (CAP // 2 - np.arange(COLUMNS)) % COLUMNS
    border = block_border(np.arange((CAP + 1) ** 2).reshape(CAP + 1, CAP + 1))
    cap.ravel()[border] = rim[order]
    hole = cap < 0
    cap[hole] = builder.new_vertices(int(hole.sum()))
    builder.add(grid_quads(cap))
    return cap


def _mirror_vertices(
    count: int,
    skull: IntArray,
    cap: IntArray,
    face: IntArray,
    rings: dict[str, IntArray],
    inner: dict[str, IntArray],
) -> IntArray:
    mirror = np.arange(count, dtype=np.int64)
    mirror[skull] = skull[:, (-np.arange(COLUMNS)) % COLUMNS]
    mirror[cap] = cap[:, ::-1]
    mirror[face] = face[:, ::-1]
    for name, levels in rings.items():
        other = name.replace("right", "#").replace("left", "right").replace("#", "left")
        grid = inner.get(name, face)
        width = grid.shape[1] - 1
        shift = (width - np.arange(levels.shape[1])) % levels.shape[1]
        mirror[levels] = rings[other][:, shift]
        if name in inner:
            mirror[grid] = inner[other][:, ::-1]
    return mirror
