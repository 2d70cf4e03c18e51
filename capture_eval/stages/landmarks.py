"""The work of ``capture-eval landmarks``: pixels of landmarks into the landmarks file, a sheet to find them on."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from capture_eval.errors import InputError, RegistrationError
from capture_eval.files.atomic import atomic_path
from capture_eval.files.colmap_files import read_sparse_model
from capture_eval.files.jpeg_files import read_photo
from capture_eval.files.landmark_files import read_landmark_rows, write_landmark_rows
from capture_eval.files.manifest_files import Capture
from capture_eval.files.mesh_files import read_mesh
from capture_eval.files.photo_files import list_photos
from capture_eval.polygon_mesh import PolygonMesh

if TYPE_CHECKING:
    from capture_eval.cameras import View

logger = logging.getLogger("capture_eval.landmarks")

_SHEET_WIDTH = 900  # pixels of a photo on the sheet


@dataclass(frozen=True)
class Placement:
    """A landmark's pixel in a photo of the neutral pose; photos by name or by number of the sheet."""

    photo: str
    name: str
    pixel: tuple[float, float]


@dataclass(frozen=True)
class LandmarkRequest:
    """What is to change.

    Attributes
    ----------
    define : tuple of (name, template vertex)
        New landmarks.
    place : tuple of Placement
    remove : tuple of (photo or None, name)
        Pixels to take out; None means in all photos.
    detector : str or None
        Fills what has no pixel yet.
    confidence : float
        Detections below it are left out.
    """

    define: tuple[tuple[str, int], ...] = ()
    place: tuple[Placement, ...] = ()
    remove: tuple[tuple[str | None, str], ...] = ()
    detector: str | None = None
    confidence: float = 0.5

    @property
    def changes(self) -> bool:
        """Whether the file is to be written."""
        return bool(self.define or self.place or self.remove or self.detector)


@dataclass(frozen=True)
class LandmarkState:
    """How a landmark stands: photos with a pixel, and how well they agree.

    Attributes
    ----------
    name : str
    photos : int
    known_point : bool
        Given in space, needs no photos.
    error_px : float or None
        Reprojection error; None without cameras.
    problem : str
        Why it cannot be placed; empty if it can or nothing is known.
    """

    name: str
    photos: int
    known_point: bool
    error_px: float | None = None
    problem: str = ""


def place_landmarks_by_hand(
    capture: Capture, request: LandmarkRequest, sheet: Path, result: Path | None = None
) -> list[LandmarkState]:
    """Change the landmarks file of a capture and draw its sheet.

    Parameters
    ----------
    capture : Capture
        With a template and photos of the neutral pose.
    request : LandmarkRequest
    sheet : Path
        The picture (.png, .pdf).
    result : Path, optional
        Folder of a run, for its cameras.

    Raises
    ------
    InputError
        No template or photos, an unknown landmark or photo, a pixel outside its photo; nothing is written then.
    ToolError
        The detector fails.
    """
    template, folder = capture.manifest.template, capture.manifest.poses[0].photos
    if template is None or folder is None:
        raise InputError(f"{capture.path}: landmarks need a template and photos of the first pose")
    path, mesh = capture.resolve(template.landmarks), read_mesh(capture.resolve(template.mesh))
    photos = list_photos(capture.resolve(folder))
    if not photos:
        raise InputError(f"{capture.resolve(folder)}: no photos of the neutral pose")
    rows = read_landmark_rows(path, len(mesh.vertices)) if path.exists() or not request.define else []
    _define(rows, request, len(mesh.vertices), path)
    views = _views(result, capture)
    by_name = {str(row["name"]): row for row in rows}
    _remove(by_name, photos, request)
    _place(by_name, photos, request)
    if request.detector is not None:
        _detect(by_name, photos, request.detector, request.confidence)
    if request.changes:
        write_landmark_rows(path, rows)
    _draw(sheet, mesh, by_name, photos)
    return [_state(row, views) for row in rows]


def _define(rows: list[dict[str, Any]], request: LandmarkRequest, count: int, path: Path) -> None:
    names = {str(row["name"]) for row in rows}
    for name, vertex in request.define:
        if name in names:
            raise InputError(f"{path}: landmark {name} is there already")
        if not 0 <= vertex < count:
            raise InputError(f"landmark {name}: the template has the vertices 0..{count - 1}, not {vertex}")
        rows.append({"name": name, "vertex": vertex, "photos": {}})
        names.add(name)


def _photo(photos: Sequence[Path], asked: str) -> Path:
    """A photo by its file name or its number on the sheet."""
    for path in photos:
        if path.name == asked:
            return path
    if asked.isdigit() and 1 <= int(asked) <= len(photos):
        return photos[int(asked) - 1]
    raise InputError(f"photo {asked} is not among the {len(photos)} of the neutral pose in {photos[0].parent}")


def _row(by_name: dict[str, dict[str, Any]], name: str) -> dict[str, Any]:
    if name not in by_name:
        raise InputError(f"the template has no landmark {name}; it has {', '.join(by_name)} (--define NAME=VERTEX)")
    return by_name[name]


def _marks(row: dict[str, Any]) -> dict[str, Any]:
    """The row's pixels, made if there are none."""
    if not isinstance(row.get("photos"), dict):
        row["photos"] = {}
    marks: dict[str, Any] = row["photos"]
    return marks


def _remove(by_name: dict[str, dict[str, Any]], photos: Sequence[Path], request: LandmarkRequest) -> None:
    for asked, name in request.remove:
        marks = _marks(_row(by_name, name))
        if asked is None:
            marks.clear()
            continue
        photo = _photo(photos, asked).name
        if photo not in marks:
            raise InputError(f"landmark {name} has no pixel in {photo}")
        del marks[photo]


def _place(by_name: dict[str, dict[str, Any]], photos: Sequence[Path], request: LandmarkRequest) -> None:
    sizes: dict[Path, tuple[int, int]] = {}
    for wanted in request.place:
        photo, row = _photo(photos, wanted.photo), _row(by_name, wanted.name)
        if photo not in sizes:
            height, width = read_photo(photo).shape[:2]
            sizes[photo] = (width, height)
        (x, y), (width, height) = wanted.pixel, sizes[photo]
        if not (0 <= x <= width and 0 <= y <= height):
            raise InputError(f"{photo}: {wanted.name}={x:g},{y:g} lies outside the photo of {width}x{height}")
        _marks(row)[photo.name] = [round(x, 3), round(y, 3)]


def _detect(by_name: dict[str, dict[str, Any]], photos: Sequence[Path], name: str, confidence: float) -> None:
    """Fill what has no pixel; what a person has placed stays."""
    from capture_eval.registration.landmark_detectors import detect_landmarks, load_detector

    detector = load_detector(name)
    added, foreign = 0, set[str]()
    for number, photo in enumerate(photos, start=1):
        found = detect_landmarks(detector, read_photo(photo), f"landmark detector '{name}', {photo.name}")
        for mark, detection in found.items():
            if mark not in by_name:
                foreign.add(mark)
            elif detection.confidence >= confidence and photo.name not in _marks(by_name[mark]):
                _marks(by_name[mark])[photo.name] = [round(value, 3) for value in detection.pixel]
                added += 1
        logger.info("landmarks: %d/%d photos", number, len(photos))
    if foreign:
        names = ", ".join(sorted(foreign)[:5]) + (", …" if len(foreign) > 5 else "")
        logger.warning("the template has no landmarks for %d names of the detector: %s", len(foreign), names)
    if not added:
        raise InputError(f"landmark detector '{name}' added no landmark of the template in {len(photos)} photos")


def _views(result: Path | None, capture: Capture) -> dict[str, View]:
    if result is None:
        return {}
    return dict(read_sparse_model(result / "work" / capture.manifest.pose_names[0] / "sparse").views)


def _state(row: dict[str, Any], views: dict[str, View]) -> LandmarkState:
    from capture_eval.registration.landmark_triangulation import triangulate_point

    name, marks, known = str(row["name"]), row.get("photos") or {}, row.get("point") is not None
    if known or not views or len(marks) < 2:
        problem = "" if known or len(marks) >= 2 else "needs 2 photos or more"
        return LandmarkState(name, len(marks), known, None, problem)
    try:
        found = triangulate_point(views, {photo: np.array(pixel, dtype=np.float64) for photo, pixel in marks.items()})
    except RegistrationError as error:
        return LandmarkState(name, len(marks), known, None, str(error))
    left_out = len([photo for photo in marks if photo in views]) - len(found.photos)
    problem = f"{left_out} of its photos disagree and are left out" if left_out else ""
    return LandmarkState(name, len(marks), known, found.reprojection_error, problem)


def _draw(sheet: Path, mesh: PolygonMesh, by_name: dict[str, dict[str, Any]], photos: Sequence[Path]) -> None:
    from capture_eval.report.landmark_sheet import SheetPhoto, draw_landmark_sheet

    pictures = []
    for number, path in enumerate(photos, start=1):
        image = read_photo(path)
        marks = {
            name: row["photos"][path.name] for name, row in by_name.items() if path.name in (row.get("photos") or {})
        }
        size = (image.shape[1], image.shape[0])
        pictures.append(SheetPhoto(number, path.name, _small(image), size, marks))
    landmarks = {name: int(row["vertex"]) for name, row in by_name.items()}
    figure = draw_landmark_sheet(mesh.vertices, mesh.triangles()[0], landmarks, pictures)
    kind = sheet.suffix[1:].lower()
    quick: Any = {"pil_kwargs": {"compress_level": 2}} if kind == "png" else {}  # photos hardly get smaller
    sheet.parent.mkdir(parents=True, exist_ok=True)
    with atomic_path(sheet) as temporary:
        figure.savefig(temporary, format=kind, dpi=120, **quick)


def _small(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    from PIL import Image

    if image.shape[1] <= _SHEET_WIDTH:
        return image
    height = round(image.shape[0] * _SHEET_WIDTH / image.shape[1])
    return np.asarray(Image.fromarray(image).resize((_SHEET_WIDTH, height), Image.Resampling.LANCZOS))
