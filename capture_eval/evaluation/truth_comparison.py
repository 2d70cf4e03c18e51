"""What evaluating photos says beside what evaluating the true meshes says (captures with known truth)."""

from __future__ import annotations

from typing import Any

import numpy as np

from capture_eval.errors import InputError
from capture_eval.evaluation.error_table import ErrorTable
from capture_eval.evaluation.summary import largest_errors


def compare_with_truth(photos: ErrorTable, truth: ErrorTable) -> dict[str, Any]:
    """Compare two error tables over the rows that have a value in both.

    Parameters
    ----------
    photos : ErrorTable
        Errors measured on registered meshes, as fractions of their D.
    truth : ErrorTable
        Errors of the same methods, curves and times on the true meshes with the same points counted.

    Returns
    -------
    dict
        Plain values: per method LME and LAE of both, their ratios (photos over truth), the largest difference of
        E_A and E_M and where it occurs; whether both order the methods alike.

    Raises
    ------
    InputError
        The tables are not of the same methods, curves and times.
    """
    if (photos.methods, photos.curves) != (truth.methods, truth.curves) or not np.array_equal(photos.t, truth.t):
        raise InputError("errors from photos and from truth are not of the same methods, curves and times")
    methods = {name: _compare_method(photos, truth, k, name) for k, name in enumerate(photos.methods)}
    return {
        "methods": methods,
        "order_LME": _orders(methods, "LME"),
        "order_LAE": _orders(methods, "LAE"),
    }


def _compare_method(photos: ErrorTable, truth: ErrorTable, k: int, name: str) -> dict[str, Any]:
    row: dict[str, Any] = {}
    from_photos, from_truth = largest_errors(photos, name), largest_errors(truth, name)
    for key in ("LME", "LAE"):
        a, b = from_photos[key], from_truth[key]
        row |= {f"{key}_photos": a, f"{key}_truth": b, f"{key}_ratio": None if a is None or not b else a / b}
    for key, one, other in (("E_A", photos.average, truth.average), ("E_M", photos.maximum, truth.maximum)):
        difference = np.abs(one[k] - other[k])
        if not np.isfinite(difference).any():
            row |= {f"largest_{key}_difference": None, f"largest_{key}_difference_at": None}
            continue
        n, i = np.unravel_index(int(np.nanargmax(difference)), difference.shape)
        row[f"largest_{key}_difference"] = float(difference[n, i])
        row[f"largest_{key}_difference_at"] = {"curve": photos.curves[n], "t": float(photos.t[i])}
    return row


def _orders(methods: dict[str, dict[str, Any]], key: str) -> dict[str, Any]:
    """Methods from best to worst; methods whose true errors agree to nine digits count as one place."""
    orders = {side: _order(methods, f"{key}_{side}") for side in ("photos", "truth")}
    place = {name: number for number, group in enumerate(_groups(methods, f"{key}_truth")) for name in group}
    places = [place[name] for name in orders["photos"] if name in place]
    same: bool | None = places == sorted(places) if orders["photos"] and orders["truth"] else None
    return {**orders, "same": same}


def _order(methods: dict[str, dict[str, Any]], key: str) -> list[str]:
    known = [name for name in methods if methods[name][key] is not None]
    return sorted(known, key=lambda name: (methods[name][key], name))


def _groups(methods: dict[str, dict[str, Any]], key: str) -> list[list[str]]:
    groups: list[list[str]] = []
    last = -np.inf
    for name in _order(methods, key):
        value = methods[name][key]
        if groups and value - last <= 1e-9 * abs(value):
            groups[-1].append(name)
        else:
            groups.append([name])
        last = value
    return groups
