"""Expression packing in rounds, each proven optimal (Carrigan et al. 2020, Algorithm 1)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capture_eval.errors import InputError
from capture_eval.planning.conflict_graph import Items
from capture_eval.planning.independent_set import heaviest_set
from capture_eval.planning.packing_rules import ItemRules

Floats = NDArray[np.float64]
Booleans = NDArray[np.bool_]


@dataclass(frozen=True)
class PackedSet:
    """Items of one expression.

    Attributes
    ----------
    items : tuple of int
    value, bound : float
        Sum of importances at its round, and its proven upper bound under the rules of the mode.
    proven : bool
        Whether the value is proven to be the best.
    """

    items: tuple[int, ...]
    value: float
    bound: float
    proven: bool = True


@dataclass(frozen=True)
class PackingProblem:
    """What both modes solve.

    Attributes
    ----------
    items : groups of shapes
    rows : (R, I) bool
        Maximal rows, those of "never together" included.
    conflicts : (I, I) bool
        The graph of these rows.
    rules : ItemRules
    importance : function (used shapes, remaining shapes) -> (K,)
        Of the shapes, possibly different in every round.
    largest_count : int or None
        J_max.
    """

    items: Items
    rows: Booleans
    conflicts: Booleans
    rules: ItemRules
    importance: Callable[[Sequence[int], Sequence[int]], Floats]
    largest_count: int | None = None

    def __post_init__(self) -> None:
        if self.largest_count is not None and self.largest_count < 1:
            raise InputError(f"largest number of expressions {self.largest_count}: must be 1 or more")

    def weights(self, used_items: Sequence[int]) -> Floats:
        """Importance of every item (I,) after some were used."""
        used = [shape for item in used_items for shape in self.items[item]]
        done = set(used_items)
        remaining = [shape for item, shapes in enumerate(self.items) if item not in done for shape in shapes]
        importance = self.importance(used, remaining)
        return np.array([importance[list(shapes)].sum() for shapes in self.items], dtype=np.float64)


def pack_greedily(problem: PackingProblem) -> list[PackedSet]:
    """Take the heaviest set again and again until nothing is left or J_max rounds were made.

    Every round is an exact 0/1 programme; the number of rounds need not be the smallest possible
    (see `minimum_packing`).

    Raises
    ------
    InputError
        The rules leave a round empty, or name an expression that is never reached.
    SolverError
        A round was not proven optimal.
    """
    remaining = set(range(len(problem.items)))
    reserved = problem.rules.position_of()
    rounds: list[PackedSet] = []
    used: list[int] = []
    while remaining and (problem.largest_count is None or len(rounds) < problem.largest_count):
        number = len(rounds) + 1
        gone = set(range(len(problem.items))) - remaining
        later = {item for item, place in reserved.items() if place > number}
        exclude = gone | later | set(problem.rules.exclude.get(number, ()))
        if remaining <= exclude:
            raise InputError(
                f"rules: nothing is left for expression {number}: the rest is excluded from it or kept for later"
            )
        weights = problem.weights(used)
        chosen = heaviest_set(
            weights, problem.rows, include=problem.rules.include.get(number, ()), exclude=sorted(exclude)
        )
        rounds.append(PackedSet(chosen.items, chosen.value, chosen.bound))
        used += chosen.items
        remaining -= set(chosen.items)
    check_reached(problem, len(rounds))
    return rounds


def check_reached(problem: PackingProblem, count: int) -> None:
    """Refuse a plan that ends before an expression that must hold something.

    Raises
    ------
    InputError
        With the numbers of both.
    """
    wanted = problem.rules.last_expression
    if wanted > count:
        raise InputError(f"rules: expression {wanted} must hold something, but the plan has only {count}")
