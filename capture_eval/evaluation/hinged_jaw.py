"""A jaw on a hinge whose motion is known exactly: the experiment that tells timing from path.

5,047 points on 49 closed loops round the mouth of an ellipsoid face; the jaw turns by 25° about an axis from ear to
ear with smoothstep weights; the largest displacement is 0.381 D, with D = 1.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from capture_eval.curves.extract import Curve, CurveSet, extract_curves

Floats = NDArray[np.float64]

LOOPS, AROUND = 49, 103
ANGLE = float(np.deg2rad(25.0))
LARGEST_DISPLACEMENT = 0.381
_HINGE = (0.1, 0.2)  # y and z before scaling


def hinged_jaw(share: Floats) -> CurveSet:
    """The loops in all poses.

    Parameters
    ----------
    share : (P,)
        Part of the angle in each pose, 0 first and 1 last: the timing.

    Returns
    -------
    CurveSet
        49 closed curves of 103 points, positions (P, 103, 3) in units of D.
    """
    ring, turn = np.meshgrid(np.linspace(0.1, 1.0, LOOPS), 2 * np.pi * np.arange(AROUND) / AROUND, indexing="ij")
    across, up = 0.35 * ring * np.sin(turn), 0.45 * ring * np.cos(turn)
    forward = np.sqrt(1 - (across / 0.4) ** 2 * 0.5 - (up / 0.5) ** 2 * 0.5)
    points = np.stack([across, up, forward], axis=-1).reshape(-1, 3)
    below = np.clip(-points[:, 1] / 0.25, 0.0, 1.0)
    weights = below**2 * (3 - 2 * below)
    arm = points[:, 1:] - np.array(_HINGE)
    farthest = (2 * np.linalg.norm(arm, axis=1) * np.sin(0.5 * ANGLE * weights)).max()
    scale = LARGEST_DISPLACEMENT / farthest
    arm, points = arm * scale, points * scale
    angle = ANGLE * np.asarray(share, dtype=np.float64)[:, None] * weights
    moved = np.repeat(points[None], len(angle), axis=0)
    moved[..., 1] += np.cos(angle) * arm[:, 0] - np.sin(angle) * arm[:, 1] - arm[:, 0]
    moved[..., 2] += np.sin(angle) * arm[:, 0] + np.cos(angle) * arm[:, 1] - arm[:, 1]
    indices = np.arange(LOOPS * AROUND).reshape(LOOPS, AROUND)
    return extract_curves([Curve(f"loop_{n + 1}", loop, True) for n, loop in enumerate(indices)], moved)
