"""What the engine costs: time of a whole `run` against the sum of its stages, in the same run.

    python benchmarks/engine_overhead.py capture/manifest.yaml --out build/engine

Runs into a new folder with one core, so that stages never overlap and their times add up. Wall time is what a user
waits for; CPU time does not depend on what else the machine does. Prints a Markdown table.
"""

from __future__ import annotations

import argparse
import json
import resource
import shutil
import subprocess
import sys
import time
from pathlib import Path


def main() -> None:
    """Run, measure, print."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("manifest", type=Path)
    parser.add_argument("--out", type=Path, default=Path("build/engine"))
    parser.add_argument("--until", default=None)
    arguments = parser.parse_args()
    shutil.rmtree(arguments.out, ignore_errors=True)
    command = [sys.executable, "-m", "capture_eval", "run", str(arguments.manifest), "--out", str(arguments.out)]
    if arguments.until:
        command += ["--until", arguments.until]
    started = time.perf_counter()
    subprocess.run(command, check=True)
    wall = time.perf_counter() - started
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = usage.ru_utime + usage.ru_stime
    started = time.perf_counter()
    subprocess.run(command, check=True)
    again = time.perf_counter() - started
    rows = json.loads((arguments.out / "work" / "timings.json").read_text()).values()
    stage_wall = sum(row["seconds"] for row in rows)
    stage_cpu = sum(row["cpu_seconds"] for row in rows)
    print("| | whole run | sum of stages | engine | share |")
    print("| --- | --- | --- | --- | --- |")
    for name, whole, stages in (("wall, s", wall, stage_wall), ("CPU, s", cpu, stage_cpu)):
        print(f"| {name} | {whole:.1f} | {stages:.1f} | {whole - stages:.1f} | {(whole - stages) / stages:.1%} |")
    print(f"\n{len(rows)} stages; the same command again, with nothing to do: {again:.1f} s")


if __name__ == "__main__":
    main()
