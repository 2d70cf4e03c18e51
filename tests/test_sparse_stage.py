"""The sparse stage on photos of a freckled ball whose cameras are known."""

import json
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from capture_eval.cameras import Intrinsics, View, pixel_rays, project
from capture_eval.errors import InputError
from capture_eval.files.colmap_files import read_features, read_sparse_model
from capture_eval.similarity import estimate_similarity
from capture_eval.stages.sparse import SparseOptions, reconstruct_sparse

pytest.importorskip("pycolmap")

WIDTH, HEIGHT, FOCAL = 240, 200, 380.0


def _ball_view(index: int, count: int) -> View:
    """A camera on an arc of 60 degrees, three ball radii away, alternately above and below."""
    azimuth = np.radians(-30 + 60 * index / (count - 1))
    elevation = np.radians(12 if index % 2 else -12)
    direction = np.array([np.sin(azimuth) * np.cos(elevation), np.sin(elevation), np.cos(azimuth) * np.cos(elevation)])
    forward = -direction
    right = np.cross(forward, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    matrix = np.array([[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1]])
    intrinsics = Intrinsics(WIDTH, HEIGHT, matrix, np.zeros(4))
    return View(f"view_{index:02d}.png", intrinsics, rotation, -rotation @ (direction * 4.0))


def _freckles(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Grey of a solid texture of dark spots at seeded places on the unit ball."""
    from scipy.spatial import cKDTree

    random = np.random.default_rng(3)
    centres = random.normal(size=(1200, 3))
    centres /= np.linalg.norm(centres, axis=1, keepdims=True)
    radius = random.uniform(0.015, 0.05, len(centres))
    distance, index = cKDTree(centres).query(points)
    return 200.0 - 130.0 * np.exp(-((distance / radius[index]) ** 2))


def _photograph(view: View, path: Path) -> None:
    columns, rows = np.meshgrid(np.arange(2 * WIDTH) / 2 + 0.25, np.arange(2 * HEIGHT) / 2 + 0.25)
    origin, directions = pixel_rays(view, np.stack([columns.ravel(), rows.ravel()], axis=1))
    along = directions @ origin
    root = along**2 - (origin @ origin - 1.0)
    grey = np.full(len(directions), 60.0)
    hit = root > 0
    depth = -along[hit] - np.sqrt(root[hit])
    grey[hit] = _freckles(origin + depth[:, None] * directions[hit])
    picture = grey.reshape(HEIGHT, 2, WIDTH, 2).mean(axis=(1, 3)).astype(np.uint8)
    Image.fromarray(np.repeat(picture[:, :, None], 3, axis=2)).save(path)


@pytest.fixture(scope="module")
def ball(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[View]]:
    folder = tmp_path_factory.mktemp("ball") / "photos" / "pose_00"
    folder.mkdir(parents=True)
    views = [_ball_view(index, 6) for index in range(6)]
    for view in views:
        _photograph(view, folder / view.name)
    return folder, views


def test_cameras_are_recovered_up_to_a_similarity_and_repeat_bit_for_bit(
    ball: tuple[Path, list[View]], tmp_path: Path
) -> None:
    folder, views = ball
    photos = sorted(folder.glob("*.png"))
    quality = reconstruct_sparse(photos, tmp_path / "a" / "pose_00", SparseOptions())
    reconstruct_sparse(photos, tmp_path / "b" / "pose_00", SparseOptions())
    assert quality["status"] == "ok"
    assert quality["registered"] == len(photos)
    assert json.loads((tmp_path / "a" / "pose_00" / "sparse.json").read_text()) == quality
    for name in ("cameras.bin", "images.bin", "points3D.bin"):
        first = (tmp_path / "a" / "pose_00" / "sparse" / name).read_bytes()
        assert first == (tmp_path / "b" / "pose_00" / "sparse" / name).read_bytes()
    model = read_sparse_model(tmp_path / "a" / "pose_00" / "sparse")
    solved = np.array([model.views[view.name].center for view in views])
    true = np.array([view.center for view in views])
    moved = estimate_similarity(solved, true).apply(solved)
    # six photos of a small arc leave the focal length loose: 5 % of the distance of 4 is what it costs here
    assert np.linalg.norm(moved - true, axis=1).max() < 0.2
    features = read_features(tmp_path / "a" / "pose_00" / "database.db")
    for name, view in model.views.items():
        seen = model.tracks[name] >= 0
        pixels, depth = project(view, model.points[model.tracks[name][seen]])
        assert np.all(depth > 0)
        assert np.median(np.linalg.norm(pixels - features[name].keypoints[seen], axis=1)) < 1.0


def test_known_cameras_are_kept_and_points_lie_on_the_ball(ball: tuple[Path, list[View]], tmp_path: Path) -> None:
    folder, views = ball
    entries = [
        {
            "pose": "pose_00",
            "photo": view.name,
            "width": WIDTH,
            "height": HEIGHT,
            "matrix": view.intrinsics.matrix.tolist(),
            "distortion": [0.0] * 4,
            "rotation": view.rotation.tolist(),
            "translation": view.translation.tolist(),
        }
        for view in views
    ]
    cameras = tmp_path / "cameras.json"
    cameras.write_text(json.dumps({"views": entries}))
    quality = reconstruct_sparse(
        sorted(folder.glob("*.png")), tmp_path / "pose_00", SparseOptions(known_cameras=cameras)
    )
    assert quality["status"] == "ok"
    model = read_sparse_model(tmp_path / "pose_00" / "sparse")
    for view in views:
        np.testing.assert_allclose(model.views[view.name].center, view.center, atol=1e-9)
    # half a pixel at 4 units and 380 px focal length over a base of a radian is about .01
    assert np.median(np.abs(np.linalg.norm(model.points, axis=1) - 1.0)) < 0.01


def test_photos_of_nothing_are_a_failed_row_and_no_crash(tmp_path: Path) -> None:
    folder = tmp_path / "photos"
    folder.mkdir()
    for index in range(4):
        Image.new("RGB", (64, 48), (90, 90, 90)).save(folder / f"{index}.png")
    (folder / "broken.png").write_bytes(b"not a picture")
    quality = reconstruct_sparse(sorted(folder.glob("*.png")), tmp_path / "pose_03", SparseOptions())
    assert quality["status"] == "failed"
    assert "pose_03" in quality["reason"]
    assert [row["registered"] for row in quality["per_photo"]] == [False] * 5
    assert any("unreadable" in row.get("reason", "") for row in quality["per_photo"])


def test_bad_input_is_one_line(ball: tuple[Path, list[View]], tmp_path: Path) -> None:
    folder, _ = ball
    photo = folder / "view_00.png"
    with pytest.raises(InputError, match="no photos"):
        reconstruct_sparse([], tmp_path / "pose_00", SparseOptions())
    with pytest.raises(InputError, match="2 folders"):
        reconstruct_sparse([photo, tmp_path / "other.png"], tmp_path / "pose_00", SparseOptions())
    with pytest.raises(InputError, match="twice"):
        reconstruct_sparse([photo, photo], tmp_path / "pose_00", SparseOptions())
    masks = tmp_path / "masks"
    masks.mkdir()
    Image.new("L", (10, 10), 255).save(masks / "view_00.png")
    with pytest.raises(InputError, match="10x10"):
        reconstruct_sparse(sorted(folder.glob("*.png")), tmp_path / "pose_00", SparseOptions(masks=masks))
