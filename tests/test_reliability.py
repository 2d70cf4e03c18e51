"""What cannot be registered is said to be so: every sign of a bad pose, on arrays and on a ball with known skin."""

from __future__ import annotations

import numpy as np
import pytest
import textured_sphere
from hypothesis import given, settings
from hypothesis import strategies as st

from capture_eval.errors import InputError, RegistrationError, SolverError
from capture_eval.registration.deformation_solver import DeformationSolver, SurfaceConstraints
from capture_eval.registration.landmark_triangulation import landmark_similarity
from capture_eval.registration.mesh_operators import build_mesh_operators
from capture_eval.registration.reliability import (
    PoseEvidence,
    ReliabilityOptions,
    coverage_faults,
    evidence_faults,
    exchanged_poses,
    pose_evidence,
)
from capture_eval.registration.surface_correspondence import Surface
from capture_eval.registration.texture_atlas import rasterise_atlas
from capture_eval.registration.texture_baking import bake_texture
from capture_eval.registration.texture_rounds import PhotoSet, RoundOptions, TextureAtlases, refine_by_texture
from capture_eval.registration.texture_stereo import StereoOptions

OPTIONS = ReliabilityOptions()
VERTICES = 200


def _path(times: np.ndarray, bend: float = 0.0) -> np.ndarray:
    """Poses (P, V, 3) of skin that moves along straight or bent ways."""
    generator = np.random.default_rng(3)
    rest, way, aside = generator.normal(size=(3, VERTICES, 3))
    return rest + times[:, None, None] * way + bend * (times * (1.0 - times))[:, None, None] * aside


@pytest.mark.parametrize("pair", [(0, 1), (1, 2), (2, 7), (9, 10), (0, 10)])
@pytest.mark.parametrize("bend", [0.0, 2.0])
def test_two_exchanged_poses_are_named(pair: tuple[int, int], bend: float) -> None:
    poses = _path(np.linspace(0.0, 1.0, 11), bend)
    order = np.arange(11)
    order[list(pair)] = order[list(pair[::-1])]
    found = exchanged_poses(poses[order], np.ones(VERTICES, dtype=bool))
    assert [(one.first, one.second) for one in found] == [pair]
    # in even straight motion the steps at the ends go from 3 to 2, between neighbours within from 5 to 3
    if bend == 0.0 and pair in ((0, 1), (9, 10)):
        assert found[0].gain == pytest.approx(1.0 / 3.0, abs=1e-9)
    if bend == 0.0 and pair == (1, 2):
        assert found[0].gain == pytest.approx(2.0 / 5.0, abs=1e-9)


@settings(max_examples=30, deadline=None)
@given(st.lists(st.floats(0.02, 1.0), min_size=2, max_size=10), st.floats(0.0, 3.0))
def test_a_path_in_order_is_never_doubted(steps: list[float], bend: float) -> None:
    times = np.concatenate([[0.0], np.cumsum(steps)])
    assert exchanged_poses(_path(times / times[-1], bend), np.ones(VERTICES, dtype=bool)) == []


def test_of_four_poses_those_within_are_named() -> None:
    """0, 0.6, 0.3, 1: exchanging the ends gives a way just as short."""
    found = exchanged_poses(_path(np.array([0.0, 0.6, 0.3, 1.0])), np.ones(VERTICES, dtype=bool))
    assert [(one.first, one.second) for one in found] == [(1, 2)]


def test_steps_as_small_as_noise_have_no_order() -> None:
    still = np.zeros(6)
    still[-1] = 1.0
    poses = _path(still) + 1e-4 * np.random.default_rng(0).normal(size=(6, VERTICES, 3))
    assert exchanged_poses(poses, np.ones(VERTICES, dtype=bool)) == []


def test_failed_poses_and_few_vertices_are_passed_over() -> None:
    poses = _path(np.linspace(0.0, 1.0, 6))[[0, 1, 3, 2, 4, 5]]
    poses[1] = np.nan
    known = np.ones(VERTICES, dtype=bool)
    assert [(one.first, one.second) for one in exchanged_poses(poses, known)] == [(2, 3)]
    assert exchanged_poses(poses, np.arange(VERTICES) < 10) == []
    with pytest.raises(InputError, match="do not fit"):
        exchanged_poses(poses, known[:-1])


def test_missing_photos_and_unseen_skin_are_said() -> None:
    seen = np.ones(100, dtype=bool)
    half = np.arange(100) < 60
    assert coverage_faults(seen, seen, 24, 24.0, OPTIONS) == []
    assert coverage_faults(seen, seen, None, None, OPTIONS) == []
    assert coverage_faults(seen, seen, 12, 24.0, OPTIONS) == ["12 photos placed, 24 in the other poses"]
    assert "60% of the skin" in coverage_faults(half, seen, 24, 24.0, OPTIONS)[0]
    assert len(coverage_faults(half, seen, 12, 24.0, OPTIONS)) == 2


def test_evidence_becomes_words() -> None:
    assert evidence_faults(PoseEvidence(0.9, None), OPTIONS) == []
    assert evidence_faults(PoseEvidence(0.9, 0.9), OPTIONS) == []
    assert "blank" in evidence_faults(PoseEvidence(0.05, 0.9), OPTIONS)[0]
    assert "another person" in evidence_faults(PoseEvidence(0.9, 0.05), OPTIONS)[0]
    assert evidence_faults(PoseEvidence(None, None), OPTIONS) == []
    for evidence in (PoseEvidence(0.5, None), PoseEvidence(0.5, 0.25), PoseEvidence(None, 0.25)):
        assert PoseEvidence.from_array(evidence.array) == evidence


def test_what_is_switched_off_speaks_neither_for_nor_against() -> None:
    seen = np.ones(5, dtype=bool)
    assert pose_evidence(None, None, seen, is_neutral=False) == PoseEvidence(None, None)
    none_found = SurfaceConstraints.at_vertices(np.zeros(0, dtype=np.int64), np.zeros((0, 3)), np.zeros(0))
    assert pose_evidence(none_found, none_found, seen, is_neutral=False) == PoseEvidence(0.0, 0.0)
    assert pose_evidence(none_found, none_found, seen, is_neutral=True) == PoseEvidence(0.0, None)


def test_mirrored_landmarks_are_refused_and_noise_is_not() -> None:
    """A head's landmarks are nearly symmetric: it is the depth of nose and ears that tells left from right."""
    generator = np.random.default_rng(1)
    side = np.array([[30.0, 40.0, 60.0], [60.0, 30.0, 0.0], [25.0, -30.0, 65.0], [10.0, 5.0, 80.0]])
    middle = np.array([[0.0, 10.0, 90.0], [0.0, -60.0, 70.0]])
    template = np.concatenate([side, side * [-1, 1, 1], middle])
    names = [f"mark_{k}" for k in range(len(template))]
    clicked = 2.0 * template + generator.normal(0.0, 1.0, template.shape)
    landmark_similarity(clicked, template, names)
    swapped = clicked[[4, 5, 6, 7, 0, 1, 2, 3, 8, 9]]
    with pytest.raises(RegistrationError, match="left and right are swapped"):
        landmark_similarity(swapped, template, names)


@pytest.fixture(scope="module")
def ball() -> dict:
    """The neutral: a coarse ball, its texture from six photos."""
    vertices, triangles, corner_uv = textured_sphere.mesh(columns=30, rows=20)
    views = textured_sphere.views()
    images = [textured_sphere.photograph(view) for view in views]
    atlases = TextureAtlases(rasterise_atlas(corner_uv, 192), rasterise_atlas(corner_uv, 128))
    texture = bake_texture(vertices, triangles, atlases.flow, views, images)
    solver = DeformationSolver(build_mesh_operators(vertices, triangles), np.ones(len(vertices)))
    return {"solver": solver, "vertices": vertices, "views": views, "atlases": atlases, "texture": texture,
            "scan": Surface(vertices, triangles)}  # fmt: skip


def _evidence(ball: dict, images: list[np.ndarray]) -> PoseEvidence:
    skin = np.ones(len(ball["vertices"]), dtype=bool)
    options = RoundOptions(half_ranges=(1.0,), solves=1, stereo=StereoOptions(views=6, minimum_views=3))
    photos = PhotoSet(tuple(ball["views"]), tuple(images))
    refined = refine_by_texture(
        ball["solver"], ball["vertices"], skin, photos, ball["atlases"], ball["texture"], ball["scan"], None, options
    )
    front = ball["vertices"][:, 2] > 0.75 * textured_sphere.RADIUS
    return pose_evidence(refined.flow, refined.stereo, front, is_neutral=False)


def _with_noise(image: np.ndarray, seed: int) -> np.ndarray:
    noise = np.random.default_rng(seed).normal(0.0, 2.0, image.shape)
    return np.clip(np.rint(image + noise), 0, 255).astype(np.uint8)


def test_the_same_skin_is_believed(ball: dict) -> None:
    images = [_with_noise(textured_sphere.photograph(view), k) for k, view in enumerate(ball["views"])]
    evidence = _evidence(ball, images)
    assert evidence.skin_agreement is not None
    assert evidence.stereo_share > 0.8
    assert evidence.skin_agreement > 0.8
    assert evidence_faults(evidence, OPTIONS) == []


def test_the_skin_of_another_person_is_not(ball: dict) -> None:
    images = [_with_noise(textured_sphere.photograph(view, seed=9), k) for k, view in enumerate(ball["views"])]
    evidence = _evidence(ball, images)
    assert evidence.stereo_share > 0.5  # the photos agree with each other
    assert "another person" in evidence_faults(evidence, OPTIONS)[0]


def test_nothing_measured_is_an_error_of_the_registration() -> None:
    vertices, triangles, _ = textured_sphere.mesh(columns=8, rows=6)
    nothing = SurfaceConstraints.at_vertices(np.zeros(0, dtype=np.int64), np.zeros((0, 3)), np.zeros(0))
    with pytest.raises(SolverError, match="nothing that was measured"):
        DeformationSolver(build_mesh_operators(vertices, triangles)).solve(vertices, 1.0, 0.05, [nothing])


def test_blank_skin_is_not(ball: dict) -> None:
    """Flat grey with the sensor noise of a dim room."""
    images = [_with_noise(np.full((240, 320), 128.0), k) for k in range(len(ball["views"]))]
    assert "blank" in evidence_faults(_evidence(ball, images), OPTIONS)[0]
