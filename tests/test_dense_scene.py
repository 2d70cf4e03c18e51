"""Dense stereo of what is no head: edges between near and far, a depth range of one to six, photos of three sizes."""

from dataclasses import dataclass
from pathlib import Path

import boxes_on_ground as yard
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter, minimum_filter

from capture_eval.cameras import View, pixel_rays
from capture_eval.errors import ReconstructionError
from capture_eval.evaluation.surface_error import TrueScene, closest_distance, count_photos
from capture_eval.files.atomic import write_json
from capture_eval.files.colmap_workspace import map_path, read_map
from capture_eval.files.ply_files import read_ply_with_properties
from capture_eval.files.point_cloud_files import read_point_cloud, write_point_cloud
from capture_eval.stages.dense import DenseOptions, dense_workspace
from capture_eval.stages.surface import SurfaceOptions, reconstruct_surface
from capture_eval.triangle_geometry import triangle_normals

Floats = NDArray[np.float64]
BASE = 160.0  # millimetres between a camera and the next but one


@dataclass(frozen=True)
class Compared:
    """True and found depth of one photo, and which pixels three photos see at less than 70 degrees."""

    view: View
    truth: Floats
    found: Floats
    fair: NDArray[np.bool_]

    def error(self) -> Floats:
        """Error of the depth as pixels by which the point moves in the next camera but one; NaN where none is."""
        error = np.full(self.truth.shape, np.nan)
        both = (self.truth > 0) & (self.found > 0)
        moved = np.abs(1.0 / self.found[both] - 1.0 / self.truth[both])
        error[both] = moved * BASE * self.view.intrinsics.matrix[0, 0]
        return error


def _fair(view: View, truth: Floats, cameras: list[View]) -> NDArray[np.bool_]:
    vertices, triangles, _ = yard.scene()
    height, width = truth.shape
    columns, rows = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    origin, rays = pixel_rays(view, np.stack([columns.ravel(), rows.ravel()], axis=1))
    seen = np.nonzero(truth.ravel() > 0)[0]
    places = origin + rays[seen] * (truth.ravel()[seen] / (rays[seen] @ view.rotation[2]))[:, None]
    met = yard.first_triangles(view)[seen]
    normals = triangle_normals(vertices, triangles[met])
    normals *= -np.sign(np.sum(normals * rays[seen], axis=1))[:, None]  # sheets have no inside
    scene = TrueScene(vertices, triangles, len(triangles), 3000.0, cameras)
    fair = np.zeros(truth.size, np.bool_)
    fair[seen] = count_photos(places, normals, scene, steepest=70.0)[0] >= 3
    return fair.reshape(truth.shape)


@pytest.fixture(scope="module")
def reconstructed(tmp_path_factory) -> tuple[Path, list[Compared]]:
    folder = tmp_path_factory.mktemp("yard") / "workspace"
    cameras = yard.write_workspace(folder)
    dense_workspace(folder, folder / "fused.ply", DenseOptions(backend="cpu", sources=4))
    compared = []
    for view in cameras:
        truth = yard.true_depth(view)
        found = read_map(map_path(folder, "depth", view.name, "geometric")).astype(np.float64)
        compared.append(Compared(view, truth, found, _fair(view, truth, cameras)))
    return folder, compared


@pytest.mark.parametrize(("near", "far"), [(400.0, 700.0), (700.0, 1500.0), (1500.0, 3300.0)])
def test_depth_is_right_at_any_distance(reconstructed, near, far) -> None:
    errors = [item.error()[item.fair & (item.truth > near) & (item.truth <= far)] for item in reconstructed[1]]
    error = np.concatenate(errors)
    known = error[np.isfinite(error)]
    assert len(known) > 2000
    # Matching gives a few hundredths of a pixel on such contrast; an eighth of a pixel would be plain pixel rounding
    # (uniform within half a pixel, median a quarter, halved by averaging over the photos).
    assert np.median(known) < 0.06
    assert np.percentile(known, 95) < 0.25
    # What is lost lies along edges, where windows see both sides: about 4 pixels on each side of each outline.
    assert len(known) > 0.8 * len(error)


def test_nothing_bleeds_over_edges(reconstructed) -> None:
    wrong = kept = 0
    for item in reconstructed[1]:
        filled = np.where(item.truth > 0, item.truth, np.inf)
        near, touching = (minimum_filter(filled, size=size) for size in (9, 3))
        # background two to four pixels from a nearer thing: the window (9 pixels) sees both, the pixel itself does not
        behind = (item.truth > 0) & (near < 0.85 * item.truth) & (touching >= 0.85 * item.truth)
        taken = behind & (item.found > 0) & (item.found < 0.5 * (item.truth + near))
        wrong += np.count_nonzero(taken)
        kept += np.count_nonzero(behind & (item.found > 0))
    assert kept > 500  # it is not empty there
    assert wrong < 0.015 * kept  # nearer to the thing in front than to itself


def test_no_point_hangs_in_the_air(reconstructed) -> None:
    folder, compared = reconstructed
    vertices, triangles, _ = yard.scene()
    points, _ = read_point_cloud(folder / "fused.ply")
    distance = closest_distance(points, vertices, triangles)
    centre = np.mean([item.view.center for item in compared], axis=0)
    pixel = np.sum((points - centre) ** 2, axis=1) / (BASE * yard.FOCAL)  # depth by a pixel in the next camera but one
    # a point far from every surface is several of these off; half of one leaves room for the rounding of edges
    assert np.mean(distance > 0.5 * pixel) < 0.003
    assert len(points) > 50000


def test_the_plain_backdrop_stays_empty(reconstructed) -> None:
    for item in reconstructed[1]:
        backdrop = maximum_filter(item.truth, size=5) == 0  # the outline's own pixels are half scene
        assert np.count_nonzero(item.found[backdrop]) <= 0.005 * np.count_nonzero(backdrop), item.view.name


def test_upright_and_small_photos_are_as_good_as_others(reconstructed) -> None:
    """Photo 2 stands upright, photo 4 has 0.4 times the pixels of the others."""
    for item in reconstructed[1]:
        assert item.found.shape == (item.view.intrinsics.height, item.view.intrinsics.width)
        assert np.mean(item.found[item.fair] > 0) > 0.75, item.view.name
        assert np.nanmedian(item.error()[item.fair]) < 0.06, item.view.name


def test_photos_that_share_nothing_are_refused_in_a_line(reconstructed, tmp_path) -> None:
    """The same photos, but every sparse point is seen in one of them only."""
    cameras = [item.view for item in reconstructed[1]]
    points, visible = yard.sparse_points(cameras)
    alone = [seen[seen % len(cameras) == number] for number, seen in enumerate(visible)]
    yard.write_sparse_model(tmp_path / "sparse", cameras, points, alone)
    (tmp_path / "images").symlink_to(reconstructed[0] / "images")
    with pytest.raises(ReconstructionError, match="no two photos share sparse points") as caught:
        dense_workspace(tmp_path, None, DenseOptions(backend="cpu"))
    assert "\n" not in str(caught.value)


def test_a_cloud_of_another_program_becomes_a_surface(tmp_path) -> None:
    """Points and normals are all that COLMAP's fusion or OpenMVS give: nothing is claimed about uncertainty."""
    generator = np.random.default_rng(0)
    normals = generator.normal(size=(4000, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    properties = {name: normals[:, axis] for axis, name in enumerate(("nx", "ny", "nz"))}
    write_point_cloud(tmp_path / "fused.ply", 50.0 * normals, properties)
    write_json(tmp_path / "dense.json", {"status": "ok"})
    result = reconstruct_surface(tmp_path, SurfaceOptions(depth=5))
    assert result["status"] == "ok"
    assert result["deviation_quantiles"] == {}
    mesh, numbers = read_ply_with_properties(tmp_path / "scan.ply")
    assert "deviation" not in numbers
    assert np.abs(np.linalg.norm(mesh.vertices, axis=1) - 50.0).max() < 1.0  # a fifth of the octree's cells of 5
