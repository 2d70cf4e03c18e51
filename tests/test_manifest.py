"""Manifests: what is accepted, and the one line that each mistake gets."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from capture_eval.errors import InputError
from capture_eval.files.manifest_files import Manifest, manifest_schema, read_manifest
from capture_eval.workflow.stage_options import OPTION_CLASSES, check_options, options_class, stage_options

REPOSITORY = Path(__file__).parents[1]

MINIMAL = """\
name: my-capture
source: photos
poses:
  - {t: 0.0, photos: pose_00}
  - {t: 1.0, photos: pose_10}
template: {mesh: template.obj, landmarks: landmarks.yaml}
curves: curves.yaml
methods: [linear, pde_linear, pde_quadratic, pde_cubic]
"""


def _write(folder: Path, text: str) -> Path:
    path = folder / "manifest.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def test_the_minimal_manifest_of_the_documentation_is_read(tmp_path: Path) -> None:
    capture = read_manifest(_write(tmp_path, MINIMAL))
    assert capture.manifest.pose_names == ["pose_00", "pose_10"]
    assert capture.manifest.method_entries[0].name == "linear"
    assert capture.resolve("pose_00") == (tmp_path / "pose_00").resolve()
    assert capture.manifest.camera.shared_intrinsics


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("t: 0.0", "t: 0.1", "poses: the first pose must have t = 0, not 0.1"),
        ("t: 1.0", "t: 0.9", "poses: the last pose must have t = 1, not 0.9"),
        ("t: 1.0", "t: 0.0", "poses: t must increase strictly, but 0 follows 0"),
        ("t: 1.0", "t: .nan", "line 5: .nan is not a finite number"),
        ("t: 1.0", "t: soon", "poses[1].t: "),
        ("mesh:", "meshh:", "template.meshh: unknown key"),
        ("photos: pose_10", "photo: pose_10", "poses[1].photo: unknown key"),
        ("photos: pose_10", "photos: pose_00", "poses: two poses are named 'pose_00'; set `name`"),
        ("photos: pose_10", "photos: ../pose_10", "poses[1].photos: ../pose_10 lies outside the manifest's folder"),
        ("photos: pose_10", "photos: /etc", "poses[1].photos: /etc lies outside the manifest's folder"),
        ("source: photos", "source: photo", "source: Input should be 'photos', 'meshes' or 'synthetic'"),
        ("source: photos", "source: meshes", "poses[0] needs `mesh`, because source is meshes"),
        ("source: photos", "source: photos\nname: again", "line 3: key 'name' is given twice"),
        ("source: photos", "source: !!python/object/apply:os.system [ls]", "could not determine a constructor"),
        ("source: photos\n", "", "source: missing"),
        ("[linear,", "[[linear],", "methods[0]"),
    ],
)
def test_a_mistake_gets_one_line_with_file_and_key(tmp_path: Path, old: str, new: str, expected: str) -> None:
    path = _write(tmp_path, MINIMAL.replace(old, new))
    with pytest.raises(InputError) as caught:
        read_manifest(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: ")
    assert expected in message
    assert "\n" not in message


@pytest.mark.parametrize("content", [b"", b"[1, 2]", b"hello", b"\xff\xfe\x00", b"a: [1", b"a: &x [*x]\n- b"])
def test_what_is_no_manifest_is_refused_in_one_line(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "manifest.yaml"
    path.write_bytes(content)
    with pytest.raises(InputError) as caught:
        read_manifest(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_missing_manifest_and_a_folder_are_named(tmp_path: Path) -> None:
    for path in (tmp_path / "none.yaml", tmp_path):
        with pytest.raises(InputError, match=str(path)):
            read_manifest(path)


def test_paths_may_leave_the_folder_when_the_user_says_so(tmp_path: Path) -> None:
    inside = tmp_path / "inside"
    inside.mkdir()
    path = _write(inside, MINIMAL.replace("photos: pose_10", "photos: ../pose_10"))
    capture = read_manifest(path, allow_outside=True)
    assert capture.resolve("../pose_10") == (tmp_path / "pose_10").resolve()


def test_a_link_that_leads_out_is_outside(tmp_path: Path) -> None:
    inside, outside = tmp_path / "inside", tmp_path / "outside"
    inside.mkdir()
    outside.mkdir()
    (inside / "pose_10").symlink_to(outside)
    with pytest.raises(InputError, match="outside the manifest's folder"):
        read_manifest(_write(inside, MINIMAL))


@given(times=st.lists(st.floats(0, 1), min_size=2, max_size=12))
def test_exactly_the_rising_times_from_0_to_1_are_accepted(times: list[float]) -> None:
    poses = [{"t": t, "photos": f"pose_{index:02d}"} for index, t in enumerate(times)]
    good = times[0] == 0.0 and times[-1] == 1.0 and bool(np.all(np.diff(times) > 0))
    try:
        Manifest.model_validate({"name": "x", "source": "photos", "poses": poses})
    except ValueError:
        assert not good
    else:
        assert good


def test_the_committed_schema_is_the_models_schema() -> None:
    committed = (REPOSITORY / "data_manifests" / "manifest.schema.json").read_text(encoding="utf-8")
    assert committed == manifest_schema(), "write manifest_schema() to data_manifests/manifest.schema.json"


def test_the_schema_accepts_and_refuses_what_the_models_do() -> None:
    import json

    import jsonschema
    import yaml

    schema = json.loads(manifest_schema())
    jsonschema.validate(yaml.safe_load(MINIMAL), schema)
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(yaml.safe_load(MINIMAL.replace("mesh:", "meshh:")), schema)


@pytest.mark.parametrize("name", ["my_photos.yaml", "my_meshes.yaml"])
def test_the_templates_for_users_are_good_manifests(name: str) -> None:
    capture = read_manifest(REPOSITORY / "data_manifests" / name)
    check_options(capture)
    assert len(capture.manifest.poses) == 3


@pytest.mark.parametrize("stage", sorted(OPTION_CLASSES))
def test_every_stage_has_its_options(stage: str, tmp_path: Path) -> None:
    capture = read_manifest(_write(tmp_path, MINIMAL))
    assert isinstance(stage_options(capture, stage), options_class(stage))


def test_options_of_the_manifest_reach_the_stage(tmp_path: Path) -> None:
    text = MINIMAL + "options: {sparse: {max_features: 123}, align: {limits: {}}}\ndense: {back_end: cpu}\n"
    capture = read_manifest(_write(tmp_path, text))
    check_options(capture)
    assert stage_options(capture, "sparse").max_features == 123
    assert stage_options(capture, "dense", threads=2).backend == "cpu"
    assert stage_options(capture, "dense", threads=2).threads == 2


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ("{sparse: {max_featurs: 1}}", "options.sparse.max_featurs: unknown option"),
        ("{sparse: {max_features: many}}", "options.sparse.max_features: "),
        ("{spars: {}}", "options.spars: no such stage"),
        ("{align: {limits: {nothing: 1}}}", "options.align.limits.nothing: unknown option"),
    ],
)
def test_wrong_options_get_one_line(tmp_path: Path, options: str, expected: str) -> None:
    capture = read_manifest(_write(tmp_path, f"{MINIMAL}options: {options}\n"))
    with pytest.raises(InputError) as caught:
        check_options(capture)
    assert expected in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_known_camera_becomes_the_stages_intrinsics(tmp_path: Path) -> None:
    camera = "camera: {intrinsics: {width: 640, height: 480, focal_length: [700, 701], principal_point: [320, 240]}}\n"
    capture = read_manifest(_write(tmp_path, MINIMAL + camera))
    found = stage_options(capture, "sparse").intrinsics
    assert found.matrix.tolist() == [[700, 0, 320], [0, 701, 240], [0, 0, 1]]
    assert found.distortion.tolist() == [0, 0, 0, 0]
