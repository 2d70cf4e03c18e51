"""`validate`: everything that can be wrong with a capture, found before hours are spent."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from capture_eval.errors import CaptureEvalError
from capture_eval.stages.validate_photos import Problem, validate_photos
from capture_eval.stages.validate_template import validate_pose_meshes, validate_template, validate_truth

if TYPE_CHECKING:
    from capture_eval.files.manifest_files import Capture

__all__ = ["Problem", "validate_capture"]


def validate_capture(
    capture: Capture, photos: bool = True, progress: Callable[[int, int], None] | None = None
) -> list[Problem]:
    """All problems of a capture, in the order of the manifest.

    Parameters
    ----------
    capture : Capture
        The manifest and its folder.
    photos : bool
        Open every photo too.
    progress : callable, optional
        Called with (photos done, photos in all).
    """
    problems = _validate_methods(capture) + _validate_hashes(capture)
    if capture.manifest.source == "meshes":
        return problems + validate_pose_meshes(capture)
    problems += validate_template(capture) + validate_truth(capture)
    if photos:
        problems += validate_photos(capture, progress)
    return problems


def _validate_methods(capture: Capture) -> list[Problem]:
    from capture_eval.interpolation.methods import create_method

    problems = []
    for index, method in enumerate(capture.manifest.method_entries):
        try:
            create_method(method.name, method.options)
        except CaptureEvalError as error:
            problems.append(Problem(f"{capture.path}: methods[{index}]", str(error), fatal=True))
    return problems


def _validate_hashes(capture: Capture) -> list[Problem]:
    import hashlib

    problems = []
    for relative, wanted in capture.manifest.sha256.items():
        path = capture.resolve(relative)
        try:
            with path.open("rb") as stream:
                found = hashlib.file_digest(stream, "sha256").hexdigest()
        except OSError as error:
            problems.append(Problem(str(path), f"{error.strerror or error}", fatal=True))
            continue
        if found != wanted:
            problems.append(
                Problem(str(path), f"SHA-256 is {found[:12]}…, the manifest says {wanted[:12]}…", fatal=True)
            )
    return problems
