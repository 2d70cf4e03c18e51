"""The engine round fake stages: order, resume after kill -9, failures, keys, locks. Snakemake is the real one."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import time
from pathlib import Path

import pytest
import yaml
from fake_stages import clear_record, command, environment, finished_steps
from small_capture import write_capture

from capture_eval.errors import InputError
from capture_eval.files.manifest_files import read_manifest
from capture_eval.stages.dense import DenseOptions
from capture_eval.workflow.inputs import effective_options
from capture_eval.workflow.plan import JOBS, JOBS_OF_POSES, planned_step_names
from capture_eval.workflow.runner import RunOptions, engine_command, plan_run
from capture_eval.workflow.stage_options import OPTION_CLASSES

POSES = 3
STEPS = 3 * POSES + 3 + POSES + 3  # scan, track, refine, final without truth


@pytest.fixture
def capture(tmp_path: Path) -> Path:
    return write_capture(tmp_path / "capture", POSES)


def _run(capture: Path, tmp_path: Path, *arguments: str, **settings: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        command("run", str(capture), "--out", str(tmp_path / "out"), "--cores", "2", *arguments),
        env=environment(tmp_path / "fake", **settings),
        capture_output=True,
        text=True,
        check=False,
        cwd=tmp_path,
        timeout=300,
    )


def _processes_of(out: Path) -> list[str]:
    """Command lines of living processes that work for a result folder."""
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                line = (entry / "cmdline").read_bytes().replace(b"\0", b" ").decode("utf-8", "replace")
                state = (entry / "stat").read_text().rsplit(")", 1)[1].split()[0]
            except OSError:
                continue
            if str(out) in line and state != "Z":
                found.append(line)
    return found


def test_a_run_from_beginning_to_end_and_again(capture: Path, tmp_path: Path) -> None:
    first = _run(capture, tmp_path)
    assert first.returncode == 0, first.stderr
    steps = finished_steps(tmp_path / "fake")
    assert len(steps) == STEPS
    for pose in range(POSES):
        ordered = [steps.index(f"{name} pose_{pose}") for name in ("sparse", "dense", "surface")]
        assert ordered == sorted(ordered)
        assert steps.index(f"surface pose_{pose}") < steps.index("align")
        assert steps.index("track") < steps.index(f"refine pose_{pose}") < steps.index("collect")
    assert steps[-3:] == ["collect", "evaluate", "report"]
    assert f"{STEPS}/{STEPS} " in first.stderr
    assert "report.html" in first.stdout
    timings = json.loads((tmp_path / "out" / "work" / "timings.json").read_text())
    assert len(timings) == STEPS
    assert "a native library says something" in (tmp_path / "out" / "logs" / "dense_pose_1.log").read_text()

    # nothing changed: the engine is not even started
    engine_log = tmp_path / "out" / "logs" / "snakemake.log"
    before = engine_log.stat().st_mtime_ns
    again = _run(capture, tmp_path)
    assert again.returncode == 0, again.stderr
    assert len(finished_steps(tmp_path / "fake")) == STEPS
    assert engine_log.stat().st_mtime_ns == before

    # a lost file repeats its own step only, since the others' inputs are the same
    clear_record(tmp_path / "fake")
    (tmp_path / "out" / "work" / "register" / "start.npz").unlink()
    listed = _run(capture, tmp_path, "--dry-run")
    assert "would run track: its files are missing" in listed.stdout
    assert finished_steps(tmp_path / "fake") == []
    assert _run(capture, tmp_path).returncode == 0
    assert finished_steps(tmp_path / "fake") == ["track"]

    # a changed photo repeats what depends on it
    clear_record(tmp_path / "fake")
    photo = capture.parent / "pose_2" / "view_3.jpg"
    photo.write_bytes((capture.parent / "pose_2" / "view_4.jpg").read_bytes())
    assert _run(capture, tmp_path).returncode == 0
    steps = finished_steps(tmp_path / "fake")
    assert [step for step in steps if step.startswith("sparse")] == ["sparse pose_2"]
    assert len(steps) == 3 + 3 + POSES + 3


def test_a_killed_run_goes_on_where_it_was(capture: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    env = environment(tmp_path / "fake", FAKE_SECONDS="1.5")
    runner = subprocess.Popen(
        command("run", str(capture), "--out", str(out), "--cores", "2"),
        env=env,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        cwd=tmp_path,
    )
    deadline = time.monotonic() + 120
    while len(finished_steps(tmp_path / "fake")) < 2 and time.monotonic() < deadline:
        time.sleep(0.1)
    second = _run(capture, tmp_path)
    assert second.returncode == 1
    assert "another run works in this folder" in second.stderr
    assert len(_processes_of(out)) >= 2
    os.kill(runner.pid, signal.SIGKILL)
    runner.wait()
    deadline = time.monotonic() + 20
    while _processes_of(out) and time.monotonic() < deadline:
        time.sleep(0.1)
    assert _processes_of(out) == []  # nothing works on behind the user's back
    done = finished_steps(tmp_path / "fake")
    assert 2 <= len(done) < STEPS
    resumed = _run(capture, tmp_path)
    assert resumed.returncode == 0, resumed.stderr
    steps = finished_steps(tmp_path / "fake")
    # each step once; one that was killed between its last write and its marker is allowed a second time
    assert len(set(steps)) == STEPS
    assert len(steps) <= STEPS + 2


@pytest.mark.parametrize(
    ("setting", "title", "code", "expected"),
    [
        ("FAKE_FAILURE", "dense pose_1", 3, "stage dense pose_1 failed: no two photos match; log "),
        ("FAKE_BAD_INPUT", "neutral", 1, "stage neutral failed: template.obj: no such vertex; log "),
        ("FAKE_CRASH", "surface pose_2", 3, "stage surface pose_2 failed: its process was killed"),
    ],
)
def test_a_failed_stage_is_named_with_its_log(
    capture: Path, tmp_path: Path, setting: str, title: str, code: int, expected: str
) -> None:
    found = _run(capture, tmp_path, **{setting: title})
    assert found.returncode == code, found.stderr
    last = found.stderr.strip().splitlines()[-1]
    assert last.startswith(f"capture-eval: {expected}")
    log = Path(re.search(r"log (\S+)", last).group(1))
    assert log.is_file()
    assert title not in finished_steps(tmp_path / "fake")
    assert _run(capture, tmp_path).returncode == 0


def test_the_snakefile_has_the_jobs_of_the_plan(capture: Path, tmp_path: Path) -> None:
    from capture_eval.workflow import runner

    text = (Path(runner.__file__).parent / "Snakefile").read_text()
    rules = dict.fromkeys(re.findall(r"^rule (\w+):", text, re.MULTILINE))
    assert list(rules) == ["all", *JOBS]
    for job in JOBS:
        body = text.split(f"rule {job}:")[1].split("\nrule ")[0]
        assert ("wildcards.pose" in body) == (job in JOBS_OF_POSES)
    assert set(runner.MEMORY_MB) == set(JOBS)
    (tmp_path / "out" / "work").mkdir(parents=True)
    plan, _ = plan_run(read_manifest(capture), tmp_path / "out", RunOptions(cores=3))
    arguments = engine_command(plan, RunOptions(cores=3, profile="site", engine_arguments=("--keep-going",)))
    assert arguments[-3:] == ["--profile", "site", "--keep-going"]
    assert arguments[arguments.index("--cores") + 1] == "3"
    cluster = engine_command(plan, RunOptions(cores=8, executor="slurm"))
    assert cluster[cluster.index("--executor") + 1] == "slurm"
    assert "--cores" not in cluster


def _change(capture: Path, **values: object) -> None:
    content = yaml.safe_load(capture.read_text())
    for key, value in values.items():
        if value is None:
            content.pop(key)
        else:
            content[key] = value
    capture.write_text(yaml.safe_dump(content))


def _keys(capture: Path, out: Path, threads: int = 1) -> dict[str, str]:
    plan, _ = plan_run(read_manifest(capture), out, RunOptions(threads=threads))
    return {step.identifier: step.key for step in plan.steps}


def test_keys_change_with_what_they_depend_on_and_with_nothing_else(capture: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    before = _keys(capture, out)
    os.utime(capture.parent / "pose_1" / "view_0.jpg")
    assert _keys(capture, out) == before  # a touched file is the same file

    _change(capture, methods=["linear"])
    assert {name for name, key in _keys(capture, out).items() if key != before[name]} == {"evaluate", "report"}

    _change(capture, options={"dense": {"sources": 3}})
    changed = {name for name, key in _keys(capture, out).items() if key != before[name]}
    assert {"dense_pose_0", "surface_pose_2", "align", "refine_pose_1", "report"} <= changed
    assert not any(name.startswith("sparse") for name in changed)
    assert set(_keys(capture, out, threads=2).items()).isdisjoint(before.items())


@pytest.mark.parametrize(
    ("removed", "until", "last"),
    [
        ([], None, "report"),
        ([], "interpolate", "evaluate"),
        ([], "register", "collect"),
        ([], "dense", "dense"),
        (["curves"], None, "collect"),
        (["template", "curves"], None, "surface"),
    ],
)
def test_how_far_a_run_goes(capture: Path, removed: list[str], until: str | None, last: str) -> None:
    _change(capture, **dict.fromkeys(removed))
    assert planned_step_names(read_manifest(capture), until)[-1] == last


@pytest.mark.parametrize(
    ("removed", "until", "expected"),
    [
        ([], "soon", "--until soon: no such stage; stages are sparse, dense"),
        (["template"], "report", "no `template` in the manifest, but --until report needs it"),
        (["curves"], "evaluate", "no `curves` in the manifest, but --until evaluate needs it"),
    ],
)
def test_what_cannot_be_reached_is_said(capture: Path, removed: list[str], until: str, expected: str) -> None:
    _change(capture, **dict.fromkeys(removed))
    with pytest.raises(InputError, match=re.escape(expected)):
        planned_step_names(read_manifest(capture), until)


def test_a_truth_step_is_planned_only_with_truth(capture: Path) -> None:
    assert "truth" not in planned_step_names(read_manifest(capture), None)
    _change(capture, truth={"mesh": "template.obj", "vertices": "truth.npz"})
    assert planned_step_names(read_manifest(capture), None)[-2:] == ["truth", "report"]


def test_the_report_is_told_every_option_that_a_run_uses(tmp_path: Path) -> None:
    path = write_capture(tmp_path / "capture", POSES)
    content = yaml.safe_load(path.read_text(encoding="utf-8"))
    content.setdefault("options", {})["dense"] = {"stereo": {"window": 3}}
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    options = effective_options(read_manifest(path))
    assert set(options) == set(OPTION_CLASSES)
    assert options["dense"]["stereo.window"] == 3  # of the manifest
    assert options["dense"]["sources"] == DenseOptions().sources  # a default
    assert not any(name.endswith("threads") for values in options.values() for name in values)
    json.dumps(options)  # plain values only: the page and the tables are made of them
