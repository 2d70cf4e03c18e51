"""Photographs, scans and registrations of the benchmark, each made once and kept: the work between cases and figures.

OUT/captures/NAME   what `capture-eval synthesize` writes
OUT/scans/HASH      cameras and scan of one pose, by the bytes of its photos: poses that look alike are scanned once
OUT/cases/NAME      manifest of the case, truth in its order, and the work folder of its registration
"""

from __future__ import annotations

import dataclasses
import hashlib
import multiprocessing
import os
import resource
import shutil
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from registration_cases import TEMPLATE_IDENTITY, Case, Shots

from capture_eval.files.atomic import read_json, read_npz, write_json, write_npz, write_text
from capture_eval.files.manifest_files import Capture, read_manifest
from capture_eval.images.head import Head
from capture_eval.workflow.step_calls import STEP_CALLS, STEP_OUTPUTS, StepContext

SCAN_STEPS = ("sparse", "dense", "surface")
SCAN_FILES = ("database.db", "sparse", "sparse.json", "dense.json", "scan.ply", "surface.json")


class OutOfTime(Exception):
    """The time that was allowed is over; the next call goes on here."""


@dataclass(frozen=True)
class Bench:
    """Folder of the benchmark, where the MakeHuman files are, and when to stop."""

    out: Path
    makehuman: Path | None
    deadline: float

    def check_time(self) -> None:
        """Stop before work that has not begun."""
        if time.monotonic() > self.deadline:
            raise OutOfTime

    def heads(self, shots: Shots) -> tuple[Head, Head]:
        """Person and template."""
        from capture_eval.stages.subjects import load_subjects

        return load_subjects(shots.head, shots.identity, TEMPLATE_IDENTITY, self.makehuman)


@dataclass(frozen=True)
class CaseContext(StepContext):
    """A step's context whose options are the defaults with some of them changed."""

    changes: dict[str, Any] = dataclasses.field(default_factory=dict)

    def options(self, stage: str) -> Any:
        """Options of a stage."""
        return changed(super().options(stage), self.changes.get(stage, {}))


def changed(options: Any, changes: dict[str, Any]) -> Any:
    """Nested frozen options with some fields replaced."""
    values = {}
    for name, value in changes.items():
        values[name] = changed(getattr(options, name), value) if isinstance(value, dict) else value
    return dataclasses.replace(options, **values)


def say(text: str) -> None:
    """A line with the time, at once."""
    print(f"{time.strftime('%H:%M:%S')} {text}", flush=True)


def cpu_seconds() -> float:
    """Of this process and the children it has waited for."""
    own, children = resource.getrusage(resource.RUSAGE_SELF), resource.getrusage(resource.RUSAGE_CHILDREN)
    return own.ru_utime + own.ru_stime + children.ru_utime + children.ru_stime


def make_photos(bench: Bench, shots: Shots) -> Path:
    """Photograph a capture unless it is there."""
    folder = bench.out / "captures" / shots.name
    if (folder / "manifest.yaml").is_file():
        return folder
    bench.check_time()
    from capture_eval.stages.synthesize import synthesize_capture
    from capture_eval.stages.synthesize_options import SynthesizeOptions

    options = SynthesizeOptions(
        motion=shots.motion,
        times=shots.amounts,  # linear timing: the time is how far the motion has gone
        views=shots.views,
        width=shots.width,
        height=shots.height,
        skin="weak" if shots.skin == "weak" else "normal",
        light_turn=shots.light_turn,
    )
    start = cpu_seconds()
    made = synthesize_capture(*bench.heads(shots), folder, options)
    say(f"{shots.name}: {made['photos']} photos, {cpu_seconds() - start:.0f} CPU s")
    return folder


def photo_hash(folder: Path) -> str:
    """Of the bytes and names of all photos in a folder."""
    digest = hashlib.sha256()
    for photo in sorted(folder.glob("*.jpg")):
        digest.update(photo.name.encode())
        digest.update(photo.read_bytes())
    return digest.hexdigest()[:16]


def scan_poses(bench: Bench, case: Case, capture_folder: Path) -> list[Path]:
    """Pose folders with cameras and scan for every pose of a case, in its order."""
    capture = read_manifest(capture_folder / "manifest.yaml")
    names = capture.manifest.pose_names
    folders = []
    for number in sorted(case.poses):
        name = names[number]
        key = photo_hash(capture_folder / "photos" / name)
        _scan(bench, capture, name, bench.out / "scans" / key)
    for number in case.poses:
        folders.append(bench.out / "scans" / photo_hash(capture_folder / "photos" / names[number]) / "work")
    return [next(folder.iterdir()) for folder in folders]


def _scan(bench: Bench, capture: Capture, name: str, out: Path) -> None:
    if (out / "scan.json").is_file():
        return
    bench.check_time()
    shutil.rmtree(out / "work", ignore_errors=True)
    seconds = {}
    for step in SCAN_STEPS:
        start = cpu_seconds()
        STEP_CALLS[step](StepContext(capture, out, name, 1))
        seconds[step] = round(cpu_seconds() - start, 1)
    shutil.rmtree(out / "work" / name / "dense", ignore_errors=True)  # photos and maps that nothing later reads
    (out / "work" / name / "fused.ply").unlink(missing_ok=True)
    write_json(out / "scan.json", {"cpu_seconds": seconds, "photos": f"{capture.folder.name}/{name}"})
    say(f"{capture.folder.name} {name}: scanned, CPU s {seconds}")


def compose(bench: Bench, case: Case, capture_folder: Path, scans: list[Path]) -> Capture:
    """Write the case's manifest, truth and work folder; the scans are linked."""
    folder = bench.out / "cases" / case.name
    names = [f"pose_{index:02d}" for index in range(len(scans))]
    in_order = case.amounts == tuple(sorted(case.amounts)) and case.amounts[-1] == 1.0
    times = case.amounts if in_order else tuple(np.linspace(0.0, 1.0, len(scans)).tolist())
    for name, scan in zip(names, scans, strict=True):
        target = folder / "work" / name
        target.mkdir(parents=True, exist_ok=True)
        for file in SCAN_FILES:
            if (scan / file).exists() and not (target / file).exists():
                os.symlink((scan / file).resolve(), target / file)
    truth = read_npz(capture_folder / "truth" / "truth.npz")
    write_npz(folder / "truth.npz", {"t": np.array(times), "vertices": truth["vertices"][list(case.poses)]})
    cameras = read_json(capture_folder / "truth" / "cameras.json")
    rows = []
    for name, number in zip(names, case.poses, strict=True):
        rows += [row | {"pose": name} for row in cameras["views"] if row["pose"] == f"pose_{number:02d}"]
    write_json(folder / "cameras.json", {"views": rows})
    document = yaml.safe_load((capture_folder / "manifest.yaml").read_text())
    document["poses"] = [
        {"t": t, "photos": str(capture_folder.resolve() / "photos" / f"pose_{number:02d}"), "name": name}
        for t, name, number in zip(times, names, case.poses, strict=True)
    ]
    document["truth"] |= {"vertices": "truth.npz", "cameras": "cameras.json"}
    _place_inputs(case, capture_folder, folder, document)
    write_text(folder / "manifest.yaml", yaml.safe_dump(document, sort_keys=False))
    return read_manifest(folder / "manifest.yaml", allow_outside=True)


def _place_inputs(case: Case, capture_folder: Path, folder: Path, document: dict[str, Any]) -> None:
    """Copy template, landmarks and curves, or make a template of another size."""
    for file in ("occluders.obj", "rigid_region.yaml", "curves.yaml"):
        if (capture_folder / file).is_file():
            shutil.copyfile(capture_folder / file, folder / file)
    (folder / "truth").mkdir(exist_ok=True)
    shutil.copyfile(capture_folder / "truth" / "mesh.obj", folder / "truth" / "mesh.obj")
    if case.template is None:
        for file in ("template.obj", "landmarks.yaml"):
            shutil.copyfile(capture_folder / file, folder / file)
        return
    from registration_templates import write_template

    write_template(capture_folder, folder, *case.template)
    document.pop("curves")


def register(bench: Bench, case: Case, capture: Capture, force: bool) -> dict[str, float]:
    """Register all poses of a case; CPU seconds by step (of the steps done by this call)."""
    folder = bench.out / "cases" / case.name
    seconds: dict[str, float] = {}
    for label, step, pose in registration_steps(capture.manifest.pose_names):
        outputs = [folder / path.format(pose=pose) for path in STEP_OUTPUTS[step]]
        if all(path.exists() for path in outputs) and not force:
            continue
        bench.check_time()
        start = cpu_seconds()
        STEP_CALLS[step](CaseContext(capture, folder, pose, 1, case.options))
        seconds[label] = round(cpu_seconds() - start, 2)
        write_json(folder / "seconds" / f"{label}.json", {"cpu_seconds": seconds[label]})
    saved = sorted((folder / "seconds").glob("*.json"))
    return {path.stem: float(read_json(path)["cpu_seconds"]) for path in saved}


def register_apart(bench: Bench, case: Case, capture: Capture, force: bool) -> dict[str, float]:
    """Register in a process of its own, so that its peak memory is that of the case."""
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        return pool.submit(_register_and_weigh, bench, case, capture, force).result()


def _register_and_weigh(bench: Bench, case: Case, capture: Capture, force: bool) -> dict[str, float]:
    seconds = register(bench, case, capture, force)
    path = capture.folder / "memory.json"
    if force or not path.is_file():
        write_json(path, {"peak_memory_mb": peak_memory()})
    return seconds


def peak_memory() -> float:
    """Largest resident memory of this process in MB (Linux: getrusage would count what it was started from)."""
    status = Path("/proc/self/status").read_text()
    line = next(line for line in status.splitlines() if line.startswith("VmHWM"))
    return round(int(line.split()[1]) / 1024, 1)


def registration_steps(names: list[str]) -> Iterator[tuple[str, str, str | None]]:
    """Label, step and pose of all steps of a registration."""
    for step in ("align", "neutral", "track"):
        yield step, step, None
    for name in names:
        yield f"refine_{name}", "refine", name
    yield "collect", "collect", None


def run_case(bench: Bench, case: Case, until: str, force: bool, finish: Callable[..., dict[str, Any]]) -> bool:
    """One case from photos to its result; False when it was there or ends early."""
    result = bench.out / "results" / f"{case.name}.json"
    if result.is_file() and not force and until == "results":
        return False
    capture_folder = make_photos(bench, case.shots)
    if until == "photos":
        return False
    scans = scan_poses(bench, case, capture_folder)
    if until == "scans":
        return False
    capture = compose(bench, case, capture_folder, scans)
    call = register_apart if case.group == "growth" else register
    seconds = call(bench, case, capture, force)
    bench.check_time()
    write_json(result, finish(bench, case, capture, seconds))
    say(f"{case.name}: registered and measured, CPU s {sum(seconds.values()):.0f}")
    return True
