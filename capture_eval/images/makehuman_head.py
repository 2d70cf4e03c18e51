"""A MakeHuman head as a subject: head cut from the base mesh, identities, moving bones, skin, landmarks, curves."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture_eval.errors import InputError
from capture_eval.images.head import Blocker, Contrast, Head
from capture_eval.images.makehuman_assets import (
    ETHNICITIES,
    GENDERS,
    MakeHumanAssets,
    macro_target,
    universal_target,
)
from capture_eval.images.makehuman_atlas import rasterize_atlas, repack_islands, texture_islands
from capture_eval.images.makehuman_curves import BASE_LOOPS, BaseLoop
from capture_eval.images.makehuman_parts import COLLAR, TEETH, TONGUE, eye_colors, split_quads
from capture_eval.images.makehuman_regions import head_regions, region_masks
from capture_eval.images.makehuman_skeleton import MOTIONS, pose_vertices
from capture_eval.images.makehuman_skin import SkinPlaces, SkinTone, skin_colors
from capture_eval.images.mesh_walks import closed_loop, faces_enclosed
from capture_eval.polygon_mesh import PolygonMesh

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
ByteArray = NDArray[np.uint8]

# First edge of the loop round the neck at which the head is cut, and a face vertex (tip of the nose) on the kept side.
_NECK_EDGE = (1462, 1463)
_NOSE_TIP = 5054
_MILLIMETRES = 100.0  # per decimetre of the base mesh
_WAVES, _WAVE_LENGTHS = 12, (90.0, 220.0)
_EYE_SPLITS = 3

LANDMARKS: Mapping[str, int] = {
    "eye_outer_right": 21,
    "eye_inner_right": 66,
    "eye_upper_right": 1,
    "eye_lower_right": 44,
    "eye_outer_left": 6805,
    "eye_inner_left": 6850,
    "eye_upper_left": 6785,
    "eye_lower_left": 6828,
    "nasion": 133,
    "glabella": 227,
    "nose_tip": 5054,
    "nostril_right": 5051,
    "nostril_left": 11669,
    "mouth_corner_right": 422,
    "mouth_corner_left": 7182,
    "lip_upper": 455,
    "lip_lower": 492,
    "pogonion": 733,
    "menton": 747,
    "gonion_right": 885,
    "gonion_left": 7587,
    "ear_top_right": 5413,
    "ear_top_left": 12012,
}


@dataclass(frozen=True)
class Identity:
    """Who is photographed.

    Attributes
    ----------
    number
        For the name.
    mixture
        Macro target -> weight.
    wave_size
        Millimetres (root mean square) by which smooth random waves displace the head; 0 = none.
    tone
        Skin colours.
    iris
        sRGB.
    """

    number: int
    mixture: Mapping[str, float]
    wave_size: float
    tone: SkinTone = field(default_factory=SkinTone)
    iris: tuple[int, int, int] = (92, 70, 46)


_SKINS = ((209, 162, 136), (222, 178, 152), (186, 134, 104), (150, 104, 80), (214, 170, 138))
_HAIRS = ((92, 70, 55), (60, 46, 38), (130, 98, 66), (44, 38, 36), (104, 84, 70))
_IRISES = ((92, 70, 46), (74, 96, 112), (58, 40, 26), (96, 104, 72))


def average_mixture(male: float = 0.6) -> dict[str, float]:
    """Equal parts of the three ethnicities, `male` parts of the male targets and the rest of the female."""
    shares = {"male": male, "female": 1.0 - male}
    mixture = {macro_target(e, g): shares[g] / len(ETHNICITIES) for e in ETHNICITIES for g in GENDERS}
    return mixture | {universal_target(g): shares[g] for g in GENDERS}


def identity(number: int) -> Identity:
    """Person number 0 (the average of all targets), 1, 2, ... (random mixtures with random smooth waves).

    Raises
    ------
    InputError
        The number is negative.
    """
    if number < 0:
        raise InputError(f"identity {number}: must be 0 or more")
    if number == 0:
        return Identity(0, average_mixture(), 0.0)
    random = np.random.default_rng([number, 501])
    male = float(random.uniform(0.05, 0.95))
    ethnicity = random.dirichlet(np.full(len(ETHNICITIES), 0.8))
    shares = {"male": male, "female": 1.0 - male}
    mixture = {
        macro_target(e, g): float(ethnicity[k]) * shares[g] for k, e in enumerate(ETHNICITIES) for g in GENDERS
    } | {universal_target(g): shares[g] for g in GENDERS}
    tone = SkinTone(
        skin=_SKINS[number % len(_SKINS)],
        hair=_HAIRS[number % len(_HAIRS)],
        freckles=float(random.uniform(0.3, 0.9)),
        seed=1000 * number,
    )
    return Identity(number, mixture, 5.5, tone, _IRISES[number % len(_IRISES)])


@dataclass(frozen=True)
class HeadCut:
    """Which part of the base mesh is the head, the same for all identities.

    Attributes
    ----------
    vertices
        (V,) base vertices of the skin, ascending.
    faces, face_textures
        (F, 4) in numbers of the cut.
    textures
        (T,) base texture coordinates used.
    coordinates
        (T, 2) repacked.
    islands
        (T,) island of each.
    border
        (B,) vertices of the neck border in order, in numbers of the cut.
    """

    vertices: IntArray
    faces: IntArray
    face_textures: IntArray
    textures: IntArray
    coordinates: FloatArray
    islands: IntArray
    border: IntArray


def cut_head(assets: MakeHumanAssets) -> HeadCut:
    """Cut the head from the body at a closed edge loop round the neck."""
    mesh = assets.mesh
    body = mesh.groups["body"]
    loop = closed_loop(mesh.faces[body], _NECK_EDGE)
    kept = body[faces_enclosed(mesh.faces[body], loop, _NOSE_TIP)]
    vertices, faces = np.unique(mesh.faces[kept], return_inverse=True)
    textures, face_textures = np.unique(mesh.face_textures[kept], return_inverse=True)
    faces, face_textures = faces.reshape(-1, 4), face_textures.reshape(-1, 4)
    islands = texture_islands(face_textures, len(textures))
    coordinates = repack_islands(mesh.texture_coordinates[textures], islands)
    border = np.searchsorted(vertices, loop)
    return HeadCut(vertices, faces, face_textures, textures, coordinates, islands, border)


def rest_vertices(assets: MakeHumanAssets, person: Identity) -> FloatArray:
    """Morphed base mesh (all vertices), millimetres, origin at the head joint, x = subject's left, y up, z front.

    Raises
    ------
    InputError
        A target of the mixture was not read.
    """
    vertices = assets.mesh.vertices.copy()
    for target, weight in person.mixture.items():
        if target not in assets.targets:
            raise InputError(f"MakeHuman: target {target} was not read")
        vertices += weight * assets.targets[target]
    joint = vertices[assets.skeleton.head_vertices["head"]].mean(axis=0)
    centered = np.asarray(_MILLIMETRES * (vertices - joint), dtype=np.float64)
    if person.wave_size > 0.0:
        centered += person.wave_size * smooth_waves(centered, person.number)
    return centered


def smooth_waves(points: FloatArray, seed: int) -> FloatArray:
    """Sum of plane waves of 90 to 220 mm length with random directions: displacement (N, 3) of unit mean square."""
    random = np.random.default_rng([seed, 502])
    displacement = np.zeros_like(points)
    for _ in range(_WAVES):
        direction = random.normal(size=3)
        wave = 2.0 * np.pi / random.uniform(*_WAVE_LENGTHS) * direction / np.linalg.norm(direction)
        amplitude = random.normal(size=3)
        amplitude *= np.sqrt(2.0 / _WAVES) / np.linalg.norm(amplitude)
        displacement += np.sin(points @ wave + random.uniform(0.0, 2.0 * np.pi))[:, None] * amplitude
    return displacement


class _Subject:
    """Numbers of one person that posing and texturing share."""

    def __init__(self, assets: MakeHumanAssets, person: Identity, cut: HeadCut) -> None:
        self.assets, self.person, self.cut = assets, person, cut
        self.rest = rest_vertices(assets, person)
        self.parts = [_part(assets, name) for name in _PARTS]

    def pose(self, motion: str, amount: float) -> tuple[FloatArray, tuple[FloatArray, ...]]:
        """Posed skin and blockers."""
        posed = pose_vertices(self.assets, self.rest, motion, amount)
        return posed[self.cut.vertices], self.blocker_vertices(posed)

    def blocker_vertices(self, base: FloatArray) -> tuple[FloatArray, ...]:
        """Positions of all blockers for posed base vertices."""
        neck = base[self.cut.vertices][self.cut.border]
        collar = np.concatenate([neck, [neck.mean(axis=0)]])
        return (*(matrix @ base[vertices] for vertices, matrix, _ in self.parts), collar)

    def blockers(self) -> tuple[Blocker, ...]:
        """Blockers at rest with their colours."""
        positions = self.blocker_vertices(self.rest)
        result = []
        for (name, (_, color, gloss)), (_, _, faces), place in zip(
            _PARTS.items(), self.parts, positions[:-1], strict=True
        ):
            colors = np.tile(np.array(color, dtype=np.uint8), (len(place), 1))
            if name.startswith("eye"):
                colors = eye_colors(place, self.person.iris, self.person.number)
            result.append(Blocker(name, PolygonMesh.from_faces(place, faces), colors, gloss=gloss))
        count = len(self.cut.border)
        fan = np.stack([np.roll(np.arange(count), -1), np.arange(count), np.full(count, count)], axis=1)
        cloth = np.tile(np.array(COLLAR, dtype=np.uint8), (count + 1, 1))
        return (*result, Blocker("collar", PolygonMesh.from_faces(positions[-1], fan), cloth, gloss=0.1))

    def albedo(self, size: int, contrast: Contrast) -> ByteArray:
        """Skin colour at the texels of the atlas."""
        cut = self.cut
        reference = rest_vertices(self.assets, identity(0))[cut.vertices]
        masks = region_masks(cut.vertices, cut.faces, cut.face_textures, cut.islands)
        values = np.concatenate([reference, masks], axis=1)
        corners = np.array([[0, 1, 2], [0, 2, 3]])
        uv = cut.coordinates[cut.face_textures[:, corners]].reshape(-1, 3, 2)
        filled, image = rasterize_atlas(uv, values[cut.faces[:, corners]].reshape(len(uv), 3, -1), size)
        texels = image[filled]
        places = SkinPlaces(texels[:, :3], texels[:, 3], texels[:, 4], texels[:, 5])
        atlas = np.empty((size, size, 3), dtype=np.uint8)
        atlas[:] = np.asarray(self.person.tone.skin, dtype=np.uint8)
        atlas[filled] = skin_colors(places, self.person.tone, contrast)
        return atlas


# Blocker -> (groups of the base mesh, colour, gloss).
_PARTS: Mapping[str, tuple[tuple[str, ...], tuple[int, int, int], float]] = {
    "eye_left": (("helper-l-eye",), (255, 255, 255), 4.0),
    "eye_right": (("helper-r-eye",), (255, 255, 255), 4.0),
    "teeth": (("helper-upper-teeth", "helper-lower-teeth"), TEETH, 2.0),
    "tongue": (("helper-tongue",), TONGUE, 1.6),
}


def _part(assets: MakeHumanAssets, name: str) -> tuple[IntArray, Any, IntArray]:
    """Base vertices of a part, the matrix that refines it, and its faces."""
    from scipy.sparse import identity as identity_matrix

    groups = np.concatenate([assets.mesh.groups[group] for group in _PARTS[name][0]])
    vertices, faces = np.unique(assets.mesh.faces[groups], return_inverse=True)
    faces = faces.reshape(-1, 4)
    matrix: Any = identity_matrix(len(vertices), format="csr")
    for _ in range(_EYE_SPLITS if name.startswith("eye") else 0):
        step, faces = split_quads(faces, matrix.shape[0])
        matrix = step @ matrix
    return vertices, matrix, faces


def makehuman_head(assets: MakeHumanAssets, number: int = 0, cut: HeadCut | None = None) -> Head:
    """A person with MakeHuman's topology.

    Parameters
    ----------
    assets
        The upstream files, see `parse_assets`.
    number
        Identity; 0 is the average head, others are random.
    cut
        From `cut_head`, when several heads are made.
    """
    cut = cut or cut_head(assets)
    subject = _Subject(assets, identity(number), cut)
    skin = PolygonMesh.from_faces(subject.rest[cut.vertices], cut.faces, cut.coordinates, cut.face_textures)
    here = {int(vertex): index for index, vertex in enumerate(cut.vertices)}
    reference = rest_vertices(assets, identity(0))[cut.vertices]
    return Head(
        name=f"makehuman_{number}",
        skin=skin,
        albedo=subject.albedo,
        blockers=subject.blockers(),
        landmarks={name: here[vertex] for name, vertex in LANDMARKS.items()},
        curves=tuple(_curve(loop, here) for loop in BASE_LOOPS),
        rigid_region=_rigid_region(subject),
        regions=head_regions(cut.vertices, cut.faces, cut.face_textures, cut.islands, reference),
        motions=tuple(MOTIONS),
        pose=subject.pose,
    )


def _rigid_region(subject: _Subject) -> IntArray:
    """Skin above the mouth that no motion moves."""
    moved = np.zeros(len(subject.cut.vertices))
    rest = subject.rest[subject.cut.vertices]
    for motion in MOTIONS:
        moved = np.maximum(moved, np.linalg.norm(subject.pose(motion, 1.0)[0] - rest, axis=1))
    outside = np.ones(len(rest), dtype=np.bool_)
    hidden = subject.cut.islands[subject.cut.face_textures] > 0
    outside[subject.cut.faces[hidden]] = False
    return np.flatnonzero((moved < 1e-3) & outside & (rest[:, 1] > -40.0)).astype(np.int64)


def _curve(loop: BaseLoop, here: Mapping[int, int]) -> dict[str, Any]:
    entry: dict[str, Any] = {
        "name": loop.name,
        "region": loop.region,
        "start_edge": [here[vertex] for vertex in loop.start_edge],
    }
    if loop.turns:
        entry["turns"] = {here[vertex]: here[following] for vertex, following in loop.turns.items()}
    if loop.stop is not None:
        entry["stop"] = here[loop.stop]
    return entry
