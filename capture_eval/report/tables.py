"""Tables as text: CSV, Markdown and LaTeX from the same rows. The only place where numbers are rounded."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Cell = str | float | None

_LATEX = {
    "\\": r"\textbackslash{}",
    "_": r"\_",
    "%": r"\%",
    "&": r"\&",
    "#": r"\#",
    "$": r"\$",
    "{": r"\{",
    "}": r"\}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
}


@dataclass(frozen=True)
class Table:
    """Rows for reading.

    Parameters
    ----------
    title : str
        What it shows, with definitions and unit.
    header : tuple of str
        Column names.
    rows : tuple of tuple of (str, float or None)
        Cells; None and NaN print as a dash.
    digits : int
        Digits after the point.
    """

    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    digits: int = 3


def _text(cell: Cell, digits: int, missing: str) -> str:
    if isinstance(cell, str):
        return cell
    if cell is None or not math.isfinite(cell):
        return missing
    return f"{cell:.{digits}f}"


def to_csv(table: Table) -> str:
    """Comma-separated, header first, missing cells empty."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(table.header)
    writer.writerows([_text(cell, table.digits, "") for cell in row] for row in table.rows)
    return stream.getvalue()


def to_markdown(table: Table) -> str:
    """A Markdown table under its title; numbers are aligned to the right."""
    cells = [list(table.header)] + [[_text(cell, table.digits, "–") for cell in row] for row in table.rows]
    cells = [[cell.replace("|", "\\|") for cell in row] for row in cells]
    widths = [max(len(row[i]) for row in cells) for i in range(len(table.header))]
    left = [_is_text_column(table, i) for i in range(len(table.header))]

    def line(row: Sequence[str]) -> str:
        padded = [cell.ljust(w) if keep else cell.rjust(w) for cell, w, keep in zip(row, widths, left, strict=True)]
        return "| " + " | ".join(padded) + " |"

    rule = ["-" * w if keep else "-" * (w - 1) + ":" for w, keep in zip(widths, left, strict=True)]
    return "\n".join([table.title, "", line(cells[0]), line(rule), *map(line, cells[1:]), ""])


def to_latex(table: Table) -> str:
    """A LaTeX ``table`` with booktabs rules, ready for a paper."""
    columns = "".join("l" if _is_text_column(table, i) else "r" for i in range(len(table.header)))
    rows = [" & ".join(_escape(_text(cell, table.digits, "--")) for cell in row) + r" \\" for row in table.rows]
    lines = [
        "% needs \\usepackage{booktabs}",
        r"\begin{table}",
        r"\centering",
        rf"\caption{{{_escape(table.title)}}}",
        rf"\begin{{tabular}}{{{columns}}}",
        r"\toprule",
        " & ".join(map(_escape, table.header)) + r" \\",
        r"\midrule",
        *rows,
        r"\bottomrule",
        r"\end{tabular}",
        r"\end{table}",
        "",
    ]
    return "\n".join(lines)


def _is_text_column(table: Table, index: int) -> bool:
    return any(isinstance(row[index], str) for row in table.rows)


def _escape(text: str) -> str:
    escaped = "".join(_LATEX.get(character, character) for character in text)
    return escaped.replace("–", "--").replace("×", r"$\times$").replace("≤", r"$\leq$")


def lme_lae_table(summary: Mapping[str, Any]) -> Table:
    """LME and LAE of every method, where they occur, and their size relative to geometric linear.

    The oracles come last under their titles: bounds computed from the truth, not methods.

    Parameters
    ----------
    summary : mapping
        Content of ``summary.json``.
    """
    rows = []
    bounds = {row["title"]: row for row in summary.get("oracles", {}).values()}
    for name, row in {**summary["methods"], **bounds}.items():
        cells: list[Cell] = [name]
        for key in ("LME", "LAE"):
            cells.append(_percent(row[key]))
            cells.append(row[f"{key}_curve"])
            cells.append(_moment(row[f"{key}_t"]))
            cells.append(row[f"{key}_ratio_to_linear"])
        rows.append((*cells, _percent(row.get("rms_timing")), _percent(row.get("rms_path"))))
    header: tuple[str, ...] = ("method",)
    for key in ("LME", "LAE"):
        header += (f"{key} (% D)", f"{key} curve", f"{key} t", f"{key} / linear")
    title = (
        "Largest maximum error (LME) and largest average error (LAE) over all curves and in-between poses, in % of "
        f"D = {summary['D']:.6g}; RMS error split into timing (along the way) and path (across it)."
    )
    return Table(title, (*header, "RMS timing (% D)", "RMS path (% D)"), tuple(rows))


def _percent(value: float | None) -> float | None:
    return None if value is None else 100.0 * value


def _moment(value: float | None) -> str | None:
    return None if value is None else f"{value:g}"


def per_curve_table(
    curves: Sequence[str],
    methods: Sequence[str],
    n_points: NDArray[np.int64],
    average: NDArray[np.float64],
    maximum: NDArray[np.float64],
) -> Table:
    """Errors of every curve: the largest E_M and the mean E_A over the in-between poses, per method.

    Parameters
    ----------
    curves, methods : sequence of str
        N and K names.
    n_points : (N, T)
        Points that count.
    average, maximum : (K, N, T)
        E_A and E_M as fractions of D.
    """
    rows = []
    for n, curve in enumerate(curves):
        points = int(n_points[n].max()) if n_points.shape[1] else 0
        cells: list[Cell] = [str(n + 1), curve, str(points)]
        cells += [_over_time(maximum[k, n], np.max) for k in range(len(methods))]
        cells += [_over_time(average[k, n], np.mean) for k in range(len(methods))]
        rows.append(tuple(cells))
    header = ("no.", "curve", "points", *(f"E_M {name}" for name in methods), *(f"E_A {name}" for name in methods))
    title = "Per curve: the maximum over the in-between poses of E_M and the mean over them of E_A, in % of D."
    return Table(title, header, tuple(rows))


def _over_time(values: NDArray[np.float64], reduce: Any) -> float | None:
    finite = values[np.isfinite(values)]
    return 100.0 * float(reduce(finite)) if finite.size else None


def errors_csv(rows: Sequence[tuple[str, str, float, int, float, float]]) -> str:
    """``errors.csv`` in full precision: the shortest text that reads back as the same double, ``nan`` for no value."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(("method", "curve", "t", "n_points", "E_A", "E_M"))
    writer.writerows((m, c, repr(t), n, repr(average), repr(maximum)) for m, c, t, n, average, maximum in rows)
    return stream.getvalue()


def error_bars_csv(rows: Sequence[tuple[str, float, int, float, float, float]]) -> str:
    """``error_bars.csv``: what the ground truth's own error does to E_A and E_M, fractions of D in full precision."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(("curve", "t", "n_points", "E_A_floor", "E_A_bar", "E_M_bar"))
    writer.writerows((c, repr(t), n, *map(repr, values)) for c, t, n, *values in rows)
    return stream.getvalue()
