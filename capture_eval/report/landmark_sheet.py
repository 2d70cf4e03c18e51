"""Contact sheet for placing landmarks: the template's landmarks by name, and numbered photos with a grid of pixels."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from capture_eval.cameras import project
from capture_eval.errors import InputError
from capture_eval.report.face_figures import look_at, visible_points
from capture_eval.report.figure_style import new_figure, paper_style
from capture_eval.report.mesh_rendering import render_mesh

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Floats = NDArray[np.float64]

_UP, _FRONT = np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0])
_VIEWS = (("template, right side", -60.0), ("template, front", 0.0), ("template, left side", 60.0))
_PANEL = (700, 840)
_COLUMNS = 3
_WIDTH, _GAP = 4.2, 0.3  # inches of a photo and between photos
_MARK = "#0B4F9E"


@dataclass(frozen=True)
class SheetPhoto:
    """A photo of the sheet.

    Attributes
    ----------
    number : int
        From 1.
    name : str
        Of the file.
    image : (H, W, 3) uint8
        May be smaller than the photo.
    size : (width, height)
        Of the photo, pixels.
    marks : mapping of landmark to (x, y)
        Pixels of the photo.
    """

    number: int
    name: str
    image: NDArray[np.uint8]
    size: tuple[int, int]
    marks: Mapping[str, Sequence[float]]


def draw_landmark_sheet(
    vertices: Floats, triangles: NDArray[np.int64], landmarks: Mapping[str, int], photos: Sequence[SheetPhoto]
) -> Figure:
    """The template from three sides with the names of its landmarks, and below it the photos.

    Parameters
    ----------
    vertices : (V, 3) float64
        Of the template; x to its left, y up, z out of the face.
    triangles : (K, 3) int64
    landmarks : mapping of name to vertex
        In the order of their numbers.
    photos : sequence of SheetPhoto

    Raises
    ------
    InputError
        No landmark or no photo.
    """
    if not landmarks or not photos:
        raise InputError("landmark sheet: there is no landmark or no photo to draw")
    rows = -(-len(photos) // _COLUMNS)
    aspect = max(photo.size[1] / photo.size[0] for photo in photos)
    heights = [_WIDTH * _PANEL[1] / _PANEL[0], *([_WIDTH * aspect] * rows)]
    numbers = {name: number for number, name in enumerate(landmarks, start=1)}
    legend = textwrap.fill(
        "Landmarks:  " + ",  ".join(f"{number}\N{NO-BREAK SPACE}{name}" for name, number in numbers.items()), 230
    )
    top = 0.45 + 0.13 * (1 + legend.count("\n"))
    width, height = _COLUMNS * (_WIDTH + _GAP), sum(heights) + rows * _GAP + top + 0.25
    with paper_style():
        figure = new_figure(width, height)
        figure.set_layout_engine("none")  # places are known here; searching for them takes longer than drawing
        figure.text(0.08 / width, 1.0 - 0.08 / height, legend, fontsize=7, ha="left", va="top")
        places = {"left": 0.3 / width, "right": 1.0 - 0.1 / width, "bottom": 0.25 / height, "top": 1.0 - top / height}
        spaces = {"hspace": _GAP / float(np.mean(heights)), "wspace": _GAP / _WIDTH, "height_ratios": heights}
        grid = figure.subplots(rows + 1, _COLUMNS, squeeze=False, gridspec_kw=places | spaces)
        for axes, (title, turn) in zip(grid[0], _VIEWS, strict=True):
            _draw_template(axes, vertices, triangles, list(landmarks.items()), title, turn)
        below = grid[1:].ravel()
        for axes in below[len(photos) :]:
            axes.set_axis_off()
        for axes, photo in zip(below, photos, strict=False):
            _draw_photo(axes, photo, numbers)
    return figure


def _draw_template(
    axes: Axes,
    vertices: Floats,
    triangles: NDArray[np.int64],
    landmarks: list[tuple[str, int]],
    title: str,
    turn: float,
) -> None:
    rows = np.array([vertex for _, vertex in landmarks], dtype=np.int64)
    view = look_at(vertices, _UP, _FRONT, turn, _PANEL)
    clay = render_mesh(vertices, triangles, view=view, supersampling=1)
    axes.imshow(0.6 * clay / 255.0 + 0.4, extent=(0, _PANEL[0], _PANEL[1], 0))
    axes.set_axis_off()
    axes.set_title(title, fontsize=8)
    pixels, _ = project(view, vertices[rows])
    seen = visible_points(vertices, triangles, vertices[rows], view, 0.01 * float(np.ptp(vertices, axis=0).max()))
    for number, (pixel, shown) in enumerate(zip(pixels, seen, strict=True), start=1):
        if shown:
            _label(axes, pixel, str(number), 5.5)


def _draw_photo(axes: Axes, photo: SheetPhoto, numbers: Mapping[str, int]) -> None:
    width, height = photo.size
    axes.imshow(photo.image, extent=(0, width, height, 0), interpolation="bilinear")
    axes.set_xlim(0, width)
    axes.set_ylim(height, 0)
    axes.set_title(f"{photo.number}   {photo.name}", fontsize=8, loc="left", pad=2.0)
    step = _grid_step(max(width, height))
    axes.set_xticks(np.arange(0, width + 1, step))
    axes.set_yticks(np.arange(0, height + 1, step))
    axes.tick_params(labelsize=4.5, length=1.5, pad=1.0)
    axes.grid(visible=True, color="white", linewidth=0.25, alpha=0.5)
    for name, pixel in photo.marks.items():
        _label(axes, np.asarray(pixel, dtype=np.float64), str(numbers.get(name, name)), 5.0)


def _grid_step(length: int) -> int:
    """A round number of pixels of which about a dozen make the length."""
    rough = max(length / 12.0, 1.0)
    power = 10.0 ** np.floor(np.log10(rough))
    return int(power * min((1, 2, 5, 10), key=lambda factor: abs(factor * power - rough)))


def _label(axes: Axes, pixel: Floats, text: str, size: float) -> None:
    from matplotlib.patheffects import withStroke

    axes.scatter([pixel[0]], [pixel[1]], s=7, c=_MARK, edgecolors="white", linewidths=0.4, zorder=4)
    style: dict[str, Any] = {"fontsize": size, "color": _MARK, "fontweight": "bold", "zorder": 5}
    axes.annotate(
        text, (float(pixel[0]), float(pixel[1])), (2.0, 2.0), textcoords="offset points", annotation_clip=True,
        path_effects=[withStroke(linewidth=1.4, foreground="white")], **style,
    )  # fmt: skip
