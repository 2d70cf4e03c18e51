"""``capture-eval edit``: a new expression by dragging points."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from capture_eval.editing.control_targets import ControlPoint


def edit(
    examples: Annotated[
        Path, typer.Argument(help="Folder of registered OBJ/PLY meshes (neutral first), or registered.npz of a run.")
    ],
    out: Annotated[Path, typer.Option(help="The new face, .obj or .ply.")],
    control: Annotated[
        list[str] | None, typer.Option(help="VERTEX:x,y to a pixel or VERTEX:x,y,z to a point; repeat for more.")
    ] = None,
    drag: Annotated[
        list[str] | None, typer.Option(help="x,y:x,y from pixel to pixel; the vertex under the first is picked.")
    ] = None,
    camera: Annotated[Path | None, typer.Option(help="Cameras file (truth/cameras.json of a capture).")] = None,
    view: Annotated[
        str | None, typer.Option(help="PHOTO or POSE/PHOTO in the cameras file; the first if not given.")
    ] = None,
    template: Annotated[Path | None, typer.Option(help="Mesh with the faces, for an npz that has none.")] = None,
    onto: Annotated[
        Path | None, typer.Option(help="Edit this face, which has no examples, through the examples.")
    ] = None,
    pairs: Annotated[
        Path | None, typer.Option(help="YAML `pairs: [[vertex of examples, vertex of --onto], …]`, 4 or more.")
    ] = None,
    theta2: Annotated[
        float, typer.Option(help="Weight of what is natural against what is asked; small follows the drag exactly.")
    ] = 1.0,
    printed: Annotated[bool, typer.Option("--printed", help="The paper's formulas as printed.")] = False,
    picture: Annotated[
        Path | None, typer.Option(help="Draw drags, result and soft regions (.png, .pdf, .svg).")
    ] = None,
) -> None:
    """Make a new expression: drag points, and the rest of the face follows as in the recorded expressions.

    Example: capture-eval edit expressions/ --control 5630:412,388 --camera cameras.json --out smile.obj
    """
    from dataclasses import replace

    from capture_eval.editing.blend_weights import Balance
    from capture_eval.editing.expression_editor import EditOptions
    from capture_eval.errors import InputError
    from capture_eval.stages.edit import DragRequest, edit_expression, read_view

    controls, drags = tuple(map(_control, control or [])), tuple(map(_drag, drag or []))
    if not controls and not drags:
        raise InputError("nothing is dragged: give --control VERTEX:x,y or --drag x,y:x,y")
    options = replace(EditOptions.printed() if printed else EditOptions(), balance=Balance(proximity=theta2))
    seen = None if camera is None else read_view(camera, view)
    request = DragRequest(controls, drags, seen, onto, pairs, options)
    result = edit_expression(examples, out, request, template, picture)
    for row, point in enumerate(result.controls):
        unit = "px" if len(point.target) == 2 else "of the mesh's unit"
        far = "; the drag was farther than the examples reach, and was shortened" if result.limited[row] else ""
        print(f"vertex {point.vertex}: {result.misses[row]:.4g} {unit} from its target{far}")
    print(f"face in {out}" + (f", picture in {picture}" if picture else ""))


def _control(text: str) -> ControlPoint:
    """``VERTEX:x,y`` or ``VERTEX:x,y,z``."""
    from capture_eval.editing.control_targets import ControlPoint
    from capture_eval.errors import InputError

    vertex, colon, target = text.partition(":")
    if not colon or not vertex.strip().isdigit():
        raise InputError(f"--control {text}: expected VERTEX:x,y or VERTEX:x,y,z")
    return ControlPoint(int(vertex), _numbers(target, f"--control {text}", (2, 3)))


def _drag(text: str) -> tuple[tuple[float, float], tuple[float, float]]:
    """``x,y:x,y``."""
    start, _, end = text.partition(":")
    first, last = (_numbers(part, f"--drag {text}", (2,)) for part in (start, end))
    return (first[0], first[1]), (last[0], last[1])


def _numbers(text: str, where: str, counts: tuple[int, ...]) -> tuple[float, ...]:
    from capture_eval.errors import InputError

    try:
        numbers = tuple(float(part) for part in text.split(","))
    except ValueError:
        numbers = ()
    if len(numbers) not in counts:
        raise InputError(
            f"{where}: {text!r} should be {' or '.join(str(count) for count in counts)} numbers with commas"
        )
    return numbers
