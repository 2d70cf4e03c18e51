"""Values known on some vertices of a mesh, carried smoothly to all others.

``harmonic`` solves ``L x = 0`` at the free vertices, with L the cotangent Laplacian: what it gives never exceeds the
given values, and it has creases where they are given. ``biharmonic`` solves ``L M⁻¹ L x = 0`` (M the vertex weights),
which is smooth there and may exceed them. Rims are free (natural boundary conditions). Parts of the mesh without any
given vertex get 0.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from capture_eval.errors import InputError
from capture_eval.registration.mesh_operators import build_mesh_operators

if TYPE_CHECKING:
    from scipy.sparse.linalg import SuperLU

Floats = NDArray[np.float64]
Booleans = NDArray[np.bool_]
Extension = Literal["harmonic", "biharmonic"]


class MeshExtension:
    """The factorised system for one mesh and one set of given vertices.

    Parameters
    ----------
    vertices : (V, 3)
        Rest shape.
    triangles : (K, 3) int64
        Its triangles.
    given : (V,) bool
        Vertices whose values will be given, at least one.
    kind : {"harmonic", "biharmonic"}
        See the module.

    Raises
    ------
    InputError
        An unknown kind, a mask of another length or without a vertex, or a mesh without triangles.
    """

    def __init__(self, vertices: Floats, triangles: NDArray[np.int64], given: Booleans, kind: Extension) -> None:
        if kind not in ("harmonic", "biharmonic"):
            raise InputError(f"unknown extension '{kind}'; known are harmonic, biharmonic")
        if given.shape != (len(vertices),) or not given.any():
            raise InputError(f"extension: mask {given.shape} with {int(given.sum())} given of {len(vertices)} vertices")
        self.given = given
        adjacency = build_mesh_operators(vertices, triangles).adjacency
        joined = sparse.csgraph.connected_components(adjacency, directed=False)[1]
        reached = np.isin(joined, joined[given])
        self._free = np.flatnonzero(~given & reached)
        self._coupling, self._solver = self._factorise(adjacency, kind)

    def _factorise(self, adjacency: sparse.csr_matrix, kind: Extension) -> tuple[sparse.csr_matrix, SuperLU | None]:
        degree = np.asarray(adjacency.sum(axis=1)).ravel()
        system = sparse.csr_matrix(sparse.diags(degree) - adjacency)
        if kind == "biharmonic":
            weight = np.divide(1.0, degree, out=np.zeros_like(degree), where=degree > 0)
            system = sparse.csr_matrix(system @ sparse.diags(weight) @ system)
        rows = system[self._free]
        if not len(self._free):
            return sparse.csr_matrix(rows[:, self.given]), None
        from scipy.sparse.linalg import splu

        return sparse.csr_matrix(rows[:, self.given]), splu(sparse.csc_matrix(rows[:, self._free]))

    def extend(self, values: Floats) -> Floats:
        """Values of all vertices.

        Parameters
        ----------
        values : (G, C)
            At the given vertices, in the order of the mesh.

        Returns
        -------
        (V, C) float64

        Raises
        ------
        InputError
            Another number of values than given vertices.
        """
        if values.ndim != 2 or len(values) != int(self.given.sum()):
            raise InputError(f"extension: values {values.shape} for {int(self.given.sum())} given vertices")
        result = np.zeros((len(self.given), values.shape[1]))
        result[self.given] = values
        if self._solver is not None:
            result[self._free] = self._solver.solve(-np.asarray(self._coupling @ values))
        return result
