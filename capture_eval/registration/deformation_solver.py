"""Deformation of a mesh that keeps local shape and obeys planes, tangential and point constraints.

One step minimises, over all vertex positions x at once (3 V coupled unknowns),

    alpha |L x - R L x0|^2 + mu ARAP(x; R) + planes + tangential + points

with L the umbrella Laplacian, x0 the rest shape and R the local rotations of the present shape
(Sorkine et al. 2004; Sorkine and Alexa 2007). Constraints sit on points of triangles (barycentric).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray
from scipy.sparse.linalg import splu

from capture_eval.errors import InputError, SolverError
from capture_eval.registration.mesh_operators import MeshOperators, local_rotations

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


@dataclass(frozen=True)
class SurfaceConstraints:
    """Pulls on material points of the mesh.

    The energy of a row is ``weight * (point - target)^T projector (point - target)``.

    Parameters
    ----------
    corners : (M, 3) int64
        Vertices of the triangle that the point lies in.
    barycentric : (M, 3) float64
    target : (M, 3) float64
    normal : (M, 3) float64 or None
        Unit normals. None: the whole vector counts.
    weight : (M,) float64
    tangential : bool
        With a normal: False pulls to the plane, True pulls within the plane only.
    """

    corners: Integers
    barycentric: Floats
    target: Floats
    normal: Floats | None
    weight: Floats
    tangential: bool = False

    def __post_init__(self) -> None:
        count = len(self.corners)
        shapes = {
            "corners": (self.corners.shape, (count, 3)),
            "barycentric": (self.barycentric.shape, (count, 3)),
            "target": (self.target.shape, (count, 3)),
            "weight": (self.weight.shape, (count,)),
        }
        if self.normal is not None:
            shapes["normal"] = (self.normal.shape, (count, 3))
        for name, (found, expected) in shapes.items():
            if found != expected:
                raise InputError(f"constraints: {name} {found}, expected {expected}")
        for name in ("target", "weight"):
            missing = np.count_nonzero(~np.isfinite(getattr(self, name)))
            if missing:
                raise InputError(f"constraints: {missing} numbers of {name} are not finite")

    @staticmethod
    def at_vertices(
        vertices: Integers, target: Floats, weight: Floats, normal: Floats | None = None, tangential: bool = False
    ) -> SurfaceConstraints:
        """Constraints on vertices instead of points inside of triangles."""
        barycentric = np.zeros((len(vertices), 3))
        barycentric[:, 0] = 1.0
        corners = np.repeat(vertices[:, None], 3, axis=1)
        return SurfaceConstraints(corners, barycentric, target, normal, weight, tangential)

    def points(self, positions: Floats) -> Floats:
        """Where the constrained points are now, (M, 3)."""
        places = np.einsum("mk,mki->mi", self.barycentric, positions[self.corners])
        return np.asarray(places, dtype=np.float64)

    def residuals(self, positions: Floats) -> Floats:
        """Distance that each row still complains about, (M,)."""
        difference = self.points(positions) - self.target
        if self.normal is None:
            return np.asarray(np.linalg.norm(difference, axis=1), dtype=np.float64)
        along = np.sum(difference * self.normal, axis=1)
        if not self.tangential:
            return np.asarray(np.abs(along), dtype=np.float64)
        return np.asarray(np.linalg.norm(difference - along[:, None] * self.normal, axis=1), dtype=np.float64)

    def with_weight(self, weight: Floats) -> SurfaceConstraints:
        """The same rows with other weights."""
        return SurfaceConstraints(self.corners, self.barycentric, self.target, self.normal, weight, self.tangential)

    def projectors(self) -> Floats:
        """Weighted projectors (M, 3, 3)."""
        count = len(self.corners)
        identity = np.broadcast_to(np.eye(3), (count, 3, 3))
        if self.normal is None:
            matrices = identity
        else:
            outer = self.normal[:, :, None] * self.normal[:, None, :]
            matrices = identity - outer if self.tangential else outer
        return np.asarray(self.weight[:, None, None] * matrices, dtype=np.float64)


class DeformationSolver:
    """Solves steps of the deformation of one mesh.

    Parameters
    ----------
    operators : MeshOperators
        Of the rest shape.
    stiffness : (V,) float64, optional
        Factor of both regularisers per vertex; small for hidden vertices, so that they tie nothing together.
    scan_trust : (V,) float64, optional
        How far a scan is believed at each vertex; who makes constraints from a scan weighs them with it.
    """

    def __init__(
        self, operators: MeshOperators, stiffness: Floats | None = None, scan_trust: Floats | None = None
    ) -> None:
        count = len(operators.vertices)
        factor = np.ones(count) if stiffness is None else np.asarray(stiffness, dtype=np.float64)
        if factor.shape != (count,) or np.any(factor <= 0):
            raise InputError(f"solver: stiffness {factor.shape} must be positive, one per vertex ({count})")
        trust = np.ones(count) if scan_trust is None else np.asarray(scan_trust, dtype=np.float64)
        if trust.shape != (count,) or np.any(trust < 0):
            raise InputError(f"solver: scan trust {trust.shape} must not be negative, one per vertex ({count})")
        self.operators = operators
        self.scan_trust = trust
        self._rest_laplacian = operators.laplacian @ operators.vertices
        self._weighted_laplacian = sparse.csr_matrix(operators.laplacian.T @ sparse.diags(factor))
        self._bending = sparse.csr_matrix(self._weighted_laplacian @ operators.laplacian)
        tail, head = operators.edges[:, 0], operators.edges[:, 1]
        self._edge_weights = operators.weights * np.sqrt(factor[tail] * factor[head])
        self._rest_edges = operators.vertices[head] - operators.vertices[tail]
        incidence = sparse.csr_matrix(
            (
                np.concatenate([np.ones(len(head)), -np.ones(len(tail))]),
                (np.tile(np.arange(len(head)), 2), np.concatenate([head, tail])),
            ),
            shape=(len(head), count),
        )
        self._divergence = sparse.csr_matrix(incidence.T @ sparse.diags(self._edge_weights))
        self._stretching = sparse.csr_matrix(self._divergence @ incidence)
        self._order = _elimination_order(self._bending, count)

    def solve(
        self,
        positions: Floats,
        alpha: float,
        mu: float,
        constraints: list[SurfaceConstraints],
        anchor: float = 1e-9,
    ) -> Floats:
        """One step from the present positions.

        Parameters
        ----------
        positions : (V, 3)
            Present shape; gives the local rotations.
        alpha, mu : float
            Weights of the Laplacian and of the edge term.
        constraints : list of SurfaceConstraints
        anchor : float
            Weight that holds every vertex where it is; makes the system definite where nothing else does.

        Returns
        -------
        (V, 3) float64

        Raises
        ------
        SolverError
            The system is singular or its solution not finite.
        """
        count = len(self.operators.vertices)
        rotations = local_rotations(self.operators, positions)
        turned = np.einsum("vij,vj->vi", rotations, self._rest_laplacian)
        right = alpha * (self._weighted_laplacian @ turned)
        tail, head = self.operators.edges[:, 0], self.operators.edges[:, 1]
        mean_rotation = 0.5 * (rotations[tail] + rotations[head])
        turned_edges = np.einsum("eij,ej->ei", mean_rotation, self._rest_edges)
        right = right + mu * (self._divergence @ turned_edges) + anchor * positions
        scalar = alpha * self._bending + mu * self._stretching + anchor * sparse.identity(count)
        matrix = sparse.kron(scalar, np.eye(3), format="csc")
        if constraints:
            data, load = _assemble(constraints, count)
            matrix = sparse.csc_matrix(matrix + data)
            right = right + load
        return _factor_and_solve(matrix, right, self._order)


def _elimination_order(bending: sparse.csr_matrix, count: int) -> Integers:
    """Minimum-degree order of the 3 V unknowns, found once on the V vertices (constraints add no neighbours)."""
    graph = sparse.csc_matrix(bending + sparse.identity(count))
    factors = splu(graph, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    order = np.argsort(factors.perm_c).astype(np.int64)
    return np.asarray((3 * order[:, None] + np.arange(3)).ravel(), dtype=np.int64)


def _factor_and_solve(matrix: sparse.csc_matrix, right: Floats, order: Integers) -> Floats:
    ordered = sparse.csc_matrix(matrix[order][:, order])
    try:
        factors = splu(ordered, permc_spec="NATURAL", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    except RuntimeError as error:
        raise SolverError(f"deformation: the system cannot be factored ({error})") from error
    flat = np.empty(len(order))
    flat[order] = factors.solve(right.ravel()[order])
    solution = flat.reshape(-1, 3)
    if not np.all(np.isfinite(solution)):
        raise SolverError("deformation: the solution is not finite; a constraint or the mesh is degenerate")
    return np.asarray(solution, dtype=np.float64)


def _assemble(constraints: list[SurfaceConstraints], count: int) -> tuple[sparse.csc_matrix, Floats]:
    """Normal matrix (3 V, 3 V) and right-hand side (V, 3) of all constraints."""
    corners = np.concatenate([c.corners for c in constraints])
    barycentric = np.concatenate([c.barycentric for c in constraints])
    projectors = np.concatenate([c.projectors() for c in constraints])
    targets = np.concatenate([c.target for c in constraints])
    # Rows on one triangle share their 9 x 9 block: sum them before they become matrix entries.
    keys = (corners[:, 0] * count + corners[:, 1]) * count + corners[:, 2]
    _, first_row, group = np.unique(keys, return_index=True, return_inverse=True)
    unique = corners[first_row]
    groups = len(unique)
    pulls = np.einsum("mij,mj->mi", projectors, targets)
    load = np.zeros((count, 3))
    rows, columns, values = [], [], []
    for first in range(3):
        for axis in range(3):
            load[:, axis] += np.bincount(corners[:, first], barycentric[:, first] * pulls[:, axis], minlength=count)
        for second in range(3):
            product = barycentric[:, first] * barycentric[:, second]
            if not np.any(product):
                continue
            for i in range(3):
                for j in range(3):
                    rows.append(3 * unique[:, first] + i)
                    columns.append(3 * unique[:, second] + j)
                    values.append(np.bincount(group, product * projectors[:, i, j], minlength=groups))
    if not values:
        raise SolverError("deformation: nothing that was measured holds the mesh")
    matrix = sparse.coo_matrix(
        (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), shape=(3 * count, 3 * count)
    )
    return sparse.csc_matrix(matrix), load


def cauchy_weights(residuals: Floats, scale: float) -> Floats:
    """Weights 1 / (1 + (r / scale)^2) of Cauchy's loss."""
    return np.asarray(1.0 / (1.0 + (residuals / scale) ** 2), dtype=np.float64)


def tukey_weights(residuals: Floats, limit: float) -> Floats:
    """Tukey's biweight: (1 - (r / limit)^2)^2 inside of the limit, 0 outside."""
    inside = np.maximum(1.0 - (residuals / limit) ** 2, 0.0)
    return np.asarray(inside**2, dtype=np.float64)
