"""The register stage collects poses: doubts in their rows, error bars beside the meshes, and who else hears of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from capture_eval.errors import RegistrationError
from capture_eval.files.atomic import read_json, read_npz, write_json, write_npz
from capture_eval.registration.reliability import PoseEvidence, ReliabilityOptions
from capture_eval.stages.check import pose_doubts
from capture_eval.stages.register import collect_registration
from capture_eval.stages.register_options import RegisterOptions
from capture_eval.stages.reliability import believed, troubled_poses
from capture_eval.stages.report_inputs import read_poses

NAMES = [f"pose_{index:02d}" for index in range(5)]
TIMES = [0.0, 0.25, 0.5, 0.75, 1.0]
VERTICES = 120


def _write_poses(out: Path, stated: list[float], photos: list[int]) -> Path:
    """Poses that moved as `stated` says, the fourth refused by the refinement; returns the work folder."""
    work = out / "work"
    generator = np.random.default_rng(0)
    rest, way = generator.normal(size=(2, VERTICES, 3))
    write_npz(work / "register" / "neutral.npz", {"vertices": rest})
    tracked = [{"pose": name, "status": "ok", "reason": ""} for name in NAMES]
    write_json(work / "register" / "tracking.json", {"poses": tracked})
    for index, name in enumerate(NAMES):
        write_json(work / name / "sparse.json", {"status": "ok", "photos": 24, "registered": photos[index]})
        if index == 3:
            write_json(work / name / "registered.json", {"status": "failed", "reason": "not to be believed"})
            continue
        seen = np.arange(VERTICES) < 110
        arrays = {
            "vertices": rest + stated[index] * way,
            "residual": np.zeros(VERTICES),
            "confidence": np.where(seen, 0.9, 0.0),
            "seen": seen,
            "spread": np.full(VERTICES, 0.01),
        }
        write_npz(work / name / "registered.npz", arrays)
        write_json(work / name / "registered.json", {"status": "ok", "reason": ""})
    return work


def test_a_good_capture_has_no_doubts_and_bars_where_skin_is_seen(tmp_path: Path) -> None:
    work = _write_poses(tmp_path, TIMES, [24] * 5)
    rows = collect_registration(work, NAMES, TIMES, RegisterOptions())["poses"]
    assert [row["doubts"] for row in rows] == [[], [], [], [], []]
    saved = read_npz(work / "register" / "registered.npz")
    assert saved["pose_reliable"].tolist() == saved["pose_ok"].tolist() == [True, True, True, False, True]
    known = np.isfinite(saved["error_bar"])
    assert known[[0, 1, 2, 4], :110].all()
    assert not known[:, 110:].any()
    assert not known[3].any()
    assert np.all(saved["motion_bar"][0, :110] == 0.0)
    assert np.all(saved["motion_bar"][1, :110] > 0.0)
    assert np.all(saved["error_bar"][1, :110] > saved["motion_bar"][1, :110])


def test_without_photo_halves_there_are_no_bars(tmp_path: Path) -> None:
    work = _write_poses(tmp_path, TIMES, [24] * 5)
    for name in NAMES[:3] + NAMES[4:]:
        saved = read_npz(work / name / "registered.npz")
        write_npz(work / name / "registered.npz", saved | {"spread": np.full(VERTICES, np.nan)})
    collect_registration(work, NAMES, TIMES, RegisterOptions())
    assert "error_bar" not in read_npz(work / "register" / "registered.npz")


def test_exchanged_poses_and_missing_photos_are_told_to_everybody(tmp_path: Path) -> None:
    work = _write_poses(tmp_path, [0.0, 0.5, 0.25, 0.75, 1.0], [24, 24, 24, 24, 12])
    rows = collect_registration(work, NAMES, TIMES, RegisterOptions())["poses"]
    assert "exchanged with pose_02" in rows[1]["doubts"][0]
    assert "exchanged with pose_01" in rows[2]["doubts"][0]
    assert rows[4]["doubts"] == ["12 photos placed, 24 in the other poses"]
    assert read_json(work / "register" / "registered.json")["poses"] == rows
    saved = read_npz(work / "register" / "registered.npz")
    assert saved["pose_reliable"].tolist() == [True, False, False, False, False]
    assert saved["pose_ok"].tolist() == [True, True, True, False, True]
    assert set(pose_doubts(tmp_path)) == {"pose_01", "pose_02", "pose_04"}
    told = troubled_poses(tmp_path)
    assert told[2] == "pose_03 has no result: not to be believed"
    assert [line.split(" ")[0] for line in told] == ["pose_01", "pose_02", "pose_03", "pose_04"]
    entries = [{"name": name, "t": t} for name, t in zip(NAMES, TIMES, strict=True)]
    states = [pose.state for pose in read_poses(tmp_path, entries, np.array(TIMES), None)]
    assert states[0] == "ok"
    assert states[1].startswith("doubtful: looks exchanged")
    assert states[3] == "failed: register: not to be believed"


def test_a_pose_whose_skin_was_not_measured_is_refused_by_name() -> None:
    believed("pose_01", PoseEvidence(0.7, 0.9), ReliabilityOptions())
    with pytest.raises(RegistrationError, match="pose_01 is not to be believed: 5% of the measured skin"):
        believed("pose_01", PoseEvidence(0.7, 0.05), ReliabilityOptions())
