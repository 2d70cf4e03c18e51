"""Time of the evaluation: 49 curves × 9 in-between poses × every method, after imports.

    python benchmarks/interpolation.py

Curves are closed and open ones with the sizes of a face (12 to 125 points), moving on arcs; the peer in the same run
is a bare numpy loop over the same curves that only blends linearly and takes norms. CPU seconds, medians of 9.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable

import numpy as np

from capture_eval.curves.extract import Curve, CurveSet, extract_curves
from capture_eval.evaluation.error_table import evaluate_curves
from capture_eval.evaluation.summary import summarise
from capture_eval.interpolation.methods import create_methods

SIZES = [44] * 4 + [38] * 6 + [28] * 12 + [64, 52, 52, 42, 52, 50, 72, 104, 42, 12, 12]
OPEN_SIZES = [27, 27, 24, 24, 28, 65, 125, 65, 65, 27, 27, 31, 31, 27, 27, 103]
METHODS = [
    ("linear", {}),
    ("pde_linear", {}),
    ("pde_quadratic", {}),
    ("pde_cubic", {}),
    ("pde", {"order": 5, "damping": 20.0}),
    ("pde_causal", {"order": 1.6}),
    ("cosine", {}),
    ("power", {"exponent": 1.6}),
    ("beta", {}),
    ("monotone", {"times": [0.3, 0.7], "shares": [0.1, 0.8]}),
    ("pde_surface", {"harmonics": 12}),
]


def face_curves(poses: int) -> CurveSet:
    """49 curves on arcs in ``poses`` poses."""
    rng = np.random.default_rng(0)
    curves, first = [], 0
    for number, size in enumerate([*SIZES, *OPEN_SIZES]):
        curves.append(Curve(f"curve_{number + 1}", np.arange(first, first + size), number < len(SIZES)))
        first += size
    start = rng.normal(size=(first, 3))
    angle = np.deg2rad(25) * np.linspace(0, 1, poses)[:, None] * rng.random(first)
    turned = np.stack(
        [
            start[:, 0] * np.cos(angle) - start[:, 1] * np.sin(angle),
            start[:, 0] * np.sin(angle) + start[:, 1] * np.cos(angle),
            np.broadcast_to(start[:, 2], angle.shape),
        ],
        axis=-1,
    )
    return extract_curves(curves, turned)


def cpu_seconds(work: Callable[[], object], repeats: int = 9) -> float:
    """Median CPU time of a call."""
    taken = []
    for _ in range(repeats):
        begin = time.process_time()
        work()
        taken.append(time.process_time() - begin)
    return statistics.median(taken)


def bare_linear(curves: CurveSet, t: np.ndarray) -> None:
    """The least that must be done for one method: blend and measure."""
    for positions in curves.positions:
        share = t[1:-1, None, None]
        predicted = positions[0] + share * (positions[-1] - positions[0])
        errors = np.linalg.norm(predicted - positions[1:-1], axis=-1)
        errors.mean(axis=1)
        errors.max(axis=1)


def main() -> None:
    """Print the table."""
    t = np.linspace(0, 1, 11)
    curves = face_curves(11)
    peer = cpu_seconds(lambda: bare_linear(curves, t))
    print(f"49 curves, {sum(len(c.vertices) for c in curves.curves)} points, 9 in-between poses; CPU ms, median of 9\n")
    print("| what | ms | × bare linear |")
    print("| --- | ---: | ---: |")
    print(f"| bare numpy linear (peer) | {1e3 * peer:.1f} | 1.0 |")
    causal = create_methods([("pde_causal", {"order": 1.6})])
    begin = time.process_time()
    evaluate_curves(curves, t, causal, 2.0)
    first = time.process_time() - begin
    print(f"| PDE from rest, first time (its warps are kept) | {1e3 * first:.1f} | {first / peer:.1f} |")
    for identifier, options in METHODS:
        methods = create_methods([(identifier, options)])
        taken = cpu_seconds(lambda methods=methods: evaluate_curves(curves, t, methods, 2.0))
        print(f"| {next(iter(methods.values())).title} | {1e3 * taken:.1f} | {taken / peer:.1f} |")
    paper, everything = create_methods(METHODS[:4]), create_methods(METHODS)
    for name, methods in (("the paper's four methods", paper), ("all methods", everything)):
        taken = cpu_seconds(lambda methods=methods: evaluate_curves(curves, t, methods, 2.0))
        print(f"| {name} | {1e3 * taken:.1f} | {taken / peer:.1f} |")
    found = evaluate_curves(curves, t, everything, 2.0)
    ok = np.ones(11, dtype=bool)
    taken = cpu_seconds(lambda: summarise(found, curves, everything, 2.0, ok, "all"))
    print(f"| summary of all (warnings, timing and path) | {1e3 * taken:.1f} | {taken / peer:.1f} |")


if __name__ == "__main__":
    main()
