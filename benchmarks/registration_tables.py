"""Tables of the registration benchmark's page that more than one section needs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from registration_cases import all_cases

from capture_eval.files.atomic import read_json

Results = dict[str, dict[str, Any]]


def load_results(out: Path) -> Results:
    """Saved results by case."""
    return {path.stem: read_json(path) for path in sorted((out / "results").glob("*.json"))}


def of_group(results: Results, group: str) -> Results:
    """Results of a group in the order of the cases."""
    return {case.name: results[case.name] for case in all_cases() if case.group == group and case.name in results}


def pair(figures: dict[str, Any] | None, name: str) -> str:
    """Median / p95 in %."""
    if not figures or name not in figures:
        return "–"
    median, p95 = figures[name]
    return f"{100 * median:.3f} / {100 * p95:.3f}"


def table(titles: list[str], rows: list[list[str]]) -> str:
    """Markdown."""
    lines = ["| " + " | ".join(titles) + " |", "|" + " --- |" * len(titles)]
    return "\n".join([*lines, *("| " + " | ".join(row) + " |" for row in rows)]) + "\n"


def label(row: dict[str, Any]) -> str:
    """Head and motion."""
    return f"{row['head']} {row['motion']}"


def good_poses(row: dict[str, Any]) -> list[dict[str, Any]]:
    """Poses that were registered."""
    return [pose for pose in row["poses"] if pose["status"] == "ok"]


def sequence_table(results: Results, group: str) -> str:
    """Errors of every pose of the sequences of a group."""
    parts = ("tracking", "surface", "tangential", "normal", "relative")
    titles = ["sequence", "amount", "face: tracking", "face: surface", *(f"confident: {part}" for part in parts)]
    rows = []
    for row in of_group(results, group).values():
        for pose in row["poses"]:
            start = [label(row), f"{pose['amount']:g}"]
            if pose["status"] != "ok":
                rows.append([*start, pose["status"], *[""] * 6])
                continue
            face, confident = pose["regions"].get("face"), pose["regions"].get("confident")
            cells = [pair(face, "tracking"), pair(face, "surface")]
            rows.append([*start, *cells, *(pair(confident, part) for part in parts)])
    return table(titles, rows) if rows else "Not measured.\n"


def curve_table(results: Results, group: str, mask: str) -> str:
    """LAE, LME and largest E_A difference of every method."""
    titles = [
        "sequence",
        "timing",
        "method",
        "LAE photos / truth",
        "ratio",
        "LME photos / truth",
        "ratio",
        "largest E_A difference (curve)",
    ]
    rows = []
    for row in of_group(results, group).values():
        for timing, entry in row["timings"].items():
            for name, method in entry[mask]["methods"].items():
                if name == "pde_linear":  # the same to the last digit as the linear method
                    continue
                if method["LAE_ratio"] is None:
                    rows.append([label(row), timing, name, *["–"] * 5])
                    continue
                values = [
                    f"{100 * method[f'{key}_photos']:.3f} / {100 * method[f'{key}_truth']:.3f}"
                    for key in ("LAE", "LME")
                ]
                largest = (
                    f"{100 * method['largest_E_A_difference']:.3f} ({method['largest_E_A_difference_at']['curve']})"
                )
                cells = [values[0], f"{method['LAE_ratio']:.3f}", values[1], f"{method['LME_ratio']:.3f}", largest]
                rows.append([label(row), timing, name, *cells])
    if not rows:
        return ""
    return f"\n### Curve errors from photos beside those from the truth, {mask} vertices\n\n" + table(titles, rows)
