"""Deformation transfer between meshes of one topology (Sumner and Popović 2004), generic for a rig without photos.

Sumner and Popović give every triangle a fourth vertex along its normal and fit affine maps in the least-squares sense.
Each fourth vertex belongs to one triangle only, so it can always fit its part exactly and falls out of the problem.
What remains is linear in the vertices: the edges of every triangle in an orthonormal basis of its neutral,
two rows a triangle (`FaceGradients`), and one factorisation serves all shapes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture_eval.errors import InputError
from capture_eval.planning.blendshape_rig import BlendshapeRig, check_target

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

# Pull of every vertex towards its copied displacement: too weak to bend a triangle, enough to place loose parts.
_WEAK_PULL = 1e-6
_FIXED_PULL = 1e4
_STILL = 1e-6


@dataclass(frozen=True)
class FaceGradients:
    """In-plane gradients of functions on a neutral mesh.

    Attributes
    ----------
    matrix : sparse (2 T, N)
        Rows 2 t and 2 t + 1: derivatives along the two axes of triangle t. Triangles without area are left out.
    axes : (T, 3, 2) float64
        Orthonormal axes of every triangle.
    normals : (T, 3) float64
    kept : (T,) int64
        Numbers of the triangles in the mesh.
    """

    matrix: Any
    axes: Floats
    normals: Floats
    kept: Integers

    def of(self, positions: Floats) -> Floats:
        """Gradients of positions (N, 3): (T, 3, 2)."""
        rows = self.matrix @ positions
        return np.ascontiguousarray(rows.reshape(-1, 2, 3).transpose(0, 2, 1))


def face_gradients(neutral: Floats, triangles: Integers, usable: NDArray[np.bool_] | None = None) -> FaceGradients:
    """Gradient operator of a neutral mesh.

    Parameters
    ----------
    neutral : (N, 3) float64
    triangles : (T, 3) int64
    usable : (T,) bool, optional
        Triangles to keep, besides being without area themselves.

    Raises
    ------
    InputError
        No triangle has an area.
    """
    from scipy.sparse import csr_array

    edges = np.stack(
        [neutral[triangles[:, 1]] - neutral[triangles[:, 0]], neutral[triangles[:, 2]] - neutral[triangles[:, 0]]], -1
    )
    keep = triangles_with_area(neutral, triangles)
    if usable is not None:
        keep &= usable
    kept = np.flatnonzero(keep)
    if not len(kept):
        raise InputError("deformation transfer: no triangle has an area")
    axes, lengths = np.linalg.qr(edges[kept])
    inverse = np.linalg.inv(lengths)  # derivative along axis b of a function f: sum_a (f_a - f_0) inverse[a, b]
    values = np.concatenate([-inverse.sum(axis=1, keepdims=True), inverse], axis=1)  # (T, corner, axis)
    count = len(kept)
    rows = np.repeat(2 * np.arange(count)[:, None] + np.arange(2), 3, axis=1).ravel()
    columns = np.repeat(triangles[kept][:, None, :], 2, axis=1).ravel()
    matrix = csr_array((values.transpose(0, 2, 1).ravel(), (rows, columns)), shape=(2 * count, len(neutral)))
    return FaceGradients(matrix, axes, np.cross(axes[:, :, 0], axes[:, :, 1]), kept)


def triangles_with_area(vertices: Floats, triangles: Integers) -> NDArray[np.bool_]:
    """Triangles whose area is not vanishing against their edges, (T,)."""
    first = vertices[triangles[:, 1]] - vertices[triangles[:, 0]]
    second = vertices[triangles[:, 2]] - vertices[triangles[:, 0]]
    area = np.linalg.norm(np.cross(first, second), axis=1)
    longest = np.maximum((first**2).sum(axis=1), (second**2).sum(axis=1))
    return np.asarray(area > 1e-9 * np.maximum(longest, 1e-300), dtype=np.bool_)


def deformation_gradients(source: FaceGradients, deformed: Floats) -> Floats:
    """Affine part S of every triangle's map from the source neutral to a deformed source, (T, 3, 3).

    Along the normal it follows the fourth vertex of Sumner and Popović: normal to normal, as long as the square root
    of the area's growth.
    """
    along = source.of(deformed)
    normal = np.cross(along[:, :, 0], along[:, :, 1])
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    normal /= np.sqrt(np.maximum(length, 1e-300))
    basis = np.concatenate([source.axes, source.normals[:, :, None]], axis=2)
    return np.asarray(np.concatenate([along, normal[:, :, None]], axis=2) @ basis.transpose(0, 2, 1), dtype=np.float64)


class TransferSolver:
    """Vertices of a target mesh from wanted gradients of its triangles; one factorisation for all shapes.

    Parameters
    ----------
    rig : BlendshapeRig
        The template.
    target : (N, 3) float64
        Neutral of the target.

    Raises
    ------
    InputError
        The target does not fit the rig.
    """

    def __init__(self, rig: BlendshapeRig, target: Floats) -> None:
        from scipy.sparse import diags_array
        from scipy.sparse.linalg import splu

        self.rig, self.target = rig, check_target(rig, target)
        usable = triangles_with_area(rig.neutral, rig.triangles) & triangles_with_area(self.target, rig.triangles)
        self.source_gradients = face_gradients(rig.neutral, rig.triangles, usable)
        self.gradients = face_gradients(self.target, rig.triangles, usable)
        matrix = self.gradients.matrix
        normal = matrix.T @ matrix
        largest = rig.lengths.max(initial=0.0)
        still = np.all(rig.lengths <= _STILL * largest, axis=0)
        typical = float(normal.diagonal().mean())
        self._pull = typical * np.where(still, _FIXED_PULL, _WEAK_PULL)
        self._size = _extent(self.target) / _extent(rig.neutral)
        self._factors = splu((normal + diags_array(self._pull)).tocsc())

    def generic_gradients(self, shape: int) -> Floats:
        """Wanted gradients (T, 3, 2) of the target for one shape of the rig: its deformation on the target's axes."""
        maps = deformation_gradients(self.source_gradients, self.rig.shapes[shape])
        return np.asarray(maps @ self.gradients.axes, dtype=np.float64)

    def positions(self, wanted: Floats, hint: Floats) -> Floats:
        """Vertices (N, 3) whose gradients fit the wanted ones (T, 3, 2) best; ``hint`` places what is loose."""
        rows = np.ascontiguousarray(wanted.transpose(0, 2, 1)).reshape(-1, 3)
        right = self.gradients.matrix.T @ rows + self._pull[:, None] * hint
        return np.asarray(self._factors.solve(right), dtype=np.float64)

    def hint(self, shape: int) -> Floats:
        """The target with the shape's displacements copied at the target's size, (N, 3)."""
        return np.asarray(self.target + self._size * self.rig.displacements[shape], dtype=np.float64)

    def transfer(self, shape: int) -> Floats:
        """The target's version (N, 3) of one shape of the rig."""
        return self.positions(self.generic_gradients(shape), self.hint(shape))


def transfer_deformation(rig: BlendshapeRig, target: Floats) -> Floats:
    """All shapes of a rig on another neutral, (K, N, 3), without any photo of the target's expressions.

    Raises
    ------
    InputError
        The target does not fit the rig.
    """
    solver = TransferSolver(rig, target)
    return np.array([solver.transfer(shape) for shape in range(rig.shape_count)]).reshape(rig.shapes.shape)


def _extent(points: Floats) -> float:
    return float(np.sqrt(((points - points.mean(axis=0)) ** 2).sum(axis=1).mean()))
