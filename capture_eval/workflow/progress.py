"""What a person sees while a run works: the markers of its steps and the last lines of their logs."""

from __future__ import annotations

import re
import sys
import time
from typing import Protocol, TextIO

from capture_eval.workflow.plan import Plan, Step
from capture_eval.workflow.step_markers import Markers
from capture_eval.workflow.step_runner import log_path

SILENCE_SECONDS = 20.0  # plain output says what is being worked on at least this often
_LOG_TIME = re.compile(r"^\d\d:\d\d:\d\d ")


class Progress(Protocol):
    """Something that is told every half second that time has passed."""

    def update(self) -> None:
        """Look at the markers and say what is new."""

    def close(self) -> None:
        """Say the last things."""


def make_progress(plan: Plan, pending: list[Step], stream: TextIO | None = None) -> Progress:
    """A live table on a terminal, plain lines elsewhere."""
    stream = sys.stderr if stream is None else stream
    return LiveProgress(plan, pending) if stream.isatty() else PlainProgress(plan, pending, stream)


def duration(seconds: float) -> str:
    """Seconds as 8 s, 3 min 05 s or 1 h 02 min."""
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60:02d} s"
    return f"{whole // 3600} h {whole % 3600 // 60:02d} min"


class _Watcher:
    """Which steps have finished since the last look, and which are being worked on."""

    def __init__(self, plan: Plan, pending: list[Step]) -> None:
        self._plan = plan
        self._waiting = list(pending)
        self._markers = Markers(plan.out)
        self.total = len(plan.steps)
        self.done = self.total - len(pending)
        self.started = time.monotonic()

    def newly_finished(self) -> list[tuple[Step, float]]:
        found = []
        for step in list(self._waiting):
            record = self._markers.finished(step)
            if record is not None:
                self._waiting.remove(step)
                found.append((step, float(record["seconds"])))
        return found

    def running(self) -> list[tuple[Step, float, str]]:
        """Steps at work, seconds so far and the last line of their log."""
        found = []
        for step in self._waiting:
            record = self._markers.running(step)
            if record is not None:
                found.append((step, time.time() - float(record["started"]), self._last_line(step)))
        return found

    def _last_line(self, step: Step) -> str:
        """The last line that the suite itself logged (native libraries write other things)."""
        try:
            with log_path(self._plan.out, step).open("rb") as stream:
                stream.seek(max(0, stream.seek(0, 2) - 4096))
                lines = stream.read().decode("utf-8", "replace").splitlines()
        except OSError:
            return ""
        for line in reversed(lines):
            if _LOG_TIME.match(line):
                text = line[9:].strip()
                return text.removeprefix(step.title).lstrip(": ")
        return ""


class PlainProgress:
    """One line for every finished step, and a sign of life when nothing finishes."""

    def __init__(self, plan: Plan, pending: list[Step], stream: TextIO) -> None:
        self._watcher = _Watcher(plan, pending)
        self._stream = stream
        self._last_said = time.monotonic()

    def update(self) -> None:
        """Say what is new."""
        for step, seconds in self._watcher.newly_finished():
            self._watcher.done += 1
            self._say(f"{step.title} done in {duration(seconds)}")
        if time.monotonic() - self._last_said > SILENCE_SECONDS:
            at_work = [f"{step.title} {text}".rstrip() for step, _, text in self._watcher.running()]
            self._say("working on " + ("; ".join(at_work) if at_work else "the start of the next job"))

    def close(self) -> None:
        """Say what finished last."""
        self.update()

    def _say(self, text: str) -> None:
        watcher = self._watcher
        elapsed = duration(time.monotonic() - watcher.started)
        print(f"[{elapsed}] {watcher.done}/{watcher.total} {text}", file=self._stream, flush=True)
        self._last_said = time.monotonic()


class LiveProgress:
    """A bar for the run and a line for every step at work, redrawn in place."""

    def __init__(self, plan: Plan, pending: list[Step]) -> None:
        from rich.console import Console
        from rich.live import Live

        self._watcher = _Watcher(plan, pending)
        self._live = Live(console=Console(stderr=True), refresh_per_second=4, transient=True)
        self._live.start()

    def update(self) -> None:
        """Redraw."""
        from rich.progress_bar import ProgressBar
        from rich.table import Table
        from rich.text import Text

        watcher = self._watcher
        for step, seconds in watcher.newly_finished():
            watcher.done += 1
            self._live.console.print(Text(f"{step.title} done in {duration(seconds)}", style="green"))
        table = Table.grid(padding=(0, 1))
        table.add_row(
            Text(f"{watcher.done}/{watcher.total} steps", style="bold"),
            ProgressBar(total=watcher.total, completed=watcher.done, width=40),
            Text(duration(time.monotonic() - watcher.started)),
        )
        for step, seconds, text in watcher.running():
            table.add_row(
                Text(f"  {step.title}"), Text(text, overflow="ellipsis", no_wrap=True), Text(duration(seconds))
            )
        self._live.update(table)

    def close(self) -> None:
        """Draw the last state and leave the terminal as it was."""
        self.update()
        self._live.stop()
