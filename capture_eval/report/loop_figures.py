"""Pictures of edge loops and curves on their mesh, each in a colour of its own with its number or name."""

from __future__ import annotations

import colorsys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from capture_eval.cameras import View, project
from capture_eval.errors import InputError
from capture_eval.report.face_figures import look_at, visible_points
from capture_eval.report.figure_style import new_figure, paper_style
from capture_eval.report.mesh_rendering import render_mesh

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

_UP, _FRONT = np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0])
_VIEWS = (("front", 0.0), ("left side", 90.0))
_PANEL = (1100, 1300)
_PIECES = 4  # pieces an edge is cut into, so that it can vanish half-way behind the nose


@dataclass(frozen=True)
class DrawnLoop:
    """A loop to draw: its label, its vertices in order and whether it closes."""

    label: str
    vertices: Integers
    closed: bool


def draw_loops(
    vertices: Floats, triangles: Integers, edges: Integers, loops: Sequence[DrawnLoop], title: str
) -> Figure:
    """Front and side view of a mesh with its loops.

    Parameters
    ----------
    vertices : (V, 3) float64
        x to the subject's left, y up, z out of the face.
    triangles : (K, 3) int64
        For hiding what lies behind.
    edges : (E, 2) int64
        Drawn thin below the loops.
    loops : sequence of DrawnLoop
        In the order of their colours.
    title : str
        Above the picture.

    Returns
    -------
    Figure
        Not attached to a window.

    Raises
    ------
    InputError
        There is no loop to draw.
    """
    if not loops:
        raise InputError("there is no loop to draw")
    colours = _distinct_colours(len(loops))
    with paper_style():
        figure = new_figure(14.0, 8.6)
        figure.suptitle(title, x=0.01, ha="left", fontsize=10, fontweight="bold")
        for axes, (name, turn) in zip(figure.subplots(1, 2), _VIEWS, strict=True):
            view = look_at(vertices, _UP, _FRONT, turn, _PANEL)
            coarse = look_at(vertices, _UP, _FRONT, turn, (_PANEL[0] // 2, _PANEL[1] // 2))
            clay = render_mesh(vertices, triangles, view=coarse, supersampling=2)
            axes.imshow(0.45 * clay / 255.0 + 0.55, extent=(0, _PANEL[0], _PANEL[1], 0), interpolation="bilinear")
            axes.set_title(name)
            axes.set_axis_off()
            tolerance = 2e-3 * float(np.ptp(vertices, axis=0).max())
            _draw_edges(axes, vertices, triangles, edges, view, tolerance)
            _draw_on_view(axes, vertices, triangles, loops, colours, view, tolerance)
        return figure


def _distinct_colours(count: int) -> list[tuple[float, float, float]]:
    """Hues a golden ratio apart, in three brightnesses, none too pale for white text on it."""
    colours = []
    for i in range(count):
        rgb = np.array(colorsys.hsv_to_rgb((0.58 + 0.618034 * i) % 1.0, 0.95, (0.85, 0.68, 0.5)[i % 3]))
        luminance = float(rgb**2.2 @ [0.2126, 0.7152, 0.0722])
        red, green, blue = (rgb * min(1.0, 0.24 / luminance) ** (1 / 2.2)).tolist()
        colours.append((red, green, blue))
    return colours


def _visible_pieces(
    vertices: Floats, triangles: Integers, pairs: Integers, view: View, tolerance: float
) -> tuple[Floats, NDArray[np.bool_]]:
    """Pixels of the pieces of edges, (N, pieces, 2, 2), and which can be seen, (N, pieces)."""
    shares = np.linspace(0.0, 1.0, _PIECES + 1)[:, None]
    first, last = vertices[pairs[:, 0], None], vertices[pairs[:, 1], None]
    points = first + shares * (last - first)
    middles = 0.5 * (points[:, :-1] + points[:, 1:])
    seen = visible_points(vertices, triangles, middles.reshape(-1, 3), view, tolerance)
    pixels = project(view, points.reshape(-1, 3))[0].reshape(len(pairs), _PIECES + 1, 2)
    return np.stack([pixels[:, :-1], pixels[:, 1:]], axis=2), np.asarray(seen).reshape(len(pairs), _PIECES)


def _draw_edges(
    axes: Axes, vertices: Floats, triangles: Integers, edges: Integers, view: View, tolerance: float
) -> None:
    from matplotlib.collections import LineCollection

    pieces, seen = _visible_pieces(vertices, triangles, edges, view, tolerance)
    axes.add_collection(LineCollection(list(pieces[seen]), colors="#8A8F98", linewidths=0.25, alpha=0.6))


def _draw_on_view(
    axes: Axes,
    vertices: Floats,
    triangles: Integers,
    loops: Sequence[DrawnLoop],
    colours: Sequence[tuple[float, float, float]],
    view: View,
    tolerance: float,
) -> None:
    from matplotlib.collections import LineCollection

    pairs, owners = _edges_of_loops(loops)
    pieces, seen = _visible_pieces(vertices, triangles, pairs, view, tolerance)
    places: list[tuple[int, Floats]] = []
    for number, colour in enumerate(colours):
        own = owners == number
        shown = pieces[own][seen[own]]
        axes.add_collection(LineCollection(list(shown), colors=[colour], linewidths=1.1, capstyle="round"))
        if len(shown):
            places.append((number, shown.mean(axis=1)))
    letters = max(len(loop.label) for loop in loops)
    for number, position in _spread_labels(places, 5.0 * letters):
        axes.text(
            float(position[0]),
            float(position[1]),
            loops[number].label,
            color="white",
            fontsize=5.6 if letters <= 4 else 4.6,
            ha="center",
            va="center",
            bbox={"boxstyle": "round,pad=0.18", "facecolor": colours[number], "edgecolor": "white", "linewidth": 0.4},
        )


def _edges_of_loops(loops: Sequence[DrawnLoop]) -> tuple[Integers, Integers]:
    """Vertex pairs of all loops, (N, 2), and the loop of each, (N,)."""
    pairs = []
    for loop in loops:
        steps = np.stack([loop.vertices, np.roll(loop.vertices, -1)], axis=1)
        pairs.append(steps if loop.closed else steps[:-1])
    owners = np.repeat(np.arange(len(loops)), [len(steps) for steps in pairs])
    return np.concatenate(pairs), owners


def _spread_labels(places: Sequence[tuple[int, Floats]], width: float) -> list[tuple[int, Floats]]:
    """One place per loop, as far as can be from the labels already set; loops with little choice go first.

    ``width`` is about half that of a label in pixels: labels may stand closer above one another than side by side.
    """
    chosen: list[tuple[int, Floats]] = []
    for number, candidates in sorted(places, key=lambda place: len(place[1])):
        index = len(candidates) // 2
        if chosen:
            others = np.array([position for _, position in chosen])
            gaps = np.abs(candidates[:, None] - others) / [width, 12.0]
            apart = gaps.max(axis=2).min(axis=1)
            index = int(np.argmax(np.minimum(apart, 4.0)))
        chosen.append((number, candidates[index]))
    return chosen
