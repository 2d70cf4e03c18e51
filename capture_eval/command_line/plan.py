"""``capture-eval plan``: which combined expressions to capture."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer


class Mode(StrEnum):
    """How expressions are chosen."""

    greedy = "greedy"
    minimum = "minimum"


class Symmetry(StrEnum):
    """Where symmetric pairs come from."""

    detect = "detect"
    given = "given"
    none = "none"


def plan(
    rig: Annotated[Path, typer.Argument(help="Folder of meshes of one topology (OBJ, PLY, NPZ), or one NPZ file.")],
    out: Annotated[Path, typer.Option(help="Folder of the result.")],
    target: Annotated[Path | None, typer.Option(help="Neutral of the person to capture, same topology.")] = None,
    mode: Annotated[
        Mode, typer.Option(help="greedy: the most important expression each time; minimum: the fewest, proven.")
    ] = Mode.greedy,
    neutral: Annotated[str, typer.Option(help="Name of the rig's neutral.")] = "neutral",
    threshold: Annotated[float, typer.Option(help="Share of a shape's largest movement that counts as active.")] = 0.3,
    alpha: Annotated[float, typer.Option(help="Weight of displacement against triangle distortion, 0 to 1.")] = 0.5,
    beta: Annotated[float, typer.Option(help="Weight of uniqueness, 0 or more.")] = 0.0,
    unit_weights: Annotated[bool, typer.Option("--unit-weights", help="All shapes are equally important.")] = False,
    max_expressions: Annotated[int | None, typer.Option(help="Stop after this many.")] = None,
    symmetry: Annotated[Symmetry, typer.Option(help="Symmetric pairs: find them, only --pair, or none.")] = (
        Symmetry.detect
    ),
    pair: Annotated[list[str] | None, typer.Option(metavar="A,B", help="Shapes used only together (repeat).")] = None,
    leave_out: Annotated[list[str] | None, typer.Option(metavar="A", help="Shape not to capture (repeat).")] = None,
    never_together: Annotated[list[str] | None, typer.Option(metavar="A,B", help="Shapes kept apart (repeat).")] = None,
    include: Annotated[
        list[str] | None, typer.Option(metavar="N:A,B", help="Expression N must hold these (repeat).")
    ] = None,
    exclude: Annotated[
        list[str] | None, typer.Option(metavar="N:A,B", help="Expression N must not hold these (repeat).")
    ] = None,
    rules: Annotated[Path | None, typer.Option(help="All these wishes, and masked vertices, as YAML.")] = None,
    remove_scale: Annotated[
        bool, typer.Option("--remove-scale", help="Ignore the target's overall size in the triangle distortion.")
    ] = False,
    view: Annotated[str, typer.Option(help="Pictures from: front, three_quarter, left, right, below.")] = "front",
    no_pictures: Annotated[bool, typer.Option("--no-pictures", help="Only JSON, CSV and meshes.")] = False,
) -> None:
    """Plan which combined expressions of a blendshape rig to capture.

    Shapes that do not overlap share a photo session: as few expressions as possible, the most useful first. Writes
    plan.json, plan.csv, the expressions as OBJ, a sheet of pictures for the actor, a coverage curve and plan.html.

    Example: capture-eval plan my_rig --out plan --target person.obj --mode minimum --never-together lookIn_L,lookIn_R
    """
    from capture_eval.command_line.progress_bar import counting_progress, stage_messages
    from capture_eval.files.plan_rule_files import NamedRules, read_plan_rules
    from capture_eval.planning.planner import PlanOptions
    from capture_eval.stages.plan import PlanRequest, plan_capture
    from capture_eval.stages.plan_pictures import check_view

    check_view(view)
    wishes = NamedRules(
        tuple(_names(text) for text in pair or ()),
        tuple(leave_out or ()),
        tuple(_names(text) for text in never_together or ()),
        _numbered(include),
        _numbered(exclude),
    )
    if rules is not None:
        wishes = read_plan_rules(rules).joined(wishes)
    options = PlanOptions(
        mode.value, threshold, alpha, beta, max_expressions, symmetry.value, unit_weights, remove_scale
    )
    request = PlanRequest(rig, target, neutral, wishes, options, view, not no_pictures)
    with stage_messages(), counting_progress("meshes read") as progress:
        document = plan_capture(request, out, progress)
    _print(document)
    print(f"plan: {(out / ('plan.json' if no_pictures else 'plan.html')).resolve()}")


def _print(document: dict[str, object]) -> None:
    expressions = document["expressions"]
    fewest = document["fewest"]
    if not isinstance(expressions, list) or not isinstance(fewest, dict):
        return
    for expression in expressions:
        shapes = ", ".join(shape["name"] for shape in expression["shapes"])
        print(f"{expression['number']:>3}  {100 * expression['covered_share']:>5.1f} %  {shapes}")
    needed = fewest["expressions_for_all_shapes"]
    if fewest["proven_fewest"]:
        print(f"{needed} expressions capture all shapes; proven: no plan has fewer")
    elif needed is None:
        print(f"all shapes need {fewest['lower_bound']} expressions or more")
    else:
        print(f"{needed} expressions capture all shapes; proven: {fewest['lower_bound']} or more are needed")


def _names(text: str) -> tuple[str, ...]:
    return tuple(name.strip() for name in text.split(",") if name.strip())


def _numbered(texts: list[str] | None) -> dict[int, tuple[str, ...]]:
    result: dict[int, tuple[str, ...]] = {}
    for text in texts or ():
        number, colon, names = text.partition(":")
        if not colon or not number.strip().isdigit() or not _names(names):
            raise typer.BadParameter(f"{text!r}: write N:A,B, for example 1:jawOpen,browUp_L")
        result[int(number)] = (*result.get(int(number), ()), *_names(names))
    return result
