"""Figures of the registration: mesh over photos, maps of drift and confidence, textures of all poses side by side.

Every function takes arrays and returns a matplotlib figure; nothing is measured here.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from capture_eval.cameras import View, project
from capture_eval.errors import InputError
from capture_eval.registration.photo_visibility import depth_image, depth_tolerance
from capture_eval.report import figure_style
from capture_eval.report.mesh_rendering import UNKNOWN_COLOUR, Preset, render_mesh

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Bytes = NDArray[np.uint8]

OVERLAY_CAPTION = (
    "The registered mesh drawn over photos of its pose: only edges that the camera can see. Where the lines leave "
    "the skin's outline, the registration is wrong."
)
DRIFT_CAPTION = (
    "Distance of every tracked vertex from the true place of the skin point it sits on in the neutral. Grey: not known."
)
CONFIDENCE_CAPTION = "Confidence of the tracked vertices, 0 to 1. Grey: not seen, or the pose failed."
TEXTURE_CAPTION = (
    "Photos of every pose, blended onto its registered mesh, in the UV layout. If tracking holds, every mark of the "
    "skin stays at the same place of the layout. Black: not seen."
)

_LINE_COLOUR = "#00E5FF"
_PANEL = 44.0 * figure_style.MILLIMETRE


def mesh_over_photos(
    photos: Sequence[Bytes],
    views: Sequence[View],
    vertices_of_photos: Sequence[Floats],
    triangles: Integers,
    edges: Integers,
    titles: Sequence[str],
    columns: int = 3,
) -> Figure:
    """Draw the visible edges of the registered mesh on photos, each cropped to the mesh.

    Parameters
    ----------
    photos : sequence of (H, W, 3) uint8
    views : sequence of View
        In the frame of the vertices.
    vertices_of_photos : sequence of (V, 3) float64
        Mesh of the pose that each photo shows; NaN rows are not drawn.
    triangles : (K, 3) int64
        Surface that hides edges.
    edges : (E, 2) int64
        Edges of the polygons (without the diagonals of the triangles).
    titles : sequence of str

    Raises
    ------
    InputError
        The sequences differ in length or are empty.
    """
    count = _same_length(photos, views, vertices_of_photos, titles)
    columns = min(columns, count)
    boxes = [_crop(view, vertices) for view, vertices in zip(views, vertices_of_photos, strict=True)]
    aspect = max((bottom - top) / (right - left) for left, right, top, bottom in boxes)
    boxes = [_widen(box, aspect, view) for box, view in zip(boxes, views, strict=True)]
    figure, axes = _panels(count, columns, 60.0 * figure_style.MILLIMETRE, aspect)
    for index in range(count):
        axes[index].imshow(photos[index], extent=(0, photos[index].shape[1], photos[index].shape[0], 0))
        _draw_visible_edges(axes[index], views[index], vertices_of_photos[index], triangles, edges)
        left, right, top, bottom = boxes[index]
        axes[index].set_xlim(left, right)
        axes[index].set_ylim(bottom, top)
        axes[index].set_title(titles[index])
    return figure


def drift_maps(
    vertices_of_poses: Sequence[Floats],
    triangles: Integers,
    drift_of_poses: Sequence[Floats],
    titles: Sequence[str],
    frame: Floats | None = None,
    largest: float | None = None,
    preset: Preset = "three_quarter",
) -> Figure:
    """Draw tracking errors, per cent of D, (V,) per pose, NaN where unknown; one colour bar for all poses.

    ``largest`` is the end of the bar (by default the 98th percentile of all values); ``frame`` are points that the
    pictures hold, for instance the face without the neck.
    """
    known = np.concatenate([values[np.isfinite(values)] for values in drift_of_poses])
    top = largest or (float(np.quantile(known, 0.98)) if known.size else 1.0)
    return _maps(
        vertices_of_poses,
        triangles,
        drift_of_poses,
        [f"{title}\n{_median_and_tail(values)}" for title, values in zip(titles, drift_of_poses, strict=True)],
        "tracking error  (% of D)",
        figure_style.error_colourmap(),
        (0.0, top),
        frame,
        preset,
        "max" if known.size and known.max() > top else "neither",
    )


def confidence_maps(
    vertices_of_poses: Sequence[Floats],
    triangles: Integers,
    confidence_of_poses: Sequence[Floats],
    titles: Sequence[str],
    frame: Floats | None = None,
    preset: Preset = "three_quarter",
) -> Figure:
    """Draw confidences in [0, 1], (V,) per pose, NaN where a pose failed."""
    return _maps(
        vertices_of_poses,
        triangles,
        confidence_of_poses,
        list(titles),
        "confidence",
        "cividis",
        (0.0, 1.0),
        frame,
        preset,
        "neither",
    )


def textures_side_by_side(
    textures: Sequence[NDArray[Any]], masks: Sequence[NDArray[np.bool_]], titles: Sequence[str], columns: int = 4
) -> Figure:
    """Draw baked textures, (S, S) or (S, S, 3) with values 0..255, all cropped to what any pose shows."""
    count = _same_length(textures, masks, titles)
    columns = min(columns, count)
    shown = np.any(np.stack([np.asarray(mask) for mask in masks]), axis=0)
    rows = np.flatnonzero(shown.any(axis=1)) if shown.any() else np.arange(shown.shape[0])
    places = np.flatnonzero(shown.any(axis=0)) if shown.any() else np.arange(shown.shape[1])
    box = (slice(int(rows[0]), int(rows[-1]) + 1), slice(int(places[0]), int(places[-1]) + 1))
    aspect = (box[0].stop - box[0].start) / (box[1].stop - box[1].start)
    figure, axes = _panels(count, columns, _PANEL, aspect)
    for index in range(count):
        picture = np.where(_as_colour(masks[index]), _as_colour(textures[index]), 0)[box]
        axes[index].imshow(np.clip(picture, 0, 255).astype(np.uint8))
        axes[index].set_title(titles[index])
    return figure


def _maps(
    vertices_of_poses: Sequence[Floats],
    triangles: Integers,
    values_of_poses: Sequence[Floats],
    titles: Sequence[str],
    label: str,
    colour_map: Any,
    value_range: tuple[float, float],
    frame: Floats | None,
    preset: Preset,
    extend: str,
) -> Figure:
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    count = _same_length(vertices_of_poses, values_of_poses, titles)
    columns = min(count, 4)
    figure, axes = _panels(count, columns, _PANEL, 1.2)
    scale = ScalarMappable(Normalize(*value_range), colour_map)
    held = np.concatenate([v[np.all(np.isfinite(v), axis=1)] for v in vertices_of_poses]) if frame is None else frame
    for index in range(count):
        vertices = vertices_of_poses[index]
        if not np.all(np.isfinite(vertices)):
            _say_failed(axes[index])
        else:
            colours = _colours(scale, values_of_poses[index])
            picture = render_mesh(
                vertices, triangles, colours=colours, preset=preset, size=(400, 480), frame=held, shading=0.55
            )
            axes[index].imshow(picture)
        axes[index].set_title(titles[index])
    bar = figure.colorbar(scale, ax=axes.tolist(), shrink=0.7, aspect=28, pad=0.01, extend=extend)
    bar.set_label(label)
    bar.outline.set_visible(False)
    return figure


def _colours(scale: Any, values: Floats) -> Floats:
    known = np.isfinite(values)
    mapped = np.asarray(scale.to_rgba(np.where(known, values, 0.0)), dtype=np.float64)[:, :3]
    return np.where(known[:, None], mapped, np.asarray(UNKNOWN_COLOUR))


def _panels(count: int, columns: int, width: float, aspect: float) -> tuple[Figure, NDArray[Any]]:
    rows = -(-count // columns)
    height = rows * (width * aspect + 5.0 * figure_style.MILLIMETRE)
    figure = figure_style.new_figure(min(columns * width, figure_style.DOUBLE_COLUMN), height)
    axes = np.atleast_1d(figure.subplots(rows, columns)).ravel()
    for one in axes:
        one.set_axis_off()
    return figure, axes


def _draw_visible_edges(axes: Axes, view: View, vertices: Floats, triangles: Integers, edges: Integers) -> None:
    """Draw edges whose two ends and middle are in front of all else."""
    from matplotlib.collections import LineCollection

    known = np.all(np.isfinite(vertices), axis=1)
    safe = np.where(known[:, None], vertices, np.nanmean(vertices, axis=0) if known.any() else 0.0)
    usable = triangles[known[triangles].all(axis=1)]
    depth = depth_image(view, safe, usable)
    slack = 4.0 * depth_tolerance(safe)
    ends = edges[known[edges].all(axis=1)]
    middle = 0.5 * (safe[ends[:, 0]] + safe[ends[:, 1]])
    visible = _in_front(view, depth, safe, slack)[ends].all(axis=1) & _in_front(view, depth, middle, slack)
    pixels, _ = project(view, safe)
    lines = LineCollection(list(pixels[ends[visible]]), colors=_LINE_COLOUR, linewidths=0.28, alpha=0.85)
    axes.add_collection(lines)


def _in_front(view: View, depth: NDArray[np.float32], points: Floats, slack: float) -> NDArray[np.bool_]:
    pixels, distance = project(view, points)
    height, width = depth.shape
    places = np.floor(np.nan_to_num(pixels)).astype(np.int64)
    inside = (distance > 0) & np.all((places >= 0) & (places < (width, height)), axis=1)
    column, row = np.where(inside[:, None], places, 0).T
    return np.asarray(inside & (distance <= depth[row, column] + slack), dtype=np.bool_)


def _crop(view: View, vertices: Floats) -> tuple[float, float, float, float]:
    """Left, right, top and bottom of the mesh in the photo with a margin."""
    pixels, distance = project(view, vertices[np.all(np.isfinite(vertices), axis=1)])
    pixels = pixels[distance > 0]
    width, height = view.intrinsics.width, view.intrinsics.height
    if len(pixels) == 0:
        return 0.0, float(width), 0.0, float(height)
    low, high = pixels.min(axis=0), pixels.max(axis=0)
    margin = 0.06 * float(np.max(high - low))
    left, top = max(low[0] - margin, 0.0), max(low[1] - margin, 0.0)
    right, bottom = min(high[0] + margin, width), min(high[1] + margin, height)
    if right - left < 2 or bottom - top < 2:
        return 0.0, float(width), 0.0, float(height)
    return float(left), float(right), float(top), float(bottom)


def _widen(box: tuple[float, float, float, float], aspect: float, view: View) -> tuple[float, float, float, float]:
    """Grow a box to a height of ``aspect`` times its width, within the photo where that is possible."""
    left, right, top, bottom = box
    height = max(bottom - top, aspect * (right - left))
    width = height / aspect
    left = min(max(0.5 * (left + right - width), 0.0), max(view.intrinsics.width - width, 0.0))
    top = min(max(0.5 * (top + bottom - height), 0.0), max(view.intrinsics.height - height, 0.0))
    return left, left + width, top, top + height


def _say_failed(axes: Axes) -> None:
    axes.text(0.5, 0.5, "failed", transform=axes.transAxes, ha="center", va="center", color=figure_style.FAILED_COLOUR)


def _median_and_tail(values: Floats) -> str:
    known = values[np.isfinite(values)]
    if known.size == 0:
        return "not known"
    return f"median {np.median(known):.3f}, p95 {np.quantile(known, 0.95):.3f}"


def _as_colour(picture: NDArray[Any]) -> NDArray[Any]:
    return np.repeat(picture[:, :, None], 3, axis=2) if picture.ndim == 2 else picture


def _same_length(*sequences: Sequence[Any]) -> int:
    lengths = [len(sequence) for sequence in sequences]
    if min(lengths) == 0 or len(set(lengths)) != 1:
        raise InputError(f"figure: sequences of {lengths} entries; they must be equal and not empty")
    return lengths[0]
