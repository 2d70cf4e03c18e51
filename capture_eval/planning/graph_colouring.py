"""Exact clique and colouring of small graphs, as certificates for the fewest expressions.

A set of items that all conflict (a clique) needs as many expressions as it has items; a colouring with as many colours
proves that they suffice. Vertex sets are the bits of whole numbers. Cliques: branch and bound with greedy colour
bounds (Tomita et al. 2010, San Segundo et al. 2011); colouring: saturation branching (Brélaz 1979) on what is left
after taking away vertices that can always be coloured.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Booleans = NDArray[np.bool_]


@dataclass(frozen=True)
class Clique:
    """Vertices that are all joined, ascending, and whether no larger set of that kind exists."""

    vertices: tuple[int, ...]
    proven: bool


@dataclass(frozen=True)
class Colouring:
    """Answer to "do these colours suffice?".

    Attributes
    ----------
    colours : mapping from vertex to colour, or None
        None where no colouring was found.
    decided : bool
        With no colouring: True if none exists, False if the search was given up.
    """

    colours: dict[int, int] | None
    decided: bool


def neighbour_sets(conflicts: Booleans) -> list[int]:
    """Neighbours of every vertex as bits."""
    return [sum(1 << int(other) for other in np.flatnonzero(row)) for row in conflicts]


def bits(vertices: int) -> Iterator[int]:
    """Numbers of the set bits, ascending."""
    while vertices:
        low = vertices & -vertices
        yield low.bit_length() - 1
        vertices ^= low


class _CliqueSearch:
    """Branch and bound; gives up after a number of nodes, so that its answer never depends on the clock."""

    def __init__(self, neighbours: Sequence[int], node_limit: int) -> None:
        self.neighbours, self.left = neighbours, node_limit
        self.best: list[int] = []

    def expand(self, clique: list[int], candidates: int) -> None:
        self.left -= 1
        if self.left < 0:
            return
        if not candidates:
            if len(clique) > len(self.best):
                self.best = clique.copy()
            return
        for vertex, colours in reversed(self.colour_order(candidates)):
            if len(clique) + colours <= len(self.best):
                return
            self.expand([*clique, vertex], candidates & self.neighbours[vertex])
            candidates &= ~(1 << vertex)

    def colour_order(self, candidates: int) -> list[tuple[int, int]]:
        """Vertices in the order of greedy colour classes, with the number of classes up to each."""
        order = []
        colour = 0
        while candidates:
            colour += 1
            independent = candidates
            while independent:
                low = independent & -independent
                vertex = low.bit_length() - 1
                order.append((vertex, colour))
                candidates ^= low
                independent &= ~low & ~self.neighbours[vertex]
        return order


def maximum_clique(neighbours: Sequence[int], among: int, node_limit: int = 100_000) -> Clique:
    """Largest set of joined vertices among the given ones (bits).

    Vertices are renumbered from the one with most neighbours down, which makes the colour bounds tight.
    """
    order = sorted(bits(among), key=lambda v: (-(neighbours[v] & among).bit_count(), v))
    place = {vertex: number for number, vertex in enumerate(order)}
    local = [sum(1 << place[other] for other in bits(neighbours[vertex] & among)) for vertex in order]
    search = _CliqueSearch(local, node_limit)
    search.expand([], (1 << len(order)) - 1)
    return Clique(tuple(sorted(order[number] for number in search.best)), search.left >= 0)


class _ColourSearch:
    """Saturation branching with a list of allowed colours (bits) for every vertex."""

    def __init__(self, neighbours: Sequence[int], plain: int, node_limit: int) -> None:
        self.neighbours, self.plain, self.left = neighbours, plain, node_limit

    def solve(self, open_vertices: int, allowed: dict[int, int], used: int) -> dict[int, int] | None:
        """Colours of the open vertices; None if there are none or the search was given up."""
        self.left -= 1
        if self.left < 0:
            return None
        if not open_vertices:
            return {}
        vertex = min(
            bits(open_vertices),
            key=lambda v: (allowed[v].bit_count(), -(self.neighbours[v] & open_vertices).bit_count(), v),
        )
        choices = allowed[vertex]
        fresh = choices & self.plain & ~used
        choices &= ~fresh | (fresh & -fresh)  # unused colours without rules are all alike: try one
        rest = open_vertices & ~(1 << vertex)
        for colour in bits(choices):
            bit = 1 << colour
            reduced = dict(allowed)
            possible = True
            for other in bits(self.neighbours[vertex] & rest):
                left = reduced[other] & ~bit
                reduced[other] = left
                if not left:
                    possible = False
                    break
            if possible:
                found = self.solve(rest, reduced, used | bit)
                if found is not None:
                    found[vertex] = colour
                    return found
        return None


def colour_graph(
    neighbours: Sequence[int],
    among: int,
    count: int,
    forbidden: dict[int, int] | None = None,
    node_limit: int = 5_000,
) -> Colouring:
    """Colour vertices with ``count`` colours so that joined ones differ.

    Parameters
    ----------
    neighbours : sequence of int
        From `neighbour_sets`.
    among : int
        Bits of the vertices to colour.
    count : int
        Colours are 0, 1, …, count - 1.
    forbidden : mapping from vertex to bits of colours, optional
    node_limit : int
        Branches before giving up.
    """
    every = (1 << count) - 1
    allowed = {vertex: every & ~(forbidden or {}).get(vertex, 0) for vertex in bits(among)}
    ruled = 0
    for colours in (forbidden or {}).values():
        ruled |= colours
        if (every & ~colours).bit_count() == 1:
            ruled |= every & ~colours
    core, peeled = _peel(neighbours, among, allowed)
    if any(not allowed[vertex] for vertex in bits(core)):
        return Colouring(None, True)
    # A colour that some vertex is barred from is not interchangeable with the others.
    search = _ColourSearch(neighbours, every & ~ruled, node_limit)
    colours_of = search.solve(core, {vertex: allowed[vertex] for vertex in bits(core)}, 0)
    if colours_of is None:
        return Colouring(None, search.left >= 0)
    for vertex in reversed(peeled):
        taken = 0
        for other in bits(neighbours[vertex] & among):
            if other in colours_of:
                taken |= 1 << colours_of[other]
        free = allowed[vertex] & ~taken
        colours_of[vertex] = (free & -free).bit_length() - 1
    return Colouring(colours_of, True)


def fewer_colours(
    neighbours: Sequence[int], colours: dict[int, int], enough: int, passes: int = 1_500
) -> dict[int, int]:
    """Recolour class by class in changing orders, which never needs more colours and often fewer.

    Iterated greedy colouring (Culberson 1992): each class goes first-fit into new classes, the classes in reverse, by
    size or in random order, until ``enough`` colours are left. The random numbers are seeded.
    """
    random = np.random.default_rng(0)
    classes = [sum(1 << v for v in colours if colours[v] == colour) for colour in sorted(set(colours.values()))]
    for number in range(passes):
        if len(classes) <= enough:
            break
        if number % 3 == 0:
            order = classes[::-1]
        elif number % 3 == 1:
            order = sorted(classes, key=lambda members: -members.bit_count())
        else:
            order = [classes[int(place)] for place in random.permutation(len(classes))]
        classes = _first_fit(neighbours, order)
    return {vertex: colour for colour, members in enumerate(classes) for vertex in bits(members)}


def _first_fit(neighbours: Sequence[int], order: Sequence[int]) -> list[int]:
    classes: list[int] = []
    for members in order:
        for vertex in bits(members):
            for colour, taken in enumerate(classes):
                if not taken & neighbours[vertex]:
                    classes[colour] = taken | 1 << vertex
                    break
            else:
                classes.append(1 << vertex)
    return classes


def _peel(neighbours: Sequence[int], among: int, allowed: dict[int, int]) -> tuple[int, list[int]]:
    """Take away vertices with more allowed colours than neighbours left, again and again; they colour themselves."""
    peeled: list[int] = []
    again = True
    while again:
        again = False
        for vertex in bits(among):
            if (neighbours[vertex] & among).bit_count() < allowed[vertex].bit_count():
                among &= ~(1 << vertex)
                peeled.append(vertex)
                again = True
    return among, peeled


def uncolourable_part(
    neighbours: Sequence[int],
    among: int,
    count: int,
    forbidden: dict[int, int] | None = None,
    node_limit: int = 5_000,
) -> tuple[int, ...]:
    """A small part of an uncolourable set of vertices that is itself proven uncolourable, ascending.

    A clique of more than ``count`` vertices where there is one; else vertices are left out as long as the proof holds.
    """
    clique = maximum_clique(neighbours, among, node_limit)
    if len(clique.vertices) > count:
        return clique.vertices[: count + 1]
    part = among
    for vertex in list(bits(among)):
        smaller = part & ~(1 << vertex)
        answer = colour_graph(neighbours, smaller, count, forbidden, node_limit)
        if answer.colours is None and answer.decided:
            part = smaller
    return tuple(bits(part))
