"""Planning a capture: rig in; plan as JSON, CSV, meshes, sheet, curve and page out."""

from __future__ import annotations

import csv
import io
import logging
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture_eval.errors import InputError
from capture_eval.files.atomic import write_json, write_text
from capture_eval.files.obj_files import write_obj
from capture_eval.files.plan_rule_files import NamedRules
from capture_eval.files.rig_files import RigFiles, read_positions, read_rig
from capture_eval.planning.blendshape_rig import BlendshapeRig
from capture_eval.planning.packing_rules import PackingRules
from capture_eval.planning.planner import CapturePlan, PlanOptions, plan_captures
from capture_eval.stages.plan_pictures import draw_plan

logger = logging.getLogger("capture_eval.plan")
SCHEMA_VERSION = 1


@dataclass(frozen=True)
class PlanRequest:
    """What is planned.

    Attributes
    ----------
    rig : Path
        See `read_rig`.
    target : Path or None
        Neutral of the person, same topology.
    neutral : str
        Name of the rig's neutral.
    rules : NamedRules
    options : PlanOptions
    view : str
        Preset of the pictures.
    pictures : bool
        Whether sheet, curve and page are made.
    """

    rig: Path
    target: Path | None = None
    neutral: str = "neutral"
    rules: NamedRules = field(default_factory=NamedRules)
    options: PlanOptions = field(default_factory=PlanOptions)
    view: str = "front"
    pictures: bool = True


def plan_capture(request: PlanRequest, out: Path, progress: Callable[[int, int], None] | None = None) -> dict[str, Any]:
    """Read the rig, plan, and write ``plan.json``, ``plan.csv``, ``meshes/``, ``figures/`` and ``plan.html``.

    Returns
    -------
    dict
        The content of ``plan.json``.

    Raises
    ------
    InputError
        Bad rig, target, option or rule; the text names it.
    """
    files = read_rig(request.rig, request.neutral, progress)
    rig = files.rig
    target = _read_target(request, files)
    pairs = [tuple(rig.index(name) for name in pair) for pair in request.rules.pairs]
    plan = plan_captures(
        rig,
        request.options,
        target=target,
        pairs=pairs,
        rules=numbered_rules(request.rules, rig),
        ignored=_mask(request.rules.masked_vertices, len(rig.neutral)),
    )
    logger.info("%d shapes in %d expressions", rig.shape_count - len(plan.uncaptured), len(plan.expressions))
    document = plan_document(request, rig, plan)
    write_json(out / "plan.json", document)
    write_text(out / "plan.csv", plan_csv(rig, plan))
    posed = [rig.combined(expression.shapes, target) for expression in plan.expressions]
    _write_meshes(files, rig, plan, rig.neutral if target is None else target, posed, out / "meshes")
    if request.pictures:
        draw_plan(rig, plan, rig.neutral if target is None else target, posed, request.options, request.view, out)
    return document


def numbered_rules(rules: NamedRules, rig: BlendshapeRig) -> PackingRules:
    """Rules by names as rules by numbers.

    Raises
    ------
    InputError
        A name that is not in the rig.
    """

    def numbers(names: Sequence[str]) -> tuple[int, ...]:
        return tuple(rig.index(name) for name in names)

    return PackingRules(
        numbers(rules.left_out),
        tuple(numbers(group) for group in rules.never_together),
        {number: numbers(names) for number, names in rules.include.items() if names},
        {number: numbers(names) for number, names in rules.exclude.items() if names},
    )


def plan_document(request: PlanRequest, rig: BlendshapeRig, plan: CapturePlan) -> dict[str, Any]:
    """The plan in plain values for JSON: names, weights, proofs; no times, so that equal plans give equal bytes."""
    names = rig.names
    importance = plan.importance.after((), range(rig.shape_count))
    return {
        "schema_version": SCHEMA_VERSION,
        "rig": request.rig.name,
        "target": None if request.target is None else request.target.name,
        "options": asdict(request.options),
        "vertices": len(rig.neutral),
        "shapes": [
            {
                "name": name,
                "importance": float(importance[k]),
                "displacement": float(plan.importance.displacement[k]),
                "distortion": float(plan.importance.distortion[k]),
                "active_vertices": int(plan.active[k].sum()),
                "captured": k not in plan.uncaptured,
            }
            for k, name in enumerate(names)
        ],
        "pairs": [[names[first], names[second]] for first, second in plan.pairs],
        "self_symmetric": [] if plan.found is None else [names[k] for k in plan.found.self_symmetric],
        "expressions": [
            {
                "number": number,
                "shapes": [{"name": names[shape], "weight": 1.0} for shape in expression.shapes],
                "importance": expression.value,
                "proven_bound": expression.bound,
                "proven_optimal": expression.proven,
                "covered_share": expression.covered,
                "doubly_covered_vertices": expression.doubly_covered_vertices,
            }
            for number, expression in enumerate(plan.expressions, 1)
        ],
        "fewest": {
            "expressions_for_all_shapes": plan.full_count,
            "lower_bound": plan.lower_bound,
            "proven_fewest": plan.fewest,
            "gap": None if plan.full_count is None else plan.full_count - plan.lower_bound,
            "clique": [[names[shape] for shape in group] for group in plan.clique],
        },
        "rows": {
            "vertices": plan.rows.vertices,
            "with_two_or_more": plan.rows.shared,
            "distinct": plan.rows.distinct,
            "maximal": len(plan.rows.maximal),
        },
        "not_captured": [names[shape] for shape in plan.uncaptured],
    }


def plan_csv(rig: BlendshapeRig, plan: CapturePlan) -> str:
    """One row per shape: the expression it is captured in (empty if in none), its weight and importance."""
    importance = plan.importance.after((), range(rig.shape_count))
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["expression", "shape", "weight", "importance", "covered_share", "status"])
    for number, expression in enumerate(plan.expressions, 1):
        for shape in expression.shapes:
            writer.writerow(
                [number, rig.names[shape], "1.0", repr(float(importance[shape])), repr(expression.covered), "planned"]
            )
    for shape in plan.uncaptured:
        writer.writerow(["", rig.names[shape], "", repr(float(importance[shape])), "", "not captured"])
    return text.getvalue()


def _read_target(request: PlanRequest, files: RigFiles) -> NDArray[np.float64] | None:
    if request.target is None:
        return None
    positions = read_positions(request.target)
    if positions.shape != files.rig.neutral.shape:
        raise InputError(
            f"{request.target}: {len(positions)} vertices, but the rig has {len(files.rig.neutral)}; the target must "
            "have the rig's topology"
        )
    return positions


def _mask(vertices: Sequence[int], count: int) -> NDArray[np.bool_] | None:
    if not len(vertices):
        return None
    for vertex in vertices:
        if not 0 <= vertex < count:
            raise InputError(f"masked vertex {vertex}: the rig has the vertices 0 to {count - 1}")
    return np.isin(np.arange(count), vertices)


def _write_meshes(
    files: RigFiles,
    rig: BlendshapeRig,
    plan: CapturePlan,
    neutral: NDArray[np.float64],
    posed: Sequence[NDArray[np.float64]],
    folder: Path,
) -> None:
    """The neutral and every planned expression as OBJ; meshes of a longer plan made before are removed."""
    for old in folder.glob("expression_*.obj"):
        if old.stem[len("expression_") :].isdigit():
            old.unlink()
    write_obj(folder / "expression_00_neutral.obj", files.neutral.with_vertices(neutral), ["neutral"])
    for number, (expression, vertices) in enumerate(zip(plan.expressions, posed, strict=True), 1):
        comment = "all at weight 1: " + ", ".join(rig.names[shape] for shape in expression.shapes)
        write_obj(folder / f"expression_{number:02d}.obj", files.neutral.with_vertices(vertices), [comment])
