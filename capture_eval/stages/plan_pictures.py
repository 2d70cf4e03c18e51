"""Pictures of a plan: the sheet for the actor (PNG, PDF), the coverage curve, and the page."""

from __future__ import annotations

import io
import logging
from collections.abc import Sequence
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from capture_eval.errors import InputError
from capture_eval.files.atomic import atomic_path, write_text
from capture_eval.planning.blendshape_rig import BlendshapeRig
from capture_eval.planning.planner import CapturePlan, PlanOptions
from capture_eval.report.figure_style import RASTER_DPI, paper_style
from capture_eval.report.mesh_rendering import PRESETS, Preset
from capture_eval.report.plan_page import PageExpression, PlanPage, render_plan_page
from capture_eval.report.plan_sheet import (
    SheetCell,
    draw_coverage,
    draw_sheet,
    expression_cell,
    movement_strength,
    render_cells,
)

Floats = NDArray[np.float64]
logger = logging.getLogger("capture_eval.plan")
_CELLS_A_PAGE = 12
_MOVES, _MARGIN = 0.1, 1.15


def draw_plan(
    rig: BlendshapeRig,
    plan: CapturePlan,
    neutral: Floats,
    posed: Sequence[Floats],
    options: PlanOptions,
    view: str,
    out: Path,
) -> None:
    """Write ``figures/plan_sheet.{png,pdf}``, ``figures/coverage.{png,pdf}`` and ``plan.html``.

    Raises
    ------
    InputError
        There is no such view.
    """
    check_view(view)
    cells = _cells(rig, plan, neutral, posed, options.threshold, cast(Preset, view))
    title = f"Capture plan: {len(plan.expressions)} expressions, every shape at weight 1.0"
    with paper_style():
        sheet = draw_sheet(cells, title)
        _save(out / "figures" / "plan_sheet.png", sheet)
        _save_pages(out / "figures" / "plan_sheet.pdf", cells, title)
        curve = draw_coverage([e.covered for e in plan.expressions], plan.lower_bound, plan.full_count)
        _save(out / "figures" / "coverage.png", curve)
        _save(out / "figures" / "coverage.pdf", curve)
        coverage = io.BytesIO()
        curve.savefig(coverage, format="png", dpi=160, metadata={"Software": None})
    write_text(out / "plan.html", render_plan_page(_page(rig, plan, cells, coverage.getvalue(), options)))


def check_view(view: str) -> None:
    """Refuse an unknown view, before anything is computed.

    Raises
    ------
    InputError
        There is no such view.
    """
    if view not in PRESETS:
        raise InputError(f"view {view!r}: there are {', '.join(PRESETS)}")


def _cells(
    rig: BlendshapeRig, plan: CapturePlan, neutral: Floats, posed: Sequence[Floats], threshold: float, view: Preset
) -> list[SheetCell]:
    largest = rig.lengths.max(axis=1, initial=1e-300)[:, None]
    frame = _moving_part(rig, neutral, posed)

    def cell(number: int) -> SheetCell:
        if number == 0:
            return expression_cell("Neutral", "capture first", neutral, rig.triangles, [], frame, view)
        expression = plan.expressions[number - 1]
        groups = []
        for shapes in plan.items:
            if shapes[0] in expression.shapes:
                lengths = rig.lengths[list(shapes)] / largest[list(shapes)]
                groups.append(([rig.names[shape] for shape in shapes], movement_strength(lengths, threshold)))
        note = f"{100.0 * expression.covered:.0f} % covered"
        return expression_cell(f"{number}", note, posed[number - 1], rig.triangles, groups, frame, view)

    def say(done: int, total: int) -> None:
        if done % 5 == 0 or done == total:
            logger.info("pictures: %d/%d", done, total)

    return render_cells(len(plan.expressions) + 1, cell, say)


def _moving_part(rig: BlendshapeRig, neutral: Floats, posed: Sequence[Floats]) -> Floats:
    """Points that the pictures hold: whatever moves, with a margin, so that the face fills the picture."""
    strongest = rig.lengths.max(axis=0, initial=0.0)
    moving = strongest >= _MOVES * strongest.max(initial=0.0)
    points = np.concatenate([vertices[moving] for vertices in (neutral, *posed)])
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    return np.asarray(middle + _MARGIN * (points - middle), dtype=np.float64)


def _save(path: Path, figure: Any) -> None:
    metadata = {"CreationDate": None} if path.suffix == ".pdf" else {"Software": None}
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=RASTER_DPI, metadata=metadata)


def _save_pages(path: Path, cells: Sequence[SheetCell], title: str) -> None:
    from matplotlib.backends.backend_pdf import PdfPages

    pages = [cells[start : start + _CELLS_A_PAGE] for start in range(0, len(cells), _CELLS_A_PAGE)]
    with atomic_path(path) as temporary, PdfPages(temporary, metadata={"CreationDate": None}) as document:
        for number, page in enumerate(pages, 1):
            document.savefig(draw_sheet(page, f"{title}  ({number}/{len(pages)})"), dpi=RASTER_DPI)


def _page(
    rig: BlendshapeRig, plan: CapturePlan, cells: Sequence[SheetCell], coverage: bytes, options: PlanOptions
) -> PlanPage:
    expressions = []
    for number, cell in enumerate(cells):
        shapes = [(text.rsplit("  ", 1)[0], "1.0", colour) for text, colour in cell.lines]
        found = plan.expressions[number - 1] if number else None
        expressions.append(
            PageExpression(
                cell.heading if found is None else f"Expression {number}",
                _png(cell.picture),
                shapes,
                "" if found is None else f"{found.value:.3f}",
                "" if found is None else f"{found.bound:.3f}",
                "" if found is None else f"{100.0 * found.covered:.0f} %",
            )
        )
    planned = rig.shape_count - len(plan.uncaptured)
    facts = [
        ("mode", options.mode),
        ("threshold of activity", f"{options.threshold:g}"),
        ("weights", "all equal" if options.unit_weights else f"alpha {options.alpha:g}, beta {options.beta:g}"),
        ("rig", f"{rig.shape_count} shapes, {len(rig.neutral)} vertices"),
        ("symmetric pairs", str(len(plan.pairs))),
        ("rows of the 0/1 programme", f"{plan.rows.vertices} vertices → {len(plan.rows.maximal)} maximal"),
        (
            "shapes that all overlap",
            ", ".join("+".join(rig.names[s] for s in group) for group in plan.clique) or "none",
        ),
    ]
    title = f"Capture plan of {planned} shapes"
    return PlanPage(title, verdict(plan), facts, coverage, expressions, [rig.names[s] for s in plan.uncaptured])


def verdict(plan: CapturePlan) -> str:
    """One sentence: how many captures, and whether fewer would do."""
    count = len(plan.expressions)
    if plan.full_count is None or plan.full_count > count:
        share = 100.0 * plan.expressions[-1].covered if plan.expressions else 0.0
        need = plan.lower_bound
        return f"The first {count} captures cover {share:.0f} % of the transfer risk; all shapes need {need} or more."
    if plan.fewest:
        return f"{count} captures cover all shapes, and no plan does with fewer (proven)."
    return f"{count} captures cover all shapes; {plan.lower_bound} or more are needed (gap {count - plan.lower_bound})."


def _png(picture: NDArray[np.uint8]) -> bytes:
    from PIL import Image

    text = io.BytesIO()
    Image.fromarray(picture).save(text, format="PNG")
    return text.getvalue()
