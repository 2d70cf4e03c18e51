"""Timing of a motion: how far the motion has gone (0 to 1) at time t of the sequence.

The timing decides which interpolation method is right: a straight-line method is exact for a straight motion with
linear timing, and wrong by the timing alone otherwise.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from capture_eval.errors import InputError

FloatArray = NDArray[np.float64]
Timing = Callable[[ArrayLike], FloatArray]


def linear(t: ArrayLike) -> FloatArray:
    """The motion goes on evenly: t."""
    return np.asarray(t, dtype=np.float64) * 1.0


def eased(t: ArrayLike) -> FloatArray:
    """Start and end at rest, 10 t^3 - 15 t^4 + 6 t^5 (the minimum-jerk law; Flash & Hogan 1985)."""
    t = np.asarray(t, dtype=np.float64)
    return t**3 * (10.0 + t * (-15.0 + 6.0 * t))


def power(exponent: float) -> Timing:
    """The law t^exponent; above 1 the motion accelerates.

    Raises
    ------
    InputError
        The exponent is not a finite number above 0.
    """
    if not np.isfinite(exponent) or exponent <= 0.0:
        raise InputError(f"timing power:{exponent:g}: the exponent must be a finite number above 0, such as power:2")

    def law(t: ArrayLike) -> FloatArray:
        return np.asarray(t, dtype=np.float64) ** exponent

    return law


def parse_timing(text: str) -> Timing:
    """Timing law named by ``linear``, ``eased`` or ``power:p``.

    Raises
    ------
    InputError
        The text names none of them.

    Examples
    --------
    >>> float(parse_timing("power:2")(0.5))
    0.25
    """
    if text == "linear":
        return linear
    if text == "eased":
        return eased
    name, _, exponent = text.partition(":")
    if name == "power":
        try:
            return power(float(exponent))
        except ValueError as error:
            if isinstance(error, InputError):
                raise
            raise InputError(f"timing {text!r}: {exponent!r} is not a number; write power:2") from None
    raise InputError(f"timing {text!r} is unknown; use linear, eased or power:p (for example power:2)")
