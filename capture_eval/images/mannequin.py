"""The embedded mannequin: a head that needs no data, as a `Head` that can be posed and photographed."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from capture_eval.errors import InputError
from capture_eval.images.head import Blocker, Contrast, Head
from capture_eval.images.mannequin_curves import (
    mannequin_curves,
    mannequin_landmarks,
    mannequin_regions,
    rigid_skull,
)
from capture_eval.images.mannequin_identity import identity_offset, identity_positions, identity_scale
from capture_eval.images.mannequin_layout import canonical_positions
from capture_eval.images.mannequin_motion import (
    JAW_ANGLE,
    JAW_HINGE,
    MOTIONS,
    Turn,
    apply_turns,
    rotate_about,
    skin_turns,
)
from capture_eval.images.mannequin_parts import mannequin_parts
from capture_eval.images.mannequin_shape import EYE_CENTRE
from capture_eval.images.mannequin_skin import bake_albedo
from capture_eval.images.mannequin_topology import Topology, build_topology
from capture_eval.images.mannequin_unwrap import density_weights, unwrap
from capture_eval.polygon_mesh import PolygonMesh

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


@lru_cache(maxsize=1)
def _canonical() -> tuple[Topology, FloatArray, dict[str, IntArray], FloatArray, IntArray]:
    topology = build_topology()
    positions = canonical_positions(topology)
    regions = mannequin_regions(topology, positions)
    coordinates, corners = unwrap(topology, positions, density_weights(topology, regions))
    return topology, positions, regions, coordinates, corners


def build_mannequin(identity: int = 0) -> Head:
    """The mannequin as a head that can be posed.

    Parameters
    ----------
    identity
        0 is the canonical person; other numbers are other persons with the same topology, texture coordinates,
        landmarks and curves, 2 to 4 % of the head's size away on average.

    Returns
    -------
    Head
        Millimetres, x = subject's left, y = up, z = front.

    Raises
    ------
    InputError
        The identity is negative.

    Examples
    --------
    >>> head = build_mannequin()
    >>> skin, parts = head.pose("jaw_open", 0.5)
    """
    if identity < 0:
        raise InputError(f"mannequin identity {identity}: give 0 or a positive number")
    topology, canonical, regions, coordinates, corners = _canonical()
    neutral = identity_positions(topology, canonical, identity)
    skin = PolygonMesh.from_faces(neutral, topology.quads, coordinates, corners)
    turns = {motion: _moved_turns(skin_turns(topology, canonical, motion), canonical, identity) for motion in MOTIONS}
    parts = _identity_parts(mannequin_parts(identity), canonical, identity)
    hinge = turns["jaw_open"][0].centre
    moved = np.any([turn.degrees != 0 for group in turns.values() for turn in group], axis=0)

    def albedo(size: int, contrast: Contrast) -> NDArray[np.uint8]:
        return bake_albedo(topology, canonical, coordinates, corners, size, contrast, identity)

    def pose(motion: str, amount: float) -> tuple[FloatArray, tuple[FloatArray, ...]]:
        if motion not in turns:
            raise InputError(f"motion {motion!r} is unknown to the mannequin: choose one of {', '.join(MOTIONS)}")
        jaw = JAW_ANGLE * amount if motion == "jaw_open" else 0.0
        return apply_turns(neutral, turns[motion], amount), _posed_parts(parts, hinge, jaw)

    return Head(
        name=f"mannequin_{identity}",
        skin=skin,
        albedo=albedo,
        blockers=parts,
        landmarks=mannequin_landmarks(topology),
        curves=tuple(mannequin_curves(topology)),
        rigid_region=rigid_skull(canonical, regions, moved),
        regions=regions,
        motions=MOTIONS,
        pose=pose,
    )


def _moved_turns(turns: tuple[Turn, ...], canonical: FloatArray, identity: int) -> tuple[Turn, ...]:
    """Turns whose axes have gone with the person's shape."""
    scale = identity_scale(canonical, identity)
    moved = []
    for turn in turns:
        # the jaw's axis passes through both joints, 45 mm to the sides
        probe = turn.centre + ([45.0, 0.0, 0.0] if turn.centre is JAW_HINGE else [0.0, 0.0, 0.0])
        offset = scale * identity_offset(probe[None], identity)[0]
        if turn.centre is JAW_HINGE:
            offset = offset * [0.0, 1.0, 1.0]
        moved.append(replace(turn, centre=turn.centre + offset))
    return tuple(moved)


def _identity_parts(parts: tuple[Blocker, ...], canonical: FloatArray, identity: int) -> tuple[Blocker, ...]:
    scale = identity_scale(canonical, identity)
    moved = []
    for part in parts:
        vertices = part.mesh.vertices
        points = vertices
        if part.name.startswith("eye"):
            points = EYE_CENTRE[None] * [1.0 if part.name == "eye_left" else -1.0, 1, 1]
        moved.append(replace(part, mesh=part.mesh.with_vertices(vertices + scale * identity_offset(points, identity))))
    return tuple(moved)


def _posed_parts(parts: tuple[Blocker, ...], hinge: FloatArray, degrees: float) -> tuple[FloatArray, ...]:
    posed = []
    for part in parts:
        vertices = part.mesh.vertices
        if part.name == "teeth_lower" and degrees:
            angle = np.full(len(vertices), np.radians(degrees))
            vertices = rotate_about(vertices, hinge, np.array([1.0, 0.0, 0.0]), angle)
        posed.append(vertices)
    return tuple(posed)
