"""The curves file as a person writes it: a start edge with turns and a stop, or a plain list of vertices."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from capture_eval.curves.edge_loops import EdgeLoop, EdgeTopology, spoke, walk_edge_loop
from capture_eval.errors import InputError

_KNOWN = ("name", "start_edge", "turns", "turn_spokes", "stop", "vertices", "closed")


@dataclass(frozen=True)
class CurveSpecification:
    """One entry of the curves file.

    Parameters
    ----------
    name : str
        Unique in the file.
    start_edge : (int, int), optional
        First two vertices of an edge-loop walk.
    turns : mapping of vertex to next vertex
        Where the walk leaves the rule.
    turn_spokes : mapping of vertex to spoke number
        The same as a count of spokes from the incoming edge in face winding order.
    stop : int, optional
        Vertex at which the walk ends.
    vertices : tuple of int, optional
        The curve as a list, when it is no edge loop.
    closed : bool, optional
        Whether a listed curve closes; for a walk, what the result is checked against.
    extra : mapping
        Further keys (region, note, …), kept as they are.
    """

    name: str
    start_edge: tuple[int, int] | None = None
    turns: Mapping[int, int] = field(default_factory=dict)
    turn_spokes: Mapping[int, int] = field(default_factory=dict)
    stop: int | None = None
    vertices: tuple[int, ...] | None = None
    closed: bool | None = None
    extra: Mapping[str, object] = field(default_factory=dict)


def parse_curves(document: object, source: str) -> tuple[CurveSpecification, ...]:
    """Turn the loaded YAML or JSON of a curves file into specifications.

    Parameters
    ----------
    document : object
        A mapping with the list ``curves``; further keys at the top are ignored.
    source : str
        Name for messages, usually the file.

    Raises
    ------
    InputError
        Wrong structure, a curve without vertices or start edge, or two curves of one name; names the curve.
    """
    entries = document.get("curves") if isinstance(document, Mapping) else None
    if not isinstance(entries, Sequence) or isinstance(entries, str) or not entries:
        raise InputError(f"{source}: needs a key 'curves' with a list of at least one curve")
    specifications = tuple(_parse_one(entry, number, source) for number, entry in enumerate(entries))
    names = [specification.name for specification in specifications]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"{source}: two curves are called '{name}'")
    return specifications


def _parse_one(entry: object, number: int, source: str) -> CurveSpecification:
    if not isinstance(entry, Mapping):
        raise InputError(f"{source}: entry {number} under 'curves' is not a mapping with 'name'")
    name = entry.get("name")
    if not isinstance(name, str) or not name.strip():
        raise InputError(f"{source}: entry {number} under 'curves' has no 'name'")
    where = f"{source}: curve '{name}'"
    nested = entry.get("spec")
    if "vertices" not in entry and "start_edge" not in entry and isinstance(nested, Mapping):
        spokes = {"turn_spokes": nested.get("turns") or {}}
        kept = {key: value for key, value in entry.items() if key != "spec"}
        entry = {**kept, "start_edge": nested.get("start_edge"), "stop": nested.get("stop"), **spokes}
    has_list, has_walk = entry.get("vertices") is not None, entry.get("start_edge") is not None
    if has_list == has_walk:
        raise InputError(f"{where} needs either 'vertices' with 'closed' or 'start_edge', not both and not neither")
    closed = entry.get("closed")
    if closed is not None and not isinstance(closed, bool):
        raise InputError(f"{where}: 'closed' is {closed!r}, expected true or false")
    if has_list and closed is None:
        raise InputError(f"{where} lists vertices but does not say 'closed: true' or 'closed: false'")
    start = _indices(entry.get("start_edge"), f"{where}: 'start_edge'") if has_walk else None
    if start is not None and len(start) != 2:
        raise InputError(f"{where}: 'start_edge' has {len(start)} vertices, expected 2")
    stop = entry.get("stop")
    return CurveSpecification(
        name=name,
        start_edge=None if start is None else (start[0], start[1]),
        turns=_index_mapping(entry.get("turns"), f"{where}: 'turns'"),
        turn_spokes=_index_mapping(entry.get("turn_spokes"), f"{where}: 'turn_spokes'"),
        stop=None if stop is None else _index(stop, f"{where}: 'stop'"),
        vertices=_indices(entry["vertices"], f"{where}: 'vertices'") if has_list else None,
        closed=closed,
        extra={str(key): value for key, value in entry.items() if key not in _KNOWN},
    )


def _index(value: object, where: str) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or value < 0:
        raise InputError(f"{where}: {value!r} is not a vertex number (0, 1, 2, …)")
    return value


def _indices(value: object, where: str) -> tuple[int, ...]:
    if not isinstance(value, Sequence) or isinstance(value, str):
        raise InputError(f"{where}: expected a list of vertex numbers")
    return tuple(_index(item, where) for item in value)


def _index_mapping(value: object, where: str) -> dict[int, int]:
    """Vertex to number; JSON has only text keys, so digits are taken as numbers."""
    if value is None:
        return {}
    if not isinstance(value, Mapping):
        raise InputError(f"{where}: expected a mapping of vertex to vertex")
    digits = {int(key) if isinstance(key, str) and key.isdigit() else key: item for key, item in value.items()}
    return {_index(key, where): _index(item, where) for key, item in digits.items()}


def dump_curves(specifications: Sequence[CurveSpecification]) -> dict[str, object]:
    """Plain data of a curves file, the inverse of `parse_curves`; empty parts are left out."""
    return {"curves": [_dump_one(specification) for specification in specifications]}


def _dump_one(specification: CurveSpecification) -> dict[str, object]:
    entry: dict[str, object] = {"name": specification.name}
    if specification.start_edge is not None:
        entry["start_edge"] = list(specification.start_edge)
    if specification.turns:
        entry["turns"] = dict(specification.turns)
    if specification.turn_spokes:
        entry["turn_spokes"] = dict(specification.turn_spokes)
    if specification.stop is not None:
        entry["stop"] = specification.stop
    if specification.vertices is not None:
        entry["vertices"] = list(specification.vertices)
    if specification.closed is not None:
        entry["closed"] = specification.closed
    return {**entry, **specification.extra}


def resolve_curve(specification: CurveSpecification, topology: EdgeTopology) -> EdgeLoop:
    """The vertices of a specified curve on a mesh.

    Raises
    ------
    InputError
        The walk does not exist on this mesh, or closes where the file says it does not (or the reverse); the
        message names the curve.
    """
    if specification.vertices is not None:
        return EdgeLoop(np.array(specification.vertices, dtype=np.int64), bool(specification.closed))
    if specification.start_edge is None:
        raise InputError(f"curve '{specification.name}': neither vertices nor a start edge")
    try:
        loop = _walk_with_spokes(specification, specification.start_edge, topology)
    except InputError as problem:
        raise InputError(f"curve '{specification.name}': {problem}") from problem
    if specification.closed is not None and loop.closed != specification.closed:
        found, said = ("closes", "false") if loop.closed else ("does not close", "true")
        raise InputError(f"curve '{specification.name}': the loop {found}, but the file says 'closed: {said}'")
    return loop


def _walk_with_spokes(
    specification: CurveSpecification, start_edge: tuple[int, int], topology: EdgeTopology
) -> EdgeLoop:
    """Spoke numbers depend on where the walk comes from: resolve them one after the other as they are met."""
    turns = dict(specification.turns)
    open_spokes = dict(specification.turn_spokes)
    while open_spokes:
        walk = walk_edge_loop(topology, start_edge, turns, None).vertices.tolist()
        met = next((at for at, vertex in enumerate(walk[1:], 1) if vertex in open_spokes), None)
        if met is not None:
            before, vertex = walk[met - 1], walk[met]
        elif walk[0] in open_spokes and topology.has_edge(walk[-1], walk[0]):
            before, vertex = walk[-1], walk[0]
        else:
            raise InputError(f"the walk does not reach vertex {sorted(open_spokes)[0]}, at which it should turn")
        turns[vertex] = spoke(topology, before, vertex, open_spokes.pop(vertex))
    return walk_edge_loop(topology, start_edge, turns, specification.stop)
