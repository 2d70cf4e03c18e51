"""Blend weights of control points: Eq 6 of paper 001 by L-BFGS-B, Eq 5 in closed form.

The energy of one control point is ``θ1 |F(q) − p|² + θ2 Σ_m (1 + |F(v_m) − p|²) w_m²`` with ``q = q0 + Aᵀ w``; row m
of A is the example's position v_m in the printed form (q0 = 0), and its displacement v_m − v_0 in the form that does
not depend on the origin (q0 = v_0; the neutral's weight is what is missing to one).

Only q enters the first term, so at a minimum ``w = C⁻¹ A λ`` with ``C = diag(1 + |F(v_m) − p|²)`` and λ of three
numbers: the gradient is zero only where C w lies in the span of A's columns. The search therefore runs over three
unknowns a control point, whatever the number of examples, and is exact.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture_eval.editing.control_targets import Targets
from capture_eval.errors import InputError, SolverError

Floats = NDArray[np.float64]

_NO_MOTION = 1e-13  # relative eigenvalue of the Gram matrix below which no example moves the point that way
_ITERATIONS, _ROUNDS = 40, 12
_SLOPE = 1e-10  # of the energy by unknowns in which its curvature is one: their error
_FLAT = 1e-15  # relative fall of the energy that rounding could make
_SHALLOWEST = 0.01  # share of the depth at rest that a control point keeps while its weights are searched


@dataclass(frozen=True)
class Balance:
    """θ1 (meet the target) and θ2 (keep to examples near the target) of Eq 6.

    Raises
    ------
    InputError
        Not both positive and finite.
    """

    fit: float = 2.0
    proximity: float = 1.0

    def __post_init__(self) -> None:
        if not (np.isfinite(self.fit) and np.isfinite(self.proximity) and self.fit > 0 and self.proximity > 0):
            raise InputError(f"weights: theta1 {self.fit} and theta2 {self.proximity} must be positive")


@dataclass(frozen=True)
class ControlSystem:
    """How L control points answer to the weights of K examples.

    Attributes
    ----------
    origin : (L, 3)
        Where the points are with zero weights.
    basis : (L, K, 3)
        What the weight of each example adds.
    examples : (L, K, 3)
        Where each example has the points, for the proximity term.
    rest : (L, 3)
        Where the neutral face has the points; the search starts there.
    """

    origin: Floats
    basis: Floats
    examples: Floats
    rest: Floats

    def select(self, chosen: NDArray[np.bool_]) -> ControlSystem:
        """The system of some control points."""
        return ControlSystem(self.origin[chosen], self.basis[chosen], self.examples[chosen], self.rest[chosen])

    def points(self, weights: Floats) -> Floats:
        """Control points (L, 3) for weights (L, K)."""
        return np.asarray(self.origin + np.einsum("lk,lki->li", weights, self.basis), dtype=np.float64)


def printed_system(positions: Floats) -> ControlSystem:
    """Eq 6 as printed: weights of all examples' positions (L, M, 3), the neutral's first."""
    return ControlSystem(np.zeros_like(positions[:, 0]), positions, positions, positions[:, 0])


def invariant_system(positions: Floats) -> ControlSystem:
    """Weights of displacements from the neutral, which comes first in the positions (L, M, 3)."""
    rest = positions[:, 0]
    return ControlSystem(rest, positions[:, 1:] - rest[:, None], positions[:, 1:], rest)


def proximity_penalties(system: ControlSystem, targets: Targets) -> Floats:
    """``1 + |F(v_m) − p|²`` of every control point and example, (L, K)."""
    distance = targets.residuals(system.examples)
    return np.asarray(1.0 + np.einsum("lki,lki->lk", distance, distance), dtype=np.float64)


def weight_energy(system: ControlSystem, targets: Targets, balance: Balance, weights: Floats) -> tuple[Floats, Floats]:
    """Eq 6 of every control point (L,) and its gradient by the weights (L, K)."""
    penalties = proximity_penalties(system, targets)
    residual, jacobian = targets.residuals_with_jacobian(system.points(weights))
    energy = balance.fit * np.sum(residual**2, axis=1) + balance.proximity * np.sum(penalties * weights**2, axis=1)
    pull = np.einsum("lri,lr->li", jacobian, residual)
    gradient = 2.0 * balance.fit * np.einsum("lki,li->lk", system.basis, pull)
    return energy, gradient + 2.0 * balance.proximity * penalties * weights


def closed_form_weights(system: ControlSystem, targets: Targets, balance: Balance) -> Floats:
    """Minimum (L, K) of Eq 5: targets in space, a convex quadratic.

    Raises
    ------
    InputError
        Some target is a pixel.
    """
    if np.any(targets.on_screen):
        raise InputError("weights: the closed form (Eq 5) is for targets in space; a pixel needs Eq 6")
    shares = system.basis / proximity_penalties(system, targets)[..., None]
    gram = np.einsum("lki,lkj->lij", system.basis, shares)
    fit = balance.fit / targets.length_unit**2
    matrix = fit * gram + balance.proximity * np.eye(3)
    multiplier = np.linalg.solve(matrix, (fit * (targets.values - system.origin))[..., None])
    return np.asarray((shares @ multiplier)[..., 0], dtype=np.float64)


def iterative_weights(system: ControlSystem, targets: Targets, balance: Balance) -> Floats:
    """Minimum (L, K) of Eq 6 by L-BFGS-B with the analytic gradient.

    Raises
    ------
    InputError
        A control point lies behind the camera in some example.
    SolverError
        The search did not end.
    """
    shares = system.basis / proximity_penalties(system, targets)[..., None]
    gram = np.einsum("lki,lkj->lij", system.basis, shares)
    multiplier = minimise_multipliers(gram, system.origin[:, None], system.rest[:, None], targets, balance)
    return np.asarray(np.einsum("lki,li->lk", shares, multiplier), dtype=np.float64)


def control_weights(system: ControlSystem, targets: Targets, balance: Balance) -> Floats:
    """Weights (L, K): in closed form for targets in space, by L-BFGS-B for pixels."""
    weights = np.zeros(system.basis.shape[:2])
    for chosen, solve in ((targets.on_screen, iterative_weights), (~targets.on_screen, closed_form_weights)):
        if np.any(chosen):
            weights[chosen] = solve(system.select(chosen), targets.select(chosen), balance)
    return weights


def coupled_weights(system: ControlSystem, targets: Targets, balance: Balance, shares: Floats) -> Floats:
    """Weights (L, K) of all control points at once, with Eq 6 asked of the blended face.

    Solved one by one, the control points' weights meet their targets, but the blend of Eq 10 mixes them at every
    control point, so that a second one pulls the first off its target. Here the first term of Eq 6 is taken where the
    blended face has the control points, ``q_l = q0_l + Σ_k B[l, k] A_lᵀ W_k``; the second stays as it is. With one
    control point this is Eq 6. Not in the paper.

    Parameters
    ----------
    system : ControlSystem
    targets : Targets
    balance : Balance
    shares : (L, L)
        Influence B of the control points (second index) on each of them (first).
    """
    points, examples = system.basis.shape[:2]
    inverse = 1.0 / proximity_penalties(system, targets)
    mixed = shares[:, None, :, None] * np.swapaxes(system.basis, 1, 2)[:, :, None, :]  # point, axis, control, example
    flat = mixed.reshape(3 * points, points * examples)
    weighted = flat * inverse.ravel()
    gram = weighted @ flat.T
    if np.any(targets.on_screen):
        multiplier = minimise_multipliers(gram[None], system.origin[None], system.rest[None], targets, balance)[0]
    else:
        fit = balance.fit / targets.length_unit**2
        matrix = fit * gram + balance.proximity * np.eye(3 * points)
        multiplier = np.linalg.solve(matrix, fit * (targets.values - system.origin).ravel())
    return np.asarray((multiplier @ weighted).reshape(points, examples), dtype=np.float64)


def minimise_multipliers(gram: Floats, origin: Floats, start: Floats, targets: Targets, balance: Balance) -> Floats:
    """λ (B, 3P) of B independent problems with P points each: least ``θ1 |F(q0 + G λ) − p|² + θ2 λᵀ G λ``.

    Parameters
    ----------
    gram : (B, 3P, 3P)
        G = Aᵀ C⁻¹ A, the three coordinates of a point next to each other.
    origin, start : (B, P, 3)
        q0, and where the search starts.
    targets : Targets
        Of the B·P points, problem after problem.
    balance : Balance

    Notes
    -----
    Unknowns are turned and scaled so that the Hessian (Gauss-Newton) is the identity where a search starts: it is then
    over after a handful of steps, and its tolerance is one on the unknowns themselves. Where perspective changes the
    Hessian on the way, the search starts again from where it stopped.

    Raises
    ------
    SolverError
        The search did not end.
    """
    problems, size = gram.shape[:2]
    eigenvalues, axes = np.linalg.eigh(gram)
    moving = eigenvalues > _NO_MOTION * np.maximum(eigenvalues[:, -1:], 1e-300)
    root = np.sqrt(np.where(moving, eigenvalues, 0.0))
    inverse_root = np.where(moving, 1.0 / np.where(moving, root, 1.0), 0.0)
    points_from_scaled = axes * root[:, None, :]
    scaled = inverse_root * np.einsum("bij,bi->bj", axes, (start - origin).reshape(problems, size))
    slope = np.inf
    for _ in range(_ROUNDS):
        scaled, slope = _search(points_from_scaled, origin, scaled, targets, balance)
        if slope <= 1e3 * _SLOPE:
            break
    if not slope <= 1e4 * _SLOPE:
        raise SolverError(
            f"weights: L-BFGS-B did not converge (slope {slope:.3g}); raise theta2, {balance.proximity:g}"
        )
    return np.asarray(np.einsum("bij,bj->bi", axes * inverse_root[:, None, :], scaled), dtype=np.float64)


def _search(
    points_from_scaled: Floats, origin: Floats, scaled: Floats, targets: Targets, balance: Balance
) -> tuple[Floats, float]:
    """One run of L-BFGS-B from scaled multipliers (B, n): where it ended and the slope there by the energy's root."""
    from scipy.optimize import minimize

    first = origin.reshape(scaled.shape) + np.einsum("bij,bj->bi", points_from_scaled, scaled)
    whitening = _whitening(points_from_scaled, first.reshape(-1, 3), targets, balance)
    to_scaled, to_points = _block_diagonal(whitening), _block_diagonal(points_from_scaled @ whitening)
    shallowest = _SHALLOWEST * targets.depths(first.reshape(-1, 3))

    def energy(unknowns: Floats) -> tuple[float, Floats]:
        here = scaled.ravel() + to_scaled @ unknowns
        places = (first.ravel() + to_points @ unknowns).reshape(-1, 3)
        if np.any(targets.depths(places) <= shallowest):  # a step too long: a wall that the line search backs off from
            return wall * (1.0 + float(unknowns @ unknowns)), 2.0 * wall * unknowns
        residual, jacobian = targets.residuals_with_jacobian(places)
        pull = (residual[:, None, :] @ jacobian).ravel()
        value = balance.fit * float(np.sum(residual**2)) + balance.proximity * float(here @ here)
        return value, 2.0 * (balance.fit * (pull @ to_points) + balance.proximity * (here @ to_scaled))

    wall = np.inf
    start = energy(np.zeros(scaled.size))[0]
    wall = 10.0 * start
    options: Any = {"maxiter": _ITERATIONS, "ftol": _FLAT, "gtol": _SLOPE * max(1.0, float(np.sqrt(start)))}
    search: Any = minimize  # its stubs do not know that energy and gradient may come together with options
    minimum = search(energy, np.zeros(scaled.size), jac=True, method="L-BFGS-B", options=options)
    slope = float(np.max(np.abs(minimum.jac), initial=0.0)) / max(1.0, float(np.sqrt(minimum.fun)))
    return scaled + (to_scaled @ minimum.x).reshape(scaled.shape), slope


def _block_diagonal(blocks: Floats) -> Floats:
    """The (B, n, n) blocks as one (Bn, Bn) matrix."""
    count, size = blocks.shape[:2]
    matrix = np.zeros((count, size, count, size))
    matrix[np.arange(count), :, np.arange(count), :] = blocks
    return matrix.reshape(count * size, count * size)


def _whitening(points_from_scaled: Floats, places: Floats, targets: Targets, balance: Balance) -> Floats:
    """Map (B, n, n) of unknowns to scaled multipliers under which the energy's Hessian at the start is about one."""
    problems, size = points_from_scaled.shape[:2]
    _, jacobian = targets.residuals_with_jacobian(places)
    by_point = points_from_scaled.reshape(problems, -1, 3, size)
    slopes = np.einsum("bpri,bpij->bprj", jacobian.reshape(problems, -1, 3, 3), by_point).reshape(problems, -1, size)
    hessian = 2.0 * (balance.fit * np.swapaxes(slopes, 1, 2) @ slopes + balance.proximity * np.eye(size))
    values, axes = np.linalg.eigh(hessian)
    return np.asarray(axes / np.sqrt(values)[:, None, :], dtype=np.float64)
