"""The editor: examples in, control points and targets in, mesh out (section 3 of paper 001)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from capture_eval.editing.blend_weights import (
    Balance,
    ControlSystem,
    control_weights,
    coupled_weights,
    invariant_system,
    printed_system,
)
from capture_eval.editing.coherency import (
    STILL,
    ExampleMotion,
    coherency_of,
    coherent_motion,
    example_motion,
    influence_maps,
)
from capture_eval.editing.control_targets import ControlPoint, Targets, gather_targets
from capture_eval.editing.projection import Projection
from capture_eval.errors import InputError

Floats = NDArray[np.float64]

REFERENCE = 1000.0  # the picture's height and the model's D are this many units in the default form


@dataclass(frozen=True)
class EditOptions:
    """How targets become a face.

    Attributes
    ----------
    balance : Balance
        θ1 and θ2 of Eq 6.
    invariant : bool
        Blend displacements, so that the result moves with its inputs; False gives the printed form, in which the
        weights of all examples are free and the result depends on the choice of the origin.
    normalise : bool
        Measure pixels in thousandths of the picture's height and lengths in thousandths of D, so that the balance of
        Eq 6 does not depend on the picture's size or the model's unit; False gives the printed form.
    reach : float or None
        A drag farther than this many times what the farthest example reaches counts as a drag that far. Without it
        (None, the printed form) a drag too far sends the face back to rest, because then all examples are equally far.
    coupled : bool
        Ask Eq 6 of the blended face, all control points at once; False solves one by one as printed, and then each
        further control point pulls the others off their targets.
    sharpness : float
        Power of the coherency in Eq 10. Control points of one face are so coherent that with 1, as printed, the two
        corners of a mouth have shares of 0.6 and 0.4 in each other; larger powers tell them apart.
    still : float
        Displacements up to this share of D count as zero in Eq 7.

    Raises
    ------
    InputError
        A reach below 1, a sharpness that is not positive, or a share outside [0, 1).
    """

    balance: Balance = field(default_factory=Balance)
    invariant: bool = True
    normalise: bool = True
    reach: float | None = 1.5
    coupled: bool = True
    sharpness: float = 2.0
    still: float = STILL

    def __post_init__(self) -> None:
        if self.reach is not None and not self.reach >= 1.0:
            raise InputError(f"editing: reach {self.reach} would keep from recorded expressions; give 1 or more")
        if not (np.isfinite(self.sharpness) and self.sharpness > 0.0):
            raise InputError(f"editing: sharpness {self.sharpness} must be positive")
        if not 0.0 <= self.still < 1.0:
            raise InputError(f"editing: still {self.still} is a share of D, at least 0 and below 1")

    @staticmethod
    def printed() -> EditOptions:
        """Eqs 5 to 10 as printed (but for the slip in Eqs 9 and 10)."""
        return EditOptions(invariant=False, normalise=False, reach=None, coupled=False, sharpness=1.0)


@dataclass(frozen=True)
class MotionCarrier:
    """How motions of the control points are seen on another face (section 4).

    Attributes
    ----------
    rest : (L, 3)
        The points of the other face that the user drags.
    linear : (L, 3, 3)
        Rotation times scale: other motion from own motion.
    """

    rest: Floats
    linear: Floats


@dataclass(frozen=True)
class Edit:
    """An edited face and what it was made of; also what the next edit may reuse.

    Attributes
    ----------
    controls : tuple of ControlPoint
    options : EditOptions
    projection, carrier
        As given.
    vertices : (N, 3) float64
        The new face.
    weights : (L, M) float64
        Of the examples for each control point, the neutral first.
    coherency, influence : (N, L) float64
        b of Eq 8 and B of Eq 10.
    solved : (L, 3) float64
        Where its own weights put each control point.
    reached : (L, 3) float64
        Where the blended face has it; on the other face where there is a carrier.
    misses : (L,) float64
        Distance of ``reached`` from the target, in pixels or the unit of the model.
    limited : (L,) bool
        Targets that were too far away, see ``EditOptions.reach``.
    """

    controls: tuple[ControlPoint, ...]
    options: EditOptions
    projection: Projection | None
    carrier: MotionCarrier | None
    vertices: Floats
    weights: Floats
    coherency: Floats
    influence: Floats
    solved: Floats
    reached: Floats
    misses: Floats
    limited: NDArray[np.bool_]


def check_controls(controls: Sequence[ControlPoint], count: int) -> None:
    """Refuse control points that are none, outside the mesh of ``count`` vertices, or the same vertex twice.

    Raises
    ------
    InputError
        With the vertex in question.
    """
    if not controls:
        raise InputError("editing: no control point; give at least one")
    seen = set[int]()
    for control in controls:
        if not 0 <= control.vertex < count:
            raise InputError(f"control {control.vertex}: the mesh has the vertices 0..{count - 1}")
        if control.vertex in seen:
            raise InputError(f"control {control.vertex}: the vertex is given twice; one target per vertex")
        seen.add(control.vertex)


def scaled_targets(
    controls: Sequence[ControlPoint], projection: Projection | None, length: float, options: EditOptions
) -> Targets:
    """Targets in the units of the options; ``length`` is D of the face that is dragged."""
    if not options.normalise:
        return gather_targets(controls, projection)
    pixel_unit = projection.height / REFERENCE if projection is not None else 1.0
    return gather_targets(controls, projection, pixel_unit, length / REFERENCE)


class ExpressionEditor:
    """Edits a face by dragging its points, with recorded expressions as the guide to what is natural.

    Parameters
    ----------
    examples : (M, N, 3)
        Registered meshes, the neutral first; any unit and frame.
    options : EditOptions, optional

    Raises
    ------
    InputError
        No or one example, or numbers that are not finite.

    Examples
    --------
    >>> editor = ExpressionEditor(examples)
    >>> first = editor.edit([ControlPoint(corner, (410.0, 388.5))], projection)
    >>> second = editor.edit([ControlPoint(corner, (412.0, 384.0))], projection, previous=first)
    """

    def __init__(self, examples: Floats, options: EditOptions | None = None) -> None:
        self.motion: ExampleMotion = example_motion(examples)
        self.options = options or EditOptions()

    def edit(
        self,
        controls: Sequence[ControlPoint],
        projection: Projection | None = None,
        previous: Edit | None = None,
        carrier: MotionCarrier | None = None,
    ) -> Edit:
        """The face for control points: a pure function of editor, controls, projection and carrier.

        Parameters
        ----------
        controls : sequence of ControlPoint
            At least one, no vertex twice.
        projection : Projection, optional
            Needed by targets that are pixels.
        previous : Edit, optional
            An edit by this editor: coherency of vertices and weights of control points that are the same are taken from
            it. The result does not depend on it.
        carrier : MotionCarrier, optional
            Where targets are meant for another face.

        Raises
        ------
        InputError
            No control points, a vertex outside the mesh or twice, a pixel without a camera, or points behind it.
        """
        chosen = tuple(controls)
        check_controls(chosen, len(self.motion.neutral))
        _check_carrier(carrier, len(chosen))
        options, vertices = self.options, np.array([control.vertex for control in chosen], dtype=np.int64)
        system = self._system(vertices, carrier)
        asked = scaled_targets(chosen, projection, self._length(carrier), options)
        targets, limited = asked, np.zeros(len(chosen), dtype=np.bool_)
        if options.reach is not None:
            targets, limited = asked.limited(system.rest, system.examples, options.reach)
        known = self._known_columns(vertices, previous)
        if options.coupled:
            shares = influence_maps(self._own_coherency(vertices, known), options.sharpness)
            weights = coupled_weights(system, targets, options.balance, shares)
        else:
            usable = previous if previous is not None and self._same_setting(previous, projection, carrier) else None
            weights = self._weights(chosen, system, targets, usable)
        coherency, influence, moved = self._blend(vertices, weights, known)
        reached = moved[vertices]
        if carrier is not None:
            own = (reached - self.motion.neutral[vertices])[..., None]
            reached = carrier.rest + (carrier.linear @ own)[..., 0]
        if options.invariant:
            weights = np.concatenate([1.0 - weights.sum(axis=1, keepdims=True), weights], axis=1)
        return Edit(
            chosen, options, projection, carrier, moved, weights, coherency, influence,
            solved=system.points(weights[:, 1:] if options.invariant else weights),
            reached=reached, misses=asked.distances(reached), limited=limited,
        )  # fmt: skip

    def _length(self, carrier: MotionCarrier | None) -> float:
        """D, in the unit of the face that is dragged."""
        if carrier is None:
            return self.motion.diameter
        return self.motion.diameter * float(np.mean(np.cbrt(np.abs(np.linalg.det(carrier.linear)))))

    def _system(self, vertices: NDArray[np.int64], carrier: MotionCarrier | None) -> ControlSystem:
        positions = self.motion.positions(vertices)
        own = invariant_system(positions) if self.options.invariant else printed_system(positions)
        if carrier is None:
            return own
        turn = np.swapaxes(carrier.linear, 1, 2)
        offset = carrier.rest - (carrier.linear @ own.rest[..., None])[..., 0]
        return ControlSystem(
            (carrier.linear @ own.origin[..., None])[..., 0] + offset,
            own.basis @ turn,
            own.examples @ turn + offset[:, None],
            carrier.rest,
        )

    def _same_setting(self, previous: Edit, projection: Projection | None, carrier: MotionCarrier | None) -> bool:
        """Whether weights of an earlier edit would come out the same."""
        same_camera = previous.projection is projection
        return previous.options == self.options and same_camera and previous.carrier is None and carrier is None

    def _weights(
        self, controls: tuple[ControlPoint, ...], system: ControlSystem, targets: Targets, previous: Edit | None
    ) -> Floats:
        """Free weights (L, K or M); only those of control points that changed are searched."""
        skipped = 1 if self.options.invariant else 0
        known = dict(zip(previous.controls, previous.weights[:, skipped:], strict=True)) if previous else {}
        weights = np.zeros(system.basis.shape[:2])
        fresh = np.array([control not in known for control in controls], dtype=np.bool_)
        for row, control in enumerate(controls):
            if not fresh[row]:
                weights[row] = known[control]
        if np.any(fresh):
            weights[fresh] = control_weights(system.select(fresh), targets.select(fresh), self.options.balance)
        return weights

    def _known_columns(self, vertices: NDArray[np.int64], previous: Edit | None) -> dict[int, Floats]:
        """Coherency (N,) of control vertices that need not be computed."""
        del vertices
        if previous is None or previous.options.still != self.options.still:
            return {}
        return {control.vertex: previous.coherency[:, k] for k, control in enumerate(previous.controls)}

    def _own_coherency(self, vertices: NDArray[np.int64], known: dict[int, Floats]) -> Floats:
        """Coherency (L, L) of the control points with each other."""
        if all(int(vertex) in known for vertex in vertices):
            return np.stack([known[int(vertex)][vertices] for vertex in vertices], axis=1)
        return coherency_of(self.motion, vertices, vertices, self.options.still)

    def _blend(
        self, vertices: NDArray[np.int64], weights: Floats, known: dict[int, Floats]
    ) -> tuple[Floats, Floats, Floats]:
        """Coherency and influence (N, L) and the new face (N, 3); only columns of new vertices are computed."""
        free = weights if self.options.invariant else weights[:, 1:]
        sharpness, still = self.options.sharpness, self.options.still
        coherency, influence, moved = coherent_motion(self.motion, vertices, free, sharpness, still, known)
        neutral = self.motion.neutral
        if self.options.invariant:
            return coherency, influence, neutral + moved
        total = influence @ weights.sum(axis=1)
        coherent = influence.sum(axis=1) > 0  # 0/0 of Eq 10: such a vertex keeps its neutral position
        scale = np.where(coherent, total, 1.0)[:, None]
        return coherency, influence, scale * neutral + moved


def _check_carrier(carrier: MotionCarrier | None, count: int) -> None:
    if carrier is not None and (carrier.rest.shape != (count, 3) or carrier.linear.shape != (count, 3, 3)):
        raise InputError(f"editing: carrier of {len(carrier.rest)} points for {count} control points")
