"""Surface cleaning on clouds and meshes whose right answer is known."""

import numpy as np
import pytest

pytest.importorskip("open3d")
pytest.importorskip("pymeshlab")

from capture_eval.errors import InputError, ReconstructionError
from capture_eval.reconstruction.surface_cleaning import (
    SurfaceOptions,
    keep_vertices,
    largest_parts,
    octree_depth,
    point_spacing,
    repair,
    robust_size,
    surface_from_cloud,
    without_lone_points,
)


def ball(count: int = 20000, share: float = 1.0) -> np.ndarray:
    """Evenly spread unit vectors (Fibonacci), the first `share` of them from the top down."""
    index = np.arange(int(count * share)) + 0.5
    height = 1 - 2 * index / count
    turn = np.pi * (1 + 5**0.5) * index
    ring = np.sqrt(1 - height**2)
    return np.stack([ring * np.cos(turn), ring * np.sin(turn), height], axis=1)


def tetrahedra(*centres: float) -> tuple[np.ndarray, np.ndarray]:
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    faces = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])
    vertices = np.concatenate([corners + centre for centre in centres])
    return vertices, np.concatenate([faces + 4 * k for k in range(len(centres))])


def test_a_ball_becomes_a_ball() -> None:
    points = ball()
    surface = surface_from_cloud(points, points, np.ones(len(points)), SurfaceOptions(depth=6))
    np.testing.assert_allclose(np.linalg.norm(surface.vertices, axis=1), 1.0, atol=0.005)
    assert np.min(np.sum(surface.vertices * surface.normals, axis=1)) > 0.95
    edges = np.sort(surface.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    assert np.all(np.unique(edges, axis=0, return_counts=True)[1] == 2)  # closed, two triangles at every edge
    assert len(surface.vertices) - 1.5 * len(surface.triangles) + len(surface.triangles) == 2  # Euler


def test_the_flap_over_a_missing_part_is_cut() -> None:
    points = ball(share=0.75)  # Poisson closes the ball below z = -0.5
    surface = surface_from_cloud(points, points, np.ones(len(points)), SurfaceOptions(depth=6, largest_hole=0.0))
    assert surface.vertices[:, 2].min() > -0.56
    assert surface.vertices[:, 2].min() < -0.49
    np.testing.assert_allclose(np.linalg.norm(surface.vertices, axis=1), 1.0, atol=0.02)


def test_an_island_and_lone_points_go() -> None:
    generator = np.random.default_rng(0)
    island = 0.15 * ball(300) + [0.0, 0.0, 2.0]
    lone = generator.uniform(-2.0, 2.0, (60, 3))
    points = np.concatenate([ball(), island, lone])
    normals = np.concatenate([ball(), ball(300), np.tile([[0.0, 0.0, 1.0]], (60, 1))])
    surface = surface_from_cloud(points, normals, np.ones(len(points)), SurfaceOptions(depth=6))
    np.testing.assert_allclose(np.linalg.norm(surface.vertices, axis=1), 1.0, atol=0.02)


def test_repeats_to_the_bit() -> None:
    points = ball(4000)
    first, second = (surface_from_cloud(points, points, np.ones(4000), SurfaceOptions(depth=6)) for _ in range(2))
    assert first.vertices.tobytes() == second.vertices.tobytes()
    assert first.triangles.tobytes() == second.triangles.tobytes()
    assert first.support.tobytes() == second.support.tobytes()


def test_support_follows_the_density() -> None:
    everywhere = ball()
    points = everywhere[(everywhere[:, 2] > 0) | (np.arange(len(everywhere)) % 4 == 0)]
    surface = surface_from_cloud(points, points, np.ones(len(points)), SurfaceOptions(depth=6, trim=0.04))
    dense = np.median(surface.support[surface.vertices[:, 2] > 0.2])
    thin = np.median(surface.support[surface.vertices[:, 2] < -0.2])
    assert 3.0 < dense / thin < 5.0


def test_uncertainty_reaches_the_vertices() -> None:
    points = ball(share=0.75)
    deviation = np.where(points[:, 2] > 0, 0.001, 0.004)
    surface = surface_from_cloud(
        points, points, np.ones(len(points)), SurfaceOptions(depth=6, trim=0.05), deviation=deviation
    )
    height = surface.vertices[:, 2]
    np.testing.assert_allclose(surface.deviation[height > 0.1], 0.001, rtol=0.05)  # nearest points all have it
    np.testing.assert_allclose(surface.deviation[(height < -0.1) & (height > -0.4)], 0.004, rtol=0.05)
    assert surface.deviation[height < -0.56].min() > 0.008  # nothing but Poisson's guess below z = -0.5
    plain = surface_from_cloud(points, points, np.ones(len(points)), SurfaceOptions(depth=6))
    assert np.isnan(plain.deviation).all()


def test_lone_points_are_those_far_from_all_others() -> None:
    points = np.concatenate([ball(500), [[3.0, 0.0, 0.0]]])
    kept = without_lone_points(points, 8, 3.0)
    assert kept[:-1].all()
    assert not kept[-1]


def test_largest_part_stays_and_small_ones_go() -> None:
    vertices, triangles = tetrahedra(0.0, 5.0)
    bigger = np.concatenate([vertices, vertices[4:] + 0.5])
    triangles = np.concatenate([triangles, [[4, 8, 5]], triangles[4:] + 4])
    found, faces = largest_parts(bigger, triangles, 1.0)
    assert len(faces) == 9
    assert found.min() >= 5.0
    assert len(largest_parts(bigger, triangles, 0.1)[1]) == 13


def test_kept_vertices_are_renumbered() -> None:
    vertices, triangles = tetrahedra(0.0, 5.0)
    found, faces = keep_vertices(vertices, triangles, vertices[:, 0] >= 5.0)
    np.testing.assert_array_equal(found, vertices[4:])
    np.testing.assert_array_equal(faces, triangles[:4])


def test_repair_closes_small_holes_and_drops_doubles() -> None:
    vertices, triangles = tetrahedra(0.0)
    broken = np.concatenate([triangles[:3], triangles[:1]])  # one face missing, one twice
    found, faces = repair(vertices, broken, 5)
    assert len(found) == 4
    assert len(faces) == 4
    _, open_faces = repair(vertices, broken, 0)
    assert len(open_faces) == 3


def test_sizes() -> None:
    line = np.stack([np.linspace(0, 1, 1001), np.zeros(1001), np.zeros(1001)], axis=1)
    assert robust_size(line) == pytest.approx(0.98)
    assert point_spacing(line) == pytest.approx(1e-3)
    assert octree_depth(1.0, 1.1 / 256 / 2.0, 2.0) == 8
    assert octree_depth(1.0, 1e-9, 2.0) == 11


def test_bad_clouds_are_refused() -> None:
    points = ball(50)
    with pytest.raises(ReconstructionError, match="only 50 points"):
        surface_from_cloud(points, points, np.ones(50), SurfaceOptions())
    with pytest.raises(InputError, match="normals"):
        surface_from_cloud(points, points[:-1], np.ones(50), SurfaceOptions())
