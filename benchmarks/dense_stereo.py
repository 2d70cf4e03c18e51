"""Accuracy, completeness and cost of the dense and surface stages on synthetic captures, against truth.

    python benchmarks/dense_stereo.py CAPTURE [CAPTURE ...] [--pose pose_00] [--poses-from truth|photos|both]

For every capture the pose is reconstructed with the true cameras and with cameras solved from the photos (then the
result is brought to truth by the camera centres and a similarity ICP), and compared with the true mesh over what at
least three photos see: `head` is all of it, `face` what lies near the curves. All lengths are % of D, the largest
distance between two vertices of the neutral mesh. The table is printed and written to benchmarks/results/.
"""

import argparse
import json
import resource
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from capture_eval.cameras import View, project
from capture_eval.curves.edge_loops import edge_topology
from capture_eval.curves.extract import resolve_curves
from capture_eval.files.atomic import write_text
from capture_eval.files.camera_files import read_cameras
from capture_eval.files.colmap_files import read_sparse_model
from capture_eval.files.curve_files import read_curves
from capture_eval.files.mesh_files import read_mesh
from capture_eval.files.point_cloud_files import read_point_cloud
from capture_eval.polygon_mesh import PolygonMesh
from capture_eval.similarity import Similarity, estimate_similarity
from capture_eval.stages.dense import DenseOptions, reconstruct_dense
from capture_eval.stages.sparse import SparseOptions, reconstruct_sparse
from capture_eval.stages.surface import SurfaceOptions, reconstruct_surface
from capture_eval.triangle_geometry import diameter

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]

SAMPLES = 60000
FACE_REACH = 0.035  # of D: how far from a curve the face goes


@dataclass(frozen=True)
class Truth:
    """The true surface of one pose: mesh, D, samples with normals, which are seen and which are of the face."""

    vertices: Floats
    triangles: NDArray[np.int64]
    size: float
    samples: Floats
    normals: Floats
    seen: Flags
    face: Flags
    centers: dict[str, Floats]


def _scene(vertices: Floats, triangles: NDArray[np.int64]):
    import open3d

    scene = open3d.t.geometry.RaycastingScene()
    scene.add_triangles(vertices.astype(np.float32), triangles.astype(np.uint32))
    return scene


def distances(points: Floats, vertices: Floats, triangles: NDArray[np.int64]) -> Floats:
    """Distance of points (N, 3) to a triangle mesh."""
    closest = closest_points(points, vertices, triangles)
    return np.linalg.norm(points - closest, axis=1)


def closest_points(points: Floats, vertices: Floats, triangles: NDArray[np.int64]) -> Floats:
    """Nearest points (N, 3) of a triangle mesh."""
    found = _scene(vertices, triangles).compute_closest_points(points.astype(np.float32))
    return found["points"].numpy().astype(np.float64)


def sample_surface(vertices: Floats, triangles: NDArray[np.int64], count: int, seed: int = 0) -> tuple[Floats, Floats]:
    """Points spread evenly by area, and the normals of their triangles."""
    generator = np.random.default_rng(seed)
    corners = vertices[triangles]
    area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = np.linalg.norm(area, axis=1)
    chosen = generator.choice(len(triangles), count, p=size / size.sum())
    first, second = np.sqrt(generator.random(count)), generator.random(count)
    weights = np.stack([1 - first, first * (1 - second), first * second], axis=1)
    points = np.einsum("nk,nkd->nd", weights, corners[chosen])
    return points, area[chosen] / np.maximum(size[chosen], 1e-300)[:, None]


def count_views(points: Floats, normals: Floats, views: list[View], scene) -> NDArray[np.int64]:
    """How many photos see each point at less than 78 degrees."""
    total = np.zeros(len(points), np.int64)
    for view in views:
        pixels, depth = project(view, points)
        ray = points - view.center
        length = np.linalg.norm(ray, axis=1)
        facing = -np.sum(ray * normals, axis=1) / length > np.cos(np.radians(78.0))
        size = (view.intrinsics.width, view.intrinsics.height)
        inside = (depth > 0) & np.all((pixels > 2) & (pixels < np.array(size) - 2), axis=1)
        rays = np.concatenate([np.broadcast_to(view.center, points.shape), ray / length[:, None]], axis=1)
        hit = scene.cast_rays(rays.astype(np.float32))["t_hit"].numpy()
        total += inside & facing & (hit > length * (1 - 1e-4) - 0.05)
    return total


def read_truth(capture: Path, pose: str) -> Truth:
    """True surface of a pose of a synthetic capture."""
    arrays = np.load(capture / "truth" / "truth.npz")
    mesh = read_mesh(capture / "truth" / "mesh.obj")
    index = sorted(path.name for path in (capture / "photos").iterdir()).index(pose)
    vertices = np.asarray(arrays["vertices"][index], dtype=np.float64)
    size = diameter(np.asarray(arrays["vertices"][0], dtype=np.float64))
    triangles = PolygonMesh(vertices, mesh.face_offsets, mesh.face_vertices).triangles()[0]
    samples, normals = sample_surface(vertices, triangles, SAMPLES)
    views = read_cameras(capture / "truth" / "cameras.json")[pose]
    seen = count_views(samples, normals, views, _scene(vertices, triangles)) >= 3
    near = _curve_vertices(capture, mesh)
    face = seen & (cKDTree(vertices[near]).query(samples)[0] < FACE_REACH * size)
    return Truth(vertices, triangles, size, samples, normals, seen, face, {v.name: v.center for v in views})


def _curve_vertices(capture: Path, mesh: PolygonMesh) -> NDArray[np.int64]:
    curves = resolve_curves(read_curves(capture / "curves.yaml"), edge_topology(mesh))
    return np.unique(np.concatenate([curve.vertices for curve in curves]))


def truth_from_model(folder: Path, truth: Truth, scan: PolygonMesh, known: bool) -> Similarity:
    """Similarity from the frame of the reconstruction to truth: camera centres, then ICP on what is seen."""
    if known:
        return Similarity(1.0, np.eye(3), np.zeros(3))
    views = read_sparse_model(folder / "sparse").views
    names = [name for name in views if name in truth.centers]
    transform = estimate_similarity(
        np.array([views[name].center for name in names]), np.array([truth.centers[name] for name in names])
    )
    triangles = scan.triangles()[0]
    target = truth.samples[truth.seen][::3]
    for _ in range(25):
        moved = transform.apply(scan.vertices)
        closest = closest_points(target, moved, triangles)
        gap = np.linalg.norm(closest - target, axis=1)
        good = gap <= np.quantile(gap, 0.9)
        transform = estimate_similarity(closest[good], target[good]).compose(transform)
    return transform


def quantiles(values: Floats, shares: tuple[int, ...]) -> str:
    """Text of percentiles."""
    return "/".join(f"{np.percentile(values, share):.3f}".lstrip("0") for share in shares) if len(values) else "-"


def measure(folder: Path, truth: Truth, known: bool) -> dict[str, dict[str, str]]:
    """Figures of fused.ply and scan.ply for head and face, in % of D."""
    points, _ = read_point_cloud(folder / "fused.ply")
    scan = read_mesh(folder / "scan.ply")
    transform = truth_from_model(folder, truth, scan, known)
    points, vertices = transform.apply(points), transform.apply(scan.vertices)
    percent = 100.0 / truth.size
    tree = cKDTree(truth.samples)
    cloud_gap = distances(points, truth.vertices, truth.triangles) * percent
    mesh_gap = distances(vertices, truth.vertices, truth.triangles) * percent
    cloud_place, mesh_place = tree.query(points)[1], tree.query(vertices)[1]
    to_cloud = cKDTree(points).query(truth.samples)[0] * percent
    to_mesh = distances(truth.samples, vertices, scan.triangles()[0]) * percent
    result = {}
    for name, region in (("head", truth.seen), ("face", truth.face)):
        inside = to_mesh[region]
        result[name] = {
            "points": f"{np.count_nonzero(region[cloud_place]):d}",
            "accuracy 50/90/95": quantiles(cloud_gap[region[cloud_place]], (50, 90, 95)),
            "complete <.1/<.3": "/".join(f"{np.mean(to_cloud[region] < limit):.3f}" for limit in (0.1, 0.3)),
            "truth->mesh 50/90/95/99": quantiles(inside, (50, 90, 95, 99)),
            "rms": f"{np.sqrt(np.mean(inside**2)):.3f}",
            "mesh->truth 50/90/95/99": quantiles(mesh_gap[region[mesh_place]], (50, 90, 95, 99)),
        }
    return result


def reconstruct(capture: Path, pose: str, folder: Path, known: bool, dense: DenseOptions, surface: SurfaceOptions):
    """Run the three stages; CPU seconds of dense and surface."""
    photos = sorted((capture / "photos" / pose).glob("*.jpg"))
    cameras = capture / "truth" / "cameras.json" if known else None
    if not (folder / "sparse.json").exists():
        reconstruct_sparse(photos, folder, SparseOptions(known_cameras=cameras))
    start = time.process_time()
    reconstruct_dense(folder, dense)
    middle = time.process_time()
    reconstruct_surface(folder, surface)
    return len(photos), middle - start, time.process_time() - middle


def table(rows: list[dict[str, str]]) -> str:
    """Markdown table of equal rows."""
    names = list(rows[0])
    widths = {name: max(len(name), *(len(row[name]) for row in rows)) for name in names}
    lines = ["| " + " | ".join(name.ljust(widths[name]) for name in names) + " |"]
    lines += ["|" + "|".join("-" * (widths[name] + 2) for name in names) + "|"]
    lines += ["| " + " | ".join(row[name].ljust(widths[name]) for name in names) + " |" for row in rows]
    return "\n".join(lines) + "\n"


def main() -> None:
    """Reconstruct, measure, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("captures", nargs="+", type=Path)
    parser.add_argument("--pose", default="pose_00")
    parser.add_argument("--poses-from", choices=("truth", "photos", "both"), default="both")
    parser.add_argument("--work", type=Path, help="keep the reconstructions here (default: a temporary folder)")
    parser.add_argument("--fusion", choices=("own", "colmap"), default="own")
    arguments = parser.parse_args()
    rows: list[dict[str, str]] = []
    with tempfile.TemporaryDirectory() as temporary:
        root = arguments.work or Path(temporary)
        for capture in arguments.captures:
            truth = read_truth(capture, arguments.pose)
            for known in (True, False):
                if arguments.poses_from != "both" and known != (arguments.poses_from == "truth"):
                    continue
                folder = root / capture.name / ("true" if known else "solved") / arguments.pose
                folder.mkdir(parents=True, exist_ok=True)
                options = DenseOptions(fusion=arguments.fusion)
                photos, dense, surface = reconstruct(capture, arguments.pose, folder, known, options, SurfaceOptions())
                figures = measure(folder, truth, known)
                for region, values in figures.items():
                    rows.append(
                        {
                            "capture": capture.name,
                            "poses": "true" if known else "solved",
                            "region": region,
                            "dense CPU s/photo": f"{dense / photos:.2f}",
                            "surface CPU s": f"{surface:.1f}",
                            **values,
                        }
                    )
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024**2
    text = table(rows) + f"\nLengths in % of D. Peak memory {peak:.2f} GB. Fusion: {arguments.fusion}.\n"
    print(text)
    write_text(Path(__file__).parent / "results" / "dense_stereo.md", text)
    print(json.dumps({"written": "benchmarks/results/dense_stereo.md"}))


if __name__ == "__main__":
    main()
