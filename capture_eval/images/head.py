"""A head with known truth: what the photographer (ray casting) needs to know about a subject.

The embedded mannequin and the MakeHuman heads are both handed on as a `Head`, so everything after it (cameras, ray
casting, capture folders) is written once.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from capture_eval.errors import InputError
from capture_eval.polygon_mesh import PolygonMesh

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
ByteArray = NDArray[np.uint8]
Contrast = Literal["normal", "weak"]


@dataclass(frozen=True)
class Blocker:
    """A part that hides skin or fills a hole and is no skin itself: eyeball, teeth, tongue.

    Attributes
    ----------
    name
        For example ``eye_left``.
    mesh
        Neutral vertices in millimetres (frame of the head) and faces; with texture coordinates where `texture` is
        given.
    colors
        (V, 3) uint8 sRGB colour of every vertex, or None when `texture` is used.
    texture
        (H, W, 3) uint8 sRGB image, row 0 at the top (v = 1), or None when `colors` are used.
    gloss
        Strength of the specular highlight relative to skin (1 = like skin, eyes are larger).
    """

    name: str
    mesh: PolygonMesh
    colors: ByteArray | None = None
    texture: ByteArray | None = None
    gloss: float = 1.0

    def __post_init__(self) -> None:
        if (self.colors is None) == (self.texture is None):
            raise InputError(f"blocker {self.name}: give either colors or texture")
        if self.colors is not None and self.colors.shape != (len(self.mesh.vertices), 3):
            raise InputError(
                f"blocker {self.name}: colors {self.colors.shape} do not fit {len(self.mesh.vertices)} vertices"
            )
        if self.texture is not None and self.mesh.texture_coordinates is None:
            raise InputError(f"blocker {self.name}: a texture needs texture coordinates on the mesh")


@dataclass(frozen=True)
class Head:
    """A textured head of known shape that can be posed.

    Frame: millimetres, right-handed, x = subject's left, y = up, z = front.

    Attributes
    ----------
    name
        For example ``mannequin_0``.
    skin
        Neutral skin, all quads, with texture coordinates (v up, (0, 0) the lower left corner of the image).
    albedo
        ``albedo(size, contrast)`` -> (size, size, 3) uint8 sRGB image without baked light, row 0 at v = 1; contrast
        is ``normal`` or ``weak``.
    blockers
        Eyeballs, teeth, ...: drawn and casting shadow, not registered.
    landmarks
        Name -> vertex of the skin.
    curves
        Curve specifications as in the curves file: ``{name, start_edge, turns?, stop?, region}`` or
        ``{name, vertices, closed, region}``.
    rigid_region
        Vertices of the skin that no motion moves (skull), ascending.
    regions
        Region name -> vertices of the skin (a partition: lips, chin, cheeks, forehead, eyes, nose, ears, scalp, neck,
        inner).
    motions
        Names that `pose` takes.
    pose
        ``pose(motion, amount)`` -> (skin vertices (V, 3), tuple of blocker vertices in the order of `blockers`);
        amount in [0, 1] is the value of the timing, 0 = neutral.
    """

    name: str
    skin: PolygonMesh
    albedo: Callable[[int, Contrast], ByteArray]
    blockers: tuple[Blocker, ...]
    landmarks: Mapping[str, int]
    curves: tuple[Mapping[str, Any], ...]
    rigid_region: IntArray
    regions: Mapping[str, IntArray]
    motions: tuple[str, ...]
    pose: Callable[[str, float], tuple[FloatArray, tuple[FloatArray, ...]]]

    def __post_init__(self) -> None:
        count = len(self.skin.vertices)
        if self.skin.texture_coordinates is None:
            raise InputError(f"head {self.name}: the skin has no texture coordinates")
        beyond = [name for name, vertex in self.landmarks.items() if not 0 <= vertex < count]
        if beyond:
            raise InputError(f"head {self.name}: landmarks {beyond} name vertices outside 0..{count - 1}")
        if len(self.rigid_region) and not 0 <= self.rigid_region.min() <= self.rigid_region.max() < count:
            raise InputError(f"head {self.name}: the rigid region names vertices outside 0..{count - 1}")
