"""No head: boxes and a ball on a slanted ground that runs off to seven times their distance, as a dense workspace.

Rendered with the project's photographer. Lengths in millimetres, y up, the cameras look along -z.
"""

from functools import lru_cache
from pathlib import Path

import numpy as np
import pycolmap
from numpy.typing import NDArray
from PIL import Image

from capture_eval.cameras import Intrinsics, View, pixel_rays, project
from capture_eval.images.camera_rig import look_at
from capture_eval.images.ray_casting import TriangleScene
from capture_eval.images.sensor import expose
from capture_eval.images.skin_shading import HeadModel, Lighting, light_head, photograph, texture_pyramids
from capture_eval.triangle_geometry import triangle_normals

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

FOCAL = 330.0  # pixels at full size
NEAR, FAR = 420.0, 3000.0  # ground along -z
SLOPE = 0.2  # it rises away from the cameras
SIZES = ((320, 240), (320, 240), (240, 320), (320, 240), (200, 150), (320, 240))  # the third upright, the fifth small


def _sheet(corner: Floats, across: Floats, up: Floats, pieces: int) -> tuple[Floats, Integers, Floats]:
    """Vertices, triangles and texture coordinates of a parallelogram cut into pieces x pieces."""
    u, v = np.meshgrid(np.linspace(0.0, 1.0, pieces + 1), np.linspace(0.0, 1.0, pieces + 1))
    points = corner + u[..., None] * across + v[..., None] * up
    index = np.arange((pieces + 1) ** 2).reshape(pieces + 1, pieces + 1)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    triangles = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    longest = max(np.linalg.norm(across), np.linalg.norm(up))
    scale = np.array([np.linalg.norm(across), np.linalg.norm(up)]) / max(longest, 700.0)
    return points.reshape(-1, 3), triangles, np.stack([u, v], -1).reshape(-1, 2) * scale * 0.98 + 0.01


def _box(x: float, z: float, width: float, height: float) -> list[tuple[Floats, Integers, Floats]]:
    """Front, both sides and top, turned by 20 degrees about the vertical; its foot is sunk into the ground."""
    turn = np.radians(20.0)
    right = width * np.array([np.cos(turn), 0.0, np.sin(turn)])
    back = width * np.array([np.sin(turn), 0.0, -np.cos(turn)])
    up = np.array([0.0, height + 40.0, 0.0])
    foot = np.array([x, -SLOPE * z - 40.0, z]) - right / 2
    return [
        _sheet(foot, right, up, 2),
        _sheet(foot + right, back, up, 2),
        _sheet(foot + back, -back, up, 2),
        _sheet(foot + up, right, back, 2),
    ]


def _ball(centre: tuple[float, float, float], radius: float) -> tuple[Floats, Integers, Floats]:
    points, triangles, _ = _sheet(np.zeros(3), np.array([1.0, 0, 0]), np.array([0, 1.0, 0]), 40)
    longitude, latitude = (points[:, 0] - 0.5) * 2 * np.pi, (points[:, 1] - 0.5) * np.pi
    unit = [np.sin(longitude) * np.cos(latitude), np.sin(latitude), np.cos(longitude) * np.cos(latitude)]
    return np.array(centre) + radius * np.stack(unit, 1), triangles, np.stack([points[:, 0], points[:, 1]], 1)


@lru_cache(maxsize=1)
def scene() -> tuple[Floats, Integers, Floats]:
    """Vertices, triangles and texture coordinates of the triangles' corners."""
    ground = _sheet(
        np.array([-1600.0, SLOPE * NEAR, -NEAR]),
        np.array([3200.0, 0, 0]),
        np.array([0.0, SLOPE * (FAR - NEAR), NEAR - FAR]),
        30,
    )
    parts = [ground, *_box(-120.0, -650.0, 110.0, 150.0), *_box(40.0, -1500.0, 320.0, 330.0)]
    parts.append(_ball((150.0, SLOPE * 900.0 + 60.0, -900.0), 85.0))
    starts = np.cumsum([0, *(len(part[0]) for part in parts)])
    triangles = np.concatenate([part[1] + start for part, start in zip(parts, starts, strict=False)])
    uv = np.concatenate([part[2] for part in parts])
    return np.concatenate([part[0] for part in parts]), triangles, uv[triangles]


def _texture(side: int = 1024) -> NDArray[np.uint8]:
    """Grey noise with the same contrast at every scale."""
    generator = np.random.default_rng(7)
    total = np.zeros((side, side))
    for octave in range(2, 10):
        coarse = generator.normal(size=(2**octave, 2**octave)).astype(np.float32)
        total += np.asarray(Image.fromarray(coarse).resize((side, side), Image.Resampling.BICUBIC))
    grey = np.clip(128.0 + 22.0 * total, 20.0, 235.0).astype(np.uint8)
    return np.repeat(grey[..., None], 3, axis=2)


def views() -> list[View]:
    """Six cameras side by side, alternately lower and higher, of three picture sizes."""
    result = []
    for number, (width, height) in enumerate(SIZES):
        focal = FOCAL * max(width, height) / 320
        matrix = np.array([[focal, 0.0, width / 2], [0.0, focal, height / 2], [0.0, 0.0, 1.0]])
        place = np.array([-200.0 + 80.0 * number, 420.0 if number % 2 else 350.0, 0.0])
        rotation, translation = look_at(place, (0.0, 220.0, -850.0))
        name = f"photo_{number}.png"
        result.append(View(name, Intrinsics(width, height, matrix, np.zeros(4)), rotation, translation))
    return result


def _rays(view: View) -> tuple[Floats, Floats]:
    columns, rows = np.meshgrid(np.arange(view.intrinsics.width) + 0.5, np.arange(view.intrinsics.height) + 0.5)
    return pixel_rays(view, np.stack([columns.ravel(), rows.ravel()], axis=1))


def first_triangles(view: View) -> Integers:
    """Triangle seen at every pixel centre, row by row; -1 on the backdrop."""
    vertices, triangles, _ = scene()
    return TriangleScene(vertices, triangles).first_triangles(*_rays(view)).astype(np.int64)


def true_depth(view: View) -> Floats:
    """Depth (H, W) at the pixel centres; 0 on the backdrop."""
    vertices, triangles, _ = scene()
    origin, rays = _rays(view)
    met = first_triangles(view)
    seen = np.nonzero(met >= 0)[0]
    normals = triangle_normals(vertices, triangles[met[seen]])
    along = np.sum((vertices[triangles[met[seen], 0]] - origin) * normals, axis=1) / np.sum(
        normals * rays[seen], axis=1
    )
    depth = np.zeros(len(rays))
    depth[seen] = along * (rays[seen] @ view.rotation[2])
    return depth.reshape(view.intrinsics.height, view.intrinsics.width)


def sparse_points(cameras: list[View]) -> tuple[Floats, list[Integers]]:
    """Points that photos see, 120 found in each, and which of them each photo sees."""
    vertices, triangles, _ = scene()
    caster = TriangleScene(vertices, triangles)
    generator = np.random.default_rng(3)
    found = []
    for view in cameras:
        depth = true_depth(view)
        rows, columns = np.nonzero(depth > 0)
        chosen = generator.choice(len(rows), 120, replace=False)
        pixels = np.stack([columns[chosen] + 0.5, rows[chosen] + 0.5], axis=1)
        origin, rays = pixel_rays(view, pixels)
        found.append(origin + rays * (depth[rows[chosen], columns[chosen]] / (rays @ view.rotation[2]))[:, None])
    points = np.concatenate(found)
    visible = []
    for view in cameras:
        pixels, depth = project(view, points)
        inside = np.all((pixels > 0) & (pixels < [view.intrinsics.width, view.intrinsics.height]), axis=1)
        hidden = caster.occluded(view.center, points, slack=2e-3)
        visible.append(np.nonzero(inside & (depth > 0) & ~hidden)[0])
    return points, visible


def write_workspace(folder: Path) -> list[View]:
    """`images/` and `sparse/` as COLMAP's undistorter leaves them, every photo with a camera of its own."""
    vertices, triangles, uv = scene()
    count = len(triangles)
    model = HeadModel(
        triangles=triangles,
        skin_vertices=len(vertices),
        skin_triangles=count,
        triangle_texture=np.zeros(count, np.int64),
        triangle_uv=uv,
        colors=np.zeros((len(vertices), 3)),
        gloss=np.zeros(count),
        shininess=np.ones(count),
        textures=texture_pyramids([_texture()]),
    )
    cameras = views()
    lit = light_head(model, vertices, Lighting(fill_top=1.0, fill_bottom=0.6))
    (folder / "images").mkdir(parents=True)
    for number, view in enumerate(cameras):
        Image.fromarray(expose(photograph(lit, view), 1.5, (number,))).save(folder / "images" / view.name)
    write_sparse_model(folder / "sparse", cameras, *sparse_points(cameras))
    return cameras


def write_sparse_model(folder: Path, cameras: list[View], points: Floats, visible: list[Integers]) -> None:
    """COLMAP model of the cameras and of the points that each of them sees."""
    folder.mkdir(parents=True, exist_ok=True)
    reconstruction = pycolmap.Reconstruction()
    tracks: dict[int, list[tuple[int, int]]] = {}
    for number, (view, seen) in enumerate(zip(cameras, visible, strict=True), start=1):
        lens = view.intrinsics
        camera = pycolmap.Camera.create_from_model_name(number, "PINHOLE", lens.matrix[0, 0], lens.width, lens.height)
        reconstruction.add_camera_with_trivial_rig(camera)
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(view.rotation), view.translation)
        pixels = project(view, points)[0][seen]
        image = pycolmap.Image(name=view.name, camera_id=number, image_id=number, keypoints=pixels)
        reconstruction.add_image_with_trivial_frame(image, pose)
        for place, point in enumerate(seen):
            tracks.setdefault(int(point), []).append((number, place))
    for point, elements in sorted(tracks.items()):
        track = pycolmap.Track([pycolmap.TrackElement(number, place) for number, place in elements])
        reconstruction.add_point3D(points[point], track, np.array([128, 128, 128], np.uint8))
    reconstruction.write_binary(str(folder))
