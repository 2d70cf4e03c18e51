"""How far the registration of a synthetic capture is from its known truth, and where its skin points truly are."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture_eval.curves.edge_loops import edge_topology
from capture_eval.curves.extract import resolve_curves
from capture_eval.errors import InputError
from capture_eval.evaluation.tracking_error import (
    SkinPoints,
    TrackingError,
    refine_similarity_by_surface,
    skin_points,
    tracking_error,
)
from capture_eval.files.atomic import read_npz, write_json, write_npz
from capture_eval.files.camera_files import read_cameras
from capture_eval.files.colmap_files import read_sparse_model
from capture_eval.files.curve_files import read_curves
from capture_eval.files.mesh_files import read_mesh
from capture_eval.polygon_mesh import PolygonMesh
from capture_eval.similarity import Similarity, estimate_similarity
from capture_eval.stages.bar_truth import BarInside
from capture_eval.stages.registration_inputs import load_similarities
from capture_eval.triangle_geometry import diameter

logger = logging.getLogger("capture_eval.truth")

Floats = NDArray[np.float64]
Booleans = NDArray[np.bool_]


@dataclass(frozen=True)
class TruthOptions:
    """Options of the comparison.

    Attributes
    ----------
    rings : int
        Edges around a vertex within which its skin point is looked for, when template and truth share a topology.
    confidence : float
        Vertices above it in every pose are the confident ones.
    region_reach : float
        Vertices nearer to a curve than this fraction of D belong to the curve's region.
    """

    rings: int = 4
    confidence: float = 0.5
    region_reach: float = 0.03


@dataclass(frozen=True)
class TruthFiles:
    """Files of the truth: mesh of the neutral, npz with `t` and `vertices`, cameras.json (or None)."""

    mesh: Path
    vertices: Path
    cameras: Path | None = None


def measure_tracking(
    work: Path,
    template: Path,
    truth: TruthFiles,
    report: Path,
    options: TruthOptions,
    curves: Path | None = None,
) -> dict[str, Any]:
    """Tracking and surface error of every pose; writes `register/tracked_truth.npz` and `report/truth.json`.

    The truth is brought to the head frame by a seven-parameter ICP of the neutral alone. All errors are fractions
    of D of the true neutral.

    Parameters
    ----------
    curves : Path, optional
        Curves file; its regions give the errors per region.

    Raises
    ------
    InputError
        Files are missing, or the truth has no pose of a registered time.
    """
    saved = read_npz(work / "register" / "registered.npz")
    mesh, true_mesh = read_mesh(template), read_mesh(truth.mesh)
    triangles, true_triangles = mesh.triangles()[0], true_mesh.triangles()[0]
    true_vertices = _true_poses(truth.vertices, saved["t"], len(true_mesh.vertices))
    registered, ok = saved["vertices"], saved["pose_ok"].astype(bool)
    seen = np.all(saved["seen"][ok], axis=0)
    confident = seen & np.all(saved["confidence"][ok] > options.confidence, axis=0)
    anchors = np.arange(len(mesh.vertices)) if _same_faces(mesh, true_mesh) else None
    start = _start(work, truth, registered[0], true_vertices[0], seen, anchors is not None)
    truth_from_head = refine_similarity_by_surface(
        registered[0], triangles, true_vertices[0], true_triangles, seen, start
    )
    neutral = truth_from_head.apply(registered[0])
    points = skin_points(neutral, triangles, true_vertices[0], true_triangles, anchors, options.rings)
    size = diameter(true_vertices[0])
    masks = {"seen": seen, "confident": confident} | _regions(curves, mesh, neutral, seen, options.region_reach * size)
    rows, inside = [], BarInside(saved, truth_from_head.scale, size, {"confident": confident, "seen": seen})
    for index, time in enumerate(saved["t"]):
        row: dict[str, Any] = {"pose": str(saved["pose_names"][index]), "t": float(time), "status": "failed"}
        if ok[index]:
            moved = truth_from_head.apply(registered[index])
            error = tracking_error(moved, neutral, points, true_vertices[index], true_vertices[0], true_triangles)
            row |= {"status": "ok"} | _figures(error, seen, size)
            inside.add(index, error, row)
            row["regions"] = {name: _figures(error, mask, size) for name, mask in masks.items() if mask.any()}
            logger.info("truth %s: tracking median %.3f %% of D", row["pose"], 100 * row["median"])
        rows.append(row)
    write_npz(work / "register" / "tracking_error.npz", inside.errors)
    _save_tracked(work, points, true_vertices, true_triangles, truth_from_head)
    result = {
        "schema": "capture_eval.truth/1",
        "unit": "fraction of D",
        "D": size,
        "truth_from_head_scale": truth_from_head.scale,
        "same_topology": anchors is not None,
        "seen_vertices": int(np.count_nonzero(seen)),
        "confident_share_of_seen": float(np.mean(confident[seen])) if seen.any() else 0.0,
        "error_bars": inside.overall(),
        "tracking": rows,
    }
    write_json(report / "truth.json", result)
    return result


def _true_poses(path: Path, times: Floats, vertex_count: int) -> Floats:
    saved = read_npz(path)
    if "t" not in saved or "vertices" not in saved:
        raise InputError(f"{path}: needs arrays 't' and 'vertices'")
    if saved["vertices"].ndim != 3 or saved["vertices"].shape[1:] != (vertex_count, 3):
        raise InputError(f"{path}: vertices {saved['vertices'].shape}, expected (poses, {vertex_count}, 3)")
    rows = []
    for time in times:
        distance = np.abs(saved["t"] - time)
        if distance.min() > 1e-6:
            raise InputError(f"{path}: no true pose at t = {time:g}")
        rows.append(int(np.argmin(distance)))
    return np.asarray(saved["vertices"][rows], dtype=np.float64)


def _same_faces(first: PolygonMesh, second: PolygonMesh) -> bool:
    return (
        len(first.vertices) == len(second.vertices)
        and np.array_equal(first.face_offsets, second.face_offsets)
        and np.array_equal(first.face_vertices, second.face_vertices)
    )


def _start(
    work: Path, truth: TruthFiles, neutral: Floats, true_neutral: Floats, seen: Booleans, same_topology: bool
) -> Similarity:
    """First guess of `truth_from_head`: from camera centres, or from equal vertex numbers."""
    if truth.cameras is not None:
        links = load_similarities(work / "register" / "head_from_pose.npz")
        name, link = next(iter(links.items()))
        views = read_sparse_model(work / name / "sparse").views
        known = {view.name: view for view in read_cameras(truth.cameras).get(name, [])}
        common = sorted(set(views) & set(known))
        if link is not None and len(common) >= 4:
            solved = link.apply(np.array([views[photo].center for photo in common]))
            return estimate_similarity(solved, np.array([known[photo].center for photo in common]))
    if same_topology:
        return estimate_similarity(neutral[seen], true_neutral[seen])
    raise InputError(f"{truth.mesh}: other topology than the template; true cameras are needed to place it")


def _regions(
    curves: Path | None, mesh: PolygonMesh, neutral: Floats, seen: Booleans, reach: float
) -> dict[str, Booleans]:
    """Seen vertices by the region of the nearest curve; curves without a region give none."""
    if curves is None:
        return {}
    owners: list[str] = []
    vertices: list[int] = []
    for curve in resolve_curves(read_curves(curves), edge_topology(mesh)):
        region = curve.extra.get("region")
        if region is not None:
            owners.extend([str(region)] * len(curve.vertices))
            vertices.extend(int(vertex) for vertex in curve.vertices)
    if not vertices:
        return {}
    return _nearest_region(neutral, seen, owners, vertices, reach)


def _nearest_region(
    neutral: Floats, seen: Booleans, owners: Sequence[str], vertices: Sequence[int], reach: float
) -> dict[str, Booleans]:
    from scipy.spatial import cKDTree

    found = cKDTree(neutral[np.array(vertices)]).query(neutral)
    distance, index = np.asarray(found[0]), np.asarray(found[1])
    names = np.array(owners)[index]
    return {name: seen & (names == name) & (distance < reach) for name in sorted(set(owners))}


def _figures(error: TrackingError, mask: Booleans, size: float) -> dict[str, Any]:
    if not mask.any():
        return {}

    def quantiles(values: Floats) -> tuple[float, float]:
        return float(np.median(values[mask]) / size), float(np.quantile(values[mask], 0.95) / size)

    figures: dict[str, Any] = {"vertices": int(np.count_nonzero(mask))}
    figures["median"], figures["p95"] = quantiles(error.total)
    figures["p90"] = float(np.quantile(error.total[mask], 0.9) / size)
    figures["max"] = float(error.total[mask].max() / size)
    for name, values in (
        ("surface", error.surface),
        ("tangential", error.tangential),
        ("normal", np.abs(error.normal)),
        ("relative", error.relative),
    ):
        figures[f"{name}_median"], figures[f"{name}_p95"] = quantiles(values)
    figures["normal_bias"] = float(np.median(error.normal[mask]) / size)
    return figures


def _save_tracked(
    work: Path, points: SkinPoints, true_vertices: Floats, triangles: NDArray[np.int64], truth_from_head: Similarity
) -> None:
    """Where the registered vertices' skin points truly are, in the head frame."""
    head_from_truth = truth_from_head.inverse()
    tracked = np.stack([head_from_truth.apply(points.places(pose, triangles)) for pose in true_vertices])
    write_npz(
        work / "register" / "tracked_truth.npz",
        {"vertices": tracked, "triangle": points.triangle, "barycentric": points.barycentric},
    )
