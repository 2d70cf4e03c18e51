"""The CC0 assets of MakeHuman as arrays: base mesh, morph targets, skeleton, skin weights, facial pose units.

Takes the text of the upstream files; where the files come from is the caller's business. Sources of the formats: the
files themselves (base.obj, ``*.target``, ``default.mhskel``, ``default_weights.mhw``, ``face-poseunits.bvh/.json`` of
the repository makehumancommunity/makehuman, commit a8bc2d54, whose assets are CC0 1.0) and the BVH motion format.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from capture_eval.errors import InputError

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
Parsed = TypeVar("Parsed")

BASE_MESH = "3dobjs/base.obj"
SKELETON = "rigs/default.mhskel"
WEIGHTS = "rigs/default_weights.mhw"
POSE_UNITS = "poseunits/face-poseunits.bvh"
POSE_UNIT_NAMES = "poseunits/face-poseunits.json"
ETHNICITIES = ("caucasian", "african", "asian")
GENDERS = ("male", "female")


def macro_target(ethnicity: str, gender: str) -> str:
    """File of the young-adult macro target of an ethnicity and gender."""
    return f"targets/macrodetails/{ethnicity}-{gender}-young.target"


def universal_target(gender: str) -> str:
    """File of the target for average muscle and weight of a gender."""
    return f"targets/macrodetails/universal-{gender}-young-averagemuscle-averageweight.target"


REQUIRED_FILES: tuple[str, ...] = (
    BASE_MESH,
    SKELETON,
    WEIGHTS,
    POSE_UNITS,
    POSE_UNIT_NAMES,
    *(macro_target(ethnicity, gender) for ethnicity in ETHNICITIES for gender in GENDERS),
    *(universal_target(gender) for gender in GENDERS),
)


@dataclass(frozen=True)
class BaseMesh:
    """The base mesh with all its helper geometry.

    Attributes
    ----------
    vertices
        (V, 3) decimetres, x = subject's left, y up, z front.
    texture_coordinates
        (T, 2), v up.
    faces, face_textures
        (F, 4) vertices and texture coordinates of the quads.
    groups
        Name -> quads of the group, ascending.
    """

    vertices: FloatArray
    texture_coordinates: FloatArray
    faces: IntArray
    face_textures: IntArray
    groups: Mapping[str, IntArray]


@dataclass(frozen=True)
class Skeleton:
    """Bones and where their heads are.

    Attributes
    ----------
    parents
        Bone -> parent bone or None, parents first.
    head_vertices
        Bone -> base vertices whose mean is the bone's head.
    """

    parents: Mapping[str, str | None]
    head_vertices: Mapping[str, IntArray]


@dataclass(frozen=True)
class MakeHumanAssets:
    """All that is needed for a head that moves.

    Attributes
    ----------
    mesh, skeleton
        Base mesh and bones.
    weights
        Bone -> (vertices, weights).
    targets
        File of the target -> (V, 3) displacement in decimetres.
    pose_units
        Pose unit -> bone -> (3,) rotation vector in radians, axes of the base mesh.
    """

    mesh: BaseMesh
    skeleton: Skeleton
    weights: Mapping[str, tuple[IntArray, FloatArray]]
    targets: Mapping[str, FloatArray]
    pose_units: Mapping[str, Mapping[str, FloatArray]]


def parse_assets(texts: Mapping[str, str]) -> MakeHumanAssets:
    """Parse the files named in `REQUIRED_FILES` (and further targets), given as name -> text.

    Raises
    ------
    InputError
        A file is missing or does not have the expected form; the message names it.
    """
    missing = [name for name in REQUIRED_FILES if name not in texts]
    if missing:
        raise InputError(f"MakeHuman: {missing[0]} is missing ({len(missing)} of {len(REQUIRED_FILES)} files are)")
    mesh = _checked(parse_base_mesh, texts, BASE_MESH)
    skeleton = _checked(parse_skeleton, texts, SKELETON)
    weights = _checked(parse_weights, texts, WEIGHTS)
    names = _checked(lambda text: [str(name) for name in json.loads(text)["framemapping"]], texts, POSE_UNIT_NAMES)
    pose_units = _checked(lambda text: parse_pose_units(text, names), texts, POSE_UNITS)
    count = len(mesh.vertices)
    targets = {
        name: _checked(lambda text: parse_target(text, count), texts, name)
        for name in texts
        if name.endswith(".target")
    }
    return MakeHumanAssets(mesh, skeleton, weights, targets, pose_units)


def _checked(parse: Callable[[str], Parsed], texts: Mapping[str, str], name: str) -> Parsed:
    try:
        return parse(texts[name])
    except (KeyError, IndexError, ValueError, TypeError, AttributeError) as error:
        raise InputError(f"MakeHuman: {name} is damaged or of another version ({error})") from None


def parse_base_mesh(text: str) -> BaseMesh:
    """Read the quads, texture coordinates and groups of base.obj."""
    vertices: list[list[str]] = []
    textures: list[list[str]] = []
    corners: list[list[list[str]]] = []
    members: dict[str, list[int]] = {}
    group = ""
    for line in text.splitlines():
        kind, _, rest = line.partition(" ")
        if kind == "v":
            vertices.append(rest.split())
        elif kind == "vt":
            textures.append(rest.split()[:2])
        elif kind == "g":
            group = rest.strip()
        elif kind == "f":
            members.setdefault(group, []).append(len(corners))
            corners.append([corner.split("/") for corner in rest.split()])
    table = np.array([[corner[:2] for corner in face] for face in corners], dtype=np.int64) - 1
    if table.shape[1:] != (4, 2):
        raise ValueError("faces are not quads with texture coordinates")
    return BaseMesh(
        np.array(vertices, dtype=np.float64),
        np.array(textures, dtype=np.float64),
        np.ascontiguousarray(table[:, :, 0]),
        np.ascontiguousarray(table[:, :, 1]),
        {name: np.array(faces, dtype=np.int64) for name, faces in members.items()},
    )


def parse_target(text: str, vertices: int) -> FloatArray:
    """Read a morph target: (vertices, 3) displacement in decimetres, zero where the file is silent."""
    rows = [line.split() for line in text.splitlines() if line.strip() and not line.startswith("#")]
    displacement = np.zeros((vertices, 3))
    if rows:
        table = np.array(rows, dtype=np.float64)
        displacement[table[:, 0].astype(np.int64)] = table[:, 1:4]
    return displacement


def parse_skeleton(text: str) -> Skeleton:
    """Read bones, parents and joint positions of an mhskel file."""
    data = json.loads(text)
    bones: dict[str, dict[str, str | None]] = data["bones"]
    parents: dict[str, str | None] = {}
    waiting = list(bones)
    while waiting:
        ready = [name for name in waiting if bones[name]["parent"] is None or bones[name]["parent"] in parents]
        if not ready:
            raise ValueError(f"bone {waiting[0]} has no path to a root")
        for name in ready:
            parents[name] = bones[name]["parent"]
        waiting = [name for name in waiting if name not in parents]
    joints = data["joints"]
    heads = {name: np.array(joints[str(bones[name]["head"])], dtype=np.int64) for name in parents}
    return Skeleton(parents, heads)


def parse_weights(text: str) -> dict[str, tuple[IntArray, FloatArray]]:
    """Read skin weights: bone -> (vertices, weights)."""
    weights: dict[str, list[list[float]]] = json.loads(text)["weights"]
    return {
        bone: (np.array([row[0] for row in rows], dtype=np.int64), np.array([row[1] for row in rows], dtype=np.float64))
        for bone, rows in weights.items()
    }


def parse_pose_units(text: str, names: list[str]) -> dict[str, dict[str, FloatArray]]:
    """Read the frames of the BVH as pose units: name -> bone -> rotation vector (bones that do not turn are left out).

    A frame's channels are Euler angles X, Y, Z in degrees, applied as Rx Ry Rz, in axes with z up; the base mesh has y
    up, so (x, y, z) becomes (x, z, -y).
    """
    from scipy.spatial.transform import Rotation

    header, _, motion = text.partition("MOTION")
    bones: list[tuple[str, int]] = []
    channel = 0
    bone = ""
    for words in (line.split() for line in header.splitlines()):
        if words[:1] in (["ROOT"], ["JOINT"]):
            bone = words[1]
        elif words[:1] == ["CHANNELS"]:
            if words[-3:] != ["Xrotation", "Yrotation", "Zrotation"]:
                raise ValueError(f"bone {bone} has the channels {' '.join(words[2:])}")
            channel += int(words[1])
            bones.append((bone, channel - 3))
    frames = np.array([line.split() for line in motion.strip().splitlines()[2:]], dtype=np.float64)
    if frames.shape != (len(names), channel):
        raise ValueError(f"{frames.shape} numbers for {len(names)} pose units and {channel} channels")
    units: dict[str, dict[str, FloatArray]] = {}
    for name, frame in zip(names, frames, strict=True):
        units[name] = {}
        for bone, start in bones:
            turn = Rotation.from_euler("XYZ", frame[start : start + 3], degrees=True).as_rotvec()
            if np.linalg.norm(turn) > 1e-4:
                units[name][bone] = np.array([turn[0], turn[2], -turn[1]])
    return units
