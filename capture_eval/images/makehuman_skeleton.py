"""Posing by bones: linear-blend skinning of the MakeHuman skeleton with facial pose units.

A bone's rotation vector is the weighted sum of the rotation vectors of its pose units (axes of the rest pose), times
the amount of the motion; bones chain from parent to child. So every point of the skin moves on an arc, not on a line.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from capture_eval.errors import InputError
from capture_eval.images.makehuman_assets import MakeHumanAssets

FloatArray = NDArray[np.float64]

# Weights of the pose units at full amount.
MOTIONS: Mapping[str, Mapping[str, float]] = {
    "jaw_open": {"JawDrop": 0.8, "JawDropStretched": 0.35},
    "grin": {
        "MouthLeftPullUp": 0.8,
        "MouthRightPullUp": 0.8,
        "MouthLeftPullSide": 0.3,
        "MouthRightPullSide": 0.3,
        "LeftCheekUp": 0.6,
        "RightCheekUp": 0.6,
        "UpperLipUp": 0.6,
        "lowerLipDown": 0.35,
        "LeftLowerLidUp": 0.4,
        "RightLowerLidUp": 0.4,
    },
    "blink_frown": {
        "LeftUpperLidClosed": 0.86,
        "RightUpperLidClosed": 0.86,
        "LeftLowerLidUp": 0.45,
        "RightLowerLidUp": 0.45,
        "LeftBrowDown": 0.8,
        "RightBrowDown": 0.8,
        "NoseWrinkler": 0.35,
    },
}


def bone_rotations(assets: MakeHumanAssets, motion: str) -> dict[str, FloatArray]:
    """Rotation vector (radians) of every bone that turns in a motion at full amount.

    Raises
    ------
    InputError
        The motion is unknown.
    """
    if motion not in MOTIONS:
        raise InputError(f"motion {motion!r} is unknown; MakeHuman heads have {', '.join(MOTIONS)}")
    turns: dict[str, FloatArray] = {}
    for unit, weight in MOTIONS[motion].items():
        for bone, turn in assets.pose_units[unit].items():
            turns[bone] = turns.get(bone, np.zeros(3)) + weight * turn
    return turns


def pose_vertices(assets: MakeHumanAssets, rest: FloatArray, motion: str, amount: float) -> FloatArray:
    """Posed positions of all base vertices.

    Parameters
    ----------
    assets
        Skeleton, weights and pose units.
    rest
        (V, 3) morphed base mesh, any unit; bone heads are recomputed from it.
    motion
        One of `MOTIONS`.
    amount
        0 = rest, 1 = full motion; scales the angles.
    """
    return pose_by_turns(assets, rest, bone_rotations(assets, motion), amount)


def pose_by_turns(
    assets: MakeHumanAssets, rest: FloatArray, turns: Mapping[str, FloatArray], amount: float = 1.0
) -> FloatArray:
    """Posed positions of all base vertices for rotation vectors (radians) of bones, scaled by an amount."""
    from scipy.spatial.transform import Rotation

    moved = np.zeros_like(rest)
    total = np.zeros(len(rest))
    rotations: dict[str, FloatArray] = {}
    offsets: dict[str, FloatArray] = {}
    for bone, parent in assets.skeleton.parents.items():
        rotation, offset = np.eye(3), np.zeros(3)
        if parent is not None:
            rotation, offset = rotations[parent], offsets[parent]
        if bone in turns and amount != 0.0:
            head = rest[assets.skeleton.head_vertices[bone]].mean(axis=0)
            own = Rotation.from_rotvec(amount * turns[bone]).as_matrix()
            offset = rotation @ (head - own @ head) + offset
            rotation = rotation @ own
        rotations[bone], offsets[bone] = rotation, offset
        if bone in assets.weights:
            vertices, weights = assets.weights[bone]
            moved[vertices] += weights[:, None] * (rest[vertices] @ rotation.T + offset)
            total[vertices] += weights
    loose = total <= 0.0
    moved[loose], total[loose] = rest[loose], 1.0
    return np.asarray(moved / total[:, None], dtype=np.float64)
