"""Tracking from pose to pose: loads a pose, deforms the neutral to it, remembers it for the next one."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture_eval.files.atomic import write_npz
from capture_eval.registration.deformation_solver import DeformationSolver
from capture_eval.registration.lifted_matches import MaterialMatches, lift_matches, merge_agreeing
from capture_eval.registration.pose_tracking import track_pose
from capture_eval.registration.surface_correspondence import Surface
from capture_eval.similarity import Similarity
from capture_eval.stages.align import pose_status
from capture_eval.stages.register_options import RegisterOptions
from capture_eval.stages.registration_inputs import Template, load_pose_photos, load_scan

Floats = NDArray[np.float64]


class PoseTracker:
    """Goes from pose to pose; remembers the neutral's and the last good pose's rays."""

    def __init__(
        self, parts: Template, skin: NDArray[np.bool_], solver: DeformationSolver, options: RegisterOptions
    ) -> None:
        self.parts, self.skin, self.solver, self.options = parts, skin, solver, options

    def start(self, pose_folder: Path, head_from_pose: Similarity, rest: Floats) -> None:
        """Load the neutral; `rest` (V, 3) is its registered mesh in the working frame."""
        working = self.parts.working_from_head.compose(head_from_pose)
        self.neutral_photos = load_pose_photos(pose_folder, working)
        self.neutral_hits = self.neutral_photos.lift(Surface(rest, self.parts.triangles))
        self.previous_photos, self.previous_hits = self.neutral_photos, self.neutral_hits
        self.previous = rest

    def advance(self, pose_folder: Path, head_from_pose: Similarity | None) -> tuple[dict[str, Any], Floats | None]:
        """Track the next pose: its row for the report, and its vertices (V, 3) in the working frame or None."""
        started = time.process_time()
        fault = _pose_fault(pose_folder, head_from_pose)
        if fault or head_from_pose is None:
            return {"status": "failed", "reason": fault}, None
        working = self.parts.working_from_head.compose(head_from_pose)
        scan = load_scan(pose_folder, working)
        photos = load_pose_photos(pose_folder, working)
        hits = photos.lift(scan)
        lifting, rest = self.options.lifting, self.solver.operators.vertices
        triangles = self.parts.triangles
        raw = lift_matches(self.neutral_photos, self.neutral_hits, photos, hits, lifting)
        matches = merge_agreeing(raw, rest, triangles, lifting)
        chained = lift_matches(self.previous_photos, self.previous_hits, photos, hits, lifting)
        chain = merge_agreeing(chained, self.previous, triangles, lifting)
        tracked = track_pose(self.solver, self.skin, self.previous, scan, matches, chain, self.options.tracking)
        row = {
            "status": "ok",
            "reason": "",
            "raw_matches": len(raw.triangle),
            "matches": len(matches.triangle),
            "used_matches": len(tracked.matches.triangle),
            "selected_share": tracked.selected_share,
            "cpu_seconds": round(time.process_time() - started, 3),
        }
        fault = self._match_fault(row)
        if fault:
            return row | {"status": "failed", "reason": fault}, None
        _save_matches(pose_folder / "matches.npz", tracked.matches, self.parts.unit)
        self.previous_photos, self.previous = photos, tracked.vertices
        self.previous_hits = photos.lift(Surface(tracked.vertices, triangles))
        return row, tracked.vertices

    def _match_fault(self, row: dict[str, Any]) -> str:
        if row["used_matches"] < self.options.minimum_matches:
            return f"{row['used_matches']} matches with the neutral fit, {self.options.minimum_matches} are needed"
        if row["selected_share"] < self.options.minimum_match_share:
            return (
                f"only {row['selected_share']:.0%} of the matches with the neutral fit one deformation, "
                f"{self.options.minimum_match_share:.0%} are needed"
            )
        return ""


def _pose_fault(pose_folder: Path, head_from_pose: Similarity | None) -> str:
    for stage in ("sparse", "surface"):
        status = pose_status(pose_folder.parent, pose_folder.name, stage)
        if status not in ("ok", "missing"):
            return f"stage {stage} is {status}"
    if head_from_pose is None:
        return "not aligned to the neutral"
    if not (pose_folder / "scan.ply").is_file():
        return "no scan"
    return ""


def _save_matches(path: Path, matches: MaterialMatches, unit: float) -> None:
    write_npz(
        path,
        {
            "triangle": matches.triangle,
            "barycentric": matches.barycentric,
            "target": unit * matches.target,
            "weight": matches.weight,
        },
    )
