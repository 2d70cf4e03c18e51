"""Non-rigid ICP, lifted matches and pose tracking on a bumpy ball whose deformation is known."""

import numpy as np
import pytest
from numpy.typing import NDArray

from capture_eval.cameras import Intrinsics, View, project
from capture_eval.errors import InputError, RegistrationError
from capture_eval.registration.deformation_solver import DeformationSolver, SurfaceConstraints
from capture_eval.registration.landmark_triangulation import triangulate_point
from capture_eval.registration.lifted_matches import (
    LiftingOptions,
    MaterialMatches,
    PosePhotos,
    consistent_with_prediction,
    empty_matches,
    lift_matches,
    merge_agreeing,
)
from capture_eval.registration.mesh_operators import build_mesh_operators
from capture_eval.registration.nonrigid_icp import Landmarks, NonrigidIcpOptions, fit_template
from capture_eval.registration.pose_tracking import TrackingOptions, anchor_constraints, track_pose
from capture_eval.registration.surface_correspondence import Surface, barycentric_of
from capture_eval.registration.template_visibility import (
    scan_trust,
    skin_vertices,
    sphere_directions,
    visible_direction_share,
)
from capture_eval.registration.vertex_confidence import ConfidenceOptions, vertex_areas, vertex_quality

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


def _ball(rings: int, segments: int, bumps: float = 0.0) -> tuple[Floats, Integers]:
    """A closed ball 300 units large, its radius modulated smoothly so that its points can be told apart."""
    height = np.linspace(-np.pi / 2, np.pi / 2, rings)[1:-1]
    around = 2 * np.pi * np.arange(segments) / segments
    tilt, angle = (grid.ravel() for grid in np.meshgrid(height, around, indexing="ij"))
    directions = np.stack([np.cos(tilt) * np.sin(angle), np.sin(tilt), np.cos(tilt) * np.cos(angle)], axis=1)
    directions = np.concatenate([directions, [[0.0, -1.0, 0.0], [0.0, 1.0, 0.0]]])
    radius = 150.0 * (1 + bumps * np.sin(3 * directions[:, 0]) * np.cos(4 * directions[:, 1] + directions[:, 2]))
    index = np.arange(len(tilt)).reshape(len(height), segments)
    a, b = index[:-1].ravel(), np.roll(index, -1, axis=1)[:-1].ravel()
    d, c = index[1:].ravel(), np.roll(index, -1, axis=1)[1:].ravel()
    south, north = len(tilt), len(tilt) + 1
    low, high = index[0], index[-1]
    fans = [
        np.stack([np.full(segments, south), np.roll(low, -1), low], 1),
        np.stack([np.full(segments, north), high, np.roll(high, -1)], 1),
    ]
    triangles = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1), *fans])
    return directions * radius[:, None], triangles.astype(np.int64)


def test_a_template_ends_on_the_scan_and_near_its_landmarks() -> None:
    template, triangles = _ball(20, 36)
    target, scan_triangles = _ball(40, 72, bumps=0.05)
    truth, _ = _ball(20, 36, bumps=0.05)
    marked = np.arange(5, len(template), 37)
    landmarks = Landmarks(marked, truth[marked], np.ones(len(marked)))
    skin = np.ones(len(template), dtype=np.bool_)
    fit = fit_template(template, triangles, skin, Surface(target, scan_triangles), landmarks, NonrigidIcpOptions())
    distance = np.linalg.norm(Surface(target, scan_triangles).closest(fit.vertices).points - fit.vertices, axis=1)
    # the ball starts up to 7.5 units away; what is left is the soft spring against the template's own shape
    assert np.median(distance) < 0.2
    assert np.mean(fit.matched) > 0.95
    assert np.median(np.linalg.norm(fit.vertices - truth, axis=1)) < 2.0


def test_a_scan_of_something_else_is_refused() -> None:
    template, triangles = _ball(16, 24)
    landmarks = Landmarks(np.array([0, 40, 90]), template[[0, 40, 90]], np.ones(3))
    far = Surface(template * 0.3 + 400.0, triangles)
    with pytest.raises(RegistrationError, match="check the landmarks"):
        fit_template(template, triangles, np.ones(len(template), dtype=np.bool_), far, landmarks, NonrigidIcpOptions())
    with pytest.raises(InputError, match="skin"):
        fit_template(template, triangles, np.ones(3, dtype=np.bool_), far, landmarks, NonrigidIcpOptions())


def _material(triangles: Integers, rest: Floats, pose: Floats, count: int, seed: int) -> MaterialMatches:
    random = np.random.default_rng(seed)
    triangle = random.integers(0, len(triangles), count)
    barycentric = random.dirichlet([1, 1, 1], count)
    del rest
    target = np.einsum("nk,nki->ni", barycentric, pose[triangles[triangle]])
    return MaterialMatches(triangle, barycentric, target, np.ones(count))


def _opened(vertices: Floats, degrees: float) -> Floats:
    """The lower half turned about an axis through the ball's back, with a soft border."""
    angle = np.radians(degrees) * np.clip(-vertices[:, 1] / 60.0, 0.0, 1.0)
    pivot = np.array([0.0, 0.0, -120.0])
    local = vertices - pivot
    y = np.cos(angle) * local[:, 1] - np.sin(angle) * local[:, 2]
    z = np.sin(angle) * local[:, 1] + np.cos(angle) * local[:, 2]
    return np.stack([local[:, 0], y, z], axis=1) + pivot


def test_tracking_follows_a_large_turn_from_matches_with_outliers() -> None:
    rest, triangles = _ball(30, 48, bumps=0.05)
    pose = _opened(rest, 10.0)
    matches = _material(triangles, rest, pose, 1500, seed=0)
    wrong = np.random.default_rng(1).permutation(1500)[:150]
    target = matches.target.copy()
    target[wrong] += np.random.default_rng(2).normal(size=(150, 3)) * 20
    matches = MaterialMatches(matches.triangle, matches.barycentric, target, matches.weight)
    solver = DeformationSolver(build_mesh_operators(rest, triangles))
    skin = np.ones(len(rest), dtype=np.bool_)
    options = TrackingOptions()
    tracked = track_pose(solver, skin, rest, Surface(pose, triangles), matches, empty_matches(), options)
    error = np.linalg.norm(tracked.vertices - pose, axis=1)
    # points move by up to 47 units and the border of the turn shears by 38 degrees, which the stiffness resists
    assert np.median(error) < 0.3
    assert np.quantile(error, 0.95) < 3.0
    assert 0.8 < tracked.selected_share < 0.95
    good = np.linalg.norm(tracked.matches.points(pose, triangles) - tracked.matches.target, axis=1)
    assert np.mean(good < 3.0) > 0.99


def test_turning_points_agree_with_their_prediction_and_outliers_do_not() -> None:
    rest, triangles = _ball(30, 48, bumps=0.05)
    pose, predicted = _opened(rest, 25.0), _opened(rest, 20.0)
    matches = _material(triangles, rest, pose, 800, seed=3)
    assert np.mean(consistent_with_prediction(matches, rest, predicted, triangles)) > 0.97
    shuffled = MaterialMatches(
        matches.triangle, matches.barycentric, np.roll(matches.target, 1, axis=0), matches.weight
    )
    assert np.mean(consistent_with_prediction(shuffled, rest, predicted, triangles)) < 0.05
    assert len(consistent_with_prediction(empty_matches(), rest, predicted, triangles)) == 0


def test_voxels_keep_what_agrees() -> None:
    rest, triangles = _ball(16, 24)
    pose = rest + np.array([0.0, -3.0, 1.0])
    once = _material(triangles, rest, pose, 200, seed=4)
    twice = MaterialMatches(
        np.tile(once.triangle, 2), np.tile(once.barycentric, (2, 1)), np.tile(once.target, (2, 1)), np.ones(400)
    )
    target = twice.target.copy()
    target[:50] += 10.0  # these fifty contradict their double
    merged = merge_agreeing(
        MaterialMatches(twice.triangle, twice.barycentric, target, twice.weight), rest, triangles, LiftingOptions()
    )
    np.testing.assert_allclose(merged.points(pose, triangles), merged.target, atol=1e-9)
    assert 140 <= len(merged.triangle) <= 150
    assert len(merge_agreeing(once, rest, triangles, LiftingOptions()).triangle) < 10
    assert len(merge_agreeing(empty_matches(), rest, triangles, LiftingOptions()).triangle) == 0


def _views() -> tuple[View, ...]:
    intrinsics = Intrinsics(640, 480, np.array([[800.0, 0, 320], [0, 800, 240], [0, 0, 1]]), np.zeros(4))
    views = []
    for degrees in (-15, 0, 15):
        angle = np.radians(degrees)
        axis = -np.array([np.sin(angle), 0, np.cos(angle)])
        right = np.array([np.cos(angle), 0, -np.sin(angle)])
        rotation = np.stack([-right, -np.cross(axis, right), axis])
        rotation = np.stack([np.cross(np.array([0.0, -1.0, 0.0]), axis), np.array([0.0, -1.0, 0.0]), axis])
        views.append(View(f"{degrees:+d}.jpg", intrinsics, rotation, -rotation @ (-700.0 * axis)))
    return tuple(views)


def test_pixels_are_lifted_to_material_points() -> None:
    rest, triangles = _ball(40, 72, bumps=0.05)
    pose = rest + np.array([4.0, 0.0, 0.0])
    random = np.random.default_rng(5)
    front = np.flatnonzero(rest[:, 2] > 90)[::3]
    descriptors = np.abs(random.normal(size=(len(front), 64))).astype(np.float32)
    descriptors /= np.linalg.norm(descriptors, axis=1, keepdims=True)
    views = _views()

    def photos(vertices: Floats) -> PosePhotos:
        keypoints = tuple(project(view, vertices[front])[0] for view in views)
        return PosePhotos(views, keypoints, (descriptors,) * 3)

    reference, moved = photos(rest), photos(pose)
    hits, pose_hits = reference.lift(Surface(rest, triangles)), moved.lift(Surface(pose, triangles))
    raw = lift_matches(reference, hits, moved, pose_hits, LiftingOptions(ratio=0.9))
    assert len(raw.triangle) > 2 * len(front)
    # the rays hit the mesh in single precision of 300 units
    np.testing.assert_allclose(raw.points(pose, triangles), raw.target, atol=0.01)


def test_landmarks_are_triangulated_and_a_wrong_photo_is_left_out() -> None:
    views = {view.name: view for view in _views()}
    point = np.array([12.0, -30.0, 140.0])
    pixels = {name: project(view, point[None])[0][0] for name, view in views.items()}
    found = triangulate_point(views, pixels)
    np.testing.assert_allclose(found.position, point, atol=1e-6)
    pixels["+0.jpg"] = pixels["+0.jpg"] + 60.0
    found = triangulate_point(views, pixels)
    assert "+0.jpg" not in found.photos
    np.testing.assert_allclose(found.position, point, atol=1e-6)
    with pytest.raises(RegistrationError, match="at least 2"):
        triangulate_point(views, {"+0.jpg": pixels["+0.jpg"]})
    with pytest.raises(RegistrationError, match="disagree"):
        triangulate_point(views, {"-15.jpg": pixels["-15.jpg"], "+15.jpg": pixels["+15.jpg"] + [0.0, 90.0]})


def test_the_inside_of_a_ball_is_no_skin() -> None:
    outer, triangles = _ball(16, 24)
    both = np.concatenate([outer, 0.5 * outer])
    faces = np.concatenate([triangles, triangles + len(outer)])
    skin = skin_vertices(both, faces)
    assert skin[: len(outer)].all()
    assert not skin[len(outer) :].any()
    np.testing.assert_allclose(sphere_directions(500).mean(axis=0), 0.0, atol=5e-3)


def test_a_scan_is_believed_on_open_skin_and_not_in_a_pit() -> None:
    vertices, triangles = _ball(40, 72)
    front = vertices[:, 2] / 150.0 > np.cos(0.35)
    pitted = vertices.copy()
    pitted[front, 2] -= 120.0  # a pit 120 deep and 103 wide
    trust = scan_trust(visible_direction_share(pitted, triangles))
    bottom = vertices[:, 2] / 150.0 > np.cos(0.2)
    away = vertices[:, 2] < 0.0
    # A convex point is seen from half of all directions, the bottom of the pit from less than a tenth.
    assert np.all(trust[bottom] == 0.0)
    assert np.all(trust[away] == 1.0)
    np.testing.assert_allclose(scan_trust(np.array([0.0, 0.18, 0.265, 0.35, 0.5])), [0, 0, 0.5, 1, 1], atol=1e-12)


def test_skin_that_no_scan_is_believed_at_keeps_the_shape_of_the_template() -> None:
    template, triangles = _ball(20, 36)
    target, scan_triangles = _ball(40, 72)
    target = target * 1.04
    crust = target[:, 2] > 130.0
    target[crust, 2] += 6.0  # what a scan puts over a nostril
    marked = np.flatnonzero(template[:, 2] < 100.0)[::29]
    landmarks = Landmarks(marked, 1.04 * template[marked], np.ones(len(marked)))
    skin = np.ones(len(template), dtype=np.bool_)
    covered = template[:, 2] > 125.0
    scan, options = Surface(target, scan_triangles), NonrigidIcpOptions()
    believed = fit_template(template, triangles, skin, scan, landmarks, options).vertices
    doubted = fit_template(template, triangles, skin, scan, landmarks, options, np.where(covered, 0.0, 1.0)).vertices
    centre = np.argmax(template[:, 2])
    assert np.linalg.norm(believed[centre]) > 156.0 + 4.0
    # The shape carries on over a cap of radius 0.56: half a unit of 156 is what the stiffness lets go.
    assert np.linalg.norm(doubted[centre]) < 156.0 + 1.0


def test_anchors_move_unmeasured_skin_with_its_neighbours() -> None:
    rest, triangles = _ball(16, 24)
    measured = rest[:, 2] > 0
    moved = rest + np.array([1.0, 2.0, 3.0])
    skin = np.ones(len(rest), dtype=np.bool_)
    half = np.where(measured[:, None], moved, rest)
    anchors = anchor_constraints(build_mesh_operators(rest, triangles), half, skin, measured, 0.1)
    np.testing.assert_allclose(anchors.target, moved[~measured], atol=1e-9)  # a constant is harmonic: rounding only


def test_anchors_do_not_jump_from_one_lip_to_the_other() -> None:
    lip, triangles = _ball(12, 16)
    rest = np.concatenate([lip, lip + np.array([0.0, 301.0, 0.0]), lip + np.array([0.0, 0.0, 301.0])])
    faces = np.concatenate([triangles + part * len(lip) for part in range(3)])
    upper = np.repeat([False, True, False], len(lip))
    lower = np.repeat([True, False, False], len(lip))
    moved = np.where(lower[:, None], rest - [0.0, 40.0, 0.0], rest)
    measured = lower | (upper & (rest[:, 1] > 400.0))
    skin = np.ones(len(rest), dtype=np.bool_)
    anchors = anchor_constraints(build_mesh_operators(rest, faces), moved, skin, measured, 0.1)
    followers = anchors.corners[:, 0]
    # What the upper lip does not show stays with the upper lip; the third part touches nothing measured: no row.
    np.testing.assert_array_equal(followers, np.flatnonzero(upper & ~measured))
    np.testing.assert_allclose(anchors.target, rest[followers], atol=1e-9)


def test_borders_of_a_surface_have_no_support_and_rays_may_miss() -> None:
    x, y = np.meshgrid(np.arange(6.0), np.arange(6.0))
    vertices = np.stack([x.ravel(), y.ravel(), np.zeros(36)], axis=1)
    index = np.arange(36).reshape(6, 6)
    a, b, c, d = index[:-1, :-1].ravel(), index[:-1, 1:].ravel(), index[1:, 1:].ravel(), index[1:, :-1].ravel()
    triangles = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]).astype(np.int64)
    surface = Surface(vertices, triangles, np.full(36, 0.8))
    found = surface.closest(np.array([[2.5, 2.4, 1.0], [0.2, 0.1, 0.5]]))
    np.testing.assert_allclose(found.points, [[2.5, 2.4, 0], [0.2, 0.1, 0]], atol=1e-6)
    np.testing.assert_allclose(found.support, [0.8, 0.0], atol=1e-12)
    rays = surface.cast(np.array([2.5, 2.5, 4.0]), np.array([[0.0, 0, -1], [0.0, 0, 1]]))
    np.testing.assert_array_equal(rays.hit, [True, False])
    weights = barycentric_of(np.array([[0.25, 0.5, 9.0]]), np.array([[[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]]))
    np.testing.assert_allclose(weights, [[0.25, 0.25, 0.5]])


def test_confidence_needs_measurements_photos_and_small_residuals() -> None:
    vertices, triangles = _ball(16, 24)
    assert vertex_areas(vertices, triangles).sum() == pytest.approx(4 * np.pi * 150**2, rel=0.03)
    skin = np.ones(len(vertices), dtype=np.bool_)
    photos = np.full(len(vertices), 5)
    photos[:10] = 2
    centre = np.full((len(triangles), 3), 1 / 3)
    normal = vertices[triangles].mean(axis=1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    shift = np.where(normal[:, 2] > 0, 0.0, 3.0)[:, None]
    target = vertices[triangles].mean(axis=1) + shift * normal
    area = np.linalg.norm(
        np.cross(
            vertices[triangles[:, 1]] - vertices[triangles[:, 0]], vertices[triangles[:, 2]] - vertices[triangles[:, 0]]
        ),
        axis=1,
    )
    rows = SurfaceConstraints(triangles, centre, target, normal, area)
    quality = vertex_quality(vertices, triangles, None, rows, None, photos, skin, ConfidenceOptions())
    front, back = vertices[:, 2] > 40, vertices[:, 2] < -40
    assert np.all(quality.confidence[:10] == 0)
    assert quality.confidence[front & quality.seen].min() > 0.9
    assert quality.confidence[back].max() < 0.05
    np.testing.assert_allclose(quality.residual[back], 3.0, atol=1e-9)
