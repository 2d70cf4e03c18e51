"""Fitting of the PDE's parameters on some poses, for use on others.

A fit looks at the first and the last pose, as every method does, and at its training poses. Its errors may be stated
on poses it has not looked at only (`fit_report.py`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture_eval.errors import InputError, SolverError
from capture_eval.evaluation.mode_statistics import ModeStatistics
from capture_eval.interpolation.dynamic_pde import DynamicPde
from capture_eval.interpolation.time_warps import BetaInterpolation, PowerInterpolation, TimeWarp
from capture_eval.interpolation.warps import CLOSURES, zero_mode_warp

Floats = NDArray[np.float64]

ORDERS = (1, 2, 3, 4, 5)
DAMPING_RANGE, MASS_RANGE = (-3.0, 8.0), (-3.0, 8.0)  # powers of ten of c/k and m/k
_GRID = 12  # values of each that are tried before the search
_STARTS = 2
_REFUSED = 1e300


@dataclass(frozen=True)
class Fit:
    """A fitted method.

    Attributes
    ----------
    method : DynamicPde, PowerInterpolation or BetaInterpolation
        With the parameters found.
    train_rms : float
        Root mean square error per point on the training poses, in the unit of the positions.
    """

    method: DynamicPde | PowerInterpolation | BetaInterpolation
    train_rms: float


def fit_dynamic_pde(
    statistics: Sequence[ModeStatistics],
    times: Floats,
    orders: Sequence[int] = ORDERS,
    closures: Sequence[str] = CLOSURES,
    starts: int = _STARTS,
) -> Fit:
    """The order, closure, damping and mass (rigidity 1) with the least squared error on the training poses.

    Every order and closure is tried on a grid of c/k and m/k and refined by Nelder and Mead's search from the best
    places of the grid. Parameters that are singular, or whose warps run backwards or past the end by more than 1 %,
    are refused. The free number η of the closure ``fit`` has its best value for every c/k and m/k in closed form.

    Parameters
    ----------
    statistics : sequence of ModeStatistics
        Of the curves that share the parameters.
    times : (T,)
        Of the training poses.
    orders, closures
        To be tried.
    starts : int
        Searches per order and closure.

    Raises
    ------
    InputError
        No statistics, or other times than they have.
    """
    _check(statistics, times)
    best: tuple[float, DynamicPde | None] = (_REFUSED, None)
    for order, closure in product(orders, closures):
        if order == 1 and closure == "stiff":
            candidates = [((0.0, 0.0), _pde_cost(statistics, times, 1, "stiff", (0.0, 0.0)))]  # no parameter matters
        else:
            candidates = _search(statistics, times, order, closure, starts)
        for place, cost in candidates:
            if cost < best[0]:
                best = cost, _pde(statistics, times, order, closure, place)
    if best[1] is None:
        raise SolverError("no parameters of the dynamic PDE that were tried have warps that rise")
    return Fit(best[1], _root_mean_square(best[0], statistics, times))


def fit_power(statistics: Sequence[ModeStatistics], times: Floats) -> Fit:
    """The real exponent p of t^p with the least squared error on the training poses."""
    from scipy.optimize import minimize_scalar

    _check(statistics, times)
    cost = _timing_cost(statistics, times, lambda x: PowerInterpolation(float(np.exp(x[0]))))
    found = minimize_scalar(
        lambda x: cost(np.array([x])), bounds=(-2.0, 2.5), method="bounded", options={"xatol": 1e-6}
    )
    return Fit(PowerInterpolation(float(np.exp(found.x))), _root_mean_square(float(found.fun), statistics, times))


def fit_beta(statistics: Sequence[ModeStatistics], times: Floats) -> Fit:
    """The two parameters of a Beta timing with the least squared error on the training poses."""
    from scipy.optimize import minimize

    _check(statistics, times)

    def method(x: Floats) -> BetaInterpolation:
        rise, settle = np.exp(np.clip(x, -3.0, 4.0)).tolist()
        return BetaInterpolation(rise, settle)

    cost = _timing_cost(statistics, times, method)
    found = minimize(cost, np.zeros(2), method="Nelder-Mead", options={"xatol": 1e-5, "fatol": 0.0, "maxiter": 300})
    return Fit(method(found.x), _root_mean_square(float(found.fun), statistics, times))


def _check(statistics: Sequence[ModeStatistics], times: Floats) -> None:
    if not statistics:
        raise InputError("a fit needs at least one curve")
    if len(times) == 0 or any(len(part.total) != len(times) for part in statistics):
        raise InputError(
            f"a fit of {len(times)} times to statistics of {[len(part.total) for part in statistics]} poses"
        )


def _root_mean_square(cost: float, statistics: Sequence[ModeStatistics], times: Floats) -> float:
    points = sum(part.points for part in statistics)
    return float(np.sqrt(max(cost, 0.0) / (points * len(times))))


def _timing_cost(
    statistics: Sequence[ModeStatistics], times: Floats, method: Callable[[Floats], TimeWarp]
) -> Callable[..., float]:
    def cost(x: Any) -> float:
        share = method(x).progress(times)
        return sum(part.cost(share, np.repeat(share[:, None], len(part.size) - 1, axis=1)) for part in statistics)

    return cost


def _pde(
    statistics: Sequence[ModeStatistics], times: Floats, order: int, closure: str, place: tuple[float, float]
) -> DynamicPde:
    method = DynamicPde(order, mass=10.0 ** place[1], damping=10.0 ** place[0], rigidity=1.0, closure=closure)
    return replace(method, closure_bend=_best_bend(statistics, times, method)) if closure == "fit" else method


def _best_bend(statistics: Sequence[ModeStatistics], times: Floats, method: DynamicPde) -> float:
    """η with the least squared error, ψ = t + η h: the errors are quadratic in it."""
    unit = 10.0 ** -round(method.order * max(0.0, np.log10(method.mass / method.damping)))  # h grows like (m/c)^R
    still = zero_mode_warp("fit", method.order, method.mass, method.damping, times, unit) - times
    along, squares = 0.0, 0.0
    for part in statistics:
        _, moving = method.mode_warps(part.point_count, part.closed, times)
        wanted = part.along[:, 0] - moving[:, : len(part.size) - 1] @ part.cross[1:] - times * part.size[0]
        along += float(still @ wanted)
        squares += float(still @ still) * float(part.size[0])
    return unit * along / squares if squares > 0 else 0.0


def _pde_cost(
    statistics: Sequence[ModeStatistics], times: Floats, order: int, closure: str, place: tuple[float, float]
) -> float:
    inside = all(low <= x <= high for x, (low, high) in zip(place, (DAMPING_RANGE, MASS_RANGE), strict=True))
    if not inside:
        return _REFUSED
    cost = 0.0
    moments = np.concatenate([times, _CHECKED])
    try:
        method = _pde(statistics, times, order, closure, place)
        for part in statistics:
            still, moving = method.mode_warps(part.point_count, part.closed, moments)
            warps = np.column_stack([still, moving])
            if warps.min() < -0.01 or warps.max() > 1.01:
                return _REFUSED
            cost += part.cost(still[: len(times)], moving[: len(times)])
    except SolverError:
        return _REFUSED
    return cost


_CHECKED = np.linspace(0.05, 0.95, 10)  # moments at which warps may not leave [0, 1]


def _search(
    statistics: Sequence[ModeStatistics], times: Floats, order: int, closure: str, starts: int
) -> list[tuple[tuple[float, float], float]]:
    from scipy.optimize import minimize

    def cost(x: Any) -> float:
        return _pde_cost(statistics, times, order, closure, (float(x[0]), float(x[1])))

    # for R = 2 with a closure that does not use m/c the mass drops out, and for R = 1 the damping does as well
    masses = np.linspace(*MASS_RANGE, _GRID) if order > 2 or closure not in ("stiff", "linear") else np.zeros(1)
    places = [list(place) for place in product(np.linspace(*DAMPING_RANGE, _GRID).tolist(), masses.tolist())]
    ranked = sorted(places, key=cost)[:starts]
    found = []
    for start in ranked:
        result = minimize(
            cost, np.array(start), method="Nelder-Mead", options={"xatol": 1e-3, "fatol": 0.0, "maxiter": 120}
        )
        found.append(((float(result.x[0]), float(result.x[1])), float(result.fun)))
    return found
