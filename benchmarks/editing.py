"""Time of one edit: coherency of the control points, weights by L-BFGS-B for pixels, and blending.

    python benchmarks/editing.py [--repeats 15] [--largest 100000]

Wall-clock milliseconds, medians, after one edit that compiles the loops; NUMBA_NUM_THREADS sets the cores (two were
used by the issue). The peer in the same run is the printed formula of Eqs 7 to 10 in plain numpy for given weights,
one control point after the other, called once. The paper reports under 0.1 s for up to 9,000 vertices and 20 control
points.

``from scratch`` knows only the examples; ``new target`` moves one control point again, as every mouse move does, and
reuses the coherency of the edit before.
"""

from __future__ import annotations

import argparse
import os
import statistics
import time
from collections.abc import Callable

os.environ.setdefault(
    "OPENBLAS_NUM_THREADS", "1"
)  # matrices of 24 x 24: threads of BLAS would only wait for each other

import numpy as np
from numpy.typing import NDArray

from capture_eval.cameras import Intrinsics, View
from capture_eval.editing.blend_weights import coupled_weights, invariant_system
from capture_eval.editing.coherency import coherent_motion
from capture_eval.editing.control_targets import ControlPoint
from capture_eval.editing.expression_editor import EditOptions, ExpressionEditor, scaled_targets
from capture_eval.editing.projection import Projection

Floats = NDArray[np.float64]

SIZES = ((5_000, 81, 3), (9_000, 192, 8), (9_000, 192, 20), (100_000, 192, 8))
PEER_LARGEST = 14_000_000  # numbers of the table N·M·L beyond which the peer is not waited for


def examples_like_a_face(vertices: int, meshes: int) -> Floats:
    """A ball of 250 mm whose patches move smoothly and differently in every mesh."""
    random = np.random.default_rng(0)
    neutral = random.normal(size=(vertices, 3))
    neutral *= 125.0 / np.linalg.norm(neutral, axis=1, keepdims=True)
    result = np.empty((meshes, vertices, 3))
    result[0] = neutral
    for row in range(1, meshes):
        centre = neutral[random.integers(vertices)]
        share = np.clip(1.0 - np.linalg.norm(neutral - centre, axis=1) / 90.0, 0.0, None) ** 2
        np.multiply(share[:, None], random.normal(scale=15.0, size=3), out=result[row])
        result[row] += neutral
    return result


def camera() -> Projection:
    """A picture of 1000 pixels' height."""
    matrix = np.array([[2800.0, 0.0, 400.0], [0.0, 2800.0, 500.0], [0.0, 0.0, 1.0]])
    lens = Intrinsics(800, 1000, matrix, np.zeros(4))
    return Projection.from_view(View("benchmark", lens, np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 900.0])))


def drags(examples: Floats, count: int, projection: Projection) -> list[ControlPoint]:
    """Control points at the front, each dragged to about where some mesh has it."""
    random = np.random.default_rng(1)
    front = np.flatnonzero(examples[0, :, 2] > 40.0)
    chosen = random.choice(front, count, replace=False)
    meshes = [int(np.argmax(np.linalg.norm(examples[:, v] - examples[0, v], axis=1))) for v in chosen]
    places = [projection.project(examples[m, v]) + 2.0 for v, m in zip(chosen, meshes, strict=True)]
    return [ControlPoint(int(v), tuple(place)) for v, place in zip(chosen, places, strict=True)]


def milliseconds(work: Callable[[], object], repeats: int) -> float:
    """Median wall-clock time of a call."""
    taken = []
    for _ in range(repeats):
        begin = time.perf_counter()
        work()
        taken.append(1e3 * (time.perf_counter() - begin))
    return statistics.median(taken)


def plain_numpy(examples: Floats, controls: list[int], weights: Floats) -> Floats:
    """Eqs 7, 8 and 10 as they are written, for given weights."""
    motion = examples[1:] - examples[0]
    lengths = np.linalg.norm(motion, axis=2)
    columns = []
    for control in controls:
        own, length = motion[:, control], lengths[:, control]
        with np.errstate(all="ignore"):
            product = lengths * length[:, None]
            r = 0.5 * (1.0 + np.einsum("mni,mi->mn", motion, own) / product)
            s = np.minimum(lengths / length[:, None], length[:, None] / lengths)
        consistency = np.where(product > 0, r * s, 1.0).mean(axis=0)
        distance = np.linalg.norm(examples[0] - examples[0, control], axis=1)
        columns.append((1.0 - distance / 250.0) * consistency)
    coherency = np.stack(columns, axis=1)
    shares = coherency / coherency.sum(axis=1, keepdims=True)
    return np.asarray(examples[0] + np.einsum("nl,lm,mni->ni", shares, weights, motion, optimize=True))


def measure(vertices: int, meshes: int, count: int, repeats: int) -> str:
    """One row of the table."""
    examples = examples_like_a_face(vertices, meshes)
    projection = camera()
    controls = drags(examples, count, projection)
    rows = [control.vertex for control in controls]
    editor = ExpressionEditor(examples)
    first = editor.edit(controls, projection)
    u, v = controls[0].target
    moved = [ControlPoint(rows[0], (u + 1.5, v - 1.0)), *controls[1:]]
    system = invariant_system(editor.motion.positions(rows))
    targets = scaled_targets(controls, projection, editor.motion.diameter, EditOptions())
    shares = first.influence[rows]
    whole = milliseconds(lambda: editor.edit(controls, projection), repeats)
    again = milliseconds(lambda: editor.edit(moved, projection, previous=first), repeats)
    solve = milliseconds(lambda: coupled_weights(system, targets, editor.options.balance, shares), repeats)
    free, vertices_in_use = first.weights[:, 1:], np.array(rows)
    coherent = milliseconds(lambda: coherent_motion(editor.motion, vertices_in_use, free, 2.0), repeats)
    known = {row: first.coherency[:, k] for k, row in enumerate(rows)}
    blending = milliseconds(lambda: coherent_motion(editor.motion, vertices_in_use, free, 2.0, known=known), repeats)
    peer = "–"
    if vertices * meshes * count <= PEER_LARGEST:
        taken = milliseconds(lambda: plain_numpy(examples, rows, first.weights[:, 1:]), 1)
        peer = f"{taken:.0f} ({taken / whole:.0f} ×)"
    cells = (f"{vertices:,}", meshes, count, f"{whole:.1f}", f"{again:.1f}", f"{solve:.1f}", f"{coherent:.1f}")
    return "| " + " | ".join(str(cell) for cell in (*cells, f"{blending:.1f}", peer)) + " |"


def main() -> None:
    """Print the table."""
    import numba

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=15)
    parser.add_argument("--largest", type=int, default=100_000, help="leave out sizes with more vertices")
    asked = parser.parse_args()
    repeats = asked.repeats
    print(f"one edit, wall-clock ms, median of {repeats}, {numba.get_num_threads()} threads\n")
    print("| N | M | L | from scratch | new target | weights | coherency and blend | blend alone | plain numpy |")
    print("| ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: |")
    for size in (size for size in SIZES if size[0] <= asked.largest):
        print(measure(*size, repeats), flush=True)


if __name__ == "__main__":
    main()
