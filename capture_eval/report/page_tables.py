"""The page's texts and tables from saved results; the only place where the page rounds numbers."""

from __future__ import annotations

import dataclasses
import json
import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..evaluation.error_table import ErrorTable
from . import figure_style
from .error_bar_tables import coverage_table, error_bar_fact
from .explanation_section import explanation_section
from .page import Bar, PageContent, Picture, Section, Table
from .saved_results import PoseQuality, SavedResults, TruthComparison
from .verdict import MethodScore, NoiseFloor, judge, percent

_STAGE_ORDER = ("sparse", "dense", "surface", "align", "neutral", "track", "refine", "collect", "evaluate", "truth")
_SECTIONS: tuple[tuple[str, str, str, tuple[str, ...]], ...] = (
    ("errors", "Errors", "", ("errors_per_curve", "errors_over_time", "error_maps")),
    ("faces", "Faces", "", ("faces", "linear_heat_maps", "trajectories")),
    (
        "truth",
        "Against known truth",
        "The true meshes of this capture are known. They judge the result and are never an input.",
        ("truth_comparison", "tracking_error"),
    ),
    (
        "capture",
        "Capture and reconstruction",
        "",
        ("contact_sheet", "mesh_over_photos", "reconstruction_quality", "tracking_confidence", "error_bars"),
    ),
)


def page_content(
    results: SavedResults,
    info: Mapping[str, Any],
    pictures: Mapping[str, Picture],
    viewer: Mapping[str, Any] | None,
    provenance: Mapping[str, Any],
) -> PageContent:
    """Put the page together.

    Parameters
    ----------
    results
        Saved results.
    info
        See ``stages.report.write_report``.
    pictures
        Figures by name.
    viewer
        Payload of the 3D view, or None to leave it out.
    provenance
        ``versions`` (name, version), ``timings`` by step, ``hashes`` by file.
    """
    scores = method_scores(results.summary)
    failed = [pose.name for pose in results.poses if not pose.ok]
    given = {name: row.get("key_times") or () for name, row in (results.summary.get("methods") or {}).items()}
    return PageContent(
        title=results.name,
        subtitle=str(info.get("description") or ""),
        verdict=judge(scores, noise_floor(results.summary), failed, len(results.poses), given),
        bars=_bars(scores),
        scores=score_table(results.summary, scores),
        facts=_facts(results),
        warnings=_warnings(results),
        sections=_sections(results, pictures),
        viewer=viewer,
        run=[("Methods", method_table(results.summary), False), *_run_tables(info, provenance)],
    )


def method_scores(summary: Mapping[str, Any]) -> dict[str, MethodScore]:
    """LAE and LME of every method of ``summary.json``, as fractions of D."""
    return {
        str(name): MethodScore(_number(entry.get("LAE")), _number(entry.get("LME")))
        for name, entry in (summary.get("methods") or {}).items()
    }


def noise_floor(summary: Mapping[str, Any]) -> NoiseFloor | None:
    """Noise floor of ``summary.json``, or None when no curve rests."""
    noise = summary.get("noise") or {}
    floor = NoiseFloor(*(_number(noise.get(name)) for name in ("mean_E_A", "largest_E_A", "largest_E_M")))
    return floor if all(map(math.isfinite, dataclasses.astuple(floor))) else None


def score_table(summary: Mapping[str, Any], scores: Mapping[str, MethodScore]) -> Table:
    """LAE and LME per method, where they occur, and their ratio to geometric linear."""
    labels = figure_style.method_styles(list(scores))
    rows, marks = [], []
    finite = [score.largest_average for score in scores.values() if math.isfinite(score.largest_average)]
    for name, score in scores.items():
        entry = summary["methods"][name]
        rows.append(
            (
                labels[name].label,
                percent(score.largest_average),
                _place(entry, "LAE"),
                _plain(entry.get("LAE_ratio_to_linear"), 2),
                percent(score.largest_maximum),
                _place(entry, "LME"),
                _plain(entry.get("LME_ratio_to_linear"), 2),
            )
        )
        marks.append("best" if finite and score.largest_average == min(finite) else "")
    columns = ("method", "LAE", "at", "ratio to linear", "LME", "at", "ratio to linear")
    return Table(columns, rows, marks)


def method_table(summary: Mapping[str, Any]) -> Table:
    """Every method with its source and the options it ran with."""
    methods = summary.get("methods") or {}
    labels = figure_style.method_styles(list(methods))
    rows = [
        [
            labels[name].label,
            ", ".join(f"{key} {_text(value)}" for key, value in (row.get("options") or {}).items()) or "none",
            str(row.get("reference") or ""),
        ]
        for name, row in methods.items()
    ]
    return Table(("method", "options", "source"), rows, text_columns=3)


def parts_table(summary: Mapping[str, Any]) -> Table:
    """Root mean square error per method with its timing and path parts, in % of D."""
    methods = summary.get("methods") or {}
    labels = figure_style.method_styles(list(methods))
    names = ("rms", "rms_timing", "rms_path", "mean_E_A", "mean_E_M")
    columns = ("method", "all", "timing: along the chord", "path: off the chord", "mean E_A", "mean E_M")
    rows = [
        [labels[name].label, *(_percent_plain(_number(row.get(key))) for key in names)] for name, row in methods.items()
    ]
    return Table(columns, rows)


def per_curve_table(errors: ErrorTable) -> Table:
    """Mean over t of E_A and maximum over t of E_M per curve and method, in % of D."""
    labels = figure_style.method_styles(errors.methods)
    columns = ["", "curve"]
    columns += [f"E_A {labels[method].label}" for method in errors.methods]
    columns += [f"E_M {labels[method].label}" for method in errors.methods]
    rows, marks = [], []
    for index, curve in enumerate(errors.curves):
        average = [_mean(errors.average[method, index]) for method in range(len(errors.methods))]
        largest = [_largest(errors.maximum[method, index]) for method in range(len(errors.methods))]
        rows.append([str(index + 1), curve, *(_percent_plain(value) for value in (*average, *largest))])
        marks.append("" if any(math.isfinite(value) for value in average) else "failed")
    return Table(columns, rows, marks, text_columns=2)


def pose_table(poses: Sequence[PoseQuality]) -> Table:
    """One row per pose, failed ones included with their reason."""
    figures = (
        ("photos placed", "registered", "{:.0f}"),
        ("of", "photos", "{:.0f}"),
        ("reprojection, px", "reprojection_error_px", "{:.2f}"),
        ("track length", "track_length", "{:.2f}"),
        ("sparse points", "points", "{:,.0f}"),
        ("dense points", "fused_points", "{:,.0f}"),
        ("scan vertices", "scan_vertices", "{:,.0f}"),
        ("alignment, px", "align_residual_px", "{:.2f}"),
        ("confidence", "confidence_median", "{:.2f}"),
    )
    shown = [entry for entry in figures if any(entry[1] in pose.figures for pose in poses)]
    columns = ["pose", "t", "state", *(title for title, _, _ in shown)]
    rows = []
    for pose in poses:
        values = [form.format(pose.figures[key]) if key in pose.figures else "—" for _, key, form in shown]
        rows.append([pose.name, f"{pose.t:.4g}", pose.state, *values])
    return Table(columns, rows, ["failed" if pose.doubts or not pose.ok else "" for pose in poses], text_columns=3)


def truth_tables(truth: TruthComparison) -> list[tuple[str, Table, bool]]:
    """LAE and LME from photos beside those from true meshes, and the tracking error per pose and per region."""
    tables: list[tuple[str, Table, bool]] = []
    methods = truth.comparison.get("methods") or {}
    labels = figure_style.method_styles(list(methods))
    keys = ("LAE_photos", "LAE_truth", "LME_photos", "LME_truth", "largest_E_A_difference", "largest_E_M_difference")
    if methods:
        columns = ("method", "LAE photos", "LAE truth", "LME photos", "LME truth", "largest Δ E_A", "largest Δ E_M")
        rows = [
            [labels[name].label, *(_percent_plain(_number(row.get(key))) for key in keys)]
            for name, row in methods.items()
        ]
        tables.append(("From photos and from true meshes, in % of D", Table(columns, rows), False))
    if truth.tracking_rows:
        tables.append(("Tracking error by pose, in % of D", _tracking_table(truth.tracking_rows), False))
        coverage = coverage_table(truth.tracking_rows)
        if coverage is not None:
            tables.append(("True errors inside the 95 % error bars", coverage, False))
        regions = _region_table(truth.tracking_rows)
        if regions.rows:
            tables.append(("Tracking error by region, in % of D", regions, False))
    return tables


def _tracking_table(rows: Sequence[Mapping[str, Any]]) -> Table:
    titles = {
        "median": "median",
        "p90": "p90",
        "p95": "p95",
        "tangential_median": "along the skin, median",
        "normal_median": "across, median",
        "surface_median": "to the surface, median",
        "surface_p95": "to the surface, p95",
    }
    keys = [key for key in titles if any(math.isfinite(_number(row.get(key))) for row in rows)]
    texts = [
        [
            str(row.get("pose", "")),
            f"{_number(row.get('t')):.3g}",
            *(_percent_plain(_number(row.get(key))) for key in keys),
        ]
        for row in rows
    ]
    marks = ["failed" if row.get("status", "ok") == "failed" else "" for row in rows]
    return Table(["pose", "t", *(titles[key] for key in keys)], texts, marks)


def _region_table(rows: Sequence[Mapping[str, Any]]) -> Table:
    """Per region the median over the poses and the worst pose, of the median and of the 95th percentile."""
    names = dict.fromkeys(name for row in rows for name in row.get("regions") or {})
    texts = []
    for name in names:
        found = [row["regions"][name] for row in rows if name in (row.get("regions") or {})]
        cells = []
        for key in ("median", "p95"):
            values = np.array([_number(figures.get(key)) for figures in found])
            values = values[np.isfinite(values)]
            cells += [float(np.median(values)), float(values.max())] if values.size else [math.nan, math.nan]
        vertices = max((int(figures.get("vertices", 0)) for figures in found), default=0)
        texts.append([name, f"{vertices:,}", *map(_percent_plain, cells)])
    columns = ("region", "vertices", "median", "median, worst pose", "p95", "p95, worst pose")
    return Table(columns, texts)


def _sections(results: SavedResults, pictures: Mapping[str, Picture]) -> list[Section]:
    sections = []
    for anchor, title, text, names in _SECTIONS:
        chosen = [pictures[name] for name in names if name in pictures]
        tables: list[tuple[str, Table, bool]] = []
        if anchor == "errors":
            tables.append(("Root mean square error and its parts, in % of D", parts_table(results.summary), False))
            tables.append(("All curves, in % of D", per_curve_table(results.errors), True))
        if anchor == "truth" and results.truth is not None:
            tables += truth_tables(results.truth)
        if anchor == "capture":
            tables.append(("Poses", pose_table(results.poses), False))
        if chosen or tables:
            sections.append(Section(anchor, title, text, chosen, tables))
        explained = explanation_section(results.summary) if anchor == "errors" else None
        if explained is not None:
            sections.append(explained)
    return sections


def _facts(results: SavedResults) -> list[tuple[str, str]]:
    good = sum(pose.ok for pose in results.poses)
    taken = sum(pose.figures.get("photos", 0.0) for pose in results.poses)
    placed = sum(pose.figures.get("registered", 0.0) for pose in results.poses)
    used = sum(bool(np.any(np.isfinite(row))) for row in np.moveaxis(results.errors.average, 1, 0))
    floor = results.summary.get("noise_floor")
    facts = [("Poses with a result", f"{good} of {len(results.poses)}")]
    if taken:
        facts.append(("Photos placed", f"{placed:.0f} of {taken:.0f}"))
    facts.append(("Curves with a value", f"{used} of {len(results.errors.curves)}"))
    facts.append(
        ("Curve points that count", f"{int(results.curves.counted.sum()):,} of {len(results.curves.counted):,}")
    )
    facts.append(("D, in template units", f"{results.diameter:.2f}"))
    facts.append(("Noise floor", "not measured" if floor is None else f"{percent(float(floor))} of D"))
    facts += error_bar_fact(results.faces, results.diameter, results.summary)
    if results.faces is not None:
        facts.append(("Vertices", f"{results.faces.vertices.shape[1]:,}"))
    tracking = results.truth.tracking.get("median") if results.truth is not None else None
    if tracking is not None and np.any(np.isfinite(tracking)):
        facts.append(("Tracking error, median", f"{percent(float(np.nanmedian(tracking)))} of D"))
    return facts


def _warnings(results: SavedResults) -> list[str]:
    warnings = [f"{pose.name} (t = {pose.t:.4g}) failed: {pose.reason}" for pose in results.poses if not pose.ok]
    warnings += [
        f"{pose.name} (t = {pose.t:.4g}) is doubtful: {text}" for pose in results.poses for text in pose.doubts
    ]
    for row in (results.summary.get("methods") or {}).values():
        warnings += [str(text) for text in row.get("warnings") or [] if str(text) not in warnings]
    hurried = [pose.name for pose in results.poses if pose.figures.get("threads", 1.0) > 1.0]
    if hurried:
        warnings.append(f"solved with several threads, so not repeatable bit for bit: {', '.join(hurried)}")
    lost = {pose.name: _lost_photos(pose) for pose in results.poses if pose.ok and _lost_photos(pose) > 0}
    if lost:
        listed = ", ".join(f"{name} {count}" for name, count in lost.items())
        warnings.append(f"{sum(lost.values())} photos could not be placed: {listed}")
    empty = [
        curve
        for index, curve in enumerate(results.errors.curves)
        if not np.any(np.isfinite(results.errors.average[:, index]))
    ]
    if empty:
        warnings.append(f"no errors for {len(empty)} curves: {', '.join(empty)}")
    return warnings


def _lost_photos(pose: PoseQuality) -> int:
    return round(pose.figures.get("photos", 0.0) - pose.figures.get("registered", 0.0))


def _run_tables(info: Mapping[str, Any], provenance: Mapping[str, Any]) -> list[tuple[str, Table, bool]]:
    tables: list[tuple[str, Table, bool]] = []
    timings = stage_times(provenance.get("timings") or {})
    if timings.rows:
        tables.append(("Time and memory by stage", timings, False))
    tables.append(("Versions", Table(("", "version"), provenance["versions"], text_columns=2), False))
    settings = [
        (f"{stage}.{key}", _text(value))
        for stage, values in (info.get("options") or {}).items()
        for key, value in values.items()
    ]
    settings = [("source", str(info["source"])), *settings] if info.get("source") else settings
    if settings:
        tables.append(("Settings", Table(("setting", "value"), settings, text_columns=2), True))
    terms = [(str(key), _text(value)) for key, value in (info.get("terms") or {}).items() if value]
    if terms:
        tables.append(("Terms of the data", Table(("", ""), terms, text_columns=2), False))
    hashes = [(str(name), str(value)) for name, value in (provenance.get("hashes") or {}).items()]
    if hashes:
        tables.append(("SHA-256 of inputs and results", Table(("file", "SHA-256"), hashes, text_columns=2), True))
    return tables


def stage_times(timings: Mapping[str, Mapping[str, Any]]) -> Table:
    """Sum the times of all poses per stage; ``timings`` is by step (``dense_pose_03``)."""
    groups: dict[str, list[Mapping[str, Any]]] = {}
    for step, row in timings.items():
        stage = next((name for name in _STAGE_ORDER if re.match(rf"{name}(_|$)", step)), step)
        groups.setdefault(stage, []).append(row)
    order = sorted(groups, key=lambda name: _STAGE_ORDER.index(name) if name in _STAGE_ORDER else len(_STAGE_ORDER))
    rows = []
    totals = [0.0, 0.0, 0.0]
    for name in order:
        seconds = sum(float(row.get("seconds", 0.0)) for row in groups[name])
        cpu = sum(float(row.get("cpu_seconds", 0.0)) for row in groups[name])
        memory = max(float(row.get("peak_memory_mb", 0.0)) for row in groups[name])
        totals = [totals[0] + seconds, totals[1] + cpu, max(totals[2], memory)]
        rows.append((name, str(len(groups[name])), f"{seconds:.1f}", f"{cpu:.1f}", f"{memory:,.0f}"))
    if rows:
        rows.append(("all", "", f"{totals[0]:.1f}", f"{totals[1]:.1f}", f"{totals[2]:,.0f}"))
    return Table(("stage", "runs", "seconds, summed", "CPU seconds", "peak memory, MB"), rows)


def _bars(scores: Mapping[str, MethodScore]) -> list[Bar]:
    styles = figure_style.method_styles(list(scores))
    return [
        Bar(styles[name].label, styles[name].colour, 100.0 * score.largest_average, 100.0 * score.largest_maximum)
        for name, score in scores.items()
    ]


def _place(entry: Mapping[str, Any], figure: str) -> str:
    curve = entry.get(f"{figure}_curve")
    return "—" if curve is None else f"{curve}, t = {_number(entry.get(f'{figure}_t')):.3g}"


def _number(value: Any) -> float:
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else math.nan


def _plain(value: Any, digits: int) -> str:
    number = _number(value)
    return f"{number:.{digits}f}" if math.isfinite(number) else "—"


def _mean(values: Any) -> float:
    known = values[np.isfinite(values)]
    return float(known.mean()) if known.size else math.nan


def _largest(values: Any) -> float:
    known = values[np.isfinite(values)]
    return float(known.max()) if known.size else math.nan


def _percent_plain(value: float) -> str:
    return f"{100.0 * value:.3f}" if math.isfinite(value) else "—"


def _text(value: Any) -> str:
    text = value if isinstance(value, str) else json.dumps(value, ensure_ascii=False, default=str)
    return text if len(text) <= 300 else text[:297] + "…"
