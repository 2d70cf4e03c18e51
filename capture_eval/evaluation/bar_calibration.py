"""Do error bars keep their promise? Shares of true errors inside, and the fit of a bar's parts to true errors."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture_eval.errors import InputError
from capture_eval.registration.error_bar import COVERAGE, BarModel, error_bar

Floats = NDArray[np.float64]
Booleans = NDArray[np.bool_]


def bar_coverage(error: Floats, bar: Floats, masks: Mapping[str, Booleans]) -> dict[str, dict[str, Any]]:
    """Share of true errors inside their bars, per group of vertices.

    Parameters
    ----------
    error, bar : (..., V) float64
        In one unit; NaN entries are no part of the count.
    masks : mapping of name to (V,) bool

    Returns
    -------
    dict
        Per name ``inside`` (None without any value), ``count``, ``bar_median`` and ``error_p95`` (same unit).

    Raises
    ------
    InputError
        Shapes differ.
    """
    if error.shape != bar.shape:
        raise InputError(f"calibration: errors {error.shape} and bars {bar.shape} differ")
    known = np.isfinite(error) & np.isfinite(bar)
    result: dict[str, dict[str, Any]] = {}
    for name, mask in masks.items():
        chosen = known & mask
        if not chosen.any():
            result[name] = {"inside": None, "count": 0, "bar_median": None, "error_p95": None}
            continue
        result[name] = {
            "inside": float(np.mean(error[chosen] <= bar[chosen])),
            "count": int(np.count_nonzero(chosen)),
            "bar_median": float(np.median(bar[chosen])),
            "error_p95": float(np.quantile(error[chosen], COVERAGE)),
        }
    return result


def fit_bar_model(error: Floats, spread: Floats, confidence: Floats, coverage: float = COVERAGE) -> BarModel:
    """Parts of the bar by quantile regression: least pinball loss of log(error / bar).

    Parameters
    ----------
    error, spread : (M,) float64
        Fractions of D.
    confidence : (M,) float64

    Raises
    ------
    InputError
        Fewer than 100 finite values.
    """
    from scipy.optimize import minimize

    known = np.isfinite(error) & np.isfinite(spread)
    if np.count_nonzero(known) < 100:
        raise InputError(f"calibration: {np.count_nonzero(known)} vertices with error and spread, 100 are needed")
    error, spread, confidence = error[known], spread[known], confidence[known]

    def loss(logarithms: Floats) -> float:
        bar = error_bar(spread, confidence, 1.0, BarModel(*np.exp(logarithms).tolist()))
        over = np.log((error + 1e-6) / bar)
        return float(np.mean(np.where(over > 0, coverage * over, (coverage - 1.0) * over)))

    starts = (np.log([8e-4, 3.0, 3e-3]), np.log([3e-4, 1.0, 1e-3]))
    options: Any = {"maxiter": 3000, "xatol": 1e-4, "fatol": 1e-7}
    found = [minimize(loss, start, method="Nelder-Mead", options=options) for start in starts]
    best = min(found, key=lambda result: float(result.fun))
    return BarModel(*np.exp(best.x).tolist())
