"""A counter for work that takes more than a moment: a bar on a terminal, now and then a line elsewhere."""

from __future__ import annotations

import logging
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

SILENCE_SECONDS = 5.0


@contextmanager
def counting_progress(what: str) -> Iterator[Callable[[int, int], None]]:
    """Give a function to call with (done, total).

    Parameters
    ----------
    what : str
        What is counted, as "photos checked".
    """
    if sys.stderr.isatty():
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
        with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
            task = bar.add_task(what, total=None)
            yield lambda done, total: bar.update(task, completed=done, total=total)
        return
    last = [time.monotonic()]

    def say(done: int, total: int) -> None:
        if time.monotonic() - last[0] > SILENCE_SECONDS:
            print(f"{done}/{total} {what}", file=sys.stderr, flush=True)
            last[0] = time.monotonic()

    yield say


@contextmanager
def stage_messages() -> Iterator[None]:
    """Show what stages log while they work, one line each, on standard error."""
    logger = logging.getLogger("capture_eval")
    handler = logging.StreamHandler(sys.stderr)
    logger.addHandler(handler)
    logger.setLevel(logging.INFO)
    try:
        yield
    finally:
        logger.removeHandler(handler)
