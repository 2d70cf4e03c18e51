"""Plots of the dense stereo benchmark, from saved results only."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from dense_stereo_cases import CENTRE, SOURCES, WEAK, Case
from dense_stereo_tables import CENTRE_NAME, Results, default_sources, exponent, growth_series, seconds_of, series

from capture_eval.files.atomic import atomic_path
from capture_eval.report.figure_style import (
    DOUBLE_COLUMN,
    MILLIMETRE,
    QUIET_COLOUR,
    line_options,
    method_styles,
    new_figure,
    paper_style,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

HEIGHT = 62.0 * MILLIMETRE
OURS, SGBM, OTHER, FOURTH = method_styles(["pde_linear", "pde_quadratic", "pde_cubic", "linear"]).values()
AIM = (3.3, 0.097, 0.996)  # CPU s per photo, truth to mesh p95 (% of D), completeness within .3 % of D
TICKS = [n * 10.0**power for power in range(-4, 4) for n in (1, 2, 5)]
SGBM_NAME = f"sgbm_{CENTRE.name}"

Drawn = tuple["Figure", str] | None


def _face(record: Results, key: str, place: int) -> float:
    return float(record["regions"]["face"][key][place])


def _cost(record: Results) -> float:
    return float(record["dense_cpu_s"] / record["photos"])


def _panels(count: int, height: float = HEIGHT) -> tuple[Figure, list[Axes]]:
    figure = new_figure(DOUBLE_COLUMN, height)
    return figure, [figure.add_subplot(1, count, number + 1) for number in range(count)]


def plain_ticks(axis: Any, values: list[float]) -> None:
    """Write these values on a logarithmic axis, as plain numbers, and no others."""
    axis.set_ticks(values, labels=[f"{value:g}" for value in values])
    axis.set_ticks([], minor=True)


def accuracy_against_time(saved: Results) -> Drawn:
    """Effort settings as lines, peers as points, the aim as a cross."""
    lines = {
        "number of sources": series(saved, [(n, f"sources_{n}") for n in SOURCES] + [(default_sources(), CENTRE_NAME)]),
        "number of passes": series(saved, [(1, "passes_fewer"), (2, CENTRE_NAME), (4, "passes_more")]),
        "photos halved": series(saved, [(0.5, "half_scale"), (1, CENTRE_NAME)]),
    }
    if not any(len(pairs) > 1 for pairs in lines.values()):
        return None
    figure, panels = _panels(2, 72.0 * MILLIMETRE)
    for axes, key, place, aim in zip(panels, ("truth_to_mesh", "complete"), (2, 1), AIM[1:], strict=True):
        for (label, pairs), style in zip(lines.items(), (OURS, OTHER, FOURTH), strict=True):
            if len(pairs) < 2:
                continue
            times = [_cost(record) for _, record in pairs]
            values = [_face(record, key, place) for _, record in pairs]
            axes.plot(times, values, label=f"ours, {label}", **line_options(style))
            if label == "number of sources":
                for (count, _), time, value in zip(pairs, times, values, strict=True):
                    axes.annotate(f"{count:g}", (time, value), xytext=(3, 4), textcoords="offset points", fontsize=6)
        peer = saved.get(SGBM_NAME, {})
        if peer.get("status") == "ok":
            options = line_options(SGBM) | {"linestyle": "none", "markersize": 6}
            axes.plot([_cost(peer)], [_face(peer, key, place)], label="OpenCV SGBM, our fusion", **options)
        axes.plot([AIM[0]], [aim], "x", color="black", markersize=6, label="aim (a quarter of OpenMVS's time)")
        axes.set_xscale("log")
        low, high = axes.get_xlim()
        plain_ticks(axes.xaxis, [value for value in (0.3, 0.5, 0.7, 1, 1.5, 2, 3, 4, 6, 8) if low <= value <= high])
        axes.set_xlabel("dense stereo, CPU seconds per photo of 640 × 480")
    panels[0].set_ylim(bottom=0)
    panels[0].set_ylabel("95 % of truth→mesh  (% of D)")
    panels[0].set_title("accuracy")
    panels[1].set_ylabel("share of face within 0.3 % of D")
    panels[1].set_title("completeness")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3)
    return figure, "Accuracy and completeness of the face against time; numbers at the line are sources per photo."


def _binned(saved: Results, kind: str, names: dict[str, tuple[str, str, Any]], label: str) -> Drawn:
    """Median depth error and share of pixels that are right, by tilt or contrast."""
    shown = {
        title: (saved[name]["maps"][kind], stage, style)
        for title, (name, stage, style) in names.items()
        if saved.get(name, {}).get("maps")
    }
    if not shown:
        return None
    figure, panels = _panels(2)
    for title, (bins, stage, style) in shown.items():
        middle = np.array([np.nan if value is None else value for value in bins["middle"]])
        error = np.array([np.nan if value is None else value for value in bins[stage]["median"]])
        panels[0].plot(middle, error, label=title, **line_options(style))
        share = np.where(np.isfinite(middle), bins[stage]["share_close"], np.nan)
        panels[1].plot(middle, share, label=title, **line_options(style))
    panels[0].set_yscale("log")
    low, high = panels[0].get_ylim()
    plain_ticks(panels[0].yaxis, [value for value in TICKS if low <= value <= high])
    if kind == "contrast":
        panels[0].set_ylim(low / 1.3, high * 1.7)  # room for the legend
        low, high = panels[0].get_ylim()
        fine = [n * 10.0**power for power in range(-3, 1) for n in (1, 1.5, 2, 3, 4, 5, 7)]
        plain_ticks(panels[0].yaxis, [value for value in fine if low <= value <= high])
        for axes in panels:
            axes.set_xscale("log")
            plain_ticks(axes.xaxis, [1, 1.5, 2, 3, 4, 6, 8, 10])
            axes.set_xlim(1.3, 11)
    panels[0].set_ylabel("median error of depth  (% of D)")
    panels[1].set_ylabel("share of skin pixels right to 0.3 % of D")
    panels[1].set_ylim(0, 1.03)
    for axes in panels:
        axes.set_xlabel(label)
    panels[0].legend(loc="upper left" if kind == "tilt" else "upper right")
    return figure, ""


def error_by_tilt(saved: Results) -> Drawn:
    """Slanted surfaces."""
    drawn = _binned(
        saved,
        "tilt",
        {
            "ours, one photo": (CENTRE_NAME, "photometric", OTHER),
            "ours, confirmed by others": (CENTRE_NAME, "geometric", OURS),
            "SGBM, four pairs": (SGBM_NAME, "photometric", SGBM),
            "SGBM, confirmed by others": (SGBM_NAME, "geometric", FOURTH),
        },
        "angle between surface normal and line of sight  (degrees)",
    )
    caption = "Depth maps by tilt of the surface (640 × 480, true poses, normal skin, all skin pixels of six photos)."
    return None if drawn is None else (drawn[0], caption)


def error_by_contrast(saved: Results) -> Drawn:
    """Skin with more and less detail."""
    drawn = _binned(
        saved,
        "contrast",
        {
            "ours, normal skin": (CENTRE_NAME, "geometric", OURS),
            "ours, weak skin": (f"{WEAK.name}_true", "geometric", OTHER),
            "SGBM, normal skin": (SGBM_NAME, "geometric", SGBM),
            "SGBM, weak skin": (f"sgbm_{WEAK.name}", "geometric", FOURTH),
        },
        "standard deviation of fine detail with noise  (grey levels)",
    )
    caption = (
        "Confirmed depth maps by contrast of the skin (detail finer than a blur of 2 px, its deviation over 3 px), "
        "skin tilted by less than 45 degrees. The strongest detail stands at lids, brows and outlines."
    )
    return None if drawn is None else (drawn[0], caption)


def _against(pairs: list[tuple[float, Results]], label: str, title: str, logarithmic: bool) -> Drawn:
    if len(pairs) < 2:
        return None
    figure, panels = _panels(2)
    values = [value for value, _ in pairs]
    for place, share, style in ((0, 50, OURS), (2, 95, OTHER)):
        truth = [_face(record, "truth_to_mesh", place) for _, record in pairs]
        cloud = [_face(record, "accuracy", place) for _, record in pairs]
        panels[0].plot(values, truth, label=f"truth→mesh, {share} %", **line_options(style))
        options = line_options(style) | {"linestyle": ":", "markerfacecolor": "none", "markeredgewidth": 0.9}
        panels[0].plot(values, cloud, label=f"points→truth, {share} %", **options)
    for place, limit, style in ((1, 0.3, OURS), (0, 0.1, OTHER)):
        complete = [_face(record, "complete", place) for _, record in pairs]
        panels[1].plot(values, complete, label=f"within {limit} % of D", **line_options(style))
    for axes in panels:
        axes.set_xlabel(label)
        if logarithmic:
            axes.set_xscale("log")
        plain_ticks(axes.xaxis, [round(value, 3) for value in values])
    panels[0].set_yscale("log")
    low, high = panels[0].get_ylim()
    plain_ticks(panels[0].yaxis, [value for value in TICKS if low <= value <= high])
    panels[0].set_ylabel("error  (% of D)")
    panels[1].set_ylabel("share of the face that has a point")
    panels[1].set_ylim(top=1.02)
    panels[0].legend(loc="upper right")
    panels[1].legend(loc="lower right")
    return figure, title


def error_by_photos(saved: Results) -> Drawn:
    """Fewer photos of the same scene."""
    caption = "Number of photos (640 × 480, true poses): the face that three or more of all 24 photos see."
    return _against(growth_series(saved)["photos"], "photos", caption, False)


def error_by_size(saved: Results) -> Drawn:
    """Smaller and larger photos of the same scene."""
    caption = "Image size (4:3, 24 photos, true poses), each size rendered with the same sensor noise."
    return _against(growth_series(saved)["megapixels"], "megapixels of a photo", caption, True)


def growth(saved: Results) -> Drawn:
    """CPU seconds against photos, pixels, sources."""
    kinds = {kind: pairs for kind, pairs in growth_series(saved).items() if len(pairs) > 1}
    if not kinds:
        return None
    figure, panels = _panels(len(kinds), 56.0 * MILLIMETRE)
    for axes, (kind, pairs) in zip(panels, kinds.items(), strict=True):
        values, seconds = [value for value, _ in pairs], [seconds_of(kind, record) for _, record in pairs]
        axes.plot(values, seconds, **line_options(OURS))
        line = [seconds[-1] * value / values[-1] for value in values]
        axes.plot(values, line, color=QUIET_COLOUR, linestyle=":", label="proportional")
        axes.set_xscale("log")
        axes.set_yscale("log")
        plain_ticks(axes.xaxis, [round(value, 3) for value in values])
        low, high = 0.7 * min(seconds + line), 1.5 * max(seconds + line)
        axes.set_ylim(low, high)
        plain_ticks(axes.yaxis, [value for value in TICKS if low <= value <= high])
        axes.set_xlabel(
            {"photos": "photos", "megapixels": "megapixels of a photo", "sources": "sources per photo"}[kind]
        )
        axes.set_ylabel("CPU seconds of the pose" if kind == "photos" else "CPU seconds per photo")
        axes.set_title(f"exponent {exponent(values, seconds):.2f}")
        axes.legend(loc="upper left")
    return figure, "Growth of the dense stage's time with photos, pixels and sources."


def calibration(saved: Results) -> Drawn:
    """Stated against real deviation of points."""
    names = {
        "normal skin, 640 × 480": (CENTRE_NAME, OURS),
        "weak skin, 640 × 480": (f"{WEAK.name}_true", OTHER),
        "normal skin, 1280 × 960": (CENTRE_NAME.replace("640x480", "1280x960"), FOURTH),
    }
    shown = {
        label: pair for label, pair in names.items() if saved.get(pair[0], {}).get("calibration", {}).get("points")
    }
    if not shown:
        return None
    figure = new_figure(0.5 * DOUBLE_COLUMN, HEIGHT * 1.15)
    axes = figure.add_subplot()
    everything = []
    for label, (name, style) in shown.items():
        pairs = np.array(saved[name]["calibration"]["points"]["stated_and_real"])
        everything.append(pairs)
        axes.plot(pairs[:, 0], pairs[:, 1], label=label, **line_options(style))
    joined = np.concatenate(everything)
    ends = [joined.min() * 0.8, joined.max() * 1.25]
    axes.plot(ends, ends, color=QUIET_COLOUR, linestyle=":", label="as stated")
    axes.set_xscale("log")
    axes.set_yscale("log")
    for axis in (axes.xaxis, axes.yaxis):
        plain_ticks(axis, [value for value in TICKS if ends[0] <= value <= ends[1]])
    axes.set_xlabel("stated deviation of a point  (% of D)")
    axes.set_ylabel("real deviation  (% of D)")
    axes.legend(loc="upper left")
    caption = (
        "Stated against real deviation of fused points (1.4826 × median distance to the truth in bins of equal size)."
    )
    return figure, caption


PLOTS: dict[str, Callable[[Results], Drawn]] = {
    "dense_stereo_time.png": accuracy_against_time,
    "dense_stereo_tilt.png": error_by_tilt,
    "dense_stereo_contrast.png": error_by_contrast,
    "dense_stereo_photos.png": error_by_photos,
    "dense_stereo_size.png": error_by_size,
    "dense_stereo_growth.png": growth,
    "dense_stereo_calibration.png": calibration,
}


def _save(figure: Figure, path: Path) -> None:
    """PNG with a palette, a third of the size."""
    from io import BytesIO

    from PIL import Image

    buffer = BytesIO()
    figure.savefig(buffer, format="png")
    with Image.open(buffer) as picture:
        plain = picture.convert("RGB").quantize(96, dither=Image.Dither.NONE)
        plain.save(path, format="PNG", optimize=True)


def write_plots(cases: list[Case], saved: Results, folder: Path) -> dict[str, str]:
    """Write the plots whose figures are there; file name -> caption."""
    present = {case.name: saved[case.name] for case in cases}
    written = {}
    with paper_style():
        for name, draw in PLOTS.items():
            drawn = draw(present)
            if drawn is None:
                continue
            with atomic_path(folder / name) as temporary:
                _save(drawn[0], temporary)
            written[name] = drawn[1]
    return written
