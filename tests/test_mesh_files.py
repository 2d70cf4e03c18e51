"""OBJ and PLY: what goes in comes out bit for bit, and damaged files are refused in one line."""

import os
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from capture_eval.errors import InputError
from capture_eval.files.mesh_files import (
    read_mesh,
    read_obj,
    read_ply,
    read_ply_with_properties,
    write_mesh,
    write_obj,
    write_ply,
)
from capture_eval.polygon_mesh import PolygonMesh

HEAD = Path(__file__).parents[2] / "shared" / "data" / "makehuman_head" / "neutral.obj"


def assert_same(a: PolygonMesh, b: PolygonMesh) -> None:
    assert a.vertices.tobytes() == b.vertices.tobytes()
    np.testing.assert_array_equal(a.face_offsets, b.face_offsets)
    np.testing.assert_array_equal(a.face_vertices, b.face_vertices)


finite = st.floats(allow_nan=False, allow_infinity=False, width=64)


@st.composite
def meshes(draw: st.DrawFn) -> PolygonMesh:
    count = draw(st.integers(3, 9))
    vertices = draw(st.lists(st.tuples(finite, finite, finite), min_size=count, max_size=count))
    index = st.integers(0, count - 1)
    faces = draw(st.lists(st.lists(index, min_size=3, max_size=6), min_size=1, max_size=6))
    if not draw(st.booleans()):
        return PolygonMesh.from_faces(vertices, faces)
    textures = draw(st.lists(st.tuples(finite, finite), min_size=2, max_size=5))
    pick = st.integers(0, len(textures) - 1)
    corners = [[draw(pick) for _ in face] for face in faces]
    return PolygonMesh.from_faces(vertices, faces, textures, corners)


@settings(max_examples=60, deadline=None)
@given(mesh=meshes(), form=st.sampled_from(["obj", "binary", "ascii"]))
def test_round_trip_is_exact(mesh: PolygonMesh, form: str, tmp_path_factory: pytest.TempPathFactory) -> None:
    path = tmp_path_factory.mktemp("mesh") / ("mesh.obj" if form == "obj" else "mesh.ply")
    if form == "obj":
        write_obj(path, mesh, comments=["two\nlines"])
    else:
        write_ply(path, mesh, binary=form == "binary")
    back = read_mesh(path)
    assert_same(mesh, back)
    if mesh.texture_coordinates is None:
        assert back.texture_coordinates is None
        return
    if form == "obj":
        assert back.texture_coordinates is not None
        assert back.texture_coordinates.tobytes() == mesh.texture_coordinates.tobytes()
        np.testing.assert_array_equal(back.face_texture_indices, mesh.face_texture_indices)
    corners = mesh.texture_coordinates[mesh.face_texture_indices]
    assert back.texture_coordinates is not None
    np.testing.assert_array_equal(back.texture_coordinates[back.face_texture_indices], corners)


@pytest.mark.parametrize("binary", [True, False])
def test_ply_keeps_further_vertex_properties(tmp_path: Path, binary: bool) -> None:
    rng = np.random.default_rng(1)
    mesh = PolygonMesh.from_faces(rng.normal(size=(5, 3)), [[0, 1, 2, 3], [0, 3, 4]])
    support = rng.random(5)
    write_ply(tmp_path / "scan.ply", mesh, {"support": support, "nx": -support}, binary=binary)
    back, properties = read_ply_with_properties(tmp_path / "scan.ply")
    assert_same(mesh, back)
    assert list(properties) == ["support", "nx"]
    np.testing.assert_array_equal(properties["support"], support)
    np.testing.assert_array_equal(properties["nx"], -support)


def test_reads_what_the_format_allows(tmp_path: Path) -> None:
    path = tmp_path / "free.obj"
    path.write_bytes(
        b"# free form\r\nmtllib a.mtl\r\nv 0 0 0 1 0 0\r\nv\t1 0 0\r\nv 1 1 \\\r\n0\r\nvn 0 0 1\r\nvt 0.25 0.5 0\r\n"
        b"g part\r\nf -3/1/1 -2/1/1 -1/-1/1 # last three\r\nv 0 1 0\r\ns off\r\nf 1/1 2/1 3/1 -1/1\r\n"
    )
    mesh = read_obj(path)
    np.testing.assert_array_equal(mesh.vertices, [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    np.testing.assert_array_equal(mesh.face_offsets, [0, 3, 7])
    np.testing.assert_array_equal(mesh.face_vertices, [0, 1, 2, 0, 1, 2, 3])
    np.testing.assert_array_equal(mesh.face_texture_indices, np.zeros(7))
    path.write_text("v 0 0 0\nv 1 0 0\nv 1 1 0\nf 1//1 2//1 3//1\n")
    assert read_obj(path).texture_coordinates is None


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("mixed", [True, False])
def test_binary_ply_of_other_programs(tmp_path: Path, order: str, mixed: bool) -> None:
    """Floats, colours, unknown elements and either byte order, written here field by field."""
    name = "binary_little_endian" if order == "<" else "binary_big_endian"
    faces = [[0, 1, 2, 3], [0, 1, 2] if mixed else [3, 2, 1, 0]]
    body = np.array([(0.5, 1, 2, 7), (3, 4, 5, 8), (6, 7, 8, 9), (9, 10, 11, 1)], dtype=order + "f4").tobytes()
    body += np.array([3], order + "u2").tobytes()
    for number, face in enumerate(faces):
        body += np.array([number], "u1").tobytes() + np.array([len(face)], order + "i4").tobytes()
        body += np.array(face, order + "u4").tobytes()
    header = (
        f"ply\nformat {name} 1.0\ncomment made by hand\nelement vertex 4\nproperty float x\nproperty float32 y\n"
        "property float z\nproperty float quality\nelement odd 1\nproperty ushort n\nelement face 2\n"
        "property uchar flag\nproperty list int uint vertex_index\nend_header\n"
    )
    path = tmp_path / "other.ply"
    path.write_bytes(header.encode() + body)
    mesh, properties = read_ply_with_properties(path)
    np.testing.assert_array_equal(mesh.vertices, [[0.5, 1, 2], [3, 4, 5], [6, 7, 8], [9, 10, 11]])
    assert [face.tolist() for face in mesh.faces()] == faces
    np.testing.assert_array_equal(properties["quality"], [7, 8, 9, 1])


GOOD = "v 0 0 0\nv 1 0 0\nv 0 1 0\n"
PLY = "ply\nformat ascii 1.0\nelement vertex 3\nproperty double x\nproperty double y\nproperty double z\n"
PLY += "element face 1\nproperty list uchar int vertex_indices\nend_header\n"


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("a.obj", "", "no vertices"),
        ("a.obj", GOOD, "no faces"),
        ("a.obj", GOOD + "f 1 2 4\n", "line 4: vertex index 4 does not exist"),
        ("a.obj", GOOD + "f 1 2 -4\n", "line 4: vertex index -4 does not exist"),
        ("a.obj", GOOD + "f 0 1 2\n", "line 4: vertex index 0 does not exist"),
        ("a.obj", GOOD + "f 1 2\n", "line 4: a face needs at least three corners"),
        ("a.obj", GOOD + "f 1 2 x\n", "line 4: face index 'x' is not a whole number"),
        ("a.obj", GOOD + "vt 0 0\nf 1/1 2/2 3/1\n", "line 5: texture coordinate index 2 does not exist"),
        ("a.obj", GOOD + "vt 0 0\nf 1/1 2 3/1\n", "line 5: corner without a texture coordinate"),
        ("a.obj", "v 0 0 nan\n" + GOOD + "f 1 2 3\n", "line 1: a vertex is not finite"),
        ("a.obj", GOOD + "v 0 0\nf 1 2 3\n", "line 4: a vertex needs 3 numbers"),
        ("a.obj", GOOD + "v 0 0 a\nf 1 2 3\n", "line 4: a vertex holds text"),
        ("a.ply", "solid", "not a PLY file"),
        ("a.ply", PLY[:40], "cut off inside the header"),
        ("a.ply", PLY + "0 0 0 1 0 0 0 1 0 3 0 1", "cut off in row 0 of 1 of element 'face'"),
        ("a.ply", PLY + "0 0 0 1 0 0 0 1", "cut off in row 2 of 3 of element 'vertex'"),
        ("a.ply", PLY + "0 0 0 1 0 0 0 1 0 3 0 1 3", "face 0 uses vertex 3"),
        ("a.ply", PLY + "0 0 0 1 0 0 0 1 0 2 0 1", "face 0 has 2 corners"),
        ("a.ply", PLY + "0 0 inf 1 0 0 0 1 0 3 0 1 2", "vertex 0 is not finite"),
        ("a.ply", PLY + "0 0 zero 1 0 0 0 1 0 3 0 1 2", "not a number"),
        ("a.ply", PLY.replace("double x", "half x"), "header line not understood: 'property half x'"),
        ("a.ply", PLY.replace("face 1", "face 0") + "0 0 0 1 0 0 0 1 0", "no faces"),
        ("a.stl", "solid", "unknown mesh format '.stl'"),
    ],
)
def test_damaged_files_get_one_line(tmp_path: Path, name: str, text: str, words: str) -> None:
    path = tmp_path / name
    path.write_text(text)
    with pytest.raises(InputError, match=re.escape(words)) as caught:
        read_mesh(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_every_cut_of_a_binary_ply_is_refused(tmp_path: Path) -> None:
    mesh = PolygonMesh.from_faces(np.eye(3), [[0, 1, 2], [2, 1, 0]])
    write_ply(tmp_path / "whole.ply", mesh)
    whole = (tmp_path / "whole.ply").read_bytes()
    for length in range(0, len(whole), 3):
        (tmp_path / "cut.ply").write_bytes(whole[:length])
        with pytest.raises(InputError, match=r"cut\.ply"):
            read_ply(tmp_path / "cut.ply")


def test_missing_file_and_wrong_properties(tmp_path: Path) -> None:
    mesh = PolygonMesh.from_faces(np.eye(3), [[0, 1, 2]])
    with pytest.raises(InputError, match=r"none\.obj: cannot be read"):
        read_mesh(tmp_path / "none.obj")
    with pytest.raises(InputError, match=r"none\.ply: cannot be read"):
        read_mesh(tmp_path / "none.ply")
    with pytest.raises(InputError, match="OBJ cannot hold"):
        write_mesh(tmp_path / "a.obj", mesh, {"support": np.zeros(3)})
    with pytest.raises(InputError, match="property 'support' has shape"):
        write_mesh(tmp_path / "a.ply", mesh, {"support": np.zeros(2)})
    with pytest.raises(InputError, match="unknown mesh format"):
        write_mesh(tmp_path / "a.stl", mesh)
    assert os.listdir(tmp_path) == []


def test_reads_the_head_and_agrees_with_itself_through_ply(tmp_path: Path) -> None:
    if not HEAD.exists():
        pytest.skip("../shared/data/makehuman_head is absent")
    mesh = read_mesh(HEAD)
    assert mesh.vertices.shape == (4368, 3)
    assert mesh.quads().shape == (4346, 4)
    assert mesh.texture_coordinates is not None
    assert mesh.texture_coordinates.shape == (4561, 2)
    write_mesh(tmp_path / "head.ply", mesh)
    assert_same(mesh, read_mesh(tmp_path / "head.ply"))
