"""`capture-eval curves list` and `curves check` on a small tube, as a user runs them."""

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from capture_eval.command_line.curves import application
from capture_eval.curves.edge_loops import edge_topology, walk_edge_loop
from capture_eval.errors import InputError
from capture_eval.files.mesh_files import read_mesh, write_mesh
from capture_eval.polygon_mesh import PolygonMesh
from capture_eval.stages.curves import check_curves, list_loops

CURVES = """curves:
- {name: ring, start_edge: [16, 17], closed: true}
- {name: line, start_edge: [3, 11]}
"""


@pytest.fixture
def mesh_path(tmp_path: Path) -> Path:
    rows, around = 6, 8
    index = np.arange(rows * around).reshape(rows, around)
    index = np.hstack([index, index[:, :1]])
    quads = np.stack([index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]], axis=-1).reshape(-1, 4)
    row, angle = np.divmod(np.arange(rows * around), around)
    angle = 2 * np.pi * angle / around
    points = np.stack([np.cos(angle), 0.5 * row, np.sin(angle)], axis=1)
    write_mesh(tmp_path / "tube.obj", PolygonMesh.from_faces(points, quads))
    return tmp_path / "tube.obj"


def test_listed_loops_walk_again_from_their_start_edges(mesh_path: Path) -> None:
    loops = list_loops(mesh_path)
    assert [loop.label for loop in loops] == [str(number) for number in range(1, 15)]
    assert [loop.closed for loop in loops] == [True] * 6 + [False] * 8
    assert sum(loop.border for loop in loops) == 2
    topology = edge_topology(read_mesh(mesh_path))
    for loop in loops:
        start, following = loop.vertices[:2].tolist()
        assert walk_edge_loop(topology, (start, following)).vertices.tolist() == loop.vertices.tolist()
        expected = 16 * np.sin(np.pi / 8) if loop.closed else 2.5
        assert loop.length == pytest.approx(expected, rel=1e-12)
    assert [loop.label for loop in list_loops(mesh_path, 8)] == ["1", "2", "3", "4", "5", "6"]
    with pytest.raises(InputError, match=r"tube\.obj: no edge loop has 9 or more vertices"):
        list_loops(mesh_path, 9)


def test_list_command_prints_and_draws(mesh_path: Path) -> None:
    picture = mesh_path.with_name("loops.png")
    arguments = ["list", str(mesh_path), "--min-length", "6", "--picture", str(picture)]
    result = CliRunner().invoke(application, arguments)
    assert result.exit_code == 0, result.output
    lines = result.output.splitlines()
    assert lines[1].split()[:3] == ["1", "rim", "8"]
    assert lines[-2] == "14 loops of 6 or more vertices, 6 closed and 8 open"
    from PIL import Image

    with Image.open(picture) as image:
        assert image.size[0] > 2000
        colours = np.asarray(image.convert("RGB")).reshape(-1, 3)
    assert (np.ptp(colours.astype(int), axis=1) > 80).sum() > 5000  # coloured lines, not only a grey mesh
    plain = json.loads(CliRunner().invoke(application, ["list", str(mesh_path), "--json"]).output)
    assert plain[0]["start_edge"] == plain[0]["vertices"][:2]
    with pytest.raises(InputError, match=r"written as \.png"):
        list_loops(mesh_path, 6, mesh_path.with_suffix(".gif"))


def test_check_command_names_every_problem(mesh_path: Path) -> None:
    curves = mesh_path.with_name("curves.yaml")
    curves.write_text(CURVES)
    good = CliRunner().invoke(application, ["check", str(mesh_path), str(curves)])
    assert good.exit_code == 0, good.output
    assert "2 good curves, 0 problems" in good.output
    curves.write_text(CURVES + "- {name: far, start_edge: [3, 300]}\n- {name: gap, vertices: [0, 9], closed: false}\n")
    bad = CliRunner().invoke(application, ["check", str(mesh_path), str(curves)])
    assert bad.exit_code == 1
    assert "curve 'far': vertex 300 is not in the mesh" in bad.output
    assert "curve 'gap': leaves the mesh at 1 of its steps" in bad.output
    problems, found = check_curves(mesh_path, curves)
    assert len(problems) == 2
    assert [curve.label for curve in found] == ["ring", "line"]


def test_meshes_that_are_not_manifold_are_named(tmp_path: Path) -> None:
    points = np.random.default_rng(0).normal(size=(5, 3))
    write_mesh(tmp_path / "fan.ply", PolygonMesh.from_faces(points, [[0, 1, 2], [1, 0, 3], [0, 1, 4]]))
    with pytest.raises(InputError, match=r"fan\.ply: mesh: edge 0-1 belongs to more than two faces"):
        list_loops(tmp_path / "fan.ply")
