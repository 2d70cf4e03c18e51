"""The movements on which the claims of the papers are tried (`reproduction.py`)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from capture_eval.curves.edge_loops import edge_topology
from capture_eval.curves.extract import CurveSet, extract_curves, resolve_curves
from capture_eval.evaluation.hinged_jaw import hinged_jaw
from capture_eval.files.atomic import read_npz
from capture_eval.files.curve_files import read_curves
from capture_eval.files.mesh_files import read_mesh
from capture_eval.interpolation.method import InterpolationMethod
from capture_eval.triangle_geometry import diameter

T = np.linspace(0.0, 1.0, 11)


@dataclass
class Subject:
    """A movement that can be walked with any timing."""

    name: str
    size: float
    shares: np.ndarray
    walked_evenly: CurveSet

    def errors(self, predictions: list[np.ndarray]) -> tuple[float, float, np.ndarray, np.ndarray]:
        """LME, LAE and E_M, E_A per curve and pose of predictions at the poses."""
        largest, average = [], []
        for predicted, truth in zip(predictions, self.walked_evenly.positions, strict=True):
            distance = np.linalg.norm(predicted - truth[1:-1], axis=-1) / self.size
            largest.append(distance.max(axis=1))
            average.append(distance.mean(axis=1))
        return float(np.max(largest)), float(np.max(average)), np.array(largest), np.array(average)

    def predict(self, method: InterpolationMethod, times: np.ndarray) -> list[np.ndarray]:
        """Predictions of all curves."""
        pairs = zip(self.walked_evenly.curves, self.walked_evenly.positions, strict=True)
        return [method.predict(truth[0], truth[-1], curve.closed, times) for curve, truth in pairs]


def subjects(head: Path | None) -> list[Subject]:
    """The jaw, and the movements of the head when it is there."""
    found = [Subject("jaw on a hinge", 1.0, T, hinged_jaw(T))]
    if head is not None:
        mesh = read_mesh(head / "neutral.obj")
        curves = resolve_curves(read_curves(head / "curves.json"), edge_topology(mesh))
        poses = read_npz(head / "sequences.npz")
        for name in ("jaw_open", "grin", "blink_frown"):
            vertices = poses[f"{name}_linear"].astype(np.float64)
            found.append(Subject(f"MakeHuman {name}", diameter(vertices[0]), T, extract_curves(curves, vertices)))
    return found


def timed(subject: Subject, power: float) -> np.ndarray:
    """Times of the poses when the share t^power of the angle is reached at t: the poses of an even walk, relabelled."""
    return subject.shares[1:-1] ** (1.0 / power)
