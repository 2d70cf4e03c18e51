"""Modes of a displacement along a curve, and what their warps in time mean for a reader.

A closed curve is expanded by FFT, an open one into a ramp between its ends plus a sine series (simply supported
ends): a periodic expansion of an open curve does not converge.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import fft

Floats = NDArray[np.float64]

SAMPLES = np.linspace(0.0, 1.0, 201)
_NOTICEABLE = 1e-2  # share of the displacement below which running back or past the end is not worth a warning


def mode_count(point_count: int, closed: bool) -> int:
    """Number of harmonics that a curve of so many points can hold."""
    return point_count // 2 if closed else max(point_count - 2, 0)


def wave_numbers(count: int, closed: bool) -> Floats:
    """2πn of the harmonics n = 1 … count of a closed curve, πn of an open one, per unit of u."""
    return (2.0 if closed else 1.0) * np.pi * np.arange(1, count + 1, dtype=np.float64)


def spread_modes(displacement: Floats, closed: bool, still: Floats, moving: Floats) -> Floats:
    """Sum of the modes of a displacement, each times its factor.

    Parameters
    ----------
    displacement : (M, 3)
        Of the points of a curve.
    closed : bool
        Fourier modes, or a ramp and sine modes.
    still : (T,)
        Factor of the mode without bending: mean or ramp.
    moving : (T, N)
        Factors of the harmonics 1 … N; further ones are left out.

    Returns
    -------
    (T, M, 3) float64
    """
    return _spread_closed(displacement, still, moving) if closed else _spread_open(displacement, still, moving)


def _spread_closed(displacement: Floats, still: Floats, moving: Floats) -> Floats:
    modes = fft.rfft(displacement, axis=0)
    kept = moving.shape[1]
    spectrum = np.zeros((len(still), len(modes), 3), dtype=np.complex128)
    spectrum[:, 0] = still[:, None] * modes[0]
    spectrum[:, 1 : kept + 1] = moving[:, :, None] * modes[1 : kept + 1]
    result: Floats = fft.irfft(spectrum, n=len(displacement), axis=1)
    return result


def _spread_open(displacement: Floats, still: Floats, moving: Floats) -> Floats:
    place = np.linspace(0.0, 1.0, len(displacement))[:, None]
    ramp = (1.0 - place) * displacement[0] + place * displacement[-1]
    result: Floats = still[:, None, None] * ramp
    kept = moving.shape[1]
    if kept:
        modes = fft.dst((displacement - ramp)[1:-1], type=1, axis=0, norm="ortho")
        spectrum = np.zeros((len(still), *modes.shape))
        spectrum[:, :kept] = moving[:, :, None] * modes[:kept]
        result[:, 1:-1] += fft.idst(spectrum, type=1, axis=1, norm="ortho")
    return result


def describe_warps(title: str, still: Floats, moving: Floats) -> list[str]:
    """Sentences on warps sampled at `SAMPLES` that run backwards or past the end, or drag resting points along.

    Parameters
    ----------
    title : str
        Of the method.
    still : (T,)
        Warp of the mode without bending.
    moving : (T, N)
        Warps of the harmonics.
    """
    found = []
    for number, warp in enumerate([still, *moving.T]):
        mode = f"harmonic {number}" if number else "the mode without bending"
        if warp.min() < -_NOTICEABLE:
            found.append(f"{title}: {mode} first runs backwards, to {warp.min():.3g} of its displacement")
        elif warp.max() > 1 + _NOTICEABLE:
            found.append(f"{title}: {mode} overshoots to {warp.max():.3g} of its displacement")
        elif np.diff(warp).min() < -_NOTICEABLE:
            found.append(f"{title}: {mode} runs backwards on its way")
    leak = float(np.abs(still - moving[:, -1]).max()) if moving.shape[1] else 0.0
    if leak > _NOTICEABLE:
        found.append(
            f"{title}: points that do not move are displaced by up to {leak:.2f} of their curve's mean displacement, "
            "because the mode without bending is timed differently from the stiff ones"
        )
    return found
