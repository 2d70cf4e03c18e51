"""PatchMatch stereo, view selection, plain surroundings and fusion on scenes whose depth is known exactly."""

from dataclasses import replace

import numpy as np
import pytest
import textured_ball as ball
from hypothesis import given, settings
from hypothesis import strategies as st

from capture_eval.errors import InputError
from capture_eval.reconstruction.depth_filtering import (
    KINSHIP,
    DepthMap,
    FilterOptions,
    make_consistent,
    point_deviation,
    points_of_depth,
)
from capture_eval.reconstruction.foreground_mask import textured_region
from capture_eval.reconstruction.image_pyramid import Pyramid, StereoView, build_pyramid, pack_texels
from capture_eval.reconstruction.patch_match import (
    PatchMatchOptions,
    disparity_per_inverse_depth,
    match_view,
    plane_maps,
    plane_normals,
    sampling_pattern,
)
from capture_eval.reconstruction.point_fusion import CellFusion, PointCloud, average_in_cells, clearly_uncertain
from capture_eval.reconstruction.view_selection import choose_sources, depth_range, pair_scores

WIDTH, HEIGHT, FOCAL = 160, 120, 300.0
DISTANCE = 400.0
TILT = np.radians(40.0)
NORMAL = np.array([np.sin(TILT), 0.0, -np.cos(TILT)])  # of the plane through the origin, towards the cameras


def plane_view(degrees: float, nod: float, mask: np.ndarray | None = None) -> StereoView:
    """A textured plane through the origin, tilted by 40 degrees, from a camera on an arc; nine rays a pixel."""
    turn, lift = np.radians([degrees, nod])
    centre = DISTANCE * np.array([np.sin(turn) * np.cos(lift), np.sin(lift), -np.cos(turn) * np.cos(lift)])
    forward = -centre / DISTANCE
    right = np.cross([0.0, 1.0, 0.0], forward)
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    matrix = np.array([[FOCAL, 0.0, WIDTH / 2], [0.0, FOCAL, HEIGHT / 2], [0.0, 0.0, 1.0]])
    grey = np.zeros((HEIGHT, WIDTH))
    for du in (1 / 6, 1 / 2, 5 / 6):
        for dv in (1 / 6, 1 / 2, 5 / 6):
            u, v = np.meshgrid(np.arange(WIDTH) + du, np.arange(HEIGHT) + dv)
            rays = np.stack([(u - WIDTH / 2) / FOCAL, (v - HEIGHT / 2) / FOCAL, np.ones_like(u)], -1) @ rotation
            points = centre - (centre @ NORMAL) / (rays @ NORMAL)[..., None] * rays
            grey += ball.texture(points.reshape(-1, 3), 5.0).reshape(grey.shape) / 9.0
    return StereoView(f"{degrees}", np.rint(grey).astype(np.float32), matrix, rotation, -rotation @ centre, mask)


def plane_depth(view: StereoView) -> np.ndarray:
    u, v = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
    rays = np.stack([(u - WIDTH / 2) / FOCAL, (v - HEIGHT / 2) / FOCAL, np.ones_like(u)], -1)
    normal = view.rotation @ NORMAL
    return (normal @ view.translation) / (rays @ normal)


ANGLES = ((0.0, 0.0), (-14.0, 0.0), (14.0, 0.0), (0.0, 14.0), (7.0, -12.0))


@pytest.fixture(scope="module")
def pyramids() -> list[Pyramid]:
    return [build_pyramid(plane_view(*angles), 2) for angles in ANGLES]


@pytest.fixture(scope="module")
def estimate(pyramids):
    return match_view(pyramids[0], pyramids[1:], (300.0, 600.0), PatchMatchOptions())


def inner(array: np.ndarray) -> np.ndarray:
    """Without the rim, where the plane leaves some of the photos."""
    return array[15:-15, 30:-30]


def test_a_slanted_plane_is_found_to_a_small_part_of_a_pixel(pyramids, estimate) -> None:
    view = pyramids[0].view
    truth = plane_depth(view)
    found = inner(estimate.depth) > 0
    assert found.mean() > 0.98
    error = np.abs(1.0 / inner(estimate.depth)[found] - 1.0 / inner(truth)[found])
    # pixels moved in the source 14 degrees aside: f * baseline per inverse depth
    disparity = error * FOCAL * DISTANCE * np.sin(np.radians(14.0))
    # noise-free photos rounded to whole grey levels: sampling errors of bilinear cells are a few hundredths
    assert np.median(disparity) < 0.04
    assert np.percentile(disparity, 95) < 0.1


def test_normals_of_the_plane(pyramids, estimate) -> None:
    normal = pyramids[0].view.rotation @ NORMAL
    found = inner(estimate.depth) > 0
    angles = np.degrees(np.arccos(np.clip(inner(estimate.normal)[found] @ normal, -1, 1)))
    # a tilt of 3 degrees moves the patch's rim, 4 pixels away, by about 0.02 px: as little as can be seen
    assert np.median(angles) < 3.0
    np.testing.assert_allclose(np.linalg.norm(inner(estimate.normal)[found], axis=1), 1.0, atol=1e-5)


def test_deviation_says_how_large_errors_are(pyramids, estimate) -> None:
    found = inner(estimate.depth) > 0
    error = np.abs(inner(estimate.depth) - inner(plane_depth(pyramids[0].view)))[found]
    ratio = error / inner(estimate.deviation)[found]
    # the right order of magnitude is what averaging by worth needs
    assert 0.1 < np.median(ratio) < 3.0


def test_threads_and_repeats_change_no_bit(pyramids, estimate) -> None:
    other = match_view(pyramids[0], pyramids[1:], (300.0, 600.0), PatchMatchOptions(threads=3))
    assert other.depth.tobytes() == estimate.depth.tobytes()
    assert other.normal.tobytes() == estimate.normal.tobytes()


def test_another_seed_finds_the_same_plane_by_another_way(pyramids, estimate) -> None:
    other = match_view(pyramids[0], pyramids[1:], (300.0, 600.0), PatchMatchOptions(seed=5))
    both = (inner(other.depth) > 0) & (inner(estimate.depth) > 0)
    assert other.depth.tobytes() != estimate.depth.tobytes()
    assert np.median(np.abs(inner(other.depth)[both] / inner(estimate.depth)[both] - 1.0)) < 5e-4


def test_masked_pixels_stay_empty(pyramids) -> None:
    mask = np.zeros((HEIGHT, WIDTH), np.bool_)
    mask[30:90, 40:120] = True
    masked = build_pyramid(plane_view(*ANGLES[0], mask=mask), 2)
    found = match_view(masked, pyramids[1:], (300.0, 600.0), PatchMatchOptions(fine_passes=1))
    assert np.all(found.depth[~mask] == 0)
    assert np.mean(found.depth[mask] > 0) > 0.95


def test_one_source_is_enough(pyramids) -> None:
    found = match_view(pyramids[0], pyramids[1:2], (300.0, 600.0), PatchMatchOptions())
    truth = plane_depth(pyramids[0].view)
    good = inner(found.depth) > 0
    assert np.median(np.abs(inner(found.depth)[good] / inner(truth)[good] - 1)) < 2e-3


@pytest.mark.parametrize(
    ("sources", "span", "words"),
    [(0, (1.0, 2.0), "0 source photos"), (1, (2.0, 1.0), "depth range"), (1, (0.0, 1.0), "depth range")],
)
def test_bad_searches_are_refused(pyramids, sources, span, words) -> None:
    with pytest.raises(InputError, match=words):
        match_view(pyramids[0], pyramids[1 : 1 + sources], span, PatchMatchOptions())


def test_a_mask_of_another_size_is_refused() -> None:
    with pytest.raises(InputError, match="differ in size"):
        plane_view(0.0, 0.0, mask=np.ones((3, 4), np.bool_))


def test_maps_take_a_pixel_to_where_the_source_sees_its_point(pyramids) -> None:
    reference, source = pyramids[0], pyramids[1]
    maps = plane_maps(reference, source, 0)
    depth = 390.0
    pixel = np.array([50.0, 70.0, 1.0])
    matrix = reference.view.matrix
    local = np.linalg.inv(matrix) @ (pixel + np.array([0.5, 0.5, 0.0])) * depth
    world = reference.view.rotation.T @ (local - reference.view.translation)
    seen = source.view.matrix @ (source.view.rotation @ world + source.view.translation)
    mapped = maps[:9].reshape(3, 3) @ pixel + maps[9:] / depth
    np.testing.assert_allclose(mapped[:2] / mapped[2], seen[:2] / seen[2] - 0.5, atol=1e-9)
    step = 1e-6
    moved = maps[:9].reshape(3, 3) @ pixel + maps[9:] * (1 / depth + step)
    speed = np.linalg.norm(moved[:2] / moved[2] - mapped[:2] / mapped[2]) / step
    np.testing.assert_allclose(disparity_per_inverse_depth(maps[None], pixel[:2], 1 / depth), speed, rtol=1e-3)


def test_plane_normals_of_a_plane_written_by_hand() -> None:
    matrix = np.array([[FOCAL, 0.0, 80.0], [0.0, FOCAL, 60.0], [0.0, 0.0, 1.0]])
    normal, offset = np.array([0.3, -0.2, -1.0]), -400.0  # n . X = offset
    u, v = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    rays = np.stack([(u - 80.0) / FOCAL, (v - 60.0) / FOCAL, np.ones_like(u, dtype=float)], -1)
    inverse = rays @ normal / offset
    slopes = np.broadcast_to(normal[:2] / FOCAL / offset, (HEIGHT, WIDTH, 2))
    planes = np.concatenate([slopes, inverse[..., None]], axis=2)
    expected = np.broadcast_to(normal / np.linalg.norm(normal), planes.shape)
    np.testing.assert_allclose(plane_normals(planes, matrix), expected, atol=1e-9)


def test_packed_cells_hold_the_four_corners() -> None:
    grey = np.arange(12, dtype=np.float32).reshape(3, 4)
    packed = pack_texels(grey)
    assert packed[1, 2] == 6 | 7 << 8 | 10 << 16 | 11 << 24
    assert packed[2, 3] == 11 | 11 << 8 | 11 << 16 | 11 << 24


def test_pyramid_keeps_the_mean_and_the_rays() -> None:
    view = plane_view(0.0, 0.0)
    pyramid = build_pyramid(view, 2)
    np.testing.assert_allclose(pyramid.levels[1].grey.mean(), view.grey.mean(), rtol=1e-5)
    # the middle of a coarse pixel is the corner of its four fine ones: index 3 <-> 6.5
    coarse = np.linalg.inv(pyramid.levels[1].matrix) @ [3.0, 5.0, 1.0]
    np.testing.assert_allclose(coarse, np.linalg.inv(pyramid.levels[0].matrix) @ [6.5, 10.5, 1.0], atol=1e-12)


def test_plain_backdrop_is_left_out_up_to_the_outline() -> None:
    view = ball.views()[2]
    region = textured_region(ball.photograph(view, 0), 4)
    inside = ball.true_depth(view) > 0
    assert np.mean(region[inside]) > 0.995
    # only the pixels that show both, one ring, may stay
    assert np.count_nonzero(region & ~inside) < 1.5 * np.count_nonzero(inside & ~_shrunk(inside))


def _shrunk(inside: np.ndarray) -> np.ndarray:
    from scipy.ndimage import binary_erosion

    return binary_erosion(inside)


def test_a_photo_without_plain_places_loses_nothing() -> None:
    noise = np.random.default_rng(0).integers(0, 255, (60, 80, 3)).astype(np.uint8)
    assert textured_region(noise, 4).all()


@pytest.mark.parametrize("window", range(1, 9))
def test_the_checked_reach_covers_all_samples(window: int) -> None:
    pattern = sampling_pattern(window, 100, PatchMatchOptions(window=window))
    # the kernel reads without bounds inside this radius
    assert pattern.radius >= max(np.abs(pattern.dx).max(), np.abs(pattern.dy).max())
    assert len(np.unique(np.stack([pattern.dx, pattern.dy]), axis=1).T) == 32


def ball_maps(names: tuple[int, ...]) -> list[DepthMap]:
    maps = []
    for index in names:
        view = ball.views()[index]
        depth = ball.true_depth(view).astype(np.float32)
        weight = (depth > 0).astype(np.float32)
        frame = DepthMap(
            depth, np.zeros((*depth.shape, 3), np.float32), weight, view.intrinsics.matrix, view.rotation,
            view.translation,
        )  # fmt: skip
        rows, columns = np.nonzero(depth > 0)
        normal = np.zeros((*depth.shape, 3), np.float32)
        points, _ = points_of_depth(depth, normal, frame)
        normal[rows, columns] = (points / ball.RADIUS) @ view.rotation.T
        maps.append(DepthMap(depth, normal, weight, view.intrinsics.matrix, view.rotation, view.translation))
    return maps


def test_exact_depth_maps_agree_and_stay() -> None:
    maps = ball_maps((2, 1, 3))
    found = make_consistent(maps[0], maps[1:], FilterOptions())
    kept = found.depth > 0
    facing = maps[0].normal[..., 2] < -0.6
    assert kept[facing].mean() > 0.98
    # tangent planes of the others, at most a pixel (0.9 mm) aside on a ball of radius 50: sagitta 0.01 mm
    np.testing.assert_allclose(found.depth[kept & facing], maps[0].depth[kept & facing], atol=0.05)
    points, normals = points_of_depth(found.depth, found.normal, maps[0])
    assert np.median(np.abs(np.linalg.norm(points, axis=1) - ball.RADIUS)) < 0.02
    assert np.median(np.sum(points * normals, axis=1)) > 0.99 * ball.RADIUS


def test_a_depth_nobody_confirms_goes() -> None:
    maps = ball_maps((2, 1, 3))
    wrong = DepthMap(
        maps[0].depth * np.float32(0.97), maps[0].normal, maps[0].weight, maps[0].matrix, maps[0].rotation,
        maps[0].translation,
    )  # fmt: skip
    assert np.count_nonzero(make_consistent(wrong, maps[1:], FilterOptions()).depth) < 0.01 * np.count_nonzero(
        wrong.depth
    )


def test_the_spread_of_the_maps_tells_how_sure_a_depth_is() -> None:
    generator = np.random.default_rng(0)
    noise = 0.2
    maps = [
        replace(frame, depth=np.where(frame.depth > 0, frame.depth + generator.normal(0, noise, frame.depth.shape), 0))
        for frame in ball_maps((2, 0, 1, 3, 4))
    ]
    maps = [replace(frame, depth=frame.depth.astype(np.float32)) for frame in maps]
    found = make_consistent(maps[0], maps[1:], FilterOptions())
    well_seen = (found.supporters == 4) & (maps[0].normal[..., 2] < -0.8)
    assert np.count_nonzero(well_seen) > 500
    stated = float(np.sqrt(np.mean(found.deviation[well_seen] ** 2)))
    # the noise here is independent, so the allowance for what maps have in common is all that is above it; the mean of
    # five variances from five maps each over 500 pixels varies by less than 5 %, oblique rays add some of their own
    assert 0.9 < stated / (KINSHIP * noise / np.sqrt(5)) < 1.25
    along_normal = point_deviation(found.depth, found.normal, found.deviation, maps[0].matrix)
    assert along_normal.shape == (np.count_nonzero(found.depth),)
    assert np.all(along_normal <= found.deviation[found.depth > 0] * 1.2)  # rays lean by less than 30 degrees


def test_clouds_may_come_in_parts() -> None:
    generator = np.random.default_rng(0)
    points = generator.uniform(0, 10, (400, 3))
    normals = points / np.linalg.norm(points, axis=1, keepdims=True)
    weight, deviation = generator.uniform(0.5, 2.0, 400), generator.uniform(0.1, 0.2, 400)
    cloud = PointCloud(points, normals, weight, np.full(400, 3.0), deviation)
    whole, parts = (CellFusion(points.min(axis=0), points.max(axis=0), 1.0) for _ in range(2))
    whole.add(cloud)
    for chosen in np.array_split(np.arange(400), 7):
        parts.add(PointCloud(points[chosen], normals[chosen], weight[chosen], np.full(len(chosen), 3.0),
                             deviation[chosen]))  # fmt: skip
    np.testing.assert_allclose(parts.cloud().table(), whole.cloud().table(), rtol=1e-12)
    assert whole.cloud().deviation.min() >= deviation.min()


def test_cells_grow_where_photos_are_far() -> None:
    near = np.random.default_rng(0).uniform(0, 1, (4000, 3))
    points = np.concatenate([near, near * 8.0 + 100.0])
    widths = np.concatenate([np.full(4000, 0.25), np.full(4000, 2.0)])
    fusion = CellFusion(points.min(axis=0), points.max(axis=0), 0.5)
    fusion.add(PointCloud(points, np.ones_like(points), np.ones(8000), np.ones(8000)), widths)
    found = fusion.cloud().points
    # both are the same cube in units of their pixels, so as many cells each, give or take those cut by the grid's start
    close, far = np.count_nonzero(found[:, 0] < 50), np.count_nonzero(found[:, 0] > 50)
    assert 64 <= close <= 125
    assert 64 <= far <= 125


def test_points_are_uncertain_by_the_measure_of_their_photos() -> None:
    deviation = np.array([1.0, 1.1, 0.9, 6.0, 16.0, 17.0, 95.0])
    edges = np.array([1.0, 1.0, 1.0, 1.0, 16.0, 16.0, 16.0])  # the last three are seen from far away
    assert clearly_uncertain(deviation, edges, 5.0).tolist() == [False, False, False, True, False, False, True]


@settings(max_examples=25, deadline=None)
@given(st.integers(1, 200), st.floats(0.05, 3.0), st.integers(0, 2**31))
def test_cells_keep_worth_and_centre(count: int, spacing: float, seed: int) -> None:
    generator = np.random.default_rng(seed)
    points, weight = generator.normal(size=(count, 3)), generator.uniform(0.1, 3.0, count)
    normals = points / np.linalg.norm(points, axis=1, keepdims=True)
    cloud = average_in_cells(PointCloud(points, normals, weight, np.ones(count)), spacing)
    np.testing.assert_allclose(cloud.weight.sum(), weight.sum())
    np.testing.assert_allclose(cloud.weight @ cloud.points, weight @ points, atol=1e-9 * count + 1e-9)
    cells = np.floor((points - points.min(axis=0)) / spacing)
    assert len(cloud.points) == len(np.unique(cells, axis=0))
    np.testing.assert_allclose(cloud.supporters, 1.0)


def test_partners_share_points_under_a_good_angle() -> None:
    centers = np.array([[0.0, 0, 0], [2.0, 0, 0], [0.2, 0, 0], [50.0, 0, 0]])
    points = np.tile([[1.0, 0.0, 10.0]], (10, 1)) + np.random.default_rng(0).normal(0, 0.1, (10, 3))
    visible = [np.arange(10)] * 3 + [np.arange(0)]
    scores = pair_scores(centers, points, visible)
    np.testing.assert_array_equal(scores, scores.T)
    partners = choose_sources(scores, 5)
    # 11 degrees to the second camera, 1 degree to the third; the last shares nothing
    assert partners[0].tolist() == [1, 2]
    assert partners[3].tolist() == []


def test_depth_range_holds_the_points_and_a_margin() -> None:
    near, far = depth_range(np.array([-5.0, 10.0, 12.0, 20.0]), "a.jpg")
    assert 7.0 < near < 10.0
    assert 20.0 < far < 40.0
    with pytest.raises(InputError, match=r"a\.jpg: no sparse point"):
        depth_range(np.array([-1.0]), "a.jpg")
