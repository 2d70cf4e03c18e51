"""Remembers that an input was validated, so that a run that goes on does not open every photo again."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from capture_eval.errors import CaptureEvalError
from capture_eval.files.atomic import read_json, write_json
from capture_eval.workflow.file_hashes import sha256_of_value
from capture_eval.workflow.inputs import hash_memory, input_hashes

if TYPE_CHECKING:
    from capture_eval.files.manifest_files import Capture

RECORD = "work/validated.json"


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
    hashes = hash_memory(out)
    key = sha256_of_value([capture.manifest.model_dump(mode="json"), input_hashes(capture, hashes)])
    hashes.save()
    return key
