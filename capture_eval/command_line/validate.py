"""``capture-eval validate``: manifest and photos before hours are spent."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def validate(
    manifest: Annotated[Path, typer.Argument(help="The manifest of the capture (YAML).")],
    allow_outside: Annotated[
        bool, typer.Option("--allow-outside", help="Let the manifest name files outside its folder.")
    ] = False,
) -> None:
    """Check manifest and photos before hours are spent.

    One line per problem; the exit code is 1 if there is any.

    Example: capture-eval validate capture/manifest.yaml
    """
    from capture_eval.command_line.progress_bar import counting_progress
    from capture_eval.files.manifest_files import read_manifest
    from capture_eval.stages.validate import validate_capture
    from capture_eval.workflow.stage_options import check_options

    capture = read_manifest(manifest, allow_outside)
    check_options(capture)
    with counting_progress("photos checked") as progress:
        problems = validate_capture(capture, progress=progress)
    for problem in problems:
        print(problem)
    if problems:
        print(f"{len(problems)} problem{'s' if len(problems) > 1 else ''} found")
        raise typer.Exit(1)
    poses = len(capture.manifest.poses)
    print(f"{manifest}: good, {poses} pose{'s' if poses > 1 else ''}")
