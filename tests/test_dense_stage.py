"""The dense stage on rendered photos of a ball: files, repeatability, back ends, bad workspaces."""

import json
import shutil
from pathlib import Path

import numpy as np
import pycolmap
import pytest
import textured_ball as ball
from PIL import Image

from capture_eval.cameras import Intrinsics, View
from capture_eval.errors import CaptureEvalError, InputError, ReconstructionError, ToolError
from capture_eval.files.colmap_workspace import DenseWorkspace, map_path, read_map, write_map
from capture_eval.files.point_cloud_files import read_point_cloud, write_point_cloud
from capture_eval.stages.dense import (
    DenseOptions,
    _kept_photos,
    _undistort_masks,
    choose_backend,
    dense_workspace,
    reconstruct_dense,
)
from capture_eval.stages.surface import SurfaceOptions, reconstruct_surface

CPU = DenseOptions(backend="cpu", sources=4)


@pytest.fixture(scope="module")
def pristine(tmp_path_factory) -> Path:
    """Photos and sparse model, never written to."""
    folder = tmp_path_factory.mktemp("ball") / "workspace"
    ball.write_workspace(folder)
    return folder


@pytest.fixture(scope="module")
def pose(pristine) -> Path:
    """A pose folder as the sparse stage leaves it, with dense and surface done."""
    folder = pristine.parent / "pose_00"
    shutil.copytree(pristine / "sparse", folder / "sparse")
    (folder / "sparse.json").write_text(json.dumps({"status": "ok", "photo_folder": str(pristine / "images")}))
    result = reconstruct_dense(folder, DenseOptions(backend="cpu", sources=4, keep_maps=True))
    assert result == json.loads((folder / "dense.json").read_text())
    reconstruct_surface(folder, SurfaceOptions(depth=6))
    return folder


def copied(pristine: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(pristine, tmp_path / "workspace"))


def test_points_lie_on_the_ball(pose) -> None:
    points, numbers = read_point_cloud(pose / "fused.ply")
    radius = np.linalg.norm(points, axis=1)
    # a pixel is 0.86 units wide; depth errors are a few hundredths of it divided by the sine of the base angle
    assert np.median(np.abs(radius - ball.RADIUS)) < 0.1
    assert np.percentile(np.abs(radius - ball.RADIUS), 90) < 0.4
    normals = np.stack([numbers[axis] for axis in ("nx", "ny", "nz")], axis=1)
    assert np.median(np.sum(points / radius[:, None] * normals, axis=1)) > 0.98
    assert np.all(numbers["deviation"] > 0)
    assert np.all(numbers["supporters"] >= 2)


def test_stated_uncertainty_is_what_is_found(pose) -> None:
    """The allowance was found on a head; a ball seen by five photos must agree with it roughly.

    Patches are a tenth of the ball wide here, so all maps share a small error that their spread cannot show.
    """
    from capture_eval.files.ply_files import read_ply_with_properties

    points, numbers = read_point_cloud(pose / "fused.ply")
    mesh, properties = read_ply_with_properties(pose / "scan.ply")
    for places, deviation in ((points, numbers["deviation"]), (mesh.vertices, properties["deviation"])):
        ratio = np.abs(np.linalg.norm(places, axis=1) - ball.RADIUS) / deviation
        assert 0.45 < np.mean(ratio < 1) < 0.9  # .683 for normal errors of known size
        assert np.mean(ratio < 2) > 0.75  # .954


def test_what_photos_see_is_covered_and_no_fringe_is_left(pose) -> None:
    view = ball.views()[2]
    truth = ball.true_depth(view)
    found = read_map(map_path(pose / "dense", "depth", view.name, "geometric"))
    inside = truth > 0
    assert np.mean(found[inside] > 0) > 0.75  # the rim is seen by too few of five photos
    assert np.count_nonzero(found[~inside]) < 0.01 * np.count_nonzero(inside)


def test_report_of_the_stage(pose) -> None:
    report = json.loads((pose / "dense.json").read_text())
    assert report["status"] == "ok"
    assert report["backend"] == "cpu"
    assert [row["photo"] for row in report["photos"]] == [view.name for view in ball.views()]
    assert all(0.5 < row["kept_share"] <= 1.0 for row in report["photos"])


def test_colmap_fuses_our_maps(pose, tmp_path) -> None:
    workspace = pose / "dense"
    assert (workspace / "stereo" / "fusion.cfg").read_text().split() == [view.name for view in ball.views()]
    options = pycolmap.StereoFusionOptions()
    options.min_num_pixels, options.num_threads = 3, 1
    pycolmap.stereo_fusion(
        str(tmp_path / "colmap.ply"), str(workspace), input_type="geometric", options=options, output_type="PLY"
    )
    points, numbers = read_point_cloud(tmp_path / "colmap.ply")
    assert len(points) > 2000
    normals = np.stack([numbers[axis] for axis in ("nx", "ny", "nz")], axis=1)
    assert np.median(np.sum(points / ball.RADIUS * normals, axis=1)) > 0.97  # so it reads the channels as we mean them
    # COLMAP merges pixels up to two apart (1.7 units) by the median of each coordinate, which blurs what is curved
    assert np.median(np.abs(np.linalg.norm(points, axis=1) - ball.RADIUS)) < 0.3


def test_the_scan_is_the_ball(pose) -> None:
    from capture_eval.files.ply_files import read_ply_with_properties

    mesh, numbers = read_ply_with_properties(pose / "scan.ply")
    radius = np.linalg.norm(mesh.vertices, axis=1)
    assert np.percentile(np.abs(radius - ball.RADIUS), 90) < 0.5
    assert numbers["support"].shape == radius.shape
    normals = np.stack([numbers[axis] for axis in ("nx", "ny", "nz")], axis=1)
    assert np.mean(np.sum(normals * mesh.vertices, axis=1) > 0) > 0.99


def test_dense_and_surface_repeat_to_the_byte_with_any_threads(pristine, pose) -> None:
    again = pristine.parent / "again"
    shutil.copytree(pristine / "sparse", again / "sparse")
    shutil.copy(pose / "sparse.json", again)
    reconstruct_dense(again, DenseOptions(backend="cpu", sources=4, threads=2))
    reconstruct_surface(again, SurfaceOptions(depth=6))
    for name in ("fused.ply", "scan.ply"):
        assert (again / name).read_bytes() == (pose / name).read_bytes(), name
    assert not (again / "dense" / "stereo").exists()  # maps are kept only when asked for


@pytest.mark.parametrize(("size", "kept"), [((640, 480), 32), ((4000, 3000), 4), ((12000, 9000), 2)])
def test_memory_is_bounded_by_pixels_not_by_photos(size, kept) -> None:
    lens = Intrinsics(*size, np.diag([1000.0, 1000.0, 1.0]), np.zeros(4))
    views = tuple(View(f"{k}.jpg", lens, np.eye(3), np.zeros(3)) for k in range(200))
    assert _kept_photos(DenseWorkspace(Path(), views, np.zeros((1, 3)), ())) == kept


def test_masks_are_honoured(pristine, tmp_path) -> None:
    workspace = copied(pristine, tmp_path)
    masks = tmp_path / "masks"
    masks.mkdir()
    left = np.zeros((ball.HEIGHT, ball.WIDTH), np.uint8)
    left[:, : ball.WIDTH // 2] = 255
    Image.fromarray(left).save(masks / "view_2.png.png")
    dense_workspace(workspace, None, DenseOptions(backend="cpu", sources=2, masks=masks))
    found = read_map(map_path(workspace, "depth", "view_2.png", "photometric"))
    assert np.count_nonzero(found[:, : ball.WIDTH // 2]) > 1000
    assert np.count_nonzero(found[:, ball.WIDTH // 2 :]) == 0


def test_masks_of_photos_as_taken_follow_the_lens(tmp_path) -> None:
    """A disc round the principal point stays one; a lens that shrinks the rim (k1 < 0) makes its image larger."""
    taken = tmp_path / "taken"
    ball.write_sparse_model(taken, ball.views()[:2], lens=(-0.5,))
    ball.write_workspace(tmp_path / "straight", 2)
    columns, rows = np.meshgrid(np.arange(ball.WIDTH) + 0.5, np.arange(ball.HEIGHT) + 0.5)
    radius = np.hypot(columns - ball.WIDTH / 2, rows - ball.HEIGHT / 2)
    (tmp_path / "masks").mkdir()
    Image.fromarray(np.where(radius < 60.0, 255, 0).astype(np.uint8)).save(tmp_path / "masks" / "view_0.png")
    _undistort_masks(taken, tmp_path / "straight", tmp_path / "masks")
    straight = np.asarray(Image.open(tmp_path / "straight" / "masks" / "view_0.png.png")) > 0
    edge = 60.0 / ball.FOCAL
    wanted = next(r for r in np.arange(60.0, 70.0, 0.01) if r / ball.FOCAL * (1 - 0.5 * (r / ball.FOCAL) ** 2) >= edge)
    assert abs(np.sqrt(np.count_nonzero(straight) / np.pi) - wanted) < 0.3  # the rim is cut by whole pixels
    assert not (tmp_path / "straight" / "masks" / "view_1.png.png").exists()


def test_a_failed_sparse_stage_skips(tmp_path) -> None:
    (tmp_path / "sparse.json").write_text('{"status": "failed"}')
    assert reconstruct_dense(tmp_path, CPU)["status"] == "skipped"
    assert reconstruct_surface(tmp_path, SurfaceOptions())["status"] == "skipped"


def test_maps_round_trip_and_colmap_reads_them(tmp_path) -> None:
    generator = np.random.default_rng(0)
    depth = generator.random((5, 7)).astype(np.float32)
    normal = generator.random((5, 7, 3)).astype(np.float32)
    write_map(tmp_path / "depth.bin", depth)
    write_map(tmp_path / "normal.bin", normal)
    np.testing.assert_array_equal(read_map(tmp_path / "depth.bin"), depth)
    np.testing.assert_array_equal(read_map(tmp_path / "normal.bin"), normal)
    theirs = pycolmap.DepthMap()
    theirs.read(str(tmp_path / "depth.bin"))
    np.testing.assert_array_equal(theirs.to_array(), depth)
    # one channel after the other (pycolmap's to_array would show them interleaved, its fusion reads them like this)
    assert (tmp_path / "normal.bin").read_bytes() == b"7&5&3&" + b"".join(
        normal[..., channel].tobytes() for channel in range(3)
    )


@pytest.mark.parametrize(
    ("content", "words"),
    [(b"", "not a COLMAP map"), (b"2&2&1&abc", "3 bytes of values, expected 16"), (b"a&2&1&", "not a COLMAP map")],
)
def test_broken_maps_are_named(tmp_path, content, words) -> None:
    (tmp_path / "x.bin").write_bytes(content)
    with pytest.raises(InputError, match=words):
        read_map(tmp_path / "x.bin")


def test_point_clouds_round_trip(tmp_path) -> None:
    points = np.random.default_rng(0).normal(size=(9, 3))
    write_point_cloud(tmp_path / "a.ply", points, {"worth": points[:, 0]})
    read, numbers = read_point_cloud(tmp_path / "a.ply")
    np.testing.assert_array_equal(read, points)
    np.testing.assert_array_equal(numbers["worth"], points[:, 0])


def test_back_end_is_chosen() -> None:
    assert choose_backend("auto", True) == "cuda"
    assert choose_backend("auto", False) == "cpu"
    assert choose_backend("cpu", True) == "cpu"
    with pytest.raises(ToolError, match="built without CUDA"):
        choose_backend("cuda", False)
    with pytest.raises(InputError, match="'gpu' is not known"):
        DenseOptions(backend="gpu")


def test_cuda_writes_the_same_files(pristine, pose, tmp_path, monkeypatch) -> None:
    """A recording stand-in for pycolmap's CUDA stereo copies exact maps; the rest of the stage goes on from them."""
    workspace = copied(pristine, tmp_path)
    calls = []

    def record(path, options):
        calls.append((Path(path), options.geom_consistency))
        for view in ball.views():
            for kind in ("depth", "normal"):
                source = map_path(pose / "dense", kind, view.name, "geometric")
                write_map(map_path(workspace, kind, view.name, "geometric"), read_map(source))

    monkeypatch.setattr(pycolmap, "has_cuda", True)
    monkeypatch.setattr(pycolmap, "patch_match_stereo", record)
    result = dense_workspace(workspace, tmp_path / "fused.ply", DenseOptions(backend="auto"))
    assert calls == [(workspace, True)]
    assert result["backend"] == "cuda"
    points, _ = read_point_cloud(tmp_path / "fused.ply")
    assert np.median(np.abs(np.linalg.norm(points, axis=1) - ball.RADIUS)) < 0.1


def _no_points(folder: Path) -> None:
    shutil.rmtree(folder / "sparse")
    ball.write_sparse_model(folder / "sparse", ball.views(), with_points=False)


def _one_photo(folder: Path) -> None:
    shutil.rmtree(folder / "sparse")
    ball.write_sparse_model(folder / "sparse", ball.views()[:1])


def _distorted(folder: Path) -> None:
    shutil.rmtree(folder / "sparse")
    ball.write_sparse_model(folder / "sparse", ball.views(), model="SIMPLE_RADIAL_FISHEYE")


def _other_size(folder: Path) -> None:
    Image.new("RGB", (50, 40)).save(folder / "images" / "view_1.png")


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda folder: shutil.rmtree(folder / "sparse"), "no folder sparse/ here"),
        (_no_points, "has no points"),
        (_one_photo, "needs at least two"),
        (
            lambda folder: (folder / "images" / "view_3.png").unlink(),
            r"view_3\.png: photo of the sparse model is missing",
        ),
        (
            lambda folder: (folder / "images" / "view_3.png").write_bytes(b"no"),
            r"view_3\.png: cannot be read as an image",
        ),
        (_other_size, r"view_1\.png: 50x40 pixels, but its camera has 192x144"),
        (_distorted, "SIMPLE_RADIAL_FISHEYE"),
    ],
)
def test_bad_workspaces_get_one_line(pristine, tmp_path, spoil, words) -> None:
    workspace = copied(pristine, tmp_path)
    spoil(workspace)
    with pytest.raises(CaptureEvalError, match=words) as caught:
        dense_workspace(workspace, None, CPU)
    assert "\n" not in str(caught.value)


def test_photos_without_common_points_are_refused(pristine, tmp_path, monkeypatch) -> None:
    from capture_eval.stages import dense

    workspace = copied(pristine, tmp_path)
    monkeypatch.setattr(dense, "pair_scores", lambda centers, *_: np.zeros((len(centers), len(centers))))
    with pytest.raises(ReconstructionError, match="no two photos share sparse points"):
        dense_workspace(workspace, None, CPU)
