"""`validate`: a good capture gets no line, and every kind of damage gets its own."""

from __future__ import annotations

import io
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml
from PIL import Image
from scipy import ndimage
from small_capture import PHOTOS, grid_mesh, picture, save_photo, write_capture

from capture_eval.files.manifest_files import read_manifest
from capture_eval.files.mesh_files import write_mesh
from capture_eval.polygon_mesh import PolygonMesh
from capture_eval.stages.validate import validate_capture


@pytest.fixture(scope="session")
def good_capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_capture(tmp_path_factory.mktemp("good")).parent


@pytest.fixture
def capture(good_capture: Path, tmp_path: Path) -> Path:
    folder = tmp_path / "capture"
    shutil.copytree(good_capture, folder)
    return folder


def _lines(folder: Path) -> list[str]:
    return [str(problem) for problem in validate_capture(read_manifest(folder / "manifest.yaml"))]


def _edit(folder: Path, change: Callable[[dict], object]) -> None:
    path = folder / "manifest.yaml"
    content = yaml.safe_load(path.read_text())
    change(content)
    path.write_text(yaml.safe_dump(content))


def test_a_good_capture_gets_no_line(capture: Path) -> None:
    assert _lines(capture) == []


def _truncate(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:1500])


def _with_exif(path: Path, tags: dict[int, object], details: dict[int, object] | None = None) -> None:
    exif = Image.Exif()
    exif.update(tags)
    exif.get_ifd(0x8769).update(details or {})
    save_photo(path, picture(1), exif=exif)


PHOTO_DAMAGE = {
    "truncated": (_truncate, "truncated; copy it again"),
    "empty": (lambda path: path.write_bytes(b""), "empty file (0 bytes)"),
    "text": (lambda path: path.write_text("not a picture"), "not a readable image"),
    "blurred": (
        lambda path: save_photo(path, ndimage.gaussian_filter(picture(1), (3, 3, 0))),
        "blurred: ",
    ),
    "dark": (lambda path: save_photo(path, picture(1) // 8), "under-exposed: "),
    "bright": (lambda path: save_photo(path, 255 - (255 - picture(1)) // 8), "over-exposed: "),
    "small": (lambda path: save_photo(path, picture(1, 128, 96)), "is 128x96, most photos are 160x120"),
    "tiny": (lambda path: save_photo(path, picture(1, 32, 24)), "32x24 pixels is too small"),
    "copy": (lambda path: shutil.copy(path.parent / "view_0.jpg", path), "the same file as view_0.jpg"),
    "again": (
        lambda path: save_photo(path, np.asarray(Image.open(path.parent / "view_0.jpg"))),
        "the same picture as view_0.jpg",
    ),
    "of another pose": (
        lambda path: shutil.copy(path.parents[1] / "pose_0" / "view_3.jpg", path),
        "the same file as a photo of pose_0",
    ),
    "turned": (lambda path: _with_exif(path, {0x0112: 6}), "EXIF orientation is 6"),
    "cropped": (lambda path: _with_exif(path, {}, {40962: 4000}), "EXIF says 4000 pixels wide, the picture has 160"),
    "other camera": (lambda path: _with_exif(path, {0x010F: "Maker"}), "EXIF says Maker, most photos nothing"),
}


@pytest.mark.parametrize("damage", sorted(PHOTO_DAMAGE))
def test_a_damaged_photo_is_named_and_alone(capture: Path, damage: str) -> None:
    harm, expected = PHOTO_DAMAGE[damage]
    photo = capture / "pose_1" / "view_5.jpg"
    harm(photo)
    lines = _lines(capture)
    assert any(line.startswith(f"{photo}: ") and expected in line for line in lines), lines
    assert all(str(photo) in line for line in lines), lines


def test_a_picture_of_something_else_is_noticed(capture: Path) -> None:
    photo = capture / "pose_1" / "view_5.jpg"
    pixels = picture(1)
    pixels[..., 0] //= 4  # another colour, the same brightness and detail
    pixels[..., 1] = np.clip(pixels[..., 1].astype(int) + 30, 0, 255)
    save_photo(photo, pixels)
    assert any(str(photo) in line and "something else?" in line for line in _lines(capture))


def test_a_huge_picture_is_refused_without_decoding_it(capture: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from capture_eval.stages import validate_photos

    monkeypatch.setattr(validate_photos, "LARGEST_PIXELS", 160 * 120 - 1)
    lines = _lines(capture)
    assert sum("160x120 pixels; shrink it" in line for line in lines) == 2 * PHOTOS


def test_few_photos_and_missing_poses(capture: Path) -> None:
    for photo in sorted((capture / "pose_0").iterdir())[2:]:
        photo.unlink()
    shutil.rmtree(capture / "pose_1")
    problems = validate_capture(read_manifest(capture / "manifest.yaml"))
    few = [p for p in problems if p.text.startswith("too few readable photos: 2")]
    missing = [p for p in problems if p.where.startswith("pose pose_1") and "no photos" in p.text]
    assert few
    assert few[0].fatal  # without the neutral pose there is nothing
    assert missing
    assert missing[0].fatal


def test_camera_raw_files_are_pointed_out(capture: Path) -> None:
    (capture / "pose_0" / "IMG_1.CR2").write_bytes(b"raw")
    assert any("camera raw or HEIC" in line for line in _lines(capture))


def test_masks_are_there_readable_and_of_the_photos_size(capture: Path) -> None:
    _edit(capture, lambda content: content["poses"][0].update(masks="masks"))
    (capture / "masks").mkdir()
    for index in range(PHOTOS):
        Image.new("L", (160, 120), 255).save(capture / "masks" / f"view_{index}.png")
    assert _lines(capture) == []
    Image.new("L", (80, 60), 255).save(capture / "masks" / "view_1.png")
    Image.new("L", (160, 120), 0).save(capture / "masks" / "view_2.png")
    (capture / "masks" / "view_3.png").unlink()
    (capture / "masks" / "view_4.png").write_bytes(b"x")
    text = "\n".join(_lines(capture))
    for expected in (
        "view_1.png: mask is 80x60, its photo 160x120",
        "view_2.png: mask leaves nothing",
        "view_3.png: no mask for view_3.jpg",
        "view_4.png: not a readable image",
    ):
        assert expected in text
    assert text.count("\n") == 3


def _template_text(folder: Path, change: Callable[[str], str]) -> None:
    path = folder / "template.obj"
    path.write_text(change(path.read_text()))


def _triangulated(text: str) -> str:
    lines = []
    for line in text.splitlines():
        if line.startswith("f "):
            a, b, c, d = line.split()[1:]
            lines += [f"f {a} {b} {c}", f"f {a} {c} {d}"]
        else:
            lines.append(line)
    return "\n".join(lines) + "\n"


def _without_texture(mesh: PolygonMesh) -> PolygonMesh:
    return PolygonMesh(mesh.vertices, mesh.face_offsets, mesh.face_vertices)


TEMPLATE_DAMAGE = {
    "triangles": (lambda f: _template_text(f, _triangulated), "no quads among 50 faces"),
    "non-manifold": (
        lambda f: _template_text(f, lambda text: text + "v 9 9 9\nf 8/8 9/9 37/1\nf 8/8 9/9 37/1\n"),
        "edge 7-8",
    ),
    "nan": (lambda f: _template_text(f, lambda text: "v nan 0 0\n" + text.split("\n", 1)[1]), "template.obj"),
    "no mesh": (lambda f: (f / "template.obj").write_bytes(b"\x00\x01\x02"), "template.obj"),
    "missing": (lambda f: (f / "template.obj").unlink(), "template.obj"),
    "no uv": (lambda f: write_mesh(f / "template.obj", _without_texture(grid_mesh())), "no texture coordinates"),
}


@pytest.mark.parametrize("damage", sorted(TEMPLATE_DAMAGE))
def test_a_damaged_template_is_refused(capture: Path, damage: str) -> None:
    harm, expected = TEMPLATE_DAMAGE[damage]
    harm(capture)
    problems = [p for p in validate_capture(read_manifest(capture / "manifest.yaml"), photos=False) if p.fatal]
    assert any(p.where == str(capture / "template.obj") and expected in str(p) for p in problems), list(
        map(str, problems)
    )


@pytest.mark.parametrize(
    ("curve", "expected"),
    [
        ({"name": "far", "vertices": [0, 1, 99], "closed": False}, "curve 'far': vertex 99 is not in the mesh"),
        ({"name": "off", "start_edge": [0, 20]}, "curve 'off'"),
        ({"name": "none"}, "curve 'none'"),
        ({"name": "twice", "vertices": [0, 1, 0, 2], "closed": False}, "curve 'twice'"),
    ],
)
def test_a_curve_that_leaves_the_mesh_is_named(capture: Path, curve: dict, expected: str) -> None:
    (capture / "curves.yaml").write_text(yaml.safe_dump({"curves": [curve]}))
    lines = _lines(capture)
    assert len(lines) == 1
    assert expected in lines[0]
    assert lines[0].startswith(str(capture / "curves.yaml"))


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"vertex": 99}, "vertex 99 is not in the template, which has 36"),
        ({"vertex": "nose"}, "is not a vertex number"),
        ({"photos": {"view_0.jpg": [1, 2]}}, "needs pixels in 2 or more photos"),
        ({"photos": {"view_0.jpg": [1, 2], "view_77.jpg": [1, 2]}}, "view_77.jpg is not among the photos"),
        ({"photos": {"view_0.jpg": [1, 2], "view_1.jpg": [1]}}, "is not two numbers"),
        ({"point": [1, 2]}, "is not three numbers"),
        ({"name": "mark_1"}, "is given twice"),
        ({"colour": "red"}, "unknown key colour"),
    ],
)
def test_a_wrong_landmark_is_named(capture: Path, change: dict, expected: str) -> None:
    path = capture / "landmarks.yaml"
    content = yaml.safe_load(path.read_text())
    content["landmarks"][3].update(change)
    path.write_text(yaml.safe_dump(content))
    lines = _lines(capture)
    assert len(lines) == 1
    assert expected in lines[0]
    assert "landmark mark_" in lines[0]


def test_too_few_landmarks(capture: Path) -> None:
    path = capture / "landmarks.yaml"
    content = yaml.safe_load(path.read_text())
    path.write_text(yaml.safe_dump({"landmarks": content["landmarks"][:5]}))
    assert _lines(capture) == [f"{path}: 5 usable landmarks; 6 or more are needed"]


def test_methods_rigid_region_hashes_and_truth(capture: Path) -> None:
    def change(content: dict) -> None:
        content["methods"] = ["linear", "spline_of_dreams"]
        content["rigid_region"] = [0, 1, 99]
        content["sha256"] = {"curves.yaml": "0" * 64}
        content["truth"] = {"vertices": "truth.npz", "mesh": "template.obj"}

    _edit(capture, change)
    np.savez(capture / "truth.npz", t=np.array([0.0, 1.0]), vertices=np.zeros((3, 36, 3)))
    text = "\n".join(_lines(capture))
    for expected in (
        "methods[1]: unknown interpolation method 'spline_of_dreams'",
        "rigid_region: vertex 99 is not in the template",
        "curves.yaml: SHA-256 is",
        "truth.npz: vertices (3, 36, 3), expected (2, V, 3)",
    ):
        assert expected in text
    assert text.count("\n") == 3


def test_meshes_of_one_topology(tmp_path: Path) -> None:
    grid = grid_mesh()
    for name in ("a", "b"):
        write_mesh(tmp_path / f"{name}.obj", grid)
    (tmp_path / "curves.yaml").write_text("curves: [{name: row, vertices: [6, 7, 8], closed: false}]\n")
    poses = [{"t": 0.0, "mesh": "a.obj"}, {"t": 1.0, "mesh": "b.obj"}]
    manifest = {"name": "m", "source": "meshes", "poses": poses, "curves": "curves.yaml"}
    (tmp_path / "manifest.yaml").write_text(yaml.safe_dump(manifest))
    assert _lines(tmp_path) == []
    text = (tmp_path / "b.obj").read_text()
    (tmp_path / "b.obj").write_text("v 0 0 0\n" + text)
    assert "37 vertices, but" in _lines(tmp_path)[0]
    write_mesh(tmp_path / "b.obj", PolygonMesh.from_faces(grid.vertices, [face[::-1] for face in grid.faces()]))
    assert "other faces or vertex order" in _lines(tmp_path)[0]


def test_mistakes_do_not_stop_at_the_first(capture: Path) -> None:
    (capture / "pose_0" / "view_2.jpg").write_bytes(b"")
    (capture / "pose_1" / "view_3.jpg").write_bytes(io.BytesIO(b"no").getvalue())
    (capture / "landmarks.yaml").write_text("nothing: 1\n")
    assert len(_lines(capture)) == 3
