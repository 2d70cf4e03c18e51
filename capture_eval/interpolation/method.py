"""The contract of every interpolation method: two shapes of a curve in, the shapes between them out."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from capture_eval.errors import InputError

Floats = NDArray[np.float64]


@runtime_checkable
class InterpolationMethod(Protocol):
    """What every method provides; implementations are frozen dataclasses whose fields are the options."""

    @property
    def title(self) -> str:
        """Name for figures and tables, a few words."""
        ...

    @property
    def reference(self) -> str:
        """Paper and equations the method comes from."""
        ...

    @property
    def options(self) -> Mapping[str, object]:
        """Parameters that fix the result, as plain values."""
        ...

    def predict(self, start: ArrayLike, end: ArrayLike, closed: bool, times: ArrayLike) -> Floats:
        """Shapes of one curve at the given times.

        Parameters
        ----------
        start, end : (M, 3)
            Positions at t = 0 and t = 1, in any unit; the result has the same.
        closed : bool
            Whether the last point joins the first.
        times : (T,)
            Values in [0, 1].

        Returns
        -------
        (T, M, 3) float64
            A new array; the inputs are not changed.

        Raises
        ------
        InputError
            Shapes that do not fit, numbers that are not finite, too few points, or times outside [0, 1].
        """
        ...

    def warnings(self, point_count: int, closed: bool) -> list[str]:
        """What a reader of results on such a curve must know (time running backwards, …); often empty."""
        ...


@runtime_checkable
class KeyPoseMethod(InterpolationMethod, Protocol):
    """A method that is given further poses between the ends; it is judged on the remaining ones."""

    @property
    def key_times(self) -> tuple[float, ...]:
        """t of the poses it must be given, rising, inside (0, 1)."""
        ...

    def predict_with_keys(
        self, start: ArrayLike, keys: ArrayLike, end: ArrayLike, closed: bool, times: ArrayLike
    ) -> Floats:
        """As ``predict``, with the shapes ``keys`` (Q, M, 3) at the key times."""
        ...


def check_curve_pair(start: ArrayLike, end: ArrayLike, closed: bool, times: ArrayLike) -> tuple[Floats, Floats, Floats]:
    """The arguments of ``predict`` as float64 arrays, checked.

    Raises
    ------
    InputError
        See `InterpolationMethod.predict`.
    """
    first = np.asarray(start, dtype=np.float64)
    last = np.asarray(end, dtype=np.float64)
    moments = np.asarray(times, dtype=np.float64)
    if first.ndim != 2 or first.shape[1] != 3 or first.shape != last.shape:
        raise InputError(f"a curve needs two shapes (points, 3) of equal size, got {first.shape} and {last.shape}")
    least = 3 if closed else 2
    if len(first) < least:
        raise InputError(f"{'a closed' if closed else 'an open'} curve of {len(first)} points; at least {least} needed")
    if not (np.isfinite(first).all() and np.isfinite(last).all()):
        raise InputError("a curve holds positions that are not finite")
    if moments.ndim != 1 or not np.isfinite(moments).all() or np.any((moments < 0) | (moments > 1)):
        raise InputError(f"times must be a list of numbers in [0, 1], got {np.array2string(moments, threshold=6)}")
    return first, last, moments
