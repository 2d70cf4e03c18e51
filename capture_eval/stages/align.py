"""All poses of a capture in one frame and one scale: reads the solved poses, writes work/align."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from capture_eval.cameras import View, project
from capture_eval.errors import InputError, RegistrationError
from capture_eval.files.atomic import read_json, read_npz, write_json, write_npz
from capture_eval.files.colmap_files import read_features, read_sparse_model
from capture_eval.registration.cross_pose_matching import ObservedPoints
from capture_eval.registration.marker_alignment import align_by_markers
from capture_eval.registration.nonrigid_icp import WORKING_SIZE
from capture_eval.registration.pose_alignment import AlignedPose, AlignmentOptions, align_all_poses
from capture_eval.registration.rig_alignment import align_by_rig
from capture_eval.similarity import Similarity
from capture_eval.stages.align_inputs import load_markers, load_photographed_points
from capture_eval.stages.registration_inputs import load_template, place_landmarks

logger = logging.getLogger("capture_eval.align")

# The template is another head: points within this share of its size of a rigid vertex count as rigid.
RIGID_REACH = 0.05
LEAST_RIGID_POINTS = 100


@dataclass(frozen=True)
class AlignOptions:
    """Options of the align stage.

    Attributes
    ----------
    limits : AlignmentOptions
    method : str
        `auto` takes the surest that the other options allow: a shared frame, markers, a fixed rig, matches.
        `markers`, `rig` and `matches` ask for one of them.
    shared_frame : bool
        The poses' cameras are already in one frame (known cameras): every similarity is the identity.
    markers : Path or None
        Marker file.
    fixed_rig : bool
        The cameras stay where they are: photos of one name are taken by one camera in every pose. The frame is
        then the rig's; a head that moves in it is put back by the register stage, from the skin at rest.
    rigid_region : tuple of int or None
        Template vertices that do not move (skull). Needs `template` and `landmarks`; only points near them are
        used then. Without it the rigid majority of all points decides.
    template, landmarks : Path or None
    """

    limits: AlignmentOptions = field(default_factory=AlignmentOptions)
    method: Literal["auto", "matches", "markers", "rig"] = "auto"
    shared_frame: bool = False
    markers: Path | None = None
    fixed_rig: bool = False
    rigid_region: tuple[int, ...] | None = None
    template: Path | None = None
    landmarks: Path | None = None


def pose_status(work: Path, pose_name: str, stage: str) -> str:
    """Status that a stage left for a pose: `ok`, `failed`, `skipped`, or `missing` when it never ran."""
    path = work / pose_name / f"{stage}.json"
    if not path.is_file():
        return "missing"
    return str(read_json(path).get("status", "missing"))


def load_observed_points(pose_folder: Path) -> ObservedPoints:
    """Triangulated points of a pose with all descriptors that saw them."""
    model = read_sparse_model(pose_folder / "sparse")
    features = read_features(pose_folder / "database.db")
    descriptors, owners, footprints = [], [], []
    for name, view in model.views.items():
        rows = model.tracks[name]
        seen = rows >= 0
        descriptors.append(features[name].descriptors[seen])
        owners.append(rows[seen])
        if np.any(seen):
            footprints.append(_footprint(view, model.points[rows[seen]]))
    if not owners or len(model.points) == 0:
        raise InputError(f"{pose_folder / 'sparse'}: the model has no points")
    return ObservedPoints(
        points=model.points,
        descriptors=np.concatenate(descriptors),
        point_of_descriptor=np.concatenate(owners),
        footprint=float(np.median(footprints)),
    )


def _footprint(view: View, points: NDArray[np.float64]) -> float:
    _, depth = project(view, points)
    return float(np.median(depth) / view.intrinsics.matrix[0, 0])


def align_poses(work: Path, pose_names: Sequence[str], options: AlignOptions) -> dict[str, Any]:
    """Bring all poses to the frame of the first one and write `align/alignment.npz` and `alignment.json`.

    Returns
    -------
    dict
        The content of alignment.json: a row per pose with status, scale, residual (fraction of the neutral's
        sparse extent, and pixels), matches and inliers.

    Raises
    ------
    RegistrationError
        The neutral has no reconstruction.
    """
    observed: list[ObservedPoints | None] = []
    for name in pose_names:
        usable = pose_status(work, name, "sparse") == "ok"
        observed.append(load_observed_points(work / name) if usable else None)
    neutral = observed[0]
    if neutral is None:
        raise RegistrationError(f"{work / pose_names[0]}: the neutral pose has no reconstruction")
    method = chosen_method(options)
    logger.info("align: %d poses by %s", len(pose_names), method)
    poses = _aligned(method, work, pose_names, observed, options)
    rows = [_row(name, pose, neutral) for name, pose in zip(pose_names, poses, strict=True)]
    for row in rows:
        logger.info("align %s: %s %s", row["pose"], row["status"], row["reason"])
    _save(work / "align" / "alignment.npz", pose_names, poses)
    quality = {"method": method, "extent": neutral.extent, "pixel": neutral.footprint, "poses": rows}
    write_json(work / "align" / "alignment.json", quality)
    return quality


def chosen_method(options: AlignOptions) -> str:
    """What the poses are aligned by: `shared frame`, `markers`, `rig` or `matches`."""
    if options.method == "auto":
        if options.shared_frame:
            return "shared frame"
        if options.markers is not None:
            return "markers"
        return "rig" if options.fixed_rig else "matches"
    if options.method == "markers" and options.markers is None:
        raise InputError("align: method markers needs a marker file (key `markers` of the manifest)")
    return options.method


def _aligned(
    method: str,
    work: Path,
    pose_names: Sequence[str],
    observed: Sequence[ObservedPoints | None],
    options: AlignOptions,
) -> list[AlignedPose]:
    neutral = observed[0]
    identity = AlignedPose(Similarity.identity(), 0.0, 0, 0, "rig", "")
    if method == "matches" or neutral is None:
        return align_all_poses(observed, options.limits, rigid_points(work / pose_names[0], neutral, options))
    if method == "markers" and options.markers is not None:
        usable = [points is not None for points in observed]
        placed = load_markers(work, pose_names, usable, options.markers)
        return align_by_markers(placed, neutral.footprint, options.limits)
    if method == "rig":
        _, views = load_photographed_points(work / pose_names[0])
        results = [identity]
        for name, points in zip(pose_names[1:], observed[1:], strict=True):
            seen = None if points is None else load_photographed_points(work / name)[0]
            results.append(align_by_rig(views, seen, neutral.footprint, options.limits))
        return results
    failed = AlignedPose(None, float("nan"), 0, 0, "", "no reconstruction")
    return [failed if points is None else identity for points in observed]


def rigid_points(neutral: Path, observed: ObservedPoints | None, options: AlignOptions) -> NDArray[np.bool_] | None:
    """Points of the neutral on the rigid region; None where all points take part."""
    if options.rigid_region is None or options.template is None or options.landmarks is None or observed is None:
        return None
    parts = load_template(options.template, None)
    count = len(parts.mesh.vertices)
    if any(not 0 <= vertex < count for vertex in options.rigid_region):
        raise InputError(f"{options.template}: the rigid region names a vertex outside of 0..{count - 1}")
    head_from_neutral, _, _ = place_landmarks(neutral, options.landmarks, parts)
    found = cKDTree(parts.mesh.vertices).query(head_from_neutral.apply(observed.points))
    distance, index = np.asarray(found[0]), np.asarray(found[1])
    still = np.zeros(count, dtype=np.bool_)
    still[list(options.rigid_region)] = True
    rigid = still[index] & (distance < RIGID_REACH * WORKING_SIZE * parts.unit)
    if np.count_nonzero(rigid) < LEAST_RIGID_POINTS:
        logger.info("align: only %d points on the rigid region; all points are used", np.count_nonzero(rigid))
        return None
    return np.asarray(rigid, dtype=np.bool_)


def _row(name: str, pose: AlignedPose, neutral: ObservedPoints) -> dict[str, Any]:
    ok = pose.neutral_from_pose is not None
    return {
        "pose": name,
        "status": "ok" if ok else "failed",
        "reason": pose.reason,
        "scale": pose.neutral_from_pose.scale if pose.neutral_from_pose is not None else None,
        "residual": pose.residual / neutral.extent if ok else None,
        "residual_px": pose.residual / neutral.footprint if ok else None,
        "matches": pose.matches,
        "inliers": pose.inliers,
        "through": pose.through,
    }


def _save(path: Path, pose_names: Sequence[str], poses: Sequence[AlignedPose]) -> None:
    nothing = np.full((3, 3), np.nan)
    links = [pose.neutral_from_pose for pose in poses]
    write_npz(
        path,
        {
            "pose_names": np.array(list(pose_names)),
            "scale": np.array([np.nan if link is None else link.scale for link in links]),
            "rotation": np.array([nothing if link is None else link.rotation for link in links]),
            "translation": np.array([nothing[0] if link is None else link.translation for link in links]),
            "residual": np.array([pose.residual for pose in poses]),
            "ok": np.array([link is not None for link in links]),
        },
    )


def load_alignment(work: Path) -> dict[str, Similarity | None]:
    """`neutral_from_pose` of every pose by name; None for failed poses."""
    saved = read_npz(work / "align" / "alignment.npz")
    result: dict[str, Similarity | None] = {}
    for index, name in enumerate(saved["pose_names"]):
        link = None
        if saved["ok"][index]:
            link = Similarity(float(saved["scale"][index]), saved["rotation"][index], saved["translation"][index])
        result[str(name)] = link
    return result
