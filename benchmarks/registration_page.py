"""The page of the registration benchmark, from the saved results of its cases alone."""

# ruff: noqa: E501  (the long lines are rows of the Markdown that is written)
from __future__ import annotations

from pathlib import Path
from typing import Any

from registration_cases import all_cases
from registration_measure import REGIONS
from registration_plots import draw_plots
from registration_sections import ablation, drift, error_bars, growth, hard, large, time_table
from registration_tables import (
    Results,
    curve_table,
    good_poses,
    label,
    load_results,
    of_group,
    pair,
    sequence_table,
    table,
)

from capture_eval.files.atomic import write_text

GOALS = {
    "640x480": {"tracking": (0.04, 0.20), "surface": (0.03, 0.15), "E_A": 0.08, "ratio": 0.05},
    "1280x960": {"tracking": (0.025, 0.12), "surface": (0.02, 0.09), "E_A": 0.05, "ratio": 0.03},
}
MASKS = {"face": "face", "seen": "whole head, seen", "confident": "whole head, confident"}
INTRODUCTION = """# Registration against known truth

Made by `python benchmarks/registration.py OUT --makehuman DIR`; do not edit. Rendered captures, camera positions solved from the photos, landmarks with 1 px of noise, a template of another person (identity 1); the truth only judges.

All errors are in % of D (the largest distance between two vertices of the neutral), median / 95th percentile over vertices. *Tracking*: distance of a registered vertex, in a pose, from the true place of the skin point it sits on in the neutral; *tangential* and *normal* are its parts within the skin and across it; *relative* leaves out the vertex's own distance from the skin in the neutral, which interpolation errors do not see. *Surface*: distance from the true surface. *Seen*: by at least 3 photos in every pose; *face*: those of them in front of the ears, without neck and scalp (what the goals speak of); *confident*: those of them whose confidence is above 0.5 in every pose.
"""
SEQUENCES = """
## Sequences: 24 photos a pose at 640x480

Two people of other identities than the template's and than the one whose captures options were chosen on. Poses at 0, .2, .5, .8 and 1 of the motion, some sequences without .2 (the steps between neighbours are larger than in an 11-pose sequence, so tracking has it harder). The same poses serve every timing: under *eased* the pose at amount a stands at the time at which the law reaches a.
"""


def write_page(out: Path, folder: Path) -> None:
    """Write registration.md, registration_regions.md and the plots."""
    results = load_results(out)
    plots = draw_plots(results, folder)
    parts = [INTRODUCTION, stamp(results), goals(results), SEQUENCES, sequence_table(results, "sequences")]
    parts += [plots.get("registration_poses.png", ""), region_table(results), plots.get("registration_regions.png", "")]
    parts += [
        curve_table(results, "sequences", "confident"),
        coverage_table(results),
        error_bars(results),
        ablation(results, plots),
    ]
    parts += [drift(results), hard(results), large(results), time_table(results), growth(results, plots)]
    parts.append(missing(results))
    write_text(folder / "registration.md", "\n".join(part for part in parts if part) + "\n")
    write_text(folder / "registration_regions.md", all_regions(results))
    print(f"{folder / 'registration.md'}: {len(results)} results")


def stamp(results: Results) -> str:
    """When and with what."""
    dates = sorted(row["measured"] for row in results.values() if "measured" in row)
    versions = sorted({row["version"] for row in results.values() if "version" in row})
    return f"Measured {dates[0]} to {dates[-1]} UTC, version {', '.join(versions)}.\n" if dates else ""


def goals(results: Results) -> str:
    """The figures that were asked for beside the worst that were reached."""
    rows = []
    for group, size in (("sequences", "640x480"), ("large", "1280x960")):
        found = of_group(results, group)
        if not found:
            continue
        wanted = GOALS[size]
        poses = [pose for row in found.values() for pose in good_poses(row)]
        for name in ("tracking", "surface"):
            goal = f"{wanted[name][0]:g} / {wanted[name][1]:g}"
            for mask in ("face", "seen", "confident"):
                values = [pose["regions"][mask][name] for pose in poses if mask in pose["regions"]]
                worst = [100 * max(value[k] for value in values) for k in (0, 1)]
                within = sum(all(100 * value[k] <= wanted[name][k] for k in (0, 1)) for value in values)
                verdict = "reached" if within == len(values) else f"{within} of {len(values)} poses"
                rows.append([size, f"{name}, {MASKS[mask]}", goal, f"{worst[0]:.3f} / {worst[1]:.3f}", verdict])
        rows += curve_goals(found, size, wanted)
    note = doubted(results)
    return "## Asked and reached\n\n" + table(["photos", "what", "goal", "worst", ""], rows) + note


def doubted(results: Results) -> str:
    """Poses that the registration itself refuses or doubts."""
    lines = []
    for row in results.values():
        for pose, doubt in (row.get("doubts") or {}).items():
            text = doubt if isinstance(doubt, str) else "; ".join(str(part) for part in doubt)
            lines.append(f"* {row['case']} {pose}: {text}")
    return "\nRefused or doubted by the registration itself:\n\n" + "\n".join(lines) + "\n" if lines else ""


def curve_goals(found: Results, size: str, wanted: dict[str, Any]) -> list[list[str]]:
    """Curve errors from photos beside those from the truth, confident vertices."""
    tables = [timing["confident"] for row in found.values() for timing in row["timings"].values()]
    methods = [method for entry in tables for method in entry["methods"].values() if method["LAE_ratio"] is not None]
    if not methods:
        return []
    differences = [100 * method["largest_E_A_difference"] for method in methods]
    within = sum(value <= wanted["E_A"] for value in differences)
    verdict = "reached" if within == len(differences) else f"{within} of {len(differences)} methods and sequences"
    rows = [[size, "E_A difference, confident", f"{wanted['E_A']:g}", f"{max(differences):.3f}", verdict]]
    for key in ("LAE_ratio", "LME_ratio"):
        ratios = [method[key] for method in methods]
        worst = max(ratios, key=lambda ratio: abs(ratio - 1))
        within = sum(abs(ratio - 1) <= wanted["ratio"] for ratio in ratios)
        verdict = "reached" if within == len(ratios) else f"{within} of {len(ratios)} methods and sequences"
        rows.append([size, key.replace("_", " "), f"1 ± {wanted['ratio']:g}", f"{worst:.3f}", verdict])
    decided = sum(entry["decided_pairs"] for entry in tables)
    wrong = sum(len(entry["wrong_pairs"]) for entry in tables)
    right = "reached" if wrong == 0 else "missed"
    rows.append([size, "order of methods 0.1 % D apart", "right", f"{wrong} of {decided} pairs wrong", right])
    return rows


def region_table(results: Results) -> str:
    """Tracking error by region in the last pose."""
    rows = []
    for row in of_group(results, "sequences").values():
        poses = good_poses(row)
        if poses:
            regions = poses[-1]["regions"]
            rows.append([label(row), *(pair(regions.get(name), "tracking") for name in REGIONS)])
            rows.append(["… confident", *(pair(regions.get(f"{name}, confident"), "tracking") for name in REGIONS)])
    if not rows:
        return ""
    text = "\n### Tracking by region, last pose\n\nAll poses and all parts of the error: [registration_regions.md](registration_regions.md). Lids and the skin round the eyes are *eyes*.\n\n"
    return text + table(["sequence", *REGIONS], rows)


def coverage_table(results: Results) -> str:
    """How much of the curves counts, and the order of methods."""
    rows = []
    for row in of_group(results, "sequences").values():
        for timing, entry in row["timings"].items():
            for mask in ("confident", "seen"):
                part = entry[mask]
                ratios = [m for m in part["methods"].values() if m["LAE_ratio"] is not None]
                worst = [
                    max((m[key] for m in ratios), key=lambda r: abs(r - 1), default=None)
                    for key in ("LAE_ratio", "LME_ratio")
                ]
                largest = max((m["largest_E_A_difference"] for m in ratios), default=None)
                cells = ["–" if value is None else f"{value:.3f}" for value in worst]
                cells.append("–" if largest is None else f"{100 * largest:.3f}")
                used = [f"{part[key][0]} of {part[key][1]}" for key in ("curves_used", "points_used")]
                order = "right" if not part["wrong_pairs"] else "wrong: " + ", ".join(part["wrong_pairs"])
                rows.append([label(row), timing, mask, *used, *cells, f"{order} ({part['decided_pairs']} pairs)"])
    if not rows:
        return ""
    titles = [
        "sequence",
        "timing",
        "vertices",
        "curves",
        "points",
        "worst LAE ratio",
        "worst LME ratio",
        "largest E_A difference",
        "order where LAE differ by 0.1 % D",
    ]
    return "\n### Coverage, and seen vertices beside confident ones\n\n" + table(titles, rows)


def missing(results: Results) -> str:
    """Cases without a result."""
    names = [case.name for case in all_cases()] + ["time_two_cores", "time_peer"]
    absent = [name for name in names if name not in results]
    return f"\n## Not measured\n\n{', '.join(absent)}.\n" if absent else ""


def all_regions(results: Results) -> str:
    """Every pose, region and part of the sequences and hard cases."""
    parts = ("tracking", "surface", "tangential", "normal", "relative")
    keys = [
        "face",
        "face, confident",
        "seen",
        "confident",
        *(name for region in REGIONS for name in (region, f"{region}, confident")),
    ]
    text = [
        "# Registration by pose and region\n",
        "Made with [registration.md](registration.md), which says what is what. Median / 95th percentile, % of D.\n",
    ]
    for group in ("sequences", "large", "hard", "drift"):
        for name, row in of_group(results, group).items():
            rows = [
                [
                    f"{pose['amount']:g}",
                    key,
                    str(pose["regions"][key]["vertices"]),
                    *(pair(pose["regions"][key], part) for part in parts),
                ]
                for pose in good_poses(row)
                for key in keys
                if key in pose["regions"]
            ]
            text.append(f"## {name}\n\n" + table(["amount", "vertices that", "number", *parts], rows))
    return "\n".join(text)
