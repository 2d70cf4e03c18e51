"""Do results repeat? Kills a run at random moments and resumes it, and compares clean runs, byte for byte.

    python benchmarks/determinism.py CAPTURE/manifest.yaml OUT [--kills 5] [--seed 0] [--cores 2]

Three runs: a clean one, a second clean one, and one whose every process is killed (SIGKILL) at random moments and
which is started again each time. Every file that comes with the report, and every scan and registration before it,
is compared by SHA-256.
"""

from __future__ import annotations

import argparse
import hashlib
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil

COMPARED = (
    "report/errors.csv",
    "report/summary.json",
    "report/registered.npz",
    "report/curves.npz",
    "work/align/alignment.npz",
    "work/*/scan.ply",
    "work/*/sparse/points3D.bin",
    "work/*/registered.npz",
    "report/table_*",
    "report/figures/*",
)


def command(manifest: Path, out: Path, cores: int) -> list[str]:
    """The run as a user types it."""
    return [sys.executable, "-m", "capture_eval", "run", str(manifest), "--out", str(out), "--cores", str(cores)]


def clean_run(manifest: Path, out: Path, cores: int) -> float:
    """Run from nothing; seconds."""
    start = time.perf_counter()
    subprocess.run(command(manifest, out, cores), check=True, stdout=subprocess.DEVNULL)
    return time.perf_counter() - start


def killed_run(manifest: Path, out: Path, cores: int, kills: int, seconds: float, seed: int) -> int:
    """Start the run, kill all of it at a random moment, as often as asked, then let it finish; kills that hit."""
    generator = random.Random(seed)
    moments = sorted(generator.uniform(0.05, 0.95) * seconds for _ in range(kills))
    waits = [later - sooner for sooner, later in zip([0.0, *moments], moments, strict=False)]
    hits = 0
    for wait in waits:
        process = subprocess.Popen(command(manifest, out, cores), stdout=subprocess.DEVNULL)
        try:
            process.wait(timeout=wait + 2.0)  # two seconds for the start-up, so that a resumed run gets on
            break
        except subprocess.TimeoutExpired:
            process.send_signal(signal.SIGKILL)
            process.wait()
            hits += 1
            survivors = [p for p in psutil.process_iter(["cmdline"]) if str(out) in " ".join(p.info["cmdline"] or [])]
            _, alive = psutil.wait_procs(survivors, timeout=5)
            if alive:
                print(f"still alive after the kill: {[p.pid for p in alive]}")
    subprocess.run(command(manifest, out, cores), check=True, stdout=subprocess.DEVNULL)
    return hits


def digests(out: Path) -> dict[str, str]:
    """SHA-256 of every compared file."""
    files = sorted({path for pattern in COMPARED for path in out.glob(pattern)})
    return {str(path.relative_to(out)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


def compare(name: str, first: dict[str, str], second: dict[str, str]) -> bool:
    """Print a row; True when all files are the same."""
    different = sorted(file for file in first.keys() | second.keys() if first.get(file) != second.get(file))
    print(f"| {name} | {len(first)} | {'identical' if not different else 'differ: ' + ', '.join(different)} |")
    return not different


def main() -> None:
    """Parse flags, run, compare; exit code 1 when something differs."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("manifest", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--kills", type=int, default=5)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--cores", type=int, default=2)
    options = parser.parse_args()
    seconds = clean_run(options.manifest, options.out / "first", options.cores)
    clean_run(options.manifest, options.out / "second", options.cores)
    hits = killed_run(options.manifest, options.out / "killed", options.cores, options.kills, seconds, options.seed)
    first = digests(options.out / "first")
    print("| against a clean run | files | result |\n| --- | --- | --- |")
    same = compare("second clean run", first, digests(options.out / "second"))
    same &= compare(f"killed {hits} times and resumed", first, digests(options.out / "killed"))
    raise SystemExit(0 if same else 1)


if __name__ == "__main__":
    main()
