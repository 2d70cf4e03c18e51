"""``compare``: evaluation and report of meshes that are already registered, without the engine."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from capture_eval.workflow.inputs import report_info, write_inputs
from capture_eval.workflow.stage_options import stage_options

if TYPE_CHECKING:
    from capture_eval.files.manifest_files import Capture


def compare_meshes(capture: Capture, out: Path) -> None:
    """Evaluate a `source: meshes` manifest and write the report.

    Raises
    ------
    InputError
        If the meshes do not share one topology or a curve does not exist on them.
    """
    from capture_eval.stages.evaluate import evaluate_meshes
    from capture_eval.stages.report import write_report

    manifest = capture.manifest
    write_inputs(capture, out)
    evaluate_meshes(
        [capture.resolve(pose.mesh or "") for pose in manifest.poses],
        [pose.t for pose in manifest.poses],
        capture.resolve(manifest.curves or ""),
        [(method.name, dict(method.options)) for method in manifest.method_entries],
        out / "report",
        stage_options(capture, "evaluate"),
    )
    write_report(out, report_info(capture, out), stage_options(capture, "report"))
