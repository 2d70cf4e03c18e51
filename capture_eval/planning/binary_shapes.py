"""Binary shapes: where a blendshape moves strongly (Carrigan et al. 2020, Eq 2)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from capture_eval.errors import InputError
from capture_eval.planning.blendshape_rig import BlendshapeRig

Booleans = NDArray[np.bool_]


def binary_shapes(rig: BlendshapeRig, threshold: float = 0.3, ignored: Booleans | None = None) -> Booleans:
    """Active vertices of every shape, (K, N): displaced by ``threshold`` of the shape's largest displacement or more.

    Parameters
    ----------
    rig : BlendshapeRig
    threshold : float
        In (0, 1]; the paper uses 0.25 to 0.40. A vertex that sits on the threshold is active.
    ignored : (N,) bool, optional
        Vertices that are never active and do not count for the largest displacement (lashes, eyeballs).

    Raises
    ------
    InputError
        The threshold is outside (0, 1], the mask does not fit, or a shape does not move (outside the mask).
    """
    if not 0.0 < threshold <= 1.0:
        raise InputError(f"threshold {threshold}: must be above 0 and at most 1")
    lengths = rig.lengths
    if ignored is not None:
        if ignored.shape != (len(rig.neutral),):
            raise InputError(f"vertex mask {ignored.shape} does not fit {len(rig.neutral)} vertices")
        lengths = np.where(ignored, 0.0, lengths)
    largest = lengths.max(axis=1, initial=0.0)
    if np.any(largest == 0.0):
        name = rig.names[int(np.argmax(largest == 0.0))]
        where = "" if ignored is None else " outside the masked vertices"
        raise InputError(f"shape {name} is equal to the neutral{where}: remove it from the rig")
    return np.asarray(lengths >= threshold * largest[:, None], dtype=np.bool_)
