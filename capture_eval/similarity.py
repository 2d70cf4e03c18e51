"""Similarity transforms between frames, never a reflection."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from capture_eval.cameras import View
from capture_eval.errors import InputError

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Similarity:
    """``a_from_b``: a point x of frame b is ``scale * rotation @ x + translation`` in frame a.

    Raises
    ------
    InputError
        A scale that is not positive, or a matrix that is not a proper rotation (to 1e-6).
    """

    scale: float
    rotation: Floats
    translation: Floats

    def __post_init__(self) -> None:
        rotation = np.ascontiguousarray(self.rotation, dtype=np.float64)
        translation = np.ascontiguousarray(self.translation, dtype=np.float64)
        if rotation.shape != (3, 3) or translation.shape != (3,) or not np.all(np.isfinite(translation)):
            raise InputError(f"similarity: rotation {rotation.shape}, translation {translation.shape}")
        if not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-6) or np.linalg.det(rotation) < 0:
            raise InputError("similarity: the matrix is not a proper rotation")
        if not (np.isfinite(self.scale) and self.scale > 0):
            raise InputError(f"similarity: scale {self.scale}")
        object.__setattr__(self, "scale", float(self.scale))
        object.__setattr__(self, "rotation", rotation)
        object.__setattr__(self, "translation", translation)

    @staticmethod
    def identity() -> "Similarity":
        """The transform that changes nothing."""
        return Similarity(1.0, np.eye(3), np.zeros(3))

    def apply(self, points: ArrayLike) -> Floats:
        """Points (..., 3) of frame b in frame a."""
        moved = self.scale * (np.asarray(points, dtype=np.float64) @ self.rotation.T) + self.translation
        return np.asarray(moved, dtype=np.float64)

    def compose(self, b_from_c: "Similarity") -> "Similarity":
        """``a_from_c`` of ``self = a_from_b`` and ``b_from_c``."""
        return Similarity(
            self.scale * b_from_c.scale,
            self.rotation @ b_from_c.rotation,
            self.apply(b_from_c.translation),
        )

    def inverse(self) -> "Similarity":
        """``b_from_a``."""
        rotation = self.rotation.T
        return Similarity(1.0 / self.scale, rotation, -(rotation @ self.translation) / self.scale)


def estimate_similarity(source: ArrayLike, target: ArrayLike, weights: ArrayLike | None = None) -> Similarity:
    """Weighted least-squares ``target_from_source``, reflections excluded (Umeyama 1991, Eqs 40-43).

    Parameters
    ----------
    source, target : (N, 3)
        Corresponding points, N >= 3 and not on one line.
    weights : (N,), optional
        Not negative.

    Raises
    ------
    InputError
        Shapes that differ, too few points, or points on one line.
    """
    from_points = np.asarray(source, dtype=np.float64)
    to_points = np.asarray(target, dtype=np.float64)
    if from_points.shape != to_points.shape or from_points.ndim != 2 or from_points.shape[1:] != (3,):
        raise InputError(f"similarity: point sets {from_points.shape} and {to_points.shape}")
    weight = np.ones(len(from_points)) if weights is None else np.asarray(weights, dtype=np.float64)
    if weight.shape != (len(from_points),) or np.any(weight < 0) or np.count_nonzero(weight) < 3:
        raise InputError(f"similarity: {np.count_nonzero(weight)} usable point pairs, at least 3 are needed")
    weight = weight / weight.sum()
    from_mean, to_mean = weight @ from_points, weight @ to_points
    from_centered, to_centered = from_points - from_mean, to_points - to_mean
    covariance = (to_centered * weight[:, None]).T @ from_centered
    left, singular, right = np.linalg.svd(covariance)
    if singular[1] <= 1e-12 * max(singular[0], np.finfo(float).tiny):
        raise InputError("similarity: the points lie on one line")
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    rotation = (left * signs) @ right
    scale = float(np.sum(singular * signs) / np.sum(weight @ from_centered**2))
    return Similarity(scale, rotation, to_mean - scale * (rotation @ from_mean))


def transform_view(view: View, new_from_world: Similarity) -> View:
    """The same photo seen in another frame; depths become depths of the new frame.

    A point x of the world and ``new_from_world.apply(x)`` of the new frame fall on the same pixel.
    """
    rotation = view.rotation @ new_from_world.rotation.T
    translation = new_from_world.scale * view.translation - rotation @ new_from_world.translation
    return replace(view, rotation=rotation, translation=translation)
