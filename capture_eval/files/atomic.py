"""Files that are either whole or not there: written under a temporary name, then renamed."""

import json
import os
import uuid
import zipfile
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture_eval.errors import InputError

_ZIP_LARGE = 2_000_000_000  # bytes from which on a member's sizes need eight bytes each, headers included


@contextmanager
def atomic_path(path: Path) -> Iterator[Path]:
    """A temporary path in the folder of ``path`` (same suffix) that becomes ``path`` when the block ends well."""
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.parent / f".{path.stem}.{os.getpid()}.{uuid.uuid4().hex[:8]}.tmp{path.suffix}"
    try:
        yield temporary
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write UTF-8 text with Unix line ends."""
    write_bytes(path, text.encode("utf-8"))


def write_bytes(path: Path, content: bytes) -> None:
    """Write bytes."""
    with atomic_path(path) as temporary:
        temporary.write_bytes(content)


def write_json(path: Path, value: Any) -> None:
    """Write JSON with two-space indents; numbers that are not finite are refused (use None)."""
    write_text(path, json.dumps(value, indent=2, allow_nan=False, ensure_ascii=False) + "\n")


def read_json(path: Path) -> Any:
    """Read JSON.

    Raises
    ------
    InputError
        The file is missing or not JSON.
    """
    try:
        return json.loads(Path(path).read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, json.JSONDecodeError) as error:
        raise InputError(f"{path}: cannot be read as JSON ({error})") from error


Arrays = Mapping[str, NDArray[Any]] | Iterable[tuple[str, NDArray[Any]]]


def write_npz(path: Path, arrays: Arrays) -> None:
    """Write arrays compressed; equal arrays give equal bytes (np.savez stores the time of day).

    Parameters
    ----------
    path : Path
        File to write, whole or not at all.
    arrays : mapping of name to array, or iterable of (name, array)
        Compressed some megabytes at a time, without a copy of the whole. An iterable is asked for the next array when
        the one before is written, so that arrays that are made for the file need not exist together.
    """
    items = arrays.items() if isinstance(arrays, Mapping) else arrays
    with (
        atomic_path(path) as temporary,
        zipfile.ZipFile(temporary, "w", zipfile.ZIP_DEFLATED, compresslevel=4) as archive,
    ):
        for name, array in items:
            content = np.asanyarray(array)
            large = content.nbytes > _ZIP_LARGE
            # opened by its name, a member has the earliest date that zip knows, whatever the time
            with archive.open(f"{name}.npy", "w", force_zip64=large) as stream:
                np.lib.format.write_array(stream, content, allow_pickle=False)
            del array, content  # before the next one is made


def read_npz(path: Path) -> dict[str, NDArray[Any]]:
    """Read all arrays of an npz file; pickles are refused.

    Raises
    ------
    InputError
        The file is missing, damaged, or holds a pickle.
    """
    try:
        with np.load(path, allow_pickle=False) as archive:
            return {name: archive[name] for name in archive.files}
    except (OSError, ValueError, zipfile.BadZipFile, KeyError, EOFError) as error:
        raise InputError(f"{path}: cannot be read as npz without pickles ({error})") from error
