"""The photos part of `validate`: open every photo and mask of a capture once and judge them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from capture_eval.errors import InputError
from capture_eval.files.photo_files import list_photos, list_unsupported_photos
from capture_eval.images.photo_checks import PhotoFacts, judge_capture, judge_pose, measure_photo

if TYPE_CHECKING:
    from PIL import Image

    from capture_eval.files.manifest_files import Capture, PoseEntry

LARGEST_PIXELS = 300_000_000
SMALLEST_SIDE = 64
FALSE_SIZE_TAGS = {40962: 0, 40963: 1}  # EXIF PixelXDimension, PixelYDimension -> index in the size
ORIENTATION_TAG, MAKE_TAG, MODEL_TAG, EXIF_FOLDER, FOCAL_TAG = 0x0112, 0x010F, 0x0110, 0x8769, 37386


@dataclass(frozen=True)
class Problem:
    """One thing wrong with an input.

    Attributes
    ----------
    where : str
        File, or manifest and key.
    text : str
        What is wrong and what to do.
    fatal : bool
        Whether `run` cannot start with it; others it reports and works around.
    """

    where: str
    text: str
    fatal: bool = False

    def __str__(self) -> str:
        return f"{self.where}: {self.text}"


def validate_photos(capture: Capture, progress: Callable[[int, int], None] | None = None) -> list[Problem]:
    """Open all photos and masks of a capture.

    Parameters
    ----------
    capture : Capture
        The manifest and its folder; its source is not `meshes`.
    progress : callable, optional
        Called with (photos done, photos in all).
    """
    problems: list[Problem] = []
    folders: dict[str, Path] = {}
    photos: dict[str, list[Path]] = {}
    for pose in capture.manifest.poses:
        folders[pose.pose_name] = capture.resolve(pose.photos or "")
        try:
            photos[pose.pose_name] = list_photos(folders[pose.pose_name])
            raw = list_unsupported_photos(folders[pose.pose_name])
        except InputError as error:
            problems.append(Problem(f"pose {pose.pose_name} (t = {pose.t:g})", f"no photos: {error}", fatal=True))
            continue
        if raw:
            problems.append(
                Problem(str(raw[0]), f"camera raw or HEIC ({len(raw)} such files); convert to JPEG, PNG or TIFF")
            )
    total, done = sum(len(paths) for paths in photos.values()), 0
    facts: dict[str, list[PhotoFacts]] = {}
    for pose in capture.manifest.poses:
        name = pose.pose_name
        if name not in photos:
            continue
        facts[name] = []
        for path in photos[name]:
            fact, found = inspect_photo(path)
            problems += found
            if fact is not None:
                facts[name].append(fact)
                problems += _validate_mask(capture, pose, path, (fact.width, fact.height))
            done += 1
            if progress is not None:
                progress(done, total)
        fatal = pose.t == 0.0 and len(facts[name]) < 3
        for photo, text in judge_pose(facts[name]):
            where = folders[name] / photo if photo else folders[name]
            problems.append(Problem(str(where), text, fatal and not photo))
    for name, photo, text in judge_capture(facts, capture.manifest.camera.shared_intrinsics):
        problems.append(Problem(str(folders[name] / photo), text))
    return problems


def inspect_photo(path: Path) -> tuple[PhotoFacts | None, list[Problem]]:
    """Decode one photo completely; facts are None when that is not possible."""
    from PIL import Image

    where = str(path)
    if path.stat().st_size == 0:
        return None, [Problem(where, "empty file (0 bytes)")]
    Image.MAX_IMAGE_PIXELS = None  # the limit below is ours, and says what it is
    try:
        with Image.open(path) as image:
            if image.width * image.height > LARGEST_PIXELS:
                return None, [
                    Problem(
                        where, f"{image.width}x{image.height} pixels; shrink it below {LARGEST_PIXELS / 1e6:g} million"
                    )
                ]
            if min(image.size) < SMALLEST_SIDE:
                return None, [Problem(where, f"{image.width}x{image.height} pixels is too small for a photo")]
            image.load()
            camera, problems = _read_exif(image, where)
            pixels = np.asarray(image.convert("RGB"))
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError, MemoryError) as error:
        reason = "truncated" if "truncated" in str(error) else "not a readable image"
        return None, [Problem(where, f"{reason}; copy it again from the camera")]
    return measure_photo(path.name, pixels, _digest(path), camera), problems


def _digest(path: Path) -> str:
    import hashlib

    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _read_exif(image: Image.Image, where: str) -> tuple[str, list[Problem]]:
    """Make, model and focal length, and what EXIF says against the picture itself."""
    problems = []
    try:
        exif = image.getexif()
        details: dict[int, Any] = dict(exif.get_ifd(EXIF_FOLDER))
    except (OSError, ValueError, SyntaxError, KeyError, TypeError):
        return "", [Problem(where, "EXIF cannot be read; save the photo again without it")]
    for tag, axis in FALSE_SIZE_TAGS.items():
        said = details.get(tag)
        if isinstance(said, int) and said not in (0, image.size[axis]):
            side = ("wide", "high")[axis]
            problems.append(
                Problem(
                    where,
                    f"EXIF says {said} pixels {side}, the picture has {image.size[axis]}; was it cropped or resized?",
                )
            )
            break
    orientation = exif.get(ORIENTATION_TAG, 1)
    if orientation not in (0, 1):
        problems.append(
            Problem(
                where, f"EXIF orientation is {orientation}; turn the pixels themselves (e.g. jpegtran, exiftran -a)"
            )
        )
    words = [str(exif[tag]).strip("\0 ") for tag in (MAKE_TAG, MODEL_TAG) if exif.get(tag)]
    try:
        focal = float(details[FOCAL_TAG])
        if not focal > 0:
            problems.append(Problem(where, f"EXIF focal length is {focal:g} mm; take it out"))
        words.append(f"{focal:g} mm")
    except (KeyError, TypeError, ValueError, ZeroDivisionError):
        pass
    return " ".join(words), problems


def _validate_mask(capture: Capture, pose: PoseEntry, photo: Path, size: tuple[int, int]) -> list[Problem]:
    from PIL import Image

    if pose.masks is None:
        return []
    folder = capture.resolve(pose.masks)
    found = next((p for p in (folder / f"{photo.name}.png", folder / f"{photo.stem}.png") if p.is_file()), None)
    if found is None:
        return [Problem(str(folder / f"{photo.stem}.png"), f"no mask for {photo.name}")]
    try:
        with Image.open(found) as mask:
            mask.load()
            mask_size, empty = mask.size, not np.asarray(mask.convert("L")).any()
    except (OSError, ValueError, SyntaxError):
        return [Problem(str(found), "not a readable image", fatal=True)]
    if mask_size != size:
        text = f"mask is {mask_size[0]}x{mask_size[1]}, its photo {size[0]}x{size[1]}"
        return [Problem(str(found), text, fatal=True)]
    return [Problem(str(found), "mask leaves nothing of the photo (all black)")] if empty else []
