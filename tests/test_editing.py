"""Expression editing against formulas, finite differences and recorded faces."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.optimize import minimize

from capture_eval.cameras import Intrinsics, View, pixel_rays, project
from capture_eval.editing.blend_weights import (
    Balance,
    closed_form_weights,
    control_weights,
    coupled_weights,
    invariant_system,
    iterative_weights,
    printed_system,
    proximity_penalties,
    weight_energy,
)
from capture_eval.editing.coherency import (
    blend,
    coherency_columns,
    coherency_of,
    coherent_motion,
    example_motion,
    influence_maps,
    soft_regions,
)
from capture_eval.editing.control_targets import ControlPoint, gather_targets
from capture_eval.editing.example_blending import blend_whole_face
from capture_eval.editing.expression_editor import Edit, EditOptions, ExpressionEditor
from capture_eval.editing.picking import VertexPicker
from capture_eval.editing.principal_components import fit_components, principal_components
from capture_eval.editing.projection import Projection
from capture_eval.editing.radial_influence import RadialInfluenceEditor
from capture_eval.errors import InputError
from capture_eval.images.head import Head
from capture_eval.images.mannequin import build_mannequin

Floats = NDArray[np.float64]
DATA = Path(__file__).parents[2] / "shared" / "data" / "makehuman_head"


@cache
def _head() -> Head:
    return build_mannequin()


@cache
def _examples() -> Floats:
    """Neutral, then four amounts of jaw_open, grin and blink_frown: all symmetric."""
    head = _head()
    posed = [head.pose(motion, amount)[0] for motion in head.motions for amount in (0.25, 0.5, 0.75, 1.0)]
    return np.array([head.skin.vertices, *posed])


def _view(width: int = 800, height: int = 900, distortion: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0)) -> View:
    """A camera 900 mm in front of the face."""
    focal = 2.2 * height
    matrix = np.array([[focal, 0.0, width / 2], [0.0, focal, height / 2], [0.0, 0.0, 1.0]])
    rotation = np.diag([1.0, -1.0, -1.0])
    return View(
        "front", Intrinsics(width, height, matrix, np.array(distortion)), rotation, np.array([0.0, -40.0, 900.0])
    )


def _control(name: str, example: int, projection: Projection | None = None) -> ControlPoint:
    vertex = _head().landmarks[name]
    place = _examples()[example, vertex]
    return ControlPoint(vertex, tuple(place if projection is None else projection.project(place)))


def _normals(vertices: Floats) -> Floats:
    quads = _head().skin.quads()
    diagonals = vertices[quads[:, 2]] - vertices[quads[:, 0]], vertices[quads[:, 3]] - vertices[quads[:, 1]]
    return np.cross(*diagonals)


# ---- projection


def test_the_screen_of_equation_2_by_hand() -> None:
    screen = Projection.from_screen(np.eye(3), [0.0, 0.0, 10.0], 2.0, 640, 480)
    # (2*1/10 + 1)*320 and (1 - 2*2/10)*240
    np.testing.assert_allclose(screen.project([1.0, 2.0, 0.0]), [384.0, 144.0], rtol=0, atol=1e-12)


def test_a_photos_camera_projects_as_the_ground_type_does() -> None:
    view = _view(distortion=(-0.1, 0.05, 0.002, -0.003))
    points = np.random.default_rng(0).normal(scale=80.0, size=(50, 3))
    np.testing.assert_allclose(Projection.from_view(view).project(points), project(view, points)[0], atol=1e-10)


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=20, deadline=None)
def test_the_jacobian_is_the_limit_of_differences(seed: int) -> None:
    random = np.random.default_rng(seed)
    screens = [
        Projection.from_view(_view(distortion=tuple(random.normal(scale=[0.1, 0.05, 0.01, 0.01])))),
        Projection.from_screen(np.eye(3), [0.0, 0.0, 600.0], random.uniform(1, 4), 640, 480),
    ]
    point, step = random.normal(scale=60.0, size=3), 1e-4
    for screen in screens:
        _, jacobian = screen.project_with_jacobian(point)
        moved = [(screen.project(point + d) - screen.project(point - d)) / (2 * step) for d in step * np.eye(3)]
        # central differences: error of order step², about 1e-8 of the slope, and rounding of 1e-13 / step
        np.testing.assert_allclose(jacobian, np.array(moved).T, rtol=0, atol=1e-6)


# ---- weights


def _systems() -> list[tuple[object, object]]:
    projection = Projection.from_view(_view())
    names, rows = ("lip_corner_left", "lip_lower_top", "lid_upper_left"), (8, 3, 11)
    vertices = [_head().landmarks[name] for name in names]
    positions = _examples()[:, vertices].transpose(1, 0, 2)
    pixels = [_control(name, row, projection) for name, row in zip(names, rows, strict=True)]
    shifted = [ControlPoint(c.vertex, (c.target[0] + 7.0, c.target[1] - 3.0)) for c in pixels]
    targets = gather_targets(shifted, projection, 0.9)
    return [(printed_system(positions), targets), (invariant_system(positions), targets)]


@pytest.mark.parametrize("form", [0, 1], ids=["printed", "invariant"])
def test_the_gradient_of_equation_6_is_the_limit_of_differences(form: int) -> None:
    system, targets = _systems()[form]
    random = np.random.default_rng(form)
    weights = random.normal(scale=0.2, size=system.basis.shape[:2])
    weights[:, 0] += 1.0 - weights.sum(axis=1) if form == 0 else 0.0
    balance, step = Balance(), 1e-6
    _, gradient = weight_energy(system, targets, balance, weights)
    for k in range(weights.shape[1]):
        change = np.zeros_like(weights)
        change[:, k] = step
        upper, _ = weight_energy(system, targets, balance, weights + change)
        lower, _ = weight_energy(system, targets, balance, weights - change)
        difference = (upper - lower) / (2 * step)
        scale = np.abs(gradient).max()
        np.testing.assert_allclose(gradient[:, k], difference, rtol=0, atol=1e-7 * scale)


@pytest.mark.parametrize("form", [0, 1], ids=["printed", "invariant"])
def test_three_unknowns_reach_the_minimum_over_all_weights(form: int) -> None:
    system, targets = _systems()[form]
    found = iterative_weights(system, targets, Balance())
    energy, gradient = weight_energy(system, targets, Balance(), found)
    # stationary in all weights, not only in the span that was searched: 1e-9 of the gradient at zero displacement
    start = np.zeros_like(found)
    start[:, 0] = 1.0 if form == 0 else 0.0
    _, first = weight_energy(system, targets, Balance(), start)
    assert np.abs(gradient).max() < 1e-8 * np.abs(first).max()

    def everything(weights: Floats) -> tuple[float, Floats]:
        value, slope = weight_energy(system, targets, Balance(), weights.reshape(found.shape))
        return float(value.sum()), slope.ravel()

    direct = minimize(everything, start.ravel(), jac=True, method="L-BFGS-B", options={"maxiter": 500, "maxfun": 1000})
    assert energy.sum() <= direct.fun + 1e-9


@pytest.mark.parametrize("make", [printed_system, invariant_system])
def test_equation_6_with_the_identity_is_the_closed_form(make: object) -> None:
    vertices = [_head().landmarks[name] for name in ("lip_corner_left", "chin", "brow_left")]
    system = make(_examples()[:, vertices].transpose(1, 0, 2))
    controls = [ControlPoint(v, tuple(_examples()[6, v] + [2.0, -1.0, 1.5])) for v in vertices]
    targets = gather_targets(controls, None)
    closed = closed_form_weights(system, targets, Balance())
    np.testing.assert_allclose(iterative_weights(system, targets, Balance()), closed, rtol=0, atol=1e-9)
    for row in range(len(vertices)):  # and both are what the normal equations of Eq 5 say
        basis = system.basis[row]
        penalty = proximity_penalties(system, targets)[row]
        normal = 2.0 * basis @ basis.T + np.diag(penalty)
        direct = np.linalg.solve(normal, 2.0 * basis @ (targets.values[row] - system.origin[row]))
        np.testing.assert_allclose(closed[row], direct, rtol=0, atol=1e-9)


def test_one_coupled_control_point_is_equation_6() -> None:
    system, targets = _systems()[1]
    first = np.array([True, False, False])
    alone = control_weights(system.select(first), targets.select(first), Balance())
    coupled = coupled_weights(system.select(first), targets.select(first), Balance(), np.ones((1, 1)))
    np.testing.assert_allclose(coupled, alone, rtol=0, atol=1e-9)


# ---- coherency


def _coherency_by_the_formula(examples: Floats, control: int) -> Floats:
    """Eqs 7 and 8, written out."""
    neutral = examples[0]
    largest = max(np.linalg.norm(neutral - point, axis=1).max() for point in neutral)
    total = np.zeros(len(neutral))
    for mesh in examples[1:]:
        own, other = mesh - neutral, (mesh - neutral)[control]
        a, c = np.linalg.norm(own, axis=1), np.linalg.norm(other)
        with np.errstate(invalid="ignore", divide="ignore"):
            r = 0.5 * (1.0 + own @ other / (a * c))
            s = np.minimum(a / c, c / a)
        zero = (a == 0) | (c == 0)
        total += np.where(zero, 1.0, r * s)
    distance = np.linalg.norm(neutral - neutral[control], axis=1)
    return (1.0 - distance / largest) * total / (len(examples) - 1)


def test_coherency_is_equations_7_and_8() -> None:
    random = np.random.default_rng(4)
    examples = np.concatenate([random.normal(size=(1, 60, 3)), np.zeros((9, 60, 3))])
    examples[1:] = examples[0] + random.normal(size=(9, 60, 3)) * random.integers(0, 2, size=(9, 60, 1))
    columns = coherency_columns(example_motion(examples), [3, 17])
    for k, control in enumerate((3, 17)):
        np.testing.assert_allclose(columns[:, k], _coherency_by_the_formula(examples, control), rtol=0, atol=1e-12)
    assert columns[3, 0] == pytest.approx(1.0, abs=1e-12)
    assert columns.min() >= 0.0
    assert columns.max() <= 1.0


@pytest.mark.parametrize(("expressions", "sharpness"), [(1, 1.0), (7, 2.0), (8, 2.5), (19, 2.0)])
def test_one_pass_is_the_formulas_one_after_the_other(expressions: int, sharpness: float) -> None:
    random = np.random.default_rng(expressions)
    examples = np.tile(random.normal(size=(1, 130, 3)), (expressions + 1, 1, 1))  # more than two blocks of vertices
    moves = random.integers(0, 2, size=(expressions, 130, 1))
    examples[1:] += random.normal(size=(expressions, 130, 3)) * moves
    motion, controls = example_motion(examples), np.array([129, 3, 17])
    weights = random.normal(size=(3, expressions))
    coherency = np.stack([_coherency_by_the_formula(examples, control) for control in controls], axis=1)
    powers = coherency**sharpness
    shares = powers / powers.sum(axis=1, keepdims=True)
    moved = np.einsum("nl,lm,mni->ni", shares, weights, examples[1:] - examples[0])
    known = {3: coherency[:, 1]}
    for result in (
        coherent_motion(motion, controls, weights, sharpness),
        coherent_motion(motion, controls, weights, sharpness, known=known),
    ):
        for found, expected in zip(result, (coherency, shares, moved), strict=True):
            np.testing.assert_allclose(found, expected, rtol=0, atol=1e-11)  # sums of tens of numbers of about 1
    np.testing.assert_allclose(blend(motion, shares, weights), moved, rtol=0, atol=1e-11)
    rows = coherency_columns(motion, controls.tolist())[controls]
    np.testing.assert_allclose(coherency_of(motion, controls, controls), rows, rtol=0, atol=1e-15)


def test_shares_sum_to_one_and_a_vertex_coherent_with_none_stays() -> None:
    coherency = np.array([[0.5, 0.25], [0.0, 0.0], [1.0, 0.0]])
    np.testing.assert_allclose(influence_maps(coherency), [[2 / 3, 1 / 3], [0.0, 0.0], [1.0, 0.0]], atol=1e-15)
    np.testing.assert_array_equal(soft_regions(influence_maps(coherency)), [[1, 1], [0, 0], [1, 0]])
    # two points as far apart as can be, moving in opposite directions: each is coherent with itself alone
    square = np.array([[0.0, 0, 0], [4, 0, 0], [2, 1, 0]])
    moved = square + np.array([[0.0, 1, 0], [0, -1, 0], [0, 0, 0]])
    editor = ExpressionEditor(np.array([square, moved]), EditOptions.printed())
    np.testing.assert_array_equal(editor.edit([ControlPoint(0, (0.0, 1.0, 0.0))]).vertices[1], square[1])


# ---- the editor


@pytest.mark.parametrize("example", [4, 8, 12])
def test_a_recorded_expression_is_reproduced_at_its_control_points(example: int) -> None:
    names = ("lip_corner_left", "lip_corner_right", "chin", "lip_lower_top", "lid_upper_left", "brow_right")
    options = EditOptions(Balance(proximity=1e-9))
    editor = ExpressionEditor(_examples(), options)
    edit = editor.edit([_control(name, example) for name in names])
    assert edit.misses.max() < 1e-5  # millimetres, of the order of theta2
    # and with them the expression: the rest of the face follows to a tenth of the largest motion
    motion = np.linalg.norm(_examples()[example] - _examples()[0], axis=1).max()
    assert np.linalg.norm(edit.vertices - _examples()[example], axis=1).max() < 0.1 * motion
    projection = Projection.from_view(_view())
    on_screen = editor.edit([_control(name, example, projection) for name in names], projection)
    assert on_screen.misses.max() < 1e-5


def test_one_control_point_is_reproduced_in_the_printed_form() -> None:
    options = EditOptions(Balance(proximity=1e-9), invariant=False, normalise=False, reach=None, coupled=False)
    edit = ExpressionEditor(_examples(), options).edit([_control("lip_corner_left", 8)])
    assert edit.misses[0] < 1e-6


def _asymmetric_smile(editor: ExpressionEditor, projection: Projection) -> Edit:
    names, rows = ("lip_corner_left", "lip_corner_right", "lip_lower_bottom"), (8, 0, 0)
    return editor.edit([_control(name, row, projection) for name, row in zip(names, rows, strict=True)], projection)


def test_symmetric_examples_give_an_asymmetric_smile_without_tearing() -> None:
    projection = Projection.from_view(_view())
    edit = _asymmetric_smile(ExpressionEditor(_examples()), projection)
    left, right = (_head().landmarks[f"lip_corner_{side}"] for side in ("left", "right"))
    moved = np.linalg.norm(edit.vertices - _examples()[0], axis=1)
    full = np.linalg.norm(_examples()[8, left] - _examples()[0, left])
    assert moved[left] > 0.8 * full
    assert moved[right] < 0.1 * full
    neutral = _normals(_examples()[0])
    turned_before = np.any([np.sum(_normals(mesh) * neutral, axis=1) < 0 for mesh in _examples()], axis=0)
    turned = np.sum(_normals(edit.vertices) * neutral, axis=1) < 0
    assert not np.any(turned & ~turned_before)


@pytest.mark.skipif(not DATA.is_dir(), reason="the MakeHuman head is not in ../shared/data")
def test_mirrored_makehuman_expressions_give_an_asymmetric_smile_without_tearing() -> None:
    with np.load(DATA / "expressions.npz") as file, np.load(DATA / "faces.npz") as faces:
        names = ("neutral", "sad", "angry", "confused", "grinning", "puff")
        recorded = np.array([file[name] for name in names], dtype=np.float64)
        quads = faces["faces"].astype(np.int64)
    from scipy.spatial import KDTree

    mirror = KDTree(recorded[0]).query(recorded[0] * [-1, 1, 1])[1]
    symmetric = 0.5 * (recorded + recorded[:, mirror] * [-1, 1, 1])
    motion = np.linalg.norm(symmetric[4] - symmetric[0], axis=1)
    corners = np.flatnonzero(
        (np.abs(symmetric[0, :, 0]) > 20) & (motion > 0.7 * motion.max()) & (symmetric[0, :, 2] > 60)
    )
    left = corners[np.argmax(symmetric[0, corners, 0] + 2 * motion[corners])]
    right = mirror[left]
    targets = (tuple(symmetric[4, left]), tuple(symmetric[0, right]))
    editor = ExpressionEditor(symmetric)
    edit = editor.edit([ControlPoint(int(v), t) for v, t in zip((left, right), targets, strict=True)])
    moved = np.linalg.norm(edit.vertices - symmetric[0], axis=1)
    assert moved[left] > 3 * moved[right]

    def normals(mesh: Floats) -> Floats:
        return np.cross(mesh[quads[:, 2]] - mesh[quads[:, 0]], mesh[quads[:, 3]] - mesh[quads[:, 1]])

    neutral = normals(symmetric[0])
    before = np.any([np.sum(normals(mesh) * neutral, axis=1) < 0 for mesh in symmetric], axis=0)
    assert not np.any((np.sum(normals(edit.vertices) * neutral, axis=1) < 0) & ~before)


def _shifted(options: EditOptions, shift: Floats) -> tuple[Floats, Floats]:
    examples = _examples()
    controls = [_control("lip_corner_left", 7), _control("chin", 2)]
    moved = [ControlPoint(c.vertex, tuple(np.add(c.target, shift))) for c in controls]
    here = ExpressionEditor(examples, options).edit(controls).vertices
    there = ExpressionEditor(examples + shift, options).edit(moved).vertices
    return here, there - shift


def test_shifting_everything_shifts_the_default_result_and_not_the_printed_one() -> None:
    shift = np.array([512.0, -256.0, 1024.0])
    here, there = _shifted(EditOptions(), shift)
    # exact but for the rounding of coordinates of a thousand millimetres
    assert np.abs(here - there).max() < 1e-9
    here, there = _shifted(EditOptions.printed(), shift)
    assert np.abs(here - there).max() > 1e-3  # millimetres: nothing keeps the printed weights' sum at one


def test_shifting_model_and_camera_shifts_the_default_result_on_screen() -> None:
    shift = np.array([300.0, 20.0, -40.0])
    view = _view()
    moved_view = View("moved", view.intrinsics, view.rotation, view.translation - view.rotation @ shift)
    controls = [_control(name, 7, Projection.from_view(view)) for name in ("lip_corner_left", "chin")]
    here = ExpressionEditor(_examples()).edit(controls, Projection.from_view(view)).vertices
    there = ExpressionEditor(_examples() + shift).edit(controls, Projection.from_view(moved_view)).vertices
    assert np.abs(here + shift - there).max() < 1e-7  # the iteration ends at slopes of 1e-10


def test_the_default_does_not_depend_on_picture_size_or_unit() -> None:
    projection = Projection.from_view(_view())
    half = Projection.from_view(_view(400, 450))
    names = ("lip_corner_left", "chin")
    full = ExpressionEditor(_examples()).edit([_control(name, 7, projection) for name in names], projection)
    small = ExpressionEditor(_examples()).edit([_control(name, 7, half) for name in names], half)
    assert np.abs(full.vertices - small.vertices).max() < 1e-7
    in_space = [_control(name, 7) for name in names]
    metres = [ControlPoint(c.vertex, tuple(np.divide(c.target, 1000.0))) for c in in_space]
    scaled = ExpressionEditor(_examples() / 1000.0).edit(metres).vertices
    assert np.abs(1000.0 * scaled - ExpressionEditor(_examples()).edit(in_space).vertices).max() < 1e-8


def test_reusing_an_edit_changes_nothing() -> None:
    projection = Projection.from_view(_view())
    for options in (EditOptions(), EditOptions.printed()):
        editor = ExpressionEditor(_examples(), options)
        first = editor.edit(
            [_control("lip_corner_left", 8, projection), _control("brow_left", 12, projection)], projection
        )
        later = [_control("lip_corner_left", 8, projection), _control("chin", 3, projection)]
        again = editor.edit(later, projection, previous=first)
        np.testing.assert_allclose(again.vertices, editor.edit(later, projection).vertices, rtol=0, atol=1e-6)


def test_a_drag_too_far_stays_a_face() -> None:
    editor = ExpressionEditor(_examples())
    chin = _head().landmarks["chin"]
    full = np.linalg.norm(_examples()[4, chin] - _examples()[0, chin])
    places = [
        _examples()[0, chin] + share * (_examples()[4, chin] - _examples()[0, chin]) for share in (1.0, 3.0, 30.0)
    ]
    edits = [editor.edit([ControlPoint(chin, tuple(place))]) for place in places]
    moved = [np.linalg.norm(edit.vertices[chin] - _examples()[0, chin]) for edit in edits]
    assert [bool(edit.limited[0]) for edit in edits] == [False, True, True]
    assert moved[0] == pytest.approx(full, rel=0.02)
    assert moved[1] == pytest.approx(moved[2], rel=1e-6)
    assert full < moved[1] < 1.5 * full
    free = ExpressionEditor(_examples(), EditOptions(reach=None)).edit([ControlPoint(chin, tuple(places[2]))])
    assert np.linalg.norm(free.vertices[chin] - _examples()[0, chin]) < 0.3 * full  # back to rest: why there is a reach


# ---- picking and the methods compared with


def test_a_pixel_picks_the_vertex_it_shows() -> None:
    view, head = _view(), _head()
    names = ("nose_tip", "chin", "brow_left", "glabella")
    vertices = np.array([head.landmarks[name] for name in names])
    pixels, _ = project(view, head.skin.vertices[vertices])
    np.testing.assert_array_equal(VertexPicker(head.skin).pick(view, pixels), vertices)
    origin, direction = pixel_rays(view, pixels[:1])
    towards = head.skin.vertices[vertices[0]] - origin
    assert float(direction[0] @ towards / np.linalg.norm(towards)) == pytest.approx(1.0, abs=1e-12)


def test_the_other_methods_meet_one_target_and_cannot_take_sides() -> None:
    projection = Projection.from_view(_view())
    editor = ExpressionEditor(_examples())
    model = principal_components(editor.motion)
    one = [_control("lip_corner_left", 8, projection)]
    sides = [_control("lip_corner_left", 8, projection), _control("lip_corner_right", 0, projection)]
    drag = np.linalg.norm(np.subtract(one[0].target, _control("lip_corner_left", 0, projection).target))
    for edit in (
        lambda controls: blend_whole_face(editor.motion, controls, projection),
        lambda controls: fit_components(editor.motion, model, controls, projection),
    ):
        assert edit(one).misses.max() < 0.02 * drag
        assert edit(sides).misses.max() > 0.3 * drag  # symmetric components: both corners go half the way
    assert editor.edit(sides, projection).misses.max() < 0.15 * drag
    radial = RadialInfluenceEditor(_examples()).edit(sides, projection)
    assert radial.misses.max() < 0.15 * drag
    np.testing.assert_allclose(radial.influence.sum(axis=1), 1.0, atol=1e-12)


# ---- bad input

ONE = ControlPoint(0, (1.0, 2.0, 3.0))


@pytest.mark.parametrize(
    ("examples", "text"),
    [
        (np.zeros((0, 5, 3)), "no example"),
        (np.random.default_rng(0).normal(size=(1, 5, 3)), "one example"),
        (np.zeros((3, 5)), "expected"),
        (np.full((2, 5, 3), np.nan), "vertex 0 of example 0 is not finite"),
    ],
)
def test_bad_examples(examples: Floats, text: str) -> None:
    with pytest.raises(InputError, match=text) as error:
        ExpressionEditor(examples)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("controls", "text"),
    [
        ([], "no control point"),
        ([ONE, ONE], "control 0: the vertex is given twice"),
        ([ControlPoint(10**6, (0.0, 0.0, 0.0))], "control 1000000: the mesh has the vertices"),
        ([ControlPoint(0, (1.0, 2.0))], "control 0: a pixel as target needs a camera"),
    ],
)
def test_bad_control_points(controls: list[ControlPoint], text: str) -> None:
    with pytest.raises(InputError, match=text):
        ExpressionEditor(_examples()).edit(controls)


def test_what_lies_behind_the_camera_is_refused() -> None:
    projection = Projection.from_view(_view())
    editor = ExpressionEditor(_examples())
    with pytest.raises(InputError, match="control 0: the target lies behind the camera"):
        editor.edit([ControlPoint(0, (0.0, 0.0, 2000.0))], projection)
    behind = View("behind", _view().intrinsics, np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, -900.0]))
    with pytest.raises(InputError, match="behind the camera"):
        editor.edit([ControlPoint(0, (10.0, 10.0))], Projection.from_view(behind))


def test_numbers_that_are_not_finite_and_pixels_beside_the_face() -> None:
    with pytest.raises(InputError, match="control 3: the target"):
        ControlPoint(3, (np.nan, 1.0))
    with pytest.raises(InputError, match="expected x,y or x,y,z"):
        ControlPoint(3, (1.0,))
    picker = VertexPicker(_head().skin)
    with pytest.raises(InputError, match=r"the pixel \(2, 3\) of front hits nothing"):
        picker.pick(_view(), [[2.0, 3.0]])
    with pytest.raises(InputError, match="finite"):
        picker.pick(_view(), [[np.inf, 3.0]])
    with pytest.raises(InputError, match="theta"):
        Balance(proximity=0.0)
    with pytest.raises(InputError, match="reach"):
        EditOptions(reach=0.5)
