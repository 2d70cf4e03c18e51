"""The neutral mesh deformed to another pose by lifted matches and the scan, starting from the previous pose.

Lengths are in the frame in which the template is 300 units large.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray
from scipy.sparse.linalg import splu

from capture_eval.registration.deformation_solver import DeformationSolver, SurfaceConstraints, cauchy_weights
from capture_eval.registration.lifted_matches import (
    MaterialMatches,
    consistent_with_prediction,
    near_present_fit,
)
from capture_eval.registration.mesh_operators import MeshOperators
from capture_eval.registration.nonrigid_icp import closest_point_constraints
from capture_eval.registration.surface_correspondence import Surface

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


@dataclass(frozen=True)
class TrackingOptions:
    """Schedule of a pose's fit.

    Parameters
    ----------
    stiffness : tuple of float
        Laplacian weight of each step.
    edge_stiffness : float
    surface_from : int
        First step with the scan's planes.
    distance_limit : (first, last)
    normal_cosine : float
    match_weight : float
    match_scale : (first, last)
        Residual at which a match counts half (Cauchy). It starts wide: the few matches on an opening lip are far
        from the previous pose, and would count nothing.
    chain_weight : float
        Weight of matches against the previous pose, relative.
    chain_steps : int
        They only help to start, during so many steps.
    selection_limit : (first, last)
        Matches nearer to the present fit than this are in use, and those whose neighbours deviate alike.
    anchor_weight : float
        Weight that lets unmeasured skin follow the measured skin that it is connected to.
    """

    stiffness: tuple[float, ...] = (20, 10, 5, 3, 2, 1, 1, 3, 3)
    edge_stiffness: float = 0.05
    surface_from: int = 2
    distance_limit: tuple[float, float] = (6.0, 2.5)
    normal_cosine: float = 0.7
    match_weight: float = 1.0
    match_scale: tuple[float, float] = (12.0, 0.7)
    chain_weight: float = 0.5
    chain_steps: int = 3
    selection_limit: tuple[float, float] = (4.0, 1.5)
    anchor_weight: float = 0.02


@dataclass(frozen=True)
class TrackedPose:
    """Result of a pose's fit.

    Parameters
    ----------
    vertices : (V, 3) float64
    matches : MaterialMatches
        The matches in use at the end.
    selected_share : float
        Share of all merged matches in use at the end: low where the pose shows something else.
    """

    vertices: Floats
    matches: MaterialMatches
    selected_share: float


def track_pose(
    solver: DeformationSolver,
    skin: NDArray[np.bool_],
    predicted: Floats,
    scan: Surface,
    matches: MaterialMatches,
    chain: MaterialMatches,
    options: TrackingOptions,
) -> TrackedPose:
    """Deform the neutral (rest shape of the solver) to a pose.

    Parameters
    ----------
    predicted : (V, 3)
        The previous pose's mesh.
    matches : MaterialMatches
        Against the neutral, merged by voxel.
    chain : MaterialMatches
        Against the previous pose, merged by voxel; they only help to start.
    """
    triangles = solver.operators.triangles
    rest = solver.operators.vertices
    positions = predicted
    good = consistent_with_prediction(matches, rest, predicted, triangles)
    chain_good = consistent_with_prediction(chain, rest, predicted, triangles)
    limits = np.geomspace(*options.distance_limit, len(options.stiffness))
    scales = np.geomspace(*options.match_scale, len(options.stiffness))
    near = np.geomspace(*options.selection_limit, len(options.stiffness))
    for step, alpha in enumerate(options.stiffness):
        if step > 0:
            good = consistent_with_prediction(matches, rest, positions, triangles)
            good |= near_present_fit(matches, positions, triangles, float(near[step]))
        scale = float(scales[step])
        constraints = [match_constraints(matches.select(good), positions, triangles, options.match_weight, scale)]
        if step < options.chain_steps:
            weight = options.chain_weight * options.match_weight
            constraints.append(match_constraints(chain.select(chain_good), positions, triangles, weight, scale))
        if step >= options.surface_from:
            planes, _ = closest_point_constraints(
                positions,
                triangles,
                skin,
                scan,
                float(limits[step]),
                options.normal_cosine,
                weight=solver.scan_trust,
            )
            constraints.append(planes)
        measured = measured_vertices(constraints, len(rest))
        constraints.append(anchor_constraints(solver.operators, positions, skin, measured, options.anchor_weight))
        positions = solver.solve(positions, alpha, options.edge_stiffness, constraints)
    share = np.count_nonzero(good) / max(len(good), 1)
    return TrackedPose(positions, matches.select(good), float(share))


def match_constraints(
    matches: MaterialMatches, positions: Floats, triangles: Integers, weight: float, scale: float
) -> SurfaceConstraints:
    """Point constraints of matches, those at a residual of `scale` counting half."""
    residual = np.linalg.norm(matches.points(positions, triangles) - matches.target, axis=1)
    weights = weight * matches.weight * cauchy_weights(residual, scale)
    return SurfaceConstraints(triangles[matches.triangle], matches.barycentric, matches.target, None, weights)


def measured_vertices(constraints: list[SurfaceConstraints], count: int) -> NDArray[np.bool_]:
    """Vertices on which some constraint acts, (V,) bool."""
    touched = np.zeros(count, dtype=np.bool_)
    for rows in constraints:
        used = rows.weight > 0
        touched[rows.corners[used][rows.barycentric[used] > 0]] = True
    return touched


def anchor_constraints(
    operators: MeshOperators,
    positions: Floats,
    skin: NDArray[np.bool_],
    measured: NDArray[np.bool_],
    weight: float,
) -> SurfaceConstraints:
    """Weak pulls that let unmeasured skin follow the measured skin that it is connected to.

    The displacement from the rest shape is continued harmonically along the skin. Nearness in space would not do:
    of a shut mouth the hidden rows of the upper lip lie nearest to the lower one, and would go down with the jaw.

    Parameters
    ----------
    operators : MeshOperators
        Of the rest shape.
    positions : (V, 3) float64
    skin, measured : (V,) bool
    """
    free, known = np.flatnonzero(skin & ~measured), np.flatnonzero(skin & measured)
    if len(free) == 0 or len(known) == 0 or weight <= 0:
        return SurfaceConstraints.at_vertices(free[:0], np.zeros((0, 3)), np.zeros(0))
    rows = operators.adjacency[free]
    inner, outer = rows[:, free], rows[:, known]
    pieces, piece = sparse.csgraph.connected_components(inner, directed=False)
    touches = np.bincount(piece, np.asarray(outer.sum(axis=1)).ravel(), minlength=pieces) > 0
    led = touches[piece]
    free, inner, outer = free[led], inner[led][:, led], outer[led]
    if len(free) == 0:
        return SurfaceConstraints.at_vertices(free, np.zeros((0, 3)), np.zeros(0))
    total = np.asarray(inner.sum(axis=1)).ravel() + np.asarray(outer.sum(axis=1)).ravel()
    laplacian = sparse.csc_matrix(sparse.diags(total) - inner)
    moved = splu(laplacian).solve(outer @ (positions - operators.vertices)[known])
    return SurfaceConstraints.at_vertices(free, operators.vertices[free] + moved, np.full(len(free), weight))
