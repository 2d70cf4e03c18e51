"""A ball with a solid texture before a plain backdrop, photographed exactly, as a COLMAP dense workspace."""

from pathlib import Path

import numpy as np
import pycolmap
from numpy.typing import NDArray
from PIL import Image

from capture_eval.cameras import Intrinsics, View, pixel_rays, project

Floats = NDArray[np.float64]

RADIUS = 50.0
WIDTH, HEIGHT, FOCAL = 192, 144, 420.0


def texture(points: Floats, finest: float = 1.6) -> Floats:
    """Grey (N,) of a pattern in space whose detail is a few pixels wide."""
    generator = np.random.default_rng(0)
    total = np.zeros(len(points))
    for _ in range(40):
        direction = generator.normal(size=3)
        direction *= 2.0 * np.pi / generator.uniform(finest, 5.0 * finest) / np.linalg.norm(direction)
        total += np.sin(points @ direction + generator.uniform(0.0, 2.0 * np.pi))
    return 128.0 + 9.0 * total


def views(count: int = 5) -> list[View]:
    """Cameras on an arc of 44 degrees, alternately above and below, looking at the centre."""
    result = []
    matrix = np.array([[FOCAL, 0.0, WIDTH / 2], [0.0, FOCAL, HEIGHT / 2], [0.0, 0.0, 1.0]])
    for index in range(count):
        turn, nod = np.radians([-22.0 + 44.0 * index / (count - 1), 8.0 if index % 2 else -8.0])
        centre = 360.0 * np.array([np.sin(turn) * np.cos(nod), np.sin(nod), -np.cos(turn) * np.cos(nod)])
        forward = -centre / np.linalg.norm(centre)
        right = np.cross([0.0, 1.0, 0.0], forward)
        right /= np.linalg.norm(right)
        rotation = np.stack([right, np.cross(forward, right), forward])
        lens = Intrinsics(WIDTH, HEIGHT, matrix, np.zeros(4))
        result.append(View(f"view_{index}.png", lens, rotation, -rotation @ centre))
    return result


def _hits(view: View, columns: Floats, rows: Floats) -> tuple[NDArray[np.bool_], Floats]:
    origin, direction = pixel_rays(view, np.stack([columns.ravel(), rows.ravel()], axis=1))
    along = direction @ origin
    under = along**2 - (origin @ origin - RADIUS**2)
    distance = -along - np.sqrt(np.maximum(under, 0.0))
    return under > 0, origin + distance[:, None] * direction


def photograph(view: View, seed: int) -> NDArray[np.uint8]:
    """Four rays a pixel, sensor noise of one grey level, on plain grey."""
    total = np.zeros(WIDTH * HEIGHT)
    for du, dv in ((0.25, 0.25), (0.75, 0.25), (0.25, 0.75), (0.75, 0.75)):
        hit, points = _hits(view, *np.meshgrid(np.arange(WIDTH) + du, np.arange(HEIGHT) + dv))
        total += np.where(hit, texture(points), 60.0) / 4.0
    noise = np.random.default_rng(seed).normal(size=(HEIGHT, WIDTH, 3))
    return np.clip(np.rint(total.reshape(HEIGHT, WIDTH, 1) + noise), 0, 255).astype(np.uint8)


def true_depth(view: View) -> Floats:
    """Depth (H, W) along the axis at the pixel centres, 0 beside the ball."""
    hit, points = _hits(view, *np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5))
    depth = points @ view.rotation[2] + view.translation[2]
    return np.where(hit, depth, 0.0).reshape(HEIGHT, WIDTH)


def write_sparse_model(
    folder: Path, cameras: list[View], with_points: bool = True, model: str = "PINHOLE", lens: tuple[float, ...] = ()
) -> None:
    """COLMAP model of the cameras and of points on the ball that each of them sees."""
    folder.mkdir(parents=True, exist_ok=True)
    generator = np.random.default_rng(1)
    points = generator.normal(size=(400, 3))
    points *= RADIUS / np.linalg.norm(points, axis=1, keepdims=True)
    reconstruction = pycolmap.Reconstruction()
    camera = pycolmap.Camera.create_from_model_name(1, "SIMPLE_RADIAL" if lens else model, FOCAL, WIDTH, HEIGHT)
    if lens:
        camera.params = [FOCAL, WIDTH / 2, HEIGHT / 2, *lens]
    reconstruction.add_camera_with_trivial_rig(camera)
    tracks: dict[int, list[tuple[int, int]]] = {}
    for number, view in enumerate(cameras, start=1):
        pixels, _ = project(view, points)
        away = view.center - points
        seen = np.nonzero(np.sum(away * points, axis=1) > 0.3 * RADIUS * np.linalg.norm(away, axis=1))[0]
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(view.rotation), view.translation)
        image = pycolmap.Image(name=view.name, camera_id=1, image_id=number, keypoints=pixels[seen])
        reconstruction.add_image_with_trivial_frame(image, pose)
        for place, point in enumerate(seen):
            tracks.setdefault(int(point), []).append((number, place))
    for point, elements in sorted(tracks.items()) if with_points else ():
        track = pycolmap.Track([pycolmap.TrackElement(number, place) for number, place in elements])
        reconstruction.add_point3D(points[point], track, np.array([128, 128, 128], np.uint8))
    reconstruction.write_binary(str(folder))


def write_workspace(folder: Path, count: int = 5) -> list[View]:
    """`images/` and `sparse/` as the undistorter leaves them."""
    cameras = views(count)
    (folder / "images").mkdir(parents=True)
    for number, view in enumerate(cameras):
        Image.fromarray(photograph(view, number)).save(folder / "images" / view.name)
    write_sparse_model(folder / "sparse", cameras)
    return cameras
