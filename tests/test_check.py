"""The nightly gate: worse than allowed fails, everything that went missing fails, equal never does."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from capture_eval.errors import InputError
from capture_eval.evaluation.baseline import (
    Metric,
    ResultRecord,
    compare_with_baseline,
    record_from_plain,
    record_to_plain,
    with_tolerances_of,
)

RECORD = ResultRecord(
    name="jaw",
    metrics={
        "linear LAE": Metric(0.005, "lower", relative=0.1, absolute=1e-4, unit="D"),
        "share": Metric(0.9, "higher", absolute=0.02),
    },
    poses={"pose_00": True, "pose_01": True, "pose_02": False},
    photos={"pose_00": 16, "pose_01": 15},
    curves=("lip", "lid"),
    methods=("linear",),
    inputs={"template.obj": "a" * 64, "photos/pose_00": "b" * 64},
)


def _bad(result: ResultRecord, baseline: ResultRecord = RECORD) -> list[str]:
    return [finding.what for finding in compare_with_baseline(result, baseline) if finding.bad]


def _with_metric(name: str, value: float | None) -> ResultRecord:
    return replace(RECORD, metrics={**RECORD.metrics, name: replace(RECORD.metrics[name], value=value)})


def test_a_result_is_no_worse_than_itself() -> None:
    assert _bad(RECORD) == []


def test_a_pose_that_became_doubtful_fails_and_one_that_always_was_does_not() -> None:
    doubtful = replace(RECORD, doubts={"pose_01": "12 photos placed, 24 in the other poses"})
    assert _bad(doubtful) == ["pose pose_01"]
    assert _bad(doubtful, doubtful) == []
    assert _bad(RECORD, doubtful) == []
    assert record_from_plain(record_to_plain(doubtful), "baseline").doubts == doubtful.doubts
    older = {key: value for key, value in record_to_plain(RECORD).items() if key != "doubts"}
    assert record_from_plain(older, "baseline").doubts == {}


@pytest.mark.parametrize(
    ("name", "value", "bad"),
    [
        ("linear LAE", 0.0056, False),  # allowed: 0.005 + 0.0001 + 0.1 * 0.005 = 0.0056
        ("linear LAE", 0.0056 + 1e-9, True),
        ("linear LAE", 0.001, False),
        ("linear LAE", None, True),
        ("linear LAE", math.nan, True),
        ("share", 0.88, False),
        ("share", 0.8799, True),
        ("share", 1.0, False),
    ],
)
def test_metrics_may_get_worse_by_their_tolerance_and_no_more(name: str, value: float | None, bad: bool) -> None:
    assert _bad(_with_metric(name, value)) == ([name] if bad else [])


@given(
    value=st.floats(1e-6, 1e3),
    relative=st.floats(0, 1),
    absolute=st.floats(0, 1),
    step=st.floats(-2, 2),
    better=st.sampled_from(["lower", "higher"]),
)
def test_the_gate_is_monotone(value: float, relative: float, absolute: float, step: float, better: str) -> None:
    metric = Metric(value, better, relative, absolute)  # type: ignore[arg-type]
    baseline = ResultRecord("x", {"m": metric})
    now = value + step * metric.allowance
    result = ResultRecord("x", {"m": replace(metric, value=now)})
    worse = step if better == "lower" else -step
    if abs(abs(worse) - 1) < 1e-6:  # on the edge rounding decides
        return
    real_loss = abs(now - value) > 1e-9 * max(1.0, value)
    assert _bad(result, baseline) == (["m"] if worse > 1 and real_loss else [])


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"poses": {"pose_00": True, "pose_01": False, "pose_02": False}}, "pose pose_01"),
        ({"poses": {"pose_00": True, "pose_02": False}}, "pose pose_01"),
        ({"photos": {"pose_00": 16, "pose_01": 14}}, "photos of pose_01"),
        ({"photos": {"pose_00": 16}}, "photos of pose_01"),
        ({"curves": ("lip",)}, "curve lid"),
        ({"methods": ()}, "method linear"),
        ({"inputs": {"template.obj": "c" * 64, "photos/pose_00": "b" * 64}}, "input template.obj"),
        ({"inputs": {"photos/pose_00": "b" * 64}}, "input template.obj"),
        ({"metrics": {"share": RECORD.metrics["share"]}}, "linear LAE"),
    ],
)
def test_what_went_missing_or_changed_fails(change: dict, expected: str) -> None:
    assert _bad(replace(RECORD, **change)) == [expected]


def test_what_got_better_or_was_added_does_not_fail() -> None:
    result = replace(
        RECORD,
        poses={**RECORD.poses, "pose_02": True, "pose_03": False},
        photos={"pose_00": 17, "pose_01": 15},
        curves=("lid", "lip", "brow"),
        methods=("linear", "pde_cubic"),
        inputs={**RECORD.inputs, "new": "d" * 64},
    )
    assert _bad(result) == []


def test_records_survive_json() -> None:
    plain = json.loads(json.dumps(record_to_plain(RECORD)))
    assert record_from_plain(plain, "x") == RECORD


def test_an_update_keeps_the_tolerances_a_person_set() -> None:
    new = replace(RECORD, metrics={"linear LAE": Metric(0.004, "lower", relative=0.5), "other": Metric(1.0)})
    kept = with_tolerances_of(new, RECORD)
    assert kept.metrics["linear LAE"] == Metric(0.004, "lower", relative=0.1, absolute=1e-4)
    assert kept.metrics["other"] == Metric(1.0)


@pytest.mark.parametrize("content", [None, [], {}, {"schema_version": 99}, {"schema_version": 1, "name": "x"}])
def test_what_is_no_baseline_is_refused(content: object) -> None:
    with pytest.raises(InputError, match="file\\.json: "):
        record_from_plain(content, "file.json")


@pytest.mark.parametrize("fields", [{"better": "sideways"}, {"relative": -0.1}, {"absolute": math.nan}])
def test_a_metric_has_a_direction_and_tolerances(fields: dict) -> None:
    with pytest.raises(InputError):
        Metric(1.0, **fields)


@pytest.fixture
def result_folder(tmp_path: Path) -> Path:
    """A result as `run` leaves it, reduced to what `check` reads."""
    out = tmp_path / "result"
    (out / "report").mkdir(parents=True)
    (out / "work" / "pose_00").mkdir(parents=True)
    row = {"LAE": 0.005, "LME": 0.02, "mean_E_A": 0.001}
    counts = {"points": 100, "points_used": 90, "curves_failed": ["lid"]}
    (out / "report" / "summary.json").write_text(json.dumps({"methods": {"linear": row}, "counts": counts}))
    (out / "report" / "errors.csv").write_text(
        "method,curve,t,n_points,E_A,E_M\nlinear,lip,0.5,3,0.1,0.2\nlinear,lid,0.5,0,,\n"
    )
    (out / "report" / "truth.json").write_text(
        json.dumps({"tracking": [{"status": "ok", "median": 0.001, "p95": 0.004}, {"status": "failed"}]})
    )
    np.savez(out / "report" / "registered.npz", t=np.array([0.0, 1.0]), pose_ok=np.array([True, False]))
    (out / "work" / "pose_00" / "sparse.json").write_text(json.dumps({"registered": 14}))
    inputs = {"name": "jaw", "poses": ["pose_00", "pose_01"], "files": {"template.obj": "a" * 64}, "tools": {}}
    (out / "work" / "inputs.json").write_text(json.dumps(inputs))
    return out


def test_a_result_folder_becomes_a_record(result_folder: Path) -> None:
    from capture_eval.stages.check import read_result

    record = read_result(result_folder)
    assert record.poses == {"pose_00": True, "pose_01": False}
    assert record.photos == {"pose_00": 14}
    assert record.curves == ("lip",)
    assert record.metrics["linear LME"].value == 0.02
    assert record.metrics["tracking p95, worst pose"].value == 0.004
    assert record.metrics["share of curve points that count"].value == 0.9
    assert record.inputs == {"template.obj": "a" * 64}


def test_check_against_its_own_baseline_and_after_damage(result_folder: Path, tmp_path: Path) -> None:
    from capture_eval.stages.check import check_result, update_baseline

    baseline = tmp_path / "baseline.json"
    with pytest.raises(InputError, match="--update"):
        check_result(result_folder, baseline)
    update_baseline(result_folder, baseline)
    assert not [finding for finding in check_result(result_folder, baseline) if finding.bad]
    summary = result_folder / "report" / "summary.json"
    summary.write_text(summary.read_text().replace("0.005", "0.006"))
    assert [finding.what for finding in check_result(result_folder, baseline) if finding.bad] == ["linear LAE"]


def test_an_unfinished_result_is_refused(tmp_path: Path) -> None:
    from capture_eval.stages.check import read_result

    with pytest.raises(InputError, match="finish `capture-eval run`"):
        read_result(tmp_path)
