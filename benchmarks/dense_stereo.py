"""Accuracy, completeness, time and memory of dense stereo and surface on rendered heads, against truth and peers.

    python benchmarks/dense_stereo.py --makehuman DIR            measure what is missing, then tables and plots
    python benchmarks/dense_stereo.py --only 'heads/*' --force   measure these again
    python benchmarks/dense_stereo.py --report                   tables and plots from the saved results only

Every case is rendered, reconstructed and measured in processes of its own; its figures go to results/dense_stereo.json
at once, and a case that is there is not repeated. Cases of MakeHuman heads need a checkout of MakeHuman (or
`capture-eval data fetch makehuman`); OpenMVS is measured where its programs are on PATH. Threads are only worth
measuring on a quiet machine: --only 'threads/*'. All cases take about an hour of one core.
"""

from __future__ import annotations

import argparse
import fnmatch
import json
import multiprocessing
import sys
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

from dense_stereo_cases import Case, all_cases

from capture_eval.errors import CaptureEvalError
from capture_eval.files.atomic import read_json, write_text

HERE = Path(__file__).parent


def in_its_own_process(function: Callable[..., Any], *arguments: Any) -> Any:
    """Result of a function that a fresh process computes."""
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, context) as pool:
        return pool.submit(function, *arguments).result()


def photograph(case: Case, work: Path, makehuman: Path | None) -> None:
    """Render the scene of a case."""
    from dense_stereo_measure import scene_folder
    from dense_stereo_rendering import photograph_scene

    photograph_scene(case.scene, scene_folder(case, work), makehuman)


def solve(case: Case, work: Path) -> None:
    """Solve or triangulate the sparse model of a case."""
    from dense_stereo_measure import solve_case

    solve_case(case, work)


def reconstruct(case: Case, work: Path) -> dict[str, Any]:
    """Reconstruct a case and compare it with the truth."""
    from dense_stereo_measure import run_case

    return run_case(case, work)


def prepare(case: Case, work: Path, makehuman: Path | None) -> None:
    """Photos and sparse model of a case, kept where they are there."""
    in_its_own_process(photograph, case, work, makehuman)
    in_its_own_process(solve, case, work)


def measure(case: Case, work: Path, makehuman: Path | None) -> dict[str, Any]:
    """Row of one case; one that cannot be measured says why."""
    from dense_stereo_peers import missing_peer

    reason = missing_peer(case.method)
    if reason:
        return {"status": "skipped", "reason": reason, "fingerprint": case.fingerprint}
    try:
        prepare(case, work, makehuman)
        record = in_its_own_process(reconstruct, case, work)
    except (CaptureEvalError, OSError, RuntimeError, ValueError) as error:
        return {"status": "failed", "reason": str(error), "fingerprint": case.fingerprint}
    return dict(record)


def load(path: Path) -> dict[str, Any]:
    """Rows by name of the case, as far as they are there."""
    return dict(read_json(path)) if path.is_file() else {}


def save(path: Path, saved: dict[str, Any]) -> None:
    """One line a case, so that a difference shows which case changed."""
    rows = (f"{json.dumps(name)}: {json.dumps(_rounded(row))}" for name, row in sorted(saved.items()))
    write_text(path, "{\n" + ",\n".join(rows) + "\n}\n")


def _rounded(value: Any) -> Any:
    """Five significant digits, which is more than any of the figures repeats to."""
    if isinstance(value, float):
        return float(f"{value:.5g}")
    if isinstance(value, dict):
        return {key: _rounded(item) for key, item in value.items()}
    return [_rounded(item) for item in value] if isinstance(value, list | tuple) else value


def is_done(saved: dict[str, Any], case: Case) -> bool:
    """True when a case was measured and means what it meant then; a skipped one is tried again."""
    return saved.get(case.name, {}).get("fingerprint") == case.fingerprint and saved[case.name]["status"] == "ok"


def main() -> int:
    """Measure what is asked for and missing, then write tables and plots."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", default=["*"], metavar="PATTERN", help="group/name, as 'heads/*'")
    parser.add_argument("--force", action="store_true", help="measure again what is there")
    parser.add_argument("--prepare", action="store_true", help="only photos and sparse models, which nothing measures")
    parser.add_argument("--report", action="store_true", help="no measuring")
    parser.add_argument("--seconds", type=float, default=float("inf"), help="begin no other case after so long")
    parser.add_argument("--list", action="store_true", help="list the cases and which are measured")
    parser.add_argument("--makehuman", type=Path, help="checkout of MakeHuman")
    parser.add_argument("--work", type=Path, default=Path("build/dense_stereo"), help="photos and reconstructions")
    parser.add_argument("--note", help="words about the machine, kept with the figures and put on the page")
    parser.add_argument("--results", type=Path, default=HERE / "results", help="folder of the JSON, tables and plots")
    arguments = parser.parse_args()
    path = arguments.results / "dense_stereo.json"
    saved = load(path)
    chosen = [
        case
        for case in all_cases()
        if any(fnmatch.fnmatch(f"{case.group}/{case.name}", pattern) for pattern in arguments.only)
    ]
    if not chosen:
        print(f"no case is called {' or '.join(arguments.only)}; --list shows them", file=sys.stderr)
        return 1
    if arguments.list:
        print("\n".join(f"{'done' if is_done(saved, case) else '-':5} {case.group}/{case.name}" for case in chosen))
        return 0
    if arguments.prepare:
        for case in chosen:
            started = time.perf_counter()
            prepare(case, arguments.work, arguments.makehuman)
            print(f"{case.name}: photos and sparse model ({time.perf_counter() - started:.0f} s)", flush=True)
        return 0
    wanted = [case for case in chosen if arguments.force or not is_done(saved, case)]
    beginning = time.perf_counter()
    for number, case in enumerate([] if arguments.report else wanted, start=1):
        started = time.perf_counter()
        if started - beginning > arguments.seconds:
            print(f"{len(wanted) - number + 1} cases are left; the same call goes on with them")
            break
        if not arguments.force and is_done(load(path), case):
            continue
        record = measure(case, arguments.work, arguments.makehuman)
        saved = load(path) | {case.name: record}  # another call may have measured other cases meanwhile
        save(path, saved)
        print(f"{number}/{len(wanted)} {case.name}: {record['status']} {record.get('reason', '')}", end=" ")
        print(f"({time.perf_counter() - started:.0f} s)", flush=True)
    if arguments.note:
        saved = load(path) | {"note": {"text": arguments.note}}
        save(path, saved)
    from dense_stereo_plots import write_plots
    from dense_stereo_tables import write_page

    known = [case for case in all_cases() if case.name in saved]
    plots = write_plots(known, saved, arguments.results)
    write_text(arguments.results / "dense_stereo.md", write_page(all_cases(), saved, plots))
    print(f"{arguments.results / 'dense_stereo.md'}: {len(known)} cases, {len(plots)} plots")
    return 0


if __name__ == "__main__":
    sys.exit(main())
