"""The report: figures and the page, drawn from what the other stages saved. Nothing is computed again."""

from __future__ import annotations

import hashlib
import io
import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..files.atomic import write_bytes, write_text
from ..report import (
    capture_figures,
    error_bar_figures,
    error_figures,
    face_figures,
    figure_style,
    head_axes,
    interactive,
    page,
    page_tables,
    reconstruction_figures,
    trajectory_figures,
)
from ..report.saved_results import SavedResults
from . import report_inputs, report_photos

if TYPE_CHECKING:
    from matplotlib.figure import Figure

logger = logging.getLogger("capture_eval.report")

_LARGE_PICTURE = 200_000  # bytes
_TOOLS = (
    "numpy",
    "scipy",
    "pycolmap",
    "pycolmap-cuda12",
    "opencv-python-headless",
    "open3d",
    "pymeshlab",
    "numba",
    "matplotlib",
    "plotly",
    "snakemake",
)

Floats = NDArray[np.float64]
Axis = tuple[float, float, float]


@dataclass(frozen=True)
class ReportOptions:
    """How the report is drawn.

    Attributes
    ----------
    up, front
        Rough axes of the template: upwards, and the way the face looks; refined where curves are named by side.
    turn
        Degrees that the camera of the face figures stands to the subject's left.
    front_photo
        File name of the photo that stands for a pose in the contact sheet; by default the one whose camera looks
        most squarely at the face.
    interactive
        Whether the page has the 3D view (about 5 MB of script).
    """

    up: Axis = (0.0, 1.0, 0.0)
    front: Axis = (0.0, 0.0, 1.0)
    turn: float = 28.0
    front_photo: str | None = None
    interactive: bool = True

    def __post_init__(self) -> None:
        for name in ("up", "front"):
            if not np.linalg.norm(getattr(self, name)) > 0.0:
                raise InputError(f"report: {name} is the zero vector")
        if abs(float(np.dot(self.up, self.front))) > 1e-3 * float(np.linalg.norm(self.up) * np.linalg.norm(self.front)):
            raise InputError("report: up and front are not at right angles")

    def facing(self, results: SavedResults) -> ReportOptions:
        """These options with the axes of the head that was captured."""
        up, front = head_axes.find_head_axes(results.curves, self.unit("up"), self.unit("front"))
        return replace(self, up=(up[0], up[1], up[2]), front=(front[0], front[1], front[2]))

    def unit(self, name: str) -> Floats:
        """``up`` or ``front`` as a unit vector."""
        vector = np.array(getattr(self, name), dtype=np.float64)
        return vector / float(np.linalg.norm(vector))


def write_report(out: Path, info: Mapping[str, Any], options: ReportOptions | None = None) -> dict[str, Any]:
    """Draw all figures and the page into ``out/report``.

    Parameters
    ----------
    out
        Folder of the result; ``report/errors.csv``, ``summary.json`` and ``curves.npz`` must be there.
    info
        What the page says about the capture: ``name``; ``description``; ``source``; ``poses``, a list of
        ``{"name", "t", "photos": folder or None}``; ``options``, any values by stage; ``hashes``, SHA-256 by input
        file; ``terms``, licence and consent. All but ``name`` may be missing.
    options
        How it is drawn.

    Returns
    -------
    dict
        ``figures``: names in order; ``page``: size of the page in bytes.

    Raises
    ------
    InputError
        A file of the evaluation is missing or damaged.
    """
    options = options or ReportOptions()
    results = report_inputs.read_results(out, info)
    options = options.facing(results)
    pictures: dict[str, page.Picture] = {}
    for drawing in _drawings(out, info, results, options):
        logger.info("report: %s", drawing.name)
        pictures[drawing.name] = _save_figure(out / "report" / "figures", drawing)
    viewer = None
    if options.interactive:
        viewer = interactive.viewer_payload(results, options.unit("up"), options.unit("front"))
    content = page_tables.page_content(results, info, pictures, viewer, _provenance(out, info))
    text = page.render_page(content)
    write_text(out / "report" / "report.html", text)
    logger.info("report: %s", out / "report" / "report.html")
    return {"figures": list(pictures), "page": len(text.encode("utf-8"))}


@dataclass(frozen=True)
class _Drawing:
    name: str
    title: str
    caption: str
    draw: Callable[[], Figure]


def _drawings(out: Path, info: Mapping[str, Any], results: SavedResults, options: ReportOptions) -> list[_Drawing]:
    return [
        *_error_drawings(results, options),
        *_face_drawings(results, options),
        *_capture_drawings(out, info, results, options),
    ]


def _error_drawings(results: SavedResults, options: ReportOptions) -> list[_Drawing]:
    floor = page_tables.noise_floor(results.summary)
    errors, curves, diameter = results.errors, results.curves, results.diameter
    drawings = [
        _Drawing(
            "errors_per_curve",
            "Errors per curve",
            error_figures.PER_CURVE_CAPTION,
            lambda: error_figures.errors_per_curve(errors),
        ),
        _Drawing(
            "errors_over_time",
            "Errors against t",
            error_figures.OVER_TIME_CAPTION,
            lambda: error_figures.errors_over_time(errors, None if floor is None else floor.mean),
        ),
        _Drawing(
            "error_maps",
            "Errors by curve and t",
            error_figures.ERROR_MAP_CAPTION,
            lambda: error_figures.error_maps(errors),
        ),
    ]
    points = trajectory_figures.choose_points(curves, diameter)
    if points:
        up, front = options.unit("up"), options.unit("front")
        drawings.append(
            _Drawing(
                "trajectories",
                "Paths of skin points",
                trajectory_figures.CAPTION,
                lambda: trajectory_figures.trajectories(curves, points, diameter, up, front),
            )
        )
    return drawings


def _capture_drawings(
    out: Path, info: Mapping[str, Any], results: SavedResults, options: ReportOptions
) -> list[_Drawing]:
    poses, truth, drawings = results.poses, results.truth, []
    photos = report_photos.front_photos(out, info.get("poses", ()), options.front_photo, options.unit("front"))
    if any(photo is not None for photo in photos):
        drawings.append(
            _Drawing(
                "contact_sheet",
                "Photos",
                reconstruction_figures.CONTACT_CAPTION,
                lambda: reconstruction_figures.contact_sheet(poses, photos),
            )
        )
    drawings.extend(_registration_drawings(out, info, results, options))
    if any(pose.stages for pose in poses):
        drawings.append(
            _Drawing(
                "reconstruction_quality",
                "Reconstruction quality",
                reconstruction_figures.QUALITY_CAPTION,
                lambda: reconstruction_figures.reconstruction_quality(poses),
            )
        )
    if truth is not None:
        drawings.append(
            _Drawing(
                "truth_comparison",
                "Photos against known truth",
                reconstruction_figures.TRUTH_CAPTION,
                lambda: reconstruction_figures.truth_comparison(results.errors, truth, poses),
            )
        )
    return drawings


def _face_drawings(results: SavedResults, options: ReportOptions) -> list[_Drawing]:
    faces = results.faces
    if faces is None:
        return []
    up, front, turn, diameter = options.unit("up"), options.unit("front"), options.turn, results.diameter
    drawings = [
        _Drawing(
            "faces",
            "Ground truth and methods side by side",
            face_figures.METHODS_CAPTION,
            lambda: face_figures.faces_by_method(faces, results.curves, diameter, up, front, turn),
        ),
        _Drawing(
            "linear_heat_maps",
            "Whole-face error of geometric linear interpolation",
            face_figures.LINEAR_CAPTION,
            lambda: face_figures.linear_heat_maps(faces, diameter, up, front, turn),
        ),
    ]
    if faces.confidence is not None:
        drawings.append(
            _Drawing(
                "tracking_confidence",
                "Tracking confidence",
                face_figures.CONFIDENCE_CAPTION,
                lambda: face_figures.confidence_map(faces, up, front),
            )
        )
    if faces.error_bar is not None:
        drawings.append(
            _Drawing(
                "error_bars",
                "Error bars",
                error_bar_figures.CAPTION,
                lambda: error_bar_figures.error_bar_map(faces, diameter, up, front),
            )
        )
    return drawings


def _registration_drawings(
    out: Path, info: Mapping[str, Any], results: SavedResults, options: ReportOptions
) -> list[_Drawing]:
    faces, truth, drawings = results.faces, results.truth, []
    if faces is None:
        return []
    good = np.flatnonzero(faces.pose_ok)
    rows = sorted({int(good[0]), int(good[len(good) // 2]), int(good[-1])})
    poses = info.get("poses", ())
    photos = []
    if len(poses) == len(faces.t):
        photos = report_photos.placed_photos(out, poses, rows, options.front_photo, options.unit("front"))
    if photos:
        drawings.append(
            _Drawing(
                "mesh_over_photos",
                "Registered mesh over photos",
                capture_figures.OVERLAY_CAPTION,
                lambda: capture_figures.mesh_over_photos(
                    [photo.image for photo in photos],
                    [photo.view for photo in photos],
                    [faces.vertices[photo.row] for photo in photos],
                    faces.triangles,
                    faces.edges,
                    [f"t = {faces.t[photo.row]:.3g}" for photo in photos],
                ),
            )
        )
    places = None if truth is None else truth.places
    if places is not None and places.shape == faces.vertices.shape:
        drawings.append(
            _Drawing(
                "tracking_error",
                "Tracking error on the face",
                capture_figures.DRIFT_CAPTION,
                lambda: face_figures.tracking_error_maps(
                    faces, places, rows, results.diameter, options.unit("up"), options.unit("front")
                ),
            )
        )
    return drawings


def _save_figure(folder: Path, drawing: _Drawing) -> page.Picture:
    """Write a figure as PNG and PDF without dates, so that equal results give equal bytes."""
    with figure_style.paper_style():
        figure = drawing.draw()
        picture, document = io.BytesIO(), io.BytesIO()
        figure.savefig(picture, format="png", metadata={"Software": None})
        figure.set_layout_engine("none")  # laid out by now; to do it again for the PDF would only cost time
        figure.savefig(
            document,
            format="pdf",
            metadata={"CreationDate": None, "Creator": None, "Producer": None, "Title": drawing.title},
        )
        width, height = (round(length * figure_style.RASTER_DPI) for length in figure.get_size_inches())
    write_bytes(folder / f"{drawing.name}.png", picture.getvalue())
    write_bytes(folder / f"{drawing.name}.pdf", document.getvalue())
    kind, image = _for_page(picture.getvalue())
    return page.Picture(drawing.name, drawing.title, drawing.caption, image, kind, width, height)


def _for_page(png: bytes) -> tuple[str, bytes]:
    """Take JPEG for figures made of photos and renders, which PNG would make several times as large."""
    from PIL import Image

    if len(png) < _LARGE_PICTURE:
        return "png", png
    stream = io.BytesIO()
    with Image.open(io.BytesIO(png)) as picture:
        picture.convert("RGB").save(stream, "JPEG", quality=92, subsampling=0, optimize=True)
    return ("jpeg", stream.getvalue()) if stream.tell() < 0.7 * len(png) else ("png", png)


def _provenance(out: Path, info: Mapping[str, Any]) -> dict[str, Any]:
    """Collect versions, times and hashes for the page."""
    from ..files.atomic import read_json

    timings = out / "work" / "timings.json"
    hashes = dict(info.get("hashes") or {})
    for name in ("errors.csv", "summary.json", "curves.npz", "registered.npz"):
        path = out / "report" / name
        if path.is_file():
            hashes[f"report/{name}"] = hashlib.sha256(path.read_bytes()).hexdigest()
    return {
        "versions": _versions(),
        "timings": read_json(timings) if timings.is_file() else {},
        "hashes": hashes,
    }


def _versions() -> list[tuple[str, str]]:
    import platform
    from importlib import metadata

    from .. import __version__

    rows = [("capture_eval", __version__), ("Python", platform.python_version()), ("system", platform.platform())]
    for name in (
        "numpy",
        "scipy",
        "pycolmap",
        "pycolmap-cuda12",
        "open3d",
        "pymeshlab",
        "numba",
        "matplotlib",
        "plotly",
        "snakemake",
    ):
        try:
            rows.append((name, metadata.version(name)))
        except metadata.PackageNotFoundError:
            continue
    return rows
