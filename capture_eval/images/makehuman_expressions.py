"""MakeHuman's facial pose units as a blendshape rig of any identity, for planning and for measuring plans."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from capture_eval.images.makehuman_assets import MakeHumanAssets
from capture_eval.images.makehuman_head import HeadCut, cut_head, identity, rest_vertices
from capture_eval.images.makehuman_skeleton import pose_by_turns
from capture_eval.polygon_mesh import PolygonMesh

FloatArray = NDArray[np.float64]

# Pose units that move the skin by less than this (millimetres) are no shapes: eyes and tongue have their own bones.
_SMALLEST_MOVE = 0.3


def pose_unit_shapes(
    assets: MakeHumanAssets, number: int = 0, cut: HeadCut | None = None
) -> tuple[PolygonMesh, tuple[str, ...], FloatArray]:
    """Neutral head of an identity, names of the pose units, and the head posed by each.

    Which pose units are shapes is decided on identity 0, so that all identities have the same.

    Returns
    -------
    neutral : PolygonMesh
        Quads, millimetres, x = subject's left, y up, z front.
    names : tuple of str
    shapes : (K, V, 3) float64
        Positions at full amount.
    """
    cut = cut or cut_head(assets)
    average = rest_vertices(assets, identity(0))
    names = []
    for name, turns in assets.pose_units.items():
        moved = pose_by_turns(assets, average, turns)[cut.vertices] - average[cut.vertices]
        if np.linalg.norm(moved, axis=1).max() > _SMALLEST_MOVE:
            names.append(name)
    rest = rest_vertices(assets, identity(number))
    shapes = np.array([pose_by_turns(assets, rest, assets.pose_units[name])[cut.vertices] for name in names])
    return PolygonMesh.from_faces(rest[cut.vertices], cut.faces), tuple(names), shapes
