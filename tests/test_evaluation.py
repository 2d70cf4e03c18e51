"""Metrics by hand, missing data as rows, and the reference errors of the MakeHuman head."""

import csv
import json
import math
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from capture_eval.curves.edge_loops import edge_topology
from capture_eval.curves.extract import Curve, CurveSet, extract_curves, resolve_curves
from capture_eval.errors import InputError
from capture_eval.evaluation.error_table import ErrorTable, check_pose_times, evaluate_curves
from capture_eval.evaluation.metrics import average_and_maximum, point_errors
from capture_eval.evaluation.oracles import ORACLES, best_shared_timing, evaluate_oracles, nearest_on_chord
from capture_eval.evaluation.summary import largest_errors, summarise
from capture_eval.evaluation.timing_path import split_timing_and_path
from capture_eval.evaluation.truth_comparison import compare_with_truth
from capture_eval.files.atomic import read_npz, write_json, write_npz
from capture_eval.files.curve_files import read_curves
from capture_eval.files.mesh_files import read_mesh, write_mesh
from capture_eval.interpolation.dynamic_pde import DynamicPde
from capture_eval.interpolation.methods import create_method, create_methods
from capture_eval.polygon_mesh import PolygonMesh
from capture_eval.report.tables import lme_lae_table, to_markdown
from capture_eval.stages.evaluate import EvaluateOptions, evaluate_capture, evaluate_meshes, evaluate_truth
from capture_eval.triangle_geometry import diameter

HEAD = Path(__file__).parents[2] / "shared" / "data" / "makehuman_head"
METHODS = [("linear", {}), ("pde_linear", {}), ("pde_quadratic", {}), ("pde_cubic", {})]
T = np.linspace(0, 1, 5)


def test_metrics_by_hand() -> None:
    truth = np.zeros((2, 2, 3))
    predicted = np.array([[[3.0, 4.0, 0.0], [0.0, 0.0, 0.0]], [[0.0, 0.0, 1.0], [2.0, 0.0, 0.0]]])
    errors = point_errors(predicted, truth, 10.0)
    np.testing.assert_allclose(errors, [[0.5, 0.0], [0.1, 0.2]])
    average, maximum, n_points = average_and_maximum(errors)
    np.testing.assert_allclose(average, [0.25, 0.15])
    np.testing.assert_allclose(maximum, [0.5, 0.2])
    np.testing.assert_array_equal(n_points, [2, 2])
    average, maximum, n_points = average_and_maximum(errors, np.array([False, True]))
    np.testing.assert_allclose(average, [0.0, 0.2])
    np.testing.assert_array_equal(n_points, [1, 1])
    for value in average_and_maximum(errors, np.zeros(2, dtype=bool)):
        assert not np.nan_to_num(value).any()
    errors[0, 1] = np.nan
    average, _, n_points = average_and_maximum(errors)
    assert math.isnan(average[0])
    np.testing.assert_array_equal(n_points, [0, 2])


def test_metrics_refuse_what_has_no_meaning() -> None:
    with pytest.raises(InputError, match="must be equal"):
        point_errors(np.zeros((2, 3, 3)), np.zeros((2, 4, 3)), 1.0)
    for size in (0.0, -1.0, math.nan):
        with pytest.raises(InputError, match="has no extent"):
            point_errors(np.zeros((2, 3, 3)), np.zeros((2, 3, 3)), size)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10**6), still=st.booleans())
def test_timing_and_path_add_up_in_squares(seed: int, still: bool) -> None:
    rng = np.random.default_rng(seed)
    predicted, truth = rng.normal(size=(2, 4, 6, 3))
    start = rng.normal(size=(6, 3))
    end = start if still else rng.normal(size=(6, 3))
    split = split_timing_and_path(predicted, truth, start, end, 2.0)
    np.testing.assert_allclose(
        split.timing**2 + split.path**2, point_errors(predicted, truth, 2.0) ** 2, rtol=1e-12, atol=1e-30
    )
    if still:
        assert not split.timing.any()


def test_a_late_prediction_on_the_way_is_all_timing() -> None:
    start, end = np.zeros((3, 3)), np.tile([2.0, 0.0, 0.0], (3, 1))
    truth, predicted = np.full((1, 3, 3), [1.0, 0.5, 0.0]), np.full((1, 3, 3), [0.5, 0.0, 0.0])
    split = split_timing_and_path(predicted, truth, start, end, 1.0)
    np.testing.assert_allclose(split.timing, -0.5)
    np.testing.assert_allclose(split.path, 0.5)


def square_curves(vertices: np.ndarray) -> CurveSet:
    curves = [Curve("ring", np.arange(6), True), Curve("line", np.array([6, 7, 8, 9]), False)]
    return extract_curves(curves, vertices)


def moving_points(seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    start, step, bend = rng.normal(size=(3, 10, 3))
    return start + T[:, None, None] * step + 0.1 * (T * (1 - T))[:, None, None] * bend


def test_missing_poses_and_points_are_rows() -> None:
    vertices = moving_points()
    vertices[2] = np.nan
    counted = np.ones(10, dtype=bool)
    counted[[0, 6, 7, 8, 9]] = False
    found = evaluate_curves(square_curves(vertices), T, create_methods(METHODS), 2.0, counted)
    rows = found.table.rows()
    assert len(rows) == 4 * 2 * 3
    assert {row[3] for row in rows if row[1] == "ring" and row[2] != 0.5} == {5}
    for _, curve, t, n_points, average, maximum in rows:
        if curve == "line" or t == 0.5:
            assert n_points == 0
            assert math.isnan(average)
            assert math.isnan(maximum)
        else:
            assert 0 < average <= maximum
    assert found.predictions["linear"][1].shape == (5, 4, 3)
    summary = summarise(found, square_curves(vertices), create_methods(METHODS), 2.0, np.arange(5) != 2, "confident")
    assert summary["counts"]["curves_failed"] == ["line"]
    assert (summary["counts"]["poses_failed"], summary["counts"]["in_between_failed"]) == (1, 1)
    assert summary["coverage"] == {"ring": 5 / 6, "line": 0.0}
    json.dumps(summary, allow_nan=False)


def test_without_an_end_pose_every_row_is_missing() -> None:
    vertices = moving_points()
    vertices[-1] = np.nan
    methods = create_methods(METHODS)
    found = evaluate_curves(square_curves(vertices), T, methods, 2.0)
    assert not found.table.n_points.any()
    assert largest_errors(found.table, "linear") == {
        "LME": None, "LME_curve": None, "LME_t": None, "LAE": None, "LAE_curve": None, "LAE_t": None
    }  # fmt: skip
    summary = summarise(found, square_curves(vertices), methods, 2.0, np.arange(5) != 4, "all")
    assert summary["noise_floor"] is None
    json.dumps(summary, allow_nan=False)


def test_largest_errors_say_where() -> None:
    average = np.array([[[0.1, 0.3], [0.2, np.nan]]])
    table = ErrorTable(("m",), ("a", "b"), np.array([0.25, 0.5]), np.array([[3, 3], [3, 0]]), average, 2 * average)
    found = largest_errors(table, "m")
    assert (found["LAE"], found["LAE_curve"], found["LAE_t"]) == (0.3, "a", 0.5)
    assert found["LME"] == 0.6
    with pytest.raises(InputError, match="do not fit 1 methods, 1 curves"):
        ErrorTable(("m",), ("a",), np.array([0.25, 0.5]), np.array([[3, 3]]), average, average)


def test_summary_ratios_and_parts() -> None:
    vertices = moving_points(3)
    methods = create_methods(METHODS)
    curves = square_curves(vertices)
    found = evaluate_curves(curves, T, methods, 2.0)
    summary = summarise(found, curves, methods, 2.0, np.ones(5, dtype=bool), "all")
    for row in summary["methods"].values():
        assert row["LME_ratio_to_linear"] == pytest.approx(row["LME"] / summary["methods"]["linear"]["LME"])
        assert row["rms"] ** 2 == pytest.approx(row["rms_timing"] ** 2 + row["rms_path"] ** 2)
        assert row["LAE"] <= row["LME"]
    assert summary["methods"]["pde_linear"]["LAE_ratio_to_linear"] == 1.0


def test_oracles_bound_every_straight_method_and_find_the_timing() -> None:
    """On straight paths walked as t² the shared oracle is exact; on bent ones it beats each straight method in RMS."""
    rng = np.random.default_rng(5)
    start, step = rng.normal(size=(2, 10, 3))
    straight = square_curves(start + (T**2)[:, None, None] * step)
    counted = tuple(np.ones(len(curve.vertices), dtype=bool) for curve in straight.curves)
    found = evaluate_oracles(straight, T, 1.0, counted)
    np.testing.assert_allclose(found.best_timing, T[1:-1] ** 2, atol=1e-14)
    assert found.table.maximum.max() < 1e-14

    curves = square_curves(moving_points(8))
    best = best_shared_timing(curves, counted)

    def squares(share: np.ndarray) -> float:
        chords = [p[0] + share[:, None, None] * (p[-1] - p[0]) - p[1:-1] for p in curves.positions]
        return sum(float((chord**2).sum()) for chord in chords)

    assert squares(best) <= min(squares(T[1:-1] ** p) for p in (1, 2, 3))
    nearest = [np.linalg.norm(nearest_on_chord(p) - p[1:-1], axis=2) for p in curves.positions]
    for p, near in zip(curves.positions, nearest, strict=True):
        for share in np.linspace(0, 1, 21):
            other = np.linalg.norm(p[0] + share * (p[-1] - p[0]) - p[1:-1], axis=2)
            assert (near <= other + 1e-15).all()


def test_best_timing_never_runs_backwards_and_survives_missing_poses() -> None:
    start, step = np.random.default_rng(2).normal(size=(2, 10, 3))
    share = np.array([0.0, 0.6, 0.4, 0.7, 1.0])
    vertices = start + share[:, None, None] * step
    vertices[3] = np.nan
    curves = square_curves(vertices)
    counted = tuple(np.ones(len(curve.vertices), dtype=bool) for curve in curves.curves)
    np.testing.assert_allclose(best_shared_timing(curves, counted), [0.5, 0.5, np.nan], atol=1e-14)
    still = square_curves(np.repeat(start[None], 5, axis=0))
    table = evaluate_oracles(still, T, 1.0, counted).table
    assert table.maximum.max() == 0.0


def test_summary_keeps_oracles_apart() -> None:
    curves, methods = square_curves(moving_points(3)), create_methods(METHODS)
    summary = summarise(evaluate_curves(curves, T, methods, 2.0), curves, methods, 2.0, np.ones(5, dtype=bool), "all")
    assert set(summary["methods"]) == {name for name, _ in METHODS}
    assert set(summary["oracles"]) == set(ORACLES)
    assert all(row["title"].startswith("oracle: ") for row in summary["oracles"].values())
    assert [row["t"] for row in summary["best_timing"]] == [0.25, 0.5, 0.75]
    text = to_markdown(lme_lae_table(summary))
    assert "oracle: straight paths, best timing shared" in text


def test_noise_floor_comes_from_resting_curves() -> None:
    """Isotropic noise σ on all poses: E_A at rest is √(8/π)·σ·√(1 + (1−t)² + t²) on average."""
    rng = np.random.default_rng(1)
    noise = 0.001
    t = np.linspace(0, 1, 11)
    vertices = rng.normal(size=(1, 400, 3)) + noise * rng.normal(size=(11, 400, 3))
    vertices[:, 200:] += 0.3 * t[:, None, None]
    curves = extract_curves(
        [Curve("still", np.arange(200), True), Curve("moving", np.arange(200, 400), True)], vertices
    )
    methods = create_methods(METHODS)
    summary = summarise(evaluate_curves(curves, t, methods, 1.0), curves, methods, 1.0, np.ones(11, dtype=bool), "all")
    assert summary["noise"]["curves"] == ["still"]
    inner = t[1:-1]
    expected = math.sqrt(8 / math.pi) * noise * np.sqrt(1 + (1 - inner) ** 2 + inner**2).mean()
    assert summary["noise_floor"] == pytest.approx(expected, rel=0.05)  # 200 correlated points


@pytest.mark.parametrize(
    ("t", "words"),
    [
        ([0, 0.5, 0.5, 0.7, 1], "must rise from 0 to 1"),
        ([0, 0.7, 0.5, 0.8, 1], "must rise from 0 to 1"),
        ([0.1, 0.2, 0.5, 0.8, 1], "must rise from 0 to 1"),
        ([0, 0.2, 0.5, 0.8, 1.2], "must rise from 0 to 1"),
        ([0, 0.5, 1], "3 times for 5 poses"),
    ],
)
def test_times_out_of_order_are_refused(t: list[float], words: str) -> None:
    with pytest.raises(InputError, match=re.escape(words)):
        check_pose_times(t, 5)


def test_refusals_of_methods_name_method_and_curve() -> None:
    methods = {"short": DynamicPde(2, harmonics=3)}
    with pytest.raises(InputError, match="method 'short', curve 'line': PDE quadratic: 3 harmonics"):
        evaluate_curves(square_curves(moving_points()), T, methods, 2.0)
    with pytest.raises(InputError, match="no curves"):
        evaluate_curves(CurveSet((), ()), T, methods, 2.0)


def test_names_of_methods_with_options() -> None:
    created = create_methods([("pde", {"order": 2}), ("pde", {"order": 3, "damping": 5}), ("linear", {})])
    assert list(created) == ["pde(order=2)", "pde(damping=5,order=3)", "linear"]
    with pytest.raises(InputError, match="asked for twice"):
        create_methods([("linear", {}), ("linear", {})])
    with pytest.raises(InputError, match="no interpolation method"):
        create_methods([])


def test_truth_comparison_by_hand() -> None:
    methods, curves, t, n = ("a", "b"), ("c",), np.array([0.25, 0.5]), np.array([[4, 4]])
    photos = ErrorTable(
        methods, curves, t, n, np.array([[[0.1, 0.2]], [[0.3, 0.1]]]), np.array([[[0.2, 0.4]], [[0.6, 0.2]]])
    )
    truth = ErrorTable(
        methods, curves, t, n, np.array([[[0.1, 0.25]], [[0.2, 0.1]]]), np.array([[[0.2, 0.5]], [[0.4, 0.2]]])
    )
    found = compare_with_truth(photos, truth)
    assert found["methods"]["a"]["LAE_ratio"] == pytest.approx(0.8)
    assert found["methods"]["b"]["largest_E_A_difference"] == pytest.approx(0.1)
    assert found["methods"]["b"]["largest_E_A_difference_at"] == {"curve": "c", "t": 0.25}
    assert found["order_LAE"] == {"photos": ["a", "b"], "truth": ["b", "a"], "same": False}
    assert compare_with_truth(truth, truth)["order_LME"]["same"] is True
    with pytest.raises(InputError, match="not of the same methods"):
        compare_with_truth(photos, ErrorTable(methods, ("d",), t, n, truth.average, truth.maximum))


# --- the stage -----------------------------------------------------------------------------------------------------


def tube(rows: int = 6, around: int = 8) -> PolygonMesh:
    index = np.arange(rows * around).reshape(rows, around)
    index = np.hstack([index, index[:, :1]])
    quads = np.stack([index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]], axis=-1).reshape(-1, 4)
    row, angle = np.divmod(np.arange(rows * around), around)
    angle = 2 * np.pi * angle / around
    return PolygonMesh.from_faces(np.stack([np.cos(angle), np.sin(angle), row], axis=1), quads)


@pytest.fixture
def capture(tmp_path: Path) -> Path:
    """A tube that bends and grows, 5 poses, saved as a registered capture, as meshes and as its own truth."""
    mesh = tube()
    write_mesh(tmp_path / "template.obj", mesh)
    (tmp_path / "curves.yaml").write_text(
        "curves:\n- {name: ring, start_edge: [16, 17]}\n- {name: rim, start_edge: [0, 1]}\n"
        "- {name: line, start_edge: [3, 11], region: side}\n"
    )
    z = mesh.vertices[:, 2:]
    vertices = np.stack([mesh.vertices + t**2 * z * [0.3, 0.1 * t, 0.2] for t in T])
    confidence = np.full(vertices.shape[:2], 0.9)
    confidence[3, :4] = 0.2
    seen = np.ones(vertices.shape[:2], dtype=bool)
    seen[1, 16] = False
    arrays = {"t": T, "vertices": vertices, "confidence": confidence, "seen": seen, "pose_ok": np.ones(5, dtype=bool)}
    write_npz(tmp_path / "work/register/registered.npz", arrays)
    write_npz(tmp_path / "work/register/tracked_truth.npz", {"t": T, "vertices": vertices})
    for number, positions in enumerate(vertices):
        write_mesh(tmp_path / f"pose_{number}.ply", mesh.with_vertices(positions))
    return tmp_path


def run(folder: Path, report: str = "report", **options: str | float) -> dict[str, object]:
    return evaluate_capture(
        folder / "work", folder / "template.obj", folder / "curves.yaml", METHODS, folder / report,
        EvaluateOptions(**options),  # type: ignore[arg-type]
    )  # fmt: skip


def read_rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as stream:
        return list(csv.DictReader(stream))


def test_stage_writes_everything_and_repeats_byte_for_byte(capture: Path) -> None:
    for number in range(2):
        write_json(capture / f"work/pose_{number}/sparse.json", {"status": "ok", "photos": 12, "registered": 11})
    summary = run(capture)
    assert summary["counts"]["photos"] == 24  # type: ignore[index]
    assert summary["counts"]["photos_registered"] == 22  # type: ignore[index]
    run(capture, "again")
    names = sorted(path.name for path in (capture / "report").iterdir())
    assert names == sorted(
        ["errors.csv", "summary.json", "registered.npz", "curves.npz"]
        + [
            f"table_{name}.{ending}"
            for name in ("intervals", "lme_lae", "pairs", "per_curve")
            for ending in ("csv", "md", "tex")
        ]
    )
    for name in names:
        assert (capture / "report" / name).read_bytes() == (capture / "again" / name).read_bytes(), name
    rows = read_rows(capture / "report" / "errors.csv")
    assert len(rows) == 4 * 3 * 3
    assert list(rows[0]) == ["method", "curve", "t", "n_points", "E_A", "E_M"]
    rim = [row for row in rows if row["curve"] == "rim"]
    assert {row["n_points"] for row in rim} == {"4"}  # four of eight are not confident in one pose
    worst = max(float(row["E_M"]) for row in rows if row["method"] == "pde_cubic")
    assert worst == summary["methods"]["pde_cubic"]["LME"]  # type: ignore[index]
    saved = read_npz(capture / "report" / "curves.npz")
    part = slice(int(saved["offsets"][2]), int(saved["offsets"][3]))
    assert saved["names"].tolist() == ["ring", "rim", "line"]
    predicted, truth = saved["prediction/linear"][2, part], saved["truth"][2, part]
    size = summary["D"]
    assert isinstance(size, float)
    expected = np.linalg.norm(predicted - truth, axis=1)[saved["used"][part]].mean() / size
    (row,) = [row for row in rows if (row["method"], row["curve"], row["t"]) == ("linear", "line", "0.5")]
    assert float(row["E_A"]) == pytest.approx(expected, rel=1e-14)
    poses = read_npz(capture / "report" / "registered.npz")
    assert poses["used_vertices"].sum() == 44
    assert len(poses["face_offsets"]) == 41


def test_which_vertices_count(capture: Path) -> None:
    everything = run(capture, evaluation_vertices="all")
    seen = run(capture, evaluation_vertices="seen")
    assert everything["coverage"] == {"ring": 1.0, "rim": 1.0, "line": 1.0}
    assert seen["coverage"] == {"ring": 7 / 8, "rim": 1.0, "line": 1.0}
    none = run(capture, confidence_threshold=0.95)
    assert none["counts"]["curves_failed"] == ["ring", "rim", "line"]  # type: ignore[index]
    assert "–" in (capture / "report" / "table_lme_lae.md").read_text()
    with pytest.raises(InputError, match="must be in"):
        run(capture, confidence_threshold=1.5)
    with pytest.raises(InputError, match="known are confident, seen, all"):
        run(capture, evaluation_vertices="some")


def test_failed_poses_are_rows_and_the_neutral_is_needed(capture: Path) -> None:
    path = capture / "work/register/registered.npz"
    arrays = read_npz(path)
    arrays["pose_ok"][2] = False
    arrays["confidence"][2] = np.nan
    write_npz(path, arrays)
    run(capture)
    rows = read_rows(capture / "report" / "errors.csv")
    assert {row["n_points"] for row in rows if row["t"] == "0.5"} == {"0"}
    assert {row["E_A"] for row in rows if row["t"] == "0.5"} == {"nan"}
    assert np.isnan(read_npz(capture / "report" / "registered.npz")["vertices"][2]).all()
    arrays["pose_ok"][0] = False
    write_npz(path, arrays)
    with pytest.raises(InputError, match="the neutral pose"):
        run(capture)


def test_truth_of_itself_is_equal(capture: Path) -> None:
    run(capture)
    arguments = (capture / "work", capture / "template.obj", capture / "curves.yaml", METHODS, capture / "report")
    found = evaluate_truth(*arguments, EvaluateOptions())
    for row in found["methods"].values():
        assert row["LME_ratio"] == row["LAE_ratio"] == 1.0
        assert row["largest_E_A_difference"] == 0.0
    assert found["order_LME"]["same"]
    report = capture / "report"
    assert (report / "errors_truth.csv").read_bytes() == (report / "errors.csv").read_bytes()
    write_npz(capture / "work/register/tracked_truth.npz", {"vertices": np.zeros((5, 7, 3))})
    with pytest.raises(InputError, match=r"tracked_truth\.npz: vertices \(5, 7, 3\), expected \(5, 48, 3\)"):
        evaluate_truth(*arguments, EvaluateOptions())


def test_meshes_give_the_same_errors_and_refuse_another_topology(capture: Path) -> None:
    meshes = [capture / f"pose_{number}.ply" for number in range(5)]
    run(capture, evaluation_vertices="all")
    evaluate_meshes(meshes, T, capture / "curves.yaml", METHODS, capture / "compare")
    assert (capture / "compare" / "errors.csv").read_bytes() == (capture / "report" / "errors.csv").read_bytes()
    write_mesh(meshes[2], tube(7))
    with pytest.raises(InputError, match=r"pose_2\.ply: 56 vertices, but .*pose_0\.ply has 48"):
        evaluate_meshes(meshes, T, capture / "curves.yaml", METHODS, capture / "compare")
    mesh = tube()
    write_mesh(meshes[2], PolygonMesh.from_faces(mesh.vertices, mesh.quads()[::-1]))
    with pytest.raises(InputError, match=r"pose_2\.ply: its faces differ"):
        evaluate_meshes(meshes, T, capture / "curves.yaml", METHODS, capture / "compare")


def test_files_that_do_not_fit_are_named(capture: Path) -> None:
    write_mesh(capture / "template.obj", tube(7))
    with pytest.raises(InputError, match=r"template\.obj: 56 vertices, but the registered meshes have 48"):
        run(capture)
    write_mesh(capture / "template.obj", tube())
    (capture / "curves.yaml").write_text("curves: [{name: far, start_edge: [0, 99]}]\n")
    with pytest.raises(InputError, match=r"curves\.yaml: curve 'far': vertex 99 is not in the mesh"):
        run(capture)


# --- the MakeHuman head --------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def head_sequences() -> tuple[tuple[Curve, ...], float, dict[str, np.ndarray], dict[str, object]]:
    if not HEAD.exists():
        pytest.skip("../shared/data/makehuman_head is absent")
    mesh = read_mesh(HEAD / "neutral.obj")
    curves = resolve_curves(read_curves(HEAD / "curves.json"), edge_topology(mesh))
    return (
        curves,
        diameter(mesh.vertices),
        read_npz(HEAD / "sequences.npz"),
        json.loads((HEAD / "errors.json").read_text()),
    )


@pytest.mark.parametrize("motion", ["jaw_open", "grin", "blink_frown"])
@pytest.mark.parametrize("timing", ["linear", "ease"])
def test_reference_errors_of_the_head(head_sequences, motion: str, timing: str) -> None:  # type: ignore[no-untyped-def]
    """LME, LAE, where they occur and every E_A, E_M at t = 0.5, to 1e-6 of D, for four methods."""
    curves, size, sequences, reference = head_sequences
    assert size == pytest.approx(reference["D_mm"], rel=1e-6)
    extracted = extract_curves(curves, sequences[f"{motion}_{timing}"])
    methods = {
        "linear": create_method("linear"),
        "t2": create_method("power", {"exponent": 2}),
        "t3": create_method("power", {"exponent": 3}),
        "cosine": create_method("cosine"),
    }
    t = np.round(sequences["t"].astype(float), 6)
    table = evaluate_curves(extracted, t, methods, size).table
    for k, name in enumerate(methods):
        expected = reference["results"][f"{motion}_{timing}"][name]
        found = largest_errors(table, name)
        for key, values in (("LME", table.maximum), ("LAE", table.average)):
            assert found[key] == pytest.approx(expected[key] / 100, abs=1e-6)
            np.testing.assert_allclose(values[k].max(axis=0), np.array(expected[f"{key}_t"]) / 100, atol=1e-6)
        np.testing.assert_allclose(table.average[k][:, 4], np.array(expected["EA_t05"]) / 100, atol=1e-6)
        np.testing.assert_allclose(table.maximum[k][:, 4], np.array(expected["EM_t05"]) / 100, atol=1e-6)
        assert table.average[k].mean() == pytest.approx(expected["mean_EA"] / 100, abs=1e-6)
        assert table.maximum[k].mean() == pytest.approx(expected["mean_EM"] / 100, abs=1e-6)


def test_stiff_pde_is_close_to_powers_of_time_on_the_head(head_sequences) -> None:  # type: ignore[no-untyped-def]
    curves, size, sequences, _ = head_sequences
    extracted = extract_curves(curves, sequences["jaw_open_linear"])
    t = np.round(sequences["t"].astype(float), 6)
    methods = {**create_methods(METHODS), "t2": create_method("power", {"exponent": 2})}
    table = evaluate_curves(extracted, t, methods, size).table
    np.testing.assert_array_equal(table.average[1], table.average[0])
    np.testing.assert_allclose(table.average[2], table.average[4], atol=2e-4)
    assert largest_errors(table, "pde_quadratic")["LME"] > 4 * largest_errors(table, "linear")["LME"]
