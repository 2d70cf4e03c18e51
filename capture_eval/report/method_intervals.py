"""How far the figures of every method hang on single poses: mean error, LAE and LME with their intervals."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from capture_eval.report.tables import Cell, Table

EXPLANATION = (
    "Intervals are 95 % bootstraps by pose. Those of LAE and LME end at the figure itself, since no resample holds a "
    "larger error than was seen: a wide one says that the figure comes from one or few poses, none says how large the "
    "errors of other poses would be."
)
HEADER = ("method", "poses", "mean E_A", "from", "to", "LAE", "LAE from", "LAE to", "LME", "LME from", "LME to")


def interval_rows(statistics: Mapping[str, Any], titles: Mapping[str, str]) -> list[tuple[Cell, ...]]:
    """Rows under ``HEADER`` in per cent of D; empty for a summary without these intervals.

    Parameters
    ----------
    statistics : mapping
        ``statistics`` of ``summary.json``.
    titles : mapping of method to str
        Names for reading.
    """
    rows: list[tuple[Cell, ...]] = []
    for name, found in statistics["methods"].items():
        if "LAE_interval" not in found:
            continue
        cells: list[Cell] = [titles.get(name, name), str(found["poses"])]
        for figure, interval in (("mean_E_A", "interval"), ("LAE", "LAE_interval"), ("LME", "LME_interval")):
            values = [found[figure], *(found[interval] or (None, None))]
            cells += [None if value is None else 100.0 * value for value in values]
        rows.append(tuple(cells))
    return rows


def interval_table(statistics: Mapping[str, Any], titles: Mapping[str, str]) -> Table:
    """All methods as a table; parameters as for `interval_rows`."""
    title = f"Every method over the in-between poses, in % of D. {EXPLANATION}"
    return Table(title, HEADER, tuple(interval_rows(statistics, titles)))
