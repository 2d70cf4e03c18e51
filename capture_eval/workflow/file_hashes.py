"""SHA-256 of files, remembered by size and time of change so that an unchanged capture is hashed once."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from capture_eval.errors import CaptureEvalError, InputError
from capture_eval.files.atomic import read_json, write_json


def sha256_of_file(path: Path) -> str:
    """SHA-256 of a file's content.

    Raises
    ------
    InputError
        If the file cannot be read.
    """
    try:
        with path.open("rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or error}") from None


def sha256_of_value(value: Any) -> str:
    """SHA-256 of anything that JSON can hold (other objects by their repr), independent of the order of keys."""
    text = json.dumps(value, sort_keys=True, default=repr, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


class FileHashes:
    """Hashes of files with a memory on disk.

    Parameters
    ----------
    memory : Path
        JSON file with path -> [size, time of change in ns, SHA-256]; read if it is there.
    """

    def __init__(self, memory: Path) -> None:
        self._memory = memory
        self._known: dict[str, list[Any]] = {}
        self._changed = False
        try:
            self._known = dict(read_json(memory))
        except (CaptureEvalError, ValueError, TypeError):
            self._known = {}  # a lost memory costs time, never a wrong answer

    def of_file(self, path: Path) -> str:
        """SHA-256 of one file.

        Raises
        ------
        InputError
            If the file cannot be read.
        """
        try:
            status = path.stat()
        except OSError as error:
            raise InputError(f"{path}: {error.strerror or error}") from None
        entry = self._known.get(str(path))
        if entry is not None and entry[:2] == [status.st_size, status.st_mtime_ns]:
            return str(entry[2])
        digest = sha256_of_file(path)
        self._known[str(path)] = [status.st_size, status.st_mtime_ns, digest]
        self._changed = True
        return digest

    def of_files(self, paths: Iterable[Path]) -> dict[str, str]:
        """SHA-256 by file name."""
        return {path.name: self.of_file(path) for path in paths}

    def save(self) -> None:
        """Write the memory if something was added."""
        if self._changed:
            write_json(self._memory, self._known)
            self._changed = False
