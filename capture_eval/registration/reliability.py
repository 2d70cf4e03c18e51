"""Signs that a registered pose cannot be believed, each with its reason in words.

A deformation solver always returns a mesh. Whether it is the mesh of this person in this pose shows in what measured
it: how much of the skin the pose's photos agree on (stereo), how much of that carries the neutral's texture (flow), how
much of the neutral's skin is seen at all, and whether the poses lie along a path in the order in which they are given.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capture_eval.errors import InputError
from capture_eval.registration.deformation_solver import SurfaceConstraints
from capture_eval.registration.texture_rounds import vertex_sums

Floats = NDArray[np.float64]
Booleans = NDArray[np.bool_]

_MEASURED = 1.0  # sum of weights around a vertex from which it counts as measured; the texture rounds use the same
_LEAST_ORDER_VERTICES = 50
_TIE = 0.02  # of the way through all poses


@dataclass(frozen=True)
class ReliabilityOptions:
    """Limits. Their reasons are what good and bad captures measured (`benchmarks/registration_honesty.py`).

    Parameters
    ----------
    minimum_stereo_share : float
        Seen skin on which the pose's photos agree. Below it the skin is blank, blurred, or not where the mesh is.
    minimum_skin_agreement : float
        Share of that skin which carries the neutral's texture. Below it: another person, other make-up or other light.
    minimum_coverage : float
        Skin of the neutral that enough photos of the pose see.
    minimum_photo_share : float
        Photos placed, against the middle of all poses.
    minimum_order_gain : float
        Two poses are called exchanged when exchanging them shortens the steps to and from them by more than this share
        (in even motion 1/3 at the ends, 2/5 for neighbours within).
    minimum_order_length : float
        And when that is more than this share of the way through all poses: steps as small as noise have no order.
    """

    minimum_stereo_share: float = 0.3
    minimum_skin_agreement: float = 0.4
    minimum_coverage: float = 0.7
    minimum_photo_share: float = 0.7
    minimum_order_gain: float = 0.05
    minimum_order_length: float = 0.003


@dataclass(frozen=True)
class PoseEvidence:
    """What measured a registered pose, as shares in [0, 1].

    Parameters
    ----------
    stereo_share : float or None
        Of the seen skin, on which the photos of the pose agree; None where stereo is switched off.
    skin_agreement : float or None
        Of that, which carries the neutral's texture; None for the neutral itself and where flow is switched off.
    """

    stereo_share: float | None
    skin_agreement: float | None

    @property
    def array(self) -> Floats:
        """Both, (2,); NaN for None."""
        return np.array([np.nan if share is None else share for share in (self.stereo_share, self.skin_agreement)])

    @staticmethod
    def from_array(values: Floats) -> PoseEvidence:
        """The inverse of `array`."""
        share, agreement = (None if np.isnan(value) else float(value) for value in values)
        return PoseEvidence(share, agreement)


def pose_evidence(
    flow: SurfaceConstraints | None, stereo: SurfaceConstraints | None, seen: Booleans, is_neutral: bool
) -> PoseEvidence:
    """Evidence from the constraints of the last texture round.

    Parameters
    ----------
    flow, stereo : SurfaceConstraints or None
        None where that kind of measurement is switched off: it then speaks neither for nor against the pose.
    seen : (V,) bool
        Skin in enough photos.
    """
    count = len(seen)
    measured, share = seen, None
    if stereo is not None:
        measured = seen & (vertex_sums(stereo, count) > _MEASURED)
        share = float(np.mean(measured[seen])) if seen.any() else 0.0
    if is_neutral or flow is None:
        return PoseEvidence(share, None)
    by_flow = vertex_sums(flow, count) > _MEASURED
    return PoseEvidence(share, float(np.mean(by_flow[measured])) if measured.any() else 0.0)


def evidence_faults(evidence: PoseEvidence, options: ReliabilityOptions) -> list[str]:
    """Why a pose is not to be believed at all, in words; empty for a good one."""
    faults = []
    if evidence.stereo_share is not None and evidence.stereo_share < options.minimum_stereo_share:
        faults.append(
            f"the photos agree on {evidence.stereo_share:.0%} of the seen skin only, "
            f"{options.minimum_stereo_share:.0%} are needed: blank or blurred skin, or wrong cameras"
        )
    elif evidence.skin_agreement is not None and evidence.skin_agreement < options.minimum_skin_agreement:
        faults.append(
            f"{evidence.skin_agreement:.0%} of the measured skin carries the neutral's texture, "
            f"{options.minimum_skin_agreement:.0%} are needed: another person, other make-up or other light"
        )
    return faults


def coverage_faults(
    seen: Booleans,
    neutral_seen: Booleans,
    photos: int | None,
    typical_photos: float | None,
    options: ReliabilityOptions,
) -> list[str]:
    """What is missing of a pose: photos, or skin that the neutral shows.

    Parameters
    ----------
    seen, neutral_seen : (V,) bool
    photos, typical_photos : int, float or None
        Photos placed in this pose and the middle of all poses; None when the poses were not made from photos.
    """
    faults = []
    if photos is not None and typical_photos and photos < options.minimum_photo_share * typical_photos:
        faults.append(f"{photos} photos placed, {typical_photos:.0f} in the other poses")
    if neutral_seen.any():
        share = float(np.mean(seen[neutral_seen]))
        if share < options.minimum_coverage:
            faults.append(
                f"its photos see {share:.0%} of the skin seen in the neutral, {options.minimum_coverage:.0%} are needed"
            )
    return faults


@dataclass(frozen=True)
class ExchangedPoses:
    """Two poses whose exchange shortens the steps to and from them by the share `gain`."""

    first: int
    second: int
    gain: float


def exchanged_poses(
    vertices: Floats, known: Booleans, options: ReliabilityOptions | None = None
) -> list[ExchangedPoses]:
    """Pairs of poses that look exchanged: expressions move along a path, and a wrong order makes it longer.

    The length of a step is the root mean square distance over the vertices. Greedy: the exchange that shortens the way
    most is taken first, until none shortens it by more than the limit.

    Parameters
    ----------
    vertices : (P, V, 3) float64
        Poses in their stated order; rows of NaN for failed ones, which are passed over.
    known : (V,) bool
        Vertices that are trusted in every pose.

    Raises
    ------
    InputError
        Shapes differ.
    """
    options = options or ReliabilityOptions()
    if vertices.ndim != 3 or known.shape != vertices.shape[1:2]:
        raise InputError(f"order of poses: vertices {vertices.shape} and marks {known.shape} do not fit")
    order = np.flatnonzero(np.isfinite(vertices).all(axis=(1, 2)))
    if len(order) < 3 or np.count_nonzero(known) < _LEAST_ORDER_VERTICES:
        return []
    moving = vertices[order][:, known]
    distance = np.sqrt(np.mean(np.sum((moving[:, None] - moving[None]) ** 2, axis=3), axis=2))
    found: list[ExchangedPoses] = []
    path = list(range(len(order)))
    for _ in path:
        stated = _length(path, distance)
        swaps = [(_length(_swapped(path, a, b), distance), a, b) for a in path for b in path if a < b]
        least = min(swaps)[0]
        # Exchanging the ends of a short sequence may straighten it as well: then it is the poses within.
        close = [swap for swap in swaps if swap[0] <= least + _TIE * stated]
        shortest, a, b = min(close, key=lambda swap: (len({0, len(path) - 1} & {swap[1], swap[2]}), swap[0]))
        gain = (stated - shortest) / max(_steps_at(path, distance, (a, b)), 1e-300)
        if stated - shortest <= options.minimum_order_length * stated or gain <= options.minimum_order_gain:
            break
        found.append(ExchangedPoses(int(order[a]), int(order[b]), float(gain)))
        path = _swapped(path, a, b)
    return found


def _length(path: Sequence[int], distance: Floats) -> float:
    return float(distance[path[:-1], path[1:]].sum())


def _steps_at(path: Sequence[int], distance: Floats, poses: tuple[int, int]) -> float:
    """Length of the steps of a path that begin or end at one of the poses."""
    steps = itertools.pairwise(path)
    return float(sum(distance[a, b] for a, b in steps if a in poses or b in poses))


def _swapped(path: Sequence[int], a: int, b: int) -> list[int]:
    """The path with the poses a and b exchanged."""
    names = {a: b, b: a}
    return [names.get(pose, pose) for pose in path]
