"""``capture-eval edit``: meshes, cameras and drags from files, and what bad input gets."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from capture_eval.cameras import Intrinsics, View, project
from capture_eval.command_line.edit import edit as edit_command
from capture_eval.errors import InputError
from capture_eval.files.atomic import write_npz, write_text
from capture_eval.files.camera_files import write_cameras
from capture_eval.files.mesh_files import read_mesh, write_mesh
from capture_eval.polygon_mesh import PolygonMesh

Floats = NDArray[np.float64]
SIDE = 9


def _sheet() -> PolygonMesh:
    """A square of 100 units with 81 vertices, slightly bent."""
    x, y = (grid.ravel() for grid in np.meshgrid(np.linspace(-50, 50, SIDE), np.linspace(-50, 50, SIDE)))
    index = np.arange(SIDE * SIDE).reshape(SIDE, SIDE)
    corners = (index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1])
    quads = np.stack([corner.ravel() for corner in corners], axis=1)
    return PolygonMesh.from_faces(np.stack([x, y, 10 * np.cos(x / 40)], axis=1), quads)


def _bumps() -> Floats:
    """The sheet at rest, with its left side pushed up and with its right side pushed up."""
    rest = _sheet().vertices
    bumps = [
        np.exp(-np.sum((rest[:, :2] - [side, 0]) ** 2, axis=1) / 800.0)[:, None] * [0, 12, 4] for side in (-25, 25)
    ]
    return np.array([rest, *(rest + bump for bump in bumps)])


def _view() -> View:
    matrix = np.array([[400.0, 0, 160], [0, 400, 120], [0, 0, 1]])
    lens = Intrinsics(320, 240, matrix, np.zeros(4))
    return View("view_00.jpg", lens, np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 300.0]))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name, vertices in zip(("neutral", "left_up", "right_up"), _bumps(), strict=True):
        write_mesh(tmp_path / "examples" / f"{name}.obj", _sheet().with_vertices(vertices))
    write_cameras(tmp_path / "cameras.json", {"pose_00": [_view()]})
    return tmp_path


def _edit(folder: Path, *controls: str, **more: Any) -> Floats:
    examples = more.pop("examples", folder / "examples")
    edit_command(examples, folder / "out.obj", control=list(controls), **more)
    return read_mesh(folder / "out.obj").vertices


def test_a_recorded_place_gives_the_recorded_mesh(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    vertex = 38  # in the left bump
    x, y, z = _bumps()[1, vertex]
    vertices = _edit(folder, f"{vertex}:{x},{y},{z}", theta2=1e-9)
    np.testing.assert_allclose(vertices, _bumps()[1], rtol=0, atol=1e-2)
    said = capsys.readouterr().out
    assert said.startswith(f"vertex {vertex}: ")
    assert "from its target" in said


def test_pixels_picking_and_a_picture(folder: Path) -> None:
    place, goal = (project(_view(), _bumps()[row, [38]])[0][0] for row in (0, 1))
    by_vertex = _edit(folder, f"38:{goal[0]},{goal[1]}", camera=folder / "cameras.json")
    drag = f"{place[0]},{place[1]}:{goal[0]},{goal[1]}"
    picture = folder / "sheet.png"
    by_pixel = _edit(folder, drag=[drag], camera=folder / "cameras.json", view="pose_00/view_00.jpg", picture=picture)
    np.testing.assert_allclose(by_pixel, by_vertex, rtol=0, atol=1e-9)
    assert picture.stat().st_size > 1000


def test_an_npz_of_a_run_leaves_failed_poses_out(folder: Path) -> None:
    sheet = _sheet()
    vertices = np.concatenate([_bumps(), np.full((1, SIDE * SIDE, 3), np.nan)])
    arrays = {"vertices": vertices, "face_offsets": sheet.face_offsets, "face_vertices": sheet.face_vertices}
    write_npz(folder / "registered.npz", arrays)
    x, y, z = _bumps()[2, 42]
    from_npz = _edit(folder, f"42:{x},{y},{z}", examples=folder / "registered.npz")
    np.testing.assert_allclose(from_npz, _edit(folder, f"42:{x},{y},{z}"), rtol=0, atol=1e-6)  # OBJ has eight digits
    write_npz(folder / "named.npz", {"neutral": _bumps()[0], "left": _bumps()[1], "right": _bumps()[2]})
    with pytest.raises(InputError, match="no faces in it; give --template"):
        _edit(folder, "42:1,2,3", examples=folder / "named.npz")
    named = _edit(
        folder, f"42:{x},{y},{z}", examples=folder / "named.npz", template=folder / "examples" / "neutral.obj"
    )
    np.testing.assert_allclose(named, from_npz, rtol=0, atol=1e-6)


def test_a_face_without_examples(folder: Path) -> None:
    target = _sheet().with_vertices(2.0 * _sheet().vertices + [0, 0, 7.0])
    write_mesh(folder / "other.obj", target)
    rows = [0, 8, 40, 72, 80, 20, 60]
    write_text(folder / "pairs.yaml", f"pairs: {[[row, row] for row in rows]}\n")
    goal = target.vertices[38] + 2.0 * (_bumps()[1, 38] - _bumps()[0, 38])
    vertices = _edit(
        folder, "38:" + ",".join(map(str, goal)), onto=folder / "other.obj", pairs=folder / "pairs.yaml", theta2=1e-9
    )
    # twice the size: twice the motion, to what local frames make of the bent sheet's rim
    np.testing.assert_allclose(vertices, target.vertices + 2.0 * (_bumps()[1] - _bumps()[0]), rtol=0, atol=0.5)


@pytest.mark.parametrize(
    ("controls", "more", "text"),
    [
        ([], {}, "nothing is dragged"),
        (["38"], {}, "expected VERTEX:x,y"),
        (["38:1"], {}, "numbers with commas"),
        (["38:1,2"], {}, "needs a camera"),
        (["38:1,nan,2"], {}, "not finite"),
        (["38:1,2,3", "38:1,2,4"], {}, "given twice"),
        (["500:1,2,3"], {}, "the mesh has the vertices 0..80"),
        (["38:1,2,3000"], {"camera": "cameras.json"}, "behind the camera"),
        ([], {"drag": ["1,1:5,5"], "camera": "cameras.json"}, "hits nothing"),
        (["38:1,2"], {"camera": "cameras.json", "view": "none.jpg"}, "no photo 'none.jpg'"),
        (["38:1,2"], {"camera": "none.json"}, "none.json"),
        (["38:1,2,3"], {"examples": "empty"}, "no .obj or .ply files"),
        (["38:1,2,3"], {"examples": "single"}, "one example"),
        (["38:1,2,3"], {"onto": "examples/neutral.obj"}, "give --pairs"),
    ],
)
def test_bad_input_is_one_line_and_writes_nothing(
    folder: Path, controls: list[str], more: dict[str, Any], text: str
) -> None:
    (folder / "empty").mkdir()
    write_mesh(folder / "single" / "neutral.obj", _sheet())
    paths = {name: folder / value for name, value in more.items() if name in ("camera", "examples", "onto")}
    with pytest.raises(InputError, match=text) as error:
        _edit(folder, *controls, **{**more, **paths})
    assert "\n" not in str(error.value)
    assert not (folder / "out.obj").exists()
