"""Time of the evaluation: 49 curves × 9 in-between poses × every method, after imports.

    python benchmarks/interpolation.py [--large [FOLDER]]

Curves are closed and open ones with the sizes of a face (12 to 125 points), moving on arcs; the peer in the same run
is a bare numpy loop over the same curves that only blends linearly and takes norms. CPU seconds, medians of 9.
With --large instead: the whole evaluation stage, from file to files, on 1,000 poses of 100,085 vertices, and the most
memory it held (minutes; 9 GB of disk in FOLDER or the system's folder for temporary files).
"""

from __future__ import annotations

import argparse
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
import zipfile
from collections.abc import Callable
from pathlib import Path

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
    ("catmull_rom", {"times": [0.5]}),
    ("b_spline", {"times": [0.5]}),
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


def large_capture(folder: Path, poses: int = 1000, rings: int = 541, around: int = 185) -> None:
    """A tube as a registered capture: mesh, 49 curves (33 rings, 16 lines along it), positions and confidence."""
    from capture_eval.files.mesh_files import write_mesh
    from capture_eval.polygon_mesh import PolygonMesh

    index = np.arange(rings * around).reshape(rings, around)
    beside = np.roll(index, -1, axis=1)
    quads = np.stack([index[:-1], beside[:-1], beside[1:], index[1:]], axis=-1).reshape(-1, 4)
    angle, height = np.meshgrid(2 * np.pi * np.arange(around) / around, np.linspace(0, 3, rings))
    start = np.stack([np.cos(angle), np.sin(angle), height], axis=-1).reshape(-1, 3)
    write_mesh(folder / "template.obj", PolygonMesh.from_faces(start, quads))
    closed = {f"ring {n}": index[10 * n + 5] for n in range(33)}
    along = {f"line {n}": index[:around, 11 * n] for n in range(16)}
    rows = [
        f"- {{name: {name}, vertices: {vertices.tolist()}, closed: {str(name in closed).lower()}}}"
        for name, vertices in (closed | along).items()
    ]
    (folder / "curves.yaml").write_text("curves:\n" + "\n".join(rows) + "\n", encoding="utf-8")
    t, step = np.linspace(0, 1, poses), np.random.default_rng(0).normal(size=start.shape)
    (folder / "work" / "register").mkdir(parents=True)
    with zipfile.ZipFile(folder / "work" / "register" / "registered.npz", "w") as archive:
        for name, shape, make in (
            ("t", (poses,), lambda moment: np.array(moment)),
            ("vertices", (poses, *start.shape), lambda moment: (start + moment**2 * step).astype(np.float32)),
            ("confidence", (poses, len(start)), lambda moment: np.full(len(start), 0.5 + moment / 2)),
        ):
            header = {"descr": "<f8", "fortran_order": False, "shape": shape}
            with archive.open(f"{name}.npy", "w", force_zip64=True) as stream:
                np.lib.format.write_array_header_1_0(stream, header)
                for moment in t.tolist():
                    stream.write(make(moment).astype("<f8").tobytes())


def evaluate_large(folder: Path) -> None:
    """What `large` measures, in a process of its own."""
    from capture_eval.interpolation.methods import PAPER_METHODS
    from capture_eval.stages.evaluate import EvaluateOptions, evaluate_capture

    begin, wall = time.process_time(), time.perf_counter()
    methods = [(name, {}) for name in PAPER_METHODS]
    files = (folder / "work", folder / "template.obj", folder / "curves.yaml")
    summary = evaluate_capture(*files, methods, folder / "report", EvaluateOptions())
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e9
    written = sum(path.stat().st_size for path in (folder / "report").iterdir()) / 1e9
    points = summary["counts"]["points_used"]
    print(
        f"whole stage, {points} points on 49 curves, four methods: at most {most:.2f} GB held, "
        f"{time.process_time() - begin:.0f} CPU s ({time.perf_counter() - wall:.0f} s), {written:.2f} GB written"
    )


def large(parent: str | None) -> None:
    """Memory and time of the whole stage on a large capture."""
    with tempfile.TemporaryDirectory(dir=parent) as folder:
        large_capture(Path(folder))
        command = [sys.executable, __file__, "--child", folder]
        subprocess.run(command, check=True, env=os.environ | {"PYTHONWARNINGS": "error"})


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--large", nargs="?", const="", default=None, metavar="FOLDER")
    parser.add_argument("--child", type=Path, default=None, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.child is not None:
        evaluate_large(arguments.child)
    elif arguments.large is not None:
        large(arguments.large or None)
    else:
        small()


def small() -> None:
    """Table of 49 curves and 9 in-between poses."""
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
