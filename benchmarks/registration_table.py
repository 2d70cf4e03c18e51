"""Table of tracking and surface errors of a finished synthetic capture: `registration.py --table CAPTURE OUT`.

Prints, per pose and region, median / p95 in % of D of the tracking error, its tangential and normal parts, the
error relative to the vertex's own offset in the neutral, and the surface distance.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from capture_eval.files.atomic import read_json
from capture_eval.files.manifest_files import read_manifest
from capture_eval.stages.truth import TruthFiles, TruthOptions, measure_tracking

COLUMNS = ("", "surface_", "tangential_", "normal_", "relative_")
TITLES = ("tracking", "surface", "tangential", "normal", "relative")


def measure(capture_folder: Path, out: Path) -> dict[str, Any]:
    """Compare the registration under `out` with the truth of the capture."""
    capture = read_manifest(capture_folder / "manifest.yaml")
    manifest = capture.manifest
    if manifest.truth is None or manifest.truth.mesh is None or manifest.truth.vertices is None:
        raise SystemExit(f"{capture.path}: the capture has no truth")
    if manifest.template is None:
        raise SystemExit(f"{capture.path}: the capture has no template")
    cameras = manifest.truth.cameras
    truth = TruthFiles(
        capture.resolve(manifest.truth.mesh),
        capture.resolve(manifest.truth.vertices),
        None if cameras is None else capture.resolve(cameras),
    )
    curves = None if manifest.curves is None else capture.resolve(manifest.curves)
    template = capture.resolve(manifest.template.mesh)
    return measure_tracking(out / "work", template, truth, out / "report", TruthOptions(), curves)


def print_table(result: dict[str, Any]) -> None:
    """Print one line per pose and region."""
    share = result["confident_share_of_seen"]
    print(f"D = {result['D']:.2f}; median / p95 in % of D; confident share of seen {share:.0%}")
    print(f"{'pose':10}{'region':11}{'vertices':>9}  " + "".join(f"{title:>15}" for title in TITLES))
    for row in result["tracking"]:
        if row["status"] != "ok":
            print(f"{row['pose']:10}{row['status']}")
            continue
        for region, figures in row["regions"].items():
            cells = "".join(
                f"{100 * figures[f'{name}median']:8.3f}/{100 * figures[f'{name}p95']:6.3f}" for name in COLUMNS
            )
            print(f"{row['pose']:10}{region:11}{figures['vertices']:9d}  {cells}")


def print_fidelity(report: Path) -> None:
    """Print LME and LAE from photos beside those from the truth, when the evaluation has compared them."""
    path = report / "truth_comparison.json"
    if not path.is_file():
        return
    comparison = read_json(path)
    print(
        f"\n{'method':16}{'LAE photos':>12}{'LAE truth':>12}{'ratio':>8}{'LME photos':>12}{'LME truth':>12}{'ratio':>8}"
    )
    for name, row in comparison["methods"].items():
        cells = ""
        for key in ("LAE", "LME"):
            cells += f"{100 * row[f'{key}_photos']:12.4f}{100 * row[f'{key}_truth']:12.4f}{row[f'{key}_ratio']:8.3f}"
        print(f"{name:16}{cells}")


def print_finished_run(capture: Path, out: Path) -> None:
    """Measure and print."""
    print_table(measure(capture, out))
    print_fidelity(out / "report")
