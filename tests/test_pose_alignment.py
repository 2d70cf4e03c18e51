"""All poses in one frame: solved together, by markers and by a rig, with known truth; never a mirror image."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from capture_eval.cameras import Intrinsics, View, project
from capture_eval.errors import InputError, RegistrationError
from capture_eval.files.marker_files import read_markers
from capture_eval.registration.cross_pose_matching import ObservedPoints
from capture_eval.registration.joint_similarity import PointLink, solve_jointly
from capture_eval.registration.marker_alignment import PlacedMarkers, align_by_markers
from capture_eval.registration.marker_detection import detect_tags
from capture_eval.registration.pose_alignment import AlignmentOptions, align_all_poses
from capture_eval.registration.rig_alignment import PhotographedPoints, align_by_rig, place_points
from capture_eval.similarity import Similarity
from capture_eval.stages.align import AlignOptions, chosen_method

Floats = NDArray[np.float64]
OPTIONS = AlignmentOptions(trials=256)


def _rotation(random: np.random.Generator) -> Floats:
    rotation = np.linalg.qr(random.normal(size=(3, 3)))[0]
    return rotation * np.linalg.det(rotation)


def _frames(random: np.random.Generator, count: int) -> list[Similarity]:
    """True `neutral_from_pose`; the first is the identity."""
    drawn = [Similarity(random.uniform(0.5, 2), _rotation(random), random.normal(size=3)) for _ in range(count - 1)]
    return [Similarity.identity(), *drawn]


def _slightly_off(frame: Similarity, random: np.random.Generator) -> Similarity:
    turn = np.linalg.qr(np.eye(3) + 0.01 * random.normal(size=(3, 3)))[0]
    turn = turn * np.sign(np.diag(turn))  # near the identity, not its mirror image
    return Similarity(1.01, turn, 0.01 * random.normal(size=3)).compose(frame)


def test_exact_links_give_the_exact_frames_of_a_chain_and_of_a_ring() -> None:
    random = np.random.default_rng(1)
    true = _frames(random, 5)
    links = []
    for first, second in ((0, 1), (1, 2), (2, 3), (3, 4), (0, 4)):
        points = random.normal(size=(30, 3))
        links.append(
            PointLink(first, second, true[first].inverse().apply(points), true[second].inverse().apply(points))
        )
    wrong = PointLink(0, 3, random.normal(size=(10, 3)) + 9.0, random.normal(size=(10, 3)))
    start = [true[0], *(_slightly_off(frame, random) for frame in true[1:]), None]
    found = solve_jointly([*links, wrong], start, limit=0.5)
    for frame, truth in zip(found[:5], true, strict=True):
        assert frame is not None
        assert frame.scale == pytest.approx(truth.scale, abs=1e-9)  # exact data: rounding only
        np.testing.assert_allclose(frame.rotation, truth.rotation, atol=1e-9)
        assert np.linalg.det(frame.rotation) == pytest.approx(1.0)
    assert found[5] is None


def test_a_ring_of_noisy_links_is_better_than_its_chain() -> None:
    random = np.random.default_rng(2)
    poses, noise = 8, 0.01
    true = _frames(random, poses)
    chain = []
    for first in range(poses):
        second = (first + 1) % poses
        points = random.normal(size=(20, 3))
        noisy = points + noise * random.normal(size=points.shape)
        chain.append(PointLink(first, second, true[first].inverse().apply(points), true[second].inverse().apply(noisy)))
    probe = random.normal(size=(50, 3))

    def worst(links: list[PointLink]) -> float:
        frames = solve_jointly(links, [true[0], *(_slightly_off(frame, random) for frame in true[1:])], limit=0.5)
        errors = []
        for frame, truth in zip(frames, true, strict=True):
            assert frame is not None
            errors.append(np.linalg.norm(frame.apply(truth.inverse().apply(probe)) - probe, axis=1).mean())
        return max(errors)

    # errors of a chain add up to its end; the closing link halves the way
    assert worst(chain) < 0.9 * worst(chain[:-1])


def test_wrong_links_are_refused() -> None:
    points = np.zeros((3, 3))
    with pytest.raises(InputError, match="linked with itself"):
        PointLink(1, 1, points, points)
    with pytest.raises(InputError, match="point sets"):
        PointLink(0, 1, points, np.zeros((2, 3)))
    with pytest.raises(InputError, match="limit"):
        solve_jointly([], [Similarity.identity()], 0.0)
    with pytest.raises(InputError, match="no place"):
        solve_jointly([], [None], 1.0)


def test_points_off_the_rigid_region_help_where_they_did_not_move_and_only_there() -> None:
    random = np.random.default_rng(3)
    points = random.uniform(-1, 1, (600, 3))
    names = np.abs(random.normal(size=(600, 32))).astype(np.float32)
    names /= np.linalg.norm(names, axis=1, keepdims=True)
    skull, jaw = points[:, 1] > 0.6, points[:, 1] < -0.2
    moved = points + 0.001 * random.normal(size=points.shape)
    moved[jaw] += [0.0, -0.05, 0.03]
    true = Similarity(1.7, _rotation(random), np.array([1.0, 2.0, 3.0]))

    def observed(places: Floats) -> ObservedPoints:
        return ObservedPoints(places, names, np.arange(600), footprint=0.005)

    result = align_all_poses([observed(points), observed(true.inverse().apply(moved))], OPTIONS, skull)[1]
    link = result.neutral_from_pose
    assert link is not None
    assert result.inliers > np.count_nonzero(skull) + 100
    error = np.linalg.norm(link.apply(true.inverse().apply(points)) - points, axis=1)
    # below the noise of a single point (.001); the jaw, 58 times as far off, would show by hundredths
    assert error.max() < 0.001


def _markers(points: Floats, frame: Similarity, keep: NDArray[np.int64] | None = None) -> PlacedMarkers:
    rows = np.arange(len(points)) if keep is None else keep
    return PlacedMarkers(tuple(f"m{row}" for row in rows), frame.inverse().apply(points)[rows])


def test_markers_align_all_poses_even_through_each_other_and_with_one_that_came_off() -> None:
    random = np.random.default_rng(4)
    points = random.normal(size=(10, 3))
    true = _frames(random, 4)
    loose = points.copy()
    loose[2] += [0.5, 0.0, 0.0]
    poses = [
        _markers(points, true[0], np.arange(6)),
        _markers(loose, true[1]),
        _markers(points, true[2], np.arange(5, 10)),  # one marker in common with the neutral
        None,
    ]
    results = align_by_markers(poses, 0.005, OPTIONS)
    for result, truth in zip(results[:3], true, strict=False):
        assert result.neutral_from_pose is not None
        np.testing.assert_allclose(result.neutral_from_pose.apply(truth.inverse().apply(points)), points, atol=1e-8)
    assert [result.through for result in results] == ["neutral", "neutral", "pose 1", ""]
    assert results[1].inliers < results[1].matches
    assert results[3].reason == "no reconstruction"


def test_mirrored_markers_and_markers_on_a_line_are_failed_rows() -> None:
    random = np.random.default_rng(5)
    points = random.normal(size=(8, 3))
    neutral = _markers(points, Similarity.identity())
    mirrored = PlacedMarkers(neutral.names, points * [-1.0, 1.0, 1.0])
    line = np.outer(np.linspace(0, 1, 8), [1.0, 2.0, 3.0])
    row = PlacedMarkers(neutral.names, line)
    few = PlacedMarkers(neutral.names[:2], points[:2])
    results = align_by_markers([neutral, mirrored, row, few], 0.005, OPTIONS)
    assert [result.neutral_from_pose for result in results[1:]] == [None, None, None]
    assert "line" in results[2].reason
    assert "2 markers in common" in results[3].reason
    with pytest.raises(RegistrationError, match="at least 3"):
        align_by_markers([few, neutral], 0.005, OPTIONS)


def _rig(count: int = 8) -> dict[str, View]:
    intrinsics = Intrinsics(640, 480, np.array([[900.0, 0, 320], [0, 900, 240], [0, 0, 1]]), np.zeros(4))
    views = {}
    for number, angle in enumerate(np.radians(np.linspace(-60, 60, count))):
        rotation = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
        name = f"view_{number:02d}.jpg"
        views[name] = View(name, intrinsics, rotation, np.array([0.0, 0.0, 6.0]))
    return views


def test_a_rig_gives_the_frame_and_says_when_it_moved() -> None:
    random = np.random.default_rng(6)
    views = _rig()
    points = random.uniform(-1, 1, (200, 3))
    true = Similarity(0.8, _rotation(random), np.array([3.0, 1.0, 0.0]))
    noise = {name: 0.3 * random.normal(size=(200, 2)) for name in views}
    pixels = {name: project(view, points)[0] + noise[name] for name, view in views.items()}
    rows = {name: np.arange(200) for name in views}
    seen = PhotographedPoints(true.inverse().apply(points), pixels, rows)
    places, placed = place_points(views, seen)
    assert placed.all()
    # a third of a pixel at 6/900 a pixel, eight rays
    assert np.median(np.linalg.norm(places - points, axis=1)) < 0.002
    result = align_by_rig(views, seen, 6.0 / 900.0, OPTIONS)
    assert result.neutral_from_pose is not None
    assert result.through == "rig"
    # two hundred points: a tenth of the error of one
    error = np.linalg.norm(result.neutral_from_pose.apply(seen.points) - points, axis=1)
    assert error.max() < 0.0006
    shuffled = dict(zip(views, list(pixels.values())[::-1], strict=True))
    moved = align_by_rig(views, PhotographedPoints(seen.points, shuffled, rows), 6.0 / 900.0, OPTIONS)
    assert moved.neutral_from_pose is None
    assert "rig moved" in moved.reason
    other_names = PhotographedPoints(seen.points, {"a.jpg": pixels["view_00.jpg"]}, {"a.jpg": rows["view_00.jpg"]})
    assert "0 photos carry the name" in align_by_rig(views, other_names, 0.01, OPTIONS).reason


def test_the_surest_of_what_is_given_is_taken(tmp_path: Path) -> None:
    markers = tmp_path / "markers.yaml"
    assert chosen_method(AlignOptions()) == "matches"
    assert chosen_method(AlignOptions(fixed_rig=True)) == "rig"
    assert chosen_method(AlignOptions(fixed_rig=True, markers=markers)) == "markers"
    assert chosen_method(AlignOptions(fixed_rig=True, markers=markers, shared_frame=True)) == "shared frame"
    assert chosen_method(AlignOptions(fixed_rig=True, method="matches")) == "matches"
    with pytest.raises(InputError, match="needs a marker file"):
        chosen_method(AlignOptions(method="markers"))


def test_tags_are_found_where_they_were_drawn() -> None:
    family = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    tag = cv2.aruco.generateImageMarker(family, 17, 80)
    picture = np.full((240, 320), 255, dtype=np.uint8)
    picture[60:140, 100:180] = tag
    blurred = cv2.GaussianBlur(picture, (0, 0), 0.7)
    found = detect_tags(np.repeat(blurred[:, :, None], 3, axis=2), "APRILTAG_36h11")
    expected = {"17:0": (100, 60), "17:1": (180, 60), "17:2": (180, 140), "17:3": (100, 140)}
    assert set(found) == set(expected)
    for name, pixel in expected.items():
        # pixel edges lie at whole numbers where the first centre is (.5, .5); corners to a third of a pixel
        np.testing.assert_allclose(found[name], pixel, atol=0.35)
    assert detect_tags(np.full((50, 50), 255, dtype=np.uint8), "4X4_50") == {}
    with pytest.raises(InputError, match="knows no tags"):
        detect_tags(picture, "SEMAPHORE")


def test_a_marker_file_is_read_and_its_faults_are_named(tmp_path: Path) -> None:
    path = tmp_path / "markers.yaml"
    path.write_text(
        "dictionary: DICT_APRILTAG_36h11\n"
        "markers:\n"
        "- name: temple\n"
        "  poses: {pose_00: {a.jpg: [1, 2], b.jpg: [3, 4.5]}, pose_01: [1, 2, 3]}\n"
    )
    content = read_markers(path, ["pose_00", "pose_01"])
    assert content.dictionary == "APRILTAG_36h11"
    np.testing.assert_array_equal(content.places["pose_00"]["temple"].photos["b.jpg"], [3, 4.5])
    np.testing.assert_array_equal(content.places["pose_01"]["temple"].point, [1, 2, 3])
    for text, fault in (
        ("points: []\n", "needs the keys"),
        ("markers:\n- {name: a, poses: {pose_09: [1, 2, 3]}}\n", "no pose 'pose_09'"),
        ("markers:\n- {name: a, poses: {pose_00: [1, 2]}}\n", "not a list of 3 numbers"),
        ("markers:\n- {name: a}\n", "needs 'name' and 'poses'"),
    ):
        path.write_text(text)
        with pytest.raises(InputError, match=fault):
            read_markers(path, ["pose_00", "pose_01"])
