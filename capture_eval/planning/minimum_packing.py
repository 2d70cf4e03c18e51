"""The fewest expressions, proven, and among those plans the one that helps most in its order.

The fewest expressions are the chromatic number of the conflict graph. Among all plans of that size the first
expression is made as important as possible, then the second, and so on. Each step is the 0/1 programme of a round with
cuts: if what a set leaves over cannot be coloured with the colours that remain, some part of the rest cannot either,
and every valid set must take something of that part.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from capture_eval.errors import InputError, SolverError
from capture_eval.planning.graph_colouring import (
    Clique,
    bits,
    colour_graph,
    fewer_colours,
    maximum_clique,
    neighbour_sets,
    uncolourable_part,
)
from capture_eval.planning.independent_set import heaviest_set
from capture_eval.planning.packing import PackedSet, PackingProblem, check_reached

NODE_LIMIT = 5_000
_CUTS = 500


@dataclass(frozen=True)
class Fewest:
    """How many expressions are needed.

    Attributes
    ----------
    count : int
        Expressions of the best plan found.
    lower_bound : int
        Proven: no plan has fewer.
    clique : tuple of int
        Items that all conflict with each other; as many as the bound where that alone proves it.
    colours : mapping from item to expression (0, 1, …)
        A plan of ``count`` expressions.
    """

    count: int
    lower_bound: int
    clique: tuple[int, ...]
    colours: dict[int, int]

    @property
    def proven(self) -> bool:
        """Whether no plan with fewer expressions exists."""
        return self.count == self.lower_bound


def fewest_expressions(problem: PackingProblem, node_limit: int = NODE_LIMIT) -> Fewest:
    """Chromatic number of the conflict graph under the rules, or the proven bound and the best plan found.

    Parameters
    ----------
    node_limit : int
        Branches of every search before it is given up.
    """
    neighbours = neighbour_sets(problem.conflicts)
    every = (1 << len(problem.items)) - 1
    clique = maximum_clique(neighbours, every, 20 * node_limit)
    floor = max(len(clique.vertices), problem.rules.last_expression)
    upper, colours = _start(problem, neighbours, every, floor)
    lower = min(floor, upper)
    for count in range(lower, upper):
        answer = colour_graph(neighbours, every, count, forbidden_colours(problem, 0, count), node_limit)
        if answer.colours is not None:
            upper, colours = count, answer.colours
            break
        if answer.decided and count == lower:
            lower += 1
    return Fewest(upper, lower, clique.vertices, colours)


def bound_of_fewest(problem: PackingProblem, node_limit: int = NODE_LIMIT) -> Clique:
    """Largest clique of the conflict graph: no plan can have fewer expressions than it has items."""
    return maximum_clique(neighbour_sets(problem.conflicts), (1 << len(problem.items)) - 1, 20 * node_limit)


def forbidden_colours(problem: PackingProblem, done: int, count: int) -> dict[int, int]:
    """Colours 0 … count - 1, for the expressions done + 1 …, that the rules bar items from, as bits."""
    every = (1 << count) - 1
    barred: dict[int, int] = {}
    for number, items in problem.rules.exclude.items():
        if done < number <= done + count:
            for item in items:
                barred[item] = barred.get(item, 0) | 1 << (number - done - 1)
    for item, number in problem.rules.position_of().items():
        if number > done:
            own = 1 << (number - done - 1)
            barred[item] = barred.get(item, 0) | (every & ~own)
    return barred


def _start(problem: PackingProblem, neighbours: Sequence[int], every: int, floor: int) -> tuple[int, dict[int, int]]:
    """A first plan: by recolouring, or with rules as many colours as the first dive of the search needs."""
    if not problem.rules.include and not problem.rules.exclude:
        recoloured = fewer_colours(neighbours, {item: item for item in bits(every)}, floor)
        return len(set(recoloured.values())), recoloured
    for count in range(max(1, problem.rules.last_expression), len(problem.items) + problem.rules.last_expression + 2):
        answer = colour_graph(neighbours, every, count, forbidden_colours(problem, 0, count), len(problem.items) + 1)
        if answer.colours is not None:
            return count, answer.colours
    raise InputError("rules: no plan fulfils them all")


def order_by_importance(problem: PackingProblem, fewest: Fewest, node_limit: int = NODE_LIMIT) -> list[PackedSet]:
    """Rearrange a smallest plan: the most important first expression that any plan of that size has, then the second, …

    Where two first expressions are equally important the solver's choice is kept. A step that cannot be decided
    within ``node_limit`` keeps the best expression known and is marked as not proven.

    Raises
    ------
    InputError
        The rules leave an expression empty.
    """
    neighbours = neighbour_sets(problem.conflicts)
    remaining = (1 << len(problem.items)) - 1
    incumbent = fewest.colours
    used: list[int] = []
    plan: list[PackedSet] = []
    for number in range(1, fewest.count + 1):
        step = _OrderStep(problem, neighbours, remaining, number, fewest.count, node_limit)
        part, incumbent = step.solve(used, incumbent, fewest.clique)
        if not part.items:
            raise InputError(f"rules: nothing is left for expression {number}, because the rest is kept for later")
        plan.append(part)
        used += part.items
        remaining &= ~sum(1 << item for item in part.items)
        if problem.largest_count is not None and len(plan) == problem.largest_count:
            break
    check_reached(problem, len(plan))
    return plan


@dataclass(frozen=True)
class _OrderStep:
    """Choose one expression so that the rest still fits into the expressions that are left."""

    problem: PackingProblem
    neighbours: Sequence[int]
    remaining: int
    number: int
    count: int
    node_limit: int

    def solve(
        self, used: Sequence[int], incumbent: dict[int, int], clique: Sequence[int]
    ) -> tuple[PackedSet, dict[int, int]]:
        """The expression, and a colouring (0, 1, …) of what it leaves."""
        after = self.count - self.number
        include = self.problem.rules.include.get(self.number, ())
        reserved = [item for item, place in self.problem.rules.position_of().items() if place > self.number]
        gone = [item for item in range(len(self.problem.items)) if not self.remaining >> item & 1]
        exclude = sorted({*gone, *reserved, *self.problem.rules.exclude.get(self.number, ())})
        weights = self.problem.weights(used)
        barred = forbidden_colours(self.problem, self.number, after)
        here = [item for item in clique if self.remaining >> item & 1]
        cuts: list[Sequence[int]] = [here] if len(here) > after else []
        proven, bound = True, float("inf")
        for _ in range(_CUTS):
            found = heaviest_set(weights, self.problem.rows, include=include, exclude=exclude, hit=cuts)
            bound = min(bound, found.bound)
            rest = self.remaining & ~sum(1 << item for item in found.items)
            answer = colour_graph(self.neighbours, rest, after, barred, self.node_limit)
            if answer.colours is not None:
                return PackedSet(found.items, found.value, bound, proven), answer.colours
            if not answer.decided:
                break
            cuts += self._cuts(rest, after, barred)
        return self._keep(incumbent, weights.tolist(), bound)

    def _cuts(self, rest: int, after: int, barred: dict[int, int]) -> list[Sequence[int]]:
        """Parts of the rest that cannot be coloured: one, and further ones apart from it while these are cliques."""
        part = uncolourable_part(self.neighbours, rest, after, barred)
        if not part:
            raise SolverError("plan: an uncolourable rest has no uncolourable part")
        cuts: list[Sequence[int]] = [part]
        free = rest & ~sum(1 << item for item in part)
        while free:
            clique = maximum_clique(self.neighbours, free, self.node_limit // 10)
            if len(clique.vertices) <= after:
                break
            cuts.append(clique.vertices)
            free &= ~sum(1 << item for item in clique.vertices)
        return cuts

    def _keep(
        self, incumbent: dict[int, int], weights: Sequence[float], bound: float
    ) -> tuple[PackedSet, dict[int, int]]:
        """Undecided: the class of the known plan that the rules allow here and that weighs most."""
        classes: dict[int, list[int]] = {}
        for item in bits(self.remaining):
            classes.setdefault(incumbent[item], []).append(item)
        ruled = bool(self.problem.rules.include or self.problem.rules.exclude)
        first = 0 if ruled else max(classes, key=lambda c: (sum(weights[item] for item in classes[c]), -c))
        chosen = classes.get(first, [])
        rest = {item: colour for item, colour in incumbent.items() if colour != first and self.remaining >> item & 1}
        moved = {item: colour - (colour > first) for item, colour in rest.items()}
        value = sum(weights[item] for item in chosen)
        return PackedSet(tuple(chosen), value, max(bound, value), False), moved
