"""The verdict in words: which method is closest to the ground truth, by how much, and what may not be concluded."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from . import figure_style

ONE_SUBJECT = (
    "This is one subject and one movement: it allows no claim about people in general, nor about other movements."
)


@dataclass(frozen=True)
class MethodScore:
    """LAE and LME of one method as fractions of D; NaN when it has no value."""

    largest_average: float
    largest_maximum: float


@dataclass(frozen=True)
class NoiseFloor:
    """What curves show that do not move, as fractions of D: the mean, and the largest E_A and E_M."""

    mean: float
    largest_average: float
    largest_maximum: float


@dataclass(frozen=True)
class Verdict:
    """What the page says first.

    Attributes
    ----------
    headline
        One sentence.
    sentences
        By how much, in per cent of D.
    cautions
        What limits the conclusion.
    resolved
        Whether one method is best by more than the noise floor in both figures.
    """

    headline: str
    sentences: tuple[str, ...]
    cautions: tuple[str, ...]
    resolved: bool


def judge(
    scores: Mapping[str, MethodScore],
    noise_floor: NoiseFloor | None,
    failed_poses: Sequence[str] = (),
    pose_count: int = 0,
    key_times: Mapping[str, Sequence[float]] | None = None,
) -> Verdict:
    """Put the outcome in words.

    Two methods count as not resolved when their LAE differ by no more than the largest E_A of curves that do not
    move, or their LME by no more than the largest E_M of those curves.

    Parameters
    ----------
    scores
        LAE and LME by method, as fractions of D.
    noise_floor
        Errors of what does not move; None when they were not measured.
    failed_poses
        Names of poses without a result.
    pose_count
        Number of all poses.
    key_times
        Times of the in-between poses that a method was given, by method.
    """
    known = {
        name: score
        for name, score in scores.items()
        if math.isfinite(score.largest_average) and math.isfinite(score.largest_maximum)
    }
    cautions = _cautions(set(scores) - set(known), noise_floor, failed_poses, pose_count)
    if not known:
        return Verdict("No method could be evaluated.", (), cautions, False)
    labels = {name: style.label for name, style in figure_style.method_styles(list(known)).items()}
    cautions += _given_poses(labels, key_times or {})
    average = {name: score.largest_average for name, score in known.items()}
    maximum = {name: score.largest_maximum for name, score in known.items()}
    best_average, best_maximum = (
        _leaders(average, noise_floor.largest_average if noise_floor else 0.0),
        _leaders(maximum, noise_floor.largest_maximum if noise_floor else 0.0),
    )
    sentences = (
        _comparison("LAE (largest average error)", average, best_average, labels),
        _comparison("LME (largest maximum error)", maximum, best_maximum, labels),
    )
    if len(known) == 1:
        headline = f"{_capital(labels[best_average[0]])} is the only method that was evaluated."
        return Verdict(headline, sentences, cautions, False)
    headline, resolved = _headline(best_average, best_maximum, average, maximum, labels, noise_floor is not None)
    return Verdict(headline, sentences, cautions, resolved)


def _leaders(values: Mapping[str, float], floor: float) -> list[str]:
    """Return the methods that cannot be told from the best one, best first."""
    best = min(values.values())
    tolerance = max(floor, 1e-9 * abs(best))
    return [name for name, _ in sorted(values.items(), key=lambda item: item[1]) if values[name] - best <= tolerance]


def _headline(
    best_average: list[str],
    best_maximum: list[str],
    average: Mapping[str, float],
    maximum: Mapping[str, float],
    labels: Mapping[str, str],
    has_floor: bool,
) -> tuple[str, bool]:
    if set(best_average) == set(best_maximum):
        if len(best_average) == 1:
            return f"{_capital(labels[best_average[0]])} is closest to the ground truth.", True
        names = _join([labels[name] for name in average if name in best_average])
        if _equal(best_average, average) and _equal(best_maximum, maximum):
            return f"{_capital(names)} are closest to the ground truth and give the same errors.", False
        reason = "the noise floor" if has_floor else "rounding"
        return (
            f"{_capital(names)} are closest to the ground truth; the difference between them is below {reason} "
            "and is not resolved.",
            False,
        )
    common = [name for name in best_average if name in best_maximum]
    if common:
        names = _join([labels[name] for name in common])
        verb = "is" if len(common) == 1 else "are"
        return (
            f"{_capital(names)} {verb} closest to the ground truth, but only one of LAE and LME tells "
            f"{'it' if len(common) == 1 else 'them'} from the next method.",
            False,
        )
    by_average = _join([labels[name] for name in best_average])
    by_maximum = _join([labels[name] for name in best_maximum])
    return f"The two figures disagree: LAE is lowest for {by_average}, LME for {by_maximum}.", False


def _equal(names: Sequence[str], values: Mapping[str, float]) -> bool:
    chosen = [values[name] for name in names]
    return max(chosen) - min(chosen) <= 1e-9 * max(chosen)


def _comparison(figure: str, values: Mapping[str, float], leaders: Sequence[str], labels: Mapping[str, str]) -> str:
    best = values[leaders[0]]
    start = f"{figure} is {percent(best)} of D for {_join([labels[name] for name in values if name in leaders])}"
    if len(leaders) > 1 and not _equal(leaders, values):
        spread = max(values[name] for name in leaders)
        start = (
            f"{figure} is {percent(best)} to {percent(spread)} of D for "
            f"{_join([labels[name] for name in values if name in leaders])} (not resolved)"
        )
    others = [
        f"{labels[name]} has {percent(values[name])}{_ratio(values[name], best)}"
        for name in values
        if name not in leaders
    ]
    return f"{'; '.join([start, *others])}."


def _ratio(value: float, best: float) -> str:
    if best <= 0.0 or value / best > 1000.0:
        return ""
    return f", {value / best:.2f} times as much" if value / best < 10.0 else f", {value / best:.0f} times as much"


def _cautions(
    unknown: set[str], noise_floor: NoiseFloor | None, failed_poses: Sequence[str], pose_count: int
) -> tuple[str, ...]:
    lines = [ONE_SUBJECT]
    if noise_floor is not None:
        lines.append(
            f"Noise floor: curves that do not move show E_A of {percent(noise_floor.mean)} of D on average, "
            f"{percent(noise_floor.largest_average)} at most, and E_M of {percent(noise_floor.largest_maximum)} at "
            "most. It is never subtracted; LAE and LME that differ by less than these largest values are not resolved."
        )
    else:
        lines.append("No noise floor was measured: small differences may mean nothing.")
    if failed_poses:
        lines.append(
            f"{len(failed_poses)} of {pose_count} poses have no result and are not in these figures: "
            f"{_join(list(failed_poses))}."
        )
    if unknown:
        lines.append(f"No value for {_join(sorted(unknown))}.")
    return tuple(lines)


def _given_poses(labels: Mapping[str, str], key_times: Mapping[str, Sequence[float]]) -> tuple[str, ...]:
    """A caution when some methods knew poses between the ends that others had to predict."""
    given = {name: tuple(key_times[name]) for name in labels if key_times.get(name)}
    if not given or (len(given) == len(labels) and len(set(given.values())) == 1):
        return ()
    listed = _join([f"{labels[name]} (t = {', '.join(f'{t:g}' for t in times)})" for name, times in given.items()])
    return (
        f"Not like for like: {listed} {'was' if len(given) == 1 else 'were'} given in-between poses, which are not "
        "counted in the figures of that method; methods that know only the first and the last pose had to predict "
        "them all. Compare methods that were given the same poses.",
    )


def percent(fraction: float, digits: int = 3) -> str:
    """Format a fraction of D as per cent with a fixed number of decimals; an em dash when there is no value."""
    return f"{100.0 * fraction:.{digits}f}\N{NO-BREAK SPACE}%" if math.isfinite(fraction) else "—"


def _join(parts: Sequence[str]) -> str:
    if len(parts) < 2:
        return "".join(parts)
    return f"{', '.join(parts[:-1])} and {parts[-1]}"


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]
