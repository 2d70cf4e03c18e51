"""The plan of a run: which steps there are, in which job each runs, and the key that says if its result is current.

A *step* is one arrow of the pipeline (for one pose, or for all of them); a *job* is a group of steps that the engine
starts as one process, so that the engine's start-up is paid a few dozen times, not hundreds.
The key of a step is a hash of its inputs, its options, the versions of the tools it uses and the keys of the steps
before it. A result whose key is the planned one is kept, whatever happened to the clock or to the engine.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

from capture_eval import __version__
from capture_eval.errors import InputError
from capture_eval.files.photo_files import list_photos
from capture_eval.workflow.file_hashes import FileHashes, sha256_of_value
from capture_eval.workflow.stage_options import OPTION_CLASSES, stage_options

if TYPE_CHECKING:
    from capture_eval.files.manifest_files import Capture, PoseEntry

# job -> its steps, in order; jobs of poses run side by side
JOBS = {
    "scan": ("sparse", "dense", "surface"),
    "track": ("align", "neutral", "track"),
    "refine": ("refine",),
    "final": ("collect", "evaluate", "truth", "report"),
}
JOBS_OF_POSES = frozenset({"scan", "refine"})

# what a person may name in --until and --force -> the step that ends it
STAGE_STEPS = {
    "sparse": "sparse",
    "dense": "dense",
    "surface": "surface",
    "align": "align",
    "register": "collect",
    "curves": "evaluate",
    "interpolate": "evaluate",
    "evaluate": "evaluate",
    "report": "report",
}
FIRST_STEP_OF_STAGE = STAGE_STEPS | {"register": "neutral"}
STAGE_OF_STEP = {"neutral": "register", "track": "register", "refine": "register", "collect": "register"}

TOOLS_OF_STEP = {
    "sparse": ("pycolmap",),
    "dense": ("pycolmap", "numba", "opencv-python-headless"),
    "surface": ("pycolmap", "open3d", "pymeshlab"),
    "align": ("opencv-python-headless", "open3d"),
    "neutral": ("opencv-python-headless", "open3d", "scipy"),
    "track": ("opencv-python-headless", "open3d", "scipy"),
    "refine": ("opencv-python-headless", "open3d", "scipy"),
    "evaluate": ("numpy", "scipy"),
    "report": ("matplotlib", "plotly"),
}


@dataclass(frozen=True)
class Step:
    """One arrow of the pipeline.

    Attributes
    ----------
    name : str
        Name of the step.
    pose : str or None
        The pose it works on, or None for all of them.
    job : str
        The job it belongs to.
    key : str
        Hash of everything its result depends on.
    """

    name: str
    pose: str | None
    job: str
    key: str

    @property
    def identifier(self) -> str:
        """Name of the step's files: markers and logs."""
        return self.name if self.pose is None else f"{self.name}_{self.pose}"

    @property
    def title(self) -> str:
        """The step as a person reads it."""
        return self.name if self.pose is None else f"{self.name} {self.pose}"


@dataclass(frozen=True)
class Plan:
    """All steps of a run, in an order in which they could run one after the other."""

    capture: Capture
    out: Path
    until: str
    threads: int
    steps: tuple[Step, ...] = field(default_factory=tuple)

    def job_steps(self, job: str, pose: str | None) -> list[Step]:
        """The planned steps of one job."""
        return [step for step in self.steps if step.job == job and step.pose == pose]

    @property
    def jobs(self) -> list[tuple[str, str | None]]:
        """The planned jobs in order."""
        return list(dict.fromkeys((step.job, step.pose) for step in self.steps))


def last_step(capture: Capture, until: str | None) -> str:
    """Name of the step that ends the run.

    Raises
    ------
    InputError
        If there is no such stage, or the stage needs a template that the manifest does not name.
    """
    manifest = capture.manifest
    furthest = "surface" if manifest.template is None else "collect" if manifest.curves is None else "report"
    if until is None:
        return furthest
    if until not in STAGE_STEPS:
        raise InputError(f"--until {until}: no such stage; stages are {', '.join(STAGE_STEPS)}")
    step = STAGE_STEPS[until]
    order = [name for steps in JOBS.values() for name in steps]
    if order.index(step) > order.index(furthest):
        lacking = "template" if manifest.template is None else "curves"
        raise InputError(f"{capture.path}: no `{lacking}` in the manifest, but --until {until} needs it")
    return step


def planned_step_names(capture: Capture, until: str | None) -> list[str]:
    """Names of the steps that the run consists of, in order."""
    order = [step for steps in JOBS.values() for step in steps]
    names = order[: order.index(last_step(capture, until)) + 1]
    truth = capture.manifest.truth
    if truth is None or truth.mesh is None or truth.vertices is None:
        names = [name for name in names if name != "truth"]
    return names


def make_plan(capture: Capture, out: Path, until: str | None, threads: int, hashes: FileHashes) -> Plan:
    """Work out every step of a run and its key.

    Parameters
    ----------
    capture : Capture
        The manifest and its folder.
    out : Path
        Folder of the result.
    until : str or None
        Last stage; None for all.
    threads : int
        Threads inside a stage; part of the keys, since results differ with it.
    hashes : FileHashes
        Hashes of input files.
    """
    names = planned_step_names(capture, until)
    keys = _Keys(capture, threads, hashes)
    steps: list[Step] = []
    for job, job_step_names in JOBS.items():
        wanted = [name for name in job_step_names if name in names]
        poses = capture.manifest.poses if job in JOBS_OF_POSES else [None]
        for pose in poses:
            for name in wanted:
                pose_name = None if pose is None else pose.pose_name
                steps.append(Step(name, pose_name, job, keys.of_step(name, pose)))
    return Plan(capture, out, names[-1], threads, tuple(steps))


class _Keys:
    """Keys of steps, each computed once."""

    def __init__(self, capture: Capture, threads: int, hashes: FileHashes) -> None:
        self._capture = capture
        self._threads = threads
        self._hashes = hashes
        self._before_all: dict[str, list[str]] = {}  # step -> keys it has for all poses so far

    def of_step(self, name: str, pose: PoseEntry | None) -> str:
        """The key; steps must be asked for in the order of the plan."""
        upstream = [key for keys in self._before_all.values() for key in keys] if pose is None else self._of_pose(name)
        content = {
            "step": name,
            "pose": None if pose is None else pose.pose_name,
            "before": upstream,
            "inputs": self._inputs(name, pose),
            "options": self._options(name),
            "threads": self._threads,
            "versions": {"capture_eval": __version__} | {tool: _version(tool) for tool in TOOLS_OF_STEP.get(name, ())},
        }
        key = sha256_of_value(content)
        self._before_all.setdefault(name, []).append(key)
        return key

    def _of_pose(self, name: str) -> list[str]:
        """Keys before a step of one pose: the step before it in its job, or everything of the jobs before."""
        job = next(job for job, steps in JOBS.items() if name in steps)
        position = JOBS[job].index(name)
        if position > 0:
            return self._before_all[JOBS[job][position - 1]][-1:]
        return [key for step, keys in self._before_all.items() if step not in JOBS[job] for key in keys]

    def _options(self, name: str) -> dict[str, Any]:
        stage = STAGE_OF_STEP.get(name, name)
        if stage not in OPTION_CLASSES:
            return {}
        options = dataclasses.asdict(stage_options(self._capture, stage, self._threads))
        # files count by their content (see _inputs), so that a folder can be moved
        return {key: value for key, value in options.items() if not isinstance(value, Path)}

    def _inputs(self, name: str, pose: PoseEntry | None) -> dict[str, Any]:
        manifest = self._capture.manifest
        if name == "sparse" and pose is not None:
            photos = self._hashes.of_files(list_photos(self._capture.resolve(pose.photos or "")))
            masks = {} if pose.masks is None else self._hashes.of_files(list_photos(self._capture.resolve(pose.masks)))
            return {"photos": photos, "masks": masks, "known_views": self._file(manifest.camera.known_views)}
        if name in ("align", "neutral"):
            region = manifest.rigid_region
            markers = {"markers": self._file(manifest.markers)} if name == "align" else {}
            if manifest.template is None:
                return markers
            return markers | {
                "template": {key: self._file(value) for key, value in manifest.template.model_dump().items()},
                "rigid_region": self._file(region) if isinstance(region, str) else region,
            }
        if name == "collect":
            return {"t": [entry.t for entry in manifest.poses]}
        if name == "evaluate":
            methods = [method.model_dump() for method in manifest.method_entries]
            return {"curves": self._file(manifest.curves), "methods": methods}
        if name == "truth" and manifest.truth is not None:
            return {key: self._file(value) for key, value in manifest.truth.model_dump().items()}
        if name == "report":
            return {"name": manifest.name, "description": manifest.description}
        return {}

    def _file(self, relative: str | None) -> str | None:
        return None if relative is None else self._hashes.of_file(self._capture.resolve(relative))


def _version(distribution: str) -> str | None:
    names = ("pycolmap", "pycolmap-cuda12") if distribution == "pycolmap" else (distribution,)
    for name in names:
        try:
            return f"{name} {metadata.version(name)}"
        except metadata.PackageNotFoundError:
            continue
    return None
