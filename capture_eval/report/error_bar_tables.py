"""Texts and tables of the error bars, and of whether known truth lies inside."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from capture_eval.report.page import Table
from capture_eval.report.saved_results import FaceSequence
from capture_eval.report.verdict import percent

_GROUPS = {"confident": "confident", "seen": "all seen", "rest": "seen, not confident"}


def error_bar_fact(faces: FaceSequence | None, diameter: float, summary: Mapping[str, Any]) -> list[tuple[str, str]]:
    """The middle of the bars of the vertices that count, and what they do to E_A; nothing without bars."""
    if faces is None or faces.error_bar is None:
        return []
    bars = faces.error_bar[faces.pose_ok][:, faces.used]
    known = bars[np.isfinite(bars)]
    if known.size == 0:
        return []
    facts = [("Error bar (95 %) of a vertex, median", f"{percent(float(np.median(known)) / diameter)} of D")]
    on_curves = ((summary.get("noise") or {}).get("error_bars") or {}).get("bar_E_A_median")
    if on_curves is not None:
        facts.append(("Error bar (95 %) of E_A, median", f"{percent(float(on_curves))} of D"))
    return facts


def coverage_table(rows: Sequence[Mapping[str, Any]]) -> Table | None:
    """Share of true errors inside the 95 % bar of the vertex, per pose and group; None when there are no bars."""
    texts = []
    for row in rows:
        found = row.get("error_bars") or {}
        if "motion" not in found:
            continue
        cells = [_share(found[kind][group]) for kind in ("position", "motion") for group in _GROUPS]
        texts.append([str(row.get("pose", "")), f"{float(row.get('t', np.nan)):.3g}", *cells])
    if not texts:
        return None
    columns = ["pose", "t"] + [f"{kind}, {title}" for kind in ("position", "motion") for title in _GROUPS.values()]
    return Table(columns, texts)


def _share(figures: Mapping[str, Any]) -> str:
    inside = figures.get("inside")
    return "—" if inside is None else f"{100.0 * float(inside):.1f} %"
