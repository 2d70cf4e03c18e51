"""What went into a result: hashes of all inputs, tools, and what the report says about the capture."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

from capture_eval.errors import InputError
from capture_eval.files.atomic import write_json
from capture_eval.files.manifest_files import named_paths
from capture_eval.stages.check import INPUTS_FILE
from capture_eval.workflow.file_hashes import FileHashes, sha256_of_value
from capture_eval.workflow.stage_options import OPTION_CLASSES, stage_options

if TYPE_CHECKING:
    from capture_eval.files.manifest_files import Capture

TOOLS = ("numpy", "scipy", "pycolmap", "pycolmap-cuda12", "open3d", "pymeshlab", "opencv-python-headless")
LONGEST_LIST = 16  # values of an option that a row of a table can show


def hash_memory(out: Path) -> FileHashes:
    """The remembered hashes of a result folder."""
    return FileHashes(out / "work" / "hashes.json")


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


def write_inputs(capture: Capture, out: Path) -> None:
    """Write `work/inputs.json`: names of poses, hashes of inputs, versions of tools.

    Raises
    ------
    InputError
        If an input cannot be read.
    """
    hashes = hash_memory(out)
    content = {
        "name": capture.manifest.name,
        "poses": capture.manifest.pose_names,
        "files": input_hashes(capture, hashes),
        "tools": {name: version for name in TOOLS if (version := _version(name)) is not None},
    }
    hashes.save()
    write_json(out / INPUTS_FILE, content)


def _version(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def effective_options(capture: Capture) -> dict[str, dict[str, Any]]:
    """Every option of every stage as a run uses it, nested ones with dots; no paths, threads or long lists."""
    return {
        stage: {
            name: value
            for name, value in _flat(dataclasses.asdict(stage_options(capture, stage))).items()
            if name.rpartition(".")[2] != "threads" and _is_short(value)
        }
        for stage in OPTION_CLASSES
    }


def _flat(values: Mapping[str, Any], before: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for name, value in values.items():
        flat |= _flat(value, f"{before}{name}.") if isinstance(value, Mapping) else {f"{before}{name}": value}
    return flat


def _is_short(value: Any) -> bool:
    """Whether a value belongs into a table: what a manifest names by a file is told by the file's hash."""
    if isinstance(value, list | tuple):
        return len(value) <= LONGEST_LIST and all(_is_short(part) for part in value)
    return value is None or isinstance(value, str | bool | int | float)


def report_info(capture: Capture, out: Path) -> dict[str, Any]:
    """What the report says about a capture: names, times, photo folders, options, hashes, terms."""
    manifest = capture.manifest
    return {
        "name": manifest.name,
        "description": manifest.description,
        "source": manifest.source,
        "poses": [
            {
                "name": pose.pose_name,
                "t": pose.t,
                "photos": None if pose.photos is None else str(capture.resolve(pose.photos)),
            }
            for pose in manifest.poses
        ],
        "options": effective_options(capture),
        "hashes": input_hashes(capture, hash_memory(out)),
        "terms": {} if manifest.terms is None else manifest.terms.model_dump(exclude_none=True),
    }
