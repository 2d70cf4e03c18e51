"""Texture atlas: which triangle, and which point of it, every texel of a UV layout shows."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capture_eval.errors import InputError

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


@dataclass(frozen=True)
class TextureAtlas:
    """Texels of a square UV layout.

    Row 0 is the top of the picture: the centre of texel ``(row, column)`` lies at
    ``u = (column + 0.5) / size``, ``v = 1 - (row + 0.5) / size``.

    Parameters
    ----------
    triangle : (S, S) int32
        Triangle that covers the centre of the texel, -1 where none does.
    barycentric : (S, S, 3) float32
        Weights of the triangle's three corners at the texel's centre; zero outside of the charts.
    border_distance : (S, S) float32
        Distance in texels to the nearest texel that is outside of the texel's chart; 0 outside of all charts
        and where two charts touch.
    overlap : float
        Share of the covered texels that more than one triangle covers (the first one keeps them).
    """

    triangle: NDArray[np.int32]
    barycentric: NDArray[np.float32]
    border_distance: NDArray[np.float32]
    overlap: float = 0.0

    @property
    def size(self) -> int:
        """Texels along one side."""
        return int(self.triangle.shape[0])

    def covered(self) -> tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.float32]]:
        """Texels inside of the charts, row by row: flat index (M,), triangle (M,), barycentric (M, 3)."""
        flat = np.flatnonzero(self.triangle >= 0)
        return flat, self.triangle.reshape(-1)[flat], self.barycentric.reshape(-1, 3)[flat]


def rasterise_atlas(corner_uv: Floats, size: int) -> TextureAtlas:
    """Rasterise the triangles of a UV layout with the top-left rule in whole numbers of 1/4096 texel.

    A texel whose centre lies on an edge that two triangles share belongs to exactly one of them.

    Parameters
    ----------
    corner_uv : (K, 3, 2) float64
        Texture coordinates of every triangle corner in [0, 1], v upwards as in OBJ files.
    size : int
        Texels along one side of the square atlas.

    Raises
    ------
    InputError
        Wrong shape, coordinates outside of [0, 1] or not finite, or a size below 8 or above 16384.
    """
    from capture_eval.registration import texture_kernels

    corners = np.asarray(corner_uv, dtype=np.float64)
    if corners.ndim != 3 or corners.shape[1:] != (3, 2):
        raise InputError(f"texture atlas: corner coordinates {corners.shape}, expected (triangles, 3, 2)")
    if not 8 <= size <= 16384:
        raise InputError(f"texture atlas: size {size}, expected 8 to 16384 texels")
    if not np.all(np.isfinite(corners)) or corners.min(initial=0.0) < -1e-6 or corners.max(initial=0.0) > 1 + 1e-6:
        raise InputError("texture atlas: texture coordinates leave [0, 1]; tiled layouts cannot be baked")
    scale = size * texture_kernels.SUBTEXEL
    whole = np.stack([np.rint(corners[..., 0] * scale), np.rint((1.0 - corners[..., 1]) * scale)], axis=-1)
    triangle, barycentric, twice = texture_kernels.rasterise(whole.astype(np.int64), size)
    covered = int(np.count_nonzero(triangle >= 0))
    distance = _border_distance(triangle, chart_of_triangles(corners))
    return TextureAtlas(triangle, barycentric, distance, twice / max(covered, 1))


def chart_of_triangles(corner_uv: Floats) -> NDArray[np.int32]:
    """Number of the chart of every triangle, (K,): triangles that share a texture coordinate share a chart."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    triangles = len(corner_uv)
    _, place = np.unique(corner_uv.reshape(-1, 2), axis=0, return_inverse=True)
    place = place.reshape(-1)
    places = int(place.max(initial=-1)) + 1
    owner = np.repeat(np.arange(triangles), 3)
    links = coo_array((np.ones(3 * triangles), (owner, triangles + place)), shape=(triangles + places,) * 2)
    labels = connected_components(links.tocsr(), directed=False)[1]
    return np.asarray(labels[:triangles], dtype=np.int32)


def texel_positions(atlas: TextureAtlas, triangles: Integers, values: Floats) -> Floats:
    """Interpolate vertex ``values`` (V, 3) at all texels, (S, S, 3); NaN outside of the charts."""
    from capture_eval.registration import texture_kernels

    flat, triangle, barycentric = atlas.covered()
    result = np.full((atlas.size * atlas.size, 3), np.nan)
    result[flat] = texture_kernels.surface_points(
        triangle, barycentric, np.ascontiguousarray(triangles), np.ascontiguousarray(values, dtype=np.float64)
    )
    return result.reshape(atlas.size, atlas.size, 3)


def cylindrical_texture_coordinates(vertices: Floats, triangles: Integers, up: int = 1, front: int = 2) -> Floats:
    """A UV layout for heads that have none: the angle about the upright axis, and the height.

    Triangles that the cylinder folds over (inside of the mouth, behind the ears) or cuts at the back of the
    head get a texture triangle without area, which no texel shows.

    Parameters
    ----------
    vertices : (V, 3) float64
    triangles : (K, 3) int64
    up, front : int
        Axes that point to the crown and out of the face.

    Returns
    -------
    corner_uv : (K, 3, 2) float64
    """
    side = 3 - up - front
    centre = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
    local = vertices - centre
    angle = np.arctan2(local[:, side], local[:, front]) / (2.0 * np.pi)
    height = local[:, up] / max(float(np.ptp(local[:, up])), 1e-300)
    corner_uv = 0.5 + np.stack([0.98 * angle, 0.98 * height], axis=-1)[triangles]
    cut = np.ptp(corner_uv[..., 0], axis=1) > 0.25
    first, second = corner_uv[:, 1] - corner_uv[:, 0], corner_uv[:, 2] - corner_uv[:, 0]
    area = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    # The majority of the surface faces outwards and gives the layout its orientation.
    folded = area * np.sign(area[~cut].sum()) <= 0
    hidden = cut | folded | _behind_another(corner_uv, vertices, triangles, up)
    corner_uv[hidden] = corner_uv[hidden][:, :1]
    return corner_uv


def _behind_another(corner_uv: Floats, vertices: Floats, triangles: Integers, up: int) -> NDArray[np.bool_]:
    """Triangles whose middle an outer triangle of the cylinder covers (tested at the texels of a small atlas)."""
    size = 512
    axis_distance = np.linalg.norm(np.delete(vertices - vertices.mean(axis=0), up, axis=1), axis=1)
    depth = axis_distance[triangles].mean(axis=1)
    order = np.argsort(-depth, kind="stable")
    from capture_eval.registration import texture_kernels

    scale = size * texture_kernels.SUBTEXEL
    flat = np.ptp(corner_uv[..., 0], axis=1) > 0.25
    whole = np.stack([np.rint(corner_uv[..., 0] * scale), np.rint((1.0 - corner_uv[..., 1]) * scale)], axis=-1)
    whole[flat] = whole[flat][:, :1]
    shown = texture_kernels.rasterise(whole[order].astype(np.int64), size)[0]
    middle = corner_uv.mean(axis=1)
    column = np.clip((middle[:, 0] * size).astype(np.int64), 0, size - 1)
    row = np.clip(((1.0 - middle[:, 1]) * size).astype(np.int64), 0, size - 1)
    winner = shown[row, column]
    winner = np.where(winner >= 0, order[winner], -1)
    return np.asarray((winner >= 0) & (depth < depth[winner] - 0.1 * depth.max()), dtype=np.bool_)


def _border_distance(triangle: NDArray[np.int32], chart: NDArray[np.int32]) -> NDArray[np.float32]:
    from scipy.ndimage import distance_transform_edt

    label = np.where(triangle >= 0, chart[triangle] if chart.size else -1, -1)
    inside = label >= 0
    for axis in (0, 1):
        differs = np.diff(label, axis=axis) != 0
        lower = tuple(slice(None, -1) if a == axis else slice(None) for a in (0, 1))
        upper = tuple(slice(1, None) if a == axis else slice(None) for a in (0, 1))
        both = differs & (label[lower] >= 0) & (label[upper] >= 0)
        inside[lower] &= ~both
        inside[upper] &= ~both
    # A frame of empty texels: the picture's edge is a border too.
    distance = distance_transform_edt(np.pad(inside, 1))[1:-1, 1:-1]
    return np.asarray(distance, dtype=np.float32)
