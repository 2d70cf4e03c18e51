"""Edge loops of a polygon mesh: straight on through regular vertices, stop at the others.

The rule: at an interior vertex of valence 4 the walk goes on along the opposite edge; at any other valence, or where
it meets a border, it stops. A border edge is followed along the border. Going on is its own reverse, so every edge
belongs to exactly one maximal loop.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from capture_eval.errors import InputError
from capture_eval.polygon_mesh import PolygonMesh

Integers = NDArray[np.int64]


@dataclass(frozen=True)
class EdgeLoop:
    """A walk along edges.

    Parameters
    ----------
    vertices : (M,) int64
        Vertices in order; the first is not repeated at the end of a closed loop.
    closed : bool
        Whether the last vertex is joined to the first.
    border : bool
        Whether the loop runs along a border of the mesh.
    """

    vertices: Integers
    closed: bool
    border: bool = False

    @property
    def edge_count(self) -> int:
        """Number of edges walked."""
        return len(self.vertices) - (0 if self.closed else 1)


@dataclass(frozen=True)
class EdgeTopology:
    """Which edge goes on from which, built once for a mesh.

    Directed edge ``2 e`` runs from ``edges[e, 0]`` to ``edges[e, 1]`` and ``2 e + 1`` runs back.

    Parameters
    ----------
    edges : (E, 2) int64
        Undirected edges, the smaller vertex first, sorted.
    successor : (2 E,) int64
        Directed edge that goes on from each directed edge; -1 where the walk stops.
    next_in_face : (2 E,) int64
        Directed edge that follows inside the face on the left; -1 where there is no face.
    valence : (V,) int64
        Number of edges at every vertex.
    on_border : (V,) bool
        Vertices of edges that have one face only.
    """

    edges: Integers
    successor: Integers
    next_in_face: Integers
    valence: Integers
    on_border: NDArray[np.bool_]
    _directed: Mapping[tuple[int, int], int] = field(repr=False, compare=False)

    @property
    def vertex_count(self) -> int:
        """Number of vertices of the mesh."""
        return len(self.valence)

    def directed_edge(self, start: int, end: int) -> int:
        """Index of the directed edge from ``start`` to ``end``.

        Raises
        ------
        InputError
            The mesh has no such edge.
        """
        try:
            return self._directed[(start, end)]
        except KeyError:
            raise InputError(self._no_edge(start, end)) from None

    def has_edge(self, start: int, end: int) -> bool:
        """Whether the two vertices are joined by an edge."""
        return (start, end) in self._directed

    def is_border_edge(self, start: int, end: int) -> bool:
        """Whether the edge between the two vertices has one face only."""
        edge = self.directed_edge(start, end)
        return bool(self.next_in_face[edge] < 0 or self.next_in_face[edge ^ 1] < 0)

    def _no_edge(self, start: int, end: int) -> str:
        for vertex in (start, end):
            if not 0 <= vertex < self.vertex_count:
                return f"vertex {vertex} is not in the mesh, which has {self.vertex_count}"
        return f"vertices {start} and {end} are not joined by an edge"


def edge_topology(mesh: PolygonMesh) -> EdgeTopology:
    """Half-edge arrays of a mesh.

    Parameters
    ----------
    mesh : PolygonMesh
        Polygons with consistent winding, at most two at an edge.

    Returns
    -------
    EdgeTopology
        Edges, successors and valences.

    Raises
    ------
    InputError
        An edge has more than two faces, or two faces that run the same way along it.
    """
    corners, sizes = mesh.face_vertices, np.diff(mesh.face_offsets)
    last_corner = np.repeat(mesh.face_offsets[1:] - 1, sizes)
    first_corner = np.repeat(mesh.face_offsets[:-1], sizes)
    position = np.arange(len(corners))
    next_corner = np.where(position == last_corner, first_corner, position + 1)
    start, end = corners, corners[next_corner]
    edges, edge_of_corner = np.unique(np.sort(np.stack([start, end], axis=1), axis=1), axis=0, return_inverse=True)
    directed_of_corner = 2 * edge_of_corner.reshape(-1) + (start > end)
    _refuse_bad_edges(edges, directed_of_corner)
    next_in_face = np.full(2 * len(edges), -1, dtype=np.int64)
    next_in_face[directed_of_corner] = directed_of_corner[next_corner]
    valence = np.bincount(edges.ravel(), minlength=len(mesh.vertices)).astype(np.int64)
    has_face = (next_in_face >= 0).reshape(-1, 2)
    border_edges = ~has_face.all(axis=1)
    on_border = np.zeros(len(mesh.vertices), dtype=bool)
    on_border[edges[border_edges].ravel()] = True
    targets = edges[:, ::-1].reshape(-1)
    successor = _successors(next_in_face, targets, valence, on_border, np.repeat(border_edges, 2))
    directed = {pair: 2 * e for e, pair in enumerate(map(tuple, edges.tolist()))}
    directed.update({(b, a): number + 1 for (a, b), number in list(directed.items())})
    return EdgeTopology(edges, successor, next_in_face, valence, on_border, directed)


def _refuse_bad_edges(edges: Integers, directed_of_corner: Integers) -> None:
    uses = np.bincount(directed_of_corner, minlength=2 * len(edges))
    if np.any(edges[:, 0] == edges[:, 1]):
        bad = int(np.argmax(edges[:, 0] == edges[:, 1]))
        raise InputError(f"mesh: a face uses vertex {edges[bad, 0]} twice in a row")
    if np.any(uses > 1):
        a, b = edges[int(np.argmax(uses > 1)) // 2].tolist()
        faces = int(uses.reshape(-1, 2)[int(np.argmax(uses > 1)) // 2].sum())
        reason = "belongs to more than two faces" if faces > 2 else "has two faces of opposite winding"
        raise InputError(f"mesh: edge {a}-{b} {reason}; edge loops need a manifold, consistently wound mesh")


def _successors(
    next_in_face: Integers,
    targets: Integers,
    valence: Integers,
    on_border: NDArray[np.bool_],
    border_edge: NDArray[np.bool_],
) -> Integers:
    """Opposite edges at interior vertices of valence 4, and the next border edge along borders."""
    count = len(next_in_face)
    successor = np.full(count, -1, dtype=np.int64)
    regular = np.flatnonzero((valence[targets] == 4) & ~on_border[targets])
    successor[regular] = next_in_face[next_in_face[regular] ^ 1]
    sources = targets[np.arange(count) ^ 1]
    leaving = np.flatnonzero(border_edge)
    borders_at = np.bincount(sources[leaving], minlength=len(valence))
    arriving = leaving[borders_at[targets[leaving]] == 2]
    total = np.bincount(sources[leaving], weights=leaving, minlength=len(valence)).astype(np.int64)
    successor[arriving] = total[targets[arriving]] - (arriving ^ 1)
    return successor


def walk_edge_loop(
    topology: EdgeTopology,
    start_edge: tuple[int, int],
    turns: Mapping[int, int] | None = None,
    stop: int | None = None,
) -> EdgeLoop:
    """Walk from the first to the second vertex of an edge and on, until the rule, a stop or the start ends it.

    Parameters
    ----------
    topology : EdgeTopology
        Of the mesh.
    start_edge : (int, int)
        The loop begins at the first vertex and leaves towards the second.
    turns : mapping of vertex to next vertex, optional
        At these vertices the walk goes on to the named neighbour instead of following the rule.
    stop : int, optional
        The walk ends when it reaches this vertex.

    Returns
    -------
    EdgeLoop
        Closed when the walk came back to its start edge, or when ``stop`` is its first vertex.

    Raises
    ------
    InputError
        An edge, turn or stop vertex is not on the mesh or not reached, or the walk runs round without coming back.
    """
    turns = turns or {}
    first = topology.directed_edge(*start_edge)
    for vertex, following in turns.items():
        topology.directed_edge(vertex, following)
    targets = topology.edges[:, ::-1].reshape(-1)
    vertices = [start_edge[0]]
    seen: set[int] = set()
    current = first
    while True:
        if current in seen:
            raise InputError(f"the walk from edge {start_edge[0]}-{start_edge[1]} runs in circles past its start")
        seen.add(current)
        vertex = int(targets[current])
        if vertex == stop:
            closed = vertex == start_edge[0]
            return _loop(topology, vertices if closed else [*vertices, vertex], closed)
        following = topology.successor[current]
        if vertex in turns:
            following = topology.directed_edge(vertex, turns[vertex])
        if following == first:
            return _finished(topology, vertices, True, stop)
        vertices.append(vertex)
        if following < 0:
            return _finished(topology, vertices, False, stop)
        current = int(following)


def _loop(topology: EdgeTopology, vertices: list[int], closed: bool) -> EdgeLoop:
    pairs = list(pairwise([*vertices, vertices[0]] if closed else vertices))
    border = all(topology.is_border_edge(a, b) for a, b in pairs)
    return EdgeLoop(np.array(vertices, dtype=np.int64), closed, border)


def _finished(topology: EdgeTopology, vertices: list[int], closed: bool, stop: int | None) -> EdgeLoop:
    if stop is not None:
        if not 0 <= stop < topology.vertex_count:
            raise InputError(f"stop vertex {stop} is not in the mesh, which has {topology.vertex_count}")
        where = "comes back to its start" if closed else f"ends at vertex {vertices[-1]}"
        raise InputError(f"the walk from edge {vertices[0]}-{vertices[1]} {where} without meeting stop vertex {stop}")
    return _loop(topology, vertices, closed)


def spoke(topology: EdgeTopology, arriving_from: int, vertex: int, number: int) -> int:
    """Neighbour of ``vertex`` that is the ``number``-th spoke from the edge the walk arrives on.

    Spokes are counted in the direction of the face winding; at an interior vertex of valence 4, spoke 2 is the
    opposite edge.

    Raises
    ------
    InputError
        There is no such edge, or a border lies between.
    """
    current = topology.directed_edge(arriving_from, vertex)
    targets = topology.edges[:, ::-1].reshape(-1)
    for _ in range(number):
        current = int(topology.next_in_face[current])
        if current < 0:
            raise InputError(f"vertex {vertex} has no spoke {number} from vertex {arriving_from}: a border is between")
        leaving, current = current, current ^ 1
    return int(targets[leaving]) if number > 0 else arriving_from


def maximal_loops(topology: EdgeTopology) -> list[EdgeLoop]:
    """All maximal edge loops; every edge of the mesh is in exactly one.

    Returns
    -------
    list of EdgeLoop
        Closed loops first, each group by falling number of vertices, then by first vertex. A closed loop starts at
        its smallest vertex and leaves towards the smaller neighbour; an open one starts at its smaller end.
    """
    targets = topology.edges[:, ::-1].reshape(-1)
    successor = topology.successor.tolist()
    visited = np.zeros(len(topology.edges), dtype=bool)
    loops = []
    for edge in range(len(topology.edges)):
        if visited[edge]:
            continue
        forward, closed = _follow(successor, 2 * edge)
        walk = forward
        if not closed:
            backward, _ = _follow(successor, 2 * edge + 1)
            walk = [directed ^ 1 for directed in reversed(backward)] + forward[1:]
        visited[np.array(walk) // 2] = True
        vertices = targets[np.array(walk) ^ 1].tolist()
        vertices = vertices if closed else [*vertices, int(targets[walk[-1]])]
        border = bool((topology.next_in_face.reshape(-1, 2)[edge] < 0).any())
        loops.append(_canonical(vertices, closed, border))
    return sorted(loops, key=lambda loop: (not loop.closed, -len(loop.vertices), loop.vertices.tolist()))


def _follow(successor: list[int], first: int) -> tuple[list[int], bool]:
    walk = [first]
    while True:
        following = successor[walk[-1]]
        if following == first:
            return walk, True
        if following < 0:
            return walk, False
        walk.append(following)


def _canonical(vertices: list[int], closed: bool, border: bool) -> EdgeLoop:
    if not closed:
        return EdgeLoop(np.array(min(vertices, vertices[::-1]), dtype=np.int64), closed, border)
    smallest = min(vertices)
    turned = [
        order[at:] + order[:at]
        for order in (vertices, vertices[::-1])
        for at, vertex in enumerate(order)
        if vertex == smallest
    ]
    return EdgeLoop(np.array(min(turned), dtype=np.int64), closed, border)
