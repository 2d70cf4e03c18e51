"""Registered meshes to errors: curves, predictions, errors.csv, summary.json and tables."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from capture_eval.curves.edge_loops import edge_topology
from capture_eval.curves.extract import Curve, CurveSet, extract_curves, resolve_curves
from capture_eval.errors import InputError, SolverError
from capture_eval.evaluation.error_propagation import curve_bar_coverage, curve_bars
from capture_eval.evaluation.error_table import Evaluation, check_pose_times, evaluate_curves
from capture_eval.evaluation.fit_report import fit_report, training_poses
from capture_eval.evaluation.summary import summarise
from capture_eval.evaluation.truth_comparison import compare_with_truth
from capture_eval.files.atomic import read_json, read_npz, write_json, write_npz, write_text
from capture_eval.files.curve_files import read_curves
from capture_eval.files.mesh_files import read_mesh
from capture_eval.interpolation.method import InterpolationMethod
from capture_eval.interpolation.methods import create_methods
from capture_eval.polygon_mesh import PolygonMesh
from capture_eval.report.tables import error_bars_csv, errors_csv
from capture_eval.stages.evaluation_files import save_curves, save_tables
from capture_eval.triangle_geometry import diameter

logger = logging.getLogger("capture_eval.evaluate")

Floats = NDArray[np.float64]
Booleans = NDArray[np.bool_]
MethodEntries = Sequence[tuple[str, Mapping[str, object]]]


@dataclass(frozen=True)
class EvaluateOptions:
    """Options of the evaluation.

    Attributes
    ----------
    evaluation_vertices : {"confident", "seen", "all"}
        Vertices that count in the errors of a capture: whose confidence reaches the threshold in every registered
        pose, which enough photos see in every registered pose, or all. Meshes given as such always count in full.
    confidence_threshold : float
        In [0, 1].
    fit : {"none", "shared", "per_curve"}
        Fit the PDE's parameters to every second in-between pose and judge them on the others: one set for all curves,
        also one for every curve (seconds), or not at all.
    """

    evaluation_vertices: Literal["confident", "seen", "all"] = "confident"
    confidence_threshold: float = 0.5
    fit: Literal["none", "shared", "per_curve"] = "shared"


@dataclass(frozen=True)
class _Poses:
    """Registered poses: times, positions (NaN where a pose failed), and what is known of every vertex."""

    t: Floats
    vertices: Floats
    ok: Booleans
    confidence: Floats | None = None
    seen: Booleans | None = None
    error_bar: Floats | None = None
    motion_bar: Floats | None = None
    reliable: Booleans | None = None

    def taking_over(self, vertices: Floats) -> _Poses:
        """The same poses with other positions, of which those of failed poses become NaN in place: no copy is made."""
        vertices[~self.ok] = np.nan
        return replace(self, vertices=vertices)

    def without_vertices(self) -> _Poses:
        """What is known of the poses besides their positions, which may fill gigabytes."""
        return replace(self, vertices=np.empty((len(self.t), 0, 3)))


def evaluate_capture(
    work: Path, template: Path, curves: Path, methods: MethodEntries, report: Path, options: EvaluateOptions
) -> dict[str, Any]:
    """Evaluate all methods on the registered meshes of a capture.

    Parameters
    ----------
    work : Path
        Work folder with ``register/registered.npz``.
    template : Path
        Mesh with the topology of the registered vertices.
    curves : Path
        Curves file.
    methods : sequence of (identifier, options)
        As in the manifest.
    report : Path
        Folder for ``errors.csv``, ``summary.json``, ``registered.npz``, ``curves.npz`` and the tables.
    options : EvaluateOptions
        Which vertices count.

    Returns
    -------
    dict
        The summary, as saved.

    Raises
    ------
    InputError
        Files that are missing or do not fit one another, or no usable neutral pose.
    """
    poses = _read_registered(Path(work) / "register" / "registered.npz")
    mesh = _template_of(template, poses)
    found = _resolve(curves, mesh)
    counted = _counted_vertices(poses, options)
    created = create_methods(methods)
    extracted, size = _extract_and_save(poses, mesh, found, counted, Path(report))
    poses = poses.without_vertices()
    photos = _count_photos(Path(work))
    return _evaluate_and_save(
        poses, extracted, size, created, counted, options.evaluation_vertices, Path(report), options.fit, photos
    )


def evaluate_meshes(
    meshes: Sequence[Path],
    t: Sequence[float],
    curves: Path,
    methods: MethodEntries,
    report: Path,
    options: EvaluateOptions | None = None,
) -> dict[str, Any]:
    """Evaluate all methods on meshes that already share one topology; all vertices count.

    Parameters
    ----------
    meshes : sequence of Path
        One OBJ or PLY per pose, in the order of the times.
    t : sequence of float
        Times, rising from 0 to 1.
    curves, methods, report
        See `evaluate_capture`.
    options : EvaluateOptions, optional
        Of these only ``fit`` matters.

    Raises
    ------
    InputError
        Meshes with other numbers of vertices or other faces than the first; the text names the file.
    """
    check_pose_times(t, len(meshes))
    neutral = read_mesh(meshes[0])
    positions = np.empty((len(meshes), *neutral.vertices.shape))
    positions[0] = neutral.vertices
    for number, path in enumerate(meshes[1:], start=1):
        mesh = read_mesh(path)
        if len(mesh.vertices) != len(neutral.vertices):
            raise InputError(f"{path}: {len(mesh.vertices)} vertices, but {meshes[0]} has {len(neutral.vertices)}")
        if not (
            np.array_equal(mesh.face_offsets, neutral.face_offsets)
            and np.array_equal(mesh.face_vertices, neutral.face_vertices)
        ):
            raise InputError(f"{path}: its faces differ from those of {meshes[0]}; all poses need one topology")
        positions[number] = mesh.vertices
    poses = _Poses(np.asarray(t, dtype=np.float64), positions, np.ones(len(meshes), dtype=bool))
    counted = np.ones(len(neutral.vertices), dtype=bool)
    created = create_methods(methods)
    extracted, size = _extract_and_save(poses, neutral, _resolve(curves, neutral), counted, Path(report))
    del positions
    poses = poses.without_vertices()
    fit = (options or EvaluateOptions()).fit
    return _evaluate_and_save(poses, extracted, size, created, counted, "all", Path(report), fit)


def evaluate_truth(
    work: Path, template: Path, curves: Path, methods: MethodEntries, report: Path, options: EvaluateOptions
) -> dict[str, Any]:
    """Evaluate the true positions of the registered points in the same way, and compare the two outcomes.

    Parameters
    ----------
    work : Path
        Work folder with ``register/registered.npz`` and ``register/tracked_truth.npz`` (vertices (P, V, 3): where
        the points of skin that the neutral registration found truly are in every pose).
    template, curves, methods, options
        As for `evaluate_capture`; the same points count.
    report : Path
        Folder for ``errors_truth.csv`` and ``truth_comparison.json``.

    Returns
    -------
    dict
        The comparison, as saved.

    Raises
    ------
    InputError
        Files that are missing or do not fit one another.
    """
    poses = _read_registered(Path(work) / "register" / "registered.npz")
    found = _resolve(curves, _template_of(template, poses))
    counted = _counted_vertices(poses, options)
    created = create_methods(methods)
    extracted, size = _extract(poses, found)
    from_photos = evaluate_curves(extracted, poses.t, created, size, counted)
    shape, poses = poses.vertices.shape, poses.without_vertices()  # before as many true ones are read
    true_curves, true_diameter = _extract(_read_truth(Path(work), poses, shape), found)
    from_truth = evaluate_curves(true_curves, poses.t, created, true_diameter, counted)
    comparison = {
        "schema": "capture_eval.truth_comparison/1",
        "D_truth": true_diameter,
        **compare_with_truth(from_photos.table, from_truth.table),
    }
    if poses.motion_bar is not None:
        bars = curve_bars(poses.motion_bar, extracted, poses.t, from_photos.counted, size)
        comparison["error_bars"] = curve_bar_coverage(bars, from_photos.table, from_truth.table)
    write_text(Path(report) / "errors_truth.csv", errors_csv(from_truth.table.rows()))
    write_json(Path(report) / "truth_comparison.json", comparison)
    return comparison


def _read_truth(work: Path, poses: _Poses, shape: tuple[int, ...]) -> _Poses:
    """The poses with the true positions of their points."""
    path = work / "register" / "tracked_truth.npz"
    truth = read_npz(path).get("vertices")
    if truth is None or truth.shape != shape:
        found = "no array 'vertices'" if truth is None else f"vertices {truth.shape}"
        raise InputError(f"{path}: {found}, expected {shape} as in registered.npz")
    return poses.taking_over(np.asarray(truth, dtype=np.float64))


def _read_registered(path: Path) -> _Poses:
    arrays = read_npz(path)
    missing = [name for name in ("t", "vertices") if name not in arrays]
    if missing:
        raise InputError(f"{path}: no array {', '.join(missing)}")
    t, vertices = np.asarray(arrays["t"], dtype=np.float64), np.asarray(arrays.pop("vertices"), dtype=np.float64)
    if vertices.ndim != 3 or vertices.shape[2] != 3:
        raise InputError(f"{path}: vertices have shape {vertices.shape}, expected (poses, vertices, 3)")
    t = check_pose_times(t, len(vertices))
    finite = [bool(np.isfinite(positions).all()) for positions in vertices]  # pose by pose needs less memory
    ok = np.asarray(arrays.get("pose_ok", np.ones(len(t))), dtype=bool) & finite
    confidence, seen = arrays.get("confidence"), arrays.get("seen")
    bars = {name: arrays.get(name) for name in ("error_bar", "motion_bar")}
    for name, values in (("confidence", confidence), ("seen", seen), *bars.items()):
        if values is not None and values.shape != vertices.shape[:2]:
            raise InputError(f"{path}: {name} has shape {values.shape}, expected {vertices.shape[:2]}")
    if not ok[0]:
        raise InputError(f"{path}: the neutral pose (t = 0) was not registered, so nothing can be evaluated")
    reliable = arrays.get("pose_reliable")
    poses = _Poses(t, vertices, ok, confidence, None if seen is None else seen.astype(bool), **bars, reliable=reliable)
    return poses.taking_over(vertices)


def _template_of(template: Path, poses: _Poses) -> PolygonMesh:
    mesh = read_mesh(template)
    if len(mesh.vertices) != poses.vertices.shape[1]:
        raise InputError(
            f"{template}: {len(mesh.vertices)} vertices, but the registered meshes have {poses.vertices.shape[1]}"
        )
    return mesh


def _resolve(curves: Path, mesh: PolygonMesh) -> tuple[Curve, ...]:
    specifications = read_curves(curves)
    try:
        return resolve_curves(specifications, edge_topology(mesh))
    except InputError as problem:
        raise InputError(f"{curves}: {problem}") from problem


def _counted_vertices(poses: _Poses, options: EvaluateOptions) -> Booleans:
    """Vertices that count: good in every registered pose."""
    if not 0 <= options.confidence_threshold <= 1:
        raise InputError(f"confidence_threshold {options.confidence_threshold} must be in [0, 1]")
    everything = np.ones(poses.vertices.shape[1], dtype=bool)
    if options.evaluation_vertices == "all":
        return everything
    if options.evaluation_vertices == "seen":
        if poses.seen is None:
            raise InputError("registered.npz has no array 'seen'; use evaluation_vertices: all")
        return np.asarray(poses.seen[poses.ok].all(axis=0))
    if options.evaluation_vertices == "confident":
        if poses.confidence is None:
            raise InputError("registered.npz has no array 'confidence'; use evaluation_vertices: all")
        confident = everything
        for pose in np.flatnonzero(poses.ok):
            confident &= np.nan_to_num(poses.confidence[pose]) >= options.confidence_threshold
        return confident
    raise InputError(f"evaluation_vertices is '{options.evaluation_vertices}'; known are confident, seen, all")


def _extract(poses: _Poses, curves: Sequence[Curve]) -> tuple[CurveSet, float]:
    """Copies of the curves' positions, and D."""
    return extract_curves(curves, poses.vertices), diameter(poses.vertices[0])


def _extract_and_save(
    poses: _Poses, mesh: PolygonMesh, curves: Sequence[Curve], counted: Booleans, report: Path
) -> tuple[CurveSet, float]:
    """The curves and D; the poses are saved now, so that their positions need not be kept."""
    found = _extract(poses, curves)
    _save_poses(report / "registered.npz", poses, mesh, counted)
    return found


def _evaluate_and_save(
    poses: _Poses,
    extracted: CurveSet,
    size: float,
    created: Mapping[str, InterpolationMethod],
    counted: Booleans,
    which: str,
    report: Path,
    fit: str,
    photos: Mapping[str, int | None] | None = None,
) -> dict[str, Any]:
    evaluation = evaluate_curves(extracted, poses.t, created, size, counted)
    bars = None
    if poses.motion_bar is not None:
        bars = curve_bars(poses.motion_bar, extracted, poses.t, evaluation.counted, size)
        write_text(report / "error_bars.csv", error_bars_csv(bars.rows()))
    summary = summarise(evaluation, extracted, created, size, poses.ok, which, bars)
    summary["fit"] = _fit(extracted, poses, size, evaluation, fit)
    summary["counts"] |= photos or {"photos": None, "photos_registered": None}
    _log(summary)
    save_curves(report / "curves.npz", poses.t, extracted, evaluation)
    save_tables(report, summary, evaluation.table)
    write_text(report / "errors.csv", errors_csv(evaluation.table.rows()))
    write_json(report / "summary.json", summary)
    return summary


def _fit(curves: CurveSet, poses: _Poses, size: float, evaluation: Evaluation, fit: str) -> dict[str, Any]:
    """What fitted parameters are worth on poses that were held out, or why there is no such thing."""
    if fit not in ("none", "shared", "per_curve"):
        raise InputError(f"fit is '{fit}'; known are none, shared, per_curve")
    if fit == "none":
        return {"rows": [], "reason": "not asked for"}
    try:
        training = training_poses(poses.ok)
        return fit_report(curves, poses.t, size, evaluation.counted, training, fit == "per_curve")
    except (InputError, SolverError) as problem:
        return {"rows": [], "reason": str(problem)}


def _count_photos(work: Path) -> dict[str, int | None]:
    """Photos of all poses and how many the sparse stage placed; None when the poses were not made from photos."""
    found = [read_json(path) for path in sorted(work.glob("*/sparse.json"))]
    if not found:
        return {"photos": None, "photos_registered": None}
    names = {"photos": "photos", "photos_registered": "registered"}
    return {key: sum(int(one.get(name) or 0) for one in found) for key, name in names.items()}


def _log(summary: Mapping[str, Any]) -> None:
    counts = summary["counts"]
    logger.info(
        "%d of %d curves, %d of %d points, %d of %d in-between poses",
        counts["curves_used"],
        counts["curves"],
        counts["points_used"],
        counts["points"],
        counts["in_between"] - counts["in_between_failed"],
        counts["in_between"],
    )
    for name in counts["curves_failed"]:
        logger.warning("curve '%s' has no point that counts in every pose", name)
    for row in summary["methods"].values():
        for line in row["warnings"]:
            logger.warning("%s", line)


def _save_poses(path: Path, poses: _Poses, mesh: PolygonMesh, counted: Booleans) -> None:
    arrays: dict[str, NDArray[Any]] = {
        "t": poses.t,
        "vertices": poses.vertices,
        "face_offsets": mesh.face_offsets,
        "face_vertices": mesh.face_vertices,
        "pose_ok": poses.ok,
        "used_vertices": counted,
    }
    if poses.confidence is not None:
        arrays["confidence"] = poses.confidence
    known = {
        "seen": poses.seen,
        "error_bar": poses.error_bar,
        "motion_bar": poses.motion_bar,
        "pose_reliable": poses.reliable,
    }
    write_npz(path, arrays | {name: values for name, values in known.items() if values is not None})
