"""Every bad input the evaluation can get: a ValueError of the suite whose one line names the culprit."""

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from capture_eval.curves.extract import Curve, CurveSet, extract_curves
from capture_eval.errors import CaptureEvalError
from capture_eval.evaluation.error_table import evaluate_curves
from capture_eval.files.mesh_files import write_mesh
from capture_eval.interpolation.dynamic_pde import DynamicPde
from capture_eval.interpolation.methods import create_method, create_methods
from capture_eval.interpolation.static_pde_surface import crossing_factors
from capture_eval.polygon_mesh import PolygonMesh
from capture_eval.stages.evaluate import evaluate_meshes

LINEAR = create_methods([("linear", {})])
T = (0.0, 0.5, 1.0)


def ring(vertices: np.ndarray | None = None) -> CurveSet:
    places = np.random.default_rng(1).normal(size=(3, 8, 3)) if vertices is None else vertices
    return extract_curves([Curve("lip", np.arange(8), True)], places)


def lengths(*counts: int) -> CurveSet:
    rng = np.random.default_rng(2)
    return CurveSet(
        tuple(Curve(f"c{n}", np.arange(k), True) for n, k in enumerate(counts)), (rng.normal(size=(3, 8, 3)),)
    )


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: lengths(8, 8), "2 curves with 1 arrays of positions"),
        (lambda: evaluate_curves(ring(), (0.0, 1.0), LINEAR, 1.0), "2 times for 3 poses"),
        (lambda: evaluate_curves(ring(), (0.0, 0.0, 1.0), LINEAR, 1.0), "must rise from 0 to 1, got [0. 0. 1.]"),
        (lambda: evaluate_curves(ring(), (0.0, 1.2, 1.0), LINEAR, 1.0), "must rise from 0 to 1"),
        (lambda: evaluate_curves(ring(), (0.0, 0.5, 1.2), LINEAR, 1.0), "must rise from 0 to 1, got [0.  0.5 1.2]"),
        (lambda: evaluate_curves(ring(), T, LINEAR, 0.0), "is 0.0; the model has no extent"),
        (lambda: Curve("lid", np.arange(2), True), "curve 'lid': 2 points; a closed curve needs at least 3"),
        (lambda: create_method("pde", {"order": 0}), "method 'pde': order R = 0 must be a whole number, 1 or more"),
        (lambda: create_method("pde", {"order": 1.5}), "order R = 1.5 must be"),
        (lambda: create_method("pde_causal", {"order": 0.5}), "real number from 1 to 20"),
        (lambda: DynamicPde(2, damping=0.0, closure="ebar0"), "closure 'ebar0' divides by the damping, which is 0"),
        (lambda: DynamicPde(3, damping=0.0, closure="rest"), "closure 'rest' divides by the damping, which is 0"),
        (
            lambda: evaluate_curves(ring(), T, {"few": DynamicPde(2, harmonics=9)}, 1.0),
            "method 'few', curve 'lip': PDE quadratic: 9 harmonics on a closed curve of 8 points, which holds 4",
        ),
        (
            lambda: evaluate_curves(ring(), T, {"bad": DynamicPde(2, damping=8 * np.pi**4)}, 1.0),
            "method 'bad', curve 'lip': PDE quadratic with m = 1, c = 779.273, k = 1, κ = 0: order 2 is singular at "
            "harmonic 1: c/B = 0.5",
        ),
        (lambda: crossing_factors(-0.25, 3, True, [0.5]), "λ/β = -0.25 has no solution at harmonic 1"),
    ],
)  # fmt: skip
def test_bad_input_is_a_value_error_that_names_the_culprit(call: Callable[[], object], words: str) -> None:
    with pytest.raises(CaptureEvalError, match=re.escape(words)) as caught:
        call()
    assert isinstance(caught.value, ValueError)
    assert "\n" not in str(caught.value)


def test_a_pose_with_nan_is_a_row_and_not_an_error() -> None:
    places = np.random.default_rng(1).normal(size=(3, 8, 3))
    places[1, 4] = np.nan
    table = evaluate_curves(ring(places), T, LINEAR, 1.0).table
    assert table.n_points.tolist() == [[0]]
    assert len(table.rows()) == 1


def test_meshes_that_do_not_fit_or_have_no_extent_are_named(tmp_path: Path) -> None:
    square = PolygonMesh.from_faces([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2, 3]])
    more = PolygonMesh.from_faces([*square.vertices.tolist(), [2, 2, 2]], [[0, 1, 2, 3]])
    (tmp_path / "curves.yaml").write_text("curves:\n- {name: rim, vertices: [0, 1, 2, 3], closed: true}\n")

    def evaluate(second: PolygonMesh, first: PolygonMesh = square) -> object:
        for name, mesh in (("a", first), ("b", second), ("c", first)):
            write_mesh(tmp_path / f"{name}.obj", mesh)
        meshes = [tmp_path / f"{name}.obj" for name in "abc"]
        return evaluate_meshes(meshes, T, tmp_path / "curves.yaml", [("linear", {})], tmp_path / "report")

    with pytest.raises(ValueError, match=r"b\.obj: 5 vertices, but .*a\.obj has 4"):
        evaluate(more)
    turned = PolygonMesh.from_faces(square.vertices, [[1, 2, 3, 0]])
    with pytest.raises(ValueError, match=r"b\.obj: its faces differ"):
        evaluate(turned)
    point = square.with_vertices(np.zeros((4, 3)))
    with pytest.raises(ValueError, match="all points are in one place"):
        evaluate(point, point)
    assert not (tmp_path / "report" / "summary.json").exists()
