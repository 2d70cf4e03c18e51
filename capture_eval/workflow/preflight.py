"""Remembers that an input was validated, so that a run that goes on does not open every photo again."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from capture_eval.errors import CaptureEvalError, InputError
from capture_eval.files.atomic import read_json, write_json
from capture_eval.files.manifest_files import named_paths
from capture_eval.workflow.file_hashes import FileHashes, sha256_of_value

if TYPE_CHECKING:
    from capture_eval.files.manifest_files import Capture

RECORD = "work/validated.json"


def input_hashes(capture: Capture, hashes: FileHashes) -> dict[str, str]:
    """SHA-256 of everything a manifest names, by relative path; of a folder, that of the hashes of its files.

    Raises
    ------
    InputError
        If a file cannot be read.
    """
    found = {}
    for key, relative in named_paths(capture.manifest):
        path = capture.resolve(relative)
        if path.is_dir():
            files = [entry for entry in sorted(path.iterdir()) if entry.is_file()]
            found[relative] = sha256_of_value(hashes.of_files(files))
        else:
            try:
                found[relative] = hashes.of_file(path)
            except InputError as error:
                raise InputError(f"{capture.path}: {key}: {error}") from None
    return found


def checked_before(capture: Capture, out: Path) -> bool:
    """Whether exactly this input was validated for this result folder and found usable."""
    try:
        return bool(read_json(out / RECORD)["key"] == _key(capture, out))
    except (CaptureEvalError, KeyError, TypeError):
        return False


def remember_checked(capture: Capture, out: Path, warnings: Sequence[str]) -> None:
    """Note that this input is usable, with the warnings it got."""
    write_json(out / RECORD, {"key": _key(capture, out), "warnings": list(warnings)})


def _key(capture: Capture, out: Path) -> str:
    hashes = FileHashes(out / "work" / "hashes.json")
    key = sha256_of_value([capture.manifest.model_dump(mode="json"), input_hashes(capture, hashes)])
    hashes.save()
    return key
