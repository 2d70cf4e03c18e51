"""PatchMatch multi-view stereo on the CPU: depth and normal of every pixel of one photo.

Every pixel carries a slanted plane of inverse depth.  Good planes are found by chance at the
coarsest pyramid level, spread to neighbours in red-black order, disturbed with shrinking
amplitude, carried to the finer levels and there refined to sub-pixel accuracy over all
sources that see the surface well.  The likeness is bilaterally weighted normalised cross
correlation of patches warped by the plane, so surfaces seen at a slant are not forced to face
the camera.

References: Bleyer, Rhemann, Rother, "PatchMatch Stereo" (2011); Galliani, Lasinger,
Schindler, "Massively Parallel Multiview Stereopsis by Surface Normal Diffusion" (2015), for
the red-black order; Schoenberger et al. (2016), for the choice of views per pixel.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from capture_eval.errors import InputError
from capture_eval.reconstruction.image_pyramid import Pyramid, PyramidLevel

if TYPE_CHECKING:
    from capture_eval.reconstruction.patch_cost_kernels import Pattern, Reference, Sources

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]

_PAD = 8
_SCRATCH = 64
_SKIP = 0.03  # pixels: planes that differ by less are not tried
_MAX_SLOPE = 5.0  # tangent of the largest tilt, about 79 degrees
_NEIGHBOURS = np.array(
    [[-1, 0], [1, 0], [0, -1], [0, 1], [-3, 0], [3, 0], [0, -3], [0, 3], [-5, 0], [5, 0], [0, -5], [0, 5]], np.int64
)


@dataclass(frozen=True)
class PatchMatchOptions:
    """How hard to look.

    Parameters
    ----------
    window : int
        Half width of the patch, pixels of every level. Wider ones are steadier in one depth map, but smooth creases in
        all of them alike, which no averaging takes away.
    colour_sigma : float
        Grey levels at which a sample counts a quarter in the bilateral weight.
    views_per_pixel : int
        Sources whose likeness is averaged while searching, chosen per pixel.
    refining_views : int
        Most sources used per pixel by the sub-pixel refinement.
    coarse_passes, fine_passes : int
        Red-black sweeps at the coarsest and at each finer level.
    minimum_likeness : float
        NCC below which a pixel of a coarse level is not carried on.
    variance_floor : float
        Added to the variance of a patch, grey levels squared, so that flat patches look unlike each other.
    seed : int
        Random numbers are a function of it, the level, the sweep and the pixel only.
    threads : int
        Rows are divided among so many threads; the result does not depend on it.
    """

    window: int = 3
    colour_sigma: float = 20.0
    views_per_pixel: int = 3
    refining_views: int = 6
    coarse_passes: int = 4
    fine_passes: int = 2
    minimum_likeness: float = 0.3
    variance_floor: float = 0.25
    seed: int = 0
    threads: int = 1

    def __post_init__(self) -> None:
        if not 1 <= self.window <= _PAD:
            raise InputError(f"patch match: window {self.window}, expected 1 to {_PAD} pixels")
        if self.views_per_pixel < 1 or self.refining_views < 1 or self.threads < 1:
            raise InputError("patch match: views per pixel, refining views and threads must be at least 1")


@dataclass(frozen=True)
class DepthEstimate:
    """What one photo says about the surface.

    Parameters
    ----------
    depth : (H, W) float32
        Along the optical axis, unit of the world; 0 where nothing was found.
    normal : (H, W, 3) float32
        Camera frame, unit length, towards the camera.
    likeness : (H, W) float32
        Mean NCC over the sources used.
    views : (H, W) uint8
        How many sources agreed.
    deviation : (H, W) float32
        Estimated standard deviation of the depth, unit of the world.
    """

    depth: Singles
    normal: Singles
    likeness: Singles
    views: NDArray[np.uint8]
    deviation: Singles


def plane_maps(reference: Pyramid, source: Pyramid, level: int) -> Floats:
    """(12,) M row by row, then m: source pixel ~ M (u, v, 1) + m / z, both in pixel indices of `level`."""
    relative = source.view.rotation @ reference.view.rotation.T
    translation = source.view.translation - relative @ reference.view.translation
    source_matrix = source.levels[min(level, len(source.levels) - 1)].matrix
    matrix = source_matrix @ relative @ np.linalg.inv(reference.levels[level].matrix)
    return np.concatenate([matrix.ravel(), source_matrix @ translation])


def _pack_sources(reference: Pyramid, sources: Sequence[Pyramid], level: int) -> "Sources":
    from capture_eval.reconstruction.patch_cost_kernels import Sources

    chosen = [source.levels[min(level, len(source.levels) - 1)] for source in sources]
    sizes = np.array([item.texels.size for item in chosen])
    return Sources(
        texels=np.concatenate([item.texels.ravel() for item in chosen]),
        offset=np.concatenate([[0], np.cumsum(sizes)[:-1]]).astype(np.uint32),
        width=np.array([item.texels.shape[1] for item in chosen], np.int32),
        height=np.array([item.texels.shape[0] for item in chosen], np.int32),
        maps=np.array([plane_maps(reference, source, level) for source in sources]).astype(np.float32),
    )


def _pack_reference(level: PyramidLevel, active: NDArray[np.uint8]) -> "Reference":
    import cv2

    from capture_eval.reconstruction.patch_cost_kernels import Reference

    padded = np.pad(level.grey, _PAD, mode="edge")
    centre = np.ascontiguousarray(cv2.GaussianBlur(level.grey, (3, 3), 0.7))
    return Reference(np.ascontiguousarray(padded).ravel(), padded.shape[1], _PAD, centre, active)


def sampling_pattern(window: int, stride: int, options: PatchMatchOptions) -> "Pattern":
    """32 samples: six by six without corners, spread over a window of half width `window`.

    Below 3 pixels there are not six places in a row; then the samples stay 3 pixels wide and the outer ones weigh less.
    """
    from capture_eval.reconstruction.patch_cost_kernels import Pattern

    ladder = np.rint(np.array([-1.0, -0.6, -0.2, 0.2, 0.6, 1.0]) * window).astype(np.int64)
    if len(np.unique(ladder)) < 6:
        ladder = np.array([-3, -2, -1, 1, 2, 3], np.int64)
    y, x = (axis.ravel() for axis in np.meshgrid(ladder, ladder, indexing="ij"))
    inner = (np.abs(x) < ladder[-1]) | (np.abs(y) < ladder[-1])
    x, y = x[inner], y[inner]
    spatial = np.exp(-(x**2 + y**2) / (2.0 * float(window) ** 2))
    return Pattern(
        dx=x.astype(np.float32),
        dy=y.astype(np.float32),
        spatial=spatial.astype(np.float32),
        shift=(y * stride + x).astype(np.int32),
        radius=np.float32(ladder[-1]),
        colour_scale=np.float32(1.0 / options.colour_sigma**2),
        noise=np.float32(options.variance_floor),
    )


def disparity_per_inverse_depth(maps: Floats, pixel: Floats, inverse_depth: float) -> Floats:
    """(n,) pixels that a source's image of `pixel` moves per unit of inverse depth."""
    matrix, offset = maps[:, :9].reshape(-1, 3, 3), maps[:, 9:]
    homogeneous = matrix @ np.append(pixel, 1.0) + offset * inverse_depth
    place = homogeneous[:, :2] / homogeneous[:, 2:]
    return np.asarray(np.linalg.norm((offset[:, :2] - place * offset[:, 2:]) / homogeneous[:, 2:], axis=1))


def _carry_to_finer(planes: Singles, shape: tuple[int, int]) -> Singles:
    """Planes of a level -> planes of the next finer one, (h, w, 3) -> (H, W, 3)."""
    rows = np.minimum(np.arange(shape[0]) // 2, planes.shape[0] - 1)
    columns = np.minimum(np.arange(shape[1]) // 2, planes.shape[1] - 1)
    result = planes[rows][:, columns].copy()
    down = ((np.arange(shape[0]) + 0.5) / 2 - 0.5 - rows)[:, None]
    right = ((np.arange(shape[1]) + 0.5) / 2 - 0.5 - columns)[None, :]
    result[..., 2] += (result[..., 0] * right + result[..., 1] * down).astype(np.float32)
    result[..., :2] *= np.float32(0.5)
    return np.ascontiguousarray(result)


def _run_rows(kernel: Callable[..., None], height: int, threads: int, *arguments: Any) -> None:
    """Call `kernel((first, past), *arguments)` over all rows, on `threads` threads."""
    if threads == 1:
        kernel(np.array([0, height]), np.empty((5, _SCRATCH), np.float32), *arguments)
        return
    bounds = np.linspace(0, height, 4 * threads + 1).astype(np.int64)
    with ThreadPoolExecutor(threads) as pool:
        jobs = [
            pool.submit(kernel, bounds[k : k + 2], np.empty((5, _SCRATCH), np.float32), *arguments)
            for k in range(len(bounds) - 1)
        ]
        for job in jobs:
            job.result()


@dataclass
class _State:
    """What travels from level to level."""

    planes: Singles
    costs: Singles
    chosen: NDArray[np.uint8]


def _search_level(
    level: int,
    coarsest: bool,
    reference: "Reference",
    pattern: "Pattern",
    sources: "Sources",
    state: _State,
    inverse_range: tuple[float, float],
    focal: float,
    pixel_step: float,
    options: PatchMatchOptions,
) -> None:
    from capture_eval.reconstruction.patch_match_kernels import Search, choose_views_rows, propagate_rows

    height = reference.active.shape[0]
    passes = options.coarse_passes if coarsest else options.fine_passes
    choose = (reference, pattern, sources, state.planes, state.costs, state.chosen)
    if not coarsest:
        _run_rows(choose_views_rows, height, options.threads, *choose)
    span = inverse_range[1] - inverse_range[0]
    for turn in range(passes):
        shrink = 0.5**turn
        for colour in (0, 1):
            search = Search(
                colour=colour,
                key=np.uint32((options.seed * 7919 + level * 104729 + turn * 1299709 + colour * 15485863) % 2**32),
                use_all=coarsest,
                best_of=min(options.views_per_pixel, len(sources.width)),
                changes=6 if coarsest else 3,
                fresh=(8 if turn == 0 else 2) if coarsest else 0,
                amplitude=np.float32((0.1 * span if coarsest else pixel_step) * shrink),
                tilt=np.float32((1.0 if coarsest else 0.5) * shrink),
                skip=np.float32(_SKIP * pixel_step),
                nearest=np.float32(inverse_range[1]),
                farthest=np.float32(inverse_range[0]),
                focal=np.float32(focal),
                max_slope=np.float32(_MAX_SLOPE),
            )
            neighbours = _NEIGHBOURS if coarsest else _NEIGHBOURS[:8]
            _run_rows(propagate_rows, height, options.threads, search, *choose, neighbours)
        _run_rows(choose_views_rows, height, options.threads, *choose)


def match_view(
    reference: Pyramid, sources: Sequence[Pyramid], depth_range: tuple[float, float], options: PatchMatchOptions
) -> DepthEstimate:
    """Depth, normal and confidence of every pixel of a photo.

    Parameters
    ----------
    reference : Pyramid
    sources : sequence of Pyramid
        Photos to compare with, the best first; any number up to 64, of any sizes.
    depth_range : (float, float)
        Nearest and farthest depth, unit of the world.
    options : PatchMatchOptions

    Returns
    -------
    DepthEstimate

    Raises
    ------
    InputError
        No sources, more than 64, or a depth range that is empty or reaches the camera.
    """
    from capture_eval.reconstruction.patch_cost_kernels import MAX_VIEWS

    if not 1 <= len(sources) <= MAX_VIEWS:
        raise InputError(f"{reference.view.name}: {len(sources)} source photos, expected 1 to {MAX_VIEWS}")
    if not 0 < depth_range[0] < depth_range[1] < np.inf:
        raise InputError(f"{reference.view.name}: depth range {depth_range}, expected 0 < nearest < farthest")
    inverse_range = (1.0 / depth_range[1], 1.0 / depth_range[0])
    state: _State | None = None
    for level in reversed(range(len(reference.levels))):
        layer = reference.levels[level]
        packed = _pack_reference(layer, layer.active.copy())
        active = layer.active.astype(np.bool_)
        state = _start_level(state, active, min(options.views_per_pixel, len(sources)), options)
        packed.active[...] = active
        maps = _pack_sources(reference, sources, level)
        middle = np.array([layer.grey.shape[1], layer.grey.shape[0]]) / 2.0
        pixels = disparity_per_inverse_depth(maps.maps.astype(np.float64), middle, float(np.mean(inverse_range)))
        pixel_step = float(1.0 / np.median(pixels))
        pattern = sampling_pattern(options.window, packed.stride, options)
        focal = float(layer.matrix[0, 0])
        coarsest = level == len(reference.levels) - 1
        _search_level(level, coarsest, packed, pattern, maps, state, inverse_range, focal, pixel_step, options)
    if state is None:
        raise InputError(f"{reference.view.name}: the pyramid has no levels")
    return _refine(state, packed, pattern, maps, layer, pixel_step, options)


def _start_level(state: _State | None, active: NDArray[np.bool_], kept: int, options: PatchMatchOptions) -> _State:
    """Arrays of a level; pixels whose surroundings found nothing at the coarser level are given up."""
    import cv2

    shape = active.shape
    costs = np.full(shape, 1.0, np.float32)
    chosen = np.zeros((*shape, kept), np.uint8)
    if state is None:
        planes = np.zeros((*shape, 3), np.float32)
        planes[..., 2] = -1e9
        return _State(planes, costs, chosen)
    good = (state.costs < 1.0 - options.minimum_likeness).astype(np.uint8)
    good = cv2.dilate(cv2.medianBlur(good, 3), np.ones((5, 5), np.uint8))
    rows = np.minimum(np.arange(shape[0]) // 2, good.shape[0] - 1)
    columns = np.minimum(np.arange(shape[1]) // 2, good.shape[1] - 1)
    active &= good[rows][:, columns].astype(np.bool_)
    return _State(_carry_to_finer(state.planes, (shape[0], shape[1])), costs, chosen)


def _refine(
    state: _State,
    reference: "Reference",
    pattern: "Pattern",
    sources: "Sources",
    layer: PyramidLevel,
    pixel_step: float,
    options: PatchMatchOptions,
) -> DepthEstimate:
    from capture_eval.reconstruction.patch_match_kernels import refine_rows

    height, width = reference.active.shape
    quality = np.zeros((height, width, 3), np.float32)
    focal = float(layer.matrix[0, 0])
    steps = (np.float32(0.3 * pixel_step), np.float32(0.15 / focal))
    most = min(options.refining_views, len(sources.width))
    _run_rows(
        refine_rows, height, options.threads, reference, pattern, sources, state.planes, state.costs, steps, 2, most,
        np.float32(0.15), np.zeros((height, most), np.int64), quality,
    )  # fmt: skip
    found = (reference.active > 0) & (quality[..., 0] >= min(2, most)) & (state.planes[..., 2] > 0)
    inverse = np.where(found, state.planes[..., 2], 1.0).astype(np.float64)
    normal = plane_normals(state.planes, layer.matrix)
    bend = np.maximum(quality[..., 2], 1e-4)
    spread = steps[0] * np.sqrt(np.maximum(1.0 - quality[..., 1], 1e-3) / (bend * 32 * np.maximum(quality[..., 0], 1)))
    depth = np.where(found, 1.0 / inverse, 0.0)
    return DepthEstimate(
        depth=depth.astype(np.float32),
        normal=np.where(found[..., None], normal, 0.0).astype(np.float32),
        likeness=np.where(found, quality[..., 1], 0.0).astype(np.float32),
        views=np.where(found, quality[..., 0], 0).astype(np.uint8),
        deviation=(depth**2 * spread).astype(np.float32),
    )


def plane_normals(planes: Singles, index_matrix: Floats) -> Floats:
    """Unit normals (H, W, 3) in the camera frame, towards the camera.

    With 1/z = a (u - u0) + b (v - v0) + c and u = fx x/z + cx, the plane is
    a fx x + b fy y + (c - a (u0 - cx) - b (v0 - cy)) z = 1.
    """
    height, width = planes.shape[:2]
    a, b, c = (planes[..., k].astype(np.float64) for k in range(3))
    u = np.arange(width)[None, :] - index_matrix[0, 2]
    v = np.arange(height)[:, None] - index_matrix[1, 2]
    normal = -np.stack([a * index_matrix[0, 0], b * index_matrix[1, 1], c - a * u - b * v], axis=-1)
    length = np.linalg.norm(normal, axis=-1, keepdims=True)
    return np.asarray(normal / np.maximum(length, 1e-300))
