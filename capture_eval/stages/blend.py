"""Registered expressions to blended shapes on disk."""

from __future__ import annotations

import csv
import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from capture_eval.curves.edge_loops import edge_topology, maximal_loops
from capture_eval.curves.extract import Curve, resolve_curves
from capture_eval.errors import InputError
from capture_eval.files.atomic import read_npz
from capture_eval.files.blend_files import write_shapes_npz, write_shapes_obj
from capture_eval.files.curve_files import read_curves
from capture_eval.files.mesh_files import read_mesh
from capture_eval.interpolation.blendshapes import blend_basis, blend_blocks, expression_motion, vertices_on_curves
from capture_eval.interpolation.mesh_extension import Extension, MeshExtension
from capture_eval.interpolation.method import KeyPoseMethod
from capture_eval.interpolation.methods import create_method
from capture_eval.interpolation.weight_grid import check_weights, first_of_equals, normalise_weights, weight_grid
from capture_eval.polygon_mesh import PolygonMesh

logger = logging.getLogger("capture_eval.blend")

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class BlendOptions:
    """What to blend.

    Attributes
    ----------
    method, method_options
        Interpolation method of the motion from neutral to each target.
    t
        Moment of the motion, 1 is the target itself.
    weights
        Rows of one weight per target; empty for the grid of ``levels``.
    levels
        Levels of the grid of all combinations.
    free
        Take the weights as they are (Eq 36) instead of scaling every row to add up to 1 (Eq 38).
    distinct
        Leave out shapes whose weights are equal to those of an earlier one.
    extension
        How vertices on no curve follow.
    precision
        Of the positions in the result.
    """

    method: str = "pde_quadratic"
    method_options: Mapping[str, object] = field(default_factory=dict)
    t: float = 1.0
    weights: tuple[tuple[float, ...], ...] = ()
    levels: tuple[float, ...] = ()
    free: bool = False
    distinct: bool = False
    extension: Extension = "harmonic"
    precision: Literal["float32", "float64"] = "float64"


def blend_expressions(
    neutral: Path,
    targets: Sequence[Path],
    curves: Path | None,
    out: Path,
    options: BlendOptions,
    progress: Callable[[int, int], None] | None = None,
) -> dict[str, Any]:
    """Blend registered expressions and write the shapes while they are made.

    Parameters
    ----------
    neutral : Path
        Mesh (OBJ or PLY).
    targets : sequence of Path
        Meshes of the same topology, or npz files whose (V, 3) arrays are targets (one called ``neutral`` is not).
    curves : Path, optional
        Curves file; all edge loops of the mesh by default.
    out : Path
        ``.npz``: one file with vertices (K, V, 3), weights (K, J), targets, t and the faces. Else a folder of OBJ.
    options : BlendOptions
        Weights, method, moment.
    progress : callable, optional
        Called with (done, total).

    Returns
    -------
    dict
        targets, shapes, distinct, left_out, on_curves (share of the vertices).

    Raises
    ------
    InputError
        Files that are missing or do not fit one another; the text names them.
    """
    mesh = read_mesh(neutral)
    expressions = _read_targets(targets, mesh)
    if not 0.0 <= options.t <= 1.0:
        raise InputError(f"t = {options.t} must be in [0, 1]")
    rows, distinct = _weights(options, len(expressions))
    found = _curves(curves, mesh)
    on = vertices_on_curves(found, len(mesh.vertices))
    extension = MeshExtension(mesh.vertices, mesh.triangles()[0], on, options.extension)
    method = create_method(options.method, options.method_options)
    if isinstance(method, KeyPoseMethod) and method.key_times:
        raise InputError(f"method '{options.method}' needs key poses, which blending does not have")
    motions = [
        expression_motion(mesh.vertices, shape, found, method, options.t, extension) for shape in expressions.values()
    ]
    precision = np.dtype(options.precision)
    basis = blend_basis(mesh.vertices, motions, precision)
    result = {
        "targets": list(expressions),
        "shapes": len(rows),
        "distinct": distinct,
        "on_curves": float(on.mean()),
        "curves": len(found),
    }
    logger.info("%d shapes of %d targets at t = %g by %s", len(rows), len(expressions), options.t, method.title)
    blocks = blend_blocks(rows, basis)
    if out.suffix.lower() != ".npz":
        write_shapes_obj(out, blocks, mesh, len(rows), progress)
        _write_weights(out / "weights.csv", list(expressions), rows)
        return result
    arrays: dict[str, NDArray[Any]] = {
        "weights": rows,
        "targets": np.array(list(expressions)),
        "t": np.array(options.t),
        "face_offsets": mesh.face_offsets,
        "face_vertices": mesh.face_vertices,
    }
    write_shapes_npz(out, blocks, (len(rows), len(mesh.vertices), 3), precision, arrays, progress)
    return result


def read_weights(path: Path) -> tuple[tuple[float, ...], ...]:
    """Rows of weights from a CSV file; a first row of names is skipped.

    Raises
    ------
    InputError
        The file is missing, empty or holds something else than numbers; names the line.
    """
    try:
        lines = list(csv.reader(Path(path).read_text(encoding="utf-8").splitlines()))
    except (OSError, UnicodeDecodeError) as problem:
        raise InputError(f"{path}: cannot be read ({problem})") from problem
    rows = []
    for number, line in enumerate(lines, start=1):
        if not line:
            continue
        try:
            rows.append(tuple(float(cell) for cell in line))
        except ValueError as problem:
            if number > 1:
                raise InputError(f"{path}: line {number}: {problem}") from problem
    if not rows:
        raise InputError(f"{path}: no row of weights")
    for number, row in enumerate(rows):
        if len(row) != len(rows[0]):
            raise InputError(f"{path}: row {number + 1} has {len(row)} weights, the first {len(rows[0])}")
    return tuple(rows)


def _write_weights(path: Path, names: list[str], rows: Floats) -> None:
    from capture_eval.files.atomic import write_text

    lines = [",".join(names), *(",".join(map(repr, row)) for row in rows.tolist())]
    write_text(path, "\n".join(lines) + "\n")


def _weights(options: BlendOptions, targets: int) -> tuple[Floats, int]:
    """Weights as they are used, and how many of all of them are distinct."""
    if bool(options.weights) == bool(options.levels):
        raise InputError("give either weights or the levels of a grid")
    lengths = {len(row) for row in options.weights}
    if len(lengths) > 1 or (lengths and lengths != {targets}):
        raise InputError(f"rows of {sorted(lengths)} weights for {targets} targets; one weight per target is needed")
    rows = weight_grid(options.levels, targets) if options.levels else check_weights(options.weights, targets)
    if not options.free:
        rows = normalise_weights(rows, targets)
    first = first_of_equals(rows)
    return (rows[first] if options.distinct else rows), len(first)


def _read_targets(paths: Sequence[Path], mesh: PolygonMesh) -> dict[str, Floats]:
    found: dict[str, Floats] = {}
    for path in paths:
        if Path(path).suffix.lower() == ".npz":
            arrays = read_npz(path)
            shapes = {
                name: np.asarray(array, dtype=np.float64)
                for name, array in arrays.items()
                if array.shape == mesh.vertices.shape and name != "neutral"
            }
            if not shapes:
                raise InputError(f"{path}: no array of shape {mesh.vertices.shape}; it holds {', '.join(arrays)}")
        else:
            target = read_mesh(path)
            same = np.array_equal(target.face_vertices, mesh.face_vertices)
            if target.vertices.shape != mesh.vertices.shape or not same:
                raise InputError(f"{path}: not the topology of the neutral mesh ({len(mesh.vertices)} vertices)")
            shapes = {Path(path).stem: target.vertices}
        for name, shape in shapes.items():
            if name in found:
                raise InputError(f"{path}: target '{name}' is given twice")
            if not np.isfinite(shape).all():
                raise InputError(f"{path}: target '{name}' holds positions that are not finite")
            found[name] = shape
    if not found:
        raise InputError("no target expression is given")
    return found


def _curves(path: Path | None, mesh: PolygonMesh) -> tuple[Curve, ...]:
    topology = edge_topology(mesh)
    if path is not None:
        try:
            return resolve_curves(read_curves(path), topology)
        except InputError as problem:
            raise InputError(f"{path}: {problem}") from problem
    found = []
    for number, loop in enumerate(maximal_loops(topology)):
        simple = len(np.unique(loop.vertices)) == len(loop.vertices)
        if simple and len(loop.vertices) >= (3 if loop.closed else 2):
            found.append(Curve(f"edge loop {number + 1}", loop.vertices, loop.closed))
    return tuple(found)
