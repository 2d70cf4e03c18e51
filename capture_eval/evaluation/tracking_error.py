"""Registered meshes against known truth: does the skin's point stay the skin's point?

Tracking error: the distance, in pose k, between a registered vertex and the true place of the skin point that it
sits on in the neutral. All arrays are in the frame of the truth.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from capture_eval.errors import InputError
from capture_eval.registration.surface_correspondence import Surface
from capture_eval.similarity import Similarity
from capture_eval.triangle_geometry import triangle_normals, unique_edges, vertex_normals

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Booleans = NDArray[np.bool_]

_CANDIDATES = 32
_CHUNK = 1024


@dataclass(frozen=True)
class SkinPoints:
    """Points of a true mesh that registered vertices sit on.

    Parameters
    ----------
    triangle : (V,) int64
    barycentric : (V, 3) float64
    """

    triangle: Integers
    barycentric: Floats

    def places(self, vertices: Floats, triangles: Integers) -> Floats:
        """Where they are on a true mesh of the same topology, (V, 3)."""
        corners = vertices[triangles[self.triangle]]
        return np.asarray(np.einsum("vk,vki->vi", self.barycentric, corners), dtype=np.float64)


@dataclass(frozen=True)
class TrackingError:
    """Errors of one pose, all (V,) in the unit of the truth.

    Parameters
    ----------
    total : distance to the true place of the skin point.
    normal : signed part along the true normal (positive outside).
    tangential : part within the surface.
    relative : total without the vertex's own offset in the neutral, turned with the skin.
    surface : distance to the nearest point of the true surface.
    """

    total: Floats
    normal: Floats
    tangential: Floats
    relative: Floats
    surface: Floats


def closest_on_triangles(points: Floats, corners: Floats) -> tuple[Floats, Floats]:
    """Exact closest points: barycentric (N, 3) and distance (N,) of points (N, 3) to triangles (N, 3, 3).

    Inside of the triangle's prism the projection counts, else the best of the three edges (Ericson 2005, 5.1.5).
    """
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    offset = points - corners[:, 0]
    aa, ab, bb = (np.sum(x * y, axis=1) for x, y in ((first, first), (first, second), (second, second)))
    ap, bp = np.sum(first * offset, axis=1), np.sum(second * offset, axis=1)
    determinant = np.maximum(aa * bb - ab * ab, 1e-300)
    u, v = (bb * ap - ab * bp) / determinant, (aa * bp - ab * ap) / determinant
    best = np.stack([1.0 - u - v, u, v], axis=1)
    inside = np.all(best >= 0.0, axis=1)
    distance = np.where(inside, _distance(points, corners, best), np.inf)
    for start in range(3):
        end = (start + 1) % 3
        along = corners[:, end] - corners[:, start]
        length = np.maximum(np.sum(along**2, axis=1), 1e-300)
        share = np.clip(np.sum((points - corners[:, start]) * along, axis=1) / length, 0.0, 1.0)
        weights = np.zeros_like(best)
        weights[:, start], weights[:, end] = 1.0 - share, share
        edge_distance = _distance(points, corners, weights)
        nearer = edge_distance < distance
        best[nearer], distance[nearer] = weights[nearer], edge_distance[nearer]
    return best, distance


def _distance(points: Floats, corners: Floats, weights: Floats) -> Floats:
    return np.asarray(np.linalg.norm(points - np.einsum("nk,nki->ni", weights, corners), axis=1), dtype=np.float64)


def nearest_on_mesh(
    points: Floats, vertices: Floats, triangles: Integers, normals: Floats | None = None, minimum_cosine: float = 0.3
) -> tuple[SkinPoints, Floats]:
    """Nearest point of a mesh to each point, and its distance.

    Parameters
    ----------
    points : (N, 3)
    normals : (N, 3), optional
        Only triangles whose normals agree with these are looked at, as long as there are any nearby: the plain
        nearest point of an upper lip may lie on the lower one.
    """
    corners = vertices[triangles]
    count = min(_CANDIDATES, len(triangles))
    faces = triangle_normals(vertices, triangles)
    tree = cKDTree(corners.mean(axis=1))
    index = np.asarray(tree.query(points, count)[1]).reshape(len(points), count)
    triangle = np.zeros(len(points), dtype=np.int64)
    barycentric = np.zeros((len(points), 3))
    distance = np.zeros(len(points))
    for start in range(0, len(points), _CHUNK):
        rows = slice(start, min(start + _CHUNK, len(points)))
        block = index[rows]
        weights, length = closest_on_triangles(np.repeat(points[rows], count, axis=0), corners[block.ravel()])
        length = length.reshape(block.shape)
        if normals is not None:
            agree = np.einsum("nci,ni->nc", faces[block], normals[rows]) > minimum_cosine
            length = np.where(agree | ~agree.any(axis=1, keepdims=True), length, np.inf)
        best = np.argmin(length, axis=1)
        lines = np.arange(len(block))
        triangle[rows] = block[lines, best]
        barycentric[rows] = weights.reshape(*block.shape, 3)[lines, best]
        distance[rows] = length[lines, best]
    return SkinPoints(triangle, barycentric), distance


def skin_points(
    registered_neutral: Floats,
    registered_triangles: Integers,
    true_neutral: Floats,
    true_triangles: Integers,
    anchors: Integers | None = None,
    rings: int = 4,
) -> SkinPoints:
    """Skin point under each registered vertex in the neutral.

    Parameters
    ----------
    registered_neutral : (V, 3)
    registered_triangles : (K, 3)
        Topology of the registration, for its normals.
    true_neutral : (W, 3)
    true_triangles : (L, 3)
    anchors : (V,) int, optional
        True vertex near each registered one (the vertex itself when both share a topology). The search then
        stays within `rings` edges of it; without anchors, among triangles whose normals agree.
    """
    if anchors is None:
        normals = vertex_normals(registered_neutral, registered_triangles)
        return nearest_on_mesh(registered_neutral, true_neutral, true_triangles, normals)[0]
    if anchors.shape != (len(registered_neutral),):
        raise InputError(f"tracking error: anchors {anchors.shape} for {len(registered_neutral)} vertices")
    reach = _triangles_within(true_triangles, len(true_neutral), rings)[anchors]
    rows, candidates = reach.nonzero()
    order = np.argsort(rows, kind="stable")
    rows = np.asarray(rows[order], dtype=np.int64)
    candidates = candidates[order].astype(np.int64)
    weights, distance = closest_on_triangles(registered_neutral[rows], true_neutral[true_triangles[candidates]])
    best = np.lexsort((candidates, distance, rows))
    first = np.asarray(best)[np.flatnonzero(np.diff(rows[best], prepend=-1))]
    if len(first) != len(registered_neutral):
        raise InputError("tracking error: some anchors are vertices without triangles")
    return SkinPoints(np.asarray(candidates[first], dtype=np.int64), weights[first])


def _triangles_within(triangles: Integers, count: int, rings: int) -> sparse.csr_matrix:
    """Which triangles touch a vertex within so many edges of a vertex, (V, K) boolean."""
    edges = unique_edges(triangles)
    ones = np.ones(len(edges), dtype=bool)
    adjacency = sparse.csr_matrix((ones, (edges[:, 0], edges[:, 1])), shape=(count, count))
    step = adjacency + adjacency.T + sparse.identity(count, dtype=bool)
    reach = sparse.identity(count, dtype=bool, format="csr")
    for _ in range(rings):
        reach = (reach @ step) > 0
    columns = np.repeat(np.arange(len(triangles)), 3)
    touch = sparse.csr_matrix(
        (np.ones(len(columns), dtype=bool), (triangles.ravel(), columns)), shape=(count, len(triangles))
    )
    return sparse.csr_matrix((reach @ touch) > 0)


def tracking_error(
    registered: Floats,
    registered_neutral: Floats,
    points: SkinPoints,
    true_vertices: Floats,
    true_neutral: Floats,
    true_triangles: Integers,
) -> TrackingError:
    """Errors of one pose.

    Parameters
    ----------
    registered, registered_neutral : (V, 3)
        Registered vertices in the pose and in the neutral.
    points : SkinPoints
        What the registered vertices sit on in the neutral.
    true_vertices, true_neutral : (W, 3)
    true_triangles : (L, 3)
    """
    place = points.places(true_vertices, true_triangles)
    difference = registered - place
    frames = _frames(true_vertices, true_triangles, points)
    neutral_frames = _frames(true_neutral, true_triangles, points)
    normal = np.sum(difference * frames[:, :, 2], axis=1)
    tangential = np.linalg.norm(difference - normal[:, None] * frames[:, :, 2], axis=1)
    own = registered_neutral - points.places(true_neutral, true_triangles)
    turned = np.einsum("vij,vkj,vk->vi", frames, neutral_frames, own)
    relative = np.linalg.norm(difference - turned, axis=1)
    nearest = Surface(true_vertices, true_triangles).closest(registered).points
    surface = np.linalg.norm(registered - nearest, axis=1)
    return TrackingError(np.linalg.norm(difference, axis=1), normal, tangential, relative, surface)


def _frames(vertices: Floats, triangles: Integers, points: SkinPoints) -> Floats:
    """Orthonormal frame of the skin at each point: along the first edge, across, normal; (V, 3, 3) in columns."""
    corners = vertices[triangles[points.triangle]]
    along = corners[:, 1] - corners[:, 0]
    along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-300)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    return np.stack([along, np.cross(normal, along), normal], axis=2)


def refine_similarity_by_surface(
    source: Floats,
    source_triangles: Integers,
    target: Floats,
    target_triangles: Integers,
    use: Booleans,
    start: Similarity,
    steps: int = 12,
) -> Similarity:
    """Seven-parameter point-to-plane ICP of a mesh to the true neutral: `target_from_source`.

    Tukey weights with a limit of six times the median distance keep unmatched parts out.

    Parameters
    ----------
    use : (V,) bool
        Vertices of the source that take part: the face that photos see.
    """
    if np.count_nonzero(use) < 20:
        raise InputError(f"alignment to the truth: {np.count_nonzero(use)} seen vertices, at least 20 are needed")
    fit = start
    rows = np.flatnonzero(use)
    surface = Surface(target, target_triangles)
    faces = triangle_normals(target, target_triangles)
    for _ in range(steps):
        moved = fit.apply(source)
        normals = vertex_normals(moved, source_triangles)[rows]
        closest = surface.closest(moved[rows])
        distance = np.linalg.norm(moved[rows] - closest.points, axis=1)
        limit = 6.0 * max(float(np.median(distance)), 1e-9)
        face_normals = faces[closest.triangle]
        agree = np.sum(face_normals * normals, axis=1) > 0.3
        weight = np.where(agree, np.maximum(1.0 - (distance / limit) ** 2, 0.0) ** 2, 0.0)
        step = _similarity_step(moved[rows], closest.points, face_normals, weight)
        fit = step.compose(fit)
    return fit


def _similarity_step(points: Floats, places: Floats, normals: Floats, weight: Floats) -> Similarity:
    """Linearised weighted point-to-plane step in rotation, translation and scale about the centre."""
    centre = np.average(points, axis=0, weights=weight)
    local = points - centre
    size = float(np.sqrt(np.average(np.sum(local**2, axis=1), weights=weight)))
    columns = [np.cross(local / size, normals), normals, np.sum(local / size * normals, axis=1)[:, None]]
    matrix = np.concatenate(columns, axis=1)
    right = np.sum((places - points) * normals, axis=1)
    root = np.sqrt(weight)
    solution = np.linalg.lstsq(matrix * root[:, None], right * root, rcond=None)[0]
    turn = solution[:3] / size
    angle = float(np.linalg.norm(turn))
    axis = turn / angle if angle > 0 else np.array([1.0, 0.0, 0.0])
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    rotation = np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * (cross @ cross)
    scale = 1.0 + solution[6] / size
    return Similarity(scale, rotation, centre + solution[3:6] - scale * (rotation @ centre))
