"""``capture-eval curves``: edge loops to choose from, and the check of a curves file."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated

import typer

application = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    rich_markup_mode=None,
    help="Edge loops of a mesh, and curves files.\n\nExample: capture-eval curves list head.obj --picture loops.png",
)

Mesh = Annotated[Path, typer.Argument(help="The mesh (OBJ or PLY with quads).")]
Picture = Annotated[
    Path | None, typer.Option(help="Draw front and side view, a colour and label for each, to this PNG, PDF or SVG.")
]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON with the vertices of each.")]


@application.command("list")
def list_loops(
    mesh: Mesh,
    picture: Picture = None,
    min_length: Annotated[int, typer.Option(min=2, help="Leave out loops with fewer vertices.")] = 8,
    as_json: AsJson = False,
) -> None:
    """List all maximal edge loops: closed ones first, each with a start edge that a curves file can use.

    A loop goes straight on at vertices with four edges and stops at all others; rims of the mesh are loops too.

    Example: capture-eval curves list template.obj --min-length 20 --picture loops.png
    """
    from capture_eval.stages import curves

    _say_drawing(picture)
    loops = curves.list_loops(mesh, min_length, picture)
    if as_json:
        print(json.dumps([loop.as_dict() for loop in loops]))
        return
    print(f"{'no.':>4}  {'kind':<6}  {'vertices':>8}  {'length':>10}  start_edge")
    for loop in loops:
        start, following = loop.vertices[:2]
        print(
            f"{loop.label:>4}  {_kind(loop):<6}  {len(loop.vertices):>8}  {loop.length:>10.4g}  [{start}, {following}]"
        )
    closed = sum(loop.closed for loop in loops)
    print(f"{len(loops)} loops of {min_length} or more vertices, {closed} closed and {len(loops) - closed} open")
    if picture is not None:
        print(f"drawn in {picture}")


@application.command("check")
def check(
    mesh: Mesh,
    curves_file: Annotated[Path, typer.Argument(metavar="CURVES", help="The curves file (YAML or JSON).")],
    picture: Picture = None,
    as_json: AsJson = False,
) -> None:
    """Walk every curve of a curves file on a mesh: one line per problem, exit code 1 if there is any.

    Example: capture-eval curves check template.obj curves.yaml --picture curves.png
    """
    from capture_eval.stages import curves

    _say_drawing(picture)
    problems, good = curves.check_curves(mesh, curves_file, picture)
    if as_json:
        print(json.dumps({"problems": problems, "curves": [curve.as_dict() for curve in good]}))
    else:
        width = max((len(curve.label) for curve in good), default=0)
        for curve in good:
            print(
                f"{curve.label:<{width}}  {_kind(curve):<6}  {len(curve.vertices):>5} vertices  {curve.length:>10.4g}"
            )
        for problem in problems:
            print(problem)
        print(f"{curves_file}: {len(good)} good curves, {len(problems)} problem{'' if len(problems) == 1 else 's'}")
        if picture is not None and good:
            print(f"drawn in {picture}")
    if problems:
        raise typer.Exit(1)


def _say_drawing(picture: Path | None) -> None:
    if picture is not None and sys.stderr.isatty():
        print(f"drawing {picture} …", file=sys.stderr)


def _kind(loop: object) -> str:
    if getattr(loop, "border", False):
        return "rim"
    return "closed" if getattr(loop, "closed", False) else "open"
