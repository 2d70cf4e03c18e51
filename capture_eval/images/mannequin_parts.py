"""Eyeballs and teeth of the mannequin: simple separate meshes that hide skin and fill the openings."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from capture_eval.images.head import Blocker
from capture_eval.images.mannequin_shape import EYE_CENTRE, EYE_RADIUS
from capture_eval.polygon_mesh import PolygonMesh

FloatArray = NDArray[np.float64]
ByteArray = NDArray[np.uint8]

_SEGMENTS, _BANDS = 32, 20


def eyeball(name: str, centre: FloatArray, seed: int) -> Blocker:
    """Eyeball of radius 12 mm looking to the front, textured over polar angle (v) and turn (u)."""
    turn = 2 * np.pi * np.arange(_SEGMENTS) / _SEGMENTS
    polar = np.pi * np.arange(1, _BANDS) / _BANDS
    sine, cosine = np.sin(polar)[:, None], np.cos(polar)[:, None]
    shape = (len(polar), _SEGMENTS)
    ball = np.stack([sine * np.cos(turn), sine * np.sin(turn), np.broadcast_to(cosine, shape)], axis=-1).reshape(-1, 3)
    vertices = centre + EYE_RADIUS * np.concatenate([ball, [[0, 0, 1.0]], [[0, 0, -1.0]]])
    front, back = len(ball), len(ball) + 1
    u, v = np.meshgrid(np.arange(_SEGMENTS + 1) / _SEGMENTS, 1 - polar / np.pi)
    middle = (np.arange(_SEGMENTS) + 0.5) / _SEGMENTS
    poles = [np.stack([middle, np.full(_SEGMENTS, level)], axis=1) for level in (1.0, 0.0)]
    coordinates = np.concatenate([np.stack([u.ravel(), v.ravel()], axis=1), *poles])
    faces: list[list[int]] = []
    textures: list[list[int]] = []
    texture_row = _SEGMENTS + 1
    first_pole = texture_row * len(polar)
    for s in range(_SEGMENTS):
        t = (s + 1) % _SEGMENTS
        faces.append([front, s, t])
        textures.append([first_pole + s, s, s + 1])
        for band in range(len(polar) - 1):
            a, b = band * _SEGMENTS, (band + 1) * _SEGMENTS
            faces.append([a + s, b + s, b + t, a + t])
            c, d = band * texture_row, (band + 1) * texture_row
            textures.append([c + s, d + s, d + s + 1, c + s + 1])
        a, c = (len(polar) - 1) * _SEGMENTS, (len(polar) - 1) * texture_row
        faces.append([a + s, back, a + t])
        textures.append([c + s, first_pole + _SEGMENTS + s, c + s + 1])
    mesh = PolygonMesh.from_faces(vertices, faces, coordinates, textures)
    return Blocker(name, mesh, texture=eye_texture(seed), gloss=4.0)


def eye_texture(seed: int, height: int = 256, width: int = 256) -> ByteArray:
    """Sclera with veins, iris with radial fibres, pupil: (height, width, 3) uint8, row 0 at the front pole."""
    generator = np.random.default_rng(seed)
    polar = 180.0 * (np.arange(height) + 0.5) / height
    fibre = np.interp(np.arange(width), np.linspace(0, width, 65), generator.normal(0, 1, 65))
    fibre[-8:] += np.linspace(0, 1, 8) * (fibre[0] - fibre[-1])
    veins = np.abs(np.interp(np.arange(width), np.linspace(0, width, 25), generator.normal(0, 1, 25)))
    sclera = np.array([226.0, 216.0, 210.0]) - np.clip(polar[:, None] - 30, 0, 60)[..., None] * [0.2, 0.8, 0.8]
    sclera = np.broadcast_to(sclera, (height, width, 3)) - (veins < 0.12)[None, :, None] * np.array([4.0, 26.0, 26.0])
    iris = np.array([104.0, 88.0, 62.0]) + 16.0 * fibre[None, :, None] + (22 - polar)[:, None, None] * [1.6, 1.2, 0.2]
    rim = np.clip((27.5 - polar) / 5.0, 0.35, 1.0)[:, None, None]
    pupil = np.clip((polar - 9.5) / 1.5, 0.0, 1.0)[:, None, None]
    share = np.clip((28.8 - polar) / 1.6, 0.0, 1.0)[:, None, None]
    image = (1 - share) * sclera + share * (iris * rim * pupil + 12.0)
    return np.asarray(np.clip(image, 0, 255) + 0.5).astype(np.uint8)


def teeth(name: str, upper: bool) -> Blocker:
    """Row of teeth with gum as a strip along the dental arch, coloured per vertex."""
    columns = 113
    x = np.linspace(-24.0, 24.0, columns)
    inward = np.array([1.0, 0.8, 0.35, 0.0, 0.0, 0.3, 0.9])
    levels = np.array([-55.0, -56.5, -58.5, -60.0, -63.5, -66.4, -66.9])
    if not upper:
        levels = np.array([-79.0, -77.5, -75.5, -74.0, -70.5, -67.6, -67.2])
    tooth = np.abs(np.sin(np.pi * (x - x[0]) / (6.9 if upper else 5.4)))
    round_off = 1.2 * (1 - tooth**0.35)
    arch = (82.0 if upper else 80.2) - 12.0 * (x / 25.0) ** 2
    z = arch[None] - 1.5 * inward[:, None] - 0.5 * round_off[None]
    y = np.broadcast_to(levels[:, None], z.shape)
    vertices = np.stack([np.broadcast_to(x, z.shape), y, z], axis=-1).reshape(-1, 3)
    index = np.arange(len(vertices)).reshape(z.shape)
    quads = np.stack([index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]], axis=-1).reshape(-1, 4)
    quads = quads if upper else quads[:, ::-1]
    enamel = np.array([222.0, 212.0, 190.0]) - 70 * (1 - tooth**0.3)[:, None]
    gum = np.array([170.0, 92.0, 90.0]) - 14 * (1 - tooth)[:, None]
    colors = np.stack([gum, gum, gum, enamel, enamel, enamel, enamel * 0.9])
    mesh = PolygonMesh.from_faces(vertices, quads)
    return Blocker(name, mesh, colors=np.clip(colors, 0, 255).reshape(-1, 3).astype(np.uint8), gloss=2.0)


def mannequin_parts(seed: int) -> tuple[Blocker, ...]:
    """Eyeballs and teeth of the canonical head, millimetres."""
    return (
        eyeball("eye_left", EYE_CENTRE, 7 + seed),
        eyeball("eye_right", EYE_CENTRE * [-1, 1, 1], 8 + seed),
        teeth("teeth_upper", True),
        teeth("teeth_lower", False),
    )
