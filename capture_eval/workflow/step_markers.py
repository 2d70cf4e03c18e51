"""Markers in `work/steps/`: what has been done, what is being done, what failed.

A marker is renamed into place after the stage function has returned, so a killed step leaves none.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from capture_eval.errors import CaptureEvalError
from capture_eval.files.atomic import read_json, write_json
from capture_eval.workflow.plan import Plan, Step
from capture_eval.workflow.step_calls import STEP_OUTPUTS


@dataclass(frozen=True)
class Failure:
    """Why a step ended badly."""

    step: str
    message: str
    log: str
    bad_input: bool


class Markers:
    """The markers of one result folder."""

    def __init__(self, out: Path) -> None:
        self._out = out
        self.folder = out / "work" / "steps"

    def finished(self, step: Step) -> dict[str, Any] | None:
        """The record of a finished step, or None if its result is missing or belongs to other inputs."""
        record = _read(self._path(step, "json"))
        if record is None or record.get("key") != step.key:
            return None
        outputs = (self._out / name.format(pose=step.pose) for name in STEP_OUTPUTS.get(step.name, ()))
        return record if all(path.is_file() for path in outputs) else None

    def reason(self, step: Step) -> str:
        """Why a step that is not finished has to run."""
        record = _read(self._path(step, "json"))
        if record is None:
            return "no result yet"
        return "its inputs, options or tools changed" if record.get("key") != step.key else "its files are missing"

    def running(self, step: Step) -> dict[str, Any] | None:
        """The record of a step whose process is alive on this machine."""
        record = _read(self._path(step, "running"))
        if record is None:
            return None
        if record.get("host") == os.uname().nodename and not Path(f"/proc/{record.get('process')}").exists():
            return None
        return record

    def begun(self, step: Step) -> bool:
        """Whether the step was begun and neither finished nor failed."""
        return self._path(step, "running").is_file()

    def failure(self, step: Step) -> Failure | None:
        """Why the step failed, if it did."""
        record = _read(self._path(step, "failed"))
        return None if record is None else Failure(**record)

    def begin(self, step: Step, started: float) -> None:
        """Say that this process works on a step; what an earlier try left behind is removed."""
        self.forget(step)
        write_json(
            self._path(step, "running"),
            {"process": os.getpid(), "host": os.uname().nodename, "started": started},
        )

    def finish(self, step: Step, record: dict[str, Any]) -> None:
        """Say that a step is done."""
        write_json(self._path(step, "json"), {"key": step.key} | record)
        self._path(step, "running").unlink(missing_ok=True)

    def fail(self, step: Step, failure: Failure) -> None:
        """Say that a step failed."""
        write_json(self._path(step, "failed"), vars(failure))
        self._path(step, "running").unlink(missing_ok=True)

    def forget(self, step: Step) -> None:
        """Remove all markers of a step, so that it runs again."""
        for kind in ("json", "running", "failed"):
            self._path(step, kind).unlink(missing_ok=True)

    def job_done(self, job: str, pose: str | None) -> Path:
        """The file by which the engine sees that a job is done."""
        return self.folder / (f"{job}.done" if pose is None else f"{job}_{pose}.done")

    def clear_for_run(self, plan: Plan) -> list[Step]:
        """Forget failures and half-done work, tell the engine which jobs are not current, return the steps to run."""
        pending = [step for step in plan.steps if self.finished(step) is None]
        for step in plan.steps:
            self._path(step, "failed").unlink(missing_ok=True)
            self._path(step, "running").unlink(missing_ok=True)
        waiting = {(step.job, step.pose) for step in pending}
        for job, pose in plan.jobs:
            if (job, pose) in waiting:
                self.job_done(job, pose).unlink(missing_ok=True)
            else:
                self.job_done(job, pose).parent.mkdir(parents=True, exist_ok=True)
                self.job_done(job, pose).touch()
        return pending

    def _path(self, step: Step, kind: str) -> Path:
        return self.folder / f"{step.identifier}.{kind}"


def _read(path: Path) -> dict[str, Any] | None:
    if not path.is_file():
        return None
    try:
        record = read_json(path)
    except CaptureEvalError:
        return None
    return record if isinstance(record, dict) else None
