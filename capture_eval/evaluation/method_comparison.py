"""Which of two methods is better, and whether these poses can tell: intervals, tests and verdicts for all pairs."""

from __future__ import annotations

from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture_eval.evaluation.error_table import ErrorTable
from capture_eval.evaluation.statistics import (
    CONFIDENCE,
    POWER,
    RESAMPLES,
    SEED,
    bootstrap_interval,
    bootstrap_maximum_interval,
    holm_correction,
    minimum_detectable_difference,
    sign_flip_test,
)

Floats = NDArray[np.float64]

SIGNIFICANCE = 1.0 - CONFIDENCE
CAVEAT = (
    "Poses of one movement of one subject are not independent samples of faces: intervals and tests say whether the "
    "order of the methods holds throughout this movement, and allow no claim about people."
)


def compare_methods(table: ErrorTable, noise_floor: float | None) -> dict[str, Any]:
    """Intervals of every method and a verdict for every pair, as plain values for ``summary.json``.

    Each in-between pose gives one number per method, the mean of E_A over its curves. A pair is compared on the poses
    and curves for which both have a value.

    Parameters
    ----------
    table : ErrorTable
        Errors as fractions of D.
    noise_floor : float, optional
        Mean E_A of what does not move.

    Returns
    -------
    dict
        ``methods``: mean E_A, LAE and LME with intervals by pose; ``pairs``: the first method against the second:
        difference of the means with interval, p, p after Holm's correction over all pairs of methods that differ,
        least detectable difference, and ``verdict`` ``better``, ``worse`` or ``not resolved`` with its reason
        (``equal``, ``few poses``, ``significance``, ``noise``).
    """
    methods = {name: _method(table, k) for k, name in enumerate(table.methods)}
    pairs = [_pair(table, a, b, noise_floor) for a, b in combinations(range(len(table.methods)), 2)]
    tested = _correct(pairs, table.methods)
    for pair in pairs:
        pair["verdict"], pair["reason"] = _verdict(pair, noise_floor, tested)
    return {
        "definition": "per in-between pose the mean over curves of E_A; pairs on the poses both methods have",
        "definition_of_largest": "LAE and LME: largest E_A and E_M of every pose, resampled by pose; no resample "
        "exceeds what was seen: an interval shows how far the figure hangs on single poses, not how large it may be",
        "confidence": CONFIDENCE,
        "power": POWER,
        "resamples": RESAMPLES,
        "seed": SEED,
        "noise_floor": noise_floor,
        "methods": methods,
        "pairs": pairs,
        "caveat": CAVEAT,
    }


def _correct(pairs: list[dict[str, Any]], methods: tuple[str, ...]) -> int:
    """Fill in p after Holm's correction; the number of tests it corrects for.

    A method that equals an earlier one is the same hypothesis again: only the earlier one is counted.
    """
    stands_for = {name: name for name in methods}
    for pair in pairs:
        if pair["equal"] and stands_for[pair["first"]] == pair["first"]:
            stands_for[pair["second"]] = pair["first"]
    counted = [
        pair
        for pair in pairs
        if pair["p"] is not None and not pair["equal"]
        and all(stands_for[pair[end]] == pair[end] for end in ("first", "second"))
    ]  # fmt: skip
    corrected = holm_correction([pair["p"] for pair in counted]).tolist()
    known = {frozenset((pair["first"], pair["second"])): value for pair, value in zip(counted, corrected, strict=True)}
    for pair in pairs:
        if pair["p"] is not None and not pair["equal"]:
            key = frozenset(stands_for[pair[end]] for end in ("first", "second"))
            pair["p_holm"] = known.get(key, min(1.0, pair["p"] * max(1, len(counted))))
    return len(counted)


def _method(table: ErrorTable, k: int) -> dict[str, Any]:
    values = _pose_means(table.average[k])
    found: dict[str, Any] = {"poses": len(values), "mean_E_A": float(values.mean()) if len(values) else None}
    intervals = {"interval": bootstrap_interval(values)}
    for name, errors in (("LAE", table.average[k]), ("LME", table.maximum[k])):
        known = np.isfinite(errors)
        largest = np.where(known, errors, 0.0).max(axis=0)[known.any(axis=0)]
        found[name] = float(largest.max()) if len(largest) else None
        intervals[f"{name}_interval"] = bootstrap_maximum_interval(largest)
    return found | {key: list(interval) if interval else None for key, interval in intervals.items()}


def _pose_means(values: Floats) -> Floats:
    """Mean over curves (N, T) → poses with any value."""
    known = np.isfinite(values)
    count = known.sum(axis=0)
    total = np.where(known, values, 0.0).sum(axis=0)
    result: Floats = total[count > 0] / count[count > 0]
    return result


def _pair(table: ErrorTable, a: int, b: int, noise_floor: float | None) -> dict[str, Any]:
    first, second = table.average[a], table.average[b]
    both = np.isfinite(first) & np.isfinite(second)
    means = [_pose_means(np.where(both, values, np.nan)) for values in (first, second)]
    differences = means[0] - means[1]
    interval = bootstrap_interval(differences)
    known = len(differences) > 0
    largest = float(np.max(np.abs(np.concatenate([first[both], second[both]])), initial=0.0))
    return {
        "first": table.methods[a],
        "second": table.methods[b],
        "poses": len(differences),
        "mean_first": float(means[0].mean()) if known else None,
        "mean_second": float(means[1].mean()) if known else None,
        "difference": float(differences.mean()) if known else None,
        "interval": list(interval) if interval else None,
        "equal": bool(np.all(np.abs(first - second)[both] <= 1e-9 * largest)) if known else False,
        "p": sign_flip_test(differences) if known else None,
        "p_holm": None,
        "smallest_p": 2.0 ** (1 - len(differences)) if known else None,
        "minimum_detectable": minimum_detectable_difference(differences, noise_floor),
    }


def _verdict(pair: dict[str, Any], noise_floor: float | None, tests: int) -> tuple[str, str | None]:
    if pair["p"] is None:
        return "not resolved", "few poses"
    if pair["equal"]:
        return "not resolved", "equal"
    if pair["p_holm"] > SIGNIFICANCE + 1e-12:
        # with so few poses no difference whatever could have passed the test
        return "not resolved", "few poses" if pair["smallest_p"] * tests > SIGNIFICANCE else "significance"
    if noise_floor is not None and abs(pair["difference"]) < noise_floor:
        return "not resolved", "noise"
    return ("better" if pair["difference"] < 0 else "worse"), None
