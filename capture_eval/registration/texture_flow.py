"""Texture flow: where the skin of the neutral went on a pose's mesh, by dense optical flow between textures.

Both poses are baked in one UV layout, so that the flow between them is only the registration's error: drift
along the skin. Every pose is compared with the neutral, never with its neighbour, and the error cannot grow
along the sequence.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capture_eval.errors import InputError
from capture_eval.registration.texture_atlas import TextureAtlas, texel_positions
from capture_eval.registration.texture_baking import BakedTexture

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Picture = NDArray[np.float32]


@dataclass(frozen=True)
class FlowConstraints:
    """Points of the neutral's surface and where their skin is on the pose's mesh.

    The solver pulls the material point (``triangle``, ``barycentric``) of the pose's mesh to ``target`` within
    the tangent plane (the target lies on the pose's present mesh: it says nothing about the normal direction).

    Parameters
    ----------
    triangle : (M,) int64
    barycentric : (M, 3) float64
    target : (M, 3) float64
        Position on the pose's mesh that shows the same skin, in the frame of the pose's vertices.
    weight : (M,) float64
        0..1 from texture strength, correlation and forward/backward agreement.
    """

    triangle: Integers
    barycentric: Floats
    target: Floats
    weight: Floats


@dataclass(frozen=True)
class FlowOptions:
    """Options of :func:`texture_flow`; lengths in texels of the atlas.

    Parameters
    ----------
    normalisation_sigma : float
        Brightness and contrast are made equal within Gaussian windows of this width.
    consistency : float
        Largest difference between the forward flow and the backward flow at its end.
    minimum_correlation : float
        Least normalised correlation of the two textures after warping.
    correlation_sigma : float
        Width of the Gaussian window of the correlation.
    refinement_sigma : float
        Width of the Gaussian window of the last, full-resolution least-squares steps.
    border_margin : float
        Texels nearer to a chart's border or to a hole of the textures are not used.
    step : int
        Use every step-th row and column.
    """

    normalisation_sigma: float = 5.0
    consistency: float = 0.6
    minimum_correlation: float = 0.6
    correlation_sigma: float = 4.0
    refinement_sigma: float = 7.0
    border_margin: float = 4.0
    step: int = 3


@dataclass(frozen=True)
class FlowField:
    """Dense flow between two textures, (S, S) each: texels to the right and down, and what it is worth.

    Parameters
    ----------
    flow : (S, S, 2) float32
    disagreement : (S, S) float32
        Distance between the forward flow and the backward flow at its end.
    correlation : (S, S) float32
        Normalised correlation after warping.
    strength : (S, S) float32
        Smaller eigenvalue of the structure tensor of the normalised neutral texture.
    distance : (S, S) float32
        Texels to the nearest border of a chart or hole of either texture.
    """

    flow: Picture
    disagreement: Picture
    correlation: Picture
    strength: Picture
    distance: Picture


def texture_flow(
    neutral: BakedTexture,
    pose: BakedTexture,
    atlas: TextureAtlas,
    pose_vertices: Floats,
    triangles: Integers,
    options: FlowOptions | None = None,
) -> FlowConstraints:
    """Dense flow from the neutral's texture to a pose's texture, as constraints on material points.

    For the first round, where the drift is still large, pass ``FlowOptions(consistency=1.2)``.

    Parameters
    ----------
    neutral, pose : BakedTexture
        Grey textures of the neutral and the pose in the same ``atlas``.
    atlas : TextureAtlas
    pose_vertices : (V, 3) float64
        The mesh on which ``pose`` was baked.
    triangles : (K, 3) int64
    options : FlowOptions, optional

    Raises
    ------
    InputError
        Textures and atlas differ in size, or are not grey.
    """
    options = options or FlowOptions()
    field = flow_field(neutral, pose, atlas, options)
    row, column = (grid.ravel() for grid in np.mgrid[0 : atlas.size : options.step, 0 : atlas.size : options.step])
    good = _is_good(field, options)[row, column]
    row, column = row[good], column[good]
    moved = np.stack([column, row], axis=1) + field.flow[row, column]
    target = _interpolate_positions(texel_positions(atlas, triangles, pose_vertices), moved)
    weight = _weights(field, options)[row, column].astype(np.float64)
    kept = np.all(np.isfinite(target), axis=1) & (weight > 0)
    row, column = row[kept], column[kept]
    return FlowConstraints(
        atlas.triangle[row, column].astype(np.int64),
        atlas.barycentric[row, column].astype(np.float64),
        target[kept],
        weight[kept],
    )


def flow_field(
    neutral: BakedTexture, pose: BakedTexture, atlas: TextureAtlas, options: FlowOptions | None = None
) -> FlowField:
    """Dense inverse search (Kroeger et al., ECCV 2016; OpenCV) both ways, then least squares."""
    options = options or FlowOptions()
    shape = (atlas.size, atlas.size)
    for name, texture in (("neutral", neutral), ("pose", pose)):
        if texture.image.shape != shape:
            raise InputError(f"texture flow: {name} texture {texture.image.shape}, atlas {shape} (grey is needed)")
    field = FlowField(
        np.zeros((*shape, 2), dtype=np.float32),
        np.full(shape, np.inf, dtype=np.float32),
        np.zeros(shape, dtype=np.float32),
        np.zeros(shape, dtype=np.float32),
        np.zeros(shape, dtype=np.float32),
    )
    both = neutral.mask & pose.mask
    if not both.any():
        return field
    box = _bounding_box(both, 2 * int(options.normalisation_sigma))
    first = local_normalisation(neutral.image[box], neutral.mask[box], options.normalisation_sigma)
    second = local_normalisation(pose.image[box], pose.mask[box], options.normalisation_sigma)
    forward, backward = _dense_flow(first, second), _dense_flow(second, first)
    forward = refine_flow(first, second, forward, options.refinement_sigma)
    field.flow[box] = forward
    field.disagreement[box] = np.linalg.norm(forward + warp(backward, forward), axis=-1)
    warped, known = warp(second, forward), warp(pose.mask[box].astype(np.float32), forward)
    overlap = (neutral.mask[box] & (known > 0.99)).astype(np.float32)
    field.correlation[box] = windowed_correlation(first, warped, overlap, options.correlation_sigma)
    field.strength[box] = texture_strength(first)
    field.distance[:] = np.minimum(distance_to_holes(both), atlas.border_distance)
    return field


def local_normalisation(image: Picture, mask: NDArray[np.bool_], sigma: float) -> Picture:
    """Subtract the local mean and divide by the local deviation, both over known texels only; 0 outside.

    Shading that changes slowly with the pose, and the gain of a photo, vanish; skin detail stays.
    """
    import cv2

    known = mask.astype(np.float32)
    share = np.maximum(cv2.GaussianBlur(known, (0, 0), sigma), 1e-6)
    mean = cv2.GaussianBlur(np.where(mask, image, 0.0).astype(np.float32), (0, 0), sigma) / share
    difference = np.where(mask, image - mean, 0.0).astype(np.float32)
    deviation = np.sqrt(cv2.GaussianBlur(difference * difference, (0, 0), sigma) / share)
    # The floor (one grey level) keeps featureless skin from being blown up to pure noise.
    return np.asarray(difference / (deviation + 1.0), dtype=np.float32)


def _dense_flow(first: Picture, second: Picture) -> Picture:
    """Dense inverse search down to half the resolution; :func:`refine_flow` does the rest for a third of the time."""
    import cv2

    search = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    search.setFinestScale(1)
    search.setPatchSize(8)
    search.setPatchStride(4)
    bytes_first, bytes_second = (np.clip(128.0 + 40.0 * p, 0, 255).astype(np.uint8) for p in (first, second))
    return np.asarray(search.calc(bytes_first, bytes_second, None), dtype=np.float32)


def refine_flow(first: Picture, second: Picture, flow: Picture, sigma: float, steps: int = 2) -> Picture:
    """Lucas-Kanade steps at full resolution: least squares of the brightness difference in Gaussian windows."""
    import cv2

    right, down = _gradients(first)
    for _ in range(steps):
        warped = warp(second, flow, cubic=True)
        warped_right, warped_down = _gradients(warped)
        x, y, difference = 0.5 * (right + warped_right), 0.5 * (down + warped_down), warped - first
        products = (x * x, x * y, y * y, x * difference, y * difference)
        xx, xy, yy, xt, yt = (cv2.GaussianBlur(p, (0, 0), sigma) for p in products)
        # The damping stops steps where the skin has no detail; gradients there are noise of about 0.03.
        xx, yy = xx + 1e-3, yy + 1e-3
        determinant = xx * yy - xy * xy
        step = np.stack([(xy * yt - yy * xt) / determinant, (xy * xt - xx * yt) / determinant], axis=-1)
        flow = cv2.GaussianBlur(flow + np.clip(step, -1.0, 1.0), (0, 0), 1.0)
    return np.asarray(flow, dtype=np.float32)


def _gradients(picture: Picture) -> tuple[Picture, Picture]:
    import cv2

    return cv2.Sobel(picture, cv2.CV_32F, 1, 0, scale=0.125), cv2.Sobel(picture, cv2.CV_32F, 0, 1, scale=0.125)


def warp(picture: Picture, flow: Picture, cubic: bool = False) -> Picture:
    """``picture`` at texel + flow."""
    import cv2

    height, width = flow.shape[:2]
    column, row = np.meshgrid(np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32))
    moved = cv2.remap(
        picture, column + flow[..., 0], row + flow[..., 1], cv2.INTER_CUBIC if cubic else cv2.INTER_LINEAR
    )
    return np.asarray(moved, dtype=np.float32)


def windowed_correlation(first: Picture, second: Picture, mask: Picture, sigma: float) -> Picture:
    import cv2

    def mean(values: Picture) -> Picture:
        blurred = cv2.GaussianBlur(values * mask, (0, 0), sigma)
        return np.asarray(blurred / share, dtype=np.float32)

    share = np.maximum(cv2.GaussianBlur(mask, (0, 0), sigma), 1e-3)
    mean_first, mean_second = mean(first), mean(second)
    covariance = mean(first * second) - mean_first * mean_second
    variance = (mean(first * first) - mean_first**2) * (mean(second * second) - mean_second**2)
    return np.asarray(covariance / np.sqrt(np.maximum(variance, 1e-6)), dtype=np.float32)


def texture_strength(picture: Picture, sigma: float = 4.0) -> Picture:
    """Smaller eigenvalue of the structure tensor."""
    import cv2

    right, down = _gradients(picture)
    xx, xy, yy = (cv2.GaussianBlur(p, (0, 0), sigma) for p in (right * right, right * down, down * down))
    return np.asarray(0.5 * (xx + yy - np.sqrt((xx - yy) ** 2 + 4.0 * xy * xy)), dtype=np.float32)


def distance_to_holes(known: NDArray[np.bool_]) -> Picture:
    import cv2

    framed = np.pad(known.astype(np.uint8), 1)
    distance = cv2.distanceTransform(framed, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    return np.asarray(distance[1:-1, 1:-1], dtype=np.float32)


def _is_good(field: FlowField, options: FlowOptions) -> NDArray[np.bool_]:
    inner = field.distance > options.border_margin
    agrees = (field.disagreement < options.consistency) & (field.correlation > options.minimum_correlation)
    return np.asarray(inner & agrees, dtype=np.bool_)


def _weights(field: FlowField, options: FlowOptions) -> Picture:
    agreement = 1.0 - 0.5 * np.minimum(field.disagreement / options.consistency, 1.0) ** 2
    span = 1.0 - options.minimum_correlation
    similarity = np.clip((field.correlation - options.minimum_correlation) / max(span, 1e-6), 0.0, 1.0)
    # The typical eigenvalue of skin with pores and freckles after normalisation is about 0.01.
    texture = field.strength / (field.strength + 0.004)
    # Beside lips and lids the shade of the gap moves, not the skin: trust comes back within twelve texels.
    inland = np.minimum(field.distance / 12.0, 1.0) ** 2
    return np.asarray(agreement * (0.25 + 0.75 * similarity) * texture * inland, dtype=np.float32)


def _interpolate_positions(positions: Floats, places: NDArray[np.float32] | Floats) -> Floats:
    """Bilinear positions (M, 3) at (column, row) places (M, 2); NaN where a neighbour is outside of the charts."""
    size = positions.shape[0]
    inside = np.all((places >= 0) & (places < size - 1.001), axis=1)
    safe = np.where(inside[:, None], places, 0.0)
    column, row = np.floor(safe).astype(np.int64).T
    across, along = (safe - np.floor(safe)).T[:, :, None]
    upper = positions[row, column] * (1 - across) + positions[row, column + 1] * across
    lower = positions[row + 1, column] * (1 - across) + positions[row + 1, column + 1] * across
    return np.asarray(np.where(inside[:, None], upper * (1 - along) + lower * along, np.nan), dtype=np.float64)


def _bounding_box(mask: NDArray[np.bool_], margin: int) -> tuple[slice, slice]:
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    return (
        slice(max(0, int(rows[0]) - margin), min(mask.shape[0], int(rows[-1]) + margin + 1)),
        slice(max(0, int(columns[0]) - margin), min(mask.shape[1], int(columns[-1]) + margin + 1)),
    )
