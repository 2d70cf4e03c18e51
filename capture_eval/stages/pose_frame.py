"""What keeps a pose's frame that of the neutral: cameras straightened by texture, and skin at rest put back."""

from __future__ import annotations

import dataclasses
import logging

import numpy as np
from numpy.typing import NDArray

from capture_eval.errors import InputError
from capture_eval.registration.camera_refinement import refine_cameras
from capture_eval.registration.head_stabilization import stabilise_head
from capture_eval.registration.texture_observations import observe_texture
from capture_eval.registration.texture_rounds import PhotoSet
from capture_eval.stages.register_options import RegisterOptions
from capture_eval.stages.registration_inputs import Template

logger = logging.getLogger("capture_eval.register")

Floats = NDArray[np.float64]

CONFIDENT = 0.5
LEAST_STEADY_VERTICES = 50  # fewer say little about a whole head; the alignment stands then


def straightened(photos: PhotoSet, vertices: Floats, parts: Template, options: RegisterOptions) -> PhotoSet:
    """The photos with cameras adjusted to the texture of the mesh ``vertices`` (V, 3) in the working frame."""
    if not options.straighten_cameras:
        return photos
    atlas = parts.atlases(options.flow_texels, options.stereo_texels).stereo
    observations = observe_texture(vertices, parts.triangles, atlas, photos.views, photos.images)
    try:
        cameras = refine_cameras(photos.views, observations)
    except InputError as error:
        logger.info("register: cameras stay as they are (%s)", error)
        return photos
    logger.info(
        "register: cameras %s, %d observations, residual %.3f to %.3f px, focal length %+.2f %%",
        "straightened" if cameras.accepted else "stay as they are",
        cameras.observations,
        cameras.residual_before,
        cameras.residual_after,
        100 * cameras.focal_change,
    )
    return dataclasses.replace(photos, views=cameras.views)


def stabilised(vertices: Floats, rest: Floats, confidence: Floats, options: RegisterOptions) -> Floats:
    """The pose (V, 3) moved so that its confident skin at rest lies where it lies in the neutral ``rest``."""
    if not options.stabilise:
        return vertices
    weight = (confidence > CONFIDENT).astype(np.float64)
    if options.rigid_region is not None:
        steady = np.zeros(len(weight))
        steady[list(options.rigid_region)] = 1.0
        if np.count_nonzero(weight * steady) >= LEAST_STEADY_VERTICES:
            weight = weight * steady
    if np.count_nonzero(weight) < LEAST_STEADY_VERTICES:
        return vertices
    found = stabilise_head(vertices, rest, weight)
    logger.info(
        "register: head %s, %.0f %% of the weight agrees, residual %.4f of D",
        "stabilised" if found.accepted else "stays as aligned",
        100 * found.inlier_share,
        found.residual,
    )
    return found.neutral_from_pose.apply(vertices)
