"""The report: every file is there, says what failed, needs no network, escapes what it is given, and repeats."""

import base64
import json
import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from capture_eval.curves.curve_specification import parse_curves
from capture_eval.errors import InputError
from capture_eval.files.atomic import write_json, write_npz
from capture_eval.files.curve_files import write_curves
from capture_eval.files.mesh_files import write_mesh
from capture_eval.polygon_mesh import PolygonMesh
from capture_eval.report import face_figures, figure_style, head_axes, interactive, page_tables, trajectory_figures
from capture_eval.report.saved_results import CurvePositions, FaceSequence
from capture_eval.report.verdict import MethodScore, NoiseFloor, judge, percent
from capture_eval.stages import report_inputs, report_photos
from capture_eval.stages.evaluate import EvaluateOptions, evaluate_capture, evaluate_truth
from capture_eval.stages.report import ReportOptions, write_report

METHODS = [("linear", {}), ("pde_quadratic", {})]
TIMES = np.array([0.0, 0.3, 0.6, 1.0])
FAILED = 1
HOSTILE = '<script>alert("x")</script> & "name"'
SIZE = 13
FIGURES = (
    "errors_per_curve",
    "errors_over_time",
    "error_maps",
    "trajectories",
    "faces",
    "linear_heat_maps",
    "tracking_confidence",
    "contact_sheet",
    "tracking_error",
    "reconstruction_quality",
    "truth_comparison",
)


def dome() -> PolygonMesh:
    """A dome of quads that looks along +z, a stand-in for a face."""
    index = np.arange(SIZE * SIZE).reshape(SIZE, SIZE)
    quads = np.stack([index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]], axis=-1).reshape(-1, 4)
    y, x = np.divmod(np.arange(SIZE * SIZE), SIZE)
    x, y = (x - 6.0) * 10.0, (y - 6.0) * 12.0
    return PolygonMesh.from_faces(np.stack([x, y, 60.0 - (x**2 + y**2) / 100.0], axis=1), quads)


def turning(neutral: np.ndarray) -> np.ndarray:
    """The lower half turns about an axis behind it: paths are arcs, in t^1.5."""
    weight = np.clip(-neutral[:, 1] / 60.0, 0.0, 1.0)
    poses = []
    for t in TIMES:
        angle = 0.5 * t**1.5 * weight
        y, z = neutral[:, 1], neutral[:, 2] + 40.0
        turned = np.stack(
            [neutral[:, 0], y * np.cos(angle) - z * np.sin(angle), y * np.sin(angle) + z * np.cos(angle) - 40.0], axis=1
        )
        poses.append(turned)
    return np.stack(poses)


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict]:
    """A finished run of four poses, of which one failed, with everything the report reads."""
    from PIL import Image

    folder = tmp_path_factory.mktemp("run")
    out = folder / "out"
    mesh = dome()
    write_mesh(folder / "template.obj", mesh)
    rows = np.arange(SIZE * SIZE).reshape(SIZE, SIZE)
    listed = {"lip_lower": rows[3, 3:10], "midline": rows[:, 6], "brow": rows[10, 2:11], "forehead": rows[11, 2:11]}
    entries = [{"name": name, "vertices": line.tolist(), "closed": False} for name, line in listed.items()]
    entries[0]["name"] = "lip_<b>lower</b>"
    write_curves(folder / "curves.yaml", parse_curves({"curves": entries}, "test"))

    truth = turning(mesh.vertices)
    registered = truth + 0.02 * np.random.default_rng(3).standard_normal(truth.shape)
    registered[FAILED] = np.nan
    ok = np.arange(4) != FAILED
    confidence = np.where(ok[:, None], np.where(mesh.vertices[:, 0] < 45.0, 0.9, 0.2), 0.0)
    write_npz(
        out / "work" / "register" / "registered.npz",
        {"t": TIMES, "vertices": registered, "confidence": confidence, "seen": confidence > 0.1, "pose_ok": ok},
    )
    write_npz(out / "work" / "register" / "tracked_truth.npz", {"vertices": truth})
    inputs = (out / "work", folder / "template.obj", folder / "curves.yaml", METHODS, out / "report", EvaluateOptions())
    evaluate_capture(*inputs)
    evaluate_truth(*inputs)
    poses = []
    for index, t in enumerate(TIMES):
        name = f"pose_{index:02d}"
        photos = folder / "photos" / name
        photos.mkdir(parents=True)
        Image.new("RGB", (64, 48), (40 * index, 90, 120)).save(photos / "view_00.jpg")
        write_stage_files(out / "work" / name, index)
        poses.append({"name": name, "t": float(t), "photos": str(photos)})
    aligned = [
        {"pose": pose["name"], "status": "ok" if ok[i] else "failed", "residual_px": 0.7}
        for i, pose in enumerate(poses)
    ]
    write_json(out / "work" / "align" / "alignment.json", {"poses": aligned})
    tracking = [{"pose": pose["name"], "t": pose["t"], "median": 4e-4, "p95": 2e-3} for pose in poses]
    tracking[FAILED] = {"pose": "pose_01", "t": 0.3, "status": "failed"}
    write_json(out / "report" / "truth.json", {"tracking": tracking})
    write_json(
        out / "work" / "timings.json",
        {f"sparse_{pose['name']}": {"seconds": 2.0, "cpu_seconds": 2.5, "peak_memory_mb": 100.0} for pose in poses},
    )
    info = {
        "name": HOSTILE,
        "description": "javascript:</style>",
        "source": "synthetic",
        "poses": poses,
        "options": {"sparse": {"seed": 7}},
        "hashes": {"template.obj": "0" * 64},
        "terms": {"licence": "CC0"},
    }
    return out, info


def write_stage_files(folder: Path, index: int) -> None:
    if index == FAILED:
        reason = f"3 of 8 photos registered <img src=x onerror=alert({index})>"
        write_json(
            folder / "sparse.json", {"status": "failed", "reason": reason, "photos": 8, "registered": 3, "points": 0}
        )
        write_json(folder / "dense.json", {"status": "skipped", "points": 0})
        return
    write_json(
        folder / "sparse.json",
        {
            "status": "ok",
            "photos": 8,
            "registered": 8,
            "points": 900,
            "reprojection_error_px": 0.5,
            "track_length": 3.1,
        },
    )
    write_json(folder / "dense.json", {"status": "ok", "points": 20000})
    write_json(folder / "surface.json", {"status": "ok", "vertices": 8000, "support_quantiles": {"5": 2.0, "50": 6.0}})


@pytest.fixture(scope="module")
def report(result: tuple[Path, dict]) -> Path:
    out, info = result
    written = write_report(out, info)
    assert written["figures"] == list(FIGURES)
    return out / "report"


class Collector(HTMLParser):
    """Tags, attributes and the text that a reader sees."""

    def __init__(self) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.text: list[str] = []
        self.hidden = 0

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        self.hidden += tag in ("script", "style")

    def handle_endtag(self, tag: str) -> None:
        self.hidden -= tag in ("script", "style")

    def handle_data(self, data: str) -> None:
        if not self.hidden:
            self.text.append(data)


@pytest.fixture(scope="module")
def page(report: Path) -> Collector:
    collector = Collector()
    collector.feed((report / "report.html").read_text(encoding="utf-8"))
    return collector


def test_every_figure_is_there_in_both_formats(report: Path) -> None:
    for name in FIGURES:
        png, pdf = (report / "figures" / f"{name}.{ending}" for ending in ("png", "pdf"))
        assert png.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n", name
        assert png.stat().st_size > 3000, name
        content = pdf.read_bytes()
        assert content.startswith(b"%PDF"), name
        assert b"/CIDFontType2" in content, f"{name}: text is not kept as TrueType (Type 42)"
        assert b"/Type3" not in content, name


def test_pictures_are_not_blank(report: Path) -> None:
    from PIL import Image

    for name in FIGURES:
        with Image.open(report / "figures" / f"{name}.png") as picture:
            grey = np.asarray(picture.convert("L"))
        assert grey.shape[1] >= 1000, name
        # Even the sparsest figure, the markers per curve, has ink on more than one per cent of the paper.
        assert np.mean(grey < 200) > 0.01, name


def test_page_needs_nothing_from_outside(page: Collector) -> None:
    for tag, attributes in page.tags:
        for name in ("src", "href", "data", "action", "srcset", "poster"):
            value = attributes.get(name)
            if value is not None:
                assert value.startswith(("data:", "#")), f"<{tag} {name}={value[:60]}>"
    assert not [tag for tag, _ in page.tags if tag in ("iframe", "object", "embed", "base")]


def test_style_sheet_fetches_nothing(report: Path) -> None:
    text = (report / "report.html").read_text(encoding="utf-8")
    style = text[text.index("<style>") : text.index("</style>")]
    assert "url(" not in style
    assert "@import" not in style


def test_page_escapes_names_reasons_and_curves(report: Path, page: Collector) -> None:
    text = (report / "report.html").read_text(encoding="utf-8")
    assert "<script>alert" not in text
    assert "<img src=x" not in text
    assert "lip_<b>" not in text
    assert HOSTILE in "".join(page.text)
    # the payload, Plotly and the viewer; none came in through a name
    assert sum(tag == "script" for tag, _ in page.tags) == 3
    assert not [name for _, attributes in page.tags for name in attributes if name.startswith("on")]


def test_failed_pose_is_a_row_with_its_reason(report: Path, page: Collector) -> None:
    text = (report / "report.html").read_text(encoding="utf-8")
    rows = re.findall(r'<tr class="failed"><td>pose_01</td>.*?</tr>', text, re.DOTALL)
    assert any("3 of 8 photos registered" in row for row in rows)
    shown = " ".join("".join(page.text).split())
    assert "3 of 4" in shown
    assert "1 of 4 poses have no result" in shown


def test_verdict_comes_first_and_names_the_limits(page: Collector) -> None:
    shown = " ".join("".join(page.text).split())
    headings = [
        shown.index(word) for word in ("LAE (largest average", "allows no claim about people", "Errors per curve.")
    ]
    assert headings == sorted(headings)
    assert "Noise floor" in shown


def test_images_of_the_page_are_those_of_the_files(report: Path, page: Collector) -> None:
    images = {attributes["alt"]: attributes["src"] for tag, attributes in page.tags if tag == "img"}
    assert len(images) == len(FIGURES)
    source = images["Errors per curve"]
    assert source is not None
    assert base64.b64decode(source.partition(",")[2]) == (report / "figures" / "errors_per_curve.png").read_bytes()


def test_viewer_payload_gives_back_positions_and_errors(report: Path, result: tuple[Path, dict]) -> None:
    text = (report / "report.html").read_text(encoding="utf-8")
    found = re.search(r'<script id="viewer-data" type="application/json">(.*?)</script>', text, re.DOTALL)
    assert found is not None
    data = json.loads(found.group(1))
    saved = report_inputs.read_results(*result)
    count = len(saved.curves.vertices)
    steps = np.frombuffer(base64.b64decode(data["curves"]["truth"]), dtype="<u2").reshape(4, count, 3)
    assert np.all(steps[FAILED] == 65535)
    back = np.array(data["low"]) + steps[2] * data["step"]
    # rounded to steps of the bounding box: half a step at most
    assert np.max(np.abs(back - saved.curves.truth[2])) <= 0.5001 * data["step"]
    method = data["methods"][1]
    errors = np.frombuffer(base64.b64decode(method["errors"]), dtype="<u2").reshape(4, count)[2]
    true = 100.0 * saved.curves.point_errors("pde_quadratic", saved.diameter)[2]
    counted = saved.curves.counted
    assert np.all(errors[~counted] == 65535)
    assert np.max(np.abs(errors[counted] * data["errorStep"] - true[counted])) <= 0.5001 * data["errorStep"]


def test_figures_repeat_byte_for_byte(report: Path, result: tuple[Path, dict], tmp_path: Path) -> None:
    """The figures that are drawn without rays; those with rays are covered by the same saving code."""
    from capture_eval.stages import report as stage

    out, info = result
    results = report_inputs.read_results(out, info)
    again = {drawing.name: drawing for drawing in stage._drawings(out, info, results, ReportOptions())}
    for name in ("errors_per_curve", "contact_sheet", "faces"):
        stage._save_figure(tmp_path, again[name])
        for ending in ("png", "pdf"):
            first, second = (folder / f"{name}.{ending}" for folder in (report / "figures", tmp_path))
            assert first.read_bytes() == second.read_bytes(), f"{name}.{ending}"


def test_meshes_without_photos_make_a_report_too(result: tuple[Path, dict], tmp_path: Path) -> None:
    import shutil

    out, _ = result
    (tmp_path / "report").mkdir()
    for name in ("errors.csv", "summary.json", "curves.npz", "registered.npz"):
        shutil.copy(out / "report" / name, tmp_path / "report" / name)
    written = write_report(tmp_path, {"name": "meshes"}, ReportOptions(interactive=False))
    assert "contact_sheet" not in written["figures"]
    assert "truth_comparison" not in written["figures"]
    assert written["page"] < 3_000_000


def test_missing_results_are_named(tmp_path: Path) -> None:
    (tmp_path / "report").mkdir()
    with pytest.raises(InputError, match=r"summary\.json"):
        write_report(tmp_path, {"name": "nothing"})
    write_json(tmp_path / "report" / "summary.json", {"D": 1.0})
    (tmp_path / "report" / "errors.csv").write_text("method,curve\n")
    with pytest.raises(InputError, match=r"errors\.csv: no column t, n_points, E_A, E_M"):
        report_inputs.read_errors(tmp_path / "report" / "errors.csv")


def test_options_refuse_axes_that_are_not_a_frame() -> None:
    with pytest.raises(InputError, match="right angles"):
        ReportOptions(up=(0.0, 1.0, 0.0), front=(0.0, 1.0, 0.2))
    with pytest.raises(InputError, match="zero vector"):
        ReportOptions(up=(0.0, 0.0, 0.0))
    assert np.allclose(ReportOptions(up=(0.0, 0.0, 2.0), front=(0.0, -3.0, 0.0)).unit("front"), [0.0, -1.0, 0.0])


def test_unreadable_photo_is_a_grey_tile_not_a_crash(tmp_path: Path) -> None:
    (tmp_path / "pose_00").mkdir()
    (tmp_path / "pose_00" / "view_00.jpg").write_bytes(b"not a photo")
    poses = [{"name": "pose_00", "photos": str(tmp_path / "pose_00")}, {"name": "pose_01", "photos": None}]
    assert report_photos.front_photos(tmp_path, poses, None, np.array([0.0, 0.0, 1.0])) == [None, None]


# --- the verdict ---

FLOOR = NoiseFloor(0.0002, 0.0005, 0.001)


def test_verdict_names_a_clear_winner() -> None:
    verdict = judge({"linear": MethodScore(0.02, 0.04), "pde_quadratic": MethodScore(0.01, 0.02)}, FLOOR)
    assert verdict.headline == "PDE quadratic (R = 2) is closest to the ground truth."
    assert verdict.resolved
    assert "geometric linear has 2.000\u00a0%, 2.00 times as much" in verdict.sentences[0]


def test_verdict_does_not_resolve_differences_below_the_floor() -> None:
    verdict = judge({"linear": MethodScore(0.0103, 0.0205), "pde_quadratic": MethodScore(0.01, 0.02)}, FLOOR)
    assert "below the noise floor and is not resolved" in verdict.headline
    assert not verdict.resolved


def test_verdict_says_equal_when_equal_and_disagreement_when_they_disagree() -> None:
    same = judge({"linear": MethodScore(0.01, 0.02), "pde_linear": MethodScore(0.01, 0.02)}, FLOOR)
    assert "give the same errors" in same.headline
    split = judge({"linear": MethodScore(0.01, 0.05), "pde_cubic": MethodScore(0.02, 0.03)}, FLOOR)
    assert split.headline == "The two figures disagree: LAE is lowest for geometric linear, LME for PDE cubic (R = 3)."
    assert not split.resolved


def test_verdict_without_values_or_floor_or_rivals() -> None:
    nothing = judge({"linear": MethodScore(float("nan"), float("nan"))}, None, ["pose_03"], 5)
    assert nothing.headline == "No method could be evaluated."
    assert any("1 of 5 poses" in line for line in nothing.cautions)
    assert any("No noise floor" in line for line in nothing.cautions)
    assert "only method" in judge({"linear": MethodScore(0.01, 0.02)}, FLOOR).headline


def test_verdict_warns_when_some_methods_were_given_poses() -> None:
    scores = {name: MethodScore(0.01, 0.02) for name in ("linear", "b_spline", "catmull_rom")}
    times = {"linear": [], "b_spline": [0.5], "catmull_rom": [0.5]}
    (line,) = (text for text in judge(scores, FLOOR, key_times=times).cautions if "Not like for like" in text)
    assert "(t = 0.5) and " in line
    assert "were given in-between poses" in line
    splines = {name: scores[name] for name in ("b_spline", "catmull_rom")}
    for given_scores, given_times in ((splines, times), (scores, {}), (scores, None)):
        assert "Not like" not in " ".join(judge(given_scores, FLOOR, key_times=given_times).cautions)


@given(
    st.dictionaries(
        st.sampled_from(["linear", "pde_linear", "pde_quadratic", "own"]),
        st.tuples(st.floats(0, 1), st.floats(0, 1)),
        min_size=1,
    )
)
def test_verdict_always_names_a_best_method(scores: dict[str, tuple[float, float]]) -> None:
    verdict = judge({name: MethodScore(*values) for name, values in scores.items()}, FLOOR)
    best = min(scores, key=lambda name: scores[name][0])
    label = figure_style.method_styles(list(scores))[best].label
    assert label.lower() in f"{verdict.headline} {verdict.sentences[0]}".lower()


def test_percent_marks_missing_values() -> None:
    assert percent(0.01234) == "1.234\u00a0%"
    assert percent(float("nan")) == "—"


# --- pieces ---


def test_known_methods_keep_their_look_and_others_differ() -> None:
    alone = figure_style.method_styles(["pde_cubic"])["pde_cubic"]
    names = ["linear", "pde_linear", "pde_quadratic", "pde_cubic", *(f"own_{i}" for i in range(8))]
    styles = figure_style.method_styles(names)
    assert styles["pde_cubic"] == alone
    assert len({(style.colour, style.marker, style.hollow) for style in styles.values()}) == len(names)


def test_chord_coordinates_of_a_half_circle() -> None:
    """A half circle of radius 1 from (1, 0) to (-1, 0): along = 1 - cos a, off = sin a."""
    angle = np.linspace(0.0, np.pi, 9)
    circle = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    along, off = trajectory_figures.chord_coordinates(circle, circle)
    assert np.allclose(along, 1.0 - np.cos(angle), atol=1e-12)
    assert np.allclose(off, np.sin(angle), atol=1e-12)
    straight = np.linspace(circle[0], circle[-1], 9)
    assert np.allclose(trajectory_figures.chord_coordinates(straight, circle)[1], 0.0, atol=1e-12)


def curve_positions(names: tuple[str, ...], truth: np.ndarray) -> CurvePositions:
    count = truth.shape[1]
    each = count // len(names)
    return CurvePositions(
        names,
        np.zeros(len(names), dtype=bool),
        each * np.arange(len(names) + 1),
        np.arange(count),
        np.linspace(0.0, 1.0, len(truth)),
        truth,
        {},
        np.ones(count, dtype=bool),
    )


def test_tracked_points_are_the_furthest_moving_of_each_part() -> None:
    start = np.zeros((9, 3))
    start[:, 0] = np.repeat([0.0, 40.0, 80.0], 3) + np.tile([0.0, 1.0, 2.0], 3)
    end = start.copy()
    end[4, 1], end[1, 1], end[8, 1] = -9.0, -5.0, -0.1
    curves = curve_positions(("lip_1", "chin_line", "eye_1"), np.stack([start, 0.5 * (start + end), end]))
    points = trajectory_figures.choose_points(curves, 100.0)
    assert [(point.label, point.row) for point in points] == [("chin", 4), ("lip", 1)]  # the eye rests


def test_decimated_face_keeps_original_vertices() -> None:
    mesh = dome()
    vertices = np.stack([mesh.vertices, mesh.vertices + np.array([0.0, 1.0, 0.0])])
    faces = FaceSequence(
        np.array([0.0, 1.0]),
        vertices,
        mesh.triangles()[0],
        np.ones(vertices.shape[:2]),
        np.ones(2, dtype=bool),
        np.ones(len(mesh.vertices), dtype=bool),
        np.zeros((0, 2), dtype=np.int64),
        np.ones(vertices.shape[:2], dtype=bool),
    )
    small = interactive.decimate(faces, 60)
    assert small.vertices.shape[1] <= 60
    assert small.triangles.max() < small.vertices.shape[1]
    originals = {tuple(point) for point in mesh.vertices}
    assert all(tuple(point) in originals for point in small.vertices[0])
    assert np.allclose(small.vertices[1] - small.vertices[0], [0.0, 1.0, 0.0])
    assert interactive.decimate(faces, 1000) is faces


def test_points_behind_the_face_are_not_visible() -> None:
    mesh = dome()
    view = face_figures.look_at(mesh.vertices, np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0]), 0.0, (100, 100))
    assert view.center[2] > 500.0  # the camera stands before the face
    points = np.array([mesh.vertices[84], mesh.vertices[84] - [0.0, 0.0, 5.0], [np.nan] * 3])
    seen = face_figures.visible_points(mesh.vertices, mesh.triangles()[0], points, view, 1.0)
    assert seen.tolist() == [True, False, False]


def test_stage_times_are_summed_over_poses_in_the_order_of_the_pipeline() -> None:
    row = {"seconds": 2.0, "cpu_seconds": 1.5, "peak_memory_mb": 300.0}
    table = page_tables.stage_times({"evaluate": row, "sparse_pose_00": row, "sparse_pose_01": row | {"seconds": 3.0}})
    assert [line[0] for line in table.rows] == ["sparse", "evaluate", "all"]
    assert table.rows[0] == ("sparse", "2", "5.0", "3.0", "300")
    assert table.rows[-1] == ("all", "", "7.0", "4.5", "300")


@given(st.integers(0, 2**32 - 1))
def test_head_axes_are_found_from_a_turned_head(seed: int) -> None:
    """Curves of a face in its own frame (x left, y up, z front), turned at random by up to 40 degrees."""
    from scipy.spatial.transform import Rotation

    random = np.random.default_rng(seed)
    axis = random.standard_normal(3)
    turn = Rotation.from_rotvec(np.deg2rad(40.0) * random.random() * axis / np.linalg.norm(axis)).as_matrix()
    points = np.array(
        [[3.0, 4.0, 0.0], [4.0, 4.0, 0.0], [-3.0, 4.0, 0.0], [-4.0, 4.0, 0.0], [-1.0, 0.0, 1.0], [1.0, 0.0, 1.0]]
    )
    curves = curve_positions(("eye_L", "eye_R", "lip_1"), np.stack([points @ turn.T] * 2))
    given_up, given_front = np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0])
    up, front = head_axes.find_head_axes(curves, given_up, given_front)
    left = turn @ [1.0, 0.0, 0.0]
    assert np.allclose(np.cross(up, front), left, atol=1e-12)
    assert np.isclose(np.linalg.norm(up), 1.0)
    assert abs(up @ front) < 1e-12


def test_head_axes_of_another_convention_and_of_nameless_curves() -> None:
    points = np.array(
        [[3.0, 0.0, 4.0], [4.0, 0.0, 4.0], [-3.0, 0.0, 4.0], [-4.0, 0.0, 4.0], [-1.0, -1.0, 0.0], [1.0, -1.0, 0.0]]
    )
    given_up, given_front = np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0])
    z_up = curve_positions(("lid_left", "lid_right", "mouth"), np.stack([points] * 2))
    up, front = head_axes.find_head_axes(z_up, given_up, given_front)
    assert up[2] > 0.9
    assert front[1] < -0.9
    nameless = curve_positions(("a", "b", "c"), np.stack([points] * 2))
    assert head_axes.find_head_axes(nameless, given_up, given_front)[0] is given_up
