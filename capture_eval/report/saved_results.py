"""What the report draws from: the saved results of a run, as arrays with checked shapes.

Errors are fractions of D as they are in the files; only labels and tables turn them into per cent. A pose, curve or
method without a value is NaN here and a marked row in the report, never left out.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..evaluation.error_table import ErrorTable

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Booleans = NDArray[np.bool_]


@dataclass(frozen=True)
class CurvePositions:
    """True and predicted positions of the points of all curves, one curve after the other.

    Attributes
    ----------
    names
        Curve names.
    closed : (C,) bool array
    offsets : (C + 1,) int array
        Curve ``c`` owns the points ``offsets[c]:offsets[c + 1]``.
    vertices : (N,) int array
        Mesh vertex of every point.
    t : (P,) array
        Time of every pose, first and last included.
    truth : (P, N, 3) array
        Registered positions in head units; NaN in failed poses.
    predictions : dict of (P, N, 3) arrays
        By method.
    counted : (N,) bool array
        Points that count in the errors; the others are drawn grey and carry no figure.
    """

    names: tuple[str, ...]
    closed: Booleans
    offsets: Integers
    vertices: Integers
    t: Floats
    truth: Floats
    predictions: Mapping[str, Floats]
    counted: Booleans

    def __post_init__(self) -> None:
        count = len(self.vertices)
        if len(self.counted) != count:
            raise InputError(f"curves: {len(self.counted)} marks of counted points for {count} points")
        if len(self.offsets) != len(self.names) + 1 or int(self.offsets[-1]) != count:
            raise InputError(f"curves: offsets do not span {len(self.names)} curves of {count} points")
        expected = (len(self.t), count, 3)
        for name, values in (("truth", self.truth), *self.predictions.items()):
            if values.shape != expected:
                raise InputError(f"curves: {name} has shape {values.shape}, expected {expected}")

    def slices(self) -> list[slice]:
        """Rows of every curve in ``truth``."""
        return [slice(int(a), int(b)) for a, b in zip(self.offsets[:-1], self.offsets[1:], strict=True)]

    def point_errors(self, method: str, diameter: float) -> Floats:
        """Distance of every predicted point from the true one as a fraction of D, (P, N); NaN if it does not count."""
        distance: Floats = np.linalg.norm(self.predictions[method] - self.truth, axis=2) / diameter
        return np.where(self.counted, distance, np.nan)


@dataclass(frozen=True)
class FaceSequence:
    """The registered mesh of every pose, in head units.

    Attributes
    ----------
    t : (P,) array
    vertices : (P, V, 3) array
        NaN in failed poses.
    triangles : (K, 3) int array
        For drawing only.
    confidence : (P, V) array in [0, 1], or None when poses were given as meshes.
    pose_ok : (P,) bool array
    used : (V,) bool array
        Vertices that count in the errors.
    edges : (E, 2) int array
        Edges of the polygons.
    seen : (P, V) bool array
        Vertices that enough photos of the pose see.
    error_bar : (P, V) array of 95 % bars in head units, NaN where unknown; None without bars.
    """

    t: Floats
    vertices: Floats
    triangles: Integers
    confidence: Floats | None
    pose_ok: Booleans
    used: Booleans
    edges: Integers
    seen: Booleans
    error_bar: Floats | None = None

    def __post_init__(self) -> None:
        if self.vertices.ndim != 3 or self.vertices.shape[2] != 3 or self.vertices.shape[0] != len(self.t):
            raise InputError(f"registered: vertices have shape {self.vertices.shape}, expected ({len(self.t)}, V, 3)")
        if self.confidence is not None and self.confidence.shape != self.vertices.shape[:2]:
            raise InputError(f"registered: confidence has shape {self.confidence.shape}, not one value per vertex")


@dataclass(frozen=True)
class PoseQuality:
    """What every stage said about one pose; figures are by name and absent when a stage did not give them."""

    name: str
    t: float
    ok: bool
    reason: str
    figures: Mapping[str, float]
    stages: Mapping[str, str] = field(default_factory=dict)
    """Status by stage: ok, failed or skipped."""
    doubts: tuple[str, ...] = ()
    """Why a pose that has a result should not be relied on."""

    @property
    def state(self) -> str:
        """For the table of poses: ok, or failed or doubtful with the reason."""
        if not self.ok:
            return f"failed: {self.reason}"
        return f"doubtful: {'; '.join(self.doubts)}" if self.doubts else "ok"


@dataclass(frozen=True)
class TruthComparison:
    """How the results from photos compare with known truth (synthetic captures only).

    Attributes
    ----------
    errors_from_truth : ErrorTable or None
        The same errors computed on the true meshes.
    tracking : dict of (P,) arrays
        Tracking error per pose as fractions of D: ``median``, ``p90``, ``p95``.
    tracking_rows
        Rows of ``truth.json``, one per pose, with parts and regions.
    comparison
        Content of ``truth_comparison.json``.
    places : (P, V, 3) array or None
        Where the skin points of the registered vertices truly are, in head units.
    """

    errors_from_truth: ErrorTable | None
    tracking: Mapping[str, Floats]
    tracking_rows: tuple[Mapping[str, Any], ...] = ()
    comparison: Mapping[str, Any] = field(default_factory=dict)
    places: Floats | None = None


@dataclass(frozen=True)
class SavedResults:
    """Everything the report shows."""

    name: str
    diameter: float
    summary: Mapping[str, Any]
    errors: ErrorTable
    curves: CurvePositions
    faces: FaceSequence | None
    poses: tuple[PoseQuality, ...]
    truth: TruthComparison | None = None
