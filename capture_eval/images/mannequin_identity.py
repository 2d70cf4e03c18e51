"""Other persons with the mannequin's topology: a smooth symmetric change of shape drawn from a seed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from capture_eval.images.mannequin_shape import EYE_CENTRE
from capture_eval.images.mannequin_topology import Topology

FloatArray = NDArray[np.float64]

MEAN_DIFFERENCE = 6.6

# centre (mm, subject's left), radius (mm), direction of the local change
_LOCAL = (
    ((0.0, -98.0, 80.0), 46.0, (0.0, -0.7, 0.7)),  # chin length
    ((50.0, -75.0, 15.0), 50.0, (1.0, 0.0, 0.0)),  # jaw width
    ((48.0, -25.0, 55.0), 42.0, (0.8, 0.0, 0.6)),  # cheekbones
    ((0.0, -30.0, 108.0), 40.0, (0.0, -0.3, 1.0)),  # nose length
    ((0.0, 5.0, 88.0), 34.0, (0.0, 0.0, 1.0)),  # nose bridge
    ((14.0, -40.0, 92.0), 26.0, (1.0, 0.0, 0.0)),  # nose width
    ((28.0, 20.0, 84.0), 38.0, (0.0, 0.3, 1.0)),  # brow ridge
    ((0.0, 70.0, 70.0), 60.0, (0.0, 0.3, 1.0)),  # forehead
    ((0.0, 30.0, -95.0), 80.0, (0.0, 0.0, -1.0)),  # back of the head
    ((24.0, -66.0, 80.0), 34.0, (1.0, 0.0, 0.0)),  # mouth width
    ((75.0, -10.0, -25.0), 45.0, (1.0, 0.2, 0.0)),  # ears
    ((32.0, 0.0, 70.0), 40.0, (1.0, 0.3, 0.2)),  # distance and height of the eyes
)


def identity_offset(points: FloatArray, seed: int) -> FloatArray:
    """Displacement (N, 3) in millimetres of points (N, 3) of the canonical head; identity 0 moves nothing.

    The change is stretching along the axes plus smooth local changes, symmetric in x. It is not yet scaled.
    """
    if seed == 0:
        return np.zeros_like(points)
    generator = np.random.default_rng(1000 + seed)
    stretch = generator.uniform(0.6, 1.0, 3) * generator.choice([-1.0, 1.0], 3) * [0.055, 0.055, 0.045]
    offset = points * stretch
    side = np.tanh(points[:, :1] / 10.0)
    folded = np.abs(points)
    folded[:, 1:] = points[:, 1:]
    for centre, radius, direction in _LOCAL:
        size = generator.uniform(0.4, 1.0) * generator.choice([-1.0, 1.0]) * 0.07 * radius
        distance = np.linalg.norm(folded - np.array(centre), axis=1) / radius
        weight = np.exp(-(distance**2))[:, None]
        offset = offset + size * weight * np.array(direction) * np.concatenate(
            [side, np.ones_like(side), np.ones_like(side)], axis=1
        )
    return np.asarray(offset)


def identity_scale(positions: FloatArray, seed: int) -> float:
    """Factor that makes the mean difference to the canonical head `MEAN_DIFFERENCE` millimetres."""
    if seed == 0:
        return 1.0
    return float(MEAN_DIFFERENCE / np.mean(np.linalg.norm(identity_offset(positions, seed), axis=1)))


def identity_positions(topology: Topology, positions: FloatArray, seed: int) -> FloatArray:
    """Neutral vertices (V, 3) of a person; the eyes keep their size, so that lids go on turning about a ball."""
    scale = identity_scale(positions, seed)
    offset = scale * identity_offset(positions, seed)
    for side, sign in (("left", 1.0), ("right", -1.0)):
        rings, grid = topology.rings[f"eye_{side}"], topology.inner[f"eye_{side}"]
        rigid = scale * identity_offset(EYE_CENTRE[None] * [sign, 1, 1], seed)[0]
        share = np.ones(len(rings))
        share[:4] = (0.1, 0.35, 0.65, 0.9)
        for ring, amount in zip(rings, share, strict=True):
            offset[ring] = amount * rigid + (1 - amount) * offset[ring]
        offset[grid] = rigid
    return np.asarray(positions + offset)
