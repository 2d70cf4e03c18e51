"""Paths of single skin points (chin, lip, lid): ground truth against every method (paper 003, Figures 1 and 2)."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from . import figure_style
from .saved_results import CurvePositions

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Floats = NDArray[np.float64]

CAPTION = (
    "Left: all curves at t = 0 seen from the side, with the places of the points. "
    "Right, one column per point: its path in the sagittal plane at equal scale; how far it has come along the chord "
    "from its first to its last place (timing); and its distance from that chord, counted positive to the side on "
    "which the true path bends (bend). Of each part of the face the curve point that moves furthest is shown. "
    "A method that moves points on straight lines can correct timing and never bend."
)

_PARTS: tuple[tuple[str, frozenset[str]], ...] = (
    ("chin", frozenset({"chin", "menton"})),
    ("lip", frozenset({"lip", "lips", "mouth"})),
    ("lid", frozenset({"lid", "lids", "eyelid", "eye"})),
    ("jaw", frozenset({"jaw"})),
    ("brow", frozenset({"brow", "brows", "eyebrow"})),
    ("cheek", frozenset({"cheek", "cheeks"})),
    ("nose", frozenset({"nose", "nostril"})),
)
_WORTH_DRAWING = 0.005
"""A point that moves less than this fraction of D shows only noise."""
_APART = 0.15
"""A further point nearer than this fraction of D to a chosen one would show the same path again."""
_LOCAL = 0.4
"""A curve wider than this fraction of D runs through many parts of the face: its name tells no place."""


@dataclass(frozen=True)
class TrackedPoint:
    """One curve point whose path is drawn.

    Attributes
    ----------
    label
        Part of the face.
    curve
        Name of its curve.
    row
        Row in ``CurvePositions.truth``.
    vertex
        Vertex of the mesh.
    motion
        Distance between its first and last place as a fraction of D.
    """

    label: str
    curve: str
    row: int
    vertex: int
    motion: float


def choose_points(curves: CurvePositions, diameter: float, count: int = 3) -> list[TrackedPoint]:
    """Choose the points to draw: of each part of the face the curve point that moves furthest.

    Parts are known by the words in the names of short curves (chin or jaw, lip or mouth, lid or eye, …). Parts that
    do not move are passed over; with fewer moving parts than ``count``, the furthest-moving points well away from
    the chosen ones follow under the name of their curve.

    Parameters
    ----------
    curves
        True positions; first and last pose must be present.
    diameter
        D in head units.
    count
        Largest number of points.

    Returns
    -------
    list
        Points in the order chin, lip, lid, …; empty when the first or the last pose is missing.
    """
    motion = np.linalg.norm(curves.truth[-1] - curves.truth[0], axis=1) / diameter
    if not np.any(np.isfinite(motion)):
        return []
    motion = np.where(np.isfinite(motion), motion, -1.0)
    curve_of_row = np.repeat(np.arange(len(curves.names)), np.diff(curves.offsets))
    chosen: list[TrackedPoint] = []
    used = np.zeros(len(motion), dtype=bool)

    def take(label: str, allowed: NDArray[np.bool_], least: float) -> None:
        open_rows = allowed & ~used
        if len(chosen) == count or not np.any(open_rows):
            return
        row = int(np.argmax(np.where(open_rows, motion, -2.0)))
        if motion[row] < least:
            return
        curve = curves.names[curve_of_row[row]]
        chosen.append(TrackedPoint(label or curve, curve, row, int(curves.vertices[row]), float(motion[row])))
        used[np.linalg.norm(curves.truth[0] - curves.truth[0, row], axis=1) < 0.06 * diameter] = True

    extents = np.array([np.max(np.ptp(curves.truth[0, rows], axis=0)) for rows in curves.slices()])
    local = extents < _LOCAL * diameter
    claimed = np.zeros(len(motion), dtype=bool)
    for label, words in _PARTS:
        named = local & np.array([bool(words & _words(name)) for name in curves.names], dtype=bool)
        allowed = named[curve_of_row] & ~claimed
        claimed |= allowed
        take(label, allowed, _WORTH_DRAWING)
    for _ in range(count):
        far = np.ones(len(motion), dtype=bool)
        for point in chosen:
            far &= np.linalg.norm(curves.truth[0] - curves.truth[0, point.row], axis=1) > _APART * diameter
        take("", far, _WORTH_DRAWING if chosen else 0.0)
    return chosen


def _words(name: str) -> set[str]:
    return set(re.findall(r"[a-z]+", name.lower()))


def trajectories(
    curves: CurvePositions,
    points: Sequence[TrackedPoint],
    diameter: float,
    up: Floats,
    front: Floats,
) -> Figure:
    """Draw the paths of the chosen points with all methods.

    Parameters
    ----------
    curves
        True and predicted positions.
    points
        Points from ``choose_points``, at least one.
    diameter
        D in head units.
    up, front : (3,) arrays
        Unit vectors of the head: upwards, and the way the face looks.
    """
    figure = figure_style.new_figure(figure_style.DOUBLE_COLUMN, 128.0 * figure_style.MILLIMETRE)
    grid = figure.add_gridspec(3, len(points) + 1, width_ratios=[1.35] + [1.0] * len(points), height_ratios=[1.6, 1, 1])
    overview = figure.add_subplot(grid[:, 0])
    _draw_profile(overview, curves, points, up, front)
    first_column: list[Axes] = []
    for column, point in enumerate(points):
        axes = [figure.add_subplot(grid[row, column + 1]) for row in range(3)]
        letter = "ABCDEFGH"[column]
        axes[0].set_title(f"{letter}  {point.label}", fontsize=7.5, pad=11)
        _draw_path(axes[0], curves, point, diameter, up, front)
        _draw_timing_and_bend(axes[1], axes[2], curves, point, diameter)
        if column == 0:
            first_column = axes
    first_column[0].set_ylabel("up  (% of D)")
    first_column[1].set_ylabel("along the chord  (% of D)")
    first_column[2].set_ylabel("off the chord  (% of D)")
    figure.align_ylabels(first_column)
    handles, labels = first_column[1].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=5)
    return figure


def chord_coordinates(path: Floats, truth: Floats) -> tuple[Floats, Floats]:
    """Split a path into progress along the true chord and signed distance from it.

    Parameters
    ----------
    path : (P, 3) array
        Positions to split.
    truth : (P, 3) array
        True path; its first and last row span the chord, the side of its largest departure counts as positive.

    Returns
    -------
    along, off : (P,) arrays
        In the units of the input; NaN where ``path`` is NaN.
    """
    chord = truth[-1] - truth[0]
    direction = chord / max(float(np.linalg.norm(chord)), 1e-300)
    true_off = (truth - truth[0]) - np.outer((truth - truth[0]) @ direction, direction)
    sizes = np.nan_to_num(np.linalg.norm(true_off, axis=1))
    side = true_off[int(np.argmax(sizes))] / max(float(sizes.max()), 1e-300)
    relative = path - truth[0]
    return relative @ direction, relative @ side


def _draw_profile(
    axes: Axes, curves: CurvePositions, points: Sequence[TrackedPoint], up: Floats, front: Floats
) -> None:
    start = curves.truth[0]
    for closed, rows in zip(curves.closed, curves.slices(), strict=True):
        line = start[rows]
        line = np.concatenate([line, line[:1]]) if closed else line
        axes.plot(line @ front, line @ up, color="#A3AAB5", linewidth=0.45)
    for column, point in enumerate(points):
        path = curves.truth[:, point.row]
        axes.plot(path @ front, path @ up, color=figure_style.TRUTH_COLOUR, linewidth=1.4)
        axes.plot(path[0] @ front, path[0] @ up, "o", color=figure_style.TRUTH_COLOUR, markersize=3)
        step = np.array([(path[-1] - path[0]) @ front, (path[-1] - path[0]) @ up])
        away = -9.0 * step / max(float(np.linalg.norm(step)), 1e-300)
        axes.annotate(
            "ABCDEFGH"[column],
            (float(path[0] @ front), float(path[0] @ up)),
            xytext=(float(away[0]), float(away[1])),
            textcoords="offset points",
            fontsize=8,
            fontweight="bold",
            ha="center",
            va="center",
        )
    axes.set_aspect("equal")
    axes.margins(0.08)
    axes.axis("off")
    axes.set_title("side view, t = 0", fontsize=7.0, fontweight="normal")


def _draw_path(
    axes: Axes, curves: CurvePositions, point: TrackedPoint, diameter: float, up: Floats, front: Floats
) -> None:
    origin = curves.truth[0, point.row]
    styles = figure_style.method_styles(list(curves.predictions))
    for method, positions in curves.predictions.items():
        path = 100.0 * (positions[:, point.row] - origin) / diameter
        axes.plot(path @ front, path @ up, **figure_style.marker_options(styles[method], 2.8))
    path = 100.0 * (curves.truth[:, point.row] - origin) / diameter
    axes.plot(path @ front, path @ up, "-", color=figure_style.TRUTH_COLOUR, marker=".", markersize=4, zorder=5)
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.08)
    axes.set_xlabel("forward  (% of D)")
    axes.grid(True, axis="both")
    place = f"vertex {point.vertex}" if point.label == point.curve else f"{point.curve}, vertex {point.vertex}"
    axes.text(0.0, 1.02, place, transform=axes.transAxes, fontsize=5.5, color=figure_style.QUIET_COLOUR, va="bottom")


def _draw_timing_and_bend(
    timing: Axes, bend: Axes, curves: CurvePositions, point: TrackedPoint, diameter: float
) -> None:
    truth = curves.truth[:, point.row]
    along, off = chord_coordinates(truth, truth)
    for axes, values in ((timing, along), (bend, off)):
        axes.plot(
            curves.t,
            100.0 * values / diameter,
            "-",
            color=figure_style.TRUTH_COLOUR,
            marker=".",
            markersize=4,
            linewidth=1.6,
            label="ground truth",
            zorder=2,
        )
        missing = [float(t) for t, value in zip(curves.t, values, strict=True) if not np.isfinite(value)]
        figure_style.mark_failed(axes, missing, 0.03)
        axes.set_xlim(-0.03, 1.03)
        axes.set_xticks([0.0, 0.25, 0.5, 0.75, 1.0], ["0", "", "0.5", "", "1"])
    styles = figure_style.method_styles(list(curves.predictions))
    for method, positions in curves.predictions.items():
        style = styles[method]
        predicted = chord_coordinates(positions[:, point.row], truth)
        for axes, values in zip((timing, bend), predicted, strict=True):
            axes.plot(curves.t, 100.0 * values / diameter, label=style.label, **figure_style.line_options(style, 2.6))
    bend.set_xlabel("t")
