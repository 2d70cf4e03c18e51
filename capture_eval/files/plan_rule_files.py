"""Wishes for a plan on disk (YAML): pairs, shapes left out or kept apart, contents of expressions, masked vertices."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from capture_eval.errors import InputError
from capture_eval.files.manifest_files import read_yaml

Names = tuple[str, ...]
_KEYS = ("pairs", "left_out", "never_together", "expressions", "masked_vertices")


@dataclass(frozen=True)
class NamedRules:
    """Wishes by names of shapes.

    Attributes
    ----------
    pairs, never_together : groups of names
    left_out : names
    include, exclude : mapping from expression (1, 2, …) to names
    masked_vertices : numbers of vertices
    """

    pairs: tuple[Names, ...] = ()
    left_out: Names = ()
    never_together: tuple[Names, ...] = ()
    include: Mapping[int, Names] = field(default_factory=dict)
    exclude: Mapping[int, Names] = field(default_factory=dict)
    masked_vertices: tuple[int, ...] = ()

    def joined(self, other: NamedRules) -> NamedRules:
        """The wishes of both."""
        return NamedRules(
            (*self.pairs, *other.pairs),
            (*self.left_out, *other.left_out),
            (*self.never_together, *other.never_together),
            _joined(self.include, other.include),
            _joined(self.exclude, other.exclude),
            (*self.masked_vertices, *other.masked_vertices),
        )


def read_plan_rules(path: Path) -> NamedRules:
    """Read wishes.

    Example::

        pairs: [[smile_left, smile_right]]
        left_out: [tongue_out]
        never_together: [[eye_look_in_left, eye_look_in_right]]
        expressions:
          1: {include: [jaw_open], exclude: [cheek_puff]}
        masked_vertices: [17, 18, 19]

    Raises
    ------
    InputError
        Not YAML, an unknown key, or a value of another kind; the text names the key.
    """
    document = read_yaml(path)
    if not isinstance(document, dict):
        raise InputError(f"{path}: expected a mapping with some of {', '.join(_KEYS)}")
    unknown = [str(key) for key in document if key not in _KEYS]
    if unknown:
        raise InputError(f"{path}: unknown key '{unknown[0]}'; there are {', '.join(_KEYS)}")
    include: dict[int, Names] = {}
    exclude: dict[int, Names] = {}
    expressions = document.get("expressions") or {}
    if not isinstance(expressions, dict):
        raise InputError(f"{path}: 'expressions' maps numbers to include and exclude")
    for number, wishes in expressions.items():
        where = f"expressions: {number}"
        if not isinstance(number, int) or not isinstance(wishes, dict) or set(wishes) - {"include", "exclude"}:
            raise InputError(f"{path}: '{where}' needs a whole number with include and exclude")
        include[number] = _names(path, wishes.get("include"), where)
        exclude[number] = _names(path, wishes.get("exclude"), where)
    masked = document.get("masked_vertices") or []
    if not isinstance(masked, list) or not all(isinstance(vertex, int) for vertex in masked):
        raise InputError(f"{path}: 'masked_vertices' is a list of whole numbers")
    return NamedRules(
        _groups(path, document.get("pairs"), "pairs"),
        _names(path, document.get("left_out"), "left_out"),
        _groups(path, document.get("never_together"), "never_together"),
        include,
        exclude,
        tuple(masked),
    )


def _names(path: Path, value: Any, key: str) -> Names:
    if value is None:
        return ()
    if not isinstance(value, list) or not all(isinstance(name, str) for name in value):
        raise InputError(f"{path}: '{key}' is a list of names of shapes")
    return tuple(value)


def _groups(path: Path, value: Any, key: str) -> tuple[Names, ...]:
    if value is None:
        return ()
    if not isinstance(value, list):
        raise InputError(f"{path}: '{key}' is a list of lists of names of shapes")
    return tuple(_names(path, group if group is not None else [], key) for group in value)


def _joined(first: Mapping[int, Names], second: Mapping[int, Names]) -> dict[int, Names]:
    return {number: (*first.get(number, ()), *second.get(number, ())) for number in sorted({*first, *second})}
