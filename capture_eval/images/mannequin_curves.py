"""Names on the mannequin: 49 edge-loop curves, landmarks, regions and the rigid part of the skull."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture_eval.images.mannequin_features import EYE_MARGIN, LIP_CONTACT, upper_and_lower
from capture_eval.images.mannequin_topology import Topology

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

_MOUTH_NAMES = ("mouth_ring_1", "mouth_ring_2", "mouth_ring_3", "mouth_ring_4")
_LIP_NAMES = ("lip_outer_1", "lip_outer_2", "lip_middle", "lip_inner_1", "lip_inner_2")
_EYE_RINGS = (1, 3, 4, 5, 6, 7, 8, 10)


def mannequin_curves(topology: Topology) -> list[dict[str, Any]]:
    """The 49 named curves as specifications (start edge, stop where open, region) for the edge-loop walk."""
    curves: list[dict[str, Any]] = []

    def add(name: str, start: IntArray, region: str, stop: int | None = None) -> None:
        curve: dict[str, Any] = {"name": name, "start_edge": [int(start[0]), int(start[1])], "region": region}
        if stop is not None:
            curve["stop"] = int(stop)
        curves.append(curve)

    for ring, name in enumerate(_MOUTH_NAMES + _LIP_NAMES, start=1):
        add(name, topology.rings["mouth"][ring, 2:4], "mouth" if ring < 5 else "lips")
    for side in ("right", "left"):
        for number, ring in enumerate(_EYE_RINGS, start=1):
            add(f"eye_{side}_{number}", topology.rings[f"eye_{side}"][ring, 2:4], "eyes")
    for ring in range(1, 6):
        add(f"face_ring_{ring}", topology.rings["face"][ring, 2:4], "face")
    for side in ("right", "left"):
        for number, ring in enumerate((3, 8), start=1):
            add(f"ear_{side}_{number}", topology.rings[f"ear_{side}"][ring, 2:4], "ears")
    face, skull = topology.face, topology.skull
    for name, row in (("forehead_1", 1), ("forehead_2", 3), ("cheek_1", 12), ("cheek_2", 14), ("chin_1", 30)):
        add(name, face[row, 1:3], name.split("_")[0])
    add("chin_2", face[32, 1:3], "chin")
    for number, row in enumerate((1, 2), start=1):
        add(f"head_ring_{number}", skull[row, 1:3], "scalp")
    for number, row in enumerate((40, 43, 46), start=1):
        add(f"neck_ring_{number}", skull[row, 1:3], "neck")
    middle = face.shape[1] // 2
    nose = face[1:23, middle]
    add("profile_nose", nose, "nose", stop=nose[-1])
    chin = face[28:, middle]
    add("profile_chin", chin, "chin", stop=chin[-1])
    for side, column in (("right", 2), ("left", face.shape[1] - 3)):
        add(f"cheek_{side}", face[1:, column], "cheeks", stop=face[-2, column])
    return curves


def mannequin_landmarks(topology: Topology) -> dict[str, int]:
    """Named vertices: eyes, brows, nose, lips, chin, jaw and ears."""
    face, rings = topology.face, topology.rings
    middle = face.shape[1] // 2
    lips, border = rings["mouth"][LIP_CONTACT], rings["mouth"][5]
    upper, lower = upper_and_lower(6, 14)
    landmarks = {
        "glabella": face[4, middle],
        "nasion": face[6, middle],
        "nose_bridge": face[10, middle],
        "nose_tip": face[16, middle],
        "nose_base": face[21, middle],
        "lip_upper_top": border[upper[10]],
        "lip_upper_bottom": lips[upper[10]],
        "lip_lower_top": lips[lower[10]],
        "lip_lower_bottom": border[lower[10]],
        "lip_corner_right": border[upper[0]],
        "lip_corner_left": border[upper[-1]],
        "chin": face[31, middle],
        "chin_bottom": face[-1, middle],
    }
    above, below = upper_and_lower(6, 8)
    for side, inner, outer in (("right", -1, 0), ("left", 0, -1)):
        margin = rings[f"eye_{side}"][EYE_MARGIN]
        landmarks[f"eye_inner_{side}"] = margin[above[inner]]
        landmarks[f"eye_outer_{side}"] = margin[above[outer]]
        landmarks[f"lid_upper_{side}"] = margin[above[7]]
        landmarks[f"lid_lower_{side}"] = margin[below[7]]
        column = middle + (5 if side == "left" else -5)
        landmarks[f"nose_wing_{side}"] = face[17, column]
        landmarks[f"brow_{side}"] = rings[f"eye_{side}"][1, 4]
        ring = rings[f"ear_{side}"][3]
        landmarks[f"ear_top_{side}"] = ring[2 if side == "left" else 3]
        landmarks[f"ear_lobe_{side}"] = ring[16 if side == "left" else 17]
        corner, (height, width) = rings["face"][0], np.array(face.shape) - 1
        landmarks[f"gonion_{side}"] = corner[width + height - 2 if side == "left" else 2 * width + height + 2]
    return {name: int(vertex) for name, vertex in sorted(landmarks.items())}


def mannequin_regions(topology: Topology, positions: FloatArray) -> dict[str, IntArray]:
    """Region name -> vertices; a partition of the skin by topology and canonical position."""
    x, y, z = positions.T
    label = np.full(len(positions), "cheeks", dtype=object)
    label[y > 34] = "forehead"
    label[(np.abs(x) < 17) & (y < 12) & (y > -50) & (z > 84)] = "nose"
    label[(y < -76) & (np.abs(x) < 40)] = "chin"
    outside = _outside_face(topology)
    label[outside] = "scalp"
    label[outside & (y < -40) & (z > -60)] = "neck"
    label[y < -85 - 0.6 * np.clip(z - 20, 0, 60)] = "neck"
    for side in ("right", "left"):
        label[topology.rings[f"eye_{side}"][2:11]] = "eyes"
        label[topology.rings[f"eye_{side}"][11:]] = "inner"
        label[topology.inner[f"eye_{side}"]] = "inner"
        label[topology.rings[f"ear_{side}"][1:]] = "ears"
        label[topology.inner[f"ear_{side}"]] = "ears"
        label[topology.rings[f"nostril_{side}"]] = "nose"
        label[topology.rings[f"nostril_{side}"][2:]] = "inner"
        label[topology.inner[f"nostril_{side}"]] = "inner"
    label[topology.rings["mouth"][5:11]] = "lips"
    label[topology.rings["mouth"][11:]] = "inner"
    label[topology.inner["mouth"]] = "inner"
    names = ("lips", "chin", "cheeks", "forehead", "eyes", "nose", "ears", "scalp", "neck", "inner")
    return {name: np.flatnonzero(label == name).astype(np.int64) for name in names}


def _outside_face(topology: Topology) -> NDArray[np.bool_]:
    outside = np.zeros(topology.vertex_count, dtype=bool)
    outside[topology.skull] = True
    outside[topology.cap] = True
    outside[topology.face] = False
    outside[topology.rings["face"]] = False
    for name, levels in topology.rings.items():
        if not name.startswith("ear"):
            outside[levels] = False
            outside[topology.inner.get(name, levels)] = False
    outside[topology.rings["face"][0]] = True
    return outside


def rigid_skull(positions: FloatArray, regions: dict[str, IntArray], moved: NDArray[np.bool_]) -> IntArray:
    """Vertices of skull, forehead above the brows, nose bridge and ears that no motion moves, ascending."""
    y, z = positions[:, 1], positions[:, 2]
    wanted = np.zeros(len(positions), dtype=bool)
    for name in ("scalp", "forehead", "ears"):
        wanted[regions[name]] = True
    wanted[regions["nose"]] = y[regions["nose"]] > -25
    wanted &= ~((y < -40) & (z < 0))
    return np.flatnonzero(wanted & ~moved).astype(np.int64)
