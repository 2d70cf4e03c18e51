"""``capture-eval synthesize``: photographs of a head whose every point is known."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from capture_eval.errors import InputError


class Dataset(StrEnum):
    """Heads that can be photographed."""

    mannequin = "mannequin"
    makehuman = "makehuman"


class Skin(StrEnum):
    """How much there is to see on the skin."""

    normal = "normal"
    weak = "weak"


def synthesize(
    dataset: Annotated[
        Dataset, typer.Argument(help="mannequin is built in; makehuman needs its files (see --makehuman).")
    ],
    out: Annotated[Path, typer.Option("--out", help="Folder of the capture; made if it is not there.")],
    motion: Annotated[str, typer.Option(help="jaw_open, grin or blink_frown.")] = "jaw_open",
    timing: Annotated[
        str, typer.Option(help="linear, eased (10t^3-15t^4+6t^5) or power:P (t^P; above 1 accelerates).")
    ] = "linear",
    poses: Annotated[int, typer.Option(min=2, help="Poses at t = 0 ... 1.")] = 11,
    times: Annotated[str | None, typer.Option(help="Times of the poses instead of --poses, as 0,0.3,0.6,1.")] = None,
    views: Annotated[int, typer.Option(min=2, help="Photos of every pose.")] = 30,
    size: Annotated[str, typer.Option(help="Width x height of the photos; 480x640 stands upright.")] = "640x480",
    seed: Annotated[int, typer.Option(min=0, help="Of camera jitter, sensor noise and landmark noise.")] = 0,
    skin: Annotated[Skin, typer.Option(help="weak: little contrast and more noise, hard to match.")] = Skin.normal,
    identity: Annotated[int, typer.Option(min=0, help="The person photographed.")] = 0,
    template_identity: Annotated[int, typer.Option(min=0, help="The person whose mesh is the template.")] = 1,
    distortion: Annotated[float, typer.Option(help="Radial distortion k1 of the lens, as -0.05 or 0.03.")] = 0.0,
    light_turn: Annotated[
        float, typer.Option(help="Degrees the lamps are walked round the head from the first pose to the last.")
    ] = 0.0,
    makehuman: Annotated[
        Path | None, typer.Option(help="Checkout of MakeHuman; without it the fetched data set is taken.")
    ] = None,
    cores: Annotated[int, typer.Option(min=1, help="Poses photographed at the same time.")] = 1,
) -> None:
    """Photograph a head with known truth: photos, cameras, true meshes, template, landmarks, curves and manifest.

    The same options give the same bytes; an interrupted call goes on where it stopped.

    Example: capture-eval synthesize mannequin --out capture --views 16 --cores 2

    Example: capture-eval synthesize makehuman --motion grin --timing power:2 --size 1280x960 --out grin
    """
    from capture_eval.command_line.progress_bar import counting_progress
    from capture_eval.stages.subjects import load_subjects
    from capture_eval.stages.synthesize import synthesize_capture
    from capture_eval.stages.synthesize_options import SynthesizeOptions

    width, height = parse_size(size)
    options = SynthesizeOptions(
        motion=motion,
        timing=timing,
        poses=poses,
        times=None if times is None else parse_times(times),
        views=views,
        width=width,
        height=height,
        seed=seed,
        skin=skin.value,
        distortion=(distortion, 0.0, 0.0, 0.0),
        light_turn=light_turn,
    )
    options.check()
    head, template = load_subjects(dataset.value, identity, template_identity, makehuman)
    with counting_progress("photos made") as progress:
        made = synthesize_capture(head, template, out, options, cores, progress)
    kept = f" ({made['kept']} were there)" if made["kept"] else ""
    print(f"{made['manifest']}: {made['photos']} photos{kept}, D = {made['diameter_mm']:.3f} mm")


def parse_size(text: str) -> tuple[int, int]:
    """Width and height of ``640x480``.

    Raises
    ------
    InputError
        The text is no size.
    """
    width, _, height = text.lower().partition("x")
    if not (width.isdecimal() and height.isdecimal()):
        raise InputError(f"size {text!r}: write it as 640x480")
    return int(width), int(height)


def parse_times(text: str) -> tuple[float, ...]:
    """Times of ``0,0.3,1``.

    Raises
    ------
    InputError
        Something between the commas is no number.
    """
    try:
        return tuple(float(part) for part in text.split(","))
    except ValueError:
        raise InputError(f"times {text!r}: write them as 0,0.3,0.6,1") from None
