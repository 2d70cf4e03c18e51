"""``capture-eval blend``: blendshapes from registered expressions."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer


class Precision(StrEnum):
    """Of the positions that are written."""

    float32 = "float32"
    float64 = "float64"


class Follow(StrEnum):
    """How vertices on no curve follow the curves."""

    harmonic = "harmonic"
    biharmonic = "biharmonic"


def blend(
    neutral: Annotated[Path, typer.Argument(help="The neutral mesh, OBJ or PLY.")],
    targets: Annotated[
        list[Path], typer.Argument(help="Expressions of the same topology: meshes, or an npz of (vertices, 3) arrays.")
    ],
    out: Annotated[Path, typer.Option(help="NAME.npz for one file, any other name for a folder of OBJ files.")],
    weights: Annotated[
        list[str] | None, typer.Option(help="One weight per target, as 0.2,0,0.6; repeat for a list of shapes.")
    ] = None,
    weights_file: Annotated[Path | None, typer.Option(help="CSV with one row of weights per shape.")] = None,
    levels: Annotated[
        str | None, typer.Option(help="All combinations of these weights, as 0,0.2,0.4,0.6,0.8,1.")
    ] = None,
    t: Annotated[float, typer.Option(help="Moment of the motion, from 0 (neutral) to 1 (targets).")] = 1.0,
    method: Annotated[str, typer.Option(help="Interpolation method of the motion.")] = "pde_quadratic",
    option: Annotated[
        list[str] | None, typer.Option(help="Option of the method, as damping=100; repeat for more.")
    ] = None,
    curves: Annotated[Path | None, typer.Option(help="Curves file; all edge loops of the mesh by default.")] = None,
    free: Annotated[bool, typer.Option("--free", help="Use weights as they are, not scaled to add up to 1.")] = False,
    distinct: Annotated[bool, typer.Option("--distinct", help="Leave out shapes with equal weights.")] = False,
    extension: Annotated[Follow, typer.Option(help="How vertices on no curve follow.")] = Follow.harmonic,
    precision: Annotated[Precision, typer.Option(help="Of the positions.")] = Precision.float64,
) -> None:
    """Blend registered expressions: one shape, a list, or every combination of weight levels.

    Each expression goes from the neutral mesh to its target as the method says; at t = 1 all methods give the linear
    blend. Shapes are written while they are made, so that memory does not grow with their number.

    Example: capture-eval blend neutral.obj sad.obj grin.obj --levels 0,0.5,1 --t 0.6 --out shapes.npz
    """
    from capture_eval.command_line.progress_bar import counting_progress
    from capture_eval.stages.blend import BlendOptions, blend_expressions, read_weights

    rows = [_numbers(row, "--weights") for row in weights or []]
    if weights_file is not None:
        rows += read_weights(weights_file)
    options = BlendOptions(
        method=method,
        method_options=dict(_pair(text) for text in option or []),
        t=t,
        weights=tuple(rows),
        levels=_numbers(levels, "--levels") if levels is not None else (),
        free=free,
        distinct=distinct,
        extension=extension.value,
        precision=precision.value,
    )
    with counting_progress("shapes blended") as progress:
        result = blend_expressions(neutral, targets, curves, out, options, progress)
    print(
        f"{result['shapes']} shapes of {len(result['targets'])} targets "
        f"({', '.join(result['targets'])}) at t = {t:g}: {out}"
    )
    if result["distinct"] < result["shapes"]:
        print(
            f"{result['distinct']} of them are distinct, the others repeat the weights of one before "
            "(--distinct leaves them out)"
        )
    if result["on_curves"] < 1.0:
        print(f"{100 * result['on_curves']:.1f} % of the vertices are on curves, the rest follows ({extension.value})")


def _numbers(text: str, flag: str) -> tuple[float, ...]:
    try:
        return tuple(float(part) for part in text.split(","))
    except ValueError as problem:
        raise typer.BadParameter(f"{flag}: '{text}' is not a list of numbers as 0.2,0,0.6") from problem


def _pair(text: str) -> tuple[str, object]:
    import yaml

    name, equals, value = text.partition("=")
    if not equals:
        raise typer.BadParameter(f"--option: '{text}' is not name=value")
    try:
        return name, yaml.safe_load(value)
    except yaml.YAMLError as problem:
        raise typer.BadParameter(f"--option: '{value}' cannot be read ({problem})") from problem
