"""Ray casting, shading, cameras, sensor and EXIF of the synthetic captures, held to what can be worked out by hand."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from capture_eval.cameras import View, pixel_rays, project
from capture_eval.errors import InputError
from capture_eval.files.camera_files import read_cameras, write_cameras
from capture_eval.files.jpeg_files import PhotoTags, read_photo, read_photo_tags, write_jpeg
from capture_eval.images.camera_rig import RigOptions, arc_directions, intrinsics_for, look_at, place_cameras
from capture_eval.images.landmark_noise import click_landmarks, visible_vertices
from capture_eval.images.ray_casting import TriangleScene, plane_depths, sample_pixels
from capture_eval.images.sensor import expose, linear_from_srgb, srgb_from_linear
from capture_eval.images.skin_shading import HeadModel, Lighting, LitHead, photograph, texture_pyramids
from capture_eval.images.timing import parse_timing


def ball(radius: float = 80.0, rings: int = 40) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and triangles of a sphere about the origin."""
    polar, around = np.linspace(0.05, np.pi - 0.05, rings), np.linspace(0, 2 * np.pi, 2 * rings, endpoint=False)
    p, a = np.meshgrid(polar, around, indexing="ij")
    vertices = radius * np.stack([np.sin(p) * np.cos(a), np.cos(p), np.sin(p) * np.sin(a)], axis=-1).reshape(-1, 3)
    row, column = np.meshgrid(np.arange(rings - 1), np.arange(2 * rings), indexing="ij")
    here, right = row * 2 * rings + column, row * 2 * rings + (column + 1) % (2 * rings)
    quads = np.stack([here, right, right + 2 * rings, here + 2 * rings], axis=-1).reshape(-1, 4)
    return vertices, np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def evenly_lit(vertices: np.ndarray, triangles: np.ndarray, colors: np.ndarray, backdrop: int = 0) -> LitHead:
    """Things that glow in their own (linear) colours: no lamp, no shade."""
    model = HeadModel(
        triangles=triangles,
        skin_vertices=len(vertices),
        skin_triangles=len(triangles),
        triangle_texture=np.full(len(triangles), -1),
        triangle_uv=np.zeros((len(triangles), 3, 2)),
        colors=colors,
        gloss=np.zeros(len(triangles)),
        shininess=np.ones(len(triangles)),
        textures=texture_pyramids([]),
    )
    return lit_model(model, vertices, backdrop)


def lit_model(model: HeadModel, vertices: np.ndarray, backdrop: int = 0) -> LitHead:
    return LitHead(
        model=model,
        lighting=Lighting(boxes=(), backdrop=backdrop),
        scene=TriangleScene(vertices, model.triangles),
        normals=np.tile([0.0, 0.0, 1.0], (len(vertices), 1)),
        irradiance=np.ones(len(vertices)),
        light_visibility=np.zeros((len(vertices), 0)),
    )


def frontal_view(width: int = 160, height: int = 120, distance: float = 600.0, k1: float = 0.0) -> View:
    rotation, translation = look_at([0.0, 0.0, distance], [0.0, 0.0, 0.0])
    return View("front", intrinsics_for(width, height, (k1, 0.0, 0.0, 0.0)), rotation, translation)


@pytest.mark.parametrize("k1", [0.0, -0.12])
def test_rays_through_projected_points_meet_the_points(k1: float) -> None:
    """Projection (with distortion) and ray casting are each other's inverse: 1e-6 mm, the rounding of undistortion."""
    vertices, triangles = ball()
    scene = TriangleScene(vertices, triangles)
    rotation, translation = look_at([210.0, 90.0, 540.0], [3.0, -2.0, 1.0], 0.1)
    view = View("slanted", intrinsics_for(640, 480, (k1, 0.0, 0.0, 0.0)), rotation, translation)
    # Just beside the vertices: single-precision rays may slip between the triangles that meet exactly at one.
    corners = vertices[triangles]
    points = 0.98 * corners[:, 0] + 0.01 * (corners[:, 1] + corners[:, 2])
    facing = np.flatnonzero(np.einsum("ij,ij->i", points, view.center - points) > 2000.0)
    points = points[facing]
    pixels, depth = project(view, points)
    origin, directions = pixel_rays(view, pixels)
    hit = scene.first_triangles(origin, directions)
    assert len(facing) > 1000
    assert np.array_equal(hit, facing)
    reach, _ = plane_depths(scene, origin, directions, hit)
    met = origin + reach[:, None] * directions
    assert np.abs(met - points).max() < 1e-6
    assert np.abs((met - origin) @ view.rotation[2] - depth).max() < 1e-6


def test_picture_of_places_shows_where_each_pixel_looks() -> None:
    """Colours linear in the place make the photo a map of places; its pixels must be those of the pixels' own rays."""
    corners = np.array([[-90.0, -80.0, 30.0], [90.0, -80.0, -30.0], [90.0, 80.0, -30.0], [-90.0, 80.0, 30.0]])
    triangles = np.array([[0, 1, 2], [0, 2, 3]])
    lit = evenly_lit(corners, triangles, (corners + 100.0) / 200.0)
    view = frontal_view()
    picture = photograph(lit, view)
    columns, rows = np.meshgrid(np.arange(60, 100), np.arange(45, 75))
    places = np.zeros((columns.size, 3))
    for shift_u in (-1 / 3, 0.0, 1 / 3):
        for shift_v in (-1 / 3, 0.0, 1 / 3):
            pixels = np.stack([columns.ravel() + 0.5 + shift_u, rows.ravel() + 0.5 + shift_v], axis=1)
            origin, rays = pixel_rays(view, pixels)
            normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
            reach = normal @ (corners[0] - origin) / (rays @ normal)
            places += (origin + reach[:, None] * rays) / 9.0
    expected = (places + 100.0) / 200.0
    # double precision all through: only the sums are ordered differently
    assert np.abs(picture[rows.ravel(), columns.ravel()] - expected).max() < 1e-9


@pytest.mark.parametrize("k1", [0.0, -0.15])
def test_photographed_ball_is_where_projection_says(k1: float) -> None:
    """Centre of a small bright ball near the picture's corner: centroid of light against projection.

    A ball 20 px wide has its centroid within (6/600)^2 of its distance from the middle (0.03 px); samples add 0.01 px.
    """
    vertices, triangles = ball(radius=6.0, rings=24)
    vertices = vertices + np.array([128.0, 90.0, 0.0])
    lit = evenly_lit(vertices, triangles, np.ones_like(vertices))
    view = frontal_view(640, 480, k1=k1)
    light = photograph(lit, view)[:, :, 0]
    rows, columns = np.indices(light.shape) + 0.5
    centroid = np.array([(light * columns).sum(), (light * rows).sum()]) / light.sum()
    expected, _ = project(view, np.array([[128.0, 90.0, 0.0]]))
    assert np.abs(centroid - expected[0]).max() < 0.05


def test_edges_are_area_filtered() -> None:
    """An upright edge through a pixel at 1/3 of its width covers 1/3 of the pixel exactly (3 x 3 samples)."""
    view = frontal_view()
    per_pixel = 600.0 / view.intrinsics.matrix[0, 0]
    right = (1.0 / 3.0) * per_pixel  # the principal point is the left border of column 80
    corners = np.array([[-40.0, -40.0, 0.0], [right, -40.0, 0.0], [right, 40.0, 0.0], [-40.0, 40.0, 0.0]])
    lit = evenly_lit(corners, np.array([[0, 1, 2], [0, 2, 3]]), np.ones((4, 3)))
    picture = photograph(lit, view)[60, :, 0]
    assert picture[79] == pytest.approx(1.0)
    assert picture[80] == pytest.approx(1.0 / 3.0, abs=1e-12)
    assert picture[81] == 0.0


def checker_plane(cell: int, side: int, texels_per_pixel: float) -> tuple[LitHead, View]:
    """A plane with a black and white checker, parallel to the picture."""
    view = frontal_view()
    half = 0.5 * side / texels_per_pixel * 600.0 / view.intrinsics.matrix[0, 0]
    corners = np.array([[-half, -half, 0.0], [half, -half, 0.0], [half, half, 0.0], [-half, half, 0.0]])
    grid = np.indices((side, side)) // cell
    image = np.repeat((255 * (grid.sum(axis=0) % 2))[:, :, None], 3, axis=2).astype(np.uint8)
    uv = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    triangles = np.array([[0, 1, 2], [0, 2, 3]])
    model = HeadModel(
        triangles, 4, 2, np.zeros(2, dtype=np.int64), uv[triangles], np.zeros((4, 3)), np.zeros(2), np.ones(2),
        texture_pyramids([image]),
    )  # fmt: skip
    return lit_model(model, corners), view


def test_fine_checker_becomes_its_mean() -> None:
    """Detail smaller than a pixel must not alias: six texels a pixel, checker of three texels, mean light one half."""
    lit, view = checker_plane(cell=3, side=384, texels_per_pixel=6.0)
    middle = photograph(lit, view)[40:80, 60:100, 0]
    # One pixel holds two by two cells, so its area mean is exactly 1/2; the reduced textures blur by half a cell.
    assert middle.mean() == pytest.approx(0.5, abs=0.005)
    assert middle.std() < 0.05
    single = photograph(lit, view, samples_per_side=1)[40:80, 60:100, 0]
    assert np.abs(middle - 0.5).max() < 0.15
    assert single.mean() == pytest.approx(0.5, abs=0.1)


def test_coarse_checker_is_seen_texel_by_texel() -> None:
    """Eight pixels a cell: inside the cells the photo is black and white, and the right cell is white."""
    lit, view = checker_plane(cell=8, side=128, texels_per_pixel=1.0)
    picture = photograph(lit, view)[:, :, 0]
    # The plane's texel (64, 64) begins at the picture's centre (80, 60); cells (8, 8) there are of even parity: black.
    assert picture[62:66, 82:86].max() == 0.0
    assert picture[62:66, 90:94].min() == pytest.approx(1.0, abs=1e-6)
    assert picture[70:74, 82:86].min() == pytest.approx(1.0, abs=1e-6)


def test_texture_halvings_keep_the_mean_light() -> None:
    """Box means in linear light keep the light, up to the rounding to 8 bits (half a grey level)."""
    image = np.random.default_rng(1).integers(0, 256, (64, 64, 3)).astype(np.uint8)
    pyramid = texture_pyramids([image])
    light = linear_from_srgb(pyramid.texels / 255.0)
    means = [light[start : start + w * h].mean() for start, w, h in pyramid.table[0] if w]
    assert len(means) >= 4
    assert np.allclose(means, means[0], atol=0.004)


def test_empty_picture_is_backdrop() -> None:
    vertices, triangles = ball()
    lit = evenly_lit(vertices, triangles, np.ones_like(vertices), backdrop=96)
    rotation, translation = look_at([0.0, 0.0, 600.0], [0.0, 0.0, 900.0])
    view = View("away", intrinsics_for(160, 120), rotation, translation)
    assert len(sample_pixels(lit.scene, view).rows) == 0
    assert np.all(photograph(lit, view) == linear_from_srgb(96 / 255.0))


@given(st.floats(0.0, 1.0))
def test_srgb_goes_there_and_back(light: float) -> None:
    assert float(linear_from_srgb(srgb_from_linear(light))) == pytest.approx(light, abs=1e-6)


@pytest.mark.parametrize("sigma", [1.5, 2.5])
def test_sensor_noise_has_the_stated_size(sigma: float) -> None:
    """Rounding adds a variance of 1/12; 120,000 values give the deviation to 1 %."""
    grey = np.full((200, 200, 3), float(linear_from_srgb(0.5)))
    photo = expose(grey, sigma, (4, 5)).astype(float)
    assert photo.std() == pytest.approx(np.sqrt(sigma**2 + 1.0 / 12.0), rel=0.01)
    assert photo.mean() == pytest.approx(127.5, abs=0.05)
    assert np.array_equal(expose(grey, sigma, (4, 5)), photo)
    assert not np.array_equal(expose(grey, sigma, (4, 6)), photo)


def test_photo_keeps_tags_and_pixels(tmp_path: Path) -> None:
    image = np.full((120, 160, 3), (200, 120, 60), dtype=np.uint8)
    tags = PhotoTags(focal_px=250.25, f_number=8.0, iso=200)
    write_jpeg(tmp_path / "photo.jpg", image, tags)
    read = read_photo_tags(tmp_path / "photo.jpg")
    assert read.focal_px == pytest.approx(250.25, rel=1e-6)
    assert (read.make, read.model, read.f_number, read.iso) == (tags.make, tags.model, 8.0, 200)
    assert np.abs(read_photo(tmp_path / "photo.jpg").astype(int) - image).max() <= 2  # JPEG 95 of a flat picture
    write_jpeg(tmp_path / "again.jpg", image, tags)
    assert (tmp_path / "again.jpg").read_bytes() == (tmp_path / "photo.jpg").read_bytes()


def test_bad_photos_are_one_line(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"absent\.jpg"):
        read_photo(tmp_path / "absent.jpg")
    (tmp_path / "text.jpg").write_text("no image")
    with pytest.raises(InputError, match=r"text\.jpg"):
        read_photo_tags(tmp_path / "text.jpg")
    with pytest.raises(InputError, match="uint8"):
        write_jpeg(tmp_path / "x.jpg", np.zeros((4, 4)), PhotoTags(None))


@given(st.integers(1, 60))
def test_arcs_hold_all_cameras(count: int) -> None:
    directions = arc_directions(count)
    assert len(directions) == count
    assert np.abs(directions[:, 0]).max() <= 70.0 + 1e-9
    assert len(np.unique(directions, axis=0)) == count
    assert len(set(directions[:, 1])) <= 3


def test_cameras_stand_as_the_options_say() -> None:
    options = RigOptions()
    aim = np.array([0.0, 5.0, 40.0])
    views = place_cameras(24, intrinsics_for(640, 480), aim, seed=3, pose_index=2, options=options)
    distance = np.linalg.norm([view.center - aim for view in views], axis=1)
    jitter = 5.0 * options.position_jitter
    assert np.all((distance > options.distances[0] - jitter) & (distance < options.distances[1] + jitter))
    pixels = np.concatenate([project(view, aim[None])[0] for view in views])
    # The aim is jittered by 4 mm, which is 6.5 px at 620 mm; five deviations.
    assert np.abs(pixels - [320.0, 240.0]).max() < 5 * 6.5
    assert all(view.rotation[1, 1] < -0.8 for view in views)  # the picture's down is the world's down
    again = place_cameras(24, intrinsics_for(640, 480), aim, seed=3, pose_index=2)
    other = place_cameras(24, intrinsics_for(640, 480), aim, seed=3, pose_index=3)
    assert all(np.array_equal(a.translation, b.translation) for a, b in zip(views, again, strict=True))
    assert not any(np.array_equal(a.translation, b.translation) for a, b in zip(views, other, strict=True))


def test_cameras_survive_their_file(tmp_path: Path) -> None:
    views = place_cameras(3, intrinsics_for(640, 480, (-0.05, 0.01, 0.0, 0.0)), [0.0, 0.0, 0.0], seed=1)
    write_cameras(tmp_path / "cameras.json", {"pose_00": views, "pose_01": views[:1]})
    read = read_cameras(tmp_path / "cameras.json")
    assert [len(found) for found in read.values()] == [3, 1]
    for before, after in zip(views, read["pose_00"], strict=True):
        assert before.name == after.name
        assert np.array_equal(before.rotation, after.rotation)
        assert np.array_equal(before.translation, after.translation)
        assert np.array_equal(before.intrinsics.matrix, after.intrinsics.matrix)
        assert np.array_equal(before.intrinsics.distortion, after.intrinsics.distortion)
    (tmp_path / "bad.json").write_text('{"views": [{"pose": "pose_00"}]}')
    with pytest.raises(InputError, match=r"bad\.json: view 0"):
        read_cameras(tmp_path / "bad.json")


def test_landmarks_are_a_pixel_off_and_visible() -> None:
    vertices, triangles = ball()
    scene = TriangleScene(vertices, triangles)
    normals = vertices / np.linalg.norm(vertices, axis=1, keepdims=True)
    views = place_cameras(12, intrinsics_for(640, 480), [0.0, 0.0, 0.0], seed=7)
    landmarks = {f"mark_{k}": int(k) for k in range(0, len(vertices), 5)}
    clicks = click_landmarks(scene, normals, views, landmarks, seed=7, noise=1.0)
    by_name = {view.name: view for view in views}
    errors = []
    for name, photos in clicks.items():
        assert len(photos) <= 5
        for photo, place in photos.items():
            exact, _ = project(by_name[photo], vertices[[landmarks[name]]])
            errors.append(np.asarray(place) - exact[0])
            towards = by_name[photo].center - vertices[landmarks[name]]
            assert towards @ normals[landmarks[name]] > 0.0
    errors = np.array(errors)
    assert len(errors) > 1000
    assert errors.std() == pytest.approx(1.0, abs=0.05)  # 2000 numbers: standard error 0.016
    assert np.abs(errors.mean(axis=0)).max() < 0.1
    assert not clicks["mark_0"] or vertices[0, 1] > 0
    hidden = [name for name, photos in clicks.items() if not photos]
    assert hidden  # the back of the ball is seen by nobody


def test_vertices_behind_something_are_not_visible() -> None:
    vertices, triangles = ball(20.0)
    front = vertices + np.array([0.0, 0.0, 100.0])
    both = np.concatenate([vertices, front])
    scene = TriangleScene(both, np.concatenate([triangles, triangles + len(vertices)]))
    normals = np.concatenate([vertices, vertices]) / 20.0
    view = frontal_view()
    nearest = int(np.argmax(vertices[:, 2]))
    visible, _ = visible_vertices(scene, normals, view, np.array([nearest, nearest + len(vertices)]))
    assert visible.tolist() == [False, True]


@given(st.floats(0.0, 1.0), st.floats(0.2, 5.0))
def test_timings_start_at_zero_and_end_at_one(t: float, exponent: float) -> None:
    for name in ("linear", "eased", f"power:{exponent!r}"):
        law = parse_timing(name)
        assert float(law(0.0)) == 0.0
        assert float(law(1.0)) == pytest.approx(1.0, abs=1e-12)
        assert 0.0 <= float(law(t)) <= 1.0 + 1e-12
    assert float(parse_timing("linear")(t)) == t
    # the minimum-jerk law is its own mirror image
    assert float(parse_timing("eased")(t) + parse_timing("eased")(1.0 - t)) == pytest.approx(1.0, abs=1e-12)


def test_timing_values_by_hand() -> None:
    assert float(parse_timing("power:2")(0.3)) == pytest.approx(0.09)
    assert float(parse_timing("eased")(0.2)) == pytest.approx(0.08 - 0.024 + 0.00192)


@pytest.mark.parametrize("text", ["", "fast", "power", "power:x", "power:0", "power:-1", "power:nan", "linear:2"])
def test_unknown_timings_are_refused(text: str) -> None:
    with pytest.raises(InputError, match="timing"):
        parse_timing(text)
