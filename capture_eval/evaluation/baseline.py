"""Comparison of a result with a baseline: what got worse, what went missing, which input is another."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

from capture_eval.errors import InputError

SCHEMA_VERSION = 1
Direction = Literal["lower", "higher"]


@dataclass(frozen=True)
class Metric:
    """A number with the direction that is good and what may be lost without alarm.

    Attributes
    ----------
    value : float or None
        None when the result has no such number.
    better : {'lower', 'higher'}
    relative, absolute : float
        It may get worse by ``absolute + relative * |baseline value|``.
    unit : str
        For reading.
    """

    value: float | None
    better: Direction = "lower"
    relative: float = 0.0
    absolute: float = 0.0
    unit: str = ""

    def __post_init__(self) -> None:
        if self.value is not None and not math.isfinite(self.value):
            object.__setattr__(self, "value", None)
        if self.better not in ("lower", "higher"):
            raise InputError(f"baseline: better is {self.better!r}; it must be lower or higher")
        if not (self.relative >= 0.0 and self.absolute >= 0.0):
            raise InputError(f"baseline: tolerances {self.relative:g}, {self.absolute:g} must not be negative")

    @property
    def allowance(self) -> float:
        """How much worse than this value a result may be."""
        return self.absolute + self.relative * abs(self.value or 0.0)


@dataclass(frozen=True)
class ResultRecord:
    """What a baseline remembers of a result.

    Attributes
    ----------
    name : str
        Name of the capture.
    metrics : mapping of name to Metric
    poses : mapping of pose to whether it was registered
    doubts : mapping of pose to why it should not be relied on; poses without doubts are not in it
    photos : mapping of pose to the number of photos that were used
    curves, methods : tuple of str
    inputs : mapping of relative path to SHA-256
    made_with : mapping of tool to version; for reading, not compared
    """

    name: str
    metrics: Mapping[str, Metric]
    poses: Mapping[str, bool] = field(default_factory=dict)
    photos: Mapping[str, int] = field(default_factory=dict)
    curves: tuple[str, ...] = ()
    methods: tuple[str, ...] = ()
    inputs: Mapping[str, str] = field(default_factory=dict)
    made_with: Mapping[str, str] = field(default_factory=dict)
    doubts: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Finding:
    """One line of the comparison.

    Attributes
    ----------
    what : str
        The metric, pose, curve, method or input.
    before, now : str
        Values as text.
    allowed : str
        The worst value that is still good.
    bad : bool
        Whether it makes the check fail.
    """

    what: str
    before: str
    now: str
    allowed: str
    bad: bool


def compare_with_baseline(result: ResultRecord, baseline: ResultRecord) -> list[Finding]:
    """All metrics side by side, and everything that went missing or changed.

    Parameters
    ----------
    result, baseline : ResultRecord
        Tolerances are those of the baseline.

    Returns
    -------
    list of Finding
        The bad ones first; nothing is left out.
    """
    findings = [_compare_metric(name, result.metrics.get(name), metric) for name, metric in baseline.metrics.items()]
    findings += [
        Finding(f"pose {name}", "registered", "failed" if name in result.poses else "missing", "registered", True)
        for name, good in baseline.poses.items()
        if good and not result.poses.get(name, False)
    ]
    findings += [
        Finding(f"pose {name}", "reliable", text, "reliable", True)
        for name, text in result.doubts.items()
        if name not in baseline.doubts
    ]
    for name, count in baseline.photos.items():
        found = result.photos.get(name, 0)
        if found < count:
            findings.append(Finding(f"photos of {name}", str(count), str(found), str(count), True))
    for kind, before, now in (
        ("curve", baseline.curves, result.curves),
        ("method", baseline.methods, result.methods),
    ):
        findings += [Finding(f"{kind} {name}", "there", "missing", "there", True) for name in before if name not in now]
    findings += _compare_inputs(result.inputs, baseline.inputs)
    return sorted(findings, key=lambda finding: not finding.bad)


def _compare_metric(name: str, now: Metric | None, baseline: Metric) -> Finding:
    before = baseline.value
    value = None if now is None else now.value
    if before is None:
        return Finding(name, "none", _text(value, baseline.unit), "any", False)
    sign = 1.0 if baseline.better == "lower" else -1.0
    limit = before + sign * baseline.allowance
    # a difference in the last bit is no loss, whatever tolerance is stated
    bad = value is None or sign * (value - limit) > 1e-12 * max(1.0, abs(before))
    return Finding(name, _text(before, baseline.unit), _text(value, baseline.unit), _text(limit, baseline.unit), bad)


def _compare_inputs(now: Mapping[str, str], before: Mapping[str, str]) -> list[Finding]:
    findings = []
    for name, digest in before.items():
        found = now.get(name)
        if found != digest:
            text = "missing" if found is None else f"{found[:12]}…"
            findings.append(Finding(f"input {name}", f"{digest[:12]}…", text, "the same file", True))
    findings += [
        Finding(f"input {name}", "none", f"{now[name][:12]}…", "any", False) for name in now if name not in before
    ]
    return findings


def _text(value: float | None, unit: str) -> str:
    if value is None:
        return "missing"
    if unit == "D":
        return f"{100.0 * value:.4f} % D"
    return f"{value:.6g} {unit}".rstrip()


def with_tolerances_of(record: ResultRecord, baseline: ResultRecord) -> ResultRecord:
    """A new record that keeps the tolerances a person has set in an earlier baseline."""
    metrics = {}
    for name, metric in record.metrics.items():
        old = baseline.metrics.get(name)
        if old is not None:
            metric = Metric(metric.value, old.better, old.relative, old.absolute, metric.unit)
        metrics[name] = metric
    return ResultRecord(
        record.name,
        metrics,
        record.poses,
        record.photos,
        record.curves,
        record.methods,
        record.inputs,
        record.made_with,
        record.doubts,
    )


def record_to_plain(record: ResultRecord) -> dict[str, Any]:
    """A record as JSON can hold it."""
    return {
        "schema_version": SCHEMA_VERSION,
        "name": record.name,
        "made_with": dict(record.made_with),
        "metrics": {name: vars(metric) for name, metric in record.metrics.items()},
        "poses": dict(record.poses),
        "photos": dict(record.photos),
        "curves": list(record.curves),
        "methods": list(record.methods),
        "inputs": dict(record.inputs),
        "doubts": dict(record.doubts),
    }


def record_from_plain(content: Any, source: str) -> ResultRecord:
    """The inverse of `record_to_plain`.

    Raises
    ------
    InputError
        The content is no baseline, or one of another schema; names the source.
    """
    version = content.get("schema_version") if isinstance(content, Mapping) else None
    if version != SCHEMA_VERSION:
        raise InputError(f"{source}: not a baseline of schema {SCHEMA_VERSION} (schema_version is {version!r})")
    try:
        metrics = {str(name): Metric(**fields) for name, fields in content["metrics"].items()}
        return ResultRecord(
            name=str(content["name"]),
            metrics=metrics,
            poses={str(name): bool(good) for name, good in content["poses"].items()},
            photos={str(name): int(count) for name, count in content["photos"].items()},
            curves=_names(content["curves"]),
            methods=_names(content["methods"]),
            inputs={str(name): str(digest) for name, digest in content["inputs"].items()},
            doubts={str(name): str(text) for name, text in content.get("doubts", {}).items()},
            made_with={str(name): str(value) for name, value in content.get("made_with", {}).items()},
        )
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(f"{source}: damaged baseline ({type(error).__name__}: {error})") from None


def _names(values: Sequence[object]) -> tuple[str, ...]:
    return tuple(str(value) for value in values)
