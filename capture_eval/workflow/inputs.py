"""What went into a result: hashes of all inputs, tools, and what the report says about the capture."""

from __future__ import annotations

from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

from capture_eval.errors import InputError
from capture_eval.files.atomic import write_json
from capture_eval.files.manifest_files import named_paths
from capture_eval.stages.check import INPUTS_FILE
from capture_eval.workflow.file_hashes import FileHashes, sha256_of_value

if TYPE_CHECKING:
    from capture_eval.files.manifest_files import Capture

TOOLS = ("numpy", "scipy", "pycolmap", "pycolmap-cuda12", "open3d", "pymeshlab", "opencv-python-headless")


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
        "options": manifest.options,
        "hashes": input_hashes(capture, hash_memory(out)),
        "terms": {} if manifest.terms is None else manifest.terms.model_dump(exclude_none=True),
    }
