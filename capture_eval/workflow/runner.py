"""``run``: work out what has to be done and let Snakemake do it, as a command of the same environment.

Snakemake brings the order of jobs, jobs side by side within cores and memory, and executors for clusters. Which
results are current is decided here by keys (see :mod:`capture_eval.workflow.plan`), so that a killed run, a touched
file or a copied folder neither repeats work nor believes anything half-written.
"""

from __future__ import annotations

import fcntl
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING

import capture_eval
from capture_eval.errors import InputError, StageError, ToolError
from capture_eval.workflow.inputs import hash_memory, write_inputs
from capture_eval.workflow.plan import FIRST_STEP_OF_STAGE, JOBS, JOBS_OF_POSES, Plan, Step, make_plan
from capture_eval.workflow.progress import make_progress
from capture_eval.workflow.step_markers import Failure, Markers
from capture_eval.workflow.step_runner import collect_timings, die_with_parent, log_path, write_plan

if TYPE_CHECKING:
    from capture_eval.files.manifest_files import Capture

POLL_SECONDS = 0.25
DISK_FULL_BYTES = 20_000_000
# Peaks measured with 24 photos of 640x480 were 1.2, 0.8, 0.8 and 0.7 GB; twice that leaves room for larger photos.
MEMORY_MB = {"scan": 2500, "track": 1600, "refine": 1600, "final": 1400}
THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS", "MKL_NUM_THREADS")


@dataclass(frozen=True)
class RunOptions:
    """How a run is driven; none of it changes results except `threads`.

    Attributes
    ----------
    cores : int
        Jobs side by side times threads inside a job.
    until, force : str or None
        Last stage; stage to repeat although its result is current.
    threads : int
        Threads inside a stage. With more than one, results do not repeat bit for bit.
    executor, profile : str or None
        Handed to Snakemake.
    engine_arguments : tuple of str
        More arguments for Snakemake.
    """

    cores: int = 1
    until: str | None = None
    force: str | None = None
    threads: int = 1
    executor: str | None = None
    profile: str | None = None
    engine_arguments: tuple[str, ...] = ()


def plan_run(capture: Capture, out: Path, options: RunOptions) -> tuple[Plan, list[Step]]:
    """The plan of a run and the steps that have to run, without running anything.

    Raises
    ------
    InputError
        If an input cannot be read or a stage does not exist.
    """
    hashes = hash_memory(out)
    plan = make_plan(capture, out, options.until, options.threads, hashes)
    if out.is_dir():
        hashes.save()
    markers = Markers(out)
    forced = _forced(plan, options.force)
    return plan, [step for step in plan.steps if step in forced or markers.finished(step) is None]


def run(capture: Capture, out: Path, options: RunOptions) -> Plan:
    """Run everything that has no current result.

    Parameters
    ----------
    capture : Capture
        The manifest and its folder.
    out : Path
        Folder of the result; made if it is missing.
    options : RunOptions
        How to drive it.

    Raises
    ------
    InputError
        If the input is bad or another run works in the same folder.
    StageError
        If a stage failed; names the stage, the pose and the log.
    ToolError
        If the engine itself failed.
    """
    out = out.resolve()
    out.mkdir(parents=True, exist_ok=True)
    with _only_run_in(out):
        plan, pending = plan_run(capture, out, options)
        markers = Markers(out)
        for step in _forced(plan, options.force):
            markers.forget(step)
        markers.clear_for_run(plan)
        if pending:
            write_inputs(capture, out)
            write_plan(plan)
            _drive(plan, pending, options)
        collect_timings(plan)
    return plan


def _forced(plan: Plan, stage: str | None) -> list[Step]:
    """Steps to repeat: the stage's own and all after them."""
    if stage is None:
        return []
    if stage not in FIRST_STEP_OF_STAGE:
        raise InputError(f"--force {stage}: no such stage; stages are {', '.join(FIRST_STEP_OF_STAGE)}")
    order = [name for names in JOBS.values() for name in names]
    first = order.index(FIRST_STEP_OF_STAGE[stage])
    return [step for step in plan.steps if order.index(step.name) >= first]


@contextmanager
def _only_run_in(out: Path) -> Iterator[None]:
    """Hold the lock of a result folder; the system lets go of it when the process ends, however it ends."""
    try:
        stream = (out / ".lock").open("w")
    except OSError as error:
        raise InputError(f"{out}: cannot write there ({error.strerror})") from None
    with stream:
        try:
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise InputError(f"{out}: another run works in this folder; wait for it or choose another --out") from None
        yield


def _drive(plan: Plan, pending: list[Step], options: RunOptions) -> None:
    """Start the engine, watch it, and say what came of it."""
    logs = plan.out / "logs"
    logs.mkdir(exist_ok=True)
    engine_log = logs / "snakemake.log"
    command = engine_command(plan, options)
    with engine_log.open("w", encoding="utf-8") as stream:
        print(" ".join(command), file=stream, flush=True)
        engine = subprocess.Popen(
            command,
            stdout=stream,
            stderr=subprocess.STDOUT,
            stdin=subprocess.DEVNULL,
            env=_environment(options.threads),
            start_new_session=True,
            preexec_fn=die_with_parent,
        )
    progress = make_progress(plan, pending)
    try:
        while engine.poll() is None:
            progress.update()
            time.sleep(POLL_SECONDS)
    except BaseException:
        _end(engine)
        raise
    finally:
        progress.close()
    _judge(plan, engine.returncode, engine_log)


def engine_command(plan: Plan, options: RunOptions) -> list[str]:
    """The Snakemake command line for a plan."""
    markers = Markers(plan.out)
    targets = [str(markers.job_done(job, pose)) for job, pose in plan.jobs]
    config = {
        "python": sys.executable,
        "out": str(plan.out),
        "done": str(markers.folder),
        "poses": plan.capture.manifest.pose_names,
        "threads": options.threads,
        "gpu": int(_uses_gpu(plan.capture)),
        "memory_mb": MEMORY_MB,
        "targets": targets,
    }
    config_file = plan.out / "work" / "engine.json"
    config_file.write_text(json.dumps(config, indent=2), encoding="utf-8")
    snakefile = Path(capture_eval.__file__).parent / "workflow" / "Snakefile"
    command = [sys.executable, "-m", "snakemake", "--snakefile", str(snakefile), "--configfile", str(config_file)]
    command += ["--directory", str(plan.out / "work"), "--nolock", "--rerun-incomplete", "--rerun-triggers", "mtime"]
    command += ["--resources", f"mem_mb={_memory_mb()}", "gpu=1", "--latency-wait", "15", "--nocolor"]
    if options.executor is None:
        command += ["--cores", str(max(options.cores, options.threads)), "--scheduler", "greedy"]
    else:
        command += ["--executor", options.executor, "--jobs", str(options.cores)]
    if options.profile is not None:
        command += ["--profile", options.profile]
    return [*command, *options.engine_arguments]


def _environment(threads: int) -> dict[str, str]:
    """Environment of the engine and its jobs: this package importable, so many threads, a fixed order of sets."""
    package_parent = str(Path(capture_eval.__file__).parents[1])
    path = os.environ.get("PYTHONPATH")
    environment = dict(os.environ)
    environment["PYTHONPATH"] = package_parent if not path else f"{package_parent}{os.pathsep}{path}"
    environment["PYTHONHASHSEED"] = "0"
    environment["MPLBACKEND"] = "agg"
    return environment | dict.fromkeys(THREAD_VARIABLES, str(threads))


def _uses_gpu(capture: Capture) -> bool:
    back_end = capture.manifest.dense.back_end
    if back_end != "auto":
        return back_end == "cuda"
    try:
        metadata.version("pycolmap-cuda12")
    except metadata.PackageNotFoundError:
        return False
    return True


def _memory_mb() -> int:
    """Memory that jobs side by side may ask for: nearly all there is, and never less than one job asks for."""
    import psutil

    return max(int(0.9 * psutil.virtual_memory().total / 2**20), *MEMORY_MB.values())


def _end(engine: subprocess.Popen[bytes]) -> None:
    """End the engine and every job it started."""
    with suppress(ProcessLookupError):
        os.killpg(engine.pid, signal.SIGKILL)
    engine.wait()


def _judge(plan: Plan, code: int, engine_log: Path) -> None:
    markers = Markers(plan.out)
    unfinished = [step for step in plan.steps if markers.finished(step) is None]
    failures = [failure for step in plan.steps if (failure := markers.failure(step)) is not None]
    if not failures:
        failures = [_killed(plan, step) for step in unfinished if markers.begun(step)]
    if failures:
        raise _as_error(failures)
    if code != 0 or unfinished:
        raise ToolError(f"the engine (snakemake) ended with code {code}; see {engine_log}")


def _killed(plan: Plan, step: Step) -> Failure:
    text = "its process was killed (out of memory? see `dmesg`) or crashed"
    if shutil.disk_usage(plan.out).free < DISK_FULL_BYTES:
        text = f"the disk of {plan.out} is full"
    return Failure(step.title, text, str(log_path(plan.out, step)), False)


def _as_error(failures: Sequence[Failure]) -> Exception:
    first = failures[0]
    more = f" (and {len(failures) - 1} more failed)" if len(failures) > 1 else ""
    text = f"stage {first.step} failed: {first.message}; log {first.log}{more}"
    return InputError(text) if first.bad_input else StageError(text)


# jobs of poses are named here so that the Snakefile and the plan cannot drift apart unnoticed (a test compares them)
ENGINE_RULES = {job: job in JOBS_OF_POSES for job in JOBS}
