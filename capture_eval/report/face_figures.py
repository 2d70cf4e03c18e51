"""Faces: ground truth and every method side by side, heat maps of error and of tracking confidence.

Curve methods predict curves, so their columns show the true face in grey with the predicted curves over it, coloured
by error. Only geometric linear interpolation is defined for every vertex; it alone gets whole-face heat maps.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..cameras import Intrinsics, View, project
from . import figure_style
from .capture_figures import drift_maps
from .mesh_rendering import render_mesh
from .saved_results import CurvePositions, FaceSequence

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.colors import Normalize
    from matplotlib.figure import Figure

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

METHODS_CAPTION = (
    "Grey: the registered face at t; lines: the curves, in the method columns where the method puts them, "
    "coloured by the distance of each point from its true place, on one square-root scale. "
    "The number in a tile is the largest error of all curves at that t (% of D)."
    " Thin grey lines: points that do not count, because tracking was not sure of them."
)
LINEAR_CAPTION = (
    "Geometric linear interpolation is defined for every vertex, not only on curves: distance of each vertex "
    "from its registered place, drawn on the registered face. Grey: vertices that do not count."
)
CONFIDENCE_CAPTION = (
    "Drawn on the neutral face: for every vertex the lowest value of all poses. Blue parts carry "
    "the evaluation; brown parts were hidden, opened or closed in some pose."
)
_ASPECT = 1.3

_FACE_COLOUR = (0.84, 0.84, 0.85)
_NO_CLAIM_COLOUR = (0.72, 0.72, 0.73)


def look_at(points: Floats, up: Floats, front: Floats, turn: float, size: tuple[int, int]) -> View:
    """Place a long lens that holds all points, turned about the upright axis.

    Parameters
    ----------
    points : (N, 3) array
        What the picture is to hold; rows with NaN are passed over.
    up, front : (3,) arrays
        Unit vectors of the head.
    turn : float
        Degrees; 0 looks at the face from the front, positive from its left.
    size : (width, height)
        Pixels.

    Returns
    -------
    View
        COLMAP convention, at twelve times the extent of the points, so that perspective hardly shows.
    """
    known = points[np.all(np.isfinite(points), axis=1)]
    angle = np.deg2rad(turn)
    left = np.cross(up, front)
    towards = np.cos(angle) * front + np.sin(angle) * left
    forward = -towards
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    local = known @ rotation.T
    low, high = local.min(axis=0), local.max(axis=0)
    extent = float(np.max(high - low))
    middle = 0.5 * (low + high)
    distance = 12.0 * extent
    width, height = size
    room = np.array([width, height]) * 0.92
    focal = float(np.min(room / np.maximum((high - low)[:2], 1e-12))) * (distance - 0.5 * (high - low)[2])
    matrix = np.array([[focal, 0.0, 0.5 * width], [0.0, focal, 0.5 * height], [0.0, 0.0, 1.0]])
    intrinsics = Intrinsics(width=width, height=height, matrix=matrix, distortion=np.zeros(4))
    translation = np.array([-middle[0], -middle[1], distance - middle[2]])
    return View(name="look_at", intrinsics=intrinsics, rotation=rotation, translation=translation)


def visible_points(vertices: Floats, triangles: Integers, points: Floats, view: View, tolerance: float) -> Any:
    """Tell which points no part of the mesh hides from the camera, (N,) bool; NaN points are hidden.

    A point may lie up to ``tolerance`` behind the surface, since curve points lie in it.
    """
    import open3d

    tensor: Any = open3d.core.Tensor
    scene = open3d.t.geometry.RaycastingScene(nthreads=1)
    centre = np.nanmean(vertices, axis=0)
    scene.add_triangles(tensor((vertices - centre).astype(np.float32)), tensor(triangles.astype(np.uint32)))
    offsets = points - view.center
    distance = np.linalg.norm(offsets, axis=1)
    known = np.isfinite(distance)
    directions = np.where(known[:, None], offsets / np.where(known, distance, 1.0)[:, None], [0.0, 0.0, 1.0])
    # Rays start near the face: from the camera's true distance single precision would eat the tolerance.
    reach = 2.0 * float(np.nanmax(np.linalg.norm(vertices - centre, axis=1)))
    start = np.where(known[:, None], points, centre) - reach * directions - centre
    rays = np.concatenate([start, directions], axis=1).astype(np.float32)
    hit = scene.cast_rays(tensor(rays), nthreads=1)["t_hit"].numpy()
    return known & (hit > reach - tolerance)


def choose_times(curves: CurvePositions, count: int = 3) -> list[int]:
    """Choose in-between poses evenly spread over those that have a ground truth; rows of ``CurvePositions.t``."""
    inside = [row for row in range(1, len(curves.t) - 1) if bool(np.any(np.isfinite(curves.truth[row])))]
    if len(inside) <= count:
        return inside
    wanted = np.linspace(0.3, 0.7, count)
    times = curves.t[inside]
    return sorted({inside[int(np.argmin(np.abs(times - t)))] for t in wanted})


def faces_by_method(
    faces: FaceSequence, curves: CurvePositions, diameter: float, up: Floats, front: Floats, turn: float = 28.0
) -> Figure:
    """Draw one row per chosen t and one column for the truth and each method.

    Parameters
    ----------
    faces, curves
        Registered meshes and curves of the same poses.
    diameter
        D in head units.
    up, front : (3,) arrays
        Unit vectors of the head.
    turn
        Degrees that the camera stands to the subject's left.
    """
    rows = choose_times(curves)
    methods = list(curves.predictions)
    columns = len(methods) + 1
    width = figure_style.DOUBLE_COLUMN
    tile = (width - 0.45) / columns
    aspect = _ASPECT
    figure = figure_style.new_figure(width, max(len(rows), 1) * tile * aspect + 0.3, padding=0.01)
    axes = figure.subplots(max(len(rows), 1), columns, squeeze=False)
    for panel in axes.ravel():
        panel.axis("off")
    if not rows:
        axes[0, 0].text(0.0, 0.5, "no in-between pose has a ground truth", color=figure_style.FAILED_COLOUR)
        return figure
    size = (360, round(360 * aspect))
    view = look_at(_portrait(faces, up, front, diameter), up, front, turn, size)
    errors = {method: curves.point_errors(method, diameter) for method in methods}
    known = np.concatenate([errors[method][rows].ravel() for method in methods])
    top = 100.0 * float(np.max(known[np.isfinite(known)], initial=0.0))
    styles = figure_style.method_styles(methods)
    for line, row in enumerate(rows):
        vertices = faces.vertices[row]
        picture = _grey_face(vertices, faces.triangles, view)
        seen = visible_points(vertices, faces.triangles, curves.truth[row], view, 0.012 * diameter)
        for column in range(columns):
            panel = axes[line, column]
            panel.imshow(picture, extent=(0, size[0], size[1], 0), interpolation="antialiased")
            panel.set_xlim(0, size[0])
            panel.set_ylim(size[1], 0)
            method = methods[column - 1] if column else None
            if line == 0:
                panel.set_title("ground truth" if method is None else styles[method].label, loc="center", fontsize=7)
            if method is None:
                _draw_curves(panel, curves, curves.truth[row], seen, view, None, top)
                panel.text(6, 6, f"t = {curves.t[row]:.3g}", va="top", fontsize=7, fontweight="bold")
            else:
                values = 100.0 * errors[method][row]
                _draw_curves(panel, curves, curves.predictions[method][row], seen, view, values, top)
                panel.text(size[0] - 6, size[1] - 6, _largest_text(values), ha="right", va="bottom", fontsize=6)
    _error_bar(figure, axes, _error_scale(top), "error  (% of D, square-root scale)")
    return figure


def linear_heat_maps(
    faces: FaceSequence, diameter: float, up: Floats, front: Floats, turn: float = 28.0, count: int = 5
) -> Figure:
    """Draw the whole-face error of geometric linear interpolation at evenly chosen in-between poses."""
    from matplotlib.colors import Normalize

    inside = [row for row in range(1, len(faces.t) - 1) if faces.pose_ok[row]]
    rows = (
        [inside[i] for i in sorted(set(np.linspace(0, len(inside) - 1, count).round().astype(int)))] if inside else []
    )
    width = figure_style.DOUBLE_COLUMN
    tile = (width - 0.45) / max(len(rows), 1)
    aspect = _ASPECT
    figure = figure_style.new_figure(width, min(tile, 1.8) * aspect + 0.3)
    axes = figure.subplots(1, max(len(rows), 1), squeeze=False)
    for panel in axes.ravel():
        panel.axis("off")
    first, last = faces.vertices[0], faces.vertices[-1]
    times = faces.t[rows][:, None, None]
    errors = np.linalg.norm(first + times * (last - first) - faces.vertices[rows], axis=2) / diameter
    if not rows or not np.any(np.isfinite(errors)):
        axes[0, 0].text(0.0, 0.5, "first, last or every in-between pose failed", color=figure_style.FAILED_COLOUR)
        return figure
    trusted = faces.used
    top = 100.0 * float(np.nanmax(errors[:, trusted])) if np.any(trusted) else 1.0
    size = (360, round(360 * aspect))
    view = look_at(_portrait(faces, up, front, diameter), up, front, turn, size)
    colourmap = figure_style.error_colourmap()
    for panel, row, values in zip(axes[0], rows, errors, strict=True):
        colours = np.asarray(colourmap(np.clip(100.0 * values / max(top, 1e-12), 0.0, 1.0)))[:, :3]
        colours[~trusted] = _NO_CLAIM_COLOUR
        picture = render_mesh(
            faces.vertices[row], faces.triangles, colours=colours, view=view, supersampling=2, shading=0.45
        )
        panel.imshow(picture, interpolation="antialiased")
        panel.set_title(f"t = {faces.t[row]:.3g}", loc="center", fontsize=7)
    _error_bar(figure, axes, Normalize(0.0, max(top, 1e-12)), "error  (% of D)")
    return figure


def confidence_map(faces: FaceSequence, up: Floats, front: Floats) -> Figure:
    """Draw the lowest confidence of all poses on the neutral face, from three sides."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import LinearSegmentedColormap, Normalize

    width = figure_style.DOUBLE_COLUMN
    aspect = _ASPECT
    figure = figure_style.new_figure(width, 0.9 * (width - 0.45) / 3 * aspect)
    axes = figure.subplots(1, 3, squeeze=False)
    for panel in axes.ravel():
        panel.axis("off")
    colourmap = LinearSegmentedColormap.from_list("confidence", ["#B35806", "#E8E4DC", "#2166AC"])
    if faces.confidence is not None and faces.pose_ok[0]:
        values = np.nan_to_num(np.min(faces.confidence[faces.pose_ok], axis=0))
        colours = np.asarray(colourmap(values))[:, :3]
        for panel, turn in zip(axes[0], (-50.0, 0.0, 50.0), strict=True):
            size = (420, round(420 * aspect))
            view = look_at(faces.vertices[0], up, front, turn, size)
            picture = render_mesh(
                faces.vertices[0], faces.triangles, colours=colours, view=view, supersampling=2, shading=0.5
            )
            panel.imshow(picture, interpolation="antialiased")
    else:
        axes[0, 0].text(0.0, 0.5, "poses were given as meshes: no confidence")
    bar = figure.colorbar(
        ScalarMappable(Normalize(0.0, 1.0), colourmap), ax=list(axes.ravel()), shrink=0.6, pad=0.01, aspect=24
    )
    bar.set_label("lowest confidence of all poses")
    return figure


def _largest_text(values: Floats) -> str:
    known = values[np.isfinite(values)]
    return f"{known.max():.2f}" if known.size else "no value"


def tracking_error_maps(
    faces: FaceSequence, places: Floats, rows: Sequence[int], diameter: float, up: Floats, front: Floats
) -> Figure:
    """Draw how far the seen vertices of chosen poses are from the true places of their skin points.

    Parameters
    ----------
    faces
        Registered meshes.
    places : (P, V, 3) array
        True places in the frame of the meshes.
    rows
        Poses to draw.
    diameter
        D in head units.
    up, front : (3,) arrays
        Unit vectors of the head.
    """
    drawn_from_head = np.stack([np.cross(up, front), up, front])  # x to the subject's left, y up, z out of the face
    errors = 100.0 * np.linalg.norm(faces.vertices - places, axis=2) / diameter
    errors = np.where(faces.seen, errors, np.nan)
    return drift_maps(
        [faces.vertices[row] @ drawn_from_head.T for row in rows],
        faces.triangles,
        [errors[row] for row in rows],
        [f"t = {faces.t[row]:.3g}" for row in rows],
        frame=_portrait(faces, up, front, diameter) @ drawn_from_head.T,
    )


def _portrait(faces: FaceSequence, up: Floats, front: Floats, diameter: float) -> Floats:
    """Points that frame the face in every pose: the front of the head, without neck and nape."""
    known = faces.vertices[np.all(np.isfinite(faces.vertices), axis=(1, 2))]
    points = known.reshape(-1, 3)
    if len(points) == 0:
        return np.array([[-1.0, -1.0, -1.0], [1.0, 1.0, 1.0]])
    height = known[0] @ up
    depth = points @ front
    keep = (depth > depth.max() - 0.36 * diameter) & (points @ up > height.max() - 0.86 * diameter)
    framed: Floats = points[keep]
    return framed


def _grey_face(vertices: Floats, triangles: Integers, view: View) -> NDArray[np.uint8]:
    colours = np.tile(np.array(_FACE_COLOUR), (len(vertices), 1))
    return render_mesh(vertices, triangles, colours=colours, view=view, supersampling=2)


def _draw_curves(
    panel: Axes,
    curves: CurvePositions,
    positions: Floats,
    seen: NDArray[np.bool_],
    view: View,
    values: Floats | None,
    top: float,
) -> None:
    from matplotlib.collections import LineCollection

    known = seen & np.all(np.isfinite(positions), axis=1)
    pixels = np.full((len(positions), 2), np.nan)
    if np.any(known):
        pixels[known] = project(view, positions[known])[0]
    first, second = _segments(curves)
    drawn = known[first] & known[second]
    lines = np.stack([pixels[first[drawn]], pixels[second[drawn]]], axis=1)
    if values is None:
        panel.add_collection(LineCollection(list(lines), colors="#1F2937", linewidths=0.55, capstyle="round"))
        return
    strength = 0.5 * (values[first[drawn]] + values[second[drawn]])
    counts = np.isfinite(strength)
    panel.add_collection(LineCollection(list(lines[~counts]), colors="#8A9099", linewidths=0.35))
    lines, strength = lines[counts], strength[counts]
    collection = LineCollection(
        list(lines), cmap=figure_style.error_colourmap(), norm=_error_scale(top), linewidths=0.9, capstyle="round"
    )
    collection.set_array(strength)
    panel.add_collection(collection)


def _segments(curves: CurvePositions) -> tuple[Integers, Integers]:
    first, second = [], []
    for closed, rows in zip(curves.closed, curves.slices(), strict=True):
        row = np.arange(rows.start, rows.stop)
        first.append(row if closed else row[:-1])
        second.append(np.roll(row, -1) if closed else row[1:])
    return np.concatenate(first), np.concatenate(second)


def _error_scale(top: float) -> Normalize:
    """Return a square-root scale: a method ten times better than the worst is still told from zero."""
    from matplotlib.colors import PowerNorm

    return PowerNorm(0.5, 0.0, max(top, 1e-12))


def _error_bar(figure: Figure, axes: NDArray[Any], scale: Normalize, label: str) -> None:
    from matplotlib.cm import ScalarMappable

    mappable = ScalarMappable(scale, figure_style.error_colourmap())
    bar = figure.colorbar(mappable, ax=list(axes.ravel()), location="right", shrink=0.6, pad=0.01, aspect=28)
    bar.set_label(label)
