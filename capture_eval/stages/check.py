"""`check`: read a result folder and a baseline, and write a new baseline."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path
from typing import Any

from capture_eval import __version__
from capture_eval.errors import InputError
from capture_eval.evaluation.baseline import (
    Finding,
    Metric,
    ResultRecord,
    compare_with_baseline,
    record_from_plain,
    record_to_plain,
    with_tolerances_of,
)
from capture_eval.files.atomic import read_json, write_json

INPUTS_FILE = "work/inputs.json"

# What may be lost without alarm. Results repeat bit for bit on one machine with the same packages, so this only leaves
# room for another processor or another version of a library. A baseline file may state its own.
ERROR_TOLERANCE = Metric(None, "lower", relative=0.05, absolute=2e-5, unit="D")
TRACKING_TOLERANCE = Metric(None, "lower", relative=0.15, absolute=5e-5, unit="D")
SHARE_TOLERANCE = Metric(None, "higher", absolute=0.02)


def read_result(out: Path) -> ResultRecord:
    """What a baseline remembers of a result folder.

    Parameters
    ----------
    out : Path
        Folder of a finished `run` or `compare`.

    Raises
    ------
    InputError
        If the run is not finished or a file is damaged.
    """
    report = out / "report"
    if not (report / "summary.json").is_file():
        raise InputError(f"{report / 'summary.json'}: no such file; finish `capture-eval run` or `compare` first")
    summary = read_json(report / "summary.json")
    inputs = read_json(out / INPUTS_FILE) if (out / INPUTS_FILE).is_file() else {}
    poses: dict[str, bool] = {str(name): False for name in inputs.get("poses", [])}
    photos = {}
    for name in poses:
        sparse = out / "work" / name / "sparse.json"
        if sparse.is_file():
            photos[name] = int(read_json(sparse).get("registered") or 0)
    poses |= _registered_poses(out, list(poses))
    try:
        return ResultRecord(
            name=str(inputs.get("name", out.name)),
            metrics=_metrics(summary) | _truth_metrics(report),
            poses=poses,
            photos=photos,
            curves=_used_curves(report, summary),
            methods=tuple(summary["methods"]),
            inputs=dict(inputs.get("files", {})),
            made_with={"capture_eval": __version__, **inputs.get("tools", {})},
            doubts=pose_doubts(out),
        )
    except (KeyError, TypeError, AttributeError) as error:
        raise InputError(f"{report / 'summary.json'}: damaged ({type(error).__name__}: {error})") from None


def pose_doubts(out: Path) -> dict[str, str]:
    """Poses that have a result which should not be relied on, and why, from the register stage."""
    path = out / "work" / "register" / "registered.json"
    rows = read_json(path).get("poses", []) if path.is_file() else []
    return {str(row["pose"]): "; ".join(row["doubts"]) for row in rows if row.get("doubts")}


def _registered_poses(out: Path, names: list[str]) -> dict[str, bool]:
    from capture_eval.files.atomic import read_npz

    saved = read_npz(out / "report" / "registered.npz")
    ok = saved["pose_ok"].tolist() if "pose_ok" in saved else [True] * len(saved["t"])
    if len(names) != len(ok):
        names = [f"pose_{index:02d}" for index in range(len(ok))]
    return {name: bool(good) for name, good in zip(names, ok, strict=True)}


def _metrics(summary: dict[str, Any]) -> dict[str, Metric]:
    metrics = {}
    for method, row in summary["methods"].items():
        for key in ("LAE", "LME", "mean_E_A"):
            metrics[f"{method} {key}"] = replace(ERROR_TOLERANCE, value=row.get(key))
    counts = summary["counts"]
    if counts.get("points"):
        share = counts["points_used"] / counts["points"]
        metrics["share of curve points that count"] = replace(SHARE_TOLERANCE, value=share)
    return metrics


def _truth_metrics(report: Path) -> dict[str, Metric]:
    """Distance from known truth, where the capture has it: the worst pose counts."""
    metrics = {}
    if (report / "truth.json").is_file():
        rows = [row for row in read_json(report / "truth.json")["tracking"] if row.get("status") == "ok"]
        for key in ("median", "p95"):
            values = [float(row[key]) for row in rows if row.get(key) is not None]
            metrics[f"tracking {key}, worst pose"] = replace(TRACKING_TOLERANCE, value=max(values, default=None))
    return metrics


def _used_curves(report: Path, summary: dict[str, Any]) -> tuple[str, ...]:
    """Curves that have errors, in the order of errors.csv."""
    failed = set(summary["counts"].get("curves_failed", []))
    with (report / "errors.csv").open(encoding="utf-8", newline="") as stream:
        names = dict.fromkeys(row["curve"] for row in csv.DictReader(stream))
    return tuple(name for name in names if name not in failed)


def check_result(out: Path, baseline: Path) -> list[Finding]:
    """Compare a result folder with a baseline file.

    Raises
    ------
    InputError
        If one of them is missing or damaged.
    """
    if not baseline.is_file():
        raise InputError(
            f"{baseline}: no such baseline; `capture-eval check {out} --baseline FILE --update` writes one"
        )
    return compare_with_baseline(read_result(out), record_from_plain(read_json(baseline), str(baseline)))


def update_baseline(out: Path, baseline: Path) -> ResultRecord:
    """Write the baseline of a result; tolerances of an earlier baseline in that file are kept.

    Raises
    ------
    InputError
        If the result is missing or damaged.
    """
    record = read_result(out)
    if baseline.is_file():
        record = with_tolerances_of(record, record_from_plain(read_json(baseline), str(baseline)))
    write_json(baseline, record_to_plain(record))
    return record
