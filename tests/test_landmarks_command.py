"""``capture-eval landmarks``: pixels by hand and by a plugin, the sheet, and what bad input gets."""

from __future__ import annotations

from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from PIL import Image
from small_capture import write_capture
from typer.testing import CliRunner

from capture_eval.cameras import Intrinsics, View, project
from capture_eval.command_line.landmarks import parse_points
from capture_eval.command_line.main import build_application
from capture_eval.errors import CaptureEvalError, InputError, ToolError
from capture_eval.files.landmark_files import read_landmarks
from capture_eval.files.manifest_files import read_manifest
from capture_eval.registration import landmark_detectors
from capture_eval.registration.landmark_detectors import detect_landmarks, load_detector
from capture_eval.stages import landmarks as stage
from capture_eval.stages.landmarks import LandmarkRequest, Placement, place_landmarks_by_hand

GREY = np.full((120, 160, 3), 128, dtype=np.uint8)


def _rows(folder: Path) -> dict[str, dict[str, Any]]:
    document = yaml.safe_load((folder / "landmarks.yaml").read_text())
    return {row["name"]: row for row in document["landmarks"]}


def _run(folder: Path, *words: str) -> Any:
    return CliRunner().invoke(build_application(), ["landmarks", str(folder / "manifest.yaml"), *words])


def _offer(monkeypatch: pytest.MonkeyPatch, detector: object) -> None:
    """An installed package that offers ``fake``."""

    class Entry:
        name, value = "fake", "package:detect"

        def load(self) -> object:
            if isinstance(detector, ImportError):
                raise detector
            return detector

    def entry_points(group: str, name: str | None = None) -> list[Entry]:
        assert group == "capture_eval.landmarks"
        return [Entry()] if name in (None, "fake") else []

    monkeypatch.setattr(landmark_detectors, "metadata", type("Fake", (metadata.EntryPoint,), {}))
    monkeypatch.setattr(landmark_detectors.metadata, "entry_points", staticmethod(entry_points), raising=False)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_capture(tmp_path)
    return tmp_path


@pytest.fixture
def no_sheet(monkeypatch: pytest.MonkeyPatch) -> None:
    """Drawing takes most of the time and is looked at by a test of its own."""
    monkeypatch.setattr(stage, "_draw", lambda *_: None)


def test_without_points_only_the_sheet_is_written_and_it_shows_the_photos(folder: Path) -> None:
    before = (folder / "landmarks.yaml").read_bytes()
    told = _run(folder)
    assert told.exit_code == 0, told.output
    assert "mark_0: 2 photos" in told.output
    assert "7 of 7 landmarks can be used" in told.output
    assert (folder / "landmarks.yaml").read_bytes() == before
    pixels = np.asarray(Image.open(folder / "landmarks.png").convert("RGB"), dtype=float)
    # nine photos of textured noise below the template: most rows of pixels in the lower half vary, the margins do not
    lower = pixels[len(pixels) // 2 :]
    assert np.mean(lower.std(axis=(1, 2)) > 20.0) > 0.7
    mark = np.array([0x0B, 0x4F, 0x9E])
    assert np.sum(np.abs(pixels - mark).max(axis=2) < 12) > 100


@pytest.mark.usefixtures("no_sheet")
def test_points_by_name_and_by_number_come_back_from_the_file(folder: Path) -> None:
    told = _run(folder, "view_3.jpg", "mark_0=10.25,20", "mark_1=30,40.5", "1", "mark_0=11,21", "--define", "new=9")
    assert told.exit_code == 0, told.output
    rows = _rows(folder)
    assert rows["mark_0"]["photos"] == {
        "view_0.jpg": [11.0, 21.0],
        "view_1.jpg": [12.0, 9.0],
        "view_3.jpg": [10.25, 20.0],
    }
    assert rows["mark_1"]["photos"]["view_3.jpg"] == [30.0, 40.5]
    assert rows["new"] == {"name": "new", "vertex": 9, "photos": {}}
    assert "new: 0 photos; needs 2 photos or more" in told.output
    assert _run(folder, "view_0.jpg", "new=1,2", "view_1.jpg", "new=3,4").exit_code == 0
    found = {landmark.name: landmark for landmark in read_landmarks(folder / "landmarks.yaml", 36)}
    np.testing.assert_array_equal(found["new"].photos["view_1.jpg"], [3.0, 4.0])
    assert _run(folder, "--remove", "view_3.jpg:mark_0", "--remove", "mark_1").exit_code == 0
    rows = _rows(folder)
    assert set(rows["mark_0"]["photos"]) == {"view_0.jpg", "view_1.jpg"}
    assert rows["mark_1"]["photos"] == {}


@pytest.mark.usefixtures("no_sheet")
def test_a_first_landmark_makes_the_file(folder: Path) -> None:
    (folder / "landmarks.yaml").unlink()
    assert _run(folder, "--define", "tip=3", "2", "tip=5,6").exit_code == 0
    assert _rows(folder) == {"tip": {"name": "tip", "vertex": 3, "photos": {"view_1.jpg": [5.0, 6.0]}}}


@pytest.mark.usefixtures("no_sheet")
def test_a_plugin_fills_what_nobody_placed(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def detect(image: np.ndarray) -> dict[str, tuple[float, ...]]:
        assert image.shape == (120, 160, 3)
        assert image.dtype == np.uint8
        image[:] = 0  # its own copy
        return {"mark_0": (50.0, 60.0), "mark_1": (70.0, 80.0, 0.9), "mark_2": (1.0, 2.0, 0.1), "left_knee": (5.0, 5.0)}

    _offer(monkeypatch, detect)
    told = _run(folder, "view_2.jpg", "mark_0=7,8", "--detector", "fake")
    assert told.exit_code == 0, told.output
    rows = _rows(folder)
    assert rows["mark_0"]["photos"]["view_0.jpg"] == [10.0, 10.0]  # as it was
    assert rows["mark_0"]["photos"]["view_2.jpg"] == [7.0, 8.0]
    assert rows["mark_0"]["photos"]["view_5.jpg"] == [50.0, 60.0]
    assert len(rows["mark_1"]["photos"]) == 9
    assert len(rows["mark_2"]["photos"]) == 2  # too doubtful
    assert "left_knee" not in rows


@pytest.mark.parametrize(
    ("detector", "text"),
    [
        (lambda _: 1 / 0, "the detector failed: ZeroDivisionError"),
        (lambda _: [1.0], "returned list"),
        (lambda _: {3: (1.0, 2.0)}, "the name 3"),
        (lambda _: {"chin": "left"}, "expected x, y"),
        (lambda _: {"chin": (1.0,)}, "expected x, y"),
        (lambda _: {"chin": (np.nan, 2.0)}, "expected x, y"),
        (lambda _: {"chin": (161.0, 2.0)}, "outside the photo of 160x120"),
        (lambda _: {"chin": (1.0, 2.0, 7.0)}, "confidence 7"),
    ],
)
def test_a_plugin_that_fails_or_returns_nonsense_is_one_line(detector: Any, text: str) -> None:
    with pytest.raises(ToolError, match=text) as caught:
        detect_landmarks(detector, GREY, "fake, view_0.jpg")
    assert str(caught.value).startswith("fake, view_0.jpg: ")
    assert "\n" not in str(caught.value)


def test_a_plugin_that_is_missing_or_cannot_be_loaded(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match="no landmark detector 'nobody' is installed"):
        load_detector("nobody")
    _offer(monkeypatch, ImportError("no model"))
    with pytest.raises(InputError, match="cannot be loaded: no model"):
        load_detector("fake")
    _offer(monkeypatch, "not a function")
    with pytest.raises(InputError, match="is not a function"):
        load_detector("fake")
    _offer(monkeypatch, lambda _: {"left_knee": (1.0, 1.0)})
    with pytest.raises(InputError, match="added no landmark of the template in 9 photos"):
        place_landmarks_by_hand(
            read_manifest(folder / "manifest.yaml"), LandmarkRequest(detector="fake"), folder / "sheet.png"
        )


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["view_0.jpg", "elbow=1,2"], "no landmark elbow; it has mark_0"),
        (["view_0.jpg", "mark_0=161,2"], "outside the photo of 160x120"),
        (["view_99.jpg", "mark_0=1,2"], "photo view_99.jpg is not among the 9"),
        (["10", "mark_0=1,2"], "photo 10 is not among the 9"),
        (["view_0.jpg", "mark_0=1;2"], "expected NAME=X,Y"),
        (["view_0.jpg", "mark_0=1,nan"], "outside the photo"),
        (["mark_0=1,2"], "which photo"),
        (["view_0.jpg"], "no pixel after photo view_0.jpg"),
        (["view_0.jpg", "view_1.jpg", "mark_0=1,2"], "no pixel after photo view_0.jpg"),
        (["--remove", "view_5.jpg:mark_0"], "has no pixel in view_5.jpg"),
        (["--remove", "elbow"], "no landmark elbow"),
        (["--define", "mark_0=3"], "is there already"),
        (["--define", "tip=99"], "the vertices 0..35, not 99"),
        (["--define", "tip"], "expected NAME=VERTEX"),
        (["--sheet", "sheet.gif"], "a .png or a .pdf"),
        (["--detector", "nobody"], "no landmark detector 'nobody'"),
    ],
)
def test_bad_input_is_one_line_and_changes_nothing(folder: Path, words: list[str], text: str) -> None:
    before = (folder / "landmarks.yaml").read_bytes()
    told = _run(folder, *words)
    assert isinstance(told.exception, CaptureEvalError)
    assert text in str(told.exception)
    assert "\n" not in str(told.exception)
    assert (folder / "landmarks.yaml").read_bytes() == before
    assert not (folder / "landmarks.png").exists()


def test_cameras_tell_how_well_the_photos_of_a_landmark_agree() -> None:
    lens = Intrinsics(640, 480, np.array([[700.0, 0, 320], [0, 700, 240], [0, 0, 1]]), np.zeros(4))
    views = {}
    for number, degrees in enumerate((-30.0, -10.0, 10.0, 30.0)):
        angle = np.radians(degrees)
        turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
        views[f"{number}.jpg"] = View(f"{number}.jpg", lens, turn, np.array([0.0, 0.0, 5.0]))
    point = np.array([[0.2, -0.1, 0.3]])
    marks = {name: project(view, point)[0][0].tolist() for name, view in views.items()}
    exact = stage._state({"name": "tip", "photos": marks}, views)
    assert exact.error_px == pytest.approx(0.0, abs=1e-6)  # rays that meet
    assert exact.problem == ""
    marks["2.jpg"][0] += 60.0
    wrong = stage._state({"name": "tip", "photos": marks}, views)
    assert wrong.error_px == pytest.approx(0.0, abs=1e-6)  # of the other three
    assert wrong.problem == "1 of its photos disagree and are left out"
    apart = {"1.jpg": [320.0, 100.0], "2.jpg": [320.0, 400.0]}
    assert "disagree by" in stage._state({"name": "tip", "photos": apart}, views).problem


def test_words_belong_to_the_photo_before_them() -> None:
    assert parse_points(["a.jpg", "chin=1,2", "nose=3,4.5", "7", "chin=5,6"]) == (
        Placement("a.jpg", "chin", (1.0, 2.0)),
        Placement("a.jpg", "nose", (3.0, 4.5)),
        Placement("7", "chin", (5.0, 6.0)),
    )
