"""``capture-eval run``: the whole job."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from capture_eval.errors import InputError

if TYPE_CHECKING:
    from capture_eval.files.manifest_files import Capture
    from capture_eval.workflow.runner import RunOptions

INTERRUPTED = 130
RESULT_OF_POSE = {"sparse": "sparse", "dense": "fused.ply", "surface": "scan.ply"}


def run(
    manifest: Annotated[Path, typer.Argument(help="The manifest of the capture (YAML).")],
    out: Annotated[Path, typer.Option(help="Folder of the result; a run that was broken off goes on in it.")],
    cores: Annotated[int, typer.Option(min=1, help="Poses worked on side by side.")] = 1,
    until: Annotated[
        str | None,
        typer.Option(
            help="Last stage: sparse, dense, surface, align, register, curves, interpolate, evaluate or report."
        ),
    ] = None,
    force: Annotated[str | None, typer.Option(help="Repeat this stage and all after it.")] = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", "-n", help="List what would run, and why.")] = False,
    threads: Annotated[
        int, typer.Option(min=1, help="Threads inside a stage; more than 1 is not repeatable bit for bit.")
    ] = 1,
    allow_outside: Annotated[
        bool, typer.Option("--allow-outside", help="Let the manifest name files outside its folder.")
    ] = False,
    executor: Annotated[str | None, typer.Option(help="Snakemake executor plugin, e.g. slurm.")] = None,
    profile: Annotated[str | None, typer.Option(help="Snakemake profile (folder) for a cluster.")] = None,
    engine_arguments: Annotated[
        list[str] | None, typer.Argument(help="After `--`: more arguments for Snakemake.", show_default=False)
    ] = None,
) -> None:
    """The whole job: photos to tables, plots and a report. Broken off, the same command goes on.

    Example: capture-eval run capture/manifest.yaml --out result --cores 4

    Example: capture-eval run capture/manifest.yaml --out result --until surface
    """
    from capture_eval.files.manifest_files import read_manifest
    from capture_eval.workflow.runner import RunOptions

    capture = read_manifest(manifest, allow_outside)
    options = RunOptions(cores, until, force, threads, executor, profile, tuple(engine_arguments or ()))
    if dry_run:
        _list_pending(capture, out.resolve(), options)
    else:
        _run(capture, out.resolve(), options)


def _list_pending(capture: Capture, out: Path, options: RunOptions) -> None:
    from capture_eval.workflow.runner import plan_run
    from capture_eval.workflow.step_markers import Markers

    plan, pending = plan_run(capture, out, options)
    markers = Markers(out)
    for step in pending:
        why = "forced" if markers.finished(step) is not None else markers.reason(step)
        print(f"would run {step.title}: {why}")
    print(f"{len(pending)} of {len(plan.steps)} steps would run")


def _run(capture: Capture, out: Path, options: RunOptions) -> None:
    import sys
    import time

    from capture_eval.stages.reliability import troubled_poses
    from capture_eval.workflow.progress import duration
    from capture_eval.workflow.runner import run as run_plan

    if capture.manifest.source == "meshes":
        raise InputError(
            f"{capture.path}: source is meshes, so there is nothing to reconstruct; use capture-eval compare"
        )
    if options.until is None and capture.manifest.template is None:
        print("no `template` in the manifest: the run ends with the cleaned scans (surface)", file=sys.stderr)
    elif options.until is None and capture.manifest.curves is None:
        print("no `curves` in the manifest: the run ends with the registered meshes (register)", file=sys.stderr)
    started = time.monotonic()
    _refuse_bad_input(capture, out)
    try:
        plan = run_plan(capture, out, options)
    except KeyboardInterrupt:
        print("interrupted; the same command goes on from here", file=sys.stderr)
        raise typer.Exit(INTERRUPTED) from None
    for line in troubled_poses(out):
        print(f"warning: {line}", file=sys.stderr)
    took = duration(time.monotonic() - started)
    if plan.until == "report":
        print(f"report: {out / 'report' / 'report.html'} ({took})")
    elif plan.until in ("sparse", "dense", "surface"):
        for name in capture.manifest.pose_names:
            print(out / "work" / name / RESULT_OF_POSE[plan.until])
        print(f"done until {plan.until} ({took})")
    else:
        print(f"done until {plan.until}: {out / 'work'} ({took})")


def _refuse_bad_input(capture: Capture, out: Path) -> None:
    """Stop for what no stage can work around, say what else is wrong; unchanged input is looked at once."""
    import sys

    from capture_eval.command_line.progress_bar import counting_progress
    from capture_eval.stages.validate import validate_capture
    from capture_eval.workflow.preflight import checked_before, remember_checked
    from capture_eval.workflow.stage_options import check_options

    check_options(capture)
    if checked_before(capture, out):
        return
    with counting_progress("photos checked") as progress:
        problems = validate_capture(capture, progress=progress)
    for problem in problems:
        print(f"warning: {problem}" if not problem.fatal else str(problem), file=sys.stderr)
    fatal = [problem for problem in problems if problem.fatal]
    if fatal:
        raise InputError(f"{capture.path}: {len(fatal)} of the problems above must be solved first")
    remember_checked(capture, out, [str(problem) for problem in problems])
