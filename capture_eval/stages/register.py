"""All poses of a capture in the template's topology: neutral, tracking, texture rounds, collection."""

from __future__ import annotations

import dataclasses
import logging
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture_eval.errors import CaptureEvalError, InputError, RegistrationError
from capture_eval.files.atomic import read_json, read_npz, write_json, write_npz
from capture_eval.registration.deformation_solver import DeformationSolver
from capture_eval.registration.lifted_matches import (
    MaterialMatches,
)
from capture_eval.registration.mesh_operators import build_mesh_operators
from capture_eval.registration.nonrigid_icp import (
    closest_point_constraints,
    fit_template,
    hidden_stiffness,
)
from capture_eval.registration.photo_visibility import count_seen
from capture_eval.registration.reliability import PoseEvidence, pose_evidence
from capture_eval.registration.surface_correspondence import Surface
from capture_eval.registration.template_visibility import SKIN_SHARE, scan_trust, visible_direction_share
from capture_eval.registration.texture_baking import BakedTexture, bake_texture
from capture_eval.registration.texture_rounds import PhotoSet, RefinedPose, refine_by_texture
from capture_eval.registration.vertex_confidence import VertexQuality, vertex_quality
from capture_eval.stages.align import load_alignment, pose_status
from capture_eval.stages.pose_frame import stabilised, straightened
from capture_eval.stages.pose_tracker import PoseTracker
from capture_eval.stages.register_options import RegisterOptions
from capture_eval.stages.registration_inputs import (
    Template,
    load_photo_set,
    load_scan,
    load_similarities,
    load_template,
    place_landmarks,
    save_similarities,
)
from capture_eval.stages.reliability import believed, pose_doubts
from capture_eval.stages.uncertainty import (
    bar_arrays,
    neutral_landmark_spread,
    photo_half_spread,
    spread_figures,
)

logger = logging.getLogger("capture_eval.register")

POSE_ARRAYS = ("vertices", "residual", "confidence", "seen", "spread", "evidence")

Floats = NDArray[np.float64]


def register_neutral(
    work: Path,
    template: Path,
    landmarks: Path,
    pose_names: Sequence[str],
    options: RegisterOptions,
    occluders: Path | None = None,
) -> dict[str, Any]:
    """Fit the template to the neutral scan and write `register/neutral.npz` and `head_from_pose.npz`.

    Returns
    -------
    dict
        Content of register/neutral.json: landmark residuals, share of matched skin, CPU seconds.

    Raises
    ------
    InputError, RegistrationError
        Landmarks or scan do not lead to a fit; nothing can be evaluated without a neutral.
    """
    started = time.process_time()
    folder = work / "register"
    parts = load_template(template, occluders)
    neutral = pose_names[0]
    _require(work, neutral)
    head_from_neutral, placed, rows = place_landmarks(work / neutral, landmarks, parts)
    alignment = load_alignment(work)
    links = [alignment.get(name) for name in pose_names]
    head_from_pose = [None if link is None else head_from_neutral.compose(link) for link in links]
    save_similarities(folder / "head_from_pose.npz", pose_names, head_from_pose)
    working = parts.working_from_head.compose(head_from_neutral)
    scan = load_scan(work / neutral, working)
    rest = parts.working_from_head.apply(parts.mesh.vertices)
    blockers = _working_occluders(parts)
    share = visible_direction_share(rest, parts.triangles, blockers)
    skin, trust = share > SKIN_SHARE, scan_trust(share)
    logger.info("register neutral: %d of %d vertices are skin", np.count_nonzero(skin), len(skin))
    fit = fit_template(rest, parts.triangles, skin, scan, placed, options.neutral, trust)
    logger.info("register neutral: fitted, texture stereo follows")
    photos = straightened(load_photo_set(work / neutral, working), fit.vertices, parts, options)
    refined, texture, spread = _refine_neutral(parts, fit.vertices, skin, trust, photos, scan, options)
    quality = _quality(parts, refined, photos, scan, skin, options)
    evidence = pose_evidence(None, refined.stereo, quality.seen & skin, is_neutral=True)
    believed(neutral, evidence, options.reliability)
    sliding = neutral_landmark_spread(
        work / neutral, landmarks, parts, working, skin, scan, trust, fit.vertices, options
    )
    write_npz(
        folder / "neutral.npz",
        {"before_rounds": parts.unit * fit.vertices, "skin": skin, "scan_trust": trust}
        | {"landmark_spread": parts.unit * sliding}
        | _saved(parts, refined.vertices, quality, spread, evidence),
    )
    write_npz(folder / "neutral_texture.npz", {"image": texture.image, "weight": texture.weight, "mask": texture.mask})
    report = {
        "status": "ok",
        "landmarks": rows,
        "template_layout": "own" if parts.own_layout else "cylinder",
        "matched_share": float(np.mean(fit.matched[skin])),
        "skin_vertices": int(np.count_nonzero(skin)),
        "seen_vertices": int(np.count_nonzero(quality.seen)),
        "landmark_spread": spread_figures(sliding, quality.seen & skin),
        "cpu_seconds": round(time.process_time() - started, 3),
    }
    write_json(folder / "neutral.json", report)
    return report


def _require(work: Path, neutral: str) -> None:
    for stage in ("sparse", "surface"):
        status = pose_status(work, neutral, stage)
        if status not in ("ok", "missing") or (status == "missing" and stage == "sparse"):
            raise RegistrationError(
                f"{neutral}: stage {stage} of the neutral pose is {status}; nothing can be registered"
            )


def _working_occluders(parts: Template) -> tuple[Floats, NDArray[np.int64]] | None:
    if parts.occluders is None:
        return None
    return parts.working_from_head.apply(parts.occluders[0]), parts.occluders[1]


def _refine_neutral(
    parts: Template,
    fitted: Floats,
    skin: NDArray[np.bool_],
    trust: Floats,
    photos: PhotoSet,
    scan: Surface,
    options: RegisterOptions,
) -> tuple[RefinedPose, BakedTexture, Floats]:
    solver = DeformationSolver(build_mesh_operators(fitted, parts.triangles), hidden_stiffness(skin), trust)
    atlases = parts.atlases(options.flow_texels, options.stereo_texels)
    refined = refine_by_texture(solver, fitted, skin, photos, atlases, None, scan, None, options.neutral_rounds)
    texture = bake_texture(refined.vertices, parts.triangles, atlases.flow, photos.views, photos.images)
    spread = photo_half_spread(
        solver, refined.vertices, skin, photos, atlases, None, scan, None, options.neutral_rounds, options.uncertainty
    )
    return refined, texture, spread


def _quality(
    parts: Template,
    refined: RefinedPose,
    photos: PhotoSet,
    scan: Surface,
    skin: NDArray[np.bool_],
    options: RegisterOptions,
) -> VertexQuality:
    planes, _ = closest_point_constraints(refined.vertices, parts.triangles, skin, scan, 6.0, 0.5)
    return vertex_quality(
        refined.vertices,
        parts.triangles,
        refined.flow,
        refined.stereo,
        planes,
        count_seen(refined.vertices, parts.triangles, photos.views),
        skin,
        options.confidence,
    )


def _pose_solver(parts: Template, neutral: dict[str, NDArray[Any]]) -> DeformationSolver:
    """Solver whose rest shape is the registered neutral, working frame."""
    operators = build_mesh_operators(neutral["vertices"] / parts.unit, parts.triangles)
    return DeformationSolver(operators, hidden_stiffness(neutral["skin"]), neutral.get("scan_trust"))


def _saved(
    parts: Template, vertices: Floats, quality: VertexQuality, spread: Floats, evidence: PoseEvidence
) -> dict[str, NDArray[Any]]:
    """Arrays of one registered pose in the head frame."""
    return {
        "vertices": parts.unit * vertices,
        "residual": parts.unit * quality.residual,
        "confidence": quality.confidence,
        "seen": quality.seen,
        "spread": parts.unit * spread,
        "evidence": evidence.array,
    }


def track_poses(
    work: Path,
    template: Path,
    pose_names: Sequence[str],
    options: RegisterOptions,
    occluders: Path | None = None,
) -> dict[str, Any]:
    """Deform the neutral to every other pose in turn and write `register/start.npz`.

    A pose without scan or alignment, or whose matches do not fit, is a row of NaN with a reason; the next pose
    starts from the last good one.
    """
    parts = load_template(template, occluders)
    folder = work / "register"
    neutral = read_npz(folder / "neutral.npz")
    links = load_similarities(folder / "head_from_pose.npz")
    rest, skin = neutral["vertices"] / parts.unit, neutral["skin"]
    solver = _pose_solver(parts, neutral)
    first = links[pose_names[0]]
    if first is None:
        raise RegistrationError(f"{pose_names[0]}: the neutral pose is not aligned")
    tracker = PoseTracker(parts, skin, solver, options)
    tracker.start(work / pose_names[0], first, rest)
    vertices = np.full((len(pose_names), *rest.shape), np.nan)
    vertices[0] = parts.unit * rest
    rows: list[dict[str, Any]] = [{"pose": pose_names[0], "status": "ok", "reason": ""}]
    for index, name in enumerate(pose_names[1:], start=1):
        try:
            row, tracked = tracker.advance(work / name, links.get(name))
        except CaptureEvalError as error:
            row, tracked = {"status": "failed", "reason": str(error)}, None
        rows.append({"pose": name} | row)
        logger.info("track %s: %s %s", name, row["status"], row["reason"])
        if tracked is not None:
            vertices[index] = parts.unit * tracked
    ok = np.array([row["status"] == "ok" for row in rows])
    write_npz(folder / "start.npz", {"pose_names": np.array(list(pose_names)), "vertices": vertices, "ok": ok})
    quality = {"poses": rows}
    write_json(folder / "tracking.json", quality)
    return quality


def refine_pose(
    work: Path,
    template: Path,
    pose_name: str,
    options: RegisterOptions,
    occluders: Path | None = None,
) -> dict[str, Any]:
    """Texture rounds of one pose; writes `registered.npz` and `registered.json` into its folder.

    A pose that was not tracked gets status `skipped`.
    """
    started = time.process_time()
    folder = work / "register"
    start = read_npz(folder / "start.npz")
    names = [str(name) for name in start["pose_names"]]
    if pose_name not in names:
        raise InputError(f"{folder / 'start.npz'}: no pose {pose_name}")
    index = names.index(pose_name)
    if not start["ok"][index]:
        return _without_result(work / pose_name, "skipped", "not tracked")
    neutral = read_npz(folder / "neutral.npz")
    if index == 0:
        arrays = {key: neutral[key] for key in POSE_ARRAYS}
    else:
        parts = load_template(template, occluders)
        try:
            arrays = _refined_arrays(work, parts, pose_name, neutral, start["vertices"][index], options)
        except CaptureEvalError as error:
            return _without_result(work / pose_name, "failed", str(error))
    write_npz(work / pose_name / "registered.npz", arrays)
    row: dict[str, Any] = {
        "status": "ok",
        "reason": "",
        "confident_share_of_seen": float(np.mean(arrays["confidence"][arrays["seen"]] > 0.5)),
        "evidence": dataclasses.asdict(PoseEvidence.from_array(arrays["evidence"])),
        "cpu_seconds": round(time.process_time() - started, 3),
    }
    write_json(work / pose_name / "registered.json", row)
    logger.info("refine %s: ok", pose_name)
    return row


def _without_result(pose_folder: Path, status: str, reason: str) -> dict[str, Any]:
    """The row of a pose that has no registered mesh; an older one must not be believed."""
    (pose_folder / "registered.npz").unlink(missing_ok=True)
    row: dict[str, Any] = {"status": status, "reason": reason}
    write_json(pose_folder / "registered.json", row)
    logger.info("refine %s: %s (%s)", pose_folder.name, status, reason)
    return row


def _refined_arrays(
    work: Path,
    parts: Template,
    pose_name: str,
    neutral: dict[str, NDArray[Any]],
    start: Floats,
    options: RegisterOptions,
) -> dict[str, NDArray[Any]]:
    folder = work / "register"
    link = load_similarities(folder / "head_from_pose.npz")[pose_name]
    if link is None:
        raise RegistrationError(f"{pose_name}: tracked but not aligned; run the align stage again")
    working = parts.working_from_head.compose(link)
    skin = neutral["skin"]
    rest = neutral["vertices"] / parts.unit
    solver = _pose_solver(parts, neutral)
    saved = read_npz(folder / "neutral_texture.npz")
    texture = BakedTexture(saved["image"], saved["weight"], saved["mask"])
    raw = read_npz(work / pose_name / "matches.npz")
    matches = MaterialMatches(raw["triangle"], raw["barycentric"], raw["target"] / parts.unit, raw["weight"])
    photos = straightened(load_photo_set(work / pose_name, working), start / parts.unit, parts, options)
    scan = load_scan(work / pose_name, working)
    atlases = parts.atlases(options.flow_texels, options.stereo_texels)
    measured = (photos, atlases, texture, scan, matches, options.pose_rounds)
    refined = refine_by_texture(solver, start / parts.unit, skin, *measured)
    quality = _quality(parts, refined, photos, scan, skin, options)
    evidence = pose_evidence(refined.flow, refined.stereo, quality.seen & skin, is_neutral=False)
    believed(pose_name, evidence, options.reliability)
    confidence = np.minimum(quality.confidence, neutral["confidence"])

    def settle(vertices: Floats) -> Floats:
        return stabilised(vertices, rest, confidence, options)

    spread = photo_half_spread(solver, refined.vertices, skin, *measured, options.uncertainty, settle)
    return _saved(parts, settle(refined.vertices), quality, spread, evidence)


def collect_registration(
    work: Path, pose_names: Sequence[str], t: Sequence[float], options: RegisterOptions
) -> dict[str, Any]:
    """Gather all poses in `register/registered.npz`; poses without a result are rows of NaN.

    A pose that is kept, though something is wrong with it, has its doubts in its row and `pose_reliable` False.
    """
    if len(t) != len(pose_names):
        raise InputError(f"registration: {len(pose_names)} poses but {len(t)} times")
    count = len(read_npz(work / "register" / "neutral.npz")["vertices"])
    shape = (len(pose_names), count)
    arrays = {
        "vertices": np.full((*shape, 3), np.nan),
        "residual": np.full(shape, np.nan),
        "confidence": np.zeros(shape),
        "seen": np.zeros(shape, dtype=np.bool_),
        "spread": np.full(shape, np.nan),
    }
    rows: list[dict[str, Any]] = []
    for index, name in enumerate(pose_names):
        report = work / name / "registered.json"
        row = {"status": "missing", "reason": "never refined"} if not report.is_file() else read_json(report)
        rows.append({"pose": name, "status": row["status"], "reason": row.get("reason", "")})
        if row["status"] == "ok":
            saved = read_npz(work / name / "registered.npz")
            for key, values in arrays.items():
                values[index] = saved[key]
    ok = np.array([row["status"] == "ok" for row in rows])
    doubts = pose_doubts(work, pose_names, arrays["vertices"], arrays["confidence"], arrays["seen"], ok, options)
    for row, found in zip(rows, doubts, strict=True):
        row["doubts"] = found
    bars = bar_arrays(arrays["vertices"], arrays["spread"], arrays["confidence"], arrays["seen"], options.uncertainty)
    named = {
        "t": np.asarray(t, dtype=np.float64),
        "pose_ok": ok,
        "pose_reliable": ok & np.array([not found for found in doubts]),
        "pose_names": np.array(list(pose_names)),
    }
    write_npz(work / "register" / "registered.npz", arrays | bars | named)
    quality = {"poses": rows, "registered": int(np.count_nonzero(ok))}
    write_json(work / "register" / "registered.json", quality)
    return quality
