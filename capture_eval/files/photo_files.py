"""The photos of a pose: which files of a folder they are."""

from __future__ import annotations

from pathlib import Path

from capture_eval.errors import InputError

PHOTO_SUFFIXES = frozenset({".jpg", ".jpeg", ".png", ".tif", ".tiff", ".bmp"})
CAMERA_RAW_SUFFIXES = frozenset({".heic", ".heif", ".cr2", ".cr3", ".nef", ".arw", ".dng", ".raf", ".orf", ".rw2"})


def list_photos(folder: Path) -> list[Path]:
    """Photos of a folder by name; files of other kinds and hidden files are left out.

    Raises
    ------
    InputError
        If the folder is missing or cannot be read.
    """
    return [path for path in _entries(folder) if path.suffix.lower() in PHOTO_SUFFIXES]


def list_unsupported_photos(folder: Path) -> list[Path]:
    """Files that are photos in a format the suite does not read (camera raw, HEIC)."""
    return [path for path in _entries(folder) if path.suffix.lower() in CAMERA_RAW_SUFFIXES]


def _entries(folder: Path) -> list[Path]:
    try:
        entries = sorted(folder.iterdir(), key=lambda path: path.name)
    except OSError as error:
        raise InputError(f"{folder}: {error.strerror or error}") from None
    return [path for path in entries if not path.name.startswith(".") and path.is_file()]
