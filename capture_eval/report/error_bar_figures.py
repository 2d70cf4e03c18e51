"""Figure of the error bars: how far every registered vertex may be from the skin point it stands for."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from capture_eval.report import figure_style
from capture_eval.report.face_figures import look_at
from capture_eval.report.mesh_rendering import UNKNOWN_COLOUR, render_mesh
from capture_eval.report.saved_results import FaceSequence

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Floats = NDArray[np.float64]

CAPTION = (
    "Drawn on the neutral face: for every vertex the largest 95 % error bar of all poses. The bar holds what repeating "
    "the registration with each half of the photos shows, stretched to what known truth has shown elsewhere. Grey: not "
    "seen by enough photos."
)
_RANGE = (0.05, 1.0)  # % of D: what a good capture reaches, and what no evaluation can use
_ASPECT = 1.3


def error_bar_map(faces: FaceSequence, diameter: float, up: Floats, front: Floats) -> Figure:
    """Draw the largest 95 % bar of all registered poses, % of D, from three sides.

    Parameters
    ----------
    faces
        With `error_bar` (P, V) in head units.
    diameter
        D in head units.
    up, front : (3,) arrays
        Unit vectors of the head.
    """
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import LogNorm

    width = figure_style.DOUBLE_COLUMN
    figure = figure_style.new_figure(width, 0.9 * (width - 0.45) / 3 * _ASPECT)
    axes = figure.subplots(1, 3, squeeze=False)
    for panel in axes.ravel():
        panel.axis("off")
    scale = ScalarMappable(LogNorm(*_RANGE, clip=True), figure_style.error_colourmap())
    if faces.error_bar is not None and faces.pose_ok[0]:
        bars = faces.error_bar[faces.pose_ok]
        known = np.asarray(np.isfinite(bars).all(axis=0))
        values = 100.0 * np.max(np.where(known, bars, 0.0), axis=0) / diameter
        mapped = np.asarray(scale.to_rgba(np.where(known, values, _RANGE[0])), dtype=np.float64)[:, :3]
        colours = np.where(known[:, None], mapped, np.asarray(UNKNOWN_COLOUR))
        size = (420, round(420 * _ASPECT))
        for panel, turn in zip(axes[0], (-50.0, 0.0, 50.0), strict=True):
            view = look_at(faces.vertices[0], up, front, turn, size)
            picture = render_mesh(
                faces.vertices[0], faces.triangles, colours=colours, view=view, supersampling=2, shading=0.5
            )
            panel.imshow(picture, interpolation="antialiased")
    bar = figure.colorbar(scale, ax=list(axes.ravel()), shrink=0.6, pad=0.01, aspect=24, extend="both")
    bar.set_label("largest 95 % error bar  (% of D)")
    bar.set_ticks([0.05, 0.1, 0.2, 0.5, 1.0], labels=["0.05", "0.1", "0.2", "0.5", "1"])
    bar.ax.minorticks_off()
    return figure
