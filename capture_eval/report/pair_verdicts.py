"""The comparison of methods in words: one sentence per pair, from the numbers in ``summary.json``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from capture_eval.report.tables import Cell, Table

_WHY = {
    "equal": "they give the same errors",
    "few poses": "so few poses cannot show a difference between so many methods",
    "significance": "the sign of the difference changes between poses too often",
    "noise": "the difference is below the noise floor of the ground truth",
}


def pair_sentence(pair: Mapping[str, Any], titles: Mapping[str, str]) -> str:
    """One pair in words, with the figures behind the verdict.

    Parameters
    ----------
    pair : mapping
        An entry of ``statistics.pairs`` of ``summary.json``.
    titles : mapping of method to str
        Names for reading.
    """
    first, second = (titles.get(pair[key], pair[key]) for key in ("first", "second"))
    if pair["difference"] is None:
        return f"{first} and {second}: not resolved; no pose has values of both."
    means = f"mean error {_percent(pair['mean_first'])} against {_percent(pair['mean_second'])} of D"
    if pair["verdict"] == "not resolved":
        text = f"{first} and {second}: not resolved, {_WHY[pair['reason']]} ({means}"
    else:
        text = f"{first} is {pair['verdict']} than {second} ({means}, difference {_percent(pair['difference'])}"
        if pair["interval"]:
            text += f", 95 % interval {_percent(pair['interval'][0])} to {_percent(pair['interval'][1])}"
    if pair["reason"] != "equal":
        text += f"; p = {pair['p_holm']:.2g} after Holm's correction, {pair['poses']} poses"
        if pair["minimum_detectable"] is not None:
            text += f"; differences from {_percent(pair['minimum_detectable'])} could be seen"
    return f"{text})."


def pair_table(statistics: Mapping[str, Any], titles: Mapping[str, str]) -> Table:
    """All pairs as a table.

    Parameters
    ----------
    statistics : mapping
        ``statistics`` of ``summary.json``.
    titles : mapping of method to str
        Names for reading.
    """
    rows: list[tuple[Cell, ...]] = []
    for pair in statistics["pairs"]:
        interval = pair["interval"] or (None, None)
        numbers = [pair["mean_first"], pair["mean_second"], pair["difference"], *interval, pair["minimum_detectable"]]
        rows.append(
            (
                titles.get(pair["first"], pair["first"]),
                f"{pair['verdict']}" + (f" ({pair['reason']})" if pair["reason"] else ""),
                titles.get(pair["second"], pair["second"]),
                *(None if value is None else 100.0 * value for value in numbers),
                pair["p_holm"],
            )
        )
    title = (
        "Every method against every other: per pose the mean E_A over the curves, in % of D; paired sign-flip test "
        "over poses with Holm's correction, bootstrap intervals by pose (95 %)."
    )
    header = ("method", "is", "than", "mean", "mean of other", "difference", "from", "to", "detectable", "p (Holm)")
    return Table(title, header, tuple(rows))


def _percent(value: float) -> str:
    return f"{100.0 * value:.3g} %"
