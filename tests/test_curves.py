"""Edge loops on meshes whose loops are known, curves files both ways, and the curves of the MakeHuman head."""

import json
import re
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from capture_eval.curves.curve_specification import CurveSpecification, dump_curves, parse_curves, resolve_curve
from capture_eval.curves.edge_loops import EdgeLoop, edge_topology, maximal_loops, spoke, walk_edge_loop
from capture_eval.curves.extract import Curve, curve_problems, extract_curves, resolve_curves
from capture_eval.errors import InputError
from capture_eval.files.curve_files import read_curves, write_curves
from capture_eval.files.mesh_files import read_mesh
from capture_eval.polygon_mesh import PolygonMesh

HEAD = Path(__file__).parents[2] / "shared" / "data" / "makehuman_head"


def grid(rows: int, columns: int, wrap_rows: bool = False, wrap_columns: bool = False) -> PolygonMesh:
    """Quads on a rows × columns lattice of vertices, optionally glued into a tube or torus."""
    index = np.arange(rows * columns).reshape(rows, columns)
    if wrap_rows:
        index = np.vstack([index, index[:1]])
    if wrap_columns:
        index = np.hstack([index, index[:, :1]])
    quads = np.stack([index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]], axis=-1).reshape(-1, 4)
    y, x = np.divmod(np.arange(rows * columns), columns)
    return PolygonMesh.from_faces(np.stack([x, y, 0 * x], axis=1), quads)


def cube() -> PolygonMesh:
    corners = [[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)]
    faces = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    return PolygonMesh.from_faces(corners, faces)


def edges_of(loop: EdgeLoop) -> list[tuple[int, int]]:
    order = loop.vertices.tolist()
    pairs = pairwise([*order, order[0]] if loop.closed else order)
    return [(min(pair), max(pair)) for pair in pairs]


@settings(max_examples=40, deadline=None)
@given(rows=st.integers(3, 7), columns=st.integers(3, 7), wrap_rows=st.booleans(), wrap_columns=st.booleans())
def test_loops_of_lattices(rows: int, columns: int, wrap_rows: bool, wrap_columns: bool) -> None:
    """Rows and columns are the loops; along a rim they close when the other direction is glued."""
    topology = edge_topology(grid(rows, columns, wrap_rows, wrap_columns))
    loops = maximal_loops(topology)
    every_edge = sorted(edge for loop in loops for edge in edges_of(loop))
    assert every_edge == [tuple(edge) for edge in topology.edges.tolist()]  # a partition of the edges
    inner_rows, inner_columns = rows - 2 * (not wrap_rows), columns - 2 * (not wrap_columns)
    rims = {0: 1, 1: 2, 2: 0}[wrap_rows + wrap_columns]
    closed = inner_rows * wrap_columns + inner_columns * wrap_rows + rims
    assert sum(loop.closed for loop in loops) == closed
    assert sum(loop.border for loop in loops) == rims
    assert len(loops) == inner_rows + inner_columns + rims


def test_walk_with_turn_and_stop_by_hand() -> None:
    """On a 5 × 5 lattice: along row 1, down at column 2, stopped at row 3."""
    topology = edge_topology(grid(5, 5))
    straight = walk_edge_loop(topology, (5, 6))
    assert (straight.vertices.tolist(), straight.closed) == ([5, 6, 7, 8, 9], False)
    turned = walk_edge_loop(topology, (5, 6), turns={7: 12}, stop=17)
    assert turned.vertices.tolist() == [5, 6, 7, 12, 17]
    ring = walk_edge_loop(topology, (6, 7), turns={8: 13, 18: 17, 16: 11, 6: 7})
    assert (ring.vertices.tolist(), ring.closed) == ([6, 7, 8, 13, 18, 17, 16, 11], True)
    back = walk_edge_loop(topology, (6, 7), turns={8: 13, 18: 17, 16: 11}, stop=6)
    assert back.closed
    assert back.vertices.tolist() == ring.vertices.tolist()
    border = walk_edge_loop(topology, (0, 1))
    assert border.closed
    assert border.border
    assert len(border.vertices) == 16


def test_walks_stop_at_irregular_vertices() -> None:
    topology = edge_topology(cube())
    assert all(loop.edge_count == 1 for loop in maximal_loops(topology))  # every corner has valence 3
    assert walk_edge_loop(topology, (0, 1), turns={1: 3}).vertices.tolist() == [0, 1, 3]
    triangles = PolygonMesh.from_faces(grid(4, 4).vertices, grid(4, 4).triangles()[0])
    inner = [loop for loop in maximal_loops(edge_topology(triangles)) if not loop.border]
    assert max(loop.edge_count for loop in inner) <= 2


def test_spokes_count_in_face_winding() -> None:
    topology = edge_topology(grid(5, 5))
    around = [spoke(topology, 11, 12, number) for number in range(5)]
    assert around[0] == around[4] == 11
    assert around[2] == 13
    assert {around[1], around[3]} == {7, 17}
    with pytest.raises(InputError, match="a border is between"):
        spoke(topology, 6, 5, 4)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"start_edge": (0, 6)}, "vertices 0 and 6 are not joined by an edge"),
        ({"start_edge": (0, 99)}, "vertex 99 is not in the mesh, which has 25"),
        ({"start_edge": (5, 6), "turns": {7: 13}}, "vertices 7 and 13 are not joined"),
        ({"start_edge": (5, 6), "stop": 12}, "ends at vertex 9 without meeting stop vertex 12"),
        ({"start_edge": (5, 6), "stop": 40}, "stop vertex 40 is not in the mesh"),
        ({"start_edge": (1, 6), "turns": {6: 7, 8: 13, 13: 12, 12: 11, 11: 6}}, "runs in circles past its start"),
    ],
)
def test_impossible_walks_are_refused(arguments: dict[str, object], words: str) -> None:
    topology = edge_topology(grid(5, 5))
    with pytest.raises(InputError, match=re.escape(words)):
        walk_edge_loop(topology, **arguments)  # type: ignore[arg-type]


def test_meshes_without_two_sides_are_refused() -> None:
    points = np.random.default_rng(0).normal(size=(6, 3))
    with pytest.raises(InputError, match="edge 0-1 belongs to more than two faces"):
        edge_topology(PolygonMesh.from_faces(points, [[0, 1, 2], [1, 0, 3], [0, 1, 4]]))
    with pytest.raises(InputError, match="edge 0-1 has two faces of opposite winding"):
        edge_topology(PolygonMesh.from_faces(points, [[0, 1, 2], [0, 1, 3]]))
    with pytest.raises(InputError, match="uses vertex 1 twice in a row"):
        edge_topology(PolygonMesh.from_faces(points, [[0, 1, 1, 2]]))


SPECIFICATIONS = (
    CurveSpecification("row", start_edge=(5, 6), turns={7: 12}, stop=17, extra={"region": "cheek"}),
    CurveSpecification("ring", vertices=(6, 7, 12, 11), closed=True, extra={"note": "Grüße", "weights": [1, 2]}),
    CurveSpecification("spoke", start_edge=(5, 6), turn_spokes={7: 1}),
)


@pytest.mark.parametrize("ending", ["yaml", "json"])
def test_curves_files_round_trip_and_keep_unknown_keys(tmp_path: Path, ending: str) -> None:
    path = tmp_path / f"curves.{ending}"
    write_curves(path, SPECIFICATIONS, comment="made by hand")
    assert read_curves(path) == SPECIFICATIONS
    assert parse_curves(dump_curves(SPECIFICATIONS), "memory") == SPECIFICATIONS


@pytest.mark.parametrize(
    ("entry", "words"),
    [
        ({"start_edge": [0, 1]}, "entry 0 under 'curves' has no 'name'"),
        ({"name": "a"}, "curve 'a' needs either 'vertices'"),
        ({"name": "a", "vertices": [1, 2]}, "does not say 'closed: true'"),
        ({"name": "a", "vertices": [1, -2], "closed": True}, "'vertices': -2 is not a vertex number"),
        ({"name": "a", "start_edge": [1]}, "'start_edge' has 1 vertices"),
        ({"name": "a", "start_edge": [1, 2], "turns": [3]}, "'turns': expected a mapping"),
        ({"name": "a", "start_edge": [1, 2], "stop": "nose"}, "'stop': 'nose' is not a vertex number"),
        ({"name": "a", "vertices": [1, 2], "closed": "yes"}, "'closed' is 'yes'"),
    ],
)
def test_bad_curves_files_name_the_curve(entry: dict[str, object], words: str) -> None:
    with pytest.raises(InputError, match=re.escape(words)):
        parse_curves({"curves": [entry]}, "curves.yaml")


def test_bad_documents(tmp_path: Path) -> None:
    twice = {"name": "a", "start_edge": [0, 1]}
    with pytest.raises(InputError, match="two curves are called 'a'"):
        parse_curves({"curves": [twice, twice]}, "f")
    for document in ([], {}, {"curves": []}, {"curves": "all"}, None):
        with pytest.raises(InputError, match="needs a key 'curves'"):
            parse_curves(document, "f")
    (tmp_path / "bad.yaml").write_text("curves: [a, {b")
    with pytest.raises(InputError, match=r"bad\.yaml: ") as caught:
        read_curves(tmp_path / "bad.yaml")
    assert "\n" not in str(caught.value)
    with pytest.raises(InputError, match=r"none\.yaml: cannot be read"):
        read_curves(tmp_path / "none.yaml")


def test_curves_that_do_not_fit_the_mesh_are_named() -> None:
    topology = edge_topology(grid(5, 5))
    problems = curve_problems(
        [
            *SPECIFICATIONS,
            CurveSpecification("far", vertices=(1, 2, 99), closed=False),
            CurveSpecification("gap", vertices=(0, 1, 12), closed=False),
            CurveSpecification("small", vertices=(0, 1), closed=True),
            CurveSpecification("eight", vertices=(0, 1, 2, 0), closed=False),
            CurveSpecification("wrong", start_edge=(5, 6), closed=True),
        ],
        topology,
    )
    expected = [
        "curve 'far': vertex 99 is not in the mesh",
        "curve 'gap': leaves the mesh at 1 of its steps, first between 1 and 12",
        "curve 'small': 2 points; a closed curve needs at least 3",
        "curve 'eight': vertex 0 occurs 2 times; it ends where it began",
        "curve 'wrong': the loop does not close, but the file says 'closed: true'",
    ]
    assert len(problems) == len(expected)
    for problem, words in zip(problems, expected, strict=True):
        assert problem.startswith(words)


def test_extraction_picks_vertices_in_order() -> None:
    vertices = np.random.default_rng(3).normal(size=(4, 25, 3))
    curves = [Curve("b", np.array([7, 2, 3]), True), Curve("a", np.array([0, 24]), False)]
    found = extract_curves(curves, vertices)
    assert [curve.name for curve in found.curves] == ["b", "a"]
    np.testing.assert_array_equal(found.positions[0], vertices[:, [7, 2, 3]])
    np.testing.assert_array_equal(found.positions[1], vertices[:, [0, 24]])
    with pytest.raises(InputError, match="curve 'a': vertex 24 is not in the mesh"):
        extract_curves(curves, vertices[:, :20])
    with pytest.raises(InputError, match=r"shape \(25, 3\)"):
        extract_curves(curves, vertices[0])


@pytest.fixture(scope="module")
def head() -> tuple[PolygonMesh, dict[str, list[dict[str, object]]]]:
    if not HEAD.exists():
        pytest.skip("../shared/data/makehuman_head is absent")
    return read_mesh(HEAD / "neutral.obj"), json.loads((HEAD / "curves.json").read_text())


def test_the_49_curves_of_the_head_regenerate_from_their_specifications(head) -> None:  # type: ignore[no-untyped-def]
    mesh, document = head
    topology = edge_topology(mesh)
    written = [{key: value for key, value in entry.items() if key != "vertices"} for entry in document["curves"]]
    curves = resolve_curves(parse_curves({"curves": written}, "curves.json"), topology)
    assert len(curves) == 49
    for curve, entry in zip(curves, document["curves"], strict=True):
        assert curve.vertices.tolist() == entry["vertices"], curve.name
        assert curve.closed == entry["closed"]
        assert curve.extra["region"] == entry["region"]
    listed = resolve_curves(read_curves(HEAD / "curves.json"), topology)
    assert [curve.vertices.tolist() for curve in listed] == [curve.vertices.tolist() for curve in curves]


def test_all_loops_of_the_head(head) -> None:  # type: ignore[no-untyped-def]
    """The same closed loops (the rim of the neck comes on top) and the same open loops of 15 or more vertices."""
    mesh, document = head
    loops = maximal_loops(edge_topology(mesh))
    closed = {frozenset(edges_of(loop)) for loop in loops if loop.closed and not loop.border}
    expected = {frozenset(edges_of(EdgeLoop(np.array(v), True))) for v in document["all_closed_loops"]}
    assert len(expected) == 109
    assert closed == expected
    open_loops = {frozenset(edges_of(loop)) for loop in loops if not loop.closed and len(loop.vertices) >= 15}
    assert open_loops == {frozenset(edges_of(EdgeLoop(np.array(v), False))) for v in document["long_open_loops_ge15"]}
    rims = [loop for loop in loops if loop.border]
    assert [len(loop.vertices) for loop in rims] == [42]


def test_specification_without_anything_is_refused() -> None:
    with pytest.raises(InputError, match="neither vertices nor a start edge"):
        resolve_curve(CurveSpecification("empty"), edge_topology(grid(3, 3)))
