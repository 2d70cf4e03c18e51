"""Small walks on quads that cutting out a head needs: a closed loop of edges, and what lies on one side of it."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from capture_eval.errors import InputError

IntArray = NDArray[np.int64]


def closed_loop(quads: IntArray, first_edge: tuple[int, int]) -> IntArray:
    """Vertices of the closed edge loop that starts with an edge (straight on through vertices of valence 4).

    Parameters
    ----------
    quads
        (F, 4) vertices.
    first_edge
        Two neighbouring vertices.

    Raises
    ------
    InputError
        The loop meets a vertex of another valence before it closes.
    """
    around: dict[int, set[int]] = {}
    opposite: dict[tuple[int, int], set[int]] = {}
    for quad in quads.tolist():
        for k in range(4):
            before, vertex, after = quad[k - 1], quad[k], quad[(k + 1) % 4]
            around.setdefault(vertex, set()).update((before, after))
            opposite.setdefault((before, vertex), set()).add(after)
            opposite.setdefault((after, vertex), set()).add(before)
    loop = [first_edge[0], first_edge[1]]
    while loop[-1] != first_edge[0]:
        before, vertex = loop[-2], loop[-1]
        onward = around.get(vertex, set()) - opposite.get((before, vertex), set()) - {before}
        if len(around.get(vertex, set())) != 4 or len(onward) != 1 or len(loop) > len(around):
            raise InputError(f"the edge loop from {first_edge} ends at vertex {vertex} before it closes")
        loop.append(onward.pop())
    return np.array(loop[:-1], dtype=np.int64)


def faces_enclosed(quads: IntArray, loop: Iterable[int], seed_vertex: int) -> NDArray[np.bool_]:
    """Faces (F,) that can be reached from a vertex without crossing the edges of a closed loop."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    ring = np.asarray(list(loop), dtype=np.int64)
    walls = np.sort(np.stack([ring, np.roll(ring, -1)], axis=1), axis=1)
    edges = np.sort(np.stack([quads, np.roll(quads, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
    size = int(quads.max()) + 1
    keys = edges[:, 0] * size + edges[:, 1]
    open_edge = ~np.isin(keys, walls[:, 0] * size + walls[:, 1])
    face = np.repeat(np.arange(len(quads)), 4)[open_edge]
    _, edge = np.unique(keys[open_edge], return_inverse=True)
    # Faces and open edges as one graph: two faces are joined through the edge they share.
    total = len(quads) + int(edge.max(initial=-1)) + 1
    graph = coo_matrix((np.ones(len(face)), (face, len(quads) + edge)), shape=(total, total))
    _, label = connected_components(graph, directed=False)
    start = np.flatnonzero(np.any(quads == seed_vertex, axis=1))
    if not len(start):
        raise InputError(f"vertex {seed_vertex} is on no face")
    return np.asarray(label[: len(quads)] == label[start[0]], dtype=np.bool_)
