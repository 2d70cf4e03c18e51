"""``capture-eval compare``: the evaluation alone."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def compare(
    manifest: Annotated[Path, typer.Argument(help="A manifest with `source: meshes` (YAML).")],
    out: Annotated[Path, typer.Option(help="Folder of the result.")],
    allow_outside: Annotated[
        bool, typer.Option("--allow-outside", help="Let the manifest name files outside its folder.")
    ] = False,
) -> None:
    """Evaluate meshes that are registered already.

    The evaluation and the report alone, without photos and without reconstruction.

    Example: capture-eval compare my_meshes.yaml --out result
    """
    import sys

    from capture_eval.command_line.progress_bar import stage_messages
    from capture_eval.errors import InputError
    from capture_eval.files.manifest_files import read_manifest
    from capture_eval.stages.validate import validate_capture
    from capture_eval.workflow.comparison import compare_meshes
    from capture_eval.workflow.stage_options import check_options

    capture = read_manifest(manifest, allow_outside)
    if capture.manifest.source != "meshes":
        raise InputError(
            f"{manifest}: source is {capture.manifest.source}; compare needs `source: meshes`, or use `run`"
        )
    check_options(capture)
    problems = validate_capture(capture)
    for problem in problems:
        print(problem if problem.fatal else f"warning: {problem}", file=sys.stderr)
    fatal = sum(problem.fatal for problem in problems)
    if fatal:
        raise InputError(f"{manifest}: {fatal} of the problems above must be solved first")
    with stage_messages():
        compare_meshes(capture, out)
    print(f"report: {out.resolve() / 'report' / 'report.html'}")
