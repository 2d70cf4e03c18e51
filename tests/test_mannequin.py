"""The embedded mannequin: its topology, chart, names, motions and skin, by identities and hand values."""

from __future__ import annotations

import hashlib

import numpy as np
import pytest

from capture_eval.curves.edge_loops import edge_topology, walk_edge_loop
from capture_eval.errors import InputError
from capture_eval.images.mannequin import build_mannequin
from capture_eval.images.mannequin_features import upper_and_lower
from capture_eval.images.mannequin_layout import meridian_coordinates, meridian_rays
from capture_eval.images.mannequin_motion import (
    JAW_ANGLE,
    JAW_HINGE,
    Turn,
    apply_turns,
    bump,
    rotate_about,
    skin_turns,
)
from capture_eval.images.mannequin_shape import EYE_CENTRE, EYE_RADIUS, head_distance, project_to_skin
from capture_eval.images.mannequin_topology import build_topology
from capture_eval.triangle_geometry import diameter

TOPOLOGY = build_topology()
IDENTITIES = (0, 1, 4)


@pytest.fixture(scope="module")
def head():
    return build_mannequin()


def edge_faces(quads):
    """Edge -> number of faces, as (E, 2) edges and (E,) counts."""
    edges = np.sort(np.concatenate([quads[:, [i, (i + 1) % 4]] for i in range(4)]), axis=1)
    return np.unique(edges, axis=0, return_counts=True)


def test_all_quads_one_border_and_the_euler_characteristic_of_a_disk(head):
    quads = head.skin.quads()
    edges, faces = edge_faces(quads)
    assert 5000 <= len(head.skin.vertices) <= 8000
    assert np.array_equal(np.unique(quads), np.arange(len(head.skin.vertices)))
    assert set(faces.tolist()) == {1, 2}
    assert len(head.skin.vertices) - len(edges) + len(quads) == 1
    border = edges[faces == 1]
    # one loop: every border vertex has two border edges, and walking along them meets all of them
    assert np.array_equal(np.bincount(border.ravel())[np.unique(border)], np.full(len(border), 2))
    loop = walk_edge_loop(edge_topology(head.skin), tuple(border[0].tolist()))
    assert loop.closed
    assert loop.border
    assert len(loop.vertices) == len(border)
    assert set(loop.vertices) == set(TOPOLOGY.skull[-1])


def test_winding_is_outward_and_consistent(head):
    quads = head.skin.quads()
    directed = np.concatenate([quads[:, [i, (i + 1) % 4]] for i in range(4)])
    assert len(np.unique(directed, axis=0)) == len(directed)
    corners = head.skin.vertices[quads]
    normals = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
    cap = np.isin(quads, TOPOLOGY.cap).all(axis=1)
    assert np.all(normals[cap, 1] > 0)


def test_mirror_is_an_involution_and_identity_0_is_symmetric(head):
    mirror = TOPOLOGY.mirror
    assert np.array_equal(mirror[mirror], np.arange(len(mirror)))
    faces = {tuple(sorted(face)) for face in head.skin.quads().tolist()}
    assert {tuple(sorted(face)) for face in mirror[head.skin.quads()].tolist()} == faces
    np.testing.assert_allclose(head.skin.vertices[mirror] * [-1, 1, 1], head.skin.vertices, atol=1e-9)


@pytest.mark.parametrize("motion", ["jaw_open", "grin", "blink_frown"])
def test_motions_are_symmetric_and_start_at_the_neutral(head, motion):
    neutral, _ = head.pose(motion, 0.0)
    assert np.array_equal(neutral, head.skin.vertices)
    moved, _ = head.pose(motion, 1.0)
    # the motions' weights come from linear solves: rounding only
    np.testing.assert_allclose(moved[TOPOLOGY.mirror] * [-1, 1, 1], moved, atol=1e-6)
    assert np.linalg.norm(moved - neutral, axis=1).max() > 3.0


def test_adult_size_in_millimetres(head):
    low, high = head.skin.vertices.min(axis=0), head.skin.vertices.max(axis=0)
    assert 280 < diameter(head.skin.vertices) < 300
    chin = head.skin.vertices[head.landmarks["chin_bottom"]]
    assert 215 < high[1] - chin[1] < 245
    assert 145 < high[0] - low[0] < 185
    eyes = head.skin.vertices[[head.landmarks["lid_upper_left"], head.landmarks["lid_upper_right"]]]
    assert eyes[0, 0] - eyes[1, 0] == pytest.approx(64, abs=2)


def test_texture_chart_has_no_flips_overlaps_or_waste(head):
    corners = head.skin.texture_coordinates[head.skin.face_texture_indices.reshape(-1, 4)]
    # every quad strictly convex and counter-clockwise: no triangulation of it flips
    for i in range(4):
        a, b, c = corners[:, i], corners[:, (i + 1) % 4], corners[:, (i + 2) % 4]
        turn = (b - a)[:, 0] * (c - b)[:, 1] - (b - a)[:, 1] * (c - b)[:, 0]
        assert turn.min() > 0
    diagonals = corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1]
    areas = 0.5 * (diagonals[0][:, 0] * diagonals[1][:, 1] - diagonals[0][:, 1] * diagonals[1][:, 0])
    # the border is convex and no quad flips, so the quads tile the area inside it exactly once
    assert 0.9 < areas.sum() < 1.0
    assert corners.min() > 0
    assert corners.max() < 1


def test_face_has_three_texels_a_millimetre_at_1024(head):
    quads = head.skin.quads()
    corners = head.skin.texture_coordinates[head.skin.face_texture_indices.reshape(-1, 4)] * 1024
    flat = np.concatenate([corners, np.zeros((*corners.shape[:2], 1))], axis=2)
    solid = head.skin.vertices[quads]
    area = [np.linalg.norm(np.cross(q[:, 2] - q[:, 0], q[:, 3] - q[:, 1]), axis=1) for q in (flat, solid)]
    density = np.sqrt(area[0] / area[1])
    for region in ("lips", "chin", "cheeks", "forehead", "eyes", "nose"):
        inside = np.isin(quads, head.regions[region]).all(axis=1)
        assert np.median(density[inside]) > 3.0, region
    assert np.median(density) > 2.0


def test_49_curves_regenerate_by_edge_loop_walking(head):
    topology = edge_topology(head.skin)
    loops = {
        curve["name"]: walk_edge_loop(topology, tuple(curve["start_edge"]), stop=curve.get("stop"))
        for curve in head.curves
    }
    assert len(loops) == len(head.curves) == 49
    lengths = {name: (len(loop.vertices), loop.closed) for name, loop in loops.items()}
    assert lengths["lip_outer_1"] == (40, True)
    assert lengths["eye_left_1"] == (28, True)
    assert lengths["neck_ring_1"] == (72, True)
    assert {name for name, (_, closed) in lengths.items() if not closed} == {
        "profile_nose",
        "profile_chin",
        "cheek_right",
        "cheek_left",
    }
    # no two curves are the same walk
    assert len({frozenset(loop.vertices.tolist()) for loop in loops.values()}) == 49
    ring = np.concatenate([TOPOLOGY.rings["mouth"][5], TOPOLOGY.rings["mouth"][5]]).tolist()
    assert set(loops["lip_outer_1"].vertices.tolist()) == set(ring)


def test_poles_stay_off_the_closed_feature_loops(head):
    edges, _ = edge_faces(head.skin.quads())
    valence = np.bincount(edges.ravel())
    border = set(TOPOLOGY.skull[-1].tolist())
    poles = [v for v in np.flatnonzero(valence != 4) if v not in border]
    # a cap (4 x 3), a frame of face rings (4 x 5 and 4 x 3), and 7 insets (4 x 5 and 4 x 3 each)
    assert len(poles) == 4 + 8 + 7 * 8
    named = np.concatenate([TOPOLOGY.rings["mouth"][1:10].ravel(), TOPOLOGY.rings["eye_left"][1:11].ravel()])
    assert not set(poles) & set(named.tolist())


def test_names_lie_where_they_should(head):
    at = {name: head.skin.vertices[vertex] for name, vertex in head.landmarks.items()}
    assert len(at) >= 24
    assert at["nose_tip"][2] == head.skin.vertices[:, 2].max()
    for name, point in at.items():
        if name.endswith("_left"):
            np.testing.assert_allclose(at[name.replace("_left", "_right")], point * [-1, 1, 1], atol=1e-9)
            assert point[0] > 5
        elif not name.endswith("_right"):
            assert abs(point[0]) < 1e-9
    order = ("glabella", "nasion", "nose_bridge", "nose_tip", "nose_base", "lip_upper_top", "lip_upper_bottom")
    order += ("lip_lower_top", "lip_lower_bottom", "chin", "chin_bottom")
    heights = [at[name][1] for name in order]
    assert heights == sorted(heights, reverse=True)
    assert np.array_equal(np.sort(np.concatenate(list(head.regions.values()))), np.arange(len(head.skin.vertices)))


@pytest.mark.parametrize("identity", IDENTITIES)
def test_rigid_region_does_not_move_at_all(identity):
    head = build_mannequin(identity)
    assert len(head.rigid_region) > 1500
    for motion in head.motions:
        moved, _ = head.pose(motion, 1.0)
        assert np.array_equal(moved[head.rigid_region], head.skin.vertices[head.rigid_region])


@pytest.mark.parametrize("identity", IDENTITIES)
def test_jaw_turns_rigidly_about_its_hinge(identity):
    head = build_mannequin(identity)
    turns = skin_turns(TOPOLOGY, build_mannequin(0).skin.vertices, "jaw_open")
    full = np.flatnonzero(turns[0].degrees == JAW_ANGLE)
    assert len(full) > 100
    assert head.landmarks["chin"] in full
    assert head.landmarks["lip_lower_bottom"] in full
    neutral = head.skin.vertices[full]
    for amount in (0.3, 1.0):
        moved = head.pose("jaw_open", amount)[0][full]
        # rigid: all mutual distances stay
        before = np.linalg.norm(neutral[:, None] - neutral[None], axis=2)
        np.testing.assert_allclose(np.linalg.norm(moved[:, None] - moved[None], axis=2), before, atol=1e-9)
    # an arc: sagitta to chord of a turn by 22 degrees is tan(22 / 4 degrees) / 2 for every vertex
    start, middle, end = (head.pose("jaw_open", t)[0][full] for t in (0.0, 0.5, 1.0))
    sagitta = np.linalg.norm(middle - 0.5 * (start + end), axis=1)
    chord = np.linalg.norm((end - start), axis=1)
    np.testing.assert_allclose(sagitta / chord, 0.5 * np.tan(np.radians(JAW_ANGLE / 4)), rtol=1e-9)


def test_jaw_keeps_distance_to_the_hinge_axis_everywhere(head):
    moved, parts = head.pose("jaw_open", 0.7)
    radius = [np.hypot(*(v - JAW_HINGE)[:, 1:].T) for v in (head.skin.vertices, moved)]
    np.testing.assert_allclose(radius[1], radius[0], atol=1e-9)
    names = [part.name for part in head.blockers]
    teeth = head.blockers[names.index("teeth_lower")].mesh.vertices, parts[names.index("teeth_lower")]
    radius = [np.hypot(*(v - JAW_HINGE)[:, 1:].T) for v in teeth]
    np.testing.assert_allclose(radius[1], radius[0], atol=1e-9)
    assert np.array_equal(parts[names.index("teeth_upper")], head.blockers[names.index("teeth_upper")].mesh.vertices)


@pytest.mark.parametrize("identity", IDENTITIES)
def test_lips_nearly_touch_in_the_neutral_and_part_with_the_jaw(identity):
    head = build_mannequin(identity)
    upper, lower = upper_and_lower(6, 14)
    rings = TOPOLOGY.rings["mouth"]
    middle = len(upper) // 2
    for amount, low, high in ((0.0, 0.0, 0.6), (1.0, 20.0, 60.0)):
        points, _ = head.pose("jaw_open", amount)
        gaps = points[rings[5:12][:, upper[1:-1]]][..., 1] - points[rings[5:12][:, lower[1:-1]]][..., 1]
        assert gaps.min() > 0
        assert low < gaps[4, middle - 1] < high


@pytest.mark.parametrize("identity", IDENTITIES)
@pytest.mark.parametrize("motion", ["neutral", "jaw_open", "grin", "blink_frown"])
def test_visible_skin_does_not_intersect_itself(identity, motion):
    import open3d

    head = build_mannequin(identity)
    points, _ = head.pose("grin" if motion == "neutral" else motion, 0.0 if motion == "neutral" else 1.0)
    quads = head.skin.quads()
    # behind the ears and in the nostrils the coarse skin touches itself; lids and socket meet when the eye closes
    hidden = np.concatenate([head.regions["inner"], head.regions["ears"]])
    hidden = np.concatenate([hidden, TOPOLOGY.rings["nostril_left"].ravel(), TOPOLOGY.rings["nostril_right"].ravel()])
    seen = quads[~np.isin(quads, hidden).any(axis=1)]
    triangles = np.concatenate([seen[:, [0, 1, 2]], seen[:, [0, 2, 3]]])
    mesh = open3d.geometry.TriangleMesh(open3d.utility.Vector3dVector(points), open3d.utility.Vector3iVector(triangles))
    crossing = np.asarray(mesh.get_self_intersecting_triangles())
    # a pair or two of slivers at the canthi and ear roots may touch
    assert len(crossing) <= 4


@pytest.mark.parametrize("identity", IDENTITIES)
def test_lids_close_over_the_eyeball_without_touching_it(identity):
    head = build_mannequin(identity)
    upper, lower = upper_and_lower(6, 8)
    rings = TOPOLOGY.rings["eye_left"]
    ball = head.blockers[[part.name for part in head.blockers].index("eye_left")].mesh.vertices
    centre = 0.5 * (ball.min(axis=0) + ball.max(axis=0))
    for amount in (0.0, 0.5, 1.0):
        points, _ = head.pose("blink_frown", amount)
        distance = np.linalg.norm(points[rings[5:12]] - centre, axis=2)
        assert distance.min() > EYE_RADIUS + 0.5
        gap = points[rings[10][upper[1:-1]]][:, 1] - points[rings[10][lower[1:-1]]][:, 1]
        assert gap.min() > 0
        if amount == 1.0:
            assert gap.max() < 1.0


@pytest.mark.parametrize("identity", [1, 2, 3, 4])
def test_other_persons_are_two_to_four_percent_away(head, identity):
    other = build_mannequin(identity)
    difference = np.linalg.norm(other.skin.vertices - head.skin.vertices, axis=1).mean()
    assert 0.02 < difference / diameter(head.skin.vertices) < 0.04
    assert np.array_equal(other.skin.quads(), head.skin.quads())
    assert other.landmarks == head.landmarks
    assert other.curves == head.curves


def test_skin_is_seeded_and_weak_skin_has_less_contrast(head):
    images = {contrast: head.albedo(256, contrast) for contrast in ("normal", "weak")}
    assert images["normal"].shape == (256, 256, 3)
    assert images["normal"].dtype == np.uint8
    again = head.albedo(256, "normal")
    assert hashlib.sha256(again.tobytes()).digest() == hashlib.sha256(images["normal"].tobytes()).digest()
    assert not np.array_equal(build_mannequin(1).albedo(256, "normal"), images["normal"])
    # forehead, between the eyes and the hairline in the middle of the chart
    patch = {name: image[60:84, 112:144].astype(float).mean(axis=2) for name, image in images.items()}
    assert patch["weak"].std() == pytest.approx(0.4 * patch["normal"].std(), rel=0.35)


def test_skin_has_no_seam(head):
    size = 1024
    image = head.albedo(size, "normal").astype(float)
    owners: dict[int, set[int]] = {}
    for vertex, texture in zip(head.skin.face_vertices.tolist(), head.skin.face_texture_indices.tolist(), strict=True):
        owners.setdefault(vertex, set()).add(texture)
    seam = np.array([sorted(textures) for textures in owners.values() if len(textures) == 2])
    assert len(seam) > 50
    coordinates = head.skin.texture_coordinates
    inwards = coordinates + 2.0 / size * np.sign(0.5 - coordinates)
    texel = np.clip((np.stack([1 - inwards[:, 1], inwards[:, 0]], axis=1) * size).astype(int), 0, size - 1)
    colors = image[texel[:, 0], texel[:, 1]]
    across = np.abs(colors[seam[:, 0]] - colors[seam[:, 1]]).mean()
    shuffled = np.abs(colors[seam[:, 0]] - np.roll(colors[seam[:, 1]], 7, axis=0)).mean()
    # both sides are within about a millimetre of the same point: closer than points 4 cm apart
    assert across < 0.6 * shuffled


def test_same_bytes_every_time(head):
    def digest(subject):
        parts = [subject.skin.vertices, subject.skin.texture_coordinates, *subject.pose("grin", 0.6)[1]]
        return hashlib.sha256(b"".join(np.ascontiguousarray(part).tobytes() for part in parts)).hexdigest()

    from capture_eval.images import mannequin

    first = digest(head)
    mannequin._canonical.cache_clear()
    assert digest(build_mannequin()) == first


def test_bad_requests_are_refused(head):
    with pytest.raises(InputError, match="identity"):
        build_mannequin(-1)
    with pytest.raises(InputError, match="jaw_open"):
        head.pose("wink", 0.5)
    with pytest.raises(InputError, match="outside"):
        head.pose("grin", 1.5)
    with pytest.raises(InputError, match="contrast"):
        head.albedo(64, "strong")
    with pytest.raises(InputError, match="16"):
        head.albedo(4, "normal")


def test_turning_by_hand():
    point = np.array([[1.0, 0.0, 0.0]])
    turned = rotate_about(point, np.zeros(3), np.array([0.0, 0.0, 1.0]), np.array([np.pi / 2]))
    np.testing.assert_allclose(turned, [[0.0, 1.0, 0.0]], atol=1e-15)
    turns = (Turn(np.zeros(3), np.array([0.0, 0.0, 1.0]), np.array([90.0])),)
    half = apply_turns(point, turns, 0.5)
    np.testing.assert_allclose(half, [[np.sqrt(0.5), np.sqrt(0.5), 0.0]], atol=1e-15)
    assert bump(np.array([0.0, 1.0, 2.0])).tolist() == [1.0, 0.0, 0.0]


def test_meridian_coordinates_invert_the_rays():
    generator = np.random.default_rng(3)
    angle, height = generator.uniform(-3, 3, 200), generator.uniform(0.02, 0.98, 200)
    origins, directions = meridian_rays(angle, height)
    points = origins + generator.uniform(20, 90, (200, 1)) * directions
    back = meridian_coordinates(points)
    np.testing.assert_allclose(back[0], angle, atol=1e-9)
    # rays of one meridian may meet again far from the axis, so compare the rays through the points, not the heights
    again, towards = meridian_rays(*back)
    arms = points - again
    np.testing.assert_allclose(np.linalg.norm(np.cross(arms, towards), axis=1), 0, atol=1e-4)


def test_projection_reaches_the_skin():
    points = project_to_skin(np.random.default_rng(1).normal(0, 1, (100, 3)) * 5 + [20, 60, 85], steps=8)
    np.testing.assert_allclose(head_distance(points), 0, atol=1e-3)


def test_eyeballs_sit_in_the_sockets(head):
    for side, sign in (("left", 1), ("right", -1)):
        ball = next(part.mesh.vertices for part in head.blockers if part.name == f"eye_{side}")
        np.testing.assert_allclose(np.linalg.norm(ball - EYE_CENTRE * [sign, 1, 1], axis=1), EYE_RADIUS, atol=1e-9)
