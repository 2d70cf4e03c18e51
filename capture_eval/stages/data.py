"""Data sets by name: which there are, and how their files come into the cache with their hashes checked."""

from __future__ import annotations

import hashlib
import os
import shutil
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any

import capture_eval
from capture_eval.errors import InputError, ToolError
from capture_eval.files.atomic import atomic_path
from capture_eval.files.manifest_files import read_yaml

CACHE_VARIABLE = "CAPTURE_EVAL_DATA"
KINDS = ("embedded", "files")


@dataclass(frozen=True)
class DataSet:
    """A data set as its manifest describes it.

    Attributes
    ----------
    name, kind, title, licence : str
        Kind is `embedded` (made by the suite) or `files`.
    base_url : str
        Address that the files' paths are appended to.
    files : mapping of relative path to SHA-256
    """

    name: str
    kind: str
    title: str
    licence: str
    base_url: str = ""
    files: dict[str, str] = field(default_factory=dict)


def manifest_folder() -> Path:
    """Folder with the manifests of data sets: inside the installed package, or beside it in a checkout.

    Raises
    ------
    ToolError
        If there is neither.
    """
    package = Path(capture_eval.__file__).parent
    for folder in (package / "data_manifests", package.parent / "data_manifests"):
        if folder.is_dir():
            return folder
    raise ToolError(f"{package}: no data_manifests folder in or beside the package; install it again")


def list_data_sets() -> list[DataSet]:
    """All data sets that have a manifest."""
    found = []
    for path in sorted(manifest_folder().glob("*.yaml")):
        content = read_yaml(path)
        if isinstance(content, dict) and content.get("kind") in KINDS:
            found.append(_parse(content, path))
    return found


def _parse(content: dict[str, Any], path: Path) -> DataSet:
    files = {str(name): str(digest) for name, digest in (content.get("files") or {}).items()}
    for name in files:
        parts = PurePosixPath(name).parts
        if not parts or ".." in parts or PurePosixPath(name).is_absolute():
            raise InputError(f"{path}: files: {name!r} leaves the data set's folder")
    return DataSet(
        name=str(content["name"]),
        kind=str(content["kind"]),
        title=str(content.get("title", content["name"])),
        licence=str(content.get("licence", "")),
        base_url=str(content.get("base_url", "")),
        files=files,
    )


def data_set(name: str) -> DataSet:
    """A data set by name.

    Raises
    ------
    InputError
        If there is none of that name; lists those there are.
    """
    known = list_data_sets()
    for found in known:
        if found.name == name:
            return found
    raise InputError(f"no data set {name!r}; there are {', '.join(item.name for item in known)}")


def cache_folder() -> Path:
    """Where data sets are kept: $CAPTURE_EVAL_DATA, or the user's cache folder."""
    import pooch

    chosen = os.environ.get(CACHE_VARIABLE)
    return Path(chosen) if chosen else Path(pooch.os_cache("capture_eval")) / "data"


def data_set_folder(name: str) -> Path | None:
    """Folder of a data set in the cache if all its files are there, else None."""
    wanted = data_set(name)
    folder = cache_folder() / name
    return folder if wanted.files and all((folder / relative).is_file() for relative in wanted.files) else None


def fetch_data_set(
    name: str, source: Path | None = None, progress: Callable[[int, int], None] | None = None
) -> tuple[Path, int]:
    """Bring the files of a data set into the cache; files that are there with the right hash are kept.

    Parameters
    ----------
    name : str
        Name of the data set.
    source : Path, optional
        Take the files from this folder instead of their address.
    progress : callable, optional
        Called with (files done, files in all).

    Returns
    -------
    (Path, int)
        Folder of the data set in the cache, and the number of files that had to be brought.

    Raises
    ------
    InputError
        Unknown data set, or a file of the folder is missing or another one.
    ToolError
        A download failed.
    """
    wanted = data_set(name)
    folder = cache_folder() / name
    brought = 0
    for done, (relative, digest) in enumerate(wanted.files.items()):
        target = folder / relative
        if not (target.is_file() and _digest(target) == digest):
            if source is None:
                _download(wanted, relative, target)
            else:
                _copy(source / relative, target, digest)
            brought += 1
        if progress is not None:
            progress(done + 1, len(wanted.files))
    return folder, brought


def _copy(source: Path, target: Path, digest: str) -> None:
    if not source.is_file():
        raise InputError(f"{source}: no such file; --from needs the folder that holds the data set's paths")
    if _digest(source) != digest:
        raise InputError(f"{source}: SHA-256 differs from the data set's manifest; it is another version")
    with atomic_path(target) as temporary:
        shutil.copyfile(source, temporary)


def _download(wanted: DataSet, relative: str, target: Path) -> None:
    import pooch

    target.parent.mkdir(parents=True, exist_ok=True)
    address = wanted.base_url + relative
    pooch.get_logger().setLevel("WARNING")
    try:
        pooch.retrieve(address, known_hash=f"sha256:{wanted.files[relative]}", fname=target.name, path=target.parent)
    except Exception as error:  # whatever the network stack raises, it is one failed download
        hint = f"without a network use `capture-eval data fetch {wanted.name} --from FOLDER`"
        raise ToolError(f"{address}: could not be fetched ({type(error).__name__}); {hint}") from error


def _digest(path: Path) -> str:
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
