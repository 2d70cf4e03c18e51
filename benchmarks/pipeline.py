"""The whole job, measured: wall time, memory of all its processes, time by stage, accuracy against the known truth.

    python benchmarks/pipeline.py OUT mannequin --views 16
    python benchmarks/pipeline.py OUT makehuman --makehuman DIR --motion jaw_open --timing power:2 --views 24

Prints Markdown tables and saves `OUT/measured.json`. A capture or result that is already in OUT is used as it is, so
the table of an earlier run can be printed again; its wall time is then that of a run with nothing left to do.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import psutil

SAMPLE_SECONDS = 0.2


class PeakMemory:
    """Largest sum of the proportional memory (PSS) of a process and everything it started."""

    def __init__(self, process: psutil.Process) -> None:
        self._process = process
        self._stop = threading.Event()
        self.bytes = 0
        self._thread = threading.Thread(target=self._watch, daemon=True)
        self._thread.start()

    def _watch(self) -> None:
        while not self._stop.wait(SAMPLE_SECONDS):
            total = 0
            try:
                members = [self._process, *self._process.children(recursive=True)]
            except psutil.Error:
                continue
            for member in members:
                try:
                    total += member.memory_full_info().pss
                except psutil.Error:
                    continue
            self.bytes = max(self.bytes, total)

    def stop(self) -> None:
        """Stop looking."""
        self._stop.set()
        self._thread.join()


def measured_command(arguments: Sequence[str]) -> dict[str, float]:
    """Run a command of the suite; its wall seconds and peak memory."""
    start = time.perf_counter()
    with subprocess.Popen([sys.executable, "-m", "capture_eval", *arguments]) as process:
        memory = PeakMemory(psutil.Process(process.pid))
        code = process.wait()
        memory.stop()
    if code != 0:
        raise SystemExit(f"capture-eval {' '.join(arguments)}: exit code {code}")
    return {"wall_seconds": time.perf_counter() - start, "peak_memory_gb": memory.bytes / 1e9}


def stage_table(timings: dict[str, dict[str, float]]) -> dict[str, dict[str, float]]:
    """Seconds summed over poses, and the largest memory, by stage."""
    table: dict[str, dict[str, float]] = {}
    for step, row in timings.items():
        stage = step.split("_pose_")[0]
        sums = table.setdefault(stage, {"jobs": 0, "seconds": 0.0, "cpu_seconds": 0.0, "peak_memory_mb": 0.0})
        sums["jobs"] += 1
        sums["seconds"] += row["seconds"]
        sums["cpu_seconds"] += row["cpu_seconds"]
        sums["peak_memory_mb"] = max(sums["peak_memory_mb"], row["peak_memory_mb"])
    return table


def print_stages(name: str, measured: dict[str, Any], cores: int) -> None:
    """Times by stage, the share of the engine, memory."""
    print(f"\n### {name}\n")
    print("| stage | jobs | wall s, summed over jobs | CPU s | peak MB of a job |\n| --- | --- | --- | --- | --- |")
    for stage, row in measured["stages"].items():
        times = f"{row['seconds']:.1f} | {row['cpu_seconds']:.1f}"
        print(f"| {stage} | {row['jobs']} | {times} | {row['peak_memory_mb']:.0f} |")
    photos, run = measured["synthesize"], measured["run"]
    total = sum(row["seconds"] for row in measured["stages"].values())
    print(f"\nsynthesize {photos['wall_seconds']:.0f} s, {photos['peak_memory_gb']:.2f} GB; ", end="")
    print(f"run {run['wall_seconds']:.0f} s, {run['peak_memory_gb']:.2f} GB with {cores} jobs side by side; ", end="")
    print(f"sum of the stages {total:.0f} s")


def print_accuracy(truth: dict[str, Any], comparison: dict[str, Any]) -> None:
    """Tracking and surface error per pose, and the errors of the methods from photos beside those from the truth."""
    print(f"\n{truth['seen_vertices']} vertices seen in every pose, ", end="")
    print(f"{100 * truth['confident_share_of_seen']:.0f} % of them confident. Median / p95, % of D:\n")
    print("| pose | t | tracking, seen | surface, seen | tracking, confident | surface, confident |")
    print("| --- | --- | --- | --- | --- | --- |")
    for row in truth["tracking"]:
        if row["status"] != "ok":
            print(f"| {row['pose']} | {row['t']:g} | {row['status']} | | | |")
            continue
        cells = []
        for region in ("seen", "confident"):
            figures = row["regions"].get(region, {})
            cells += [_pair(figures, "median", "p95"), _pair(figures, "surface_median", "surface_p95")]
        print(f"| {row['pose']} | {row['t']:g} | {' | '.join(cells)} |")
    print("\n| method | LAE photos | LAE truth | ratio | LME photos | LME truth | ratio | largest E_A difference |")
    print("| --- | --- | --- | --- | --- | --- | --- | --- |")
    for name, row in comparison["methods"].items():
        print(
            f"| {name} | {100 * row['LAE_photos']:.3f} | {100 * row['LAE_truth']:.3f} | {row['LAE_ratio']:.3f} "
            f"| {100 * row['LME_photos']:.3f} | {100 * row['LME_truth']:.3f} | {row['LME_ratio']:.3f} "
            f"| {100 * row['largest_E_A_difference']:.3f} ({row['largest_E_A_difference_at']['curve']}) |"
        )
    print(f"\norder of methods as in the truth: LAE {comparison['order_LAE']['same']}, ", end="")
    print(f"LME {comparison['order_LME']['same']}")


def _pair(figures: dict[str, Any], first: str, second: str) -> str:
    if first not in figures:
        return "–"
    return f"{100 * figures[first]:.3f} / {100 * figures[second]:.3f}"


def main() -> None:
    """Parse flags, run, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("dataset", choices=["mannequin", "makehuman"])
    parser.add_argument("--makehuman", type=Path)
    parser.add_argument("--motion", default="jaw_open")
    parser.add_argument("--timing", default="linear")
    parser.add_argument("--poses", default="11")
    parser.add_argument("--views", default="24")
    parser.add_argument("--size", default="640x480")
    parser.add_argument("--cores", type=int, default=2)
    options = parser.parse_args()
    capture, result = options.out / "capture", options.out / "result"
    photos = ["synthesize", options.dataset, "--out", str(capture), "--motion", options.motion]
    photos += ["--timing", options.timing, "--poses", options.poses, "--views", options.views, "--size", options.size]
    photos += ["--cores", str(options.cores)]
    if options.makehuman is not None:
        photos += ["--makehuman", str(options.makehuman)]
    measured: dict[str, Any] = {"arguments": photos, "synthesize": measured_command(photos)}
    run = ["run", str(capture / "manifest.yaml"), "--out", str(result), "--cores", str(options.cores)]
    measured["run"] = measured_command(run)
    measured["stages"] = stage_table(json.loads((result / "work" / "timings.json").read_text()))
    (options.out / "measured.json").write_text(json.dumps(measured, indent=2))
    name = f"{options.dataset} {options.motion} {options.timing}, {options.poses} poses x {options.views} photos"
    print_stages(f"{name} at {options.size}", measured, options.cores)
    report = result / "report"
    print_accuracy(*(json.loads((report / f"{file}.json").read_text()) for file in ("truth", "truth_comparison")))


if __name__ == "__main__":
    main()
