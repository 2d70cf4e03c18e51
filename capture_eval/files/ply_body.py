"""The header and the body of a PLY file: elements with scalar and list properties, as columns of numbers."""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from capture_eval.errors import InputError

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

_TYPES = {
    "char": "i1",
    "int8": "i1",
    "uchar": "u1",
    "uint8": "u1",
    "short": "i2",
    "int16": "i2",
    "ushort": "u2",
    "uint16": "u2",
    "int": "i4",
    "int32": "i4",
    "uint": "u4",
    "uint32": "u4",
    "float": "f4",
    "float32": "f4",
    "double": "f8",
    "float64": "f8",
}
_BYTE_ORDER = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}


@dataclass(frozen=True)
class Property:
    """A property of an element; ``count_kind`` is set for lists."""

    name: str
    kind: str
    count_kind: str | None = None


@dataclass(frozen=True)
class Element:
    """An element of the header: its name, number of rows and properties in order."""

    name: str
    count: int
    properties: tuple[Property, ...]


@dataclass(frozen=True)
class ListColumn:
    """A list property of all rows: row i holds ``values[offsets[i]:offsets[i + 1]]``."""

    offsets: Integers
    values: Floats


Column = Floats | ListColumn


def read_header(path: Path) -> tuple[list[Element], str, bytes]:
    try:
        data = path.read_bytes()
    except OSError as problem:
        raise InputError(f"{path}: cannot be read ({problem.strerror or problem})") from problem
    if data[:3] != b"ply":
        raise InputError(f"{path}: not a PLY file (does not start with 'ply')")
    end = data.find(b"end_header")
    newline = data.find(b"\n", end)
    if end < 0 or newline < 0:
        raise InputError(f"{path}: cut off inside the header (no 'end_header')")
    order: str | None = None
    elements: list[Element] = []
    for line in data[:end].decode("ascii", errors="replace").splitlines()[1:]:
        words = line.split()
        try:
            if not words or words[0] in ("comment", "obj_info"):
                continue
            if words[0] == "format":
                order = _BYTE_ORDER[words[1]]
            elif words[0] == "element":
                elements.append(Element(words[1], int(words[2]), ()))
            elif words[0] == "property":
                last = elements[-1]
                elements[-1] = Element(last.name, last.count, (*last.properties, _property(words)))
        except (KeyError, IndexError, ValueError) as problem:
            raise InputError(f"{path}: header line not understood: '{line.strip()[:80]}'") from problem
    if order is None:
        raise InputError(f"{path}: header has no 'format' line")
    return elements, order, data[newline + 1 :]


def _property(words: list[str]) -> Property:
    if words[1] == "list":
        return Property(words[4], _TYPES[words[3]], _TYPES[words[2]])
    return Property(words[2], _TYPES[words[1]])


def read_ascii_body(path: Path, elements: Sequence[Element], body: bytes) -> dict[str, dict[str, Column]]:
    """Columns of every element of an ASCII body.

    Raises
    ------
    InputError
        The body is cut off or holds text that is not a number.
    """
    try:
        numbers = np.array([float(token) for token in body.split()], dtype=np.float64)
    except ValueError as problem:
        raise InputError(f"{path}: the body holds text that is not a number ({problem})") from problem
    columns: dict[str, dict[str, Column]] = {}
    position = 0
    for element in elements:
        widths = _first_row_widths(element, partial(_value_after, numbers, position))
        total = sum(widths) * element.count
        if element.count == 0:
            columns[element.name] = {}
            continue
        starts = np.concatenate([[0], np.cumsum(widths)]).astype(np.int64)
        rows = numbers[position : position + total]
        if len(rows) == total and _counts_agree(element, rows.reshape(element.count, -1), starts, widths):
            columns[element.name] = _columns_of_rows(element, rows.reshape(element.count, -1), starts)
            position += total
        else:
            columns[element.name], position = _ragged_ascii(path, element, numbers, position)
    return columns


def _value_after(numbers: Floats, start: int, at: int) -> int:
    """Number ``at`` places after ``start``; 0 beyond the end or where it is no length of a list."""
    place = start + at
    return int(numbers[place]) if place < len(numbers) and 0 <= numbers[place] < 1e6 else 0


def _first_row_widths(element: Element, value_at: Callable[[int], int]) -> list[int]:
    """Numbers that each property takes in the first row; a list takes one more than its length."""
    widths: list[int] = []
    for item in element.properties:
        widths.append(1 if item.count_kind is None else 1 + value_at(sum(widths)))
    return widths


def _counts_agree(element: Element, rows: Floats, starts: Integers, widths: Sequence[int]) -> bool:
    return all(
        item.count_kind is None or bool((rows[:, starts[i]] == widths[i] - 1).all())
        for i, item in enumerate(element.properties)
    )


def _columns_of_rows(element: Element, rows: Floats, starts: Integers) -> dict[str, Column]:
    columns: dict[str, Column] = {}
    for i, item in enumerate(element.properties):
        if item.count_kind is None:
            columns[item.name] = rows[:, starts[i]].copy()
        else:
            values = rows[:, starts[i] + 1 : starts[i + 1]]
            columns[item.name] = _equal_lists(values)
    return columns


def _equal_lists(values: Floats) -> ListColumn:
    offsets = np.arange(len(values) + 1, dtype=np.int64) * values.shape[1]
    return ListColumn(offsets, values.astype(np.float64).ravel())


def _ragged_ascii(path: Path, element: Element, numbers: Floats, position: int) -> tuple[dict[str, Column], int]:
    """Row by row, for elements whose lists differ in length."""
    gathered: dict[str, list[list[float]]] = {item.name: [] for item in element.properties}
    values = numbers[position:].tolist()
    at = 0
    for row in range(element.count):
        for item in element.properties:
            length = 1
            if item.count_kind is not None:
                length = int(values[at]) if at < len(values) else -1
                at += 1
            if length < 0 or at + length > len(values):
                raise InputError(f"{path}: cut off in row {row} of {element.count} of element '{element.name}'")
            gathered[item.name].append(values[at : at + length])
            at += length
    return _gathered_columns(element, gathered), position + at


def _gathered_columns(element: Element, gathered: Mapping[str, list[list[float]]]) -> dict[str, Column]:
    columns: dict[str, Column] = {}
    for item in element.properties:
        rows = gathered[item.name]
        flat = np.array([value for row in rows for value in row], dtype=np.float64)
        if item.count_kind is None:
            columns[item.name] = flat
        else:
            sizes = np.array([len(row) for row in rows], dtype=np.int64)
            columns[item.name] = ListColumn(np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64), flat)
    return columns


def read_binary_body(path: Path, elements: Sequence[Element], order: str, body: bytes) -> dict[str, dict[str, Column]]:
    """Columns of every element of a binary body; ``order`` is ``<`` or ``>``.

    Raises
    ------
    InputError
        The body is cut off.
    """
    columns: dict[str, dict[str, Column]] = {}
    position = 0
    for element in elements:
        if element.count == 0:
            columns[element.name] = {}
            continue
        layout = _first_row_layout(element, order, body, position)
        if layout is not None and position + layout.itemsize * element.count <= len(body):
            rows = np.frombuffer(body, dtype=layout, count=element.count, offset=position)
            if _lists_agree(element, rows):
                columns[element.name] = _columns_of_records(element, rows)
                position += layout.itemsize * element.count
                continue
        columns[element.name], position = _ragged_binary(path, element, order, body, position)
    return columns


def _first_row_layout(element: Element, order: str, body: bytes, position: int) -> np.dtype[np.void] | None:
    """Record layout with the list lengths of the first row; None when the body ends before."""
    fields: list[tuple[str, str] | tuple[str, str, tuple[int]]] = []
    at = position
    for i, item in enumerate(element.properties):
        length = 1
        if item.count_kind is not None:
            count_type = np.dtype(order + item.count_kind)
            if at + count_type.itemsize > len(body):
                return None
            length = int(np.frombuffer(body, count_type, 1, at)[0])
            fields.append((f"count{i}", order + item.count_kind))
            at += count_type.itemsize
            if length < 0 or length > len(body):
                return None
        fields.append((f"value{i}", order + item.kind, (length,)))
        at += length * np.dtype(item.kind).itemsize
    return np.dtype(fields)


def _lists_agree(element: Element, rows: NDArray[np.void]) -> bool:
    return all(
        item.count_kind is None or bool((rows[f"count{i}"] == rows[f"value{i}"].shape[1]).all())
        for i, item in enumerate(element.properties)
    )


def _columns_of_records(element: Element, rows: NDArray[np.void]) -> dict[str, Column]:
    columns: dict[str, Column] = {}
    for i, item in enumerate(element.properties):
        values = rows[f"value{i}"]
        if item.count_kind is None:
            columns[item.name] = values[:, 0].astype(np.float64)
        else:
            columns[item.name] = _equal_lists(values)
    return columns


def _ragged_binary(
    path: Path, element: Element, order: str, body: bytes, position: int
) -> tuple[dict[str, Column], int]:
    """Row by row, for elements whose lists differ in length."""
    codes = {"i1": "b", "u1": "B", "i2": "h", "u2": "H", "i4": "i", "u4": "I", "f4": "f", "f8": "d"}
    gathered: dict[str, list[list[float]]] = {item.name: [] for item in element.properties}
    at = position
    row = 0
    try:
        while row < element.count:
            for item in element.properties:
                length = 1
                if item.count_kind is not None:
                    (length,) = struct.unpack_from(order + codes[item.count_kind], body, at)
                    at += int(item.count_kind[1])
                gathered[item.name].append(list(struct.unpack_from(f"{order}{length}{codes[item.kind]}", body, at)))
                at += length * int(item.kind[1])
            row += 1
    except struct.error as problem:
        raise InputError(f"{path}: cut off in row {row} of {element.count} of element '{element.name}'") from problem
    return _gathered_columns(element, gathered), at
