"""Do the saved error bars hold what they promise? Collects true errors pose by pose and counts those inside."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture_eval.evaluation.bar_calibration import bar_coverage
from capture_eval.evaluation.tracking_error import TrackingError

Floats = NDArray[np.float64]
Booleans = NDArray[np.bool_]

_BARS = {"position": "error_bar", "motion": "motion_bar"}


class BarInside:
    """Shares of true errors inside the 95 % bars, per pose and over all in-between and last poses.

    Parameters
    ----------
    saved : mapping of str to array
        ``registered.npz``; without bars everything reported is None.
    scale : float
        Truth units per head unit.
    size : float
        D of the truth; what is reported is a fraction of it.
    masks : mapping of name to (V,) bool
        Groups of vertices; ``rest`` is added: seen, and not confident.

    Attributes
    ----------
    errors : dict of (P, V) float64
        True errors as fractions of D: ``position``, and ``motion`` from the neutral.
    """

    def __init__(
        self, saved: Mapping[str, NDArray[Any]], scale: float, size: float, masks: Mapping[str, Booleans]
    ) -> None:
        self._bars = {kind: scale / size * np.asarray(saved[name]) for kind, name in _BARS.items() if name in saved}
        self._size = size
        self._masks = {**masks, "rest": masks["seen"] & ~masks["confident"]}
        self.errors: dict[str, Floats] = {kind: np.full(saved["confidence"].shape, np.nan) for kind in _BARS}

    def add(self, pose: int, error: TrackingError, row: dict[str, Any]) -> None:
        """Take the errors of one pose and put its shares into ``row`` (changed in place)."""
        for kind, values in (("position", error.total), ("motion", error.relative)):
            self.errors[kind][pose] = values / self._size
        if not self._bars:
            return
        row["error_bars"] = {
            kind: bar_coverage(self.errors[kind][pose], self._bars[kind][pose], self._masks)
            for kind in self._bars
            if kind == "position" or pose > 0
        }

    def overall(self) -> dict[str, Any] | None:
        """Shares over all poses but the neutral, whose points sit on the truth by definition; None without bars."""
        if not self._bars:
            return None
        return {kind: bar_coverage(self.errors[kind][1:], self._bars[kind][1:], self._masks) for kind in self._bars}
