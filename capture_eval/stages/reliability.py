"""Which registered poses are not to be believed, and why: the checks of the register stage with what is on disk."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture_eval.errors import InputError, RegistrationError
from capture_eval.files.atomic import read_json
from capture_eval.registration.reliability import (
    PoseEvidence,
    ReliabilityOptions,
    coverage_faults,
    evidence_faults,
    exchanged_poses,
)
from capture_eval.stages.register_options import RegisterOptions

logger = logging.getLogger("capture_eval.register")

_TRUSTED = 0.5


def believed(pose_name: str, evidence: PoseEvidence, options: ReliabilityOptions) -> None:
    """Pass a pose whose skin was measured.

    Raises
    ------
    RegistrationError
        Says what the photos do not agree on.
    """
    faults = evidence_faults(evidence, options)
    if faults:
        raise RegistrationError(f"{pose_name} is not to be believed: {'; '.join(faults)}")


def pose_doubts(
    work: Path,
    pose_names: Sequence[str],
    vertices: NDArray[np.float64],
    confidence: NDArray[np.float64],
    seen: NDArray[np.bool_],
    ok: NDArray[np.bool_],
    options: RegisterOptions,
) -> list[list[str]]:
    """Doubts about each pose in words, an empty list for a good one; failed poses have their reason elsewhere.

    Parameters
    ----------
    vertices : (P, V, 3) float64
    confidence : (P, V) float64
    seen : (P, V) bool
    ok : (P,) bool
    """
    photos = [_photos_placed(work / name) for name in pose_names]
    known = [count for count, good in zip(photos, ok, strict=True) if good and count is not None]
    typical = float(np.median(known)) if known else None
    doubts: list[list[str]] = [
        coverage_faults(seen[row], seen[0], photos[row], typical, options.reliability) if ok[row] else []
        for row in range(len(pose_names))
    ]
    trusted = np.all(confidence[ok] > _TRUSTED, axis=0)
    for pair in exchanged_poses(vertices, trusted, options.reliability):
        for row, other in ((pair.first, pair.second), (pair.second, pair.first)):
            doubts[row].append(
                f"looks exchanged with {pose_names[other]}: in the other order the steps to and from both are "
                f"{pair.gain:.0%} shorter"
            )
    for name, found in zip(pose_names, doubts, strict=True):
        for text in found:
            logger.warning("%s is doubtful: %s", name, text)
    return doubts


def troubled_poses(out: Path) -> list[str]:
    """One line per pose of a finished registration that failed or is doubtful: its name and why."""
    work = out / "work"
    aligned, tracked, registered = (
        _rows(work / name) for name in ("align/alignment.json", "register/tracking.json", "register/registered.json")
    )
    lines = []
    for pose, row in registered.items():
        if row.get("status") != "ok":
            reasons = _scan_faults(work / pose) + [found.get(pose, {}).get("reason") for found in (aligned, tracked)]
            lines.append(f"{pose} has no result: {next(filter(None, reasons), row.get('reason'))}")
        lines += [f"{pose} is doubtful: {text}" for text in row.get("doubts") or []]
    return lines


def _scan_faults(pose_folder: Path) -> list[str]:
    """What the stages before the registration said against a pose."""
    faults = []
    for stage in ("sparse", "dense", "surface"):
        found = _document(pose_folder / f"{stage}.json")
        if found.get("status") == "failed":
            faults.append(f"{stage}: {found.get('reason')}")
    return faults


def _rows(path: Path) -> dict[str, dict[str, Any]]:
    return {str(row["pose"]): row for row in _document(path).get("poses", [])}


def _document(path: Path) -> dict[str, Any]:
    """What a stage wrote; nothing where it did not run or its file is damaged: the stage that needs it will say so."""
    try:
        found = read_json(path)
    except InputError:
        return {}
    return found if isinstance(found, dict) else {}


def _photos_placed(pose_folder: Path) -> int | None:
    path = pose_folder / "sparse.json"
    if not path.is_file():
        return None
    return int(read_json(path).get("registered") or 0)
