"""What each step of a run calls: one stage function with paths and options from the manifest."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from capture_eval.files.photo_files import list_photos
from capture_eval.workflow.inputs import report_info
from capture_eval.workflow.stage_options import stage_options

if TYPE_CHECKING:
    from capture_eval.files.manifest_files import Capture, PoseEntry


@dataclass(frozen=True)
class StepContext:
    """What a step needs to know.

    Attributes
    ----------
    capture : Capture
        The manifest and its folder.
    out : Path
        Folder of the result.
    pose : str or None
        Name of the pose the step works on.
    threads : int
        Threads inside the stage.
    """

    capture: Capture
    out: Path
    pose: str | None
    threads: int

    @property
    def work(self) -> Path:
        """Folder of everything between stages."""
        return self.out / "work"

    @property
    def pose_folder(self) -> Path:
        """Folder of the pose in the work folder."""
        return self.work / (self.pose or "")

    @property
    def pose_entry(self) -> PoseEntry:
        """The pose in the manifest."""
        return next(entry for entry in self.capture.manifest.poses if entry.pose_name == self.pose)

    def options(self, stage: str) -> Any:
        """Options of a stage."""
        return stage_options(self.capture, stage, self.threads)

    def file(self, group: str, key: str) -> Path | None:
        """Absolute path of a file that a part of the manifest names."""
        relative = getattr(getattr(self.capture.manifest, group), key)
        return None if relative is None else self.capture.resolve(relative)

    @property
    def report(self) -> Path:
        """Folder of what a person reads."""
        return self.out / "report"

    @property
    def curves(self) -> Path:
        """The curves file."""
        if self.capture.manifest.curves is None:
            raise ValueError("curves is not in the manifest")  # the plan has made sure of it
        return self.capture.resolve(self.capture.manifest.curves)

    @property
    def methods(self) -> list[tuple[str, dict[str, Any]]]:
        """Interpolation methods with their options."""
        return [(method.name, dict(method.options)) for method in self.capture.manifest.method_entries]

    def required_file(self, group: str, key: str) -> Path:
        """The same for a file that must be named (the plan has made sure of it)."""
        path = self.file(group, key)
        if path is None:
            raise ValueError(f"{group}.{key} is not in the manifest")
        return path


def _sparse(context: StepContext) -> Any:
    from capture_eval.stages.sparse import reconstruct_sparse

    entry = context.pose_entry
    options = context.options("sparse")
    if entry.masks is not None:
        options = dataclasses.replace(options, masks=context.capture.resolve(entry.masks))
    photos = list_photos(context.capture.resolve(entry.photos or ""))
    return reconstruct_sparse(photos, context.pose_folder, options)


def _dense(context: StepContext) -> Any:
    from capture_eval.stages.dense import reconstruct_dense

    options = context.options("dense")
    masks = context.pose_entry.masks
    if masks is not None:
        options = dataclasses.replace(options, masks=context.capture.resolve(masks))
    return reconstruct_dense(context.pose_folder, options)


def _surface(context: StepContext) -> Any:
    from capture_eval.stages.surface import reconstruct_surface

    return reconstruct_surface(context.pose_folder, context.options("surface"))


def _align(context: StepContext) -> Any:
    from capture_eval.stages.align import align_poses

    return align_poses(context.work, context.capture.manifest.pose_names, context.options("align"))


def _neutral(context: StepContext) -> Any:
    from capture_eval.stages.register import register_neutral

    return register_neutral(
        context.work,
        context.required_file("template", "mesh"),
        context.required_file("template", "landmarks"),
        context.capture.manifest.pose_names,
        context.options("register"),
        context.file("template", "occluders"),
    )


def _track(context: StepContext) -> Any:
    from capture_eval.stages.register import track_poses

    return track_poses(
        context.work,
        context.required_file("template", "mesh"),
        context.capture.manifest.pose_names,
        context.options("register"),
        context.file("template", "occluders"),
    )


def _refine(context: StepContext) -> Any:
    from capture_eval.stages.register import refine_pose

    return refine_pose(
        context.work,
        context.required_file("template", "mesh"),
        context.pose_entry.pose_name,
        context.options("register"),
        context.file("template", "occluders"),
    )


def _collect(context: StepContext) -> Any:
    from capture_eval.stages.register import collect_registration

    manifest = context.capture.manifest
    times = [pose.t for pose in manifest.poses]
    return collect_registration(context.work, manifest.pose_names, times, context.options("register"))


def _evaluate(context: StepContext) -> Any:
    from capture_eval.stages.evaluate import evaluate_capture

    return evaluate_capture(
        context.work,
        context.required_file("template", "mesh"),
        context.curves,
        context.methods,
        context.report,
        context.options("evaluate"),
    )


def _truth(context: StepContext) -> Any:
    from capture_eval.stages.evaluate import evaluate_truth
    from capture_eval.stages.truth import TruthFiles, measure_tracking

    template = context.required_file("template", "mesh")
    files = TruthFiles(
        context.required_file("truth", "mesh"),
        context.required_file("truth", "vertices"),
        context.file("truth", "cameras"),
    )
    measure_tracking(context.work, template, files, context.report, context.options("truth"), context.curves)
    return evaluate_truth(
        context.work, template, context.curves, context.methods, context.report, context.options("evaluate")
    )


def _report(context: StepContext) -> Any:
    from capture_eval.stages.report import write_report

    return write_report(context.out, report_info(context.capture, context.out), context.options("report"))


STEP_CALLS: dict[str, Callable[[StepContext], Any]] = {
    "sparse": _sparse,
    "dense": _dense,
    "surface": _surface,
    "align": _align,
    "neutral": _neutral,
    "track": _track,
    "refine": _refine,
    "collect": _collect,
    "evaluate": _evaluate,
    "truth": _truth,
    "report": _report,
}

# Files of the work folder without which a finished step counts as not done ({pose} is the pose's folder).
STEP_OUTPUTS: dict[str, tuple[str, ...]] = {
    "sparse": ("work/{pose}/sparse.json",),
    "dense": ("work/{pose}/dense.json",),
    "surface": ("work/{pose}/surface.json",),
    "align": ("work/align/alignment.json", "work/align/alignment.npz"),
    "neutral": ("work/register/neutral.npz",),
    "track": ("work/register/start.npz",),
    "refine": ("work/{pose}/registered.json",),
    "collect": ("work/register/registered.npz",),
    "evaluate": ("report/errors.csv", "report/summary.json", "report/curves.npz", "report/registered.npz"),
    "truth": ("report/truth.json",),
    "report": ("report/report.html",),
}
