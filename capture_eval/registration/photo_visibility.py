"""Which points of a mesh are seen in which photo, by depth buffers of the photos' size."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from capture_eval.cameras import View
from capture_eval.errors import InputError
from capture_eval.triangle_geometry import vertex_normals

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Blockers = tuple[NDArray[np.float64], NDArray[np.int64]]

# Points within this share of the mesh's extent behind the nearest surface count as being it: 0.4 mm on a head.
DEPTH_TOLERANCE = 0.0012


def camera_numbers(view: View) -> Floats:
    """A view as 21 numbers for the compiled loops: R, t, fx, fy, cx, cy, k1, k2, p1, p2, skew."""
    matrix = view.intrinsics.matrix
    calibration = [matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]]
    return np.concatenate(
        [view.rotation.ravel(), view.translation, calibration, view.intrinsics.distortion, matrix[0, 1:2]]
    )


def depth_tolerance(vertices: Floats) -> float:
    """Slack of the depth test in the frame's units."""
    return DEPTH_TOLERANCE * float(np.linalg.norm(np.ptp(vertices, axis=0)))


def depth_image(
    view: View, vertices: Floats, triangles: Integers, occluders: Blockers | None = None
) -> NDArray[np.float32]:
    """Depth (H, W) of the nearest surface at every pixel's centre, infinite where there is none.

    ``occluders`` are the (vertices, triangles) of things that hide the skin without being part of it.
    """
    from capture_eval.registration import texture_kernels

    camera = camera_numbers(view)
    buffer = np.full((view.intrinsics.height, view.intrinsics.width), np.inf, dtype=np.float32)
    texture_kernels.depth_buffer(camera, np.ascontiguousarray(vertices), np.ascontiguousarray(triangles), buffer)
    if occluders is not None and len(occluders[1]):
        texture_kernels.depth_buffer(
            camera, np.ascontiguousarray(occluders[0]), np.ascontiguousarray(occluders[1]), buffer
        )
    return buffer


def clear_of_edges(
    view: View, vertices: Floats, triangles: Integers, occluders: Blockers | None, margin: int
) -> NDArray[np.float32]:
    """Depth image (H, W) in which pixels within ``margin`` of an occluding edge show nothing (minus infinity).

    An edge is where a line of depths bends by more than two pixels' width (a smooth surface does not, even
    when it is steep), where the skin ends, or where an occluder begins. Photos mix two surfaces there, and the
    dark line between two lips is no detail of either.
    """
    import cv2

    if margin == 0:
        return depth_image(view, vertices, triangles, occluders)
    skin = depth_image(view, vertices, triangles)
    everything = skin.copy()
    if occluders is not None and len(occluders[1]):
        from capture_eval.registration import texture_kernels

        texture_kernels.depth_buffer(
            camera_numbers(view), np.ascontiguousarray(occluders[0]), np.ascontiguousarray(occluders[1]), everything
        )
    known = np.isfinite(skin)
    if not known.any():
        return everything
    far = float(skin[known].max()) * 2.0
    depth = np.where(known, skin, far)
    limit = 2.0 * float(np.median(skin[known])) / float(view.intrinsics.matrix[0, 0])
    edge = everything < skin
    edge[:, 1:-1] |= np.abs(depth[:, :-2] - 2.0 * depth[:, 1:-1] + depth[:, 2:]) > limit
    edge[1:-1] |= np.abs(depth[:-2] - 2.0 * depth[1:-1] + depth[2:]) > limit
    window = np.ones((2 * margin + 1, 2 * margin + 1), dtype=np.uint8)
    everything[cv2.dilate(edge.astype(np.uint8), window) > 0] = -np.inf
    return everything


def visible_points(
    view: View, depth: NDArray[np.float32], points: Floats, normals: Floats, minimum_cosine: float, tolerance: float
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Cosine of incidence (M,), 0 where ``view`` does not see the point, and its pixel (M, 2).

    A point is seen where it faces the camera and none of the four pixels around it shows something nearer:
    points beside a silhouette count as hidden, since their pixels mix two surfaces.
    """
    from capture_eval.registration import texture_kernels

    cosine, pixel = texture_kernels.visible_points(
        camera_numbers(view), depth, points, normals, minimum_cosine, tolerance
    )
    return cosine, pixel


def vertex_cosines(
    vertices: Floats,
    triangles: Integers,
    views: Sequence[View],
    occluders: Blockers | None = None,
    minimum_cosine: float = 0.15,
) -> NDArray[np.float32]:
    """Cosine of incidence of every vertex in every view, (views, V); 0 where it is not seen.

    Raises
    ------
    InputError
        Shapes that do not fit.
    """
    if vertices.ndim != 2 or vertices.shape[1] != 3 or triangles.ndim != 2 or triangles.shape[1] != 3:
        raise InputError(f"visibility: vertices {vertices.shape} and triangles {triangles.shape}")
    normals = vertex_normals(vertices, triangles)
    tolerance = depth_tolerance(vertices)
    result = np.zeros((len(views), len(vertices)), dtype=np.float32)
    for row, view in enumerate(views):
        depth = depth_image(view, vertices, triangles, occluders)
        result[row] = visible_points(view, depth, vertices, normals, minimum_cosine, tolerance)[0]
    return result


def count_seen(
    vertices: Floats,
    triangles: Integers,
    views: Sequence[View],
    occluders: Blockers | None = None,
    minimum_cosine: float = 0.15,
) -> NDArray[np.int64]:
    """Number of photos that see each vertex, (V,) int64.

    Parameters
    ----------
    vertices : (V, 3) float64
    triangles : (K, 3) int64
    views : sequence of View
        In the frame of ``vertices``.
    occluders : (vertices, triangles), optional
        Eyes, teeth and tongue, in the same frame.
    minimum_cosine : float
        Least cosine between the normal and the direction to the camera.
    """
    cosines = vertex_cosines(vertices, triangles, views, occluders, minimum_cosine)
    return np.asarray(np.count_nonzero(cosines > 0, axis=0), dtype=np.int64)
