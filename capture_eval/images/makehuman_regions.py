"""Regions of a MakeHuman head (lips, eyes, nose, ...), from edge loops and from places on the average head."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from capture_eval.images.mesh_walks import closed_loop, faces_enclosed

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

# Base vertices: first edge of a loop, and a vertex inside it.
_LIP_LOOP, _MOUTH_INSIDE = (374, 377), 455
# The red of the lips begins between this loop and the next one inwards.
_RED_LOOP, _LIP_INSIDE = (402, 403), 413
_EYE_LOOPS = (((109, 113), 1), ((6893, 6897), 6785))
_LID_LOOPS = ((0, 1), (6784, 6785))
MAIN_ISLAND = 0


def _enclosed(vertices: IntArray, faces: IntArray, edge: tuple[int, int], inside: int) -> NDArray[np.bool_]:
    """Vertices strictly inside a loop given in base vertices: (V,) bool."""
    start, following, seed = np.searchsorted(vertices, [*edge, inside])
    loop = closed_loop(faces, (int(start), int(following)))
    chosen = np.zeros(len(vertices), dtype=np.bool_)
    chosen[faces[faces_enclosed(faces, loop, int(seed))]] = True
    chosen[loop] = False
    return chosen


def hidden_vertices(faces: IntArray, face_textures: IntArray, islands: IntArray, count: int) -> NDArray[np.bool_]:
    """Vertices of the linings of mouth and eye sockets only: (V,) bool."""
    main = islands[face_textures[:, 0]]
    lining = np.isin(main, [1, 2, 3])
    hidden = np.zeros(count, dtype=np.bool_)
    hidden[faces[lining]] = True
    hidden[faces[~lining]] = False
    return hidden


def region_masks(vertices: IntArray, faces: IntArray, face_textures: IntArray, islands: IntArray) -> FloatArray:
    """Masks (V, 3) in [0, 1] that the skin colour needs: lips, linings, edges of the lids.

    Parameters
    ----------
    vertices
        (V,) base vertices of the head.
    faces, face_textures
        (F, 4).
    islands
        Texture island of every texture coordinate.
    """
    masks = np.zeros((len(vertices), 3))
    masks[_enclosed(vertices, faces, _RED_LOOP, _LIP_INSIDE), 0] = 1.0
    masks[hidden_vertices(faces, face_textures, islands, len(vertices)), 1] = 1.0
    for edge in _LID_LOOPS:
        start, following = np.searchsorted(vertices, edge)
        masks[closed_loop(faces, (int(start), int(following))), 2] = 1.0
    return masks


def head_regions(
    vertices: IntArray, faces: IntArray, face_textures: IntArray, islands: IntArray, places: FloatArray
) -> dict[str, IntArray]:
    """Partition of the vertices into named regions.

    Parameters
    ----------
    places
        (V, 3) on the average head, millimetres, x = subject's left, y up, z front.
    """
    x, y, z = np.abs(places[:, 0]), places[:, 1], places[:, 2]
    eyes = np.zeros(len(vertices), dtype=np.bool_)
    for edge, inside in _EYE_LOOPS:
        eyes |= _enclosed(vertices, faces, edge, inside)
    rules = {
        "inner": hidden_vertices(faces, face_textures, islands, len(vertices)),
        "lips": _enclosed(vertices, faces, _LIP_LOOP, _MOUTH_INSIDE),
        "eyes": eyes,
        "ears": (x > 68.0) & (y > -25.0) & (y < 49.0) & (z > -50.0) & (z < 20.0),
        "neck": (y < -76.0) | ((y < -30.0) & (z < 20.0)),
        "nose": (x < 20.0) & (y > -12.0) & (y < 34.0) & (z > 88.0),
        "chin": (x < 30.0) & (y < -42.0) & (z > 50.0),
        "scalp": y > np.interp(z, (-50.0, -20.0, 30.0, 62.0), (-30.0, 48.0, 56.0, 95.0)),
        "forehead": (y > 47.0) & (z > 35.0),
        "cheeks": np.ones(len(vertices), dtype=np.bool_),
    }
    free = np.ones(len(vertices), dtype=np.bool_)
    regions = {}
    for name, rule in rules.items():
        regions[name] = np.flatnonzero(rule & free).astype(np.int64)
        free &= ~rule
    return regions
