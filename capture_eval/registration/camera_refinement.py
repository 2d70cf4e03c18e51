"""Bundle adjustment of one pose's cameras from sub-pixel observations of its registered mesh's texture.

Structure from motion ties the cameras to feature points that are right to a third of a pixel; its focal length
is then off by a per cent, and the space between the cameras bends by a few hundredths of a per cent of the head.
Thousands of texture observations at a tenth of a pixel straighten it. Cameras, one focal length and one radial
term per lens, and all points move. The points are tied to the mesh so loosely that its errors do not bend the
cameras; only where photos cannot tell (few views of a shallow subject: focal length against distance) it decides.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from capture_eval.cameras import Intrinsics, View
from capture_eval.errors import InputError
from capture_eval.registration.texture_observations import PhotoObservations, TextureObservations
from capture_eval.similarity import Similarity, estimate_similarity, transform_view

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


@dataclass(frozen=True)
class RefinedCameras:
    """Cameras after the adjustment, in the frame of the mesh.

    Parameters
    ----------
    views : tuple of View
        In the order given; the cameras that came in when ``accepted`` is false.
    accepted : bool
        False when there were too few observations or the adjustment went astray.
    residual_before, residual_after : float
        Root mean square distance between observed and projected points, pixels (after the first and last step).
    observations : int
    focal_change : float
        Relative change of the (first) focal length.
    """

    views: tuple[View, ...]
    accepted: bool
    residual_before: float
    residual_after: float
    observations: int
    focal_change: float


@dataclass(frozen=True)
class RefinementOptions:
    """Options of :func:`refine_cameras`.

    Parameters
    ----------
    steps : int
        Gauss-Newton steps.
    outlier_pixels : float
        Residual at which an observation counts half (Cauchy).
    observation_pixels : float
        Typical error of an observation.
    mesh_error : float
        Typical error of the mesh, a fraction of the extent of the points; large values free the points.
    minimum_observations : int
        Fewer of them leave the cameras as they are.
    largest_focal_change : float
        A larger relative change of the focal length is taken for a failure.
    """

    steps: int = 4
    outlier_pixels: float = 0.3
    observation_pixels: float = 0.1
    mesh_error: float = 0.003
    minimum_observations: int = 2000
    largest_focal_change: float = 0.05


@dataclass
class _Bundle:
    """State of the adjustment."""

    rotations: Floats
    translations: Floats
    focal: Floats
    radial: Floats
    points: Floats
    mesh_points: Floats


@dataclass(frozen=True)
class _Linearised:
    """Residuals (M, 2) of one photo with their derivatives by points, pose and lens."""

    residual: Floats
    by_point: Floats
    by_camera: Floats


def refine_cameras(
    views: Sequence[View], observations: TextureObservations, options: RefinementOptions | None = None
) -> RefinedCameras:
    """Adjust the cameras of one pose to the observations of its texture.

    Views with equal intrinsics share their lens. The frame stays that of the mesh: of all similar solutions the
    one is taken whose points lie nearest to where they were.

    Parameters
    ----------
    views : sequence of View
    observations : TextureObservations
        Of the same views, in their order.
    options : RefinementOptions, optional

    Raises
    ------
    InputError
        Views and observations differ in number.

    Notes
    -----
    Normal equations with the points eliminated (Triggs et al., Bundle Adjustment: A Modern Synthesis, 1999,
    section 6.1); the seven free directions of the frame are held by a touch of damping.
    """
    options = options or RefinementOptions()
    if len(views) != len(observations.photos):
        raise InputError(f"camera refinement: {len(views)} views but observations of {len(observations.photos)}")
    points, photos = _points_seen_thrice(observations)
    total = sum(len(photo.point) for photo in photos)
    if total < options.minimum_observations:
        return RefinedCameras(tuple(views), False, float("nan"), float("nan"), total, 0.0)
    lens_of_view, lenses = _lenses(views)
    state = _Bundle(
        np.stack([view.rotation for view in views]),
        np.stack([view.translation for view in views]),
        np.ones(len(lenses)),
        np.zeros(len(lenses)),
        points.copy(),
        points,
    )
    residuals = [_step(state, views, photos, lens_of_view, options) for _ in range(options.steps)]
    change = float(np.max(np.abs(state.focal - 1.0)))
    finite = bool(np.all(np.isfinite(residuals))) and bool(np.all(np.isfinite(state.points)))
    if not finite or change > options.largest_focal_change or residuals[-1] > residuals[0]:
        return RefinedCameras(tuple(views), False, residuals[0], residuals[-1], total, change)
    old_from_new = _robust_similarity(state.points, points)
    refined = tuple(
        transform_view(_moved(view, state, index, lens_of_view[index]), old_from_new)
        for index, view in enumerate(views)
    )
    return RefinedCameras(refined, True, residuals[0], residuals[-1], total, float(state.focal[0] - 1.0))


def _points_seen_thrice(observations: TextureObservations) -> tuple[Floats, list[PhotoObservations]]:
    count = np.zeros(len(observations.points), dtype=np.int64)
    for photo in observations.photos:
        count[photo.point] += 1
    kept = count >= 3
    number = np.cumsum(kept) - 1
    photos = []
    for photo in observations.photos:
        used = kept[photo.point]
        photos.append(PhotoObservations(number[photo.point[used]], photo.pixel[used], photo.weight[used]))
    return observations.points[kept], photos


def _lenses(views: Sequence[View]) -> tuple[Integers, list[Intrinsics]]:
    """Number of each view's lens, and the different lenses."""
    known: dict[bytes, int] = {}
    lenses: list[Intrinsics] = []
    numbers = []
    for view in views:
        lens = view.intrinsics
        key = lens.matrix.tobytes() + lens.distortion.tobytes()
        if key not in known:
            known[key] = len(lenses)
            lenses.append(lens)
        numbers.append(known[key])
    return np.array(numbers, dtype=np.int64), lenses


def _step(
    state: _Bundle,
    views: Sequence[View],
    photos: Sequence[PhotoObservations],
    lens_of_view: Integers,
    options: RefinementOptions,
) -> float:
    """One Gauss-Newton step, in place; returns the root mean square residual before it, pixels."""
    unknowns = 6 * len(views) + 2 * len(state.focal)
    count = len(state.points)
    camera_block, camera_side = np.zeros((unknowns, unknowns)), np.zeros(unknowns)
    point_block, point_side = np.zeros((count, 3, 3)), np.zeros((count, 3))
    mixed = np.zeros((count, unknowns, 3))
    squared = weight_sum = 0.0
    for index, (view, photo) in enumerate(zip(views, photos, strict=True)):
        row = _linearise(state, view, index, int(lens_of_view[index]), photo)
        lens = 6 * len(views) + 2 * int(lens_of_view[index])
        columns = np.r_[6 * index : 6 * index + 6, lens : lens + 2]
        distance = np.sum(row.residual**2, axis=1)
        weight = photo.weight / (1.0 + distance / options.outlier_pixels**2)
        squared += float(photo.weight @ distance)
        weight_sum += float(photo.weight.sum())
        camera = row.by_camera * weight[:, None, None]
        point = row.by_point * weight[:, None, None]
        camera_block[np.ix_(columns, columns)] += np.tensordot(camera, row.by_camera, axes=([0, 1], [0, 1]))
        camera_side[columns] += np.tensordot(camera, row.residual, axes=([0, 1], [0, 1]))
        # A photo shows a point once, so that plain indexing adds every row.
        point_block[photo.point] += point.transpose(0, 2, 1) @ row.by_point
        point_side[photo.point] += (point.transpose(0, 2, 1) @ row.residual[:, :, None])[:, :, 0]
        mixed[photo.point[:, None], columns[None, :]] += camera.transpose(0, 2, 1) @ row.by_point
    extent = float(np.linalg.norm(np.ptp(state.mesh_points, axis=0)))
    tie = (options.observation_pixels / (options.mesh_error * extent)) ** 2
    point_block += tie * np.eye(3)
    point_side += tie * (state.mesh_points - state.points)
    _solve(state, camera_block, camera_side, point_block, point_side, mixed)
    return float(np.sqrt(squared / max(weight_sum, 1e-300)))


def _linearise(state: _Bundle, view: View, index: int, lens: int, photo: PhotoObservations) -> _Linearised:
    """Residuals and derivatives; the lens bends by k1 and k2 (p1 and p2 shift pixels, but not derivatives)."""
    matrix, distortion = view.intrinsics.matrix, view.intrinsics.distortion
    focal = state.focal[lens] * np.array([matrix[0, 0], matrix[1, 1]])
    turned = state.points[photo.point] @ state.rotations[index].T
    local = turned + state.translations[index]
    depth = local[:, 2]
    plane = local[:, :2] / depth[:, None]
    squared = np.sum(plane**2, axis=1)
    first_radial = distortion[0] + state.radial[lens]
    bend = 1.0 + squared * (first_radial + squared * distortion[1])
    slope = 2.0 * (first_radial + 2.0 * squared * distortion[1])
    x, y = plane.T
    tangential = np.stack(
        [
            2.0 * distortion[2] * x * y + distortion[3] * (squared + 2.0 * x * x),
            distortion[2] * (squared + 2.0 * y * y) + 2.0 * distortion[3] * x * y,
        ],
        axis=1,
    )
    bent = plane * bend[:, None] + tangential
    pixel = bent * focal + matrix[:2, 2]
    pixel[:, 0] += matrix[0, 1] * bent[:, 1]
    by_plane = bend[:, None, None] * np.eye(2) + slope[:, None, None] * plane[:, :, None] * plane[:, None, :]
    by_plane *= focal[:, None]
    by_local = np.concatenate([by_plane, -by_plane @ plane[:, :, None]], axis=2) / depth[:, None, None]
    by_turn = np.cross(turned[:, None, :], by_local)
    by_lens = np.stack([focal * bent, focal * plane * squared[:, None]], axis=2)
    by_lens[:, :, 0] /= state.focal[lens]
    return _Linearised(
        photo.pixel - pixel, by_local @ state.rotations[index], np.concatenate([by_turn, by_local, by_lens], axis=2)
    )


def _solve(
    state: _Bundle,
    camera_block: Floats,
    camera_side: Floats,
    point_block: Floats,
    point_side: Floats,
    mixed: Floats,
) -> None:
    """Eliminate the points, solve for the cameras, go back to the points; changes ``state`` in place."""
    from scipy.spatial.transform import Rotation

    count, unknowns = mixed.shape[:2]
    typical = float(np.trace(point_block, axis1=1, axis2=2).mean())
    inverse = np.linalg.inv(point_block + 1e-6 * typical * np.eye(3))
    folded = mixed @ inverse
    flat = mixed.transpose(1, 0, 2).reshape(unknowns, 3 * count)
    reduced = camera_block - folded.transpose(1, 0, 2).reshape(unknowns, 3 * count) @ flat.T
    diagonal = np.diag(camera_block)
    reduced[np.diag_indices(unknowns)] += 1e-8 * diagonal + 1e-12 * float(diagonal.max())
    change = np.linalg.solve(reduced, camera_side - np.einsum("nai,ni->a", folded, point_side))
    point_change = inverse @ (point_side - np.einsum("nai,a->ni", mixed, change))[:, :, None]
    state.points += point_change[:, :, 0]
    cameras = len(state.rotations)
    pose = change[: 6 * cameras].reshape(cameras, 6)
    state.rotations = Rotation.from_rotvec(pose[:, :3]).as_matrix() @ state.rotations
    state.translations = state.translations + pose[:, 3:]
    lens = change[6 * cameras :].reshape(-1, 2)
    state.focal = state.focal + lens[:, 0]
    state.radial = state.radial + lens[:, 1]


def _moved(view: View, state: _Bundle, index: int, lens: int) -> View:
    matrix, distortion = view.intrinsics.matrix.copy(), view.intrinsics.distortion.copy()
    matrix[[0, 1], [0, 1]] *= state.focal[lens]
    distortion[0] += state.radial[lens]
    return replace(
        view,
        intrinsics=replace(view.intrinsics, matrix=matrix, distortion=distortion),
        rotation=state.rotations[index],
        translation=state.translations[index],
    )


def _robust_similarity(source: Floats, target: Floats) -> Similarity:
    """Similarity that brings most of ``source`` to ``target``; points that moved far count little."""
    link = estimate_similarity(source, target)
    for _ in range(5):
        distance = np.linalg.norm(link.apply(source) - target, axis=1)
        scale = 2.0 * float(np.median(distance)) + 1e-300
        link = estimate_similarity(source, target, 1.0 / (1.0 + (distance / scale) ** 2) ** 2)
    return link
