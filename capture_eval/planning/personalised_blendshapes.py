"""Personal blendshapes from captured expressions (Li, Weise and Pauly 2010), with the binary weights known.

Every triangle's gradients are fitted on their own: the captured expressions as the neutral plus the sum of their
shapes, and every shape close to the generic one. A shape is held the tighter the less the generic one moves the
triangle, so what a photo shows goes to the shape that moves there.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from capture_eval.errors import InputError
from capture_eval.planning.deformation_transfer import TransferSolver

Floats = NDArray[np.float64]

# Li et al. 2010 hold a triangle by ((1 + |M|) / (kappa + |M|))^theta, kappa = 0.1, theta = 2, weight 0.1 to 0.5,
# because their weights of the expressions are unknown. Here they are known: photos may be believed more.
_KAPPA, _THETA = 0.01, 2.0
REGULARISATION = 1e-4


def expression_weights(expressions: Sequence[Sequence[int]], shape_count: int) -> Floats:
    """Weights (J, K): 1 for the shapes of each expression.

    Raises
    ------
    InputError
        A shape that is not there, or an expression without shapes.
    """
    weights = np.zeros((len(expressions), shape_count))
    for row, shapes in enumerate(expressions):
        if not len(shapes):
            raise InputError(f"training expression {row + 1} has no shapes")
        for shape in shapes:
            if not 0 <= shape < shape_count:
                raise InputError(
                    f"training expression {row + 1}: there is no shape {shape}, only 0 to {shape_count - 1}"
                )
            weights[row, shape] = 1.0
    return weights


def personalise(
    solver: TransferSolver,
    expressions: Sequence[Sequence[int]],
    captured: Floats,
    regularisation: float = REGULARISATION,
) -> Floats:
    """Personal shapes of a target from its captured expressions.

    Parameters
    ----------
    solver : TransferSolver
        Of the template rig and the target's neutral.
    expressions : sequence of sets of shapes
        What was captured: each shape at weight 1.
    captured : (J, N, 3) float64
        The target in these expressions, aligned with its neutral.
    regularisation : float
        Above 0: how firmly shapes are held to the generic ones.

    Returns
    -------
    (K, N, 3) float64
        Shapes that are in no expression are the generic ones of `transfer_deformation`.

    Raises
    ------
    InputError
        Captured expressions that do not fit or are not finite, or a regularisation that is not above 0.
    """
    rig = solver.rig
    weights = expression_weights(expressions, rig.shape_count)
    captured = np.asarray(captured, dtype=np.float64)
    if captured.shape != (len(expressions), *rig.neutral.shape):
        raise InputError(f"captured expressions {captured.shape}: {len(expressions)} of {rig.neutral.shape} are needed")
    if not np.all(np.isfinite(captured)):
        raise InputError("captured expressions hold numbers that are not finite")
    if not regularisation > 0.0:
        raise InputError(f"regularisation {regularisation}: must be above 0")
    neutral = solver.gradients.of(solver.target)
    result = np.empty_like(rig.shapes)
    used = np.flatnonzero(weights.any(axis=0))
    for shape in np.setdiff1d(np.arange(rig.shape_count), used):
        result[shape] = solver.transfer(int(shape))
    for rows in _linked(weights):
        members = np.flatnonzero(weights[rows].any(axis=0))
        part = weights[rows][:, members]
        generic = np.array([solver.generic_gradients(int(shape)) - neutral for shape in members])
        wanted = np.array([solver.gradients.of(positions) - neutral for positions in captured[rows]])
        personal = fit_gradients(generic, part, wanted, regularisation)
        hints = _hints(solver, members, part, captured[rows])
        for row, shape in enumerate(members):
            result[shape] = solver.positions(neutral + personal[row], hints[row])
    return result


def _linked(weights: Floats) -> list[list[int]]:
    """Expressions in groups that share no shape: each group is a problem of its own."""
    from scipy.sparse.csgraph import connected_components

    count, label = connected_components(weights @ weights.T > 0.0, directed=False)
    return [np.flatnonzero(label == number).tolist() for number in range(count)]


def fit_gradients(generic: Floats, weights: Floats, wanted: Floats, regularisation: float) -> Floats:
    """Least-squares gradients of the shapes (K, T, 3, 2), every triangle on its own.

    Minimises ``|weights M - wanted|^2 + regularisation * sum_k w_k |M_k - generic_k|^2``, through a system as large as
    the number of expressions.

    Parameters
    ----------
    generic : (K, T, 3, 2)
    weights : (J, K)
    wanted : (J, T, 3, 2)
    """
    size = np.sqrt((generic**2).sum(axis=(2, 3)))
    # displacement gradients are ratios of lengths: no unit enters here
    hold = regularisation * ((1.0 + size) / (_KAPPA + size)) ** _THETA
    loose = weights[:, :, None] / hold[None]  # (J, K, T)
    system = np.einsum("jkt,lk->tjl", loose, weights) + np.eye(len(weights))
    missing = wanted - np.einsum("jk,ktab->jtab", weights, generic)
    solved = np.linalg.solve(system, missing.transpose(1, 0, 2, 3).reshape(len(system), len(weights), 6))
    change = np.einsum("jkt,tjc->ktc", loose, solved)
    return np.asarray(generic + change.reshape(generic.shape), dtype=np.float64)


def _hints(solver: TransferSolver, used: NDArray[np.int64], weights: Floats, captured: Floats) -> Floats:
    """Rough positions of the shapes: the captured displacement is shared by how far each generic shape moves there."""
    hints = np.array([solver.hint(int(shape)) - solver.target for shape in used])
    length = np.linalg.norm(hints, axis=2)
    rough = hints.copy()
    for row, positions in enumerate(captured):
        members = np.flatnonzero(weights[row])
        missing = positions - solver.target - hints[members].sum(axis=0)
        share = length[members] / np.maximum(length[members].sum(axis=0), 1e-300)
        rough[members] += share[:, :, None] * missing
    return np.asarray(solver.target + rough, dtype=np.float64)
