"""Read the saved results that the report draws: out/report, out/work/<pose>/*.json, alignment.json."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..evaluation.error_table import ErrorTable
from ..files.atomic import read_json, read_npz
from ..report.saved_results import (
    CurvePositions,
    FaceSequence,
    PoseQuality,
    SavedResults,
    TruthComparison,
)

_ERROR_COLUMNS = ("method", "curve", "t", "n_points", "E_A", "E_M")


def read_results(out: Path, info: Mapping[str, Any]) -> SavedResults:
    """Read everything the report shows.

    Parameters
    ----------
    out
        Folder of the result.
    info
        See ``stages.report.write_report``.

    Raises
    ------
    InputError
        A file of the evaluation is missing or not what it should be; it is named.
    """
    report = out / "report"
    summary = read_json(report / "summary.json")
    if not isinstance(summary, dict):
        raise InputError(f"{report / 'summary.json'}: not a summary")
    faces = read_faces(report / "registered.npz") if (report / "registered.npz").is_file() else None
    curves = read_curve_positions(report / "curves.npz")
    return SavedResults(
        name=str(info.get("name", out.name)),
        diameter=float(summary["D"]),
        summary=summary,
        errors=read_errors(report / "errors.csv"),
        curves=curves,
        faces=faces,
        poses=read_poses(out, info.get("poses", ()), curves.t, faces),
        truth=read_truth(out, curves.t),
    )


def read_errors(path: Path) -> ErrorTable:
    """Read ``errors.csv``; a row that is not there stays NaN.

    Raises
    ------
    InputError
        The file is missing, has other columns, or holds something that is not a number.
    """
    try:
        with path.open(encoding="utf-8", newline="") as stream:
            reader = csv.DictReader(stream)
            rows = list(reader)
            columns = tuple(reader.fieldnames or ())
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error})") from error
    missing = [name for name in _ERROR_COLUMNS if name not in columns]
    if missing:
        raise InputError(f"{path}: no column {', '.join(missing)}")
    try:
        values = [
            (
                row["method"],
                row["curve"],
                float(row["t"]),
                int(row["n_points"]),
                _number(row["E_A"]),
                _number(row["E_M"]),
            )
            for row in rows
        ]
    except ValueError as error:
        raise InputError(f"{path}: {error}") from error
    methods = tuple(dict.fromkeys(row[0] for row in values))
    curves = tuple(dict.fromkeys(row[1] for row in values))
    times = sorted({row[2] for row in values})
    average = np.full((len(methods), len(curves), len(times)), np.nan)
    maximum = average.copy()
    points = np.zeros(average.shape[1:], dtype=np.int64)
    method_row = {name: row for row, name in enumerate(methods)}
    curve_row = {name: row for row, name in enumerate(curves)}
    time_row = {t: row for row, t in enumerate(times)}
    for method, curve, t, count, mean_error, largest_error in values:
        place = (method_row[method], curve_row[curve], time_row[t])
        average[place], maximum[place], points[place[1:]] = mean_error, largest_error, count
    return ErrorTable(methods, curves, np.array(times), points, average, maximum)


def _number(text: str) -> float:
    return float(text) if text.strip() else math.nan


def read_poses(
    out: Path, entries: Sequence[Mapping[str, Any]], times: NDArray[np.float64], faces: FaceSequence | None
) -> tuple[PoseQuality, ...]:
    """Collect what every stage said about every pose of the manifest."""
    alignment, tracked, registered = (
        _pose_rows(out / "work" / name)
        for name in ("align/alignment.json", "register/tracking.json", "register/registered.json")
    )
    poses = []
    for row, entry in enumerate(entries):
        name = str(entry["name"])
        folder = out / "work" / name
        stages: dict[str, dict[str, Any]] = {
            stage: read_json(folder / f"{stage}.json")
            for stage in ("sparse", "dense", "surface")
            if (folder / f"{stage}.json").is_file()
        }
        if name in alignment:
            stages["align"] = alignment[name]
        figures = _figures(stages)
        ok = True
        if faces is not None and row < len(faces.pose_ok):
            ok = bool(faces.pose_ok[row])
            figures |= _confidence_figures(faces, row)
        for stage, found in (("register", tracked), ("register", registered)):
            earlier = any(content.get("status") == "failed" for content in stages.values())
            if not earlier and found.get(name, {}).get("status") == "failed":
                stages[stage] = found[name]
        doubts = tuple(registered.get(name, {}).get("doubts", ()))
        failed = [stage for stage, content in stages.items() if content.get("status") == "failed"]
        reason = "; ".join(f"{stage}: {stages[stage].get('reason') or 'failed'}" for stage in failed)
        if not ok and not reason:
            reason = "no registered mesh"
        statuses = {stage: str(content.get("status", "")) for stage, content in stages.items()}
        t = float(entry.get("t", times[row]))
        poses.append(PoseQuality(name, t, ok and not failed, reason, figures, statuses, doubts))
    return tuple(poses)


def _pose_rows(path: Path) -> dict[str, dict[str, Any]]:
    if not path.is_file():
        return {}
    rows = read_json(path).get("poses", [])
    return {str(row["pose"]): row for row in rows}


def _figures(stages: Mapping[str, Mapping[str, Any]]) -> dict[str, float]:
    """Pick the figures that are drawn; what a stage did not measure is left out."""
    quantiles = stages.get("surface", {}).get("support_quantiles") or {}
    inliers = stages.get("align", {}).get("inliers") or None
    wanted = {
        "photos": stages.get("sparse", {}).get("photos"),
        "registered": stages.get("sparse", {}).get("registered"),
        "reprojection_error_px": stages.get("sparse", {}).get("reprojection_error_px"),
        "track_length": stages.get("sparse", {}).get("track_length"),
        "points": stages.get("sparse", {}).get("points") or None,
        "threads": stages.get("sparse", {}).get("threads"),
        "fused_points": stages.get("dense", {}).get("points") or None,
        "scan_vertices": stages.get("surface", {}).get("vertices") or None,
        "support_median": quantiles.get("50"),
        "support_p5": quantiles.get("5"),
        # the pose that the others are brought to has no residual
        "align_residual_px": stages.get("align", {}).get("residual_px") if inliers else None,
        "align_inliers": inliers,
    }
    return {name: float(value) for name, value in wanted.items() if value is not None}


def _confidence_figures(faces: FaceSequence, row: int) -> dict[str, float]:
    if faces.confidence is None or not faces.pose_ok[row]:
        return {}
    confidence = faces.confidence[row]
    seen = confidence > 0.0
    if not np.any(seen):
        return {"seen": 0.0}
    return {
        "confidence_median": float(np.median(confidence[seen])),
        "confidence_p10": float(np.percentile(confidence[seen], 10)),
        "seen": float(np.mean(seen)),
    }


def read_faces(path: Path) -> FaceSequence:
    """Read ``registered.npz``: the registered mesh of every pose and its polygons."""
    saved = read_npz(path)
    vertices = _array(saved, "vertices", path)
    times = _array(saved, "t", path)
    used = saved.get("used_vertices")
    seen = saved.get("seen")
    return FaceSequence(
        t=times,
        vertices=vertices,
        triangles=_triangles(saved, path),
        confidence=saved.get("confidence"),
        pose_ok=_array(saved, "pose_ok", path).astype(bool),
        used=np.ones(vertices.shape[1], dtype=bool) if used is None else used.astype(bool),
        edges=_edges(saved, path),
        seen=np.ones(vertices.shape[:2], dtype=bool) if seen is None else seen.astype(bool),
        error_bar=saved.get("error_bar"),
    )


def _edges(saved: Mapping[str, NDArray[Any]], path: Path) -> NDArray[np.int64]:
    """Edges of the polygons, each once."""
    offsets = _array(saved, "face_offsets", path).astype(np.int64)
    corners = _array(saved, "face_vertices", path).astype(np.int64)
    following = np.arange(1, len(corners) + 1)
    following[offsets[1:] - 1] = offsets[:-1]
    edges: NDArray[np.int64] = np.unique(np.sort(np.stack([corners, corners[following]], axis=1), axis=1), axis=0)
    return edges


def _triangles(saved: Mapping[str, NDArray[Any]], path: Path) -> NDArray[np.int64]:
    offsets = _array(saved, "face_offsets", path).astype(np.int64)
    corners = _array(saved, "face_vertices", path).astype(np.int64)
    sizes = np.diff(offsets)
    start = np.repeat(offsets[:-1], sizes - 2)
    first = np.repeat(np.cumsum(sizes - 2) - (sizes - 2), sizes - 2)
    step = np.arange(len(start)) - first
    triangles: NDArray[np.int64] = corners[np.stack([start, start + step + 1, start + step + 2], axis=1)]
    return triangles


def read_curve_positions(path: Path) -> CurvePositions:
    """Read ``curves.npz``: true and predicted positions of all curve points."""
    saved = read_npz(path)
    methods = [str(name) for name in _array(saved, "methods", path)]
    return CurvePositions(
        names=tuple(str(name) for name in _array(saved, "names", path)),
        closed=_array(saved, "closed", path).astype(bool),
        offsets=_array(saved, "offsets", path).astype(np.int64),
        vertices=_array(saved, "vertices", path).astype(np.int64),
        t=_array(saved, "t", path),
        truth=_array(saved, "truth", path),
        predictions={method: _array(saved, f"prediction/{method}", path) for method in methods},
        counted=_array(saved, "used", path).astype(bool),
    )


def read_truth(out: Path, times: NDArray[np.float64]) -> TruthComparison | None:
    """Read the comparison with known truth, if the capture had one; missing figures are NaN."""
    table, comparison, tracking = (
        out / "report" / name for name in ("errors_truth.csv", "truth_comparison.json", "truth.json")
    )
    if not table.is_file() and not tracking.is_file():
        return None
    places = out / "work" / "register" / "tracked_truth.npz"
    rows = list(read_json(tracking).get("tracking", [])) if tracking.is_file() else []
    series = {
        name: np.array([_row_value(rows, row, name) for row in range(len(times))]) for name in ("median", "p90", "p95")
    }
    return TruthComparison(
        errors_from_truth=read_errors(table) if table.is_file() else None,
        tracking={name: values for name, values in series.items() if np.any(np.isfinite(values))},
        tracking_rows=tuple(rows),
        comparison=read_json(comparison) if comparison.is_file() else {},
        places=read_npz(places).get("vertices") if places.is_file() else None,
    )


def _row_value(rows: Sequence[Mapping[str, Any]], row: int, name: str) -> float:
    value = rows[row].get(name) if row < len(rows) else None
    return math.nan if value is None else float(value)


def _array(saved: Mapping[str, NDArray[Any]], name: str, path: Path) -> NDArray[Any]:
    if name not in saved:
        raise InputError(f"{path}: no array {name!r}")
    return saved[name]
