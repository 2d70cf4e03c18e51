"""``capture-eval check``: the nightly gate."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def check(
    result: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of a finished run or comparison.")],
    baseline: Annotated[Path, typer.Option(help="The baseline file (JSON).")],
    update: Annotated[bool, typer.Option("--update", help="Write the result as the new baseline.")] = False,
    everything: Annotated[bool, typer.Option("--all", help="Show what is good too.")] = False,
) -> None:
    """The nightly gate: fail when a result got worse.

    Exit code 1 and a table when a metric is worse than the baseline by more than its tolerance, when a pose, photo or
    curve went missing, or when an input is another file.

    Example: capture-eval check result --baseline reports/baselines/mannequin.json
    """
    from capture_eval.stages.check import check_result, update_baseline

    if update:
        record = update_baseline(result, baseline)
        print(f"{baseline}: {len(record.metrics)} metrics of {record.name}")
        return
    findings = check_result(result, baseline)
    bad = [finding for finding in findings if finding.bad]
    shown = findings if everything else bad
    if shown:
        rows = [("", "", "baseline", "now", "allowed")]
        rows += [("WORSE" if f.bad else "ok", f.what, f.before, f.now, f.allowed) for f in shown]
        widths = [max(len(row[column]) for row in rows) for column in range(5)]
        for row in rows:
            print("  ".join(text.ljust(width) for text, width in zip(row, widths, strict=True)).rstrip())
    if bad:
        print(f"{len(bad)} of {len(findings)} checks failed against {baseline}")
        raise typer.Exit(1)
    print(f"good: {len(findings)} checks against {baseline}")
