"""``capture-eval doctor``: what this machine can do."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def doctor(
    folder: Annotated[
        Path, typer.Option("--out", help="Folder where results would go (its free space is shown).")
    ] = Path(),
) -> None:
    """Say what this machine can do and what it lacks.

    The exit code is 1 if something stops work.

    Example: capture-eval doctor
    """
    from capture_eval.stages.doctor import diagnose

    rows = diagnose(folder)
    width = max(len(row.what) for row in rows)
    for row in rows:
        advice = f"  ({row.advice})" if row.advice and not (row.good and row.what == "writable") else ""
        print(f"{'ok ' if row.good else 'NO '} {row.what:<{width}}  {row.value}{advice}")
    missing = [row.advice.removeprefix("apt-get install ") for row in rows if row.advice.startswith("apt-get install ")]
    if missing:
        print(f"\nMissing system packages (Debian/Ubuntu): apt-get install {' '.join(missing)}")
    if not all(row.good for row in rows):
        raise typer.Exit(1)
