"""Still pictures of meshes without a graphics card: one ray a sample, smooth shading, colours by value.

Values that are NaN are drawn in grey: a vertex of which nothing is known says so.
"""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from capture_eval.cameras import View, pixel_rays
from capture_eval.errors import InputError
from capture_eval.triangle_geometry import vertex_normals

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Bytes = NDArray[np.uint8]
Preset = Literal["front", "left", "right", "three_quarter", "three_quarter_right", "below"]

# Turns about the upright axis and nods, in degrees: where the picture is taken from.
PRESETS: dict[str, tuple[float, float]] = {
    "front": (0.0, 0.0),
    "left": (80.0, 0.0),
    "right": (-80.0, 0.0),
    "three_quarter": (35.0, 5.0),
    "three_quarter_right": (-35.0, 5.0),
    "below": (0.0, -35.0),
}
UNKNOWN_COLOUR = (0.72, 0.72, 0.72)
CLAY_COLOUR = (0.80, 0.76, 0.72)


@dataclass(frozen=True)
class RayGrid:
    """Rays of a picture, (H, W, 3) each, and the direction towards the camera's upper left, (3,)."""

    origins: Floats
    directions: Floats
    light: Floats


def render_mesh(
    vertices: Floats,
    triangles: Integers,
    values: NDArray[np.floating] | None = None,
    colours: NDArray[np.floating] | None = None,
    *,
    view: View | None = None,
    preset: Preset = "three_quarter",
    size: tuple[int, int] = (480, 560),
    frame: Floats | None = None,
    colour_map: str = "viridis",
    value_range: tuple[float, float] | None = None,
    background: tuple[float, float, float] | None = (1.0, 1.0, 1.0),
    supersampling: int = 3,
    shading: float = 1.0,
) -> Bytes:
    """Picture of a mesh, shaded and anti-aliased.

    Parameters
    ----------
    vertices : (V, 3) float64
        x to the subject's left, y up, z out of the face for the presets; any frame with a ``view``.
    triangles : (K, 3) int64
    values : (V,), optional
        Drawn through ``colour_map``; NaN is grey.
    colours : (V, 3) in [0, 1], optional
        Colour of each vertex; without values or colours the mesh is clay.
    view : View, optional
        A photo's camera, whose lens and size are used; otherwise ``preset`` looks at the mesh without perspective.
    preset : str
        One of ``front``, ``left``, ``right``, ``three_quarter``, ``three_quarter_right``, ``below``.
    size : (width, height)
        Pixels; ignored with a view.
    frame : (N, 3), optional
        Points that the picture is to hold, for one scale in a row of pictures; by default the vertices.
    value_range : (lowest, highest), optional
        By default of the finite values.
    background : three numbers in [0, 1], or None
        None gives an alpha channel instead.
    supersampling : int
        Rays along each side of a pixel.
    shading : float
        0 draws flat colours, 1 full shading.

    Returns
    -------
    (H, W, 3) uint8, or (H, W, 4) without a background

    Raises
    ------
    InputError
        Shapes that do not fit, or an unknown preset.
    """
    vertices = np.ascontiguousarray(vertices, dtype=np.float64)
    _check(vertices, triangles, values, colours, preset, supersampling)
    if view is not None:
        size = (view.intrinsics.width, view.intrinsics.height)
        rays = _view_rays(view, supersampling)
    else:
        rays = _preset_rays(vertices if frame is None else frame, preset, size, supersampling)
    palette = vertex_colours(len(vertices), values, colours, colour_map, value_range)
    drawn = _shade(vertices, triangles, palette, rays, shading)
    height, width, s = size[1], size[0], supersampling
    drawn = drawn.reshape(height, s, width, s, 4).mean(axis=(1, 3))
    if background is None:
        alpha = drawn[..., 3:]
        return _to_bytes(np.concatenate([drawn[..., :3] / np.maximum(alpha, 1e-9), alpha], axis=-1))
    return _to_bytes(drawn[..., :3] + (1.0 - drawn[..., 3:]) * np.asarray(background))


def vertex_colours(
    count: int,
    values: NDArray[np.floating] | None,
    colours: NDArray[np.floating] | None = None,
    colour_map: str = "viridis",
    value_range: tuple[float, float] | None = None,
) -> Floats:
    """Colour of each vertex, (V, 3) in [0, 1], from values, given colours, or clay."""
    if values is not None:
        import matplotlib

        numbers = np.asarray(values, dtype=np.float64)
        known = np.isfinite(numbers)
        low, high = value_range or (
            (float(numbers[known].min()), float(numbers[known].max())) if known.any() else (0.0, 1.0)
        )
        share = np.clip((np.where(known, numbers, low) - low) / max(high - low, 1e-300), 0.0, 1.0)
        mapped = np.asarray(matplotlib.colormaps[colour_map](share), dtype=np.float64)[:, :3]
        return np.where(known[:, None], mapped, np.asarray(UNKNOWN_COLOUR))
    if colours is not None:
        return np.asarray(colours, dtype=np.float64)
    return np.tile(np.asarray(CLAY_COLOUR), (count, 1))


def preset_rotation(preset: str) -> Floats:
    """Camera axes (right, down, forward) as rows, (3, 3): view_from_world of a preset."""
    turn, nod = np.deg2rad(PRESETS[preset])
    towards = np.array([np.sin(turn) * np.cos(nod), np.sin(nod), np.cos(turn) * np.cos(nod)])
    forward = -towards
    right = np.cross(forward, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(forward, right), forward])


def _check(
    vertices: Floats,
    triangles: Integers,
    values: NDArray[np.floating] | None,
    colours: NDArray[np.floating] | None,
    preset: str,
    supersampling: int,
) -> None:
    count = len(vertices)
    if vertices.ndim != 2 or vertices.shape[1] != 3 or triangles.ndim != 2 or triangles.shape[1] != 3:
        raise InputError(f"rendering: vertices {vertices.shape} and triangles {triangles.shape}")
    if values is not None and np.shape(values) != (count,):
        raise InputError(f"rendering: values {np.shape(values)} for {count} vertices")
    if colours is not None and np.shape(colours) != (count, 3):
        raise InputError(f"rendering: colours {np.shape(colours)} for {count} vertices")
    if preset not in PRESETS:
        raise InputError(f"rendering: no preset {preset!r}; there are {', '.join(PRESETS)}")
    if supersampling < 1:
        raise InputError(f"rendering: supersampling {supersampling}, expected at least 1")


def _preset_rays(points: Floats, preset: str, size: tuple[int, int], supersampling: int) -> RayGrid:
    """Parallel rays that hold all of ``points`` with a small margin."""
    rotation = preset_rotation(preset)
    local = points[np.all(np.isfinite(points), axis=1)] @ rotation.T
    low, high = local.min(axis=0), local.max(axis=0)
    width, height = size
    scale = 1.06 * max((high[0] - low[0]) / width, (high[1] - low[1]) / height, 1e-12)
    step = scale / supersampling
    across = (np.arange(width * supersampling) + 0.5 - 0.5 * width * supersampling) * step
    down = (np.arange(height * supersampling) + 0.5 - 0.5 * height * supersampling) * step
    middle = 0.5 * (low + high)
    local_origins = np.empty((len(down), len(across), 3))
    local_origins[..., 0] = middle[0] + across[None, :]
    local_origins[..., 1] = middle[1] + down[:, None]
    local_origins[..., 2] = low[2] - 0.1 * (high[2] - low[2]) - scale
    directions = np.broadcast_to(rotation[2], local_origins.shape)
    return RayGrid(local_origins @ rotation, directions, _light(rotation))


def _view_rays(view: View, supersampling: int) -> RayGrid:
    width, height = view.intrinsics.width * supersampling, view.intrinsics.height * supersampling
    column, row = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    pixels = np.stack([column.ravel(), row.ravel()], axis=1) / supersampling
    origin, directions = pixel_rays(view, pixels)
    directions = directions.reshape(height, width, 3)
    return RayGrid(np.broadcast_to(origin, directions.shape), directions, _light(view.rotation))


def _light(rotation: Floats) -> Floats:
    light = np.array([-0.45, -0.55, -0.75]) @ rotation
    return np.asarray(light / np.linalg.norm(light), dtype=np.float64)


def _shade(vertices: Floats, triangles: Integers, palette: Floats, rays: RayGrid, shading: float) -> Floats:
    """Colour times cover and cover of every ray, (H, W, 4)."""
    import open3d

    tensor: Any = open3d.core.Tensor
    scene = open3d.t.geometry.RaycastingScene(nthreads=1)
    centre = vertices.mean(axis=0)  # single precision is then spent on the head, not on where it stands
    scene.add_triangles(tensor((vertices - centre).astype(np.float32)), tensor(triangles.astype(np.uint32)))
    bundle = np.concatenate([rays.origins - centre, rays.directions], axis=-1).astype(np.float32)
    hits = scene.cast_rays(tensor(bundle), nthreads=1)
    identifier = hits["primitive_ids"].numpy().astype(np.int64)
    hit = identifier != open3d.t.geometry.RaycastingScene.INVALID_ID
    second, third = np.moveaxis(hits["primitive_uvs"].numpy()[hit].astype(np.float64), -1, 0)
    weights = np.stack([1.0 - second - third, second, third], axis=-1)[..., None]
    corners = triangles[identifier[hit]]
    normal = (vertex_normals(vertices, triangles)[corners] * weights).sum(axis=1)
    normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-12)
    towards = -rays.directions[hit]
    facing = (normal * towards).sum(axis=-1)
    normal = np.where(facing[:, None] < 0, -normal, normal)
    diffuse = np.clip(normal @ rays.light, 0.0, 1.0)
    head_lamp = np.abs(facing)
    brightness = 1.0 - shading + shading * (0.30 + 0.42 * diffuse + 0.36 * head_lamp)
    result = np.zeros((*hit.shape, 4))
    result[hit, :3] = np.clip((palette[corners] * weights).sum(axis=1) * brightness[:, None], 0.0, 1.0)
    result[hit, 3] = 1.0
    return result


def _to_bytes(picture: Floats) -> Bytes:
    return np.asarray(np.clip(np.rint(255.0 * picture), 0, 255), dtype=np.uint8)
