"""The sheet for the actor and the coverage curve: planned expressions as pictures with names and weights."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from capture_eval.report import figure_style
from capture_eval.report.mesh_rendering import CLAY_COLOUR, Preset, render_mesh

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Floats = NDArray[np.float64]
Bytes = NDArray[np.uint8]

# Dark enough for text on white, different for people with any common colour blindness (Okabe and Ito, darkened).
GROUP_COLOURS = ("#0072B2", "#D55E00", "#00805E", "#A8437F", "#8C6D1F", "#3C8DBC", "#555555", "#7B3294")
_SIDES = (("Left", "Right"), ("left", "right"), ("_L", "_R"), ("_l", "_r"), (".L", ".R"), (".l", ".r"))
_LONGEST_LABEL = 34
_CELL_WIDTH = 44.0 * figure_style.MILLIMETRE
_PICTURE_HEIGHT = 50.0 * figure_style.MILLIMETRE
_LINE_HEIGHT = 2.7 * figure_style.MILLIMETRE
_PICTURE_SIZE = (352, 400)


@dataclass(frozen=True)
class SheetCell:
    """One picture of the sheet.

    Attributes
    ----------
    heading, note : str
        Number and share covered.
    picture : (H, W, 3) uint8
    lines : tuple of (text, colour)
        Groups of shapes with their weights, in the colour that marks them in the picture.
    """

    heading: str
    note: str
    picture: Bytes
    lines: tuple[tuple[str, str], ...]


def group_labels(names: Sequence[str]) -> tuple[str, ...]:
    """Lines that name shapes used together: a left and right pair as one, too long names one by one."""
    if len(names) == 2:
        for left, right in _SIDES:
            for first, second in ((names[0], names[1]), (names[1], names[0])):
                once = first.count(left) == 1 and right not in first
                if once and first.replace(left, right) == second:
                    return (_shortened(f"{first.replace(left, '')} (L + R)"),)
    joined = " + ".join(names)
    if len(joined) <= _LONGEST_LABEL:
        return (joined,)
    return tuple(_shortened(name) for name in names)


def expression_cell(
    heading: str,
    note: str,
    vertices: Floats,
    triangles: NDArray[np.int64],
    groups: Sequence[tuple[Sequence[str], NDArray[np.floating]]],
    frame: Floats,
    preset: Preset = "front",
) -> SheetCell:
    """Render one expression, each group of shapes tinted where it moves the face.

    Parameters
    ----------
    vertices : (N, 3) float64
        The posed face, y up and z out of the face.
    groups : sequence of (names, strength (N,))
        Strength from 0 to 1 of the group's movement at every vertex.
    frame : (M, 3) float64
        Points that all pictures hold, for one scale.
    """
    from matplotlib.colors import to_rgb

    colours = np.tile(np.asarray(CLAY_COLOUR), (len(vertices), 1))
    lines = []
    for number, (names, strength) in enumerate(groups):
        colour = GROUP_COLOURS[number % len(GROUP_COLOURS)]
        share = 0.6 * np.clip(strength, 0.0, 1.0)[:, None]
        colours = (1.0 - share) * colours + share * np.asarray(to_rgb(colour))
        lines += [(f"{label}  1.0", colour) for label in group_labels(names)]
    picture = render_mesh(
        vertices, triangles, colours=colours, preset=preset, size=_PICTURE_SIZE, frame=frame, supersampling=2
    )
    return SheetCell(heading, note, picture, tuple(lines))


def draw_sheet(cells: Sequence[SheetCell], title: str, columns: int = 4) -> Figure:
    """Draw the cells row by row."""
    rows = math.ceil(len(cells) / columns)
    most = max((len(cell.lines) for cell in cells), default=0)
    text_height = _LINE_HEIGHT * (most + 3.2)
    top = 9.0 * figure_style.MILLIMETRE
    width, cell_height = columns * _CELL_WIDTH, _PICTURE_HEIGHT + text_height
    height = rows * cell_height + top
    figure = figure_style.new_figure(width, height)
    figure.set_layout_engine("none")
    figure.text(0.012, 1.0 - 0.55 * top / height, title, fontsize=9, fontweight="bold", va="center")
    for number, cell in enumerate(cells):
        row, column = divmod(number, columns)
        upper = height - top - row * cell_height
        axes = figure.add_axes(
            (column / columns, (upper - _PICTURE_HEIGHT) / height, 1.0 / columns, _PICTURE_HEIGHT / height)
        )
        axes.imshow(cell.picture, interpolation="lanczos")
        axes.set_axis_off()
        left = (column + 0.06) / columns
        below = upper - _PICTURE_HEIGHT - 0.8 * _LINE_HEIGHT
        figure.text(left, below / height, cell.heading, fontsize=7.5, fontweight="bold", va="center")
        figure.text(
            (column + 0.94) / columns,
            below / height,
            cell.note,
            fontsize=6,
            color=figure_style.QUIET_COLOUR,
            ha="right",
            va="center",
        )
        for place, (text, colour) in enumerate(cell.lines):
            y = (below - (place + 1.15) * _LINE_HEIGHT) / height
            figure.text(left, y, text, fontsize=6, color=colour, va="center")
    return figure


def draw_coverage(covered: Sequence[float], proven_fewest: int, full_count: int | None) -> Figure:
    """Draw the share of the total importance that is covered after k captures.

    Parameters
    ----------
    covered : sequence of float
        In [0, 1], after 1, 2, … captures.
    proven_fewest : int
        No plan of all shapes has fewer expressions.
    full_count : int or None
        Expressions that this plan needs for all shapes.
    """
    from matplotlib.ticker import MaxNLocator

    figure = figure_style.new_figure(figure_style.SINGLE_COLUMN, 0.68 * figure_style.SINGLE_COLUMN)
    axes = figure.add_subplot()
    share = 100.0 * np.concatenate([[0.0], np.asarray(covered, dtype=np.float64)])
    axes.plot(np.arange(len(share)), share, color=GROUP_COLOURS[0], marker="o", markersize=3)
    axes.axvline(proven_fewest, color=figure_style.QUIET_COLOUR, linewidth=0.8, linestyle=(0, (3, 2)))
    text = f"proven: no fewer than {proven_fewest}"
    if full_count == proven_fewest:
        text = f"{proven_fewest} captures, proven fewest"
    axes.text(proven_fewest - 0.25, 4, text, rotation=90, fontsize=6, ha="right", color=figure_style.QUIET_COLOUR)
    for level in (50.0, 80.0):
        reached = np.flatnonzero(share >= level)
        if len(reached):
            axes.annotate(
                f"{share[reached[0]]:.0f} % after {reached[0]}",
                (float(reached[0]), float(share[reached[0]])),
                xytext=(6, -9),
                textcoords="offset points",
                fontsize=6,
            )
    axes.set_xlim(0, max(len(share) - 1, proven_fewest) + 0.6)
    axes.set_ylim(0, 104)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set_xlabel("captured expressions")
    axes.set_ylabel("covered share of transfer risk  (%)")
    return figure


def movement_strength(lengths: NDArray[np.floating], threshold: float) -> Floats:
    """How strongly a group is tinted at each vertex (N,): 0 well below the threshold, 1 above it.

    Parameters
    ----------
    lengths : (M, N)
        Displacement of every shape of the group as share of its largest.
    """
    strongest = lengths.max(axis=0)
    return np.asarray(np.clip((strongest - 0.5 * threshold) / (0.5 * threshold), 0.0, 1.0), dtype=np.float64)


def render_cells(count: int, cell: Callable[[int], SheetCell], progress: Callable[[int, int], None]) -> list[SheetCell]:
    """Render cells 0 … count - 1 and say how far it is."""
    cells = []
    for number in range(count):
        cells.append(cell(number))
        progress(number + 1, count)
    return cells


def _shortened(text: str) -> str:
    return text if len(text) <= _LONGEST_LABEL else text[: _LONGEST_LABEL - 1] + "…"
