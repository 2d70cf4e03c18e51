"""What a user asks of a plan: shapes left out, shapes never together, shapes that belong or do not belong in one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from capture_eval.errors import InputError
from capture_eval.planning.conflict_graph import Items

Booleans = NDArray[np.bool_]
Shapes = tuple[int, ...]


@dataclass(frozen=True)
class PackingRules:
    """Wishes in numbers of shapes.

    Attributes
    ----------
    left_out : tuple of int
        Shapes that are not captured at all; a symmetric partner is then planned on its own.
    never_together : tuple of tuples of int
        Of each group at most one shape stands in an expression.
    include, exclude : mapping from expression (1, 2, …) to tuple of int
        Shapes that an expression must and must not hold; excluded ones stay available for others.
    """

    left_out: Shapes = ()
    never_together: tuple[Shapes, ...] = ()
    include: Mapping[int, Shapes] = field(default_factory=dict)
    exclude: Mapping[int, Shapes] = field(default_factory=dict)


@dataclass(frozen=True)
class ItemRules:
    """The same wishes in numbers of items (contracted pairs), checked.

    Attributes
    ----------
    never_together : (M, I) bool
        Rows "at most one of these".
    include, exclude : mapping from expression to tuple of int
    """

    never_together: Booleans
    include: Mapping[int, Shapes]
    exclude: Mapping[int, Shapes]

    @property
    def last_expression(self) -> int:
        """Largest expression that must hold something; 0 without one."""
        return max((number for number, items in self.include.items() if items), default=0)

    def position_of(self) -> dict[int, int]:
        """Expression of every item that has a fixed one."""
        return {item: number for number, items in self.include.items() for item in items}


def check_rules(rules: PackingRules, names: Sequence[str]) -> None:
    """Refuse rules that cannot be meant.

    Raises
    ------
    InputError
        A shape that is not there, an expression below 1, a group of fewer than two shapes, or rules that contradict
        each other.
    """
    groups = [rules.left_out, *rules.never_together, *rules.include.values(), *rules.exclude.values()]
    for shape in (shape for group in groups for shape in group):
        if not 0 <= shape < len(names):
            raise InputError(f"rules: there is no shape {shape}, only 0 to {len(names) - 1}")
    for number in (*rules.include, *rules.exclude):
        if number < 1:
            raise InputError(f"rules: expression {number}: expressions are numbered from 1")
    for group in rules.never_together:
        if len(set(group)) < 2:
            raise InputError(f"rules: never together {[names[s] for s in group]}: name two or more different shapes")
    where: dict[int, int] = {}
    for number, shapes in sorted(rules.include.items()):
        for shape in shapes:
            if shape in rules.left_out:
                raise InputError(f"rules: {names[shape]} is left out and included in expression {number}")
            if where.setdefault(shape, number) != number:
                raise InputError(f"rules: {names[shape]} is included in the expressions {where[shape]} and {number}")
            if shape in rules.exclude.get(number, ()):
                raise InputError(f"rules: {names[shape]} is included in and excluded from expression {number}")


def drop_separated_pairs(
    pairs: Sequence[tuple[int, int]], rules: PackingRules, names: Sequence[str], given: bool
) -> tuple[tuple[int, int], ...]:
    """Remove found pairs that "never together" separates.

    Raises
    ------
    InputError
        The pair was given by the user, who then contradicts himself.
    """
    kept = []
    for first, second in pairs:
        if not any(first in group and second in group for group in rules.never_together):
            kept.append((first, second))
        elif given:
            raise InputError(f"rules: {names[first]} and {names[second]} are a given pair and never together")
    return tuple(kept)


def item_rules(rules: PackingRules, items: Items, conflicts: Booleans, names: Sequence[str]) -> ItemRules:
    """Rules of shapes as rules of items.

    Parameters
    ----------
    conflicts : (I, I) bool
        Of the shapes' vertices alone.

    Raises
    ------
    InputError
        An expression must hold shapes that overlap or are never together, or a chain of pairs joins shapes that are
        never together.
    """
    item_of = {shape: number for number, shapes in enumerate(items) for shape in shapes}
    rows = []
    for group in rules.never_together:
        members = [item_of[shape] for shape in dict.fromkeys(group) if shape in item_of]
        if len(set(members)) < len(members):
            raise InputError(f"rules: {[names[s] for s in group]} are never together, but symmetric pairs join them")
        rows.append(np.isin(np.arange(len(items)), members))
    apart = conflicts.copy()
    never = np.array(rows, dtype=np.bool_).reshape(len(rows), len(items))
    for row in never:
        apart |= np.outer(row, row)
    np.fill_diagonal(apart, False)
    include = {}
    for number, shapes in sorted(rules.include.items()):
        chosen = tuple(sorted({item_of[shape] for shape in shapes}))
        for first in chosen:
            for second in chosen:
                if first < second and apart[first, second]:
                    why = "overlap" if conflicts[first, second] else "are never together"
                    raise InputError(
                        f"rules: expression {number} must hold {_named(items[first], names)} and "
                        f"{_named(items[second], names)}, which {why}"
                    )
        include[number] = chosen
    exclude = {
        number: tuple(sorted({item_of[shape] for shape in shapes if shape in item_of}))
        for number, shapes in sorted(rules.exclude.items())
    }
    _check_partners(include, exclude, items, names)
    return ItemRules(never, include, exclude)


def _check_partners(
    include: Mapping[int, Shapes], exclude: Mapping[int, Shapes], items: Items, names: Sequence[str]
) -> None:
    where: dict[int, int] = {}
    for number, chosen in include.items():
        for item in chosen:
            if item in exclude.get(number, ()):
                raise InputError(
                    f"rules: expression {number} includes and excludes parts of the pair {_named(items[item], names)}"
                )
            if where.setdefault(item, number) != number:
                raise InputError(
                    f"rules: the pair {_named(items[item], names)} is included in the expressions {where[item]} and "
                    f"{number}"
                )


def _named(shapes: Sequence[int], names: Sequence[str]) -> str:
    return " + ".join(names[shape] for shape in shapes)
