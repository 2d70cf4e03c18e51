"""Error bars fitted to one capture with known truth, and what they cover on others.

    python benchmarks/registration_error_bars.py RESULT RESULT ...

Each RESULT is the folder of a finished `capture-eval run` of a synthetic capture. The bars are fitted to the first;
printed are the fitted parts, then for every result the share of true errors inside the bars in use and inside the
fitted ones, the sizes of the bars, and the ratio of mean error to mean bar. In % of D.
"""

from __future__ import annotations

import argparse
import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from capture_eval.evaluation.bar_calibration import bar_coverage, fit_bar_model
from capture_eval.files.atomic import read_npz
from capture_eval.registration.error_bar import BarModel, ErrorBarOptions, error_bar
from capture_eval.triangle_geometry import diameter


@dataclasses.dataclass(frozen=True)
class Sample:
    """True errors and spreads of all poses but the neutral as fractions of D, (P - 1, V), NaN where not seen."""

    name: str
    error: dict[str, Any]
    spread: Any
    confidence: dict[str, Any]
    masks: dict[str, Any]


def load(result: Path) -> Sample:
    """Read one result."""
    saved = read_npz(result / "work" / "register" / "registered.npz")
    errors = read_npz(result / "work" / "register" / "tracking_error.npz")
    if "error_bar" not in saved:
        raise SystemExit(f"{result}: its registration made no error bars (register.uncertainty.photo_halves)")
    ok = saved["pose_ok"].astype(bool)
    seen = saved["seen"].astype(bool)[ok].all(axis=0)
    confident = seen & (saved["confidence"][ok] > 0.5).all(axis=0)
    size = diameter(saved["vertices"][0])
    later = np.flatnonzero(ok)[1:]
    confidence = {
        "position": saved["confidence"][later],
        "motion": np.minimum(saved["confidence"][later], saved["confidence"][0]),
    }
    error = {kind: np.where(seen, values[later], np.nan) for kind, values in errors.items()}
    masks = {"confident": confident, "seen": seen, "rest": seen & ~confident}
    return Sample(result.parent.name or result.name, error, saved["spread"][later] / size, confidence, masks)


def fit(sample: Sample, kind: str) -> BarModel:
    """Fit one kind of bar."""
    return fit_bar_model(sample.error[kind].ravel(), sample.spread.ravel(), sample.confidence[kind].ravel())


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("results", type=Path, nargs="+")
    samples = [load(result) for result in parser.parse_args().results]
    used = ErrorBarOptions()
    columns = (
        "capture",
        "bar",
        "vertices",
        "inside, in use",
        "inside, fitted",
        "bar median",
        "error p95",
        "mean share",
    )
    print("| " + " | ".join(columns) + " |\n|" + " --- |" * len(columns))
    for kind in ("position", "motion"):
        models = (getattr(used, kind), fit(samples[0], kind))
        for sample in samples:
            bars = [error_bar(sample.spread, sample.confidence[kind], 1.0, model) for model in models]
            found = [bar_coverage(sample.error[kind], bar, sample.masks) for bar in bars]
            for group, mask in sample.masks.items():
                mean = np.nanmean(sample.error[kind][:, mask]) / np.nanmean(bars[0][:, mask])
                shares = " | ".join(f"{100 * one[group]['inside']:.1f} %" for one in found)
                sizes = f"{100 * found[0][group]['bar_median']:.3f} | {100 * found[0][group]['error_p95']:.3f}"
                print(f"| {sample.name} | {kind} | {group} | {shares} | {sizes} | {mean:.2f} |")
        print(f"\n{kind} fitted to {samples[0].name}: {models[1]}; in use {models[0]}\n")


if __name__ == "__main__":
    main()
