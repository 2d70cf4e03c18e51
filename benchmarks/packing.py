"""Expression packing: counts, bounds and times, what the reduction of rows saves, and what a plan is worth.

Synthetic rigs are made here. Give the folder of MakeHuman's upstream files to add a rig of real pose units and the
value of plans: ``python benchmarks/packing.py [--makehuman FOLDER [--expressions FILE.npz]]``. Times are CPU seconds of
one process, each with the work it belongs to; run it with one thread (OMP_NUM_THREADS=1).
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeVar

import numpy as np

from capture_eval.files.atomic import read_npz
from capture_eval.files.makehuman_files import read_makehuman_texts
from capture_eval.images.makehuman_assets import REQUIRED_FILES, MakeHumanAssets, parse_assets
from capture_eval.images.makehuman_expressions import pose_unit_shapes
from capture_eval.planning.blendshape_rig import BlendshapeRig
from capture_eval.planning.conflict_graph import all_rows, constraint_rows, contract_pairs, item_coverage
from capture_eval.planning.deformation_transfer import TransferSolver
from capture_eval.planning.independent_set import heaviest_set
from capture_eval.planning.packing_rules import PackingRules
from capture_eval.planning.plan_value import generic_errors, measure_plan, plan_by_weights
from capture_eval.planning.planner import MODES, PlanOptions, PreparedRig, Symmetry, pack_prepared, prepare_rig

Result = TypeVar("Result")
SYMMETRIES: tuple[Symmetry, ...] = ("detect", "none")
RANDOM_PLANS = 5


def timed(work: Callable[[], Result]) -> tuple[Result, float]:
    """A result and the CPU seconds it took."""
    start = time.process_time()
    return work(), time.process_time() - start


def synthetic_rig(
    columns: int, rows: int, pairs: int, middles: int, seed: int, radii: tuple[float, float] = (0.15, 0.5)
) -> BlendshapeRig:
    """A sheet like a face with Gaussian bumps: mirrored pairs, and shapes on the middle line."""
    x, y = np.meshgrid(np.linspace(-1.0, 1.0, columns), np.linspace(-1.3, 1.3, rows))
    neutral = np.stack([x.ravel(), y.ravel(), (0.6 * np.sqrt(2.8 - x**2 - y**2)).ravel()], axis=1)
    index = np.arange(columns * rows).reshape(rows, columns)
    a, b, c, d = index[:-1, :-1].ravel(), index[:-1, 1:].ravel(), index[1:, 1:].ravel(), index[1:, :-1].ravel()
    triangles = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    random = np.random.default_rng(seed)
    shapes, names = [], []

    def add(name: str, centre: np.ndarray, radius: float, direction: np.ndarray) -> None:
        distance = ((neutral[:, :2] - centre) ** 2).sum(axis=1)
        shapes.append(neutral + np.exp(-distance / radius**2)[:, None] * direction)
        names.append(name)

    for number in range(pairs):
        centre, radius = random.uniform([0.15, -1.0], [0.8, 1.0]), random.uniform(*radii)
        direction = random.normal(size=3) * random.uniform(0.02, 0.1)
        add(f"side{number:03d}_L", centre, radius, direction)
        add(f"side{number:03d}_R", centre * [-1.0, 1.0], radius, direction * [-1.0, 1.0, 1.0])
    for number in range(middles):
        direction = random.normal(size=3) * random.uniform(0.02, 0.1) * [0.0, 1.0, 1.0]
        add(f"middle{number:03d}", np.array([0.0, random.uniform(-1.0, 1.0)]), random.uniform(*radii), direction)
    return BlendshapeRig(tuple(names), neutral, np.array(shapes), triangles)


def fresh(rig: BlendshapeRig) -> BlendshapeRig:
    """The same rig without anything computed yet."""
    return BlendshapeRig(rig.names, rig.neutral, rig.shapes, rig.triangles)


def plan_rows(title: str, rig: BlendshapeRig, target: np.ndarray) -> None:
    """Table rows of all modes for one rig."""
    for symmetry in SYMMETRIES:
        for mode in MODES:
            options = PlanOptions(mode=mode, symmetry=symmetry)
            bare = fresh(rig)
            prepared, before = timed(lambda b=bare, o=options: prepare_rig(b, o, target, (), PackingRules(), None))
            plan, packing = timed(lambda b=bare, p=prepared, o=options: pack_prepared(b, p, o, PackingRules()))
            order = "all" if all(part.proven for part in plan.expressions) else "no"
            print(
                f"| {title} | {symmetry} ({len(plan.pairs)} pairs) | {mode} | {len(plan.expressions)} | "
                f"{plan.lower_bound} | {order} | {before:.2f} | {packing:.2f} | {before + packing:.2f} |",
                flush=True,
            )


def greedy_rounds(weights: np.ndarray, rows: np.ndarray) -> int:
    """Rounds with the given rows, to time them."""
    used: list[int] = []
    rounds = 0
    while len(used) < len(weights):
        used += heaviest_set(weights, rows, exclude=used).items
        rounds += 1
    return rounds


def reduction_rows(title: str, rig: BlendshapeRig, target: np.ndarray) -> None:
    """What fewer rows save, with the same solver in the same run."""
    prepared = prepare_rig(rig, PlanOptions(), target, (), PackingRules(), None)
    items = contract_pairs(rig.shape_count, prepared.pairs)
    coverage = item_coverage(prepared.active, items)
    importance = prepared.importance.after((), range(rig.shape_count))
    weights = np.array([importance[list(shapes)].sum() for shapes in items])
    rows, reducing = timed(lambda: constraint_rows(coverage))
    full = all_rows(coverage)
    count, slow = timed(lambda: greedy_rounds(weights, full))
    again, fast = timed(lambda: greedy_rounds(weights, rows.maximal))
    if count != again:
        raise RuntimeError("the reduced rows gave another number of rounds")
    print(
        f"| {title} | {rows.vertices} → {rows.shared} → {rows.distinct} → {len(rows.maximal)} | {slow:.2f} | "
        f"{reducing:.3f} + {fast:.2f} | {slow / (reducing + fast):.1f} |",
        flush=True,
    )


def makehuman_rig(assets: MakeHumanAssets, number: int, expressions: Path | None = None) -> BlendshapeRig:
    """Pose units of a MakeHuman identity, and for the average head ready-made expressions of the same mesh."""
    mesh, names, shapes = pose_unit_shapes(assets, number)
    if expressions is not None:
        arrays = read_npz(expressions)
        same = np.abs(arrays["neutral"] - mesh.vertices).max() < 0.01  # millimetres; the file is in single precision
        if same:
            more = sorted(name for name in arrays if "__" not in name and name != "neutral")
            base = arrays["neutral"].astype(np.float64)
            moved = [mesh.vertices + (arrays[name] - base) for name in more]
            names, shapes = (*names, *more), np.concatenate([shapes, moved])
    return BlendshapeRig(tuple(names), mesh.vertices, shapes, mesh.triangles()[0])


def value_rows(template: BlendshapeRig, person: BlendshapeRig, title: str) -> None:
    """Error that is gone after some captures: by importance, its parts, equal and random weights."""
    options = PlanOptions()
    prepared: PreparedRig = prepare_rig(template, options, person.neutral, (), PackingRules(), None)
    solver = TransferSolver(template, person.neutral)
    generic, seconds = timed(lambda: generic_errors(solver, person.shapes))
    importance = prepared.importance.after((), range(template.shape_count))
    random = np.random.default_rng(0)
    plans: list[tuple[str, list[np.ndarray]]] = [
        ("importance", [importance]),
        ("displacement alone", [prepared.importance.displacement]),
        ("distortion alone", [prepared.importance.distortion]),
        ("unit weights", [np.ones(template.shape_count)]),
        (f"random (mean of {RANDOM_PLANS})", [random.random(template.shape_count) for _ in range(RANDOM_PLANS)]),
        ("true errors (oracle)", [generic]),
    ]
    for name, weights in plans:
        values = [
            measure_plan(solver, person.shapes, plan_by_weights(template, prepared, w, options), generic)
            for w in weights
        ]
        removed = [[value.removed[min(k, len(value.removed) - 1)] for k in (1, 5, 10, 10**6)] for value in values]
        counts = np.mean([len(value.removed) - 1 for value in values])
        shares = " | ".join(f"{100.0 * share:.0f}" for share in np.mean(removed, axis=0))
        print(f"| {title} | {name} | {counts:.1f} | {100.0 * values[0].remaining[0]:.4f} | {shares} |", flush=True)
    rank = np.corrcoef(np.argsort(np.argsort(importance)), np.argsort(np.argsort(generic)))[0, 1]
    print(
        f"\n{title}: Spearman(importance, error of the generic shape) {rank:.2f}; {seconds:.2f} s for all transfers\n"
    )


def parse(arguments: Sequence[str]) -> argparse.Namespace:
    """Read the command line; a path that does not hold what it should ends the run in one line."""
    parser = argparse.ArgumentParser(description="Time and value of capture plans; prints Markdown tables.")
    parser.add_argument("--makehuman", type=Path, help="folder with makehuman/data: adds a real rig and three people")
    parser.add_argument("--expressions", type=Path, help="expressions.npz of that head: more shapes for the rig")
    options = parser.parse_args(arguments)
    if options.expressions is not None and not options.expressions.is_file():
        parser.error(f"--expressions {options.expressions}: no such file")
    if options.expressions is not None and options.makehuman is None:
        parser.error("--expressions needs --makehuman")
    return options


def main(arguments: Sequence[str]) -> None:
    """Print the tables."""
    options = parse(arguments)
    sized = synthetic_rig(77, 347, 20, 13, 1)
    target = sized.neutral * [1.2, 0.9, 1.1] + 0.03 * np.sin(5.0 * sized.neutral[:, [1, 2, 0]])
    prepare_rig(synthetic_rig(9, 11, 2, 1, 0), PlanOptions(), None, (), PackingRules(), None)  # loads the libraries
    heaviest_set(np.ones(3), np.ones((1, 3), dtype=np.bool_))
    rigs: list[tuple[str, BlendshapeRig, np.ndarray]] = [("synthetic, K = 53, N = 26,719", sized, target)]
    assets = None
    if options.makehuman is not None:
        assets = parse_assets(read_makehuman_texts(options.makehuman, REQUIRED_FILES))
        head = makehuman_rig(assets, 0, options.expressions)
        name = f"MakeHuman, K = {head.shape_count}, N = {len(head.neutral):,}"
        rigs.append((name, head, makehuman_rig(assets, 1).neutral))
    for seed in range(4):
        large = synthetic_rig(61, 81, 85, 30, seed, (0.1, 0.45))
        rigs.append((f"synthetic, K = 200, no. {seed}", large, large.neutral * [1.2, 0.9, 1.1]))
    print(
        "| rig | symmetry | mode | expressions | proven bound | order proven | preparing s | packing s | together s |"
    )
    print("| --- | --- | --- | ---: | ---: | --- | ---: | ---: | ---: |")
    for rig in rigs:
        plan_rows(*rig)
    print("\n| rig | rows | all rows s | reducing + maximal rows s | times faster |")
    print("| --- | --- | ---: | ---: | ---: |")
    for rig in rigs[:3]:
        reduction_rows(*rig)
    if assets is not None:
        print("\n| person | plan | expressions | generic error, % of D | gone after 1, % | 5 | 10 | all |")
        print("| --- | --- | ---: | ---: | ---: | ---: | ---: | ---: |")
        for number in (1, 2, 3):
            value_rows(makehuman_rig(assets, 0), makehuman_rig(assets, number), f"identity {number}")


if __name__ == "__main__":
    main(sys.argv[1:])
