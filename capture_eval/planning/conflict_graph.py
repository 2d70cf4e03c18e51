"""What cannot stand in one expression: pairs contracted to items, constraint rows, and the graph of conflicts.

Carrigan et al. clear shared bits in one member of a pair; here a pair (or a chain of pairs) is one item that covers
the union of its members' vertices, which is exact and needs no special case.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capture_eval.errors import SolverError

Floats = NDArray[np.float64]
Booleans = NDArray[np.bool_]
Items = tuple[tuple[int, ...], ...]
_BLOCK = 512


@dataclass(frozen=True)
class ConstraintRows:
    """Constraints "at most one of these items".

    Attributes
    ----------
    maximal : (R, I) bool
        The rows that imply all others, no two of them nested, the largest first.
    vertices, shared, distinct : int
        Rows of the original programme, those with two or more items, and the different ones among these.
    """

    maximal: Booleans
    vertices: int
    shared: int
    distinct: int

    def conflicts(self) -> Booleans:
        """Items that cannot stand together, (I, I), symmetric, False on the diagonal."""
        numbers = self.maximal.astype(np.float32)
        result = (numbers.T @ numbers) > 0
        np.fill_diagonal(result, False)
        return np.asarray(result, dtype=np.bool_)


def contract_pairs(shape_count: int, pairs: Sequence[Sequence[int]], left_out: Sequence[int] = ()) -> Items:
    """Groups of shapes that are only used together, ascending; a shape without a partner is a group of its own."""
    group = list(range(shape_count))
    for first, second in pairs:
        low, high = sorted((group[first], group[second]))
        group = [low if number == high else number for number in group]
    members: dict[int, list[int]] = {}
    for shape, number in enumerate(group):
        if shape not in left_out:
            members.setdefault(number, []).append(shape)
    return tuple(tuple(shapes) for shapes in members.values())


def item_coverage(active: Booleans, items: Items) -> Booleans:
    """Vertices that an item moves strongly, (I, N): the union over its shapes."""
    coverage = np.zeros((len(items), active.shape[1]), dtype=np.bool_)
    for row, shapes in enumerate(items):
        coverage[row] = active[list(shapes)].any(axis=0)
    return coverage


def constraint_rows(coverage: Booleans, never_together: Booleans | None = None) -> ConstraintRows:
    """Reduce one row per vertex to the maximal rows.

    Rows of fewer than two items say nothing, equal rows say the same, and a row whose items are among another's is
    implied by it.

    Parameters
    ----------
    coverage : (I, N) bool
    never_together : (M, I) bool, optional
        Further rows "at most one of these".
    """
    rows = coverage.T
    shared = rows[coverage.sum(axis=0) >= 2]
    count = len(shared)
    if never_together is not None and len(never_together):
        shared = np.concatenate([shared, never_together])
    distinct = _distinct(shared)
    return ConstraintRows(_maximal(distinct), len(rows), count, len(distinct))


def all_rows(coverage: Booleans) -> Booleans:
    """The rows with two or more items, unreduced, (R, I): for measuring what the reduction saves."""
    return np.ascontiguousarray(coverage.T[coverage.sum(axis=0) >= 2])


def _distinct(rows: Booleans) -> Booleans:
    if not rows.size:
        return np.zeros((0, rows.shape[1]), dtype=np.bool_)
    packed = np.ascontiguousarray(np.packbits(rows, axis=1))
    keys = packed.view(np.dtype((np.void, packed.shape[1]))).ravel()
    _, first = np.unique(keys, return_index=True)
    return np.asarray(rows[np.sort(first)], dtype=np.bool_)


def _maximal(rows: Booleans) -> Booleans:
    """Rows that are not contained in another; all rows are different."""
    size = rows.sum(axis=1)
    order = np.argsort(-size, kind="stable")
    rows, size = rows[order], size[order]
    kept = np.zeros((0, rows.shape[1]), dtype=np.float32)
    for start in range(0, len(rows), _BLOCK):
        block, own = rows[start : start + _BLOCK].astype(np.float32), size[start : start + _BLOCK]
        free = ~np.any(block @ kept.T == own[:, None], axis=1) if len(kept) else np.ones(len(block), dtype=np.bool_)
        block, own = block[free], own[free]
        inside = block @ block.T == own[:, None]
        np.fill_diagonal(inside, False)
        kept = np.concatenate([kept, block[~inside.any(axis=1)]])
    return kept > 0


def doubly_covered(active: Booleans, items: Items, expression: Sequence[int]) -> int:
    """Check one expression on the original vertices.

    Parameters
    ----------
    active : (K, N) bool
        Binary shapes, nothing contracted or reduced.
    items : groups of shapes
    expression : sequence of int
        Shapes of the expression.

    Returns
    -------
    int
        Vertices that two shapes of the same group move strongly (allowed).

    Raises
    ------
    SolverError
        Shapes of two groups share a vertex, or a group is torn: the plan would be wrong.
    """
    chosen = set(expression)
    owner = np.full(active.shape[1], -1, dtype=np.int64)
    twice = 0
    for number, shapes in enumerate(items):
        if not chosen & set(shapes):
            continue
        if not set(shapes) <= chosen:
            raise SolverError(f"plan: the symmetric shapes {list(shapes)} were torn apart in {sorted(chosen)}")
        count = active[list(shapes)].sum(axis=0)
        if np.any((count > 0) & (owner >= 0)):
            vertex = int(np.argmax((count > 0) & (owner >= 0)))
            raise SolverError(
                f"plan: vertex {vertex} is moved by {items[int(owner[vertex])]} and {shapes} in one expression"
            )
        owner[count > 0] = number
        twice += int((count > 1).sum())
    return twice
