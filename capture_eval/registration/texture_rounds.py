"""Rounds of texture-space flow and stereo that end the drift of a registered mesh and sharpen its surface.

Lengths are in the frame in which the template is 300 units large.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from capture_eval.cameras import View
from capture_eval.registration.deformation_solver import DeformationSolver, SurfaceConstraints, cauchy_weights
from capture_eval.registration.lifted_matches import MaterialMatches
from capture_eval.registration.nonrigid_icp import closest_point_constraints
from capture_eval.registration.pose_tracking import (
    anchor_constraints,
    match_constraints,
    measured_vertices,
)
from capture_eval.registration.surface_correspondence import Surface
from capture_eval.registration.texture_atlas import TextureAtlas
from capture_eval.registration.texture_baking import BakedTexture, bake_texture, resized_texture
from capture_eval.registration.texture_flow import FlowConstraints, FlowOptions, texture_flow
from capture_eval.registration.texture_stereo import OffsetConstraints, StereoOptions, texture_stereo
from capture_eval.triangle_geometry import vertex_normals

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

SEARCH_FLOW = FlowOptions(consistency=2.0, minimum_correlation=0.5, refinement_sigma=4.0, border_margin=3.0, step=2)


@dataclass(frozen=True)
class RoundOptions:
    """Weights of the rounds.

    Parameters
    ----------
    search_rounds : int
        Rounds of flow alone, in the coarse atlas, that come first: where lifted matches are thin (under the chin)
        the start is several texels off, more than the fine flow finds.
    search : FlowOptions
        Their flow, in texels of the coarse atlas.
    search_flow_scale, search_scan_weight : float
        What `flow_scale` and `scan_weight` are in those rounds.
    half_ranges : tuple of float
        Range of the stereo's offsets, one round each.
    stiffness, edge_stiffness : float
    solves : int
        Steps of the deformation per round.
    flow_weight, flow_scale, stereo_weight, stereo_scale : float
        Weight of a constraint and the residual at which it counts half (Cauchy).
    scan_weight_measured, scan_weight : float
        Weight of the scan's planes where stereo measured, and elsewhere.
    match_weight, match_scale : float
        The same for the lifted matches.
    flow_consistency : (first round, later rounds)
        Texels.
    """

    search_rounds: int = 2
    search: FlowOptions = field(default_factory=lambda: SEARCH_FLOW)
    search_flow_scale: float = 2.0
    search_scan_weight: float = 0.3
    half_ranges: tuple[float, ...] = (1.5, 0.8)
    stiffness: float = 3.0
    edge_stiffness: float = 0.05
    solves: int = 3
    flow_weight: float = 0.4
    flow_scale: float = 0.5
    stereo_weight: float = 0.4
    stereo_scale: float = 0.4
    scan_weight_measured: float = 0.03
    scan_weight: float = 0.08
    scan_limit: float = 2.5
    scan_cosine: float = 0.7
    match_weight: float = 0.1
    match_scale: float = 0.7
    anchor_weight: float = 0.02
    flow_consistency: tuple[float, float] = (1.2, 0.6)
    use_flow: bool = True
    use_stereo: bool = True
    stereo: StereoOptions = field(default_factory=StereoOptions)


@dataclass(frozen=True)
class TextureAtlases:
    """Texels of the template's layout: finer for the flow, as coarse as the photos for the stereo."""

    flow: TextureAtlas
    stereo: TextureAtlas


@dataclass(frozen=True)
class PhotoSet:
    """Cameras of one pose in the working frame and their photos (H, W, 3) uint8."""

    views: tuple[View, ...]
    images: tuple[NDArray[np.uint8], ...]


@dataclass(frozen=True)
class RefinedPose:
    """Mesh after the rounds, with the measurements of the last round.

    Parameters
    ----------
    vertices : (V, 3) float64
    flow : SurfaceConstraints or None
        Tangential constraints.
    stereo : SurfaceConstraints or None
        Plane constraints.
    """

    vertices: Floats
    flow: SurfaceConstraints | None
    stereo: SurfaceConstraints | None


def refine_by_texture(
    solver: DeformationSolver,
    start: Floats,
    skin: NDArray[np.bool_],
    photos: PhotoSet,
    atlases: TextureAtlases,
    neutral_texture: BakedTexture | None,
    scan: Surface | None,
    matches: MaterialMatches | None,
    options: RoundOptions,
) -> RefinedPose:
    """Deform a registered mesh until its texture equals the neutral's and its photos agree.

    Parameters
    ----------
    solver : DeformationSolver
        Its rest shape is the neutral (for the neutral itself: the mesh that starts).
    neutral_texture : BakedTexture or None
        In `atlases.flow`; None for the neutral itself, which has nothing to flow to.
    """
    triangles = solver.operators.triangles
    positions = start
    flow_rows: SurfaceConstraints | None = None
    stereo_rows: SurfaceConstraints | None = None
    if options.use_flow and neutral_texture is not None:
        positions = _search(solver, positions, skin, photos, atlases.stereo, neutral_texture, scan, matches, options)
    for number, half_range in enumerate(options.half_ranges):
        if options.use_flow and neutral_texture is not None:
            texture = bake_texture(positions, triangles, atlases.flow, photos.views, photos.images)
            consistency = options.flow_consistency[min(number, 1)]
            flow = texture_flow(
                neutral_texture, texture, atlases.flow, positions, triangles, FlowOptions(consistency=consistency)
            )
            flow_rows = flow_constraints(flow, positions, triangles, skin)
        if options.use_stereo:
            offsets = texture_stereo(
                positions,
                triangles,
                atlases.stereo,
                photos.views,
                photos.images,
                half_range,
                options=options.stereo,
            )
            stereo_rows = offset_constraints(offsets, positions, triangles, skin)
        positions = _solve_round(solver, positions, skin, flow_rows, stereo_rows, scan, matches, options)
    return RefinedPose(positions, flow_rows, stereo_rows)


def _search(
    solver: DeformationSolver,
    positions: Floats,
    skin: NDArray[np.bool_],
    photos: PhotoSet,
    atlas: TextureAtlas,
    neutral_texture: BakedTexture,
    scan: Surface | None,
    matches: MaterialMatches | None,
    options: RoundOptions,
) -> Floats:
    """Rounds of coarse flow that bring the mesh near enough for the fine flow."""
    triangles = solver.operators.triangles
    coarse = resized_texture(neutral_texture, atlas.size)
    wide = replace(options, flow_scale=options.search_flow_scale, scan_weight=options.search_scan_weight, solves=2)
    for _ in range(options.search_rounds):
        texture = bake_texture(positions, triangles, atlas, photos.views, photos.images)
        flow = texture_flow(coarse, texture, atlas, positions, triangles, options.search)
        rows = flow_constraints(flow, positions, triangles, skin)
        positions = _solve_round(solver, positions, skin, rows, None, scan, matches, wide)
    return positions


def flow_constraints(
    flow: FlowConstraints, positions: Floats, triangles: Integers, skin: NDArray[np.bool_]
) -> SurfaceConstraints:
    """Flow as tangential constraints of the deformation; only material points on skin."""
    keep = skin[triangles[flow.triangle]].all(axis=1)
    corners = triangles[flow.triangle[keep]]
    barycentric = flow.barycentric[keep]
    normals = np.einsum("mk,mki->mi", barycentric, vertex_normals(positions, triangles)[corners])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    return SurfaceConstraints(corners, barycentric, flow.target[keep], normals, flow.weight[keep], tangential=True)


def offset_constraints(
    offsets: OffsetConstraints, positions: Floats, triangles: Integers, skin: NDArray[np.bool_]
) -> SurfaceConstraints:
    """Stereo offsets as planes; only material points on skin."""
    keep = skin[triangles[offsets.triangle]].all(axis=1)
    corners = triangles[offsets.triangle[keep]]
    barycentric = offsets.barycentric[keep]
    places = np.einsum("mk,mki->mi", barycentric, positions[corners])
    target = places + offsets.offset[keep, None] * offsets.normal[keep]
    return SurfaceConstraints(corners, barycentric, target, offsets.normal[keep], offsets.weight[keep])


def _solve_round(
    solver: DeformationSolver,
    positions: Floats,
    skin: NDArray[np.bool_],
    flow: SurfaceConstraints | None,
    stereo: SurfaceConstraints | None,
    scan: Surface | None,
    matches: MaterialMatches | None,
    options: RoundOptions,
) -> Floats:
    triangles, rest = solver.operators.triangles, solver.operators.vertices
    measured = np.zeros(len(rest), dtype=np.bool_)
    if stereo is not None:
        measured = vertex_sums(stereo, len(rest)) > 1.0
    scan_weight = solver.scan_trust * np.where(measured, options.scan_weight_measured, options.scan_weight)
    for _ in range(options.solves):
        constraints: list[SurfaceConstraints] = []
        if flow is not None:
            robust = cauchy_weights(flow.residuals(positions), options.flow_scale)
            constraints.append(flow.with_weight(options.flow_weight * flow.weight * robust))
        if stereo is not None:
            robust = cauchy_weights(stereo.residuals(positions), options.stereo_scale)
            constraints.append(stereo.with_weight(options.stereo_weight * stereo.weight * robust))
        if scan is not None:
            planes, _ = closest_point_constraints(
                positions, triangles, skin, scan, options.scan_limit, options.scan_cosine, weight=scan_weight
            )
            constraints.append(planes)
        if matches is not None:
            constraints.append(
                match_constraints(matches, positions, triangles, options.match_weight, options.match_scale)
            )
        touched = measured_vertices(constraints, len(rest))
        constraints.append(anchor_constraints(solver.operators, positions, skin, touched, options.anchor_weight))
        positions = solver.solve(positions, options.stiffness, options.edge_stiffness, constraints)
    return positions


def vertex_sums(constraints: SurfaceConstraints, count: int, values: Floats | None = None) -> Floats:
    """Sum over the constraints around each vertex of barycentric times weight (times a value), (V,)."""
    factor = constraints.weight if values is None else constraints.weight * values
    total = np.zeros(count)
    for corner in range(3):
        total += np.bincount(
            constraints.corners[:, corner], constraints.barycentric[:, corner] * factor, minlength=count
        )
    return total
