"""One job of a run, in the process that the engine started for it: its steps one after the other, each with a log."""

from __future__ import annotations

import ctypes
import logging
import os
import resource
import signal
import sys
import time
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from capture_eval.errors import CaptureEvalError, InputError, StageError
from capture_eval.files.atomic import read_json, write_json
from capture_eval.files.manifest_files import read_manifest
from capture_eval.workflow.plan import Plan, Step
from capture_eval.workflow.step_calls import STEP_CALLS, StepContext
from capture_eval.workflow.step_markers import Failure, Markers

PLAN_FILE = "work/plan.json"


def write_plan(plan: Plan) -> None:
    """Save a plan for the processes of its jobs."""
    write_json(
        plan.out / PLAN_FILE,
        {
            "manifest": str(plan.capture.path.resolve()),
            "allow_outside": plan.capture.allow_outside,
            "threads": plan.threads,
            "steps": [{"name": s.name, "pose": s.pose, "job": s.job, "key": s.key} for s in plan.steps],
        },
    )


def read_plan(out: Path) -> Plan:
    """The plan that `run` saved.

    Raises
    ------
    InputError
        If there is none.
    """
    path = out / PLAN_FILE
    if not path.is_file():
        raise InputError(f"{path}: no plan; `capture-eval run` makes one")
    saved = read_json(path)
    capture = read_manifest(Path(saved["manifest"]), saved["allow_outside"])
    steps = tuple(Step(**step) for step in saved["steps"])
    return Plan(capture, out, steps[-1].name, saved["threads"], steps)


def run_job(out: Path, job: str, pose: str | None) -> None:
    """Run those steps of a planned job that have no current result.

    Parameters
    ----------
    out : Path
        Folder of the result, with the plan in it.
    job : str
        `scan`, `track`, `refine` or `final`.
    pose : str or None
        The pose, for jobs of one pose.

    Raises
    ------
    StageError
        If a step failed; its marker says why, its log has the details.
    """
    die_with_parent()
    plan = read_plan(out)
    steps = plan.job_steps(job, pose)
    if not steps:
        raise InputError(f"{out / PLAN_FILE}: no job {job}{' of ' + pose if pose else ''}")
    markers = Markers(out)
    for step in steps:
        if markers.finished(step) is None:
            _run_step(plan, step, markers)
    markers.job_done(job, pose).touch()


def die_with_parent() -> None:
    """Ask the system to end this process when the process that started it ends, however that one ended."""
    parent_death_signal = 1  # PR_SET_PDEATHSIG of <linux/prctl.h>
    if sys.platform == "linux":
        ctypes.CDLL(None, use_errno=True).prctl(parent_death_signal, signal.SIGKILL, 0, 0, 0)


def log_path(out: Path, step: Step) -> Path:
    """The log of a step."""
    return out / "logs" / f"{step.identifier}.log"


def collect_timings(plan: Plan) -> dict[str, dict[str, float]]:
    """Write `work/timings.json`: seconds, CPU seconds and peak memory of every finished step of a plan."""
    markers = Markers(plan.out)
    rows = {}
    for step in plan.steps:
        record = markers.finished(step)
        if record is not None:
            rows[step.identifier] = {name: record[name] for name in ("seconds", "cpu_seconds", "peak_memory_mb")}
    write_json(plan.out / "work" / "timings.json", rows)
    return rows


def _run_step(plan: Plan, step: Step, markers: Markers) -> None:
    log = log_path(plan.out, step)
    log.parent.mkdir(parents=True, exist_ok=True)
    markers.begin(step, time.time())
    clock, cpu = time.perf_counter(), _cpu_seconds()
    if step.name == "report":
        collect_timings(plan)
    with _output_to(log):
        try:
            STEP_CALLS[step.name](StepContext(plan.capture, plan.out, step.pose, plan.threads))
        except Exception as error:
            traceback.print_exc()
            markers.fail(step, _failure(step, error, log))
            raise StageError(f"{step.title} failed; log {log}") from error
    usage = resource.getrusage(resource.RUSAGE_SELF)
    markers.finish(
        step,
        {
            "seconds": round(time.perf_counter() - clock, 3),
            "cpu_seconds": round(_cpu_seconds() - cpu, 3),
            "peak_memory_mb": round(usage.ru_maxrss / 1024, 1),
        },
    )


def _failure(step: Step, error: Exception, log: Path) -> Failure:
    text = " ".join(str(error).split()) or type(error).__name__
    if not isinstance(error, CaptureEvalError):
        text = f"{type(error).__name__}: {text}"
    return Failure(step.title, text, str(log), isinstance(error, InputError))


def _cpu_seconds() -> float:
    own, children = resource.getrusage(resource.RUSAGE_SELF), resource.getrusage(resource.RUSAGE_CHILDREN)
    return own.ru_utime + own.ru_stime + children.ru_utime + children.ru_stime


@contextmanager
def _output_to(log: Path) -> Iterator[None]:
    """Send everything this process says, native libraries included, to a log file."""
    logger = logging.getLogger("capture_eval")
    sys.stdout.flush()
    sys.stderr.flush()
    saved = os.dup(1), os.dup(2)
    with log.open("w", encoding="utf-8", buffering=1) as stream:
        handler = logging.StreamHandler(stream)
        handler.setFormatter(logging.Formatter("%(asctime)s %(message)s", "%H:%M:%S"))
        logger.addHandler(handler)
        logger.setLevel(logging.INFO)
        os.dup2(stream.fileno(), 1)
        os.dup2(stream.fileno(), 2)
        try:
            yield
        finally:
            sys.stdout.flush()
            sys.stderr.flush()
            logger.removeHandler(handler)
            os.dup2(saved[0], 1)
            os.dup2(saved[1], 2)
            os.close(saved[0])
            os.close(saved[1])
