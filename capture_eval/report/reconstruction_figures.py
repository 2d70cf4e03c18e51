"""How well every pose was photographed, reconstructed, aligned and tracked, and how that compares with known truth."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..evaluation.error_table import ErrorTable
from . import figure_style
from .saved_results import PoseQuality, TruthComparison

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

QUALITY_CAPTION = (
    "By pose: photos that structure from motion placed, of those taken; mean reprojection error; "
    "points found; dense points near each vertex of the cleaned scan; residual of the alignment on what does not move; "
    "confidence of the tracked vertices. A pose without values failed or was not needed."
)
CONTACT_CAPTION = "One front view of every pose, as photographed."
TRUTH_CAPTION = (
    "Left and middle: every "
    "marker is one curve at one t; on the diagonal photos and true meshes give the same error "
    "(errors under 0.005 % of D are drawn at 0.005). Right: distance of the "
    "tracked vertices from the true place of their skin point; the line is the median over the vertices."
)

_SMALLEST_DRAWN = 0.005
"""Errors below this (per cent of D) are drawn at it, so that curves that do not move stay on the logarithmic plot."""
_SERIES_COLOURS = ("#0072B2", "#D55E00", "#009E73")


def reconstruction_quality(poses: Sequence[PoseQuality]) -> Figure:
    """Draw what the stages measured per pose as six small panels against t.

    Panels without any value say so; failed poses are shaded in every panel.
    """
    figure = figure_style.new_figure(figure_style.DOUBLE_COLUMN, 92.0 * figure_style.MILLIMETRE)
    axes = figure.subplots(2, 3, sharex=True).ravel()
    times = np.array([pose.t for pose in poses])
    spacing = float(np.min(np.diff(times))) if len(times) > 1 else 1.0
    _registered_photos(axes[0], poses, times, 0.36 * spacing)
    _lines(axes[1], poses, times, (("reprojection_error_px", "mean", 1.0),), "Reprojection error", "pixels")
    _lines(
        axes[2],
        poses,
        times,
        (("points", "sparse", 1e-3), ("fused_points", "dense", 1e-3), ("scan_vertices", "scan", 1e-3)),
        "Points",
        "thousands",
        logarithmic=True,
    )
    _lines(
        axes[3],
        poses,
        times,
        (("support_median", "median", 1.0), ("support_p5", "5th percentile", 1.0)),
        "Support of the scan",
        "dense points near a vertex",
    )
    _lines(
        axes[4],
        poses,
        times,
        (("align_residual_px", "median", 1.0),),
        "Alignment residual",
        "pixels",
    )
    _lines(
        axes[5],
        poses,
        times,
        (("confidence_median", "median", 1.0), ("confidence_p10", "10th perc.", 1.0), ("seen", "share seen", 1.0)),
        "Tracking confidence",
        "0 to 1",
    )
    axes[5].set_ylim(0.0, 1.28)
    axes[5].set_yticks([0.0, 0.25, 0.5, 0.75, 1.0])
    failed = [pose.t for pose in poses if not pose.ok]
    for panel in axes:
        figure_style.mark_failed(panel, failed, 0.4 * spacing)
        panel.set_xlim(times.min() - 0.7 * spacing, times.max() + 0.7 * spacing)
    for panel in axes[3:]:
        panel.set_xlabel("t")
    return figure


def _registered_photos(axes: Axes, poses: Sequence[PoseQuality], times: NDArray[np.float64], half: float) -> None:
    axes.set_title("Photos placed")
    axes.set_ylabel("photos")
    taken = _values(poses, "photos")
    placed = _values(poses, "registered")
    if not np.any(np.isfinite(taken)):
        _say_empty(axes)
        return
    axes.bar(times, taken, 2 * half, facecolor="white", edgecolor="#9CA3AF", linewidth=0.6, label="taken")
    axes.bar(times, placed, 2 * half, color=_SERIES_COLOURS[0], linewidth=0, label="placed")
    axes.set_ylim(0.0, 1.22 * float(np.nanmax(taken)))
    axes.legend(loc="upper left", ncols=2, fontsize=5.5)


def _lines(
    axes: Axes,
    poses: Sequence[PoseQuality],
    times: NDArray[np.float64],
    series: Sequence[tuple[str, str, float]],
    title: str,
    unit: str,
    logarithmic: bool = False,
) -> None:
    axes.set_title(title)
    axes.set_ylabel(unit)
    drawn = 0
    top = 0.0
    for (name, label, factor), colour, marker in zip(series, _SERIES_COLOURS, "os^", strict=False):
        values = factor * _values(poses, name)
        if not np.any(np.isfinite(values)):
            continue
        axes.plot(times, values, marker=marker, markersize=3.2, color=colour, label=label)
        top = max(top, float(np.nanmax(values)))
        drawn += 1
    if drawn == 0:
        _say_empty(axes)
        return
    if logarithmic:
        axes.set_yscale("log")
        axes.yaxis.set_major_formatter("{x:g}")
        low, high = axes.get_ylim()
        axes.set_ylim(low, high * (high / low) ** 0.25)
    else:
        axes.set_ylim(0.0, 1.28 * top if top > 0.0 else 1.0)
    if drawn > 1:
        axes.legend(loc="upper left", ncols=drawn, fontsize=5.5, columnspacing=1.0, handlelength=1.4)


def _say_empty(axes: Axes) -> None:
    axes.text(
        0.5, 0.5, "not measured", transform=axes.transAxes, ha="center", va="center", color=figure_style.QUIET_COLOUR
    )
    axes.set_yticks([])


def _values(poses: Sequence[PoseQuality], name: str) -> NDArray[np.float64]:
    return np.array([float(pose.figures.get(name, np.nan)) for pose in poses])


def contact_sheet(
    poses: Sequence[PoseQuality], photos: Sequence[NDArray[np.uint8] | None], columns: int | None = None
) -> Figure:
    """Draw one photo per pose with its t; a pose without a photo is a grey tile that says why.

    Parameters
    ----------
    poses
        All poses.
    photos
        One (H, W, 3) uint8 image per pose, or None.
    columns
        Tiles in a row; by default what gives rows of equal length of at most six.
    """
    rows = max(1, -(-len(poses) // 6)) if columns is None else -(-len(poses) // columns)
    columns = -(-len(poses) // rows) if columns is None else columns
    known = [photo for photo in photos if photo is not None]
    ratio = max((photo.shape[0] / photo.shape[1] for photo in known), default=0.75)
    width = figure_style.DOUBLE_COLUMN
    tile = width / columns
    figure = figure_style.new_figure(width, rows * (tile * ratio + 0.16), padding=0.015)
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for panel in axes:
        panel.axis("off")
    for panel, pose, photo in zip(axes, poses, photos, strict=False):
        colour = "black" if pose.ok else figure_style.FAILED_COLOUR
        panel.set_title(
            f"t = {pose.t:.4g}" + ("" if pose.ok else "  failed"), loc="center", fontsize=7, color=colour, pad=2
        )
        if photo is not None:
            panel.imshow(photo, interpolation="antialiased")
            continue
        panel.imshow(np.full((3, 4, 3), 235, dtype=np.uint8), extent=(0.0, 1.0, 0.0, ratio))
        text = "\n".join(textwrap.wrap(pose.reason or "no photo", 22)[:5])
        panel.text(0.5, 0.5 * ratio, text, ha="center", va="center", fontsize=5, color=colour)
    return figure


def truth_comparison(errors: ErrorTable, truth: TruthComparison, poses: Sequence[PoseQuality]) -> Figure:
    """Draw errors from photos against errors from true meshes, and the tracking error per pose."""
    figure = figure_style.new_figure(figure_style.DOUBLE_COLUMN, 66.0 * figure_style.MILLIMETRE)
    left, middle, right = figure.subplots(1, 3)
    for axes, name, symbol in ((left, "average", "E$_A$"), (middle, "maximum", "E$_M$")):
        _truth_scatter(axes, errors, truth.errors_from_truth, name, symbol)
    times = np.array([pose.t for pose in poses])
    names = {"median": "median", "p90": "90th percentile", "p95": "95th percentile"}
    drawn = 0
    for (name, values), colour, marker in zip(
        truth.tracking.items(), (*_SERIES_COLOURS, "#555555"), "os^D", strict=False
    ):
        if len(values) == len(times) and np.any(np.isfinite(values)):
            right.plot(times, 100.0 * values, marker=marker, markersize=3.2, color=colour, label=names.get(name, name))
            drawn += 1
    right.set_title("Tracking error")
    right.set_xlabel("t")
    right.set_ylabel("distance  (% of D)")
    if drawn:
        right.set_ylim(0.0, 1.2 * right.get_ylim()[1])
        right.legend(loc="upper left", fontsize=5.5, ncols=2)
    else:
        _say_empty(right)
    figure_style.mark_failed(right, [pose.t for pose in poses if not pose.ok], 0.03)
    handles, labels = left.get_legend_handles_labels()
    if handles:
        figure.legend(handles, labels, loc="outside lower center", ncols=5)
    return figure


def _truth_scatter(axes: Axes, errors: ErrorTable, true: ErrorTable | None, name: str, symbol: str) -> None:
    axes.set_title(f"{symbol}: photos against truth")
    axes.set_xlabel(f"{symbol} from true meshes  (% of D)")
    axes.set_ylabel(f"{symbol} from photos  (% of D)")
    axes.grid(True, axis="both")
    if true is None:
        _say_empty(axes)
        return
    styles = figure_style.method_styles(errors.methods)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.xaxis.set_major_formatter("{x:g}")
    axes.yaxis.set_major_formatter("{x:g}")
    low, top = np.inf, 0.0
    for row, method in enumerate(errors.methods):
        photos = getattr(errors, name)[row]
        matched = _matched(errors, true, method, getattr(true, name))
        known = np.isfinite(photos) & np.isfinite(matched)
        if not np.any(known):
            continue
        options = {
            **figure_style.marker_options(styles[method], 2.0),
            "markeredgewidth": 0.4,
            "alpha": 0.8,
            "rasterized": True,
        }
        pair = np.maximum(100.0 * np.stack([matched[known], photos[known]]), _SMALLEST_DRAWN)
        axes.plot(pair[0], pair[1], label=styles[method].label, **options)
        low, top = min(low, float(pair.min())), max(top, float(pair.max()))
    if top == 0.0:
        _say_empty(axes)
        return
    limits = (0.8 * low, 1.25 * top)
    axes.plot(limits, limits, color="black", linewidth=0.7, zorder=2)
    axes.set_xlim(*limits)
    axes.set_ylim(*limits)
    axes.set_aspect("equal")


def _matched(errors: ErrorTable, true: ErrorTable, method: str, values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Bring values of the true table to the curves and times of the measured one; NaN where it has none."""
    result = np.full((len(errors.curves), len(errors.t)), np.nan)
    if method not in true.methods:
        return result
    row = true.methods.index(method)
    curve_of = {curve: index for index, curve in enumerate(true.curves)}
    time_of = {round(float(t), 9): index for index, t in enumerate(true.t)}
    for curve_index, curve in enumerate(errors.curves):
        for time_index, t in enumerate(errors.t):
            place = time_of.get(round(float(t), 9))
            if curve in curve_of and place is not None:
                result[curve_index, time_index] = values[row, curve_of[curve], place]
    return result
