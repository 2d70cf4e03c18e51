"""Plots of the registration benchmark, from its saved results."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from registration_cases import MOTIONS, all_cases
from registration_measure import REGIONS

from capture_eval.report.figure_style import DOUBLE_COLUMN, paper_style

Results = dict[str, dict[str, Any]]

COLOURS = ("#0072B2", "#D55E00", "#009E73")
GOAL = (0.04, 0.20)


def draw_plots(results: Results, folder: Path) -> dict[str, str]:
    """Draw what there are results for; Markdown of every picture by its file name."""
    drawings = {
        "registration_poses.png": (draw_poses, "Tracking error by pose"),
        "registration_regions.png": (draw_regions, "Tracking error by region, last pose"),
        "registration_ablation.png": (draw_ablation, "What the texture steps buy"),
        "registration_growth.png": (draw_growth, "Growth of time and memory with the template"),
    }
    found = {}
    with paper_style():
        for name, (draw, title) in drawings.items():
            figure = draw(results)
            if figure is not None:
                save(figure, folder / name)
                found[name] = f"\n![{title}]({name})\n"
    return found


def save(figure: Any, path: Path) -> None:
    """As PNG, without the date."""
    import matplotlib.pyplot as plt

    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=160, metadata={"Software": None})
    plt.close(figure)


def of_group(results: Results, group: str) -> list[dict[str, Any]]:
    """Results of a group in the order of the cases."""
    return [results[case.name] for case in all_cases() if case.group == group and case.name in results]


def draw_poses(results: Results) -> Any:
    """Median and p95 of the tracking error by the amount of motion: a column per motion, a row per set of vertices."""
    import matplotlib.pyplot as plt

    rows = of_group(results, "sequences")
    if not rows:
        return None
    motions = [motion for motion in MOTIONS if any(row["motion"] == motion for row in rows)]
    figure, axes = plt.subplots(
        2, len(motions), figsize=(DOUBLE_COLUMN, 4.2), sharex=True, sharey=True, squeeze=False, layout="constrained"
    )
    heads = list(dict.fromkeys(row["head"] for row in rows))
    for line, (mask, title) in enumerate((("face", "seen, face"), ("confident", "confident, whole head"))):
        for axis, motion in zip(axes[line], motions, strict=True):
            for row in rows:
                if row["motion"] == motion:
                    draw_sequence(axis, row, mask, COLOURS[heads.index(row["head"])])
            for value in GOAL:
                axis.axhline(value, color="#6B7280", linewidth=0.8, linestyle=":")
            axis.set(yscale="log", xticks=[0, 0.2, 0.5, 0.8, 1])
            axis.set_yticks([0.02, 0.05, 0.1, 0.2, 0.5, 1.0], ["0.02", "0.05", "0.1", "0.2", "0.5", "1"])
            axis.minorticks_off()
            axis.set_title(motion if line == 0 else "")
        axes[line, 0].set_ylabel(f"tracking, % of D\n{title}")
    for axis in axes[1]:
        axis.set_xlabel("amount of motion")
    for colour, head in zip(COLOURS, heads, strict=False):
        axes[0, 0].plot([], [], color=colour, label=head)
    axes[0, 0].plot([], [], color="#222222", marker="o", markersize=3.5, label="median")
    axes[0, 0].plot(
        [], [], color="#222222", marker="^", markersize=3.5, linestyle=(0, (4, 1.5)), label="95th percentile"
    )
    axes[0, 0].plot([], [], color="#6B7280", linewidth=0.8, linestyle=":", label="goals (median, p95)")
    figure.legend(loc="outside lower center", ncols=6)
    return figure


def draw_sequence(axis: Any, row: dict[str, Any], mask: str, colour: str) -> None:
    """Two lines of one sequence."""
    poses = [pose for pose in row["poses"] if pose["status"] == "ok" and mask in pose["regions"]]
    amounts = [pose["amount"] for pose in poses]
    for part, dash, marker in ((0, "-", "o"), (1, (0, (4, 1.5)), "^")):
        values = [100 * pose["regions"][mask]["tracking"][part] for pose in poses]
        axis.plot(amounts, values, color=colour, linestyle=dash, marker=marker, markersize=3.5)


def draw_regions(results: Results) -> Any:
    """p95 of the tracking error by sequence and region in the last pose, seen and confident."""
    import matplotlib.pyplot as plt

    rows = of_group(results, "sequences")
    if not rows:
        return None
    height = max(1.9, 0.9 + 0.2 * len(rows))
    figure, axes = plt.subplots(1, 2, figsize=(DOUBLE_COLUMN, height), sharey=True, layout="constrained")
    for axis, suffix, title in zip(axes, ("", ", confident"), ("seen", "confident"), strict=True):
        values = np.full((len(rows), len(REGIONS)), np.nan)
        for line, row in enumerate(rows):
            last = [pose for pose in row["poses"] if pose["status"] == "ok"][-1]["regions"]
            for column, region in enumerate(REGIONS):
                if region + suffix in last:
                    values[line, column] = 100 * last[region + suffix]["tracking"][1]
        image = axis.imshow(np.log10(values), cmap="magma_r", vmin=np.log10(0.03), vmax=np.log10(2.0), aspect="auto")
        for line, column in np.argwhere(np.isfinite(values)):
            value = values[line, column]
            colour = "white" if value > 0.27 else "black"
            axis.text(column, line, f"{value:.2f}", ha="center", va="center", fontsize=5.5, color=colour)
        axis.set_xticks(range(len(REGIONS)), REGIONS, rotation=45, ha="right")
        axis.set_yticks(range(len(rows)), [f"{row['head']} {row['motion']}" for row in rows])
        axis.set_title(f"{title} vertices")
        axis.grid(False)
        axis.spines[:].set_visible(False)
    bar = figure.colorbar(image, ax=axes, ticks=np.log10([0.05, 0.1, 0.2, 0.5, 1, 2]), pad=0.01)
    bar.ax.set_yticklabels(["0.05", "0.1", "0.2", "0.5", "1", "2"])
    bar.set_label("tracking p95, % of D")
    return figure


def draw_ablation(results: Results) -> Any:
    """Bars of the tangential and normal error in the last pose with and without the texture steps."""
    import matplotlib.pyplot as plt

    order = {"ablation_neither": "neither", "ablation_flow_only": "flow only", "ablation_stereo_only": "stereo only"}
    names = {**order, "makehuman2_jaw_open": "both"}
    if not set(names) <= set(results):
        return None
    figure, axes = plt.subplots(1, 2, figsize=(DOUBLE_COLUMN, 2.4), layout="constrained")
    for axis, part, title in zip(axes, (0, 1), ("median", "95th percentile"), strict=True):
        for offset, (kind, colour) in enumerate(zip(("tracking", "tangential", "normal"), COLOURS, strict=True)):
            values = [100 * results[name]["poses"][-1]["regions"]["confident"][kind][part] for name in names]
            places = np.arange(len(names)) + 0.27 * (offset - 1)
            bars = axis.bar(places, values, 0.25, color=colour, label=kind)
            axis.bar_label(
                bars, [f"{value:.2f}" if value >= 0.1 else f"{value:.3f}" for value in values], fontsize=4.5, padding=1
            )
        axis.set_xticks(range(len(names)), list(names.values()))
        axis.set_title(title)
        axis.margins(y=0.1)
    axes[0].set_ylabel("error at amount 1, % of D")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=3)
    return figure


def draw_growth(results: Results) -> Any:
    """Seconds and memory by template vertices, log-log."""
    import matplotlib.pyplot as plt
    from matplotlib.ticker import LogLocator

    rows = of_group(results, "growth")
    if not rows:
        return None
    figure, axes = plt.subplots(1, 3, figsize=(DOUBLE_COLUMN, 2.3), layout="constrained")
    titles = ("neutral, CPU s", "another pose, CPU s", "peak memory, GB")
    for colour, kind, marker in zip(COLOURS, ("triangles", "quads"), ("^", "s"), strict=False):
        mine = sorted((row for row in rows if kind in row["case"]), key=lambda row: row["vertices"])
        sizes = [row["vertices"] for row in mine]
        values = (
            [row["cpu_seconds"]["neutral"] for row in mine],
            [row["cpu_seconds"]["track"] + row["cpu_seconds"]["refine_pose_01"] for row in mine],
            [row["peak_memory_mb"] / 1000 for row in mine],
        )
        for axis, heights in zip(axes, values, strict=True):
            axis.loglog(sizes, heights, color=colour, marker=marker, markersize=3.5, label=kind)
    for axis, title in zip(axes, titles, strict=True):
        low, high = axis.get_ylim()
        axis.set(title=title, xlabel="template vertices", ylim=(min(low, high / 12), high))
        axis.set_xticks([2000, 5000, 10000, 20000, 50000], ["2k", "5k", "10k", "20k", "50k"])
        axis.minorticks_off()
        axis.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axes[0].legend()
    return figure
