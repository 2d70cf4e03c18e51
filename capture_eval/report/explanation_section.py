"""The part of the page that says which differences are real and why: pairs of methods, best-fitting moments, fits."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from . import figure_style
from .method_intervals import EXPLANATION, HEADER, interval_rows
from .page import Section, Table
from .pair_verdicts import pair_sentence

_MANY_PAIRS = 10


def explanation_section(summary: Mapping[str, Any]) -> Section | None:
    """Section from ``statistics``, ``best_fit_time`` and ``fit`` of ``summary.json``; None for an older file."""
    statistics = summary.get("statistics")
    if not statistics:
        return None
    methods = summary.get("methods") or {}
    labels = {name: style.label for name, style in figure_style.method_styles(list(methods)).items()}
    tables: list[tuple[str, Table, bool]] = []
    pairs = statistics.get("pairs") or []
    if pairs:
        rows = [(pair["verdict"], pair_sentence(pair, labels)) for pair in pairs]
        marks = ["" if pair["verdict"] == "not resolved" else "best" for pair in pairs]
        heading = "Every pair of methods, mean error per pose over all curves"
        tables.append((heading, Table(("verdict", "in words"), rows, marks, text_columns=2), len(rows) > _MANY_PAIRS))
    intervals = [
        tuple(cell if isinstance(cell, str) else _number(cell) for cell in row)
        for row in interval_rows(statistics, labels)
    ]
    if intervals:
        tables.append(("Every method with its intervals, in % of D", Table(HEADER, intervals, text_columns=1), False))
    best = best_fit_table(methods, labels)
    if best.rows:
        tables.append(("Errors at the moment that fits each pose best, in % of D", best, False))
    fitted = fit_table(summary.get("fit") or {})
    if fitted.rows:
        tables.append((_fit_heading(summary["fit"]), fitted, False))
    text = (
        f"{statistics['caveat']} Not resolved does not mean equal. The moment of a photographed pose is its number, "
        "not a measured time: what is left at the best-fitting moment is wrong however the poses were timed."
        f"{' ' + EXPLANATION if intervals else ''}"
    )
    return Section("explanation", "Which differences are real", text, (), tables)


def best_fit_table(methods: Mapping[str, Any], labels: Mapping[str, str]) -> Table:
    """LAE and LME at nominal times and at the best-fitting ones, and those times."""
    rows = []
    for name, row in methods.items():
        found = row.get("best_fit_time")
        if not found:
            continue
        times = " ".join("–" if t is None else f"{t:.2f}" for t in found["times"])
        figures = [row.get("LAE"), found["LAE"], row.get("LME"), found["LME"]]
        rows.append((labels[name], times, *map(_percent, figures)))
    columns = ("method", "best-fitting t", "LAE", "LAE, best t", "LME", "LME, best t")
    return Table(columns, rows, text_columns=2)


def fit_table(fit: Mapping[str, Any]) -> Table:
    """Held-out errors of fitted methods beside linear."""
    rows = []
    for row in fit.get("rows") or []:
        figures = [row["train_rms"], row["rms"], row["mean_E_A"], row["LAE"], row["LME"]]
        rows.append((row["name"], _parameters(row["options"]), *map(_percent, figures)))
    columns = ("method", "parameters found", "RMS, fitted poses", "RMS", "mean E_A", "LAE", "LME")
    return Table(columns, rows, text_columns=2)


def _fit_heading(fit: Mapping[str, Any]) -> str:
    train, held_out = (", ".join(f"{t:g}" for t in fit[key]) for key in ("training_t", "held_out_t"))
    return f"Parameters fitted at t = {train} and judged at t = {held_out} (both ends given), in % of D"


def _parameters(options: Any) -> str:
    if isinstance(options, list):
        return f"own ones for each of {len(options)} curves"
    shown = {
        key: options[key]
        for key in ("order", "closure", "closure_bend", "mass", "damping", "exponent", "rise", "settle")
        if key in options and (key != "closure_bend" or options["closure"] == "fit")
    }
    return ", ".join(
        f"{key} {value:.3g}" if isinstance(value, float) else f"{key} {value}" for key, value in shown.items()
    )


def _percent(value: float | None) -> str:
    return _number(None if value is None else 100.0 * value)


def _number(value: float | None) -> str:
    return "—" if value is None or not math.isfinite(value) else f"{value:.3f}"
