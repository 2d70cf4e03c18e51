"""Blendshapes: the grid of weights, Eqs 36-40 of paper 003, whole meshes from curves, streaming to disk."""

import re
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

from capture_eval.command_line.main import build_application
from capture_eval.curves.extract import Curve
from capture_eval.errors import InputError
from capture_eval.files.atomic import read_npz, write_npz
from capture_eval.files.mesh_files import read_mesh, write_mesh
from capture_eval.interpolation.blendshapes import (
    blend_basis,
    blend_blocks,
    blend_into,
    block_size,
    expression_motion,
    vertices_on_curves,
)
from capture_eval.interpolation.mesh_extension import MeshExtension
from capture_eval.interpolation.methods import create_method
from capture_eval.interpolation.weight_grid import check_weights, first_of_equals, normalise_weights, weight_grid
from capture_eval.polygon_mesh import PolygonMesh
from capture_eval.stages.blend import BlendOptions, blend_expressions, read_weights

SIDE = 9


def sheet(bump: float = 0.3) -> PolygonMesh:
    """A square of quads, slightly domed."""
    x, y = np.meshgrid(np.linspace(0, 1, SIDE), np.linspace(0, 1, SIDE), indexing="ij")
    vertices = np.stack([x, y, bump * np.sin(np.pi * x) * np.sin(np.pi * y)], axis=-1).reshape(-1, 3)
    index = np.arange(SIDE * SIDE).reshape(SIDE, SIDE)
    quads = np.stack([index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]], axis=-1).reshape(-1, 4)
    return PolygonMesh.from_faces(vertices, quads)


def two_curves() -> tuple[Curve, ...]:
    index = np.arange(SIDE * SIDE).reshape(SIDE, SIDE)
    return Curve("row", index[2], False), Curve("column", index[:, 6], False)


def targets(count: int) -> list[np.ndarray]:
    rng = np.random.default_rng(4)
    return [sheet().vertices + 0.2 * rng.normal(size=(SIDE * SIDE, 3)) for _ in range(count)]


def extension(kind: str = "harmonic") -> MeshExtension:
    mesh = sheet()
    on = vertices_on_curves(two_curves(), len(mesh.vertices))
    return MeshExtension(mesh.vertices, mesh.triangles()[0], on, kind)  # type: ignore[arg-type]


def test_the_grid_of_the_paper() -> None:
    """6⁵ − 1 = 7,775 combinations; 7,471 after scaling: of (a, b, …) and its multiples one is kept."""
    rows = weight_grid([0, 0.2, 0.4, 0.6, 0.8, 1], 5)
    assert rows.shape == (7775, 5)
    assert len(np.unique(rows, axis=0)) == 7775
    scaled = normalise_weights(rows, 5)
    np.testing.assert_allclose(scaled.sum(axis=1), 1)
    first = first_of_equals(scaled)
    assert len(first) == 7471
    whole = np.rint(rows * 5).astype(int)  # independent count: directions are integer rows over their common divisor
    divisor = np.gcd.reduce(whole, axis=1)
    assert len({tuple(row) for row in whole // divisor[:, None]}) == 7471
    example = np.flatnonzero((np.abs(rows - [0.2, 0.0, 0.6, 1.0, 0.8]) < 1e-9).all(axis=1))
    np.testing.assert_allclose(scaled[example[0]], [0.0769, 0, 0.2308, 0.3846, 0.3077], atol=5e-5)
    assert len(weight_grid([0.5, 1.0], 3)) == 8


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10**6), t=st.floats(0, 1), name=st.sampled_from(["pde_quadratic", "pde_causal", "cosine"]))
def test_blending_coefficients_is_blending_shapes(seed: int, t: float, name: str) -> None:
    """Eqs 39 and 40 against Eq 38, with Σξ = 1: the blend moves as the interpolation to the blend of the targets."""
    mesh, shapes, method = sheet(), targets(3), create_method(name)
    weights = np.random.default_rng(seed).dirichlet(np.ones(3))
    follow = extension()
    motions = [expression_motion(mesh.vertices, shape, two_curves(), method, t, follow) for shape in shapes]
    found = next(iter(blend_blocks(weights, blend_basis(mesh.vertices, motions))))[0]
    at_t = sum(w * (mesh.vertices + motion) for w, motion in zip(weights, motions, strict=True))
    np.testing.assert_allclose(found, at_t, atol=1e-12)
    blended = sum(w * shape for w, shape in zip(weights, shapes, strict=True))
    for curve in two_curves():
        alone = method.predict(mesh.vertices[curve.vertices], blended[curve.vertices], False, [t])[0]
        crossing = np.isin(curve.vertices, np.intersect1d(*(one.vertices for one in two_curves())))
        np.testing.assert_allclose(found[curve.vertices][~crossing], alone[~crossing], atol=1e-12)


@pytest.mark.parametrize("kind", ["harmonic", "biharmonic"])
@pytest.mark.parametrize("name", ["linear", "pde_quadratic", "pde_causal", "beta"])
def test_whole_meshes_meet_both_shapes_and_follow_the_curves(name: str, kind: str) -> None:
    mesh, shape = sheet(), targets(1)[0]
    method, follow = create_method(name), extension(kind)
    moved = {t: expression_motion(mesh.vertices, shape, two_curves(), method, t, follow) for t in (0.0, 0.5, 1.0)}
    np.testing.assert_allclose(moved[0.0], 0, atol=1e-13)
    np.testing.assert_allclose(moved[1.0], shape - mesh.vertices, atol=1e-12)
    if name in ("linear", "beta"):  # one timing for all: vertices on no curve have it too
        np.testing.assert_allclose(moved[0.5], 0.5 * (shape - mesh.vertices), atol=1e-12)
    still = expression_motion(mesh.vertices, mesh.vertices, two_curves(), method, 0.5, follow)
    np.testing.assert_allclose(still, 0, atol=1e-13)


def test_the_extension_keeps_constants_and_harmonic_bounds() -> None:
    mesh = sheet(0.0)
    index = np.arange(SIDE * SIDE).reshape(SIDE, SIDE)
    rim = np.zeros(SIDE * SIDE, dtype=bool)
    rim[np.concatenate([index[0], index[-1], index[:, 0], index[:, -1]])] = True
    for kind in ("harmonic", "biharmonic"):
        follow = MeshExtension(mesh.vertices, mesh.triangles()[0], rim, kind)  # type: ignore[arg-type]
        np.testing.assert_allclose(follow.extend(np.full((int(rim.sum()), 2), 3.0)), 3.0, atol=1e-11)
    harmonic = MeshExtension(mesh.vertices, mesh.triangles()[0], rim, "harmonic")
    linear = mesh.vertices @ [[1.0], [2.0], [0.0]]
    np.testing.assert_allclose(harmonic.extend(linear[rim]), linear, atol=0.05)  # weights are kept away from 0
    values = np.random.default_rng(1).normal(size=(int(rim.sum()), 1))
    assert values.min() - 1e-12 <= harmonic.extend(values).min()
    assert harmonic.extend(values).max() <= values.max() + 1e-12


def test_parts_without_a_curve_stay_and_full_cover_is_exact() -> None:
    mesh = sheet()
    both = PolygonMesh.from_faces(
        np.concatenate([mesh.vertices, mesh.vertices + np.array([5.0, 0.0, 0.0])]),
        np.concatenate([mesh.quads(), mesh.quads() + SIDE * SIDE]),
    )
    given = np.zeros(2 * SIDE * SIDE, dtype=bool)
    given[3] = True
    found = MeshExtension(both.vertices, both.triangles()[0], given, "harmonic").extend(np.array([[2.0]]))
    np.testing.assert_allclose(found[: SIDE * SIDE], 2.0, atol=1e-11)
    assert not found[SIDE * SIDE :].any()
    everything = np.ones(SIDE * SIDE, dtype=bool)
    values = np.random.default_rng(1).normal(size=(SIDE * SIDE, 3))
    exact = MeshExtension(mesh.vertices, mesh.triangles()[0], everything, "biharmonic").extend(values)
    np.testing.assert_array_equal(exact, values)


@pytest.mark.parametrize("precision", [np.float32, np.float64])
def test_blocks_are_the_product(precision: type) -> None:
    mesh, shapes = sheet(), targets(4)
    weights = weight_grid([0, 0.5, 1], 4)
    basis = blend_basis(mesh.vertices, [shape - mesh.vertices for shape in shapes], precision)
    expected = mesh.vertices + np.einsum("kj,jvi->kvi", weights, np.stack(shapes) - mesh.vertices)
    out = np.empty((80, SIDE * SIDE, 3), dtype=precision)
    blend_into(weights, basis, out)
    np.testing.assert_allclose(out, expected, atol=2e-6 if precision is np.float32 else 1e-14)
    pieces = [block.copy() for block in blend_blocks(weights, basis)]
    assert len(pieces) == 2
    np.testing.assert_array_equal(np.concatenate(pieces), out)


def write_inputs(folder: Path) -> tuple[Path, Path]:
    write_mesh(folder / "neutral.obj", sheet())
    write_npz(folder / "shapes.npz", dict(zip("ab", targets(2), strict=True)))
    return folder / "neutral.obj", folder / "shapes.npz"


def test_npz_and_obj_hold_the_same_shapes(tmp_path: Path) -> None:
    neutral, shapes = write_inputs(tmp_path)
    options = BlendOptions(levels=(0, 0.5, 1), t=0.6, precision="float32")
    result = blend_expressions(neutral, [shapes], None, tmp_path / "all.npz", options)
    assert (result["targets"], result["shapes"], result["distinct"], result["on_curves"]) == (["a", "b"], 8, 5, 1.0)
    arrays = read_npz(tmp_path / "all.npz")
    assert arrays["vertices"].shape == (8, SIDE * SIDE, 3)
    assert arrays["vertices"].dtype == np.float32
    first = (tmp_path / "all.npz").read_bytes()
    blend_expressions(neutral, [shapes], None, tmp_path / "all.npz", options)
    assert (tmp_path / "all.npz").read_bytes() == first
    blend_expressions(neutral, [shapes], None, tmp_path / "objs", options)
    for number in (0, 7):
        mesh = read_mesh(tmp_path / "objs" / f"shape_{number + 1:05d}.obj")
        np.testing.assert_array_equal(mesh.vertices.astype(np.float32), arrays["vertices"][number])
        np.testing.assert_array_equal(mesh.face_vertices, arrays["face_vertices"])
    np.testing.assert_array_equal(read_weights(tmp_path / "objs" / "weights.csv"), arrays["weights"])


def test_weights_are_scaled_unless_free(tmp_path: Path) -> None:
    neutral, shapes = write_inputs(tmp_path)
    first, second = targets(2)
    base = sheet().vertices
    for free, expected in ((False, 0.25 * first + 0.75 * second), (True, 0.5 * first + 1.5 * second - base)):
        options = BlendOptions(weights=((0.5, 1.5),), free=free)
        blend_expressions(neutral, [shapes], None, tmp_path / "one.npz", options)
        np.testing.assert_allclose(read_npz(tmp_path / "one.npz")["vertices"][0], expected, atol=1e-12)


def test_memory_does_not_grow_with_the_number_of_shapes(tmp_path: Path) -> None:
    """3,124 shapes are 6 MB; a block of 64 is 0.1 MB, the weights 0.3 MB."""
    neutral, shapes = write_inputs(tmp_path)
    write_npz(tmp_path / "more.npz", dict(zip("cde", targets(3), strict=True)))
    options = BlendOptions(levels=(0, 0.25, 0.5, 0.75, 1), free=True, precision="float64")
    blend_expressions(neutral, [shapes], None, tmp_path / "small.npz", options)  # everything is imported now
    tracemalloc.start()
    blend_expressions(neutral, [shapes, tmp_path / "more.npz"], None, tmp_path / "big.npz", options)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    size = (tmp_path / "big.npz").stat().st_size
    assert size > 6e6
    assert peak < 0.5 * size
    assert [block_size(np.zeros((6, 3 * vertices))) for vertices in (12, 5071, 1_000_000)] == [64, 16, 1]


def test_the_command(tmp_path: Path) -> None:
    neutral, shapes = write_inputs(tmp_path)
    (tmp_path / "weights.csv").write_text("a,b\n1,0\n0.5,0.5\n1,1\n")
    run = CliRunner().invoke
    arguments = ["blend", str(neutral), str(shapes), "--out", str(tmp_path / "x.npz")]
    found = run(build_application(), [*arguments, "--weights-file", str(tmp_path / "weights.csv"), "--t", "0.5"])
    assert found.exit_code == 0, found.output
    assert "3 shapes of 2 targets (a, b) at t = 0.5" in found.output
    assert "2 of them are distinct" in found.output
    found = run(build_application(), [*arguments, "--levels", "0,1", "--distinct", "--option", "damping=100"])
    assert "3 shapes of 2 targets" in found.output
    assert "are distinct" not in found.output
    bad = run(build_application(), [*arguments, "--weights", "x"])
    assert bad.exit_code == 2


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"weights": ((1.0,),)}, "rows of [1] weights for 2 targets"),
        ({"weights": ((1.0, -1.0),)}, "weight -1.0 of target 1 in row 0 must be finite and not negative"),
        ({"weights": ((1.0, float("nan")),)}, "weight nan of target 1"),
        ({"weights": ((0.0, 0.0),)}, "row 0 of the weights has only zeros"),
        ({"weights": ()}, "give either weights or the levels"),
        ({"weights": ((1.0, 1.0),), "levels": (0, 1)}, "give either weights or the levels"),
        ({"t": 1.5}, "t = 1.5 must be in [0, 1]"),
        ({"method": "nothing"}, "unknown interpolation method 'nothing'"),
        ({"extension": "cubic"}, "unknown extension 'cubic'"),
    ],
)
def test_bad_options_are_refused(tmp_path: Path, change: dict[str, object], words: str) -> None:
    neutral, shapes = write_inputs(tmp_path)
    options = BlendOptions(**{"weights": ((0.5, 0.5),), **change})  # type: ignore[arg-type]
    with pytest.raises(InputError, match=re.escape(words)):
        blend_expressions(neutral, [shapes], None, tmp_path / "x.npz", options)
    assert not (tmp_path / "x.npz").exists()


def test_bad_files_are_named(tmp_path: Path) -> None:
    neutral, shapes = write_inputs(tmp_path)
    options = BlendOptions(weights=((0.5, 0.5),))
    broken = sheet().vertices.copy()
    broken[3, 0] = np.nan
    write_npz(tmp_path / "broken.npz", {"c": broken})
    write_npz(tmp_path / "other.npz", {"c": np.zeros((4, 3))})
    triangle = PolygonMesh.from_faces(np.eye(3), [[0, 1, 2]])
    write_mesh(tmp_path / "triangle.obj", triangle)
    (tmp_path / "curves.yaml").write_text("curves:\n- {name: far, vertices: [0, 500], closed: false}\n")
    for paths, curves, words in (
        ([tmp_path / "broken.npz"], None, "broken.npz: target 'c' holds positions that are not finite"),
        ([tmp_path / "other.npz"], None, "other.npz: no array of shape (81, 3); it holds c"),
        ([tmp_path / "triangle.obj"], None, "triangle.obj: not the topology of the neutral mesh (81 vertices)"),
        ([shapes, shapes], None, "shapes.npz: target 'a' is given twice"),
        ([], None, "no target expression is given"),
        ([shapes], tmp_path / "curves.yaml", "curves.yaml: curve 'far': vertex 500"),
    ):
        with pytest.raises(InputError, match=re.escape(words)):
            blend_expressions(neutral, paths, curves, tmp_path / "x.npz", options)
    (tmp_path / "bad.csv").write_text("a,b\n1,2\n3,x\n")
    with pytest.raises(InputError, match=r"bad\.csv: line 3: could not convert"):
        read_weights(tmp_path / "bad.csv")


@pytest.mark.parametrize(
    ("levels", "count", "words"),
    [
        ((0, 0.5, 0.5), 2, "must rise"),
        ((-1, 0), 2, "not negative"),
        ((0,), 2, "the only level is 0"),
        ((0, 1), 0, "at least one target"),
        (tuple(range(10)), 9, "are 1,000,000,000 shapes"),
    ],
)
def test_bad_grids_are_refused(levels: tuple[float, ...], count: int, words: str) -> None:
    with pytest.raises(InputError, match=re.escape(words)):
        weight_grid(levels, count)


def test_bad_arrays_are_refused() -> None:
    mesh = sheet()
    with pytest.raises(InputError, match=re.escape("weights have shape (1, 3), expected one row of 2")):
        check_weights([1, 2, 3], 2)
    with pytest.raises(InputError, match="must be equal"):
        expression_motion(mesh.vertices, mesh.vertices[:5], two_curves(), create_method("linear"), 0.5, extension())
    with pytest.raises(InputError, match="out is"):
        blend_into([[1.0]], blend_basis(mesh.vertices, [mesh.vertices]), np.empty((1, 2, 3)))
    with pytest.raises(InputError, match="at least one curve"):
        vertices_on_curves([], 5)
