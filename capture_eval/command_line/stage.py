"""``capture-eval stage``: one job of a run, as the engine calls it."""

from pathlib import Path
from typing import Annotated

import typer


def stage(
    job: Annotated[str, typer.Argument(help="scan, track, refine or final.")],
    out: Annotated[Path, typer.Option(help="Folder of the result, with the plan that `run` made.")],
    pose: Annotated[str | None, typer.Option(help="The pose, for jobs of one pose.")] = None,
) -> None:
    """One job of `run`; what the engine calls.

    Example: capture-eval stage scan --pose pose_03 --out result
    """
    from capture_eval.workflow.step_runner import run_job

    run_job(out, job, pose)
