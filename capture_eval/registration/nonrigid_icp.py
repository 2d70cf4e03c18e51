"""Non-rigid ICP of a template to a scan (Amberg, Romdhani and Vetter 2007: optimal step, stiff to soft).

All lengths are in a frame in which the template is 300 units large.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capture_eval.errors import InputError, RegistrationError
from capture_eval.registration.deformation_solver import (
    DeformationSolver,
    SurfaceConstraints,
    cauchy_weights,
    tukey_weights,
)
from capture_eval.registration.mesh_operators import build_mesh_operators
from capture_eval.registration.surface_correspondence import Surface
from capture_eval.triangle_geometry import vertex_normals

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

WORKING_SIZE = 300.0
HIDDEN_STIFFNESS = 0.05


@dataclass(frozen=True)
class NonrigidIcpOptions:
    """Schedule of the fit.

    Parameters
    ----------
    stiffness : tuple of float
        Laplacian weight of each step.
    edge_stiffness : (first, last)
        Weight of the edge term, falling geometrically.
    distance_limit, normal_cosine, landmark_weight : (first, last)
        Largest distance and least normal agreement of a closest point, and the weight of a landmark.
    landmark_scale : float
        Residual at which a landmark counts half (Cauchy).
    point_weight : float
        Share of the closest points that pulls in all directions, not to the plane only.
    warp_stiffness : float
        Laplacian weight while only landmarks pull.
    minimum_share : float
        Share of skin vertices that must find the scan at the end.
    """

    stiffness: tuple[float, ...] = (100, 60, 40, 25, 15, 10, 6, 4, 2.5, 1.5, 1, 1)
    edge_stiffness: tuple[float, float] = (2.0, 0.02)
    distance_limit: tuple[float, float] = (20.0, 2.5)
    normal_cosine: tuple[float, float] = (0.5, 0.8)
    landmark_weight: tuple[float, float] = (3.0, 0.3)
    landmark_scale: float = 2.0
    point_weight: float = 0.05
    warp_stiffness: float = 100.0
    warp_steps: int = 2
    minimum_share: float = 0.2


@dataclass(frozen=True)
class Landmarks:
    """Places that template vertices must go to: vertices (N,), positions (N, 3), weight (N,) in [0, 1]."""

    vertices: Integers
    positions: Floats
    weight: Floats


@dataclass(frozen=True)
class TemplateFit:
    """Result of the fit: vertices (V, 3), and which of them found the scan at the end, (V,) bool."""

    vertices: Floats
    matched: NDArray[np.bool_]


def hidden_stiffness(skin: NDArray[np.bool_]) -> Floats:
    """Stiffness per vertex: vertices that no camera can see must not tie lips or lids together."""
    return np.where(skin, 1.0, HIDDEN_STIFFNESS)


def fit_template(
    vertices: Floats,
    triangles: Integers,
    skin: NDArray[np.bool_],
    scan: Surface,
    landmarks: Landmarks,
    options: NonrigidIcpOptions,
    scan_trust: Floats | None = None,
) -> TemplateFit:
    """Deform a template until it lies on a scan.

    Parameters
    ----------
    vertices : (V, 3)
        Template after the landmark similarity, 300 units large.
    triangles : (K, 3)
    skin : (V,) bool
        Vertices that may meet the scan at all.
    scan : Surface
        In the same frame.
    scan_trust : (V,), optional
        How far the scan is believed at each vertex.

    Raises
    ------
    InputError
        Shapes that do not fit.
    RegistrationError
        Too few vertices find the scan.
    """
    if skin.shape != (len(vertices),):
        raise InputError(f"non-rigid ICP: skin {skin.shape} for {len(vertices)} vertices")
    solver = DeformationSolver(build_mesh_operators(vertices, triangles), hidden_stiffness(skin), scan_trust)
    positions = _warp_to_landmarks(solver, vertices, landmarks, options)
    steps = len(options.stiffness)
    edge_stiffness = np.geomspace(*options.edge_stiffness, steps)
    limits = np.geomspace(*options.distance_limit, steps)
    cosines = np.linspace(*options.normal_cosine, steps)
    landmark_weights = np.geomspace(*options.landmark_weight, steps)
    matched = np.zeros(len(vertices), dtype=np.bool_)
    for step in range(steps):
        planes, pulls = closest_point_constraints(
            positions,
            triangles,
            skin,
            scan,
            float(limits[step]),
            float(cosines[step]),
            options.point_weight,
            solver.scan_trust,
        )
        matched[:] = False
        matched[planes.corners[:, 0]] = True
        pins = _landmark_constraints(positions, landmarks, float(landmark_weights[step]), options.landmark_scale)
        positions = solver.solve(positions, options.stiffness[step], float(edge_stiffness[step]), [planes, pulls, pins])
    share = int(np.count_nonzero(matched & skin)) / max(int(np.count_nonzero(skin)), 1)
    if share < options.minimum_share:
        raise RegistrationError(
            f"neutral: only {share:.0%} of the template's skin lies on the scan, {options.minimum_share:.0%} "
            "are needed; check the landmarks and the scan"
        )
    return TemplateFit(positions, matched)


def _warp_to_landmarks(
    solver: DeformationSolver, vertices: Floats, landmarks: Landmarks, options: NonrigidIcpOptions
) -> Floats:
    positions = vertices
    for _ in range(options.warp_steps):
        pins = _landmark_constraints(positions, landmarks, options.landmark_weight[0], 4.0 * options.landmark_scale)
        positions = solver.solve(positions, options.warp_stiffness, options.edge_stiffness[0], [pins], anchor=1e-6)
    return positions


def _landmark_constraints(positions: Floats, landmarks: Landmarks, weight: float, scale: float) -> SurfaceConstraints:
    residual = np.linalg.norm(positions[landmarks.vertices] - landmarks.positions, axis=1)
    return SurfaceConstraints.at_vertices(
        landmarks.vertices, landmarks.positions, weight * landmarks.weight * cauchy_weights(residual, scale)
    )


def closest_point_constraints(
    positions: Floats,
    triangles: Integers,
    skin: NDArray[np.bool_],
    scan: Surface,
    limit: float,
    minimum_cosine: float,
    point_weight: float = 0.0,
    weight: Floats | float = 1.0,
) -> tuple[SurfaceConstraints, SurfaceConstraints]:
    """Plane (and weaker point) constraints of skin vertices to their closest points on a scan.

    Points at the scan's border or without support, far ones and ones whose normals disagree are left out.
    """
    closest = scan.closest(positions)
    difference = closest.points - positions
    distance = np.linalg.norm(difference, axis=1)
    agreement = np.sum(closest.normals * vertex_normals(positions, triangles), axis=1)
    strength = closest.support * tukey_weights(distance, limit) * weight
    rows = np.flatnonzero(skin & (agreement > minimum_cosine) & (strength > 0))
    planes = SurfaceConstraints.at_vertices(rows, closest.points[rows], strength[rows], closest.normals[rows])
    pulls = SurfaceConstraints.at_vertices(rows, closest.points[rows], point_weight * strength[rows])
    return planes, pulls
