"""A reconstruction against the true scene: where it is wrong, by how much, and what it lacks.

Two questions need two measures. *Truth to reconstruction* goes from places of the true surface that photos can see to
the nearest point of the reconstruction: it shows what is missing. *Reconstruction to truth* goes from places of the
reconstruction to the nearest point of the whole true scene, things that are no skin included (a scan of an eye is no
error of the lids): it shows what should not be there. All places are spread evenly by area, so neither large nor small
triangles count more.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from capture_eval.cameras import View, project
from capture_eval.errors import InputError
from capture_eval.images.ray_casting import TriangleScene
from capture_eval.triangle_geometry import diameter, triangle_area_vectors, triangle_normals

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Booleans = NDArray[np.bool_]

LEAST_PHOTOS = 3
STEEPEST = 75.0
# Parts of the face proper: no ears, neck, scalp, and nothing of mouth or nostrils that lies behind their rims.
FACE_PARTS = ("lips", "chin", "cheeks", "forehead", "eyes", "nose")
_FRAME = 2.0  # pixels: what is nearer to the border of a photo does not count as seen
_OFF_SURFACE = 2e-5  # of the scene: lifted so far off the surface, a point is not hidden by its own triangle


@dataclass(frozen=True)
class TrueScene:
    """The true surface of a pose, and what else stood before the cameras.

    Parameters
    ----------
    vertices, triangles : (V, 3), (K, 3)
        Everything, skin first.
    skin_triangles : int
        So many of the triangles are skin; the others (eyes, teeth, tongue, collar) hide skin and may be reconstructed,
        but nobody is asked to reconstruct them.
    size : float
        D, the length that errors are shares of.
    views : sequence of View
        The true cameras.
    face_triangles : (K,) bool, optional
        Triangles of the face proper.
    """

    vertices: Floats
    triangles: Integers
    skin_triangles: int
    size: float
    views: Sequence[View]
    face_triangles: Booleans | None = None

    def __post_init__(self) -> None:
        if not 0 < self.skin_triangles <= len(self.triangles) or not self.size > 0:
            raise InputError(
                f"true scene: {self.skin_triangles} of {len(self.triangles)} triangles are skin, D {self.size}"
            )
        if self.face_triangles is not None and self.face_triangles.shape != (len(self.triangles),):
            raise InputError(f"true scene: {len(self.triangles)} triangles, face flags {self.face_triangles.shape}")


@dataclass(frozen=True)
class TruePlaces:
    """Places of the true skin.

    Parameters
    ----------
    points, normals : (N, 3)
    photos : (N,) int
        Photos that see the place (see `count_photos`).
    incidence : (N,) float
        Smallest angle between normal and ray among them, degrees; 180 where no photo sees it.
    regions : region name -> (N,) bool
        `head`: skin that is seen; `face`: the face proper that is seen.
    """

    points: Floats
    normals: Floats
    photos: Integers
    incidence: Floats
    regions: Mapping[str, Booleans]


@dataclass(frozen=True)
class RegionError:
    """Errors of one region, shares of D.

    Parameters
    ----------
    to_truth : (N,)
        Places (or points) of the reconstruction to the true scene.
    to_reconstruction : (M,)
        Seen places of the truth to the nearest place (or point) of the reconstruction.
    index : (M,) int
        Which of the places of the truth these are.
    share : float
        Share of the whole reconstruction (its points, or its area) that belongs to the region.
    """

    to_truth: Floats
    to_reconstruction: Floats
    index: Integers
    share: float


def join_scene(
    skin: tuple[Floats, Integers],
    others: Sequence[tuple[Floats, Integers]],
    views: Sequence[View],
    face_vertices: Integers | None = None,
    size: float | None = None,
) -> TrueScene:
    """Skin and other parts as one scene.

    Parameters
    ----------
    skin : (vertices (V, 3), triangles (K, 3))
    others : sequence of the same
        Eyes, teeth, tongue, collar, ... in the pose of the skin.
    face_vertices : (F,) int, optional
        A triangle belongs to the face proper when all its corners are among these vertices of the skin.
    size : float, optional
        D; by default the largest distance between two vertices of the skin.
    """
    vertices = [np.asarray(part[0], dtype=np.float64) for part in (skin, *others)]
    starts = np.concatenate([[0], np.cumsum([len(part) for part in vertices])])
    triangles = [np.asarray(part[1], np.int64) + starts[k] for k, part in enumerate((skin, *others))]
    face = None
    if face_vertices is not None:
        inside = np.zeros(starts[-1], np.bool_)
        inside[face_vertices] = True
        face = np.all(inside[np.concatenate(triangles)], axis=1)
    return TrueScene(
        np.concatenate(vertices),
        np.concatenate(triangles),
        len(triangles[0]),
        diameter(vertices[0]) if size is None else size,
        tuple(views),
        face,
    )


def face_proper(vertices: Floats, regions: Mapping[str, Integers]) -> Integers:
    """Vertices of the face proper: of `FACE_PARTS`, those in front of the ears.

    As the narrow face area of the spec's study, this leaves out ears, neck, scalp, and the strip of jaw and temple that
    lies beside and behind the ears.

    Parameters
    ----------
    vertices : (V, 3)
        Neutral skin in the frame of the head, z to the front.
    regions : region name -> vertices
        `ears` and `FACE_PARTS`.

    Raises
    ------
    InputError
        A region is missing.
    """
    missing = [name for name in (*FACE_PARTS, "ears") if name not in regions]
    if missing:
        raise InputError(f"face region: the head has no region {', '.join(missing)}")
    inside = np.unique(np.concatenate([regions[name] for name in FACE_PARTS]))
    return np.asarray(inside[vertices[inside, 2] > vertices[regions["ears"], 2].max()], dtype=np.int64)


def sample_surface(vertices: Floats, triangles: Integers, count: int, seed: int = 0) -> tuple[Floats, Floats, Integers]:
    """Places (N, 3) spread evenly by area, normals (N, 3) of their triangles, and the triangles (N,).

    Raises
    ------
    InputError
        No triangle has an area.
    """
    area = np.linalg.norm(triangle_area_vectors(vertices, triangles), axis=1)
    if not area.sum() > 0:
        raise InputError(f"surface error: {len(triangles)} triangles without area cannot be sampled")
    generator = np.random.default_rng(seed)
    chosen = generator.choice(len(triangles), count, p=area / area.sum())
    first, second = np.sqrt(generator.random(count)), generator.random(count)
    weights = np.stack([1 - first, first * (1 - second), first * second], axis=1)
    points = np.einsum("nk,nkd->nd", weights, vertices[triangles[chosen]])
    return np.asarray(points), triangle_normals(vertices, triangles[chosen]), np.asarray(chosen, dtype=np.int64)


def count_photos(
    points: Floats, normals: Floats, scene: TrueScene, steepest: float = STEEPEST
) -> tuple[Integers, Floats]:
    """How many photos see each place of the true surface, and the smallest angle (degrees) at which one does.

    A photo sees a place when it lies inside the frame, nothing of the scene stands before it, and the ray meets the
    surface at no more than `steepest` degrees from its normal.
    """
    caster = TriangleScene(scene.vertices, scene.triangles)
    lifted = points + _OFF_SURFACE * scene.size * normals
    photos = np.zeros(len(points), np.int64)
    smallest = np.full(len(points), 180.0)
    for view in scene.views:
        pixels, depth = project(view, points)
        rays = view.center - points
        cosine = np.sum(rays * normals, axis=1) / np.maximum(np.linalg.norm(rays, axis=1), 1e-300)
        size = np.array([view.intrinsics.width, view.intrinsics.height])
        seen = (depth > 0) & np.all((pixels > _FRAME) & (pixels < size - _FRAME), axis=1)
        seen &= cosine >= np.cos(np.radians(steepest))
        index = np.nonzero(seen)[0]
        seen[index] = ~caster.occluded(view.center, lifted[index])
        photos += seen
        smallest[seen] = np.minimum(smallest[seen], np.degrees(np.arccos(np.clip(cosine[seen], -1.0, 1.0))))
    return photos, smallest


def _regions(scene: TrueScene, triangles: Integers, photos: Integers) -> dict[str, Booleans]:
    seen = photos >= min(LEAST_PHOTOS, len(scene.views))
    skin = triangles < scene.skin_triangles
    regions: dict[str, Booleans] = {"head": np.asarray(seen & skin)}
    if scene.face_triangles is not None:
        regions["face"] = np.asarray(seen & skin & scene.face_triangles[triangles])
    return regions


def true_places(scene: TrueScene, count: int = 100_000, seed: int = 0, steepest: float = STEEPEST) -> TruePlaces:
    """Places of the true skin, which regions they belong to and how well photos see them."""
    points, normals, triangles = sample_surface(scene.vertices, scene.triangles[: scene.skin_triangles], count, seed)
    photos, incidence = count_photos(points, normals, scene, steepest)
    return TruePlaces(points, normals, photos, incidence, _regions(scene, triangles, photos))


def _closest(points: Floats, vertices: Floats, triangles: Integers) -> tuple[Floats, Floats, Integers]:
    """Distances (N,), closest points (N, 3) and their triangles (N,), about 1e-7 of the scene exact."""
    import open3d

    core: Any = open3d.core
    scene: Any = open3d.t.geometry.RaycastingScene(nthreads=1)
    middle = points.mean(axis=0)
    scene.add_triangles(core.Tensor((vertices - middle).astype(np.float32)), core.Tensor(triangles.astype(np.uint32)))
    found = scene.compute_closest_points(core.Tensor((points - middle).astype(np.float32)), nthreads=1)
    places = found["points"].numpy().astype(np.float64) + middle
    return np.linalg.norm(points - places, axis=1), places, found["primitive_ids"].numpy().astype(np.int64)


def closest_distance(points: Floats, vertices: Floats, triangles: Integers) -> Floats:
    """Distance (N,) of points to a triangle mesh, in its unit."""
    return _closest(points, vertices, triangles)[0]


def distance_to_truth(points: Floats, scene: TrueScene) -> tuple[Floats, dict[str, Booleans]]:
    """Distance (N,) of reconstructed points to the true scene, shares of D, and the regions they belong to.

    A point belongs to the region of the nearest place of the true scene; `everything` holds all points, wherever they
    are.
    """
    distance, places, triangles = _closest(points, scene.vertices, scene.triangles)
    normals = triangle_normals(scene.vertices, scene.triangles[triangles])
    photos, _ = count_photos(places, normals, scene)
    regions = _regions(scene, triangles, photos)
    regions["everything"] = np.ones(len(points), np.bool_)
    return distance / scene.size, regions


def cloud_error(
    points: Floats, scene: TrueScene, places: TruePlaces, count: int = 100_000, seed: int = 1
) -> dict[str, RegionError]:
    """Errors of a point cloud (N, 3) in the frame of the truth, by region.

    `to_truth` is measured at `count` of the points drawn by chance (all of them where there are fewer).

    `to_reconstruction` is the distance to the nearest point, so it holds half the spacing of the points too: what
    completeness is counted from.
    """
    drawn = np.arange(len(points))
    if len(points) > count:
        drawn = np.sort(np.random.default_rng(seed).choice(len(points), count, replace=False))
    to_truth, owners = distance_to_truth(points[drawn], scene)
    to_cloud = np.asarray(cKDTree(points).query(places.points)[0]) / scene.size
    return _by_region(to_truth, owners, to_cloud, places)


def mesh_error(
    vertices: Floats, triangles: Integers, scene: TrueScene, places: TruePlaces, count: int = 100_000, seed: int = 1
) -> dict[str, RegionError]:
    """Errors of a reconstructed triangle mesh in the frame of the truth, by region."""
    to_truth, owners = distance_to_truth(sample_surface(vertices, triangles, count, seed)[0], scene)
    to_mesh = closest_distance(places.points, vertices, triangles) / scene.size
    return _by_region(to_truth, owners, to_mesh, places)


def _by_region(
    to_truth: Floats, owners: Mapping[str, Booleans], to_reconstruction: Floats, places: TruePlaces
) -> dict[str, RegionError]:
    """`everything` has no measure from the truth: nobody can reconstruct what no photo sees."""
    nothing = np.zeros(len(places.points), np.bool_)
    return {
        name: RegionError(
            to_truth[owner],
            to_reconstruction[places.regions.get(name, nothing)],
            np.nonzero(places.regions.get(name, nothing))[0],
            float(np.mean(owner)),
        )
        for name, owner in owners.items()
    }


def share_within(errors: Floats, deviation: Floats, times: Sequence[float] = (1.0, 2.0)) -> tuple[float, ...]:
    """Share of errors (N,) within so many of their own standard deviations (N,); normal errors give .683 and .954.

    Errors must be signed or absolute offsets along one direction (of a surface point: along the normal); distances in
    space follow another law.
    """
    ratio = np.abs(errors) / np.maximum(deviation, 1e-300)
    return tuple(float(np.mean(ratio <= limit)) for limit in times)
