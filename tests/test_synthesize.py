"""A tiny synthetic capture from end to end, and the MakeHuman head against an independent realisation."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from capture_eval.curves.curve_specification import parse_curves, resolve_curve
from capture_eval.curves.edge_loops import edge_topology
from capture_eval.errors import InputError
from capture_eval.files.atomic import read_npz
from capture_eval.files.camera_files import read_cameras
from capture_eval.files.jpeg_files import read_photo, read_photo_tags
from capture_eval.files.makehuman_files import read_makehuman_texts
from capture_eval.files.manifest_files import read_manifest, read_yaml
from capture_eval.files.mesh_files import read_mesh
from capture_eval.images.head import Head
from capture_eval.images.makehuman_assets import REQUIRED_FILES, MakeHumanAssets, parse_assets
from capture_eval.images.makehuman_head import HeadCut, cut_head, identity, makehuman_head
from capture_eval.images.makehuman_skeleton import MOTIONS
from capture_eval.images.skin_shading import Lighting, SoftBox
from capture_eval.similarity import estimate_similarity
from capture_eval.stages.subjects import load_subjects
from capture_eval.stages.synthesize import synthesize_capture
from capture_eval.stages.synthesize_options import SynthesizeOptions
from capture_eval.triangle_geometry import diameter

SHARED = Path(__file__).resolve().parents[2] / "shared" / "data"
TINY = SynthesizeOptions(poses=2, views=3, width=160, height=120, seed=5, texture_size=256)


@pytest.fixture(scope="module")
def subjects() -> tuple[Head, Head]:
    return load_subjects("mannequin")


@pytest.fixture(scope="module")
def capture(subjects: tuple[Head, Head], tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("tiny") / "capture"
    counts: list[tuple[int, int]] = []
    made = synthesize_capture(*subjects, folder, TINY, progress=lambda done, total: counts.append((done, total)))
    assert made["photos"] == 6
    assert made["kept"] == 0
    assert counts == [(k, 6) for k in range(7)]
    return folder


def photo_bytes(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*.jpg"))}


def test_capture_has_photos_of_the_stated_camera(capture: Path) -> None:
    cameras = read_cameras(capture / "truth" / "cameras.json")
    assert list(cameras) == ["pose_00", "pose_01"]
    for pose, views in cameras.items():
        for view in views:
            photo = capture / "photos" / pose / view.name
            image = read_photo(photo)
            assert image.shape == (120, 160, 3)
            assert read_photo_tags(photo).focal_px == pytest.approx(view.intrinsics.matrix[0, 0], rel=1e-5)
            # head and backdrop are both in the picture
            assert 0.05 < np.mean(np.abs(image.astype(int) - 96).max(axis=2) > 20) < 0.9


def test_turned_light_leaves_the_neutral_as_it_is(capture: Path, subjects: tuple[Head, Head], tmp_path: Path) -> None:
    synthesize_capture(*subjects, tmp_path / "turned", replace(TINY, light_turn=40.0))
    before, after = photo_bytes(capture / "photos"), photo_bytes(tmp_path / "turned" / "photos")
    assert [name for name in before if before[name] == after[name]] == [f"pose_00/view_{k:02d}.jpg" for k in range(3)]
    # by 90 degrees what stood to the head's left stands in front of it, at the same height and distance
    box = Lighting((SoftBox((600.0, 500.0, 0.0), 400.0, 1.0),)).turned(90.0).boxes[0]
    assert np.allclose(box.position, (0.0, 500.0, 600.0), atol=1e-9)


def test_capture_has_the_truth(capture: Path, subjects: tuple[Head, Head]) -> None:
    head = subjects[0]
    truth = read_npz(capture / "truth" / "truth.npz")
    assert truth["t"].tolist() == [0.0, 1.0]
    assert np.array_equal(truth["vertices"][0], head.pose("jaw_open", 0.0)[0])
    assert np.array_equal(truth["vertices"][1], head.pose("jaw_open", 1.0)[0])
    mesh = read_mesh(capture / "truth" / "mesh.obj")
    assert np.array_equal(mesh.face_vertices, head.skin.face_vertices)
    assert np.abs(mesh.vertices - truth["vertices"][0]).max() < 1e-6
    motion = json.loads((capture / "truth" / "motion.json").read_text())
    assert motion["diameter_mm"] == pytest.approx(diameter(truth["vertices"][0]))


def test_capture_hands_in_what_a_user_would(capture: Path, subjects: tuple[Head, Head]) -> None:
    manifest = read_manifest(capture / "manifest.yaml")
    assert manifest.manifest.pose_names == ["pose_00", "pose_01"]
    template = read_mesh(capture / "template.obj")
    head = subjects[0]
    fit = estimate_similarity(template.vertices, head.skin.vertices)
    away = np.linalg.norm(fit.apply(template.vertices) - head.skin.vertices, axis=1) / diameter(head.skin.vertices)
    assert fit.scale == pytest.approx(1.0 / TINY.template_scale, rel=0.1)
    assert 0.01 < away.mean() < 0.05  # another person, not the answer
    topology = edge_topology(template)
    loops = [resolve_curve(entry, topology) for entry in parse_curves(read_yaml(capture / "curves.yaml"), "curves")]
    assert len(loops) == 49
    landmarks = read_yaml(capture / "landmarks.yaml")["landmarks"]
    assert len(landmarks) >= 6
    views = {view.name for view in read_cameras(capture / "truth" / "cameras.json")["pose_00"]}
    for landmark in landmarks:
        assert 0 <= landmark["vertex"] < len(template.vertices)
        assert 2 <= len(landmark["photos"]) <= 5
        assert set(landmark["photos"]) <= views


def test_same_options_give_the_same_bytes_on_two_cores(
    capture: Path, subjects: tuple[Head, Head], tmp_path: Path
) -> None:
    synthesize_capture(*subjects, tmp_path / "capture", TINY, cores=2)
    first = {path.relative_to(capture): path.read_bytes() for path in sorted(capture.rglob("*")) if path.is_file()}
    second = {
        path.relative_to(tmp_path / "capture"): path.read_bytes()
        for path in sorted((tmp_path / "capture").rglob("*"))
        if path.is_file()
    }
    assert first == second


def test_interrupted_capture_goes_on(capture: Path, subjects: tuple[Head, Head]) -> None:
    before = photo_bytes(capture)
    (capture / "photos" / "pose_01" / "view_01.jpg").unlink()
    made = synthesize_capture(*subjects, capture, TINY)
    assert made["kept"] == 5
    assert photo_bytes(capture) == before


def test_other_options_leave_no_old_photos(subjects: tuple[Head, Head], tmp_path: Path) -> None:
    folder = tmp_path / "capture"
    synthesize_capture(*subjects, folder, replace(TINY, views=2))
    before = photo_bytes(folder)
    (folder / "photos" / "pose_00" / "view_07.jpg").write_bytes(b"left over")
    made = synthesize_capture(*subjects, folder, replace(TINY, views=2, seed=6))
    after = photo_bytes(folder)
    assert made["kept"] == 0
    assert set(after) == set(before)
    assert not set(after.values()) & set(before.values())


def test_folder_with_other_photos_is_left_alone(subjects: tuple[Head, Head], tmp_path: Path) -> None:
    photo = tmp_path / "photos" / "pose_00" / "view_00.jpg"
    photo.parent.mkdir(parents=True)
    photo.write_bytes(b"mine")
    with pytest.raises(InputError, match="holds photos"):
        synthesize_capture(*subjects, tmp_path, TINY)
    assert photo.read_bytes() == b"mine"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"motion": "dance"}, "no motion 'dance'"),
        ({"timing": "power:zero"}, "not a number"),
        ({"poses": 1}, "at least 2"),
        ({"times": (0.0, 0.5)}, "rise from 0 to 1"),
        ({"times": (0.0, 0.5, 0.5, 1.0)}, "rise from 0 to 1"),
        ({"views": 1}, "views"),
        ({"width": 40}, "picture size 40x120"),
        ({"distortion": (2.0, 0.0, 0.0, 0.0)}, "distortion"),
        ({"skin": "blue"}, "skin 'blue'"),
    ],
)
def test_bad_options_are_one_line(
    subjects: tuple[Head, Head], tmp_path: Path, change: dict[str, object], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        synthesize_capture(*subjects, tmp_path / "capture", replace(TINY, **change))
    assert not (tmp_path / "capture").exists()


def test_template_must_be_another_person() -> None:
    with pytest.raises(InputError, match="another person"):
        load_subjects("mannequin", 1, 1)


def test_missing_makehuman_files_are_one_line(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no MakeHuman files"):
        load_subjects("makehuman", makehuman_folder=tmp_path)


@pytest.fixture(scope="module")
def assets() -> MakeHumanAssets:
    folder = SHARED / "makehuman_upstream"
    if not folder.is_dir():
        pytest.skip("the MakeHuman upstream files are not beside the checkout")
    return parse_assets(read_makehuman_texts(folder, REQUIRED_FILES))


@pytest.fixture(scope="module")
def cut(assets: MakeHumanAssets) -> HeadCut:
    return cut_head(assets)


def study(name: str) -> dict[str, np.ndarray]:
    path = SHARED / "makehuman_head" / name
    if not path.is_file():
        pytest.skip("the independent MakeHuman head is not beside the checkout")
    return read_npz(path)


def test_head_is_cut_as_in_the_independent_realisation(assets: MakeHumanAssets, cut: HeadCut) -> None:
    other = study("head.npz")
    assert np.array_equal(cut.vertices, other["base_obj_vertex_index"])
    assert np.array_equal(cut.faces, other["faces"])
    head = makehuman_head(assets, 0, cut)
    # decimetres with four digits times 100 in another order of operations
    assert np.abs(head.skin.vertices - other["vertices"]).max() < 1e-9
    assert diameter(head.skin.vertices) == pytest.approx(294.63319809930164, abs=1e-9)


@pytest.mark.parametrize("motion", sorted(MOTIONS))
def test_bones_move_the_skin_as_in_the_independent_realisation(
    assets: MakeHumanAssets, cut: HeadCut, motion: str
) -> None:
    """The stored sequences are single precision: 150 mm have a spacing of 1.5e-5 mm, half of it is rounding."""
    other = study("sequences.npz")
    head = makehuman_head(assets, 0, cut)
    for number, t in enumerate(other["t"]):
        skin, parts = head.pose(motion, float(t))
        assert np.abs(skin - other[f"{motion}_linear"][number]).max() < 1e-5
        teeth = next(part for blocker, part in zip(head.blockers, parts, strict=True) if blocker.name == "teeth")
        assert np.abs(teeth - other[f"{motion}_linear__parts"][number][144:280]).max() < 1e-5


def test_curves_are_those_of_the_independent_realisation(assets: MakeHumanAssets, cut: HeadCut) -> None:
    path = SHARED / "makehuman_head" / "curves.json"
    if not path.is_file():
        pytest.skip("the independent MakeHuman head is not beside the checkout")
    head = makehuman_head(assets, 0, cut)
    topology = edge_topology(head.skin)
    ours = {
        (loop.closed, frozenset(loop.vertices.tolist()))
        for loop in (resolve_curve(entry, topology) for entry in parse_curves({"curves": list(head.curves)}, "head"))
    }
    theirs = {(curve["closed"], frozenset(curve["vertices"])) for curve in json.loads(path.read_text())["curves"]}
    assert ours == theirs


def test_atlas_flips_and_overlaps_nothing(assets: MakeHumanAssets, cut: HeadCut) -> None:
    triangles = cut.face_textures[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3)

    def areas(coordinates: np.ndarray) -> np.ndarray:
        corners = coordinates[triangles]
        first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        return 0.5 * (first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0])

    before, after = areas(assets.mesh.texture_coordinates[cut.textures]), areas(cut.coordinates)
    assert np.all(np.sign(before) == np.sign(after))
    assert cut.coordinates.min() > 0.0
    assert cut.coordinates.max() < 1.0
    boxes = [cut.coordinates[cut.islands == island] for island in range(cut.islands.max() + 1)]
    for number, first in enumerate(boxes):
        for second in boxes[number + 1 :]:
            apart = (first.min(axis=0) > second.max(axis=0)) | (second.min(axis=0) > first.max(axis=0))
            assert apart.any()


def test_regions_share_out_the_head(assets: MakeHumanAssets, cut: HeadCut) -> None:
    head = makehuman_head(assets, 0, cut)
    assert np.array_equal(np.sort(np.concatenate(list(head.regions.values()))), np.arange(len(cut.vertices)))
    assert all(len(vertices) > 50 for vertices in head.regions.values())
    for motion in MOTIONS:
        moved = np.linalg.norm(head.pose(motion, 1.0)[0] - head.skin.vertices, axis=1)
        assert moved[head.rigid_region].max() < 1e-3
    assert np.linalg.norm(head.pose("jaw_open", 1.0)[0] - head.skin.vertices, axis=1)[733] == pytest.approx(
        36.44, abs=0.01
    )


def test_persons_differ_and_repeat(assets: MakeHumanAssets, cut: HeadCut) -> None:
    heads = [makehuman_head(assets, number, cut).skin.vertices for number in range(4)]
    size = diameter(heads[0])
    for number, first in enumerate(heads):
        for second in heads[number + 1 :]:
            fit = estimate_similarity(second, first)
            assert np.linalg.norm(fit.apply(second) - first, axis=1).mean() > 0.008 * size
    assert np.array_equal(makehuman_head(assets, 2, cut).skin.vertices, heads[2])
    with pytest.raises(InputError, match="identity -1"):
        identity(-1)


def test_weak_skin_has_less_contrast(assets: MakeHumanAssets, cut: HeadCut) -> None:
    """On the forehead only the fine variation is left, which the weak skin has 0.4 times."""
    head = makehuman_head(assets, 0, cut)
    vertex = np.flatnonzero(np.isin(cut.faces, head.landmarks["glabella"]).any(axis=1))[0]
    u, v = cut.coordinates[cut.face_textures[vertex]].mean(axis=0)
    deviations = []
    for contrast in ("normal", "weak"):
        image = head.albedo(1024, contrast).astype(float).mean(axis=2)
        row, column = int((1.0 - v) * 1024), int(u * 1024)
        patch = image[row - 20 : row + 20, column - 34 : column - 4]  # up the forehead, which is to the left
        deviations.append(patch.std())
    assert 0.25 < deviations[1] / deviations[0] < 0.6


@pytest.mark.usefixtures("assets")
def test_damaged_upstream_files_are_one_line() -> None:
    texts = read_makehuman_texts(SHARED / "makehuman_upstream", REQUIRED_FILES)
    for name in ("3dobjs/base.obj", "poseunits/face-poseunits.bvh", "rigs/default_weights.mhw"):
        with pytest.raises(InputError, match=name):
            parse_assets(texts | {name: texts[name][: len(texts[name]) // 2] + "\nf 1/1 2/2 3/3"})
    with pytest.raises(InputError, match=r"rigs/default\.mhskel is missing"):
        parse_assets({name: text for name, text in texts.items() if name != "rigs/default.mhskel"})
