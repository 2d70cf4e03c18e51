"""Ground types: meshes, cameras, similarities, geometry and atomic files by identities and hand values."""

import hashlib
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from capture_eval.cameras import Intrinsics, View, distort, pixel_rays, project, undistort
from capture_eval.errors import CaptureEvalError, InputError
from capture_eval.files.atomic import atomic_path, read_json, read_npz, write_json, write_npz
from capture_eval.polygon_mesh import PolygonMesh
from capture_eval.similarity import Similarity, estimate_similarity, transform_view
from capture_eval.triangle_geometry import diameter, triangle_areas, unique_edges, vertex_normals


def random_rotation(generator: np.random.Generator) -> np.ndarray:
    rotation, _ = np.linalg.qr(generator.normal(size=(3, 3)))
    return rotation * np.sign(np.linalg.det(rotation))


def a_view(generator: np.random.Generator, distortion: tuple[float, float, float, float]) -> View:
    matrix = np.array([[1000.0, 0.0, 320.3], [0.0, 998.0, 241.1], [0.0, 0.0, 1.0]])
    rotation = random_rotation(generator)
    center = generator.normal(size=3) * 100.0
    return View("photo", Intrinsics(640, 480, matrix, np.array(distortion)), rotation, -rotation @ center)


class TestPolygonMesh:
    def test_fan_of_a_quad_and_a_pentagon(self) -> None:
        mesh = PolygonMesh.from_faces(np.eye(7, 3), [[0, 1, 2, 3], [2, 3, 4, 5, 6]])
        triangles, faces, corners = mesh.triangles()
        np.testing.assert_array_equal(triangles, [[0, 1, 2], [0, 2, 3], [2, 3, 4], [2, 4, 5], [2, 5, 6]])
        np.testing.assert_array_equal(faces, [0, 0, 1, 1, 1])
        np.testing.assert_array_equal(mesh.face_vertices[corners], triangles)

    def test_quads_refuses_a_triangle(self) -> None:
        with pytest.raises(InputError, match="1 of 2 faces are not quad"):
            PolygonMesh.from_faces(np.eye(5, 3), [[0, 1, 2, 3], [2, 3, 4]]).quads()

    @pytest.mark.parametrize(
        ("vertices", "faces", "message"),
        [
            (np.zeros((3, 2)), [[0, 1, 2]], "expected"),
            (np.array([[0, 0, 0], [1, 0, 0], [0, np.nan, 0]]), [[0, 1, 2]], "vertices 2 is not finite"),
            (np.eye(3), [[0, 1, 3]], "uses vertex 3"),
            (np.eye(3), [[0, 1]], "fewer than three"),
        ],
    )
    def test_bad_meshes(self, vertices: np.ndarray, faces: list[list[int]], message: str) -> None:
        with pytest.raises(InputError, match=message):
            PolygonMesh.from_faces(vertices, faces)

    def test_with_vertices_refuses_another_count(self) -> None:
        with pytest.raises(ValueError, match="do not fit"):
            PolygonMesh.from_faces(np.eye(3), [[0, 1, 2]]).with_vertices(np.zeros((4, 3)))


class TestCameras:
    def test_hand_computed_pixel(self) -> None:
        matrix = np.array([[100.0, 0.0, 50.0], [0.0, 200.0, 40.0], [0.0, 0.0, 1.0]])
        view = View("v", Intrinsics(100, 80, matrix, np.zeros(4)), np.eye(3), np.array([0.0, 0.0, 5.0]))
        pixels, depth = project(view, [[1.0, -1.0, 5.0]])
        np.testing.assert_allclose(pixels, [[60.0, 20.0]])
        np.testing.assert_allclose(depth, [10.0])

    @given(seed=st.integers(0, 10_000), k1=st.floats(-0.1, 0.1), p1=st.floats(-0.005, 0.005))
    @settings(max_examples=30, deadline=None)
    def test_rays_go_through_the_projected_points(self, seed: int, k1: float, p1: float) -> None:
        generator = np.random.default_rng(seed)
        view = a_view(generator, (k1, 0.01, p1, -p1))
        pixels = generator.uniform([0, 0], [640, 480], size=(20, 2))
        origin, directions = pixel_rays(view, pixels)
        again, depth = project(view, origin + directions * generator.uniform(10, 900, size=(20, 1)))
        # The fixed point of the undistortion contracts tenfold a step, so rounding is reached: 1e-9 px.
        np.testing.assert_allclose(again, pixels, atol=1e-8)
        assert np.all(depth > 0)

    def test_undistort_inverts_distort(self) -> None:
        places = np.random.default_rng(0).uniform(-0.4, 0.4, size=(50, 2))
        coefficients = np.array([-0.1, 0.03, 0.001, -0.002])
        np.testing.assert_allclose(undistort(distort(places, coefficients), coefficients), places, atol=1e-12)

    def test_reflection_is_refused(self) -> None:
        camera = Intrinsics(4, 4, np.eye(3), np.zeros(4))
        with pytest.raises(InputError, match="reflection"):
            View("v", camera, np.diag([1.0, 1.0, -1.0]), np.zeros(3))


class TestSimilarity:
    @given(seed=st.integers(0, 10_000), scale=st.floats(0.01, 100.0))
    @settings(max_examples=40, deadline=None)
    def test_recovers_an_exact_similarity(self, seed: int, scale: float) -> None:
        generator = np.random.default_rng(seed)
        truth = Similarity(scale, random_rotation(generator), generator.normal(size=3))
        source = generator.normal(size=(8, 3))
        found = estimate_similarity(source, truth.apply(source), generator.uniform(0.5, 1.0, size=8))
        np.testing.assert_allclose(found.apply(source), truth.apply(source), atol=1e-10 * max(1.0, scale))
        np.testing.assert_allclose(truth.inverse().compose(truth).apply(source), source, atol=1e-12)

    def test_a_mirrored_cloud_never_gives_a_reflection(self) -> None:
        source = np.random.default_rng(1).normal(size=(30, 3))
        found = estimate_similarity(source, source * [-1.0, 1.0, 1.0])
        assert np.linalg.det(found.rotation) == pytest.approx(1.0)

    def test_collinear_points_are_refused(self) -> None:
        line = np.outer(np.arange(5.0), [1.0, 2.0, 3.0])
        with pytest.raises(InputError, match="one line"):
            estimate_similarity(line, line)

    def test_a_transformed_view_sees_the_same_pixels(self) -> None:
        generator = np.random.default_rng(3)
        view = a_view(generator, (0.05, 0.0, 0.0, 0.0))
        new_from_world = Similarity(3.0, random_rotation(generator), np.array([5.0, -2.0, 1.0]))
        origin, directions = pixel_rays(view, generator.uniform(0, 400, size=(10, 2)))
        points = origin + 70.0 * directions
        pixels, depth = project(view, points)
        new_pixels, new_depth = project(transform_view(view, new_from_world), new_from_world.apply(points))
        np.testing.assert_allclose(new_pixels, pixels, atol=1e-8)
        np.testing.assert_allclose(new_depth, 3.0 * depth)


class TestTriangleGeometry:
    def test_right_triangle(self) -> None:
        vertices = np.array([[0.0, 0, 0], [3, 0, 0], [0, 4, 0]])
        triangles = np.array([[0, 1, 2]])
        assert triangle_areas(vertices, triangles)[0] == 6.0
        np.testing.assert_array_equal(vertex_normals(vertices, triangles), np.tile([0.0, 0, 1], (3, 1)))
        np.testing.assert_array_equal(unique_edges(triangles), [[0, 1], [0, 2], [1, 2]])

    @given(seed=st.integers(0, 1000), count=st.sampled_from([2, 10, 63, 64, 700]))
    @settings(max_examples=25, deadline=None)
    def test_diameter_is_the_farthest_pair(self, seed: int, count: int) -> None:
        points = np.random.default_rng(seed).normal(size=(count, 3))
        all_pairs = np.linalg.norm(points[:, None] - points[None], axis=-1)
        assert diameter(points) == pytest.approx(all_pairs.max(), rel=1e-12)

    def test_diameter_of_a_flat_set_and_of_one_place(self) -> None:
        grid = np.stack([*np.meshgrid(np.arange(10.0), np.arange(10.0)), np.zeros((10, 10))], -1).reshape(-1, 3)
        assert diameter(grid) == pytest.approx(9 * np.sqrt(2))
        with pytest.raises(InputError, match="D = 0"):
            diameter(np.ones((5, 3)))


class TestAtomicFiles:
    def test_a_failed_write_leaves_the_old_file(self, tmp_path: Path) -> None:
        target = tmp_path / "result.txt"
        target.write_text("old")

        def write_half() -> None:
            with atomic_path(target) as temporary:
                temporary.write_text("half")
                raise RuntimeError("killed")

        with pytest.raises(RuntimeError, match="killed"):
            write_half()
        assert target.read_text() == "old"
        assert list(tmp_path.iterdir()) == [target]

    def test_equal_arrays_give_equal_bytes(self, tmp_path: Path) -> None:
        arrays = {"a": np.arange(5.0), "names": np.array(["x", "yy"])}
        digests = []
        for name in ("one.npz", "two.npz"):
            write_npz(tmp_path / name, arrays)
            digests.append(hashlib.sha256((tmp_path / name).read_bytes()).hexdigest())
        assert digests[0] == digests[1]
        np.testing.assert_array_equal(read_npz(tmp_path / "one.npz")["a"], arrays["a"])

    def test_npz_is_written_in_pieces_and_arrays_can_be_made_one_after_the_other(self, tmp_path: Path) -> None:
        """Pieces are 16 MB, and two of them exist while one is compressed; both arrays together are 160 MB."""
        made = (("ab"[i], np.full(10_000_000, float(i))) for i in range(2))
        tracemalloc.start()
        write_npz(tmp_path / "large.npz", made)
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert 80e6 < peak < 80e6 + 40e6
        write_npz(
            tmp_path / "again.npz", {name: np.full(10_000_000, value) for name, value in (("a", 0.0), ("b", 1.0))}
        )
        assert (tmp_path / "again.npz").read_bytes() == (tmp_path / "large.npz").read_bytes()
        assert read_npz(tmp_path / "large.npz")["b"][-1] == 1.0

    def test_pickles_are_refused(self, tmp_path: Path) -> None:
        np.savez(tmp_path / "bad.npz", a=np.array([{"x": 1}], dtype=object))
        with pytest.raises(CaptureEvalError, match=r"bad\.npz"):
            read_npz(tmp_path / "bad.npz")

    def test_broken_json_names_the_file(self, tmp_path: Path) -> None:
        (tmp_path / "broken.json").write_text("{")
        with pytest.raises(InputError, match=r"broken\.json"):
            read_json(tmp_path / "broken.json")
        write_json(tmp_path / "good.json", {"a": [1, None]})
        assert read_json(tmp_path / "good.json") == {"a": [1, None]}
