"""What the evaluation writes for others to read: curves with all predictions, and the tables."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture_eval.curves.extract import CurveSet
from capture_eval.evaluation.error_table import ErrorTable, Evaluation
from capture_eval.files.atomic import write_npz, write_text
from capture_eval.report.method_intervals import interval_table
from capture_eval.report.pair_verdicts import pair_table
from capture_eval.report.tables import lme_lae_table, per_curve_table, to_csv, to_latex, to_markdown

Floats = NDArray[np.float64]


def save_curves(path: Path, t: Floats, curves: CurveSet, evaluation: Evaluation) -> None:
    """All curves one after the other: curve n owns the points ``offsets[n]:offsets[n + 1]``."""
    sizes = [len(curve.vertices) for curve in curves.curves]
    small: dict[str, NDArray[Any]] = {
        "names": np.array([curve.name for curve in curves.curves]),
        "methods": np.array(evaluation.table.methods),
        "closed": np.array([curve.closed for curve in curves.curves]),
        "offsets": np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64),
        "vertices": np.concatenate([curve.vertices for curve in curves.curves]),
        "used": np.concatenate(evaluation.counted),
        "t": t,
    }

    def arrays() -> Iterator[tuple[str, NDArray[Any]]]:
        yield from small.items()
        yield "truth", np.concatenate(curves.positions, axis=1)
        for name, predicted in evaluation.predictions.items():
            yield f"prediction/{name}", np.concatenate(predicted, axis=1)  # one at a time: all are as large as the rest

    write_npz(path, arrays())


def save_tables(report: Path, summary: Mapping[str, Any], table: ErrorTable) -> None:
    """Tables for reading and for papers."""
    per_curve = per_curve_table(table.curves, table.methods, table.n_points, table.average, table.maximum)
    statistics, titles = summary["statistics"], {name: row["title"] for name, row in summary["methods"].items()}
    tables = {
        "table_lme_lae": lme_lae_table(summary),
        "table_per_curve": per_curve,
        "table_pairs": pair_table(statistics, titles),
        "table_intervals": interval_table(statistics, titles),
    }
    for name, content in tables.items():
        for ending, write in (("csv", to_csv), ("md", to_markdown), ("tex", to_latex)):
            write_text(report / f"{name}.{ending}", write(content))
