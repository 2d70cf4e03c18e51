"""Pictures of expression edits: what was dragged, what came of it, and how far each control point reaches."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from capture_eval.cameras import View, project
from capture_eval.editing.expression_editor import Edit
from capture_eval.errors import InputError
from capture_eval.report.figure_style import new_figure
from capture_eval.report.mesh_rendering import CLAY_COLOUR, render_mesh

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

# Okabe and Ito; the regions of more control points start over
REGION_COLOURS = ((0.90, 0.62, 0.00), (0.00, 0.45, 0.70), (0.00, 0.62, 0.45), (0.80, 0.47, 0.65), (0.84, 0.37, 0.00))
START_COLOUR, TARGET_COLOUR, REACHED_COLOUR = "#B2182B", "#0B4F9E", "#1B1B1B"
_PANEL = 1.35  # inches wide


@dataclass(frozen=True)
class EditPanel:
    """One picture of a sheet.

    Attributes
    ----------
    title, note : str
        Above and below it.
    vertices : (N, 3)
    colours : (N, 3) in [0, 1], optional
    starts, targets, reached : (L, 2) pixels of the view, optional
        Where control points were, were dragged to, and came to.
    """

    title: str
    vertices: Floats
    note: str = ""
    colours: Floats | None = None
    starts: Floats | None = None
    targets: Floats | None = None
    reached: Floats | None = None


def region_colours(influence: Floats) -> Floats:
    """Colour (N, 3) of every vertex: its control points' colours mixed by their shares; clay where there is none.

    Shares above an even split are stressed, since maps of paper 001 fall off slowly.
    """
    count = influence.shape[1]
    palette = np.array([REGION_COLOURS[k % len(REGION_COLOURS)] for k in range(count)])
    stressed = influence**3
    total = stressed.sum(axis=1, keepdims=True)
    mixed = (stressed @ palette) / np.where(total > 0, total, 1.0)
    return np.asarray(np.where(total > 0, mixed, np.asarray(CLAY_COLOUR)), dtype=np.float64)


def map_colours(values: Floats) -> Floats:
    """Colour (N, 3) of a coherency or influence in [0, 1]."""
    import matplotlib

    return np.asarray(matplotlib.colormaps["viridis"](np.clip(values, 0.0, 1.0)), dtype=np.float64)[:, :3]


def drag_panels(neutral: Floats, edit: Edit, view: View, title: str) -> list[EditPanel]:
    """Three pictures of an edit of the face itself: drags on the neutral, the new face, and the soft regions.

    Raises
    ------
    InputError
        The edit was made for another face.
    """
    if edit.carrier is not None or len(neutral) != len(edit.vertices):
        raise InputError("sheet: the edit belongs to another face; draw the template")
    rows = [control.vertex for control in edit.controls]
    starts, _ = project(view, neutral[rows])
    reached, _ = project(view, edit.vertices[rows])
    targets = starts.copy()
    for row, control in enumerate(edit.controls):
        if len(control.target) == 3:
            targets[row] = project(view, np.array([control.target]))[0][0]
        elif edit.projection is not None:
            # on the view's own screen, or on another one: then by the way the point has to go there
            targets[row] = _on_view(edit, row, neutral, view)
    asked = np.linalg.norm(targets - starts, axis=1).max()
    missed = np.linalg.norm(targets - reached, axis=1).max()
    note = f"drag {asked:.0f} px, miss {missed:.1f} px" + (", limited" if np.any(edit.limited) else "")
    return [
        EditPanel(title, neutral, "", None, starts, targets),
        EditPanel("result", edit.vertices, note, None, None, targets, reached),
        EditPanel("soft regions", neutral, "", region_colours(edit.influence), starts),
    ]


def draw_edit_sheet(rows: Sequence[Sequence[EditPanel]], triangles: Integers, view: View) -> Figure:
    """A grid of pictures from one view; red: where a control point was, blue: where it was dragged, black: where it is.

    Raises
    ------
    InputError
        No pictures.
    """
    columns = max((len(row) for row in rows), default=0)
    if not columns:
        raise InputError("sheet: no pictures")
    width, height = view.intrinsics.width, view.intrinsics.height
    panel_height = _PANEL * height / width + 0.3
    figure = new_figure(columns * _PANEL, len(rows) * panel_height, padding=0.02)
    grid = figure.subplots(len(rows), columns, squeeze=False)
    for axes_row, panels in zip(grid, rows, strict=True):
        for axes in axes_row:
            axes.axis("off")
        for axes, panel in zip(axes_row, panels, strict=False):
            picture = render_mesh(panel.vertices, triangles, colours=panel.colours, view=view, supersampling=2)
            axes.imshow(picture, extent=(0, width, height, 0))
            axes.set_xlim(0, width)
            axes.set_ylim(height, 0)
            axes.set_title(panel.title, fontsize=6.5, pad=2.0, loc="center")
            if panel.note:
                axes.text(0.5, -0.01, panel.note, transform=axes.transAxes, ha="center", va="top", fontsize=5.5)
            _mark(axes, panel)
    return figure


def _on_view(edit: Edit, row: int, neutral: Floats, view: View) -> Floats:
    screen, control = edit.projection, edit.controls[row]
    if screen is None:
        raise InputError("sheet: a pixel without a camera")
    pixel, slope = screen.project_with_jacobian(neutral[control.vertex])
    step = np.linalg.pinv(slope) @ (np.asarray(control.target) - pixel)  # the shortest way there, across the view
    return np.asarray(project(view, (neutral[control.vertex] + step)[None])[0][0], dtype=np.float64)


def _mark(axes: Axes, panel: EditPanel) -> None:
    if panel.starts is not None and panel.targets is not None:
        for start, end in zip(panel.starts, panel.targets, strict=True):
            if np.linalg.norm(end - start) > 1.0:
                axes.annotate(
                    "", end, start, arrowprops={"arrowstyle": "-|>", "color": TARGET_COLOUR, "lw": 0.9, "shrinkA": 0,
                                                "shrinkB": 0, "mutation_scale": 5},
                )  # fmt: skip
    edge: dict[str, Any] = {"edgecolors": "white", "linewidths": 0.4}
    if panel.targets is not None:
        axes.scatter(panel.targets[:, 0], panel.targets[:, 1], s=12, c=TARGET_COLOUR, zorder=4, **edge)
    if panel.starts is not None:
        axes.scatter(panel.starts[:, 0], panel.starts[:, 1], s=12, c=START_COLOUR, zorder=5, **edge)
    if panel.reached is not None:
        axes.scatter(panel.reached[:, 0], panel.reached[:, 1], s=4, c=REACHED_COLOUR, zorder=6, **edge)
