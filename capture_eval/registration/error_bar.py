"""Error bars of registered vertices: what 95 % of the true errors should stay below.

    bar^2 = floor^2 + (factor * spread)^2 + (doubt * (1 - confidence))^2

The spread between photo halves holds sensor noise and sampling, and is a fraction of the whole error: both halves share
the deformation's smoothing, the cameras and the light. `factor` stretches it to the 95 % quantile, `floor` is what
remains where the spread is nothing, `doubt` what is added where little measured. The constants were fitted to one
rendered capture by `benchmarks/registration_error_bars.py` (MakeHuman head, jaw_open, 24 photos at 640x480), which also
prints what they cover on others.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from capture_eval.errors import InputError

Floats = NDArray[np.float64]

COVERAGE = 0.95


@dataclass(frozen=True)
class BarModel:
    """Parts of a bar.

    Parameters
    ----------
    floor, doubt : float
        Fractions of D.
    factor : float
        Multiple of the spread.
    """

    floor: float
    factor: float
    doubt: float

    def __post_init__(self) -> None:
        if min(self.floor, self.factor, self.doubt) < 0:
            raise InputError(f"error bar: floor {self.floor}, factor {self.factor}, doubt {self.doubt} must be >= 0")


@dataclass(frozen=True)
class ErrorBarOptions:
    """Two bars per vertex and pose.

    Parameters
    ----------
    position : BarModel
        Distance from the true place of the skin point.
    motion : BarModel
        Error of the way from the neutral: the vertex's own offset from the skin in the neutral moves with the skin and
        is taken out. Interpolation errors see this one.
    """

    position: BarModel = field(default_factory=lambda: BarModel(floor=0.00057, factor=5.4, doubt=0.0052))
    motion: BarModel = field(default_factory=lambda: BarModel(floor=0.00026, factor=4.1, doubt=0.0029))


def error_bar(spread: Floats, confidence: Floats, size: float, model: BarModel) -> Floats:
    """The 95 % bar of each vertex in the unit of `spread`; NaN where the spread is.

    Parameters
    ----------
    spread : (...) float64
        Root mean square random error (`half_difference_spread`).
    confidence : (...) float64
        In [0, 1], of the same shape.
    size : float
        D in the unit of the spread.

    Raises
    ------
    InputError
        Shapes differ or D is not positive.

    Examples
    --------
    >>> error_bar(np.array([0.0, 3.0]), np.array([1.0, 1.0]), 100.0, BarModel(0.04, 1.0, 0.0))
    array([4., 5.])
    """
    if spread.shape != confidence.shape:
        raise InputError(f"error bar: spread {spread.shape} and confidence {confidence.shape} differ")
    if not size > 0:
        raise InputError(f"error bar: D is {size}")
    parts = (model.floor * size, model.factor * spread, model.doubt * size * (1.0 - confidence))
    return np.asarray(np.sqrt(sum(np.square(part) for part in parts)), dtype=np.float64)
