"""Registration against known truth on rendered captures: `registration.py OUT --makehuman DIR`.

    python benchmarks/registration.py OUT --makehuman DIR                 everything; about two hours of one core
    python benchmarks/registration.py OUT --makehuman DIR --only NAME ..  some cases or groups (see --list)
    python benchmarks/registration.py OUT --page-only                     page and plots from what is measured
    python benchmarks/registration.py --table CAPTURE RESULT              tracking errors of a finished run

Every case leaves OUT/results/CASE.json and is not measured again without --force; photos and scans are kept in any
case. The page and its plots (benchmarks/results/registration*) are made from these files alone and say what was not
measured.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

from registration_cases import Case, all_cases
from registration_measure import measure_case
from registration_page import write_page
from registration_runs import Bench, OutOfTime, run_case, say
from registration_table import print_finished_run
from registration_time import TIME_GROUP, TIME_NAMES, run_time

RESULTS = Path(__file__).parent / "results"


def chosen_cases(only: list[str]) -> list[Case]:
    """Cases by name or group; all without names."""
    cases = all_cases()
    known = {case.name for case in cases} | {case.group for case in cases} | {TIME_GROUP, *TIME_NAMES}
    unknown = sorted(set(only) - known)
    if unknown:
        raise SystemExit(f"no case or group {', '.join(unknown)}; there are {', '.join(sorted(known))}")
    return [case for case in cases if not only or case.name in only or case.group in only]


def run(bench: Bench, only: list[str], until: str, force: bool) -> None:
    """All chosen cases, as far as time reaches."""
    try:
        for case in chosen_cases(only):
            run_case(bench, case, until, force, measure_case)
        names = [name for name in TIME_NAMES if not only or TIME_GROUP in only or name in only]
        if until == "results" and names:
            run_time(bench, names, force)
    except OutOfTime:
        say("out of time; the same command goes on")


def list_cases() -> None:
    """Names and groups."""
    for case in all_cases():
        print(f"{case.name:28}{case.group:12}{case.shots.name}")
    for name in TIME_NAMES:
        print(f"{name:28}{TIME_GROUP}")


def main(arguments: list[str] | None = None) -> Any:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path, nargs="?", help="folder for captures, scans and results; about 2 GB")
    parser.add_argument("--makehuman", type=Path, help="checkout of MakeHuman; without it the fetched data set")
    parser.add_argument("--only", nargs="+", default=[], metavar="NAME", help="cases or groups")
    parser.add_argument("--until", choices=("photos", "scans", "results"), default="results")
    parser.add_argument("--seconds", type=float, default=float("inf"), help="begin nothing new after so long")
    parser.add_argument("--force", action="store_true", help="register and measure again; photos and scans stay")
    parser.add_argument("--page-only", action="store_true", help="measure nothing")
    parser.add_argument("--list", action="store_true", help="print cases and groups")
    parser.add_argument("--table", type=Path, nargs=2, metavar=("CAPTURE", "RESULT"))
    options = parser.parse_args(arguments)
    if options.list:
        return list_cases()
    if options.table:
        return print_finished_run(*options.table)
    if options.out is None:
        parser.error("OUT is missing")
    bench = Bench(options.out.resolve(), options.makehuman, time.monotonic() + options.seconds)
    if not options.page_only:
        run(bench, options.only, options.until, options.force)
    if options.page_only or options.until == "results":
        write_page(bench.out, RESULTS)
    return None


if __name__ == "__main__":
    main()
