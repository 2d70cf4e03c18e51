"""Whether photos of a set are sharp, well exposed, of one size and each there once.

Facts are measured per photo, then judged within the set of a pose: what is normal for skin, lens and backdrop is what
the other photos show.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

T = TypeVar("T")

FEWEST_PHOTOS = 3  # two views have no third to confirm them
ADVISED_PHOTOS = 8  # about 15 degrees between neighbours over the front of a face
SHARPNESS_SHARE = 0.3  # of the set's median; rendered heads spread by .7-1.3, a Gaussian blur of 2 px leaves .1
SOFTNESS_LIMIT = 0.3  # .11-.17 for sharp and slightly soft photos, .34-.39 blurred by 3 px
DARKEST_WHITE = 40.0  # grey level: even the lightest twentieth of the photo is darker than this
LIGHTEST_BLACK = 215.0  # grey level: even the darkest twentieth of the photo is lighter than this
BRIGHTNESS_STEP = 60.0  # grey levels between a photo's mean and the set's median
THUMBNAIL = (32, 24)
SAME_PICTURE = 0.4  # mean difference of thumbnails in grey levels; neighbours 10 degrees apart differ by more than 2
LIKENESS_SHARE = 0.25  # of the set's median overlap of colour histograms


@dataclass(frozen=True)
class PhotoFacts:
    """What was measured on one photo.

    Attributes
    ----------
    name : str
        File name.
    width, height : int
        Pixels.
    sharpness : float
        Variance of the Laplacian after a Gaussian of 1 px (which keeps sensor noise out), grey levels squared.
    softness : float
        The same after 4 px divided by that after 2 px: near 0.1 when there is fine detail, higher when blurred.
    brightness, dark, light : float
        Mean, 5th and 95th percentile of the grey levels, 0 to 255.
    digest : str
        Hash of the file.
    thumbnail : (24, 32) float32
        Grey levels of a small version.
    colours : (512,) float64
        Histogram over 8 x 8 x 8 colours, sum 1.
    camera : str
        Make, model and focal length from EXIF, empty without.
    """

    name: str
    width: int
    height: int
    sharpness: float
    softness: float
    brightness: float
    dark: float
    light: float
    digest: str
    thumbnail: NDArray[np.float32]
    colours: NDArray[np.float64]
    camera: str = ""


def measure_photo(name: str, image: NDArray[np.uint8], digest: str, camera: str = "") -> PhotoFacts:
    """Measure one photo.

    Parameters
    ----------
    name : str
        File name.
    image : (H, W, 3) uint8
        RGB.
    digest : str
        Hash of the file.
    camera : str
        Make, model and focal length from EXIF.
    """
    import cv2

    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY).astype(np.float32)
    detail = [_detail(grey, sigma) for sigma in (1.0, 2.0, 4.0)]
    dark, light = np.percentile(grey, [5, 95])
    codes = (image >> 5).reshape(-1, 3).astype(np.int64) @ np.array([64, 8, 1])
    return PhotoFacts(
        name=name,
        width=image.shape[1],
        height=image.shape[0],
        sharpness=detail[0],
        softness=detail[2] / max(detail[1], 1e-9),
        brightness=float(grey.mean()),
        dark=float(dark),
        light=float(light),
        digest=digest,
        thumbnail=np.asarray(cv2.resize(grey, THUMBNAIL, interpolation=cv2.INTER_AREA), dtype=np.float32),
        colours=np.bincount(codes, minlength=512) / codes.size,
        camera=camera,
    )


def _detail(grey: NDArray[np.float32], sigma: float) -> float:
    import cv2

    return float(cv2.Laplacian(cv2.GaussianBlur(grey, (0, 0), sigma), cv2.CV_32F).var())


def judge_pose(facts: Sequence[PhotoFacts]) -> list[tuple[str, str]]:
    """What is wrong with the readable photos of one pose.

    Returns
    -------
    list of (photo name, what is wrong with it)
        The name is empty for what concerns the set.
    """
    problems: list[tuple[str, str]] = []
    if len(facts) < FEWEST_PHOTOS:
        problems.append(
            ("", f"too few readable photos: {len(facts)}; at least {FEWEST_PHOTOS} are needed, 15 to 30 advised")
        )
    elif len(facts) < ADVISED_PHOTOS:
        problems.append(("", f"only {len(facts)} readable photos; {ADVISED_PHOTOS} or more are advised"))
    if not facts:
        return problems
    problems += _judge_sharpness(facts) + _judge_exposure(facts)
    return problems + _judge_copies(facts) + _judge_likeness(facts)


def _judge_sharpness(facts: Sequence[PhotoFacts]) -> list[tuple[str, str]]:
    usual = float(np.median([fact.sharpness for fact in facts]))
    problems = []
    for fact in facts:
        if fact.sharpness < SHARPNESS_SHARE * usual:
            problems.append((fact.name, f"blurred: {fact.sharpness / usual:.0%} of the sharpness usual in this pose"))
        elif fact.softness > SOFTNESS_LIMIT:
            problems.append((fact.name, f"blurred: no detail finer than 2 pixels (softness {fact.softness:.2f})"))
    return problems


def _judge_exposure(facts: Sequence[PhotoFacts]) -> list[tuple[str, str]]:
    usual = float(np.median([fact.brightness for fact in facts]))
    problems = []
    for fact in facts:
        step = fact.brightness - usual
        if fact.light < DARKEST_WHITE or step < -BRIGHTNESS_STEP:
            problems.append(
                (fact.name, f"under-exposed: mean grey level {fact.brightness:.0f}, usual here {usual:.0f}")
            )
        elif fact.dark > LIGHTEST_BLACK or step > BRIGHTNESS_STEP:
            problems.append((fact.name, f"over-exposed: mean grey level {fact.brightness:.0f}, usual here {usual:.0f}"))
    return problems


def _judge_copies(facts: Sequence[PhotoFacts]) -> list[tuple[str, str]]:
    problems = []
    for index, fact in enumerate(facts):
        for earlier in facts[:index]:
            if fact.digest == earlier.digest:
                problems.append((fact.name, f"the same file as {earlier.name}"))
                break
            if float(np.mean(np.abs(fact.thumbnail - earlier.thumbnail))) < SAME_PICTURE:
                problems.append(
                    (fact.name, f"the same picture as {earlier.name}; a second shot from one place adds nothing")
                )
                break
    return problems


def _judge_likeness(facts: Sequence[PhotoFacts]) -> list[tuple[str, str]]:
    if len(facts) < ADVISED_PHOTOS:
        return []
    usual_colours = np.median([fact.colours for fact in facts], axis=0)
    overlap = np.array([np.minimum(fact.colours, usual_colours).sum() for fact in facts])
    unlike = overlap < LIKENESS_SHARE * np.median(overlap)
    return [
        (fact.name, "colours unlike all other photos of this pose; a photo of something else?")
        for fact, odd in zip(facts, unlike, strict=True)
        if odd
    ]


def judge_capture(poses: Mapping[str, Sequence[PhotoFacts]], shared_camera: bool) -> list[tuple[str, str, str]]:
    """What is wrong between photos of different poses.

    Parameters
    ----------
    poses : mapping of pose name to facts
    shared_camera : bool
        Whether the manifest says that all photos come from one camera and lens setting.

    Returns
    -------
    list of (pose, photo name, what is wrong)
    """
    problems = []
    rows = [(pose, fact) for pose, facts in poses.items() for fact in facts]
    if not rows:
        return []
    first_seen: dict[str, str] = {}
    for pose, fact in rows:
        before = first_seen.setdefault(fact.digest, pose)
        if before != pose:
            problems.append((pose, fact.name, f"the same file as a photo of {before}"))
    usual_size = _most_common((fact.width, fact.height) for _, fact in rows)
    for pose, fact in rows:
        if (fact.width, fact.height) != usual_size:
            text = f"is {fact.width}x{fact.height}, most photos are {usual_size[0]}x{usual_size[1]}"
            problems.append((pose, fact.name, text))
    if shared_camera:
        usual_camera = _most_common(fact.camera for _, fact in rows)
        for pose, fact in rows:
            if fact.camera != usual_camera:
                text = f"EXIF says {fact.camera or 'nothing'}, most photos {usual_camera or 'nothing'}"
                problems.append((pose, fact.name, f"{text}; set camera.shared_intrinsics: false or take it out"))
    return problems


def _most_common(values: Iterable[T]) -> T:
    return Counter(values).most_common(1)[0][0]
