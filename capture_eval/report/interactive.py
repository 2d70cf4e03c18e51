"""The interactive 3D view of the page: positions and errors packed small, drawn by Plotly in the browser.

Positions are stored as 16-bit steps of the bounding box (on a head of 300 mm: 0.005 mm) and errors as 16-bit steps of
the largest error, so that eleven poses and four methods of a 5,000-vertex head take about one megabyte.
"""

from __future__ import annotations

import base64
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import figure_style
from .saved_results import CurvePositions, FaceSequence, SavedResults

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

LARGEST_VERTEX_COUNT = 12000
_STEPS = 65534
_MISSING = 65535


def viewer_payload(results: SavedResults, up: Floats, front: Floats) -> dict[str, Any]:
    """Pack what the viewer needs as plain JSON values.

    Parameters
    ----------
    results
        Saved results; without a face sequence only curves are shown.
    up, front : (3,) arrays
        Unit vectors of the head: upwards, and the way the face looks.

    Returns
    -------
    dict
        Arrays are base64 of little-endian numbers; ``65535`` stands for a missing value.
    """
    curves = results.curves
    faces = None if results.faces is None else decimate(results.faces, LARGEST_VERTEX_COUNT)
    low, span = _bounds(curves, faces)
    styles = figure_style.method_styles(list(curves.predictions))
    errors = {method: curves.point_errors(method, results.diameter) for method in curves.predictions}
    finite = [values[np.isfinite(values)] for values in errors.values()]
    largest = max((float(values.max()) for values in finite if values.size), default=0.0)
    largest = largest if largest > 0.0 else 1.0
    return {
        "diameter": results.diameter,
        "low": low.tolist(),
        "step": span / _STEPS,
        "up": up.tolist(),
        "front": front.tolist(),
        "t": [float(t) for t in curves.t],
        "poses": [{"name": pose.name, "ok": pose.ok, "reason": pose.reason} for pose in results.poses],
        "largestError": 100.0 * largest,
        "errorStep": 100.0 * largest / _STEPS,
        "colours": _colour_stops(),
        "curves": {
            "names": list(curves.names),
            "draw": _pack(_draw_order(curves), "<i4"),
            "owner": _pack(np.repeat(np.arange(len(curves.names)), np.diff(curves.offsets)), "<u2"),
            "vertices": _pack(curves.vertices, "<i4"),
            "truth": _pack(_quantise(curves.truth, low, span), "<u2"),
        },
        "methods": [
            {
                "name": method,
                "label": styles[method].label,
                "colour": styles[method].colour,
                "positions": _pack(_quantise(curves.predictions[method], low, span), "<u2"),
                "errors": _pack(_steps(errors[method] / largest), "<u2"),
            }
            for method in curves.predictions
        ],
        "face": None if faces is None else _pack_face(faces, low, span, faces is results.faces),
    }


def decimate(faces: FaceSequence, largest_count: int) -> FaceSequence:
    """Thin a mesh for display: vertices of one cell of a grid become the one nearest to their mean.

    Every kept vertex is an original one, so the result is valid in every pose. The grid is made coarser until at most
    ``largest_count`` vertices remain; a mesh that is small enough is returned as it is.
    """
    count = faces.vertices.shape[1]
    neutral = faces.vertices[int(np.argmax(faces.pose_ok))]
    if count <= largest_count or not np.all(np.isfinite(neutral)):
        return faces
    cell = float(np.max(np.ptp(neutral, axis=0))) / np.sqrt(largest_count)
    while True:
        representative = _representatives(neutral, cell)
        kept = np.unique(representative)
        if len(kept) <= largest_count:
            break
        cell *= 1.15
    new_index = np.full(count, -1, dtype=np.int64)
    new_index[kept] = np.arange(len(kept))
    triangles = new_index[representative[faces.triangles]]
    proper = (
        (triangles[:, 0] != triangles[:, 1])
        & (triangles[:, 1] != triangles[:, 2])
        & (triangles[:, 2] != triangles[:, 0])
    )
    confidence = None if faces.confidence is None else faces.confidence[:, kept]
    return FaceSequence(
        faces.t,
        faces.vertices[:, kept],
        triangles[proper],
        confidence,
        faces.pose_ok,
        faces.used[kept],
        np.zeros((0, 2), dtype=np.int64),
        faces.seen[:, kept],
    )


def _representatives(points: Floats, cell: float) -> Integers:
    keys = np.floor((points - points.min(axis=0)) / cell).astype(np.int64)
    _, cell_of, sizes = np.unique(keys, axis=0, return_inverse=True, return_counts=True)
    cell_of = cell_of.reshape(-1)
    means = np.stack([np.bincount(cell_of, points[:, axis]) for axis in range(3)], axis=1) / sizes[:, None]
    distance = np.linalg.norm(points - means[cell_of], axis=1)
    order = np.lexsort((distance, cell_of))
    first = np.concatenate([[0], np.cumsum(sizes)[:-1]])
    chosen: Integers = order[first][cell_of]
    return chosen


def _bounds(curves: CurvePositions, faces: FaceSequence | None) -> tuple[Floats, float]:
    blocks = [curves.truth, *curves.predictions.values()]
    if faces is not None:
        blocks.append(faces.vertices)
    points = np.concatenate([block.reshape(-1, 3) for block in blocks])
    points = points[np.all(np.isfinite(points), axis=1)]
    if len(points) == 0:
        return np.zeros(3), 1.0
    low = points.min(axis=0)
    span = float(np.max(points.max(axis=0) - low))
    return low, span if span > 0.0 else 1.0


def _quantise(points: Floats, low: Floats, span: float) -> Integers:
    return _steps((points - low) / span)


def _steps(fractions: Floats) -> Integers:
    steps = np.rint(np.clip(np.nan_to_num(fractions, nan=0.0), 0.0, 1.0) * _STEPS)
    return np.where(np.isfinite(fractions), steps, _MISSING).astype(np.int64)


def _pack(values: NDArray[Any], kind: str) -> str:
    return base64.b64encode(np.ascontiguousarray(values).astype(np.dtype(kind)).tobytes()).decode("ascii")


def _draw_order(curves: CurvePositions) -> Integers:
    """Return point rows in the order of drawing, -1 where the pen is lifted; closed curves return to their start."""
    order: list[Integers] = []
    for closed, rows in zip(curves.closed, curves.slices(), strict=True):
        row = np.arange(rows.start, rows.stop)
        order.extend([row, row[:1], np.array([-1])] if closed else [row, np.array([-1])])
    return np.concatenate(order) if order else np.zeros(0, dtype=np.int64)


def _pack_face(faces: FaceSequence, low: Floats, span: float, whole: bool) -> dict[str, Any]:
    confidence = None
    if faces.confidence is not None:
        confidence = _pack(np.rint(255.0 * np.clip(np.nan_to_num(faces.confidence), 0.0, 1.0)), "u1")
    return {
        "count": int(faces.vertices.shape[1]),
        "whole": whole,
        "positions": _pack(_quantise(faces.vertices, low, span), "<u2"),
        "triangles": _pack(faces.triangles, "<i4"),
        "confidence": confidence,
    }


def _colour_stops() -> list[list[float | str]]:
    from matplotlib.colors import to_hex

    colours = figure_style.error_colourmap()
    return [[step / 16.0, to_hex(colours(step / 16.0))] for step in range(17)]
