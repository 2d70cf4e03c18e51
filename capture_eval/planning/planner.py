"""From a rig to a plan: binary shapes, pairs, importance, rows, rounds, and the check of the result."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from capture_eval.errors import InputError
from capture_eval.planning.binary_shapes import binary_shapes
from capture_eval.planning.blendshape_rig import BlendshapeRig
from capture_eval.planning.conflict_graph import (
    ConstraintRows,
    Items,
    constraint_rows,
    contract_pairs,
    doubly_covered,
    item_coverage,
)
from capture_eval.planning.importance import Importance, shape_importance
from capture_eval.planning.minimum_packing import (
    bound_of_fewest,
    fewest_expressions,
    order_by_importance,
)
from capture_eval.planning.packing import PackedSet, PackingProblem, pack_greedily
from capture_eval.planning.packing_rules import PackingRules, check_rules, drop_separated_pairs, item_rules
from capture_eval.planning.symmetry_pairs import FoundPairs, Pair, check_pairs, find_pairs, merge_pairs

Floats = NDArray[np.float64]
Booleans = NDArray[np.bool_]
Mode = Literal["greedy", "minimum"]
Symmetry = Literal["detect", "given", "none"]
MODES: tuple[Mode, ...] = ("greedy", "minimum")


@dataclass(frozen=True)
class PlanOptions:
    """How a capture is planned.

    Attributes
    ----------
    mode : "greedy" or "minimum"
        The most important expression in every round, or the fewest expressions and then the most important ones.
    threshold, alpha, beta : float
        Of binary shapes (Eq 2) and importance (Eq 4).
    largest_count : int or None
        J_max: make only the first so many expressions.
    symmetry : "detect", "given" or "none"
        Find pairs (those given come first), take only those given, or none.
    unit_weights : bool
        Every shape is equally important.
    remove_scale : bool
        See `triangle_stretch`; not in the paper.
    """

    mode: Mode = "greedy"
    threshold: float = 0.3
    alpha: float = 0.5
    beta: float = 0.0
    largest_count: int | None = None
    symmetry: Symmetry = "detect"
    unit_weights: bool = False
    remove_scale: bool = False

    def __post_init__(self) -> None:
        if self.mode not in MODES:
            raise InputError(f"mode {self.mode!r}: use greedy or minimum")
        if self.symmetry not in ("detect", "given", "none"):
            raise InputError(f"symmetry {self.symmetry!r}: use detect, given or none")
        if self.largest_count is not None and self.largest_count < 1:
            raise InputError(f"largest number of expressions {self.largest_count}: must be 1 or more")


@dataclass(frozen=True)
class PlannedExpression:
    """An expression to capture: every one of its shapes at weight 1.

    Attributes
    ----------
    shapes : tuple of int
    value, bound : float
        Sum of the importances in its round, and the proven bound under the rules of the mode.
    proven : bool
    covered : float
        Share of the total importance of the rig that is covered once this and all earlier ones are captured, in [0, 1].
    doubly_covered_vertices : int
        Vertices that both shapes of a symmetric pair move strongly.
    """

    shapes: tuple[int, ...]
    value: float
    bound: float
    proven: bool
    covered: float
    doubly_covered_vertices: int


@dataclass(frozen=True)
class CapturePlan:
    """A plan and its proofs.

    Attributes
    ----------
    expressions : tuple of PlannedExpression
        In the order of capture.
    full_count : int or None
        Expressions that capture all shapes; None if the rounds were stopped before.
    lower_bound : int
        Proven: no plan of all shapes has fewer expressions.
    clique : tuple of tuples of int
        Groups of shapes that all overlap each other.
    pairs : tuple of pairs of shapes
    found : FoundPairs or None
        Result of the search for pairs.
    importance : Importance
    active : (K, N) bool
    items : groups of shapes that are used together
    rows : ConstraintRows
    uncaptured : tuple of int
        Shapes in no expression: left out, or beyond the largest number of expressions.
    """

    expressions: tuple[PlannedExpression, ...]
    full_count: int | None
    lower_bound: int
    clique: tuple[tuple[int, ...], ...]
    pairs: tuple[Pair, ...]
    found: FoundPairs | None
    importance: Importance
    active: Booleans
    items: Items
    rows: ConstraintRows
    uncaptured: tuple[int, ...]

    @property
    def fewest(self) -> bool:
        """Whether it is proven that all shapes cannot be captured in fewer expressions."""
        return self.full_count is not None and self.full_count == self.lower_bound


@dataclass(frozen=True)
class PreparedRig:
    """All that is known before the packing."""

    active: Booleans
    pairs: tuple[Pair, ...]
    found: FoundPairs | None
    importance: Importance


def plan_captures(
    rig: BlendshapeRig,
    options: PlanOptions | None = None,
    *,
    target: ArrayLike | None = None,
    pairs: Sequence[Sequence[int]] = (),
    rules: PackingRules | None = None,
    ignored: Booleans | None = None,
) -> CapturePlan:
    """Plan which combined expressions to capture (Carrigan et al. 2020).

    Parameters
    ----------
    rig : BlendshapeRig
    options : PlanOptions
    target : (N, 3), optional
        Neutral of the person to be captured, same vertices.
    pairs : sequence of (int, int)
        Symmetric shapes that are only used together.
    rules : PackingRules
    ignored : (N,) bool, optional
        Vertices that do not count.

    Raises
    ------
    InputError
        Bad input; the text names the culprit.
    SolverError
        An optimum could not be proven, or the finished plan broke a constraint on the original vertices.
    """
    options, rules = options or PlanOptions(), rules or PackingRules()
    prepared = prepare_rig(rig, options, target, pairs, rules, ignored)
    return pack_prepared(rig, prepared, options, rules)


def prepare_rig(
    rig: BlendshapeRig,
    options: PlanOptions,
    target: ArrayLike | None,
    pairs: Sequence[Sequence[int]],
    rules: PackingRules,
    ignored: Booleans | None,
) -> PreparedRig:
    """Binary shapes, pairs and importance."""
    check_rules(rules, rig.names)
    given = drop_separated_pairs(check_pairs(pairs, rig.names), rules, rig.names, given=True)
    if given and options.symmetry == "none":
        raise InputError("pairs are given, but symmetry is 'none'")
    active = binary_shapes(rig, options.threshold, ignored)
    importance = shape_importance(rig, active, target, options.alpha, options.beta, options.remove_scale)
    found = None
    if options.symmetry == "detect" and rig.shape_count > 1:
        found = find_pairs(rig, active)
        apart = drop_separated_pairs(found.pairs, rules, rig.names, given=False)
        given = merge_pairs(given, apart)
    return PreparedRig(active, given, found, importance)


def pack_prepared(rig: BlendshapeRig, prepared: PreparedRig, options: PlanOptions, rules: PackingRules) -> CapturePlan:
    """Rows, rounds, and the check on the original vertices."""
    pairs = tuple(pair for pair in prepared.pairs if not set(pair) & set(rules.left_out))
    items = contract_pairs(rig.shape_count, pairs, rules.left_out)
    coverage = item_coverage(prepared.active, items)
    rows = constraint_rows(coverage)
    wishes = item_rules(rules, items, rows.conflicts(), rig.names)
    if len(wishes.never_together):
        rows = constraint_rows(coverage, wishes.never_together)
    equal = Importance(np.ones(rig.shape_count), np.zeros(rig.shape_count), None, 1.0, 0.0)
    weighed = equal if options.unit_weights else prepared.importance
    problem = PackingProblem(items, rows.maximal, rows.conflicts(), wishes, weighed.after, options.largest_count)
    packed, full_count, lower_bound, clique = _pack(problem, options.mode)
    expressions = _expressions(packed, problem, weighed, prepared.active)
    used = {shape for expression in expressions for shape in expression.shapes}
    return CapturePlan(
        expressions=expressions,
        full_count=full_count,
        lower_bound=lower_bound,
        clique=tuple(items[item] for item in clique),
        pairs=pairs,
        found=prepared.found,
        importance=weighed,
        active=prepared.active,
        items=items,
        rows=rows,
        uncaptured=tuple(shape for shape in range(rig.shape_count) if shape not in used),
    )


def _pack(problem: PackingProblem, mode: Mode) -> tuple[list[PackedSet], int | None, int, tuple[int, ...]]:
    """Expressions, how many the whole rig needs (None if unknown), the proven bound of that, and its clique."""
    if mode == "minimum":
        fewest = fewest_expressions(problem)
        return order_by_importance(problem, fewest), fewest.count, fewest.lower_bound, fewest.clique
    rounds = pack_greedily(problem)
    complete = sum(len(part.items) for part in rounds) == len(problem.items)
    clique = bound_of_fewest(problem).vertices
    return rounds, len(rounds) if complete else None, len(clique), clique


def _expressions(
    packed: Sequence[PackedSet], problem: PackingProblem, importance: Importance, active: Booleans
) -> tuple[PlannedExpression, ...]:
    """Shapes and covered importance; every expression is checked on the original vertices."""
    everything = [shape for shapes in problem.items for shape in shapes]
    alone = importance.after((), everything)
    total = float(alone[everything].sum()) if everything else 0.0
    expressions = []
    covered = 0.0
    captured = 0
    for part in packed:
        shapes = tuple(sorted(shape for item in part.items for shape in problem.items[item]))
        twice = doubly_covered(active, problem.items, shapes)
        covered += float(alone[list(shapes)].sum())
        captured += len(shapes)
        share = covered / total if total > 0.0 else captured / len(everything)
        expressions.append(PlannedExpression(shapes, part.value, part.bound, part.proven, min(share, 1.0), twice))
    return tuple(expressions)
