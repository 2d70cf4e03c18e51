"""From a fused cloud to a clean surface: lone points out, Poisson, trimming by distance, largest part, small holes.

Poisson reconstruction (Kazhdan, Hoppe, "Screened Poisson Surface Reconstruction", 2013) closes what was never seen
with smooth flaps.  Cutting by point density leaves them at jaw and neck; cutting by distance to the cloud does not.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from capture_eval.errors import InputError, ReconstructionError
from capture_eval.triangle_geometry import vertex_normals

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

_NEAREST = 8  # points that tell the uncertainty of a vertex
_USUAL_GAP = 2.0  # spacings: their mean distance where the cloud is dense
_GUESS = 0.6  # error of the closed surface as a share of the gap (found on a head of known shape)


@dataclass(frozen=True)
class SurfaceOptions:
    """How a cloud becomes a surface; lengths are shares of the cloud's size (robust diagonal).

    Attributes
    ----------
    depth : int
        Depth of Poisson's octree; 0 chooses the cell closest to `cells_per_spacing` times the point spacing.
    cells_per_spacing : float
    lone_neighbours, lone_ratio : int, float
        A point is dropped when its mean distance to so many neighbours exceeds the median of all points so many
        times. Thinly covered places, twice or three times as wide as the rest, stay.
    trim : float
        Vertices farther than this from the cloud are cut.
    largest_hole : float
        Longest rim of a hole that is closed.
    smallest_part : float
        Share of the triangles below which a separate part is dropped; the largest part always stays. 1 keeps it alone.
    threads : int
        More than one makes Poisson's result differ from run to run.
    """

    depth: int = 0
    cells_per_spacing: float = 3.2
    lone_neighbours: int = 16
    lone_ratio: float = 3.0
    trim: float = 0.009
    largest_hole: float = 0.04
    smallest_part: float = 1.0
    threads: int = 1


@dataclass(frozen=True)
class Surface:
    """A triangle mesh with what is known about each vertex.

    Parameters
    ----------
    vertices, triangles, normals : (V, 3), (T, 3), (V, 3)
    support : (V,)
        Worth of the points nearby.
    deviation : (V,)
        Standard deviation along the normal, unit of the points; NaN where the points carry none.
    """

    vertices: Floats
    triangles: Integers
    normals: Floats
    support: Floats
    deviation: Floats


def robust_size(points: Floats) -> float:
    """Length of the diagonal of the box that holds 98 % of the points along every axis."""
    low, high = np.percentile(points, [1.0, 99.0], axis=0)
    return float(np.linalg.norm(high - low))


def point_spacing(points: Floats) -> float:
    """Median distance of a point to its nearest neighbour."""
    sample = points[:: max(1, len(points) // 5000)]
    distances, _ = cKDTree(points).query(sample, k=2)
    return float(np.median(np.asarray(distances)[:, 1]))


def octree_depth(size: float, spacing: float, cells_per_spacing: float) -> int:
    """Depth whose cell is closest to `cells_per_spacing` times the spacing, 6 to 11.

    Open3D's octree spans 1.1 times the longest side of the bounding box.
    """
    return int(np.clip(np.rint(np.log2(1.1 * size / (cells_per_spacing * spacing))), 6, 11))


def without_lone_points(points: Floats, neighbours: int, ratio: float) -> NDArray[np.bool_]:
    """Which points (N,) are not `ratio` times farther from their neighbours than is usual (after Rusu et al. 2008)."""
    if len(points) <= neighbours:
        return np.ones(len(points), np.bool_)
    distances, _ = cKDTree(points).query(points, k=neighbours + 1)
    mean = np.asarray(distances)[:, 1:].mean(axis=1)
    return np.asarray(mean <= ratio * np.median(mean))


def poisson_surface(points: Floats, normals: Floats, depth: int, threads: int) -> tuple[Floats, Integers]:
    """Screened Poisson surface, vertices (V, 3) and triangles (T, 3).

    Raises
    ------
    ReconstructionError
        The cloud gives no surface.
    """
    import open3d

    open3d.utility.set_verbosity_level(open3d.utility.VerbosityLevel.Error)
    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points))
    cloud.normals = open3d.utility.Vector3dVector(normals)
    mesh, _ = open3d.geometry.TriangleMesh.create_from_point_cloud_poisson(cloud, depth=depth, n_threads=threads)
    if len(mesh.triangles) == 0:
        raise ReconstructionError(f"{len(points)} points gave no Poisson surface; more photos or texture are needed")
    return np.asarray(mesh.vertices, dtype=np.float64).copy(), np.asarray(mesh.triangles, dtype=np.int64).copy()


def keep_vertices(vertices: Floats, triangles: Integers, kept: NDArray[np.bool_]) -> tuple[Floats, Integers]:
    """The mesh without the vertices that are not `kept` and the triangles that use them."""
    inside = triangles[np.all(kept[triangles], axis=1)]
    used = np.zeros(len(vertices), np.bool_)
    used[inside.ravel()] = True
    number = np.cumsum(used) - 1
    return vertices[used], np.asarray(number[inside], dtype=np.int64)


def largest_parts(vertices: Floats, triangles: Integers, smallest_part: float) -> tuple[Floats, Integers]:
    """Parts whose share of the triangles is at least `smallest_part`; the largest always stays."""
    edges = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]]])
    graph = coo_matrix((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), shape=(len(vertices), len(vertices)))
    _, labels = connected_components(graph, directed=False)
    sizes = np.bincount(labels[triangles[:, 0]], minlength=labels.max() + 1)
    good = sizes >= smallest_part * len(triangles)
    good[np.argmax(sizes)] = True
    return keep_vertices(vertices, triangles, good[labels])


def repair(vertices: Floats, triangles: Integers, largest_hole_edges: int) -> tuple[Floats, Integers]:
    """Remove duplicates, null triangles and non-manifold places, close holes of few edges (PyMeshLab)."""
    import pymeshlab

    meshes = pymeshlab.MeshSet(verbose=False)
    meshes.add_mesh(pymeshlab.Mesh(vertices, triangles.astype(np.int32)))
    meshes.meshing_remove_duplicate_vertices()
    meshes.meshing_remove_duplicate_faces()
    meshes.meshing_remove_null_faces()
    meshes.meshing_repair_non_manifold_edges()
    meshes.meshing_repair_non_manifold_vertices()
    if largest_hole_edges >= 3:
        meshes.meshing_close_holes(maxholesize=largest_hole_edges, selfintersection=True)
    meshes.meshing_remove_unreferenced_vertices()
    mesh = meshes.current_mesh()
    return np.asarray(mesh.vertex_matrix(), dtype=np.float64), np.asarray(mesh.face_matrix(), dtype=np.int64)


def surface_from_cloud(
    points: Floats, normals: Floats, weight: Floats, options: SurfaceOptions, deviation: Floats | None = None
) -> Surface:
    """The cleaned surface of a cloud.

    Parameters
    ----------
    points, normals : (N, 3)
    weight : (N,)
        Worth of a point, summed into the support of the vertices near it (1 for plain counts).
    deviation : (N,), optional
        Standard deviation of the points along their normals.

    Returns
    -------
    Surface
        In the frame of the points; `support` is the number (or worth) of points within one trim distance.

    Raises
    ------
    InputError
        Shapes differ.
    ReconstructionError
        Fewer than 100 points, or nothing is left after trimming.
    """
    if points.shape != normals.shape or len(weight) != len(points):
        raise InputError(f"surface: points {points.shape}, normals {normals.shape}, weight {weight.shape}")
    if len(points) < 100:
        raise ReconstructionError(f"the cloud has only {len(points)} points, a surface needs at least 100")
    kept = without_lone_points(points, options.lone_neighbours, options.lone_ratio)
    points, normals, weight = points[kept], normals[kept], weight[kept]
    deviation = np.full(len(points), np.nan) if deviation is None else deviation[kept]
    size = robust_size(points)
    spacing = point_spacing(points)
    extent = float(np.max(points.max(axis=0) - points.min(axis=0)))
    depth = options.depth or octree_depth(extent, spacing, options.cells_per_spacing)
    vertices, triangles = poisson_surface(points, normals, depth, options.threads)
    tree = cKDTree(points)
    near, _ = tree.query(vertices, distance_upper_bound=options.trim * size)
    vertices, triangles = keep_vertices(vertices, triangles, np.isfinite(near))
    if len(triangles) == 0:
        raise ReconstructionError(f"no Poisson vertex lies within {options.trim:.3g} of the cloud's size of a point")
    vertices, triangles = largest_parts(vertices, triangles, options.smallest_part)
    edge = float(np.median(np.linalg.norm(vertices[triangles[:, 0]] - vertices[triangles[:, 1]], axis=1)))
    vertices, triangles = repair(vertices, triangles, int(options.largest_hole * size / max(edge, 1e-300)))
    vertices, triangles = largest_parts(vertices, triangles, options.smallest_part)
    support = vertex_support(tree, weight, vertices, 0.5 * options.trim * size)
    uncertain = vertex_deviation(tree, deviation, vertices, spacing)
    return Surface(vertices, triangles, vertex_normals(vertices, triangles), support, uncertain)


def vertex_support(tree: cKDTree, weight: Floats, vertices: Floats, radius: float) -> Floats:
    """Worth of the points within `radius` of every vertex, (V,)."""
    distances, neighbours = tree.query(vertices, k=32, distance_upper_bound=radius)
    padded = np.append(weight, 0.0)
    return np.asarray(np.where(np.isfinite(distances), padded[neighbours], 0.0).sum(axis=1))


def vertex_deviation(tree: cKDTree, deviation: Floats, vertices: Floats, spacing: float) -> Floats:
    """Standard deviation (V,) of vertices: root mean square of the nearest points', more where these are far.

    Beyond the reach of the points the surface is Poisson's guess, which may be off by a share of the gap.
    """
    distances, neighbours = (np.asarray(found) for found in tree.query(vertices, k=range(1, _NEAREST + 1)))
    near = np.mean(deviation[neighbours] ** 2, axis=1)
    gap = np.maximum(distances.mean(axis=1) - _USUAL_GAP * spacing, 0.0)
    return np.asarray(np.sqrt(near + (_GUESS * gap) ** 2))
