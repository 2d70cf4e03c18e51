"""Errors per curve (the kind of paper 003, Figure 8), against t, and as maps of curve by t."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..evaluation.error_table import ErrorTable
from . import figure_style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PER_CURVE_CAPTION = (
    "Top: E_M(n), the maximum over t of E_M(n, t). Bottom: E_A(n), the mean over t of E_A(n, t). "
    "E_A(n, t) is the mean and E_M(n, t) the maximum over the points of curve n of the distance between predicted and "
    "ground-truth position, divided by D, the distance of the two farthest vertices of the neutral model "
    "(paper 003, Eq 35)."
)
OVER_TIME_CAPTION = (
    "LME(t) is the largest E_M(n, t) and LAE(t) the largest E_A(n, t) of all curves n; right, the "
    "mean of E_A(n, t) over the curves. LME and LAE of the tables are the largest values of the two left panels."
)
ERROR_MAP_CAPTION = (
    "E_A(n, t) of every curve and in-between pose, one map per method, one colour scale. Hatched: no value "
    "(the pose or the curve failed)."
)


def errors_per_curve(errors: ErrorTable) -> Figure:
    """Draw E_M (maximum over t) and E_A (mean over t) of every curve for all methods.

    Curves are separate things, not a sequence, so they are drawn as markers and not joined by lines; the markers of
    one curve stand a little apart so that equal values stay visible.
    """
    count = len(errors.curves)
    width = max(figure_style.DOUBLE_COLUMN, (18.0 + 3.3 * count) * figure_style.MILLIMETRE)
    longest = max((len(name) for name in errors.curves), default=1)
    figure = figure_style.new_figure(width, (92.0 + 1.15 * longest) * figure_style.MILLIMETRE)
    upper, lower = figure.subplots(2, 1, sharex=True)
    panels: tuple[tuple[Axes, NDArray[np.float64], str, str], ...] = (
        (upper, _over_time(errors.maximum, np.fmax), "E$_M$", "Largest error of each curve: maximum over t of E$_M$"),
        (lower, _mean_over_time(errors.average), "E$_A$", "Average error of each curve: mean over t of E$_A$"),
    )
    styles = figure_style.method_styles(errors.methods)
    shifts = _dodge(len(errors.methods))
    for axes, values, symbol, title in panels:
        for place in range(0, count, 2):
            axes.axvspan(place - 0.5, place + 0.5, color=figure_style.BAND_COLOUR, linewidth=0, zorder=0)
        for row, method in enumerate(errors.methods):
            style = styles[method]
            axes.plot(
                np.arange(count) + shifts[row],
                100.0 * values[row],
                label=style.label,
                **figure_style.marker_options(style, 3.0),
            )
        missing = [place for place in range(count) if not np.any(np.isfinite(values[:, place]))]
        figure_style.mark_failed(axes, missing, 0.5, "no value")
        axes.set_ylabel(figure_style.percent_label(symbol))
        axes.set_ylim(bottom=0.0)
        axes.set_title(title)
        axes.set_xlim(-0.6, count - 0.4)
    lower.set_xticks(
        np.arange(count), [f"{name}  {index + 1}" for index, name in enumerate(errors.curves)], rotation=90
    )
    lower.tick_params(axis="x", length=0, labelsize=5.5, pad=1.5)
    upper.tick_params(axis="x", length=0)
    figure.align_ylabels([upper, lower])
    figure.legend(*upper.get_legend_handles_labels(), loc="outside upper center", ncols=min(4, len(errors.methods)))
    return figure


def errors_over_time(errors: ErrorTable, noise_floor: float | None = None) -> Figure:
    """Draw LME(t), LAE(t) and the mean E_A(t) of all methods, each panel from zero.

    Parameters
    ----------
    errors
        Errors per method, curve and t.
    noise_floor
        Error of what does not move, as a fraction of D; drawn as a band in the panel of means when known.
    """
    figure = figure_style.new_figure(figure_style.DOUBLE_COLUMN, 66.0 * figure_style.MILLIMETRE)
    all_axes = figure.subplots(1, 3)
    styles = figure_style.method_styles(errors.methods)
    panels = (
        (_over_curves(errors.maximum), "LME(t): largest E$_M$ of all curves"),
        (_over_curves(errors.average), "LAE(t): largest E$_A$ of all curves"),
        (_mean_over_curves(errors.average), "Mean E$_A$ over the curves"),
    )
    for axes, (values, title) in zip(all_axes, panels, strict=True):
        for row, method in enumerate(errors.methods):
            padded_t, padded = _with_end_poses(errors.t, values[row])
            style = styles[method]
            axes.plot(
                padded_t,
                100.0 * padded,
                label=style.label,
                **figure_style.line_options(style, 3.2),
                markevery=slice(1, -1),
            )
        missing = [float(t) for place, t in enumerate(errors.t) if not np.any(np.isfinite(values[:, place]))]
        figure_style.mark_failed(axes, missing, 0.03)
        axes.set_title(title, fontsize=7.0)
        axes.set_xlabel("t")
        axes.set_xlim(-0.02, 1.02)
        axes.set_xticks([0.0, 0.2, 0.4, 0.6, 0.8, 1.0])
        axes.set_ylim(bottom=0.0)
    if noise_floor is not None and np.isfinite(noise_floor):
        all_axes[2].axhspan(0.0, 100.0 * noise_floor, color="#9CA3AF", alpha=0.35, linewidth=0, label="noise floor")
    all_axes[0].set_ylabel("error  (% of D)")
    handles, labels = all_axes[2].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=min(5, len(labels)))
    return figure


def error_maps(errors: ErrorTable) -> Figure:
    """Draw E_A of every curve and t as one map per method, with one colour scale for all."""
    from matplotlib.patches import Rectangle

    methods, curves, times = errors.average.shape
    height = (24.0 + max(2.35 * curves, 20.0)) * figure_style.MILLIMETRE
    figure = figure_style.new_figure(figure_style.DOUBLE_COLUMN, height)
    all_axes = figure.subplots(1, methods, sharey=True, squeeze=False)[0]
    finite = errors.average[np.isfinite(errors.average)]
    top = 100.0 * float(finite.max()) if finite.size else 1.0
    styles = figure_style.method_styles(errors.methods)
    mesh = None
    for row, axes in enumerate(all_axes):
        axes.add_patch(
            Rectangle((-0.5, -0.5), times, curves, facecolor="white", edgecolor="#9CA3AF", hatch="////", linewidth=0)
        )
        values = np.ma.masked_invalid(100.0 * errors.average[row])
        mesh = axes.pcolormesh(
            np.arange(times + 1) - 0.5,
            np.arange(curves + 1) - 0.5,
            values,
            cmap=figure_style.error_colourmap(),
            vmin=0.0,
            vmax=max(top, 1e-12),
            linewidth=0.15,
            edgecolors="white",
        )
        axes.set_title(styles[errors.methods[row]].label, fontsize=6.5)
        axes.set_xticks(np.arange(times), [f"{t:.3g}" for t in errors.t], rotation=90)
        axes.set_xlabel("t")
        axes.grid(False)
        axes.tick_params(length=0)
        axes.set_ylim(curves - 0.5, -0.5)
    all_axes[0].set_yticks(
        np.arange(curves), [f"{name}  {index + 1}" for index, name in enumerate(errors.curves)], fontsize=5.0
    )
    if mesh is not None:
        figure.colorbar(mesh, ax=list(all_axes), location="right", shrink=0.5, label="E$_A$  (% of D)", pad=0.01)
    return figure


def _dodge(count: int) -> NDArray[np.float64]:
    return np.linspace(-0.24, 0.24, count) if count > 1 else np.zeros(1)


def _over_time(values: NDArray[np.float64], join: np.ufunc) -> NDArray[np.float64]:
    result: NDArray[np.float64] = join.reduce(values, axis=2)
    return result


def _over_curves(values: NDArray[np.float64]) -> NDArray[np.float64]:
    result: NDArray[np.float64] = np.fmax.reduce(values, axis=1)
    return result


def _mean_over_time(values: NDArray[np.float64]) -> NDArray[np.float64]:
    return _finite_mean(values, 2)


def _mean_over_curves(values: NDArray[np.float64]) -> NDArray[np.float64]:
    return _finite_mean(values, 1)


def _finite_mean(values: NDArray[np.float64], axis: int) -> NDArray[np.float64]:
    known = np.isfinite(values)
    count = known.sum(axis=axis)
    total = np.where(known, values, 0.0).sum(axis=axis)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _with_end_poses(
    times: NDArray[np.float64], values: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Add the first and last pose: every method starts and ends on the ground truth, so its error there is zero."""
    return np.concatenate([[0.0], times, [1.0]]), np.concatenate([[0.0], values, [0.0]])
