"""Editing a face that has no examples, through a template that has (section 4 of paper 001).

The user's constraint is seen through the map that carries the template's motion to the face; the template is edited;
its motion is carried over (expression cloning, Noh and Neumann 2001): turned with the local surface and scaled with
its local size. In the paper's equation S is the rotation and R the scale; here they are called what they are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capture_eval.editing.control_targets import ControlPoint
from capture_eval.editing.dense_correspondence import SurfaceMap
from capture_eval.editing.expression_editor import Edit, ExpressionEditor, MotionCarrier, check_controls
from capture_eval.editing.projection import Projection
from capture_eval.errors import InputError
from capture_eval.polygon_mesh import PolygonMesh
from capture_eval.triangle_geometry import unique_edges, vertex_normals

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

ROUNDS = 8  # edges away that count as local: one ring is as noisy as the correspondence


@dataclass(frozen=True)
class MotionTransfer:
    """How motion at a template point becomes motion of a target vertex.

    Attributes
    ----------
    correspondence : SurfaceMap
    rest : (N, 3) float64
        Vertices of the target.
    rotation : (N, 3, 3) float64
        Target direction from template direction.
    scale : (N,) float64
        Local size of the target over that of the template.
    """

    correspondence: SurfaceMap
    rest: Floats
    rotation: Floats
    scale: Floats

    @property
    def linear(self) -> Floats:
        """Rotation times scale, (N, 3, 3)."""
        return np.asarray(self.scale[:, None, None] * self.rotation, dtype=np.float64)

    def clone(self, motion: Floats) -> Floats:
        """Target vertices (N, 3) for motion vectors of the template's vertices (V, 3)."""
        carried = self.correspondence.carry(motion)[..., None]
        return np.asarray(self.rest + (self.linear @ carried)[..., 0], dtype=np.float64)


def motion_transfer(
    template: PolygonMesh, target: PolygonMesh, correspondence: SurfaceMap, rounds: int = ROUNDS
) -> MotionTransfer:
    """Rotation and scale of every target vertex.

    Parameters
    ----------
    template, target : PolygonMesh
        Neutral faces.
    correspondence : SurfaceMap
        Of the target's vertices.
    rounds : int
        Size of the neighbourhood, in edges.

    Notes
    -----
    Noh and Neumann build the local frame from the normal and one edge, and take the size from the bounding box of the
    polygons around the vertex. Here the frame is the rotation that fits the edges of the neighbourhood and the normal
    best, and the size is their root mean square length: the same for exact correspondences and less noisy for others.

    Raises
    ------
    InputError
        The correspondence does not fit the target.
    """
    if len(correspondence.corners) != len(target.vertices):
        raise InputError(
            f"cloning: correspondence of {len(correspondence.corners)} points for {len(target.vertices)} vertices"
        )
    edges = unique_edges(target.triangles()[0])
    there, here = correspondence.carry(template.vertices), target.vertices
    there_normals = correspondence.carry(vertex_normals(template.vertices, template.triangles()[0]))
    here_normals = vertex_normals(target.vertices, target.triangles()[0])
    from_edges, to_edges = there[edges[:, 1]] - there[edges[:, 0]], here[edges[:, 1]] - here[edges[:, 0]]
    covariance = _gather(np.einsum("ei,ej->eij", to_edges, from_edges), edges, len(here), rounds)
    sizes_here = _gather(np.einsum("ei,ei->e", to_edges, to_edges), edges, len(here), rounds)
    sizes_there = _gather(np.einsum("ei,ei->e", from_edges, from_edges), edges, len(here), rounds)
    weight = np.sqrt(sizes_here * sizes_there)[:, None, None]
    covariance = covariance + weight * np.einsum("ni,nj->nij", here_normals, there_normals)
    left, _, right = np.linalg.svd(covariance)
    left[:, :, 2] *= np.sign(np.linalg.det(left @ right))[:, None]
    usable = sizes_there > 0
    scale = np.sqrt(np.where(usable, sizes_here / np.where(usable, sizes_there, 1.0), 1.0))
    return MotionTransfer(correspondence, here, left @ right, scale)


def _gather(values: Floats, edges: Integers, count: int, rounds: int) -> Floats:
    """Sum of edge values (E, ...) around every vertex (count, ...), spread over some rounds of neighbours."""
    from scipy.sparse import coo_matrix, identity

    flat = values.reshape(len(edges), -1)
    ones = np.ones(len(edges))
    links = coo_matrix((ones, (edges[:, 0], edges[:, 1])), shape=(count, count)).tocsr()
    around = links + links.T + identity(count, format="csr")
    incidence = coo_matrix(
        (np.ones(2 * len(edges)), (edges.T.ravel(), np.tile(np.arange(len(edges)), 2))), shape=(count, len(edges))
    ).tocsr()
    total = incidence @ flat
    for _ in range(rounds - 1):
        total = around @ total
    return np.asarray(total, dtype=np.float64).reshape(count, *values.shape[1:])


def edit_through_template(
    editor: ExpressionEditor,
    transfer: MotionTransfer,
    controls: Sequence[ControlPoint],
    projection: Projection | None = None,
    previous: Edit | None = None,
) -> tuple[Floats, Edit]:
    """Edit a face without examples.

    Parameters
    ----------
    editor : ExpressionEditor
        Of the template.
    transfer : MotionTransfer
        To the face.
    controls : sequence of ControlPoint
        Vertices of the face, targets in its frame or on a screen that shows it.
    projection, previous
        As for the editor.

    Returns
    -------
    vertices : (N, 3) float64
        The face.
    edit : Edit
        Of the template; its control points are the template vertices that correspond.

    Raises
    ------
    InputError
        As for the editor, or two control points that correspond to one template vertex.
    """
    check_controls(controls, len(transfer.rest))
    rows = [control.vertex for control in controls]
    own = transfer.correspondence.nearest[rows]
    if len(set(own.tolist())) < len(own):
        raise InputError(f"cloning: control points {rows} share a template vertex; choose them farther apart")
    mapped = [ControlPoint(int(vertex), control.target) for vertex, control in zip(own, controls, strict=True)]
    carrier = MotionCarrier(transfer.rest[rows], transfer.linear[rows])
    edit = editor.edit(mapped, projection, previous, carrier)
    return transfer.clone(edit.vertices - editor.motion.neutral), edit
