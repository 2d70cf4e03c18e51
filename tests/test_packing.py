"""Expression packing: the case done by hand, brute force on small instances, proofs, rules, and bad input."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from synthetic_rigs import bump_rig, rig_of_heights, sheet, tiny_rig, tiny_target

from capture_eval.errors import InputError, SolverError
from capture_eval.planning.binary_shapes import binary_shapes
from capture_eval.planning.blendshape_rig import BlendshapeRig
from capture_eval.planning.conflict_graph import all_rows, constraint_rows, doubly_covered, item_coverage
from capture_eval.planning.graph_colouring import bits, colour_graph, maximum_clique, neighbour_sets
from capture_eval.planning.importance import shape_importance, triangle_stretch, uniqueness
from capture_eval.planning.independent_set import heaviest_set
from capture_eval.planning.packing_rules import PackingRules
from capture_eval.planning.planner import CapturePlan, PlanOptions, plan_captures


def _tiny(symmetry: bool, **options: object) -> CapturePlan:
    chosen = PlanOptions(symmetry="given" if symmetry else "none", **options)  # type: ignore[arg-type]
    return plan_captures(tiny_rig(), chosen, target=tiny_target(), pairs=[(4, 5)] if symmetry else [])


def _sets(plan: CapturePlan) -> list[set[int]]:
    return [set(expression.shapes) for expression in plan.expressions]


def _values(plan: CapturePlan) -> list[float]:
    return [expression.value for expression in plan.expressions]


def test_tiny_importances() -> None:
    rig = tiny_rig()
    active = binary_shapes(rig)
    assert active[4, 7]  # 0.3 of 1: equality is active
    found = shape_importance(rig, active, tiny_target())
    assert found.displacement == pytest.approx([0.475, 0.55 / 3, 0.275, 1.0, 0.35, 0.35], abs=1e-15)
    stretch = triangle_stretch(rig.neutral, tiny_target(), rig.triangles)
    # (c, c+1, c+6): one edge doubled, one kept; (c, c+6, c+5): the diagonal grows from sqrt 2 to sqrt 5, one doubled.
    assert stretch == pytest.approx(np.tile([1.0, np.sqrt(2.5)], 4), abs=1e-15)


@pytest.mark.parametrize(
    ("symmetry", "alpha", "sets", "values"),
    [
        (True, 1.0, [{0, 3, 4, 5}, {2}, {1}], [2.175, 0.275, 0.55 / 3]),
        (True, 0.5, [{0, 3, 4, 5}, {1}, {2}], [2.5875, 0.591667, 0.535404]),
        (False, 0.5, [{1, 3, 5}, {0, 2, 4}], [1.997904, 1.716667]),
    ],
)
def test_tiny_greedy(symmetry: bool, alpha: float, sets: list[set[int]], values: list[float]) -> None:
    plan = _tiny(symmetry, alpha=alpha)
    assert _sets(plan) == sets
    assert _values(plan) == pytest.approx(values, abs=5e-7)  # six digits are given
    for expression in plan.expressions:
        assert expression.bound == pytest.approx(expression.value, abs=1e-7)


def test_tiny_greedy_without_symmetry_has_a_tie() -> None:
    plan = _tiny(False, alpha=1.0)
    assert _values(plan) == pytest.approx([1.825, 0.625, 0.55 / 3], abs=1e-12)
    assert _sets(plan)[0] in ({0, 3, 4}, {0, 3, 5})
    assert _sets(plan)[0] | _sets(plan)[1] == {0, 2, 3, 4, 5}


def test_tiny_minimum() -> None:
    plan = _tiny(True, alpha=1.0, mode="minimum")
    assert _sets(plan) == [{0, 2, 4, 5}, {1, 3}]
    assert _values(plan) == pytest.approx([1.45, 1.0 + 0.55 / 3], abs=1e-12)
    assert plan.fewest
    assert plan.expressions[0].doubly_covered_vertices == 1  # v7, inside of the pair
    assert plan.expressions[-1].covered == pytest.approx(1.0)
    for symmetry, alpha in itertools.product((True, False), (0.5, 1.0)):
        plan = _tiny(symmetry, alpha=alpha, mode="minimum")
        assert (len(plan.expressions), plan.lower_bound, plan.full_count) == (2, 2, 2)
        assert len(plan.clique) == 2


def test_j_max_stops_and_says_what_is_left() -> None:
    plan = _tiny(True, alpha=1.0, largest_count=1)
    assert _sets(plan) == [{0, 3, 4, 5}]
    assert plan.uncaptured == (1, 2)
    assert plan.full_count is None
    assert plan.expressions[0].covered == pytest.approx(2.175 / (2.175 + 0.275 + 0.55 / 3))
    plan = _tiny(True, alpha=1.0, largest_count=1, mode="minimum")
    assert (len(plan.expressions), plan.full_count) == (1, 2)


def test_no_shapes_give_an_empty_plan() -> None:
    empty = BlendshapeRig((), np.zeros((3, 3)), np.zeros((0, 3, 3)), np.array([[0, 1, 2]]))
    for mode in ("greedy", "minimum"):
        assert plan_captures(empty, PlanOptions(mode=mode)).expressions == ()  # type: ignore[arg-type]


def test_no_importance_at_all_packs_by_number() -> None:
    # alpha = 0 and no target: every importance is 0, and rounds must still not come back empty.
    plan = plan_captures(tiny_rig(), PlanOptions(alpha=0.0, symmetry="none"))
    assert len(_sets(plan)[0]) == 3  # no four of the shapes are apart
    assert plan.uncaptured == ()


def _random_problem(seed: int, count: int, vertices: int) -> tuple[BlendshapeRig, np.ndarray]:
    random = np.random.default_rng(seed)
    neutral = random.normal(size=(vertices, 3))
    triangles = np.array([[v, (v + 1) % vertices, (v + 2) % vertices] for v in range(vertices)])
    heights = []
    for _ in range(count):
        chosen = random.choice(vertices, size=int(random.integers(1, max(2, vertices // 2))), replace=False)
        heights.append({int(v): float(random.uniform(0.2, 1.0)) for v in chosen})
    return rig_of_heights(neutral, triangles, tuple(heights)), neutral * random.uniform(0.5, 2.0, size=3)


def _independent(active: np.ndarray, shapes: Sequence[int]) -> bool:
    return bool(active[list(shapes)].sum(axis=0).max(initial=0) <= 1)


def _brute_force_best(active: np.ndarray, weights: np.ndarray, remaining: set[int]) -> float:
    subsets = itertools.chain.from_iterable(
        itertools.combinations(sorted(remaining), n) for n in range(1, len(remaining) + 1)
    )
    return max(float(weights[list(part)].sum()) for part in subsets if _independent(active, part))


def _partitions(shapes: list[int], count: int, active: np.ndarray) -> list[list[set[int]]]:
    if not shapes:
        return [[set() for _ in range(count)]]
    found = []
    for rest in _partitions(shapes[1:], count, active):
        seen_empty = False
        for number, part in enumerate(rest):
            if (not part and seen_empty) or not _independent(active, [*part, shapes[0]]):
                continue
            seen_empty = seen_empty or not part
            found.append([*rest[:number], part | {shapes[0]}, *rest[number + 1 :]])
    return found


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 7), st.integers(3, 9))
def test_greedy_rounds_are_the_best_there_are(seed: int, count: int, vertices: int) -> None:
    rig, target = _random_problem(seed, count, vertices)
    plan = plan_captures(rig, PlanOptions(symmetry="none"), target=target)
    weights = plan.importance.after((), range(count))
    remaining = set(range(count))
    for expression in plan.expressions:
        assert expression.value == pytest.approx(_brute_force_best(plan.active, weights, remaining), abs=1e-7)
        assert expression.bound <= expression.value + 1e-7
        assert _independent(plan.active, expression.shapes)  # on the vertices, not on reduced rows
        remaining -= set(expression.shapes)
    assert not remaining


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 7), st.integers(3, 9))
def test_minimum_is_the_fewest_and_its_order_is_the_best(seed: int, count: int, vertices: int) -> None:
    rig, target = _random_problem(seed, count, vertices)
    plan = plan_captures(rig, PlanOptions(symmetry="none", mode="minimum"), target=target)
    weights = plan.importance.after((), range(count))
    fewest = next(n for n in range(1, count + 1) if _partitions(list(range(count)), n, plan.active))
    assert len(plan.expressions) == plan.lower_bound == fewest
    best = max(
        sorted((float(weights[list(part)].sum()) for part in partition), reverse=True)
        for partition in _partitions(list(range(count)), fewest, plan.active)
    )
    # random weights have no ties, so the lexicographic best is unique
    assert _values(plan) == pytest.approx(best, abs=1e-7)
    for expression in plan.expressions:
        assert _independent(plan.active, expression.shapes)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 9), st.floats(0.1, 0.9), st.integers(1, 5))
def test_cliques_and_colourings_against_brute_force(seed: int, size: int, share: float, colours: int) -> None:
    random = np.random.default_rng(seed)
    joined = np.triu(random.random((size, size)) < share, 1)
    joined |= joined.T
    neighbours = neighbour_sets(joined)
    every = (1 << size) - 1
    largest = max(
        len(part)
        for n in range(1, size + 1)
        for part in itertools.combinations(range(size), n)
        if all(joined[a, b] for a, b in itertools.combinations(part, 2))
    )
    clique = maximum_clique(neighbours, every)
    assert clique.proven
    assert len(clique.vertices) == largest
    barred = {vertex: int(random.integers(0, 1 << colours)) for vertex in range(0, size, 2)}
    answer = colour_graph(neighbours, every, colours, barred)
    exists = any(
        all(not barred.get(v, 0) >> c & 1 for v, c in enumerate(choice))
        and all(choice[a] != choice[b] for a, b in itertools.combinations(range(size), 2) if joined[a, b])
        for choice in (itertools.product(range(colours), repeat=size) if colours**size < 50_000 else [])
    )
    if colours**size < 50_000:
        assert answer.decided
        assert (answer.colours is not None) == exists
    if answer.colours is not None:
        found = answer.colours
        assert sorted(found) == list(range(size))
        assert all(not barred.get(v, 0) >> c & 1 for v, c in found.items())
        assert all(found[a] != found[b] for a in range(size) for b in bits(neighbours[a]))


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10**6), st.integers(2, 12), st.integers(1, 300))
def test_reduced_rows_say_the_same(seed: int, count: int, vertices: int) -> None:
    random = np.random.default_rng(seed)
    coverage = random.random((count, vertices)) < random.uniform(0.05, 0.6)
    rows = constraint_rows(coverage)
    full = all_rows(coverage)
    assert rows.shared == len(full)
    for row in full:
        assert any(np.all(row <= other) for other in rows.maximal)
    for first, second in itertools.permutations(rows.maximal, 2):
        assert np.any(first & ~second)
    weights = random.uniform(0.1, 1.0, count)
    assert heaviest_set(weights, rows.maximal).value == pytest.approx(heaviest_set(weights, full).value, abs=1e-7)


def test_a_larger_rig_keeps_its_constraints_on_every_vertex() -> None:
    rig = bump_rig(41, 53, 20, 13, 3)
    for options in (PlanOptions(), PlanOptions(mode="minimum"), PlanOptions(symmetry="none", mode="minimum")):
        plan = plan_captures(rig, options, target=rig.neutral * [1.2, 0.9, 1.1])
        assert sorted(s for e in plan.expressions for s in e.shapes) == list(range(53))
        for expression in plan.expressions:
            groups = [group for group in plan.items if group[0] in expression.shapes]
            covered = sum(plan.active[list(group)].any(axis=0).astype(int) for group in groups)
            assert covered.max() == 1
            assert sorted(s for group in groups for s in group) == list(expression.shapes)
        assert len(plan.expressions) >= plan.lower_bound
        clique = [plan.active[list(group)].any(axis=0) for group in plan.clique]
        assert all(np.any(a & b) for a, b in itertools.combinations(clique, 2))
        covered = [expression.covered for expression in plan.expressions]
        assert np.all(np.diff(covered) >= 0)
        assert covered[-1] == pytest.approx(1.0)


def test_uniqueness_of_the_first_round_is_zero_and_later_prefers_the_unlike() -> None:
    similarity = np.array([[1.0, 0.8, 0.0], [0.8, 1.0, 0.4], [0.0, 0.4, 1.0]])
    assert uniqueness(similarity, (), (0, 1, 2)).tolist() == [0.0, 0.0, 0.0]
    assert uniqueness(similarity, (0,), (1, 2)).tolist() == [0.0, 0.0, 1.0]
    assert uniqueness(similarity, (0, 2), (1,)).tolist() == [0.0, 0.0, 0.0]
    plan = plan_captures(tiny_rig(), PlanOptions(beta=0.5, symmetry="none"), target=tiny_target())
    assert plan.uncaptured == ()


def test_shape_stretch_of_scale_can_be_removed() -> None:
    vertices, triangles = sheet(9, 11)
    assert triangle_stretch(vertices, 1.7 * vertices, triangles) == pytest.approx(1.4)  # 2 (1.7 - 1)
    assert triangle_stretch(vertices, 1.7 * vertices, triangles, remove_scale=True) == pytest.approx(0.0, abs=1e-12)


# --- rules ---


def test_left_out_shapes_are_not_captured_and_free_their_partner() -> None:
    plan = plan_captures(
        tiny_rig(), PlanOptions(alpha=1.0, symmetry="given"), pairs=[(4, 5)], rules=PackingRules(left_out=(5, 3))
    )
    assert plan.uncaptured == (3, 5)
    assert plan.pairs == ()
    assert any(4 in part for part in _sets(plan))


@pytest.mark.parametrize("mode", ["greedy", "minimum"])
def test_never_together(mode: str) -> None:
    rules = PackingRules(never_together=((0, 3, 5),))
    plan = plan_captures(tiny_rig(), PlanOptions(alpha=1.0, symmetry="none", mode=mode), rules=rules)  # type: ignore[arg-type]
    assert all(len(part & {0, 3, 5}) <= 1 for part in _sets(plan))
    assert len(plan.expressions) == 3
    assert plan.lower_bound == 3
    assert plan.uncaptured == ()


@pytest.mark.parametrize("mode", ["greedy", "minimum"])
def test_include_and_exclude_are_solved_exactly(mode: str) -> None:
    rules = PackingRules(include={1: (1,), 2: (3,)}, exclude={1: (5,)})
    plan = plan_captures(tiny_rig(), PlanOptions(alpha=1.0, symmetry="none", mode=mode), rules=rules)  # type: ignore[arg-type]
    # with 1: not 0, 2, 4; 5 is barred and 3 is kept for the second
    assert _sets(plan)[0] == {1}
    assert _values(plan)[0] == pytest.approx(0.55 / 3)
    assert 3 in _sets(plan)[1]
    if mode == "minimum":
        # 2 and 3 overlap, so {1}, {3, ...}, {2, ...} is the fewest
        assert len(plan.expressions) == 3
        assert _sets(plan)[1] in ({0, 3, 4}, {0, 3, 5})


def test_a_found_pair_gives_way_to_never_together_and_to_the_users_pairs() -> None:
    rig = bump_rig(21, 31, 3, 1, 0)
    assert plan_captures(rig).pairs == ((0, 1), (2, 3), (4, 5))
    plan = plan_captures(rig, rules=PackingRules(never_together=((0, 1),)))
    assert plan.pairs == ((2, 3), (4, 5))
    assert not any({0, 1} <= part for part in _sets(plan))
    assert plan_captures(rig, pairs=[(0, 3)]).pairs == ((0, 3), (4, 5))


def test_a_vertex_mask_does_not_count() -> None:
    rig = tiny_rig()
    ignored = np.zeros(10, dtype=np.bool_)
    ignored[0] = True
    active = binary_shapes(rig, ignored=ignored)
    assert not active[:, 0].any()
    assert active[0].nonzero()[0].tolist() == [1]  # 0.2 < 0.3 * 0.9
    everything = plan_captures(rig, PlanOptions(symmetry="none"), ignored=ignored)
    assert everything.uncaptured == ()


# --- bad input (each names the culprit) ---


def _shapes(**changes: object) -> BlendshapeRig:
    rig = tiny_rig()
    fields = {"names": rig.names, "neutral": rig.neutral, "shapes": rig.shapes, "triangles": rig.triangles}
    return BlendshapeRig(**(fields | changes))  # type: ignore[arg-type]


def test_bad_rigs() -> None:
    rig = tiny_rig()
    with pytest.raises(ValueError, match=r"shapes \(6, 9, 3\) do not fit a neutral \(10, 3\)"):
        _shapes(shapes=rig.shapes[:, :9])
    broken = rig.shapes.copy()
    broken[2, 4, 1] = np.nan
    with pytest.raises(ValueError, match="shape_2 holds numbers that are not finite"):
        _shapes(shapes=broken)
    with pytest.raises(ValueError, match="neutral holds numbers that are not finite"):
        _shapes(neutral=np.where(np.arange(10)[:, None] == 3, np.inf, rig.neutral))
    with pytest.raises(ValueError, match=r"triangle 1 \[0, 6, 10\] is outside the 10 vertices"):
        _shapes(triangles=np.array([[0, 1, 6], [0, 6, 10]]))
    with pytest.raises(ValueError, match="5 names for 6 shapes"):
        _shapes(names=rig.names[:5])
    with pytest.raises(ValueError, match="two shapes are called a"):
        _shapes(names=("a", "a", "b", "c", "d", "e"))
    still = rig.shapes.copy()
    still[3] = rig.neutral
    with pytest.raises(ValueError, match="shape shape_3 is equal to the neutral"):
        plan_captures(_shapes(shapes=still))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"threshold": 0.0}, "threshold 0.0"),
        ({"threshold": 1.01}, "threshold 1.01"),
        ({"threshold": float("nan")}, "threshold nan"),
        ({"alpha": -0.1}, "alpha -0.1"),
        ({"alpha": 1.1}, "alpha 1.1"),
        ({"beta": -1.0}, "beta -1.0"),
        ({"largest_count": 0}, "largest number of expressions 0"),
        ({"mode": "fast"}, "mode 'fast'"),
        ({"symmetry": "some"}, "symmetry 'some'"),
    ],
)
def test_bad_options(options: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        plan_captures(tiny_rig(), PlanOptions(**({"symmetry": "none"} | options)))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("pairs", "message"),
    [
        ([(0, 6)], "there is no shape 6"),
        ([(-1, 2)], "there is no shape -1"),
        ([(2, 2)], "cannot be paired with itself"),
        ([(0, 1), (1, 0)], "is given twice"),
        ([(0, 1, 2)], "a pair has two shapes"),
    ],
)
def test_bad_pairs(pairs: list[tuple[int, ...]], message: str) -> None:
    with pytest.raises(InputError, match=message):
        plan_captures(tiny_rig(), PlanOptions(symmetry="given"), pairs=pairs)


@pytest.mark.parametrize(
    ("rules", "message"),
    [
        (PackingRules(include={1: (0, 1)}), "must hold shape_0 and shape_1, which overlap"),
        (PackingRules(include={1: (0, 3)}, never_together=((0, 3),)), "which are never together"),
        (PackingRules(include={1: (9,)}), "there is no shape 9"),
        (PackingRules(include={0: (1,)}), "numbered from 1"),
        (PackingRules(include={1: (1,), 2: (1,)}), "included in the expressions 1 and 2"),
        (PackingRules(include={1: (1,)}, exclude={1: (1,)}), "included in and excluded from"),
        (PackingRules(include={1: (1,)}, left_out=(1,)), "is left out and included"),
        (PackingRules(never_together=((1, 1),)), "two or more different shapes"),
        (PackingRules(never_together=((4, 5),)), "a given pair and never together"),
        (PackingRules(include={1: (4,), 2: (5,)}), "pair shape_4 [+] shape_5 is included in the expressions 1 and 2"),
        (PackingRules(include={1: (4,)}, exclude={1: (5,)}), "includes and excludes parts of the pair"),
        (PackingRules(include={9: (0,)}), "expression"),
        (PackingRules(exclude={1: (0, 1, 2, 3, 4)}), "nothing is left for expression 1"),
    ],
)
@pytest.mark.parametrize("mode", ["greedy", "minimum"])
def test_bad_rules(rules: PackingRules, message: str, mode: str) -> None:
    options = PlanOptions(symmetry="given", mode=mode)  # type: ignore[arg-type]
    with pytest.raises(InputError, match=message):
        plan_captures(tiny_rig(), options, pairs=[(4, 5)], rules=rules)


def test_bad_targets_and_masks() -> None:
    rig = tiny_rig()
    with pytest.raises(InputError, match=r"target neutral \(9, 3\) does not fit"):
        plan_captures(rig, target=rig.neutral[:9])
    with pytest.raises(InputError, match="target neutral holds numbers that are not finite"):
        plan_captures(rig, target=np.full((10, 3), np.nan))
    folded = tiny_target()
    folded[1] = folded[0]
    with pytest.raises(InputError, match="edge 1-0 has no length in the target only"):
        plan_captures(rig, PlanOptions(symmetry="none"), target=folded)
    with pytest.raises(InputError, match=r"vertex mask \(4,\) does not fit 10 vertices"):
        plan_captures(rig, ignored=np.zeros(4, dtype=np.bool_))
    ignored = np.isin(np.arange(10), [3, 4])
    with pytest.raises(InputError, match="shape shape_3 is equal to the neutral outside the masked vertices"):
        plan_captures(rig, ignored=ignored)


def test_an_edge_without_length_in_both_meshes_has_the_ratio_one() -> None:
    template = np.array([[0.0, 0, 0], [0, 0, 0], [1, 0, 0]])
    assert triangle_stretch(template, 3.0 * template, np.array([[0, 1, 2]])) == pytest.approx([2.0])


def test_a_plan_that_breaks_a_constraint_is_refused() -> None:
    active = np.array([[True, True, False], [False, True, True], [False, False, True]])
    assert doubly_covered(active, ((0,), (1,), (2,)), (0, 2)) == 0
    assert doubly_covered(active, ((0, 1), (2,)), (0, 1)) == 1
    with pytest.raises(SolverError, match="vertex 1 is moved by"):
        doubly_covered(active, ((0,), (1,), (2,)), (0, 1))
    with pytest.raises(SolverError, match="torn apart"):
        doubly_covered(active, ((0, 1), (2,)), (0,))
    with pytest.raises(SolverError, match="no set of shapes fulfils"):
        heaviest_set(np.ones(2), np.ones((1, 2), dtype=np.bool_), include=(0, 1))
    assert item_coverage(active, ((0, 2), (1,))).sum() == 5


# --- pairs ---


@pytest.mark.parametrize("unit", [0.001, 1.0, 1000.0])
def test_pairs_do_not_depend_on_the_unit(unit: float) -> None:
    rig = bump_rig(41, 53, 20, 13, 1)
    scaled = BlendshapeRig(rig.names, unit * rig.neutral, unit * rig.shapes, rig.triangles)
    plan = plan_captures(scaled)
    assert plan.pairs == tuple((k, k + 1) for k in range(0, 40, 2))
    assert plan.found is not None
    assert plan.found.self_symmetric == tuple(range(40, 53))
    assert max(plan.found.misfits) < 1e-9  # mirrored exactly; differences of squares round
    step = np.array([0.3, 0.0, 0.0])
    moved = BlendshapeRig(rig.names, rig.neutral + step, rig.shapes + step, rig.triangles)
    assert plan_captures(moved).pairs == plan.pairs


def test_a_rig_without_a_mirror_image_says_what_to_do() -> None:
    rig = bump_rig(21, 31, 3, 1, 0)
    bent = rig.neutral + np.random.default_rng(0).normal(size=rig.neutral.shape) * 0.05
    with pytest.raises(InputError, match="have a mirror image in x"):
        plan_captures(BlendshapeRig(rig.names, bent, rig.shapes, rig.triangles))
