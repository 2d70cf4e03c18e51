"""Blendshapes against what the machine can do in the same run, and how their time grows.

    python benchmarks/blendshapes.py [--models 7775] [--vertices 5071] [--disk FOLDER]

The grid of five targets with six levels (7,775 models) of a face of 5,071 vertices is blended into memory and streamed
to disk, in single and double precision. Peers in the same run: a plain matrix product into preallocated memory, a
memcpy and a fill of the same bytes, and a sequential write of the same bytes. Rounds are interleaved and medians
given, so that other work on the machine hits all alike. Run it with OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1.
"""

from __future__ import annotations

import argparse
import os
import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from capture_eval.files.blend_files import write_shapes_npz
from capture_eval.interpolation.blendshapes import blend_basis, blend_blocks, blend_into, block_size
from capture_eval.interpolation.weight_grid import normalise_weights, weight_grid

PAPER = "72.7 s for 7,775 models in the paper (its laptop, its language: not like for like)"


def problem(models: int, vertices: int, targets: int, precision: str) -> tuple[np.ndarray, np.ndarray]:
    """Weights (K, J) and basis (J + 1, 3 V)."""
    rng = np.random.default_rng(0)
    shapes = rng.normal(size=(targets + 1, vertices, 3))
    if targets == 5:
        weights = normalise_weights(weight_grid([0, 0.2, 0.4, 0.6, 0.8, 1], 5), 5)
        weights = np.resize(weights, (models, 5))
    else:
        weights = normalise_weights(rng.random((models, targets)) + 1e-3, targets)
    return weights, blend_basis(shapes[0], list(shapes[1:]), precision)


def interleaved(
    works: dict[str, Callable[[], object]], rounds: int, before: Callable[[], object] = lambda: None
) -> dict[str, list[float]]:
    """Wall seconds of every work in every round, after one round that does not count; ``before`` each, uncounted."""
    taken: dict[str, list[float]] = {name: [] for name in works}
    for number in range(rounds + 1):
        for name, work in works.items():
            before()
            begin = time.perf_counter()
            work()
            if number:
                taken[name].append(time.perf_counter() - begin)
    return taken


def in_memory(models: int, vertices: int, rounds: int) -> None:
    """Table of the time to fill preallocated memory."""
    print(
        f"\n## {models} models × {vertices} vertices into preallocated memory, medians of {rounds} interleaved rounds\n"
    )
    print("| precision | what | ms | GB/s of output | × plain product |")
    print("| --- | --- | ---: | ---: | ---: |")
    for precision in ("float32", "float64"):
        weights, basis = problem(models, vertices, 5, precision)
        full = np.hstack([weights, np.ones((models, 1))]).astype(precision)
        out = np.zeros((models, vertices, 3), dtype=precision)
        other = np.zeros_like(out)
        flat = out.reshape(models, -1)
        works: dict[str, Callable[[], object]] = {
            "plain product": lambda a=full, b=basis, c=flat: np.matmul(a, b, out=c),
            "blend_into": lambda a=weights, b=basis, c=out: blend_into(a, b, c),
            "blend_blocks, nothing kept": lambda a=weights, b=basis: sum(1 for _ in blend_blocks(a, b)),
            "memcpy": lambda a=out, b=other: np.copyto(b, a),
            "fill": lambda b=other: b.fill(1.0),
        }
        taken = interleaved(works, rounds)
        plain = taken["plain product"]
        for name, values in taken.items():
            ratio = statistics.median(a / b for a, b in zip(values, plain, strict=True))
            middle = statistics.median(values)
            print(f"| {precision} | {name} | {1e3 * middle:.1f} | {out.nbytes / middle / 1e9:.2f} | {ratio:.2f} |")
        np.testing.assert_allclose(out[-1].ravel(), full[-1].astype(float) @ basis.astype(float), atol=1e-4)
    print(f"\n{PAPER}")


def sequential_write(path: Path, content: memoryview, step: int) -> None:
    """The disk's own rate: the same bytes out of memory, block after block, and on the disk at the end."""
    with open(path, "wb", buffering=0) as stream:
        for first in range(0, len(content), step):
            stream.write(content[first : first + step])
        os.fsync(stream.fileno())


def blended_write(path: Path, weights: np.ndarray, basis: np.ndarray) -> None:
    """The shapes made and written to one npz, and on the disk at the end."""
    shape = (len(weights), basis.shape[1] // 3, 3)
    write_shapes_npz(path, blend_blocks(weights, basis), shape, basis.dtype, {"weights": weights})
    with open(path, "rb") as stream:
        os.fsync(stream.fileno())


def to_disk(models: int, vertices: int, folder: Path, rounds: int) -> None:
    """Table of the time to stream all models to one npz.

    Every file is new: writing over an old one would give one side the memory and the blocks of the old file back.
    """
    print(f"\n## {models} models × {vertices} vertices to disk ({rounds} interleaved rounds, each ends on the disk)\n")
    print("| precision | what | s | MB/s | share of the disk's own rate (each round) |")
    print("| --- | --- | ---: | ---: | --- |")
    for precision in ("float32", "float64"):
        weights, basis = problem(models, vertices, 5, precision)
        finished = np.zeros((models, vertices, 3), dtype=precision)
        blend_into(weights, basis, finished)
        step = block_size(basis) * finished[0].nbytes
        target, plain = folder / "blend.npz", folder / "plain.bin"
        content = finished.reshape(-1).view(np.uint8).data
        works: dict[str, Callable[[], object]] = {
            "sequential write": lambda a=content, b=step, c=plain: sequential_write(c, a, b),
            "blended while written": lambda a=weights, b=basis, c=target: blended_write(c, a, b),
        }

        def fresh(files: tuple[Path, ...] = (target, plain)) -> None:
            for file in files:
                file.unlink(missing_ok=True)
            os.sync()

        taken = interleaved(works, rounds, fresh)
        fresh()
        own = taken["sequential write"]
        for name, values in taken.items():
            shares = [100 * b / a for a, b in zip(values, own, strict=True)]
            middle = statistics.median(values)
            listed = f"{statistics.median(shares):.0f} % ({', '.join(f'{share:.0f}' for share in shares)})"
            print(f"| {precision} | {name} | {middle:.2f} | {finished.nbytes / middle / 1e6:.0f} | {listed} |")


def growth(rounds: int) -> None:
    """Time over models, vertices and targets, with the exponent of the growth."""
    print("\n## Growth (double precision, into preallocated memory)\n")
    print("| over | sizes | ms | exponent | off a straight line at most |")
    print("| --- | --- | --- | ---: | ---: |")
    for name, sizes in (
        ("models", (500, 1000, 2000, 4000)),
        ("vertices", (1250, 2500, 5000, 10000)),
        ("targets", (5, 10, 20, 40)),
    ):
        works: dict[str, Callable[[], object]] = {}
        for size in sizes:
            chosen = {"models": 1000, "vertices": 5071, "targets": 5} | {name: size}
            weights, basis = problem(chosen["models"], chosen["vertices"], chosen["targets"], "float64")
            out = np.zeros((len(weights), chosen["vertices"], 3))
            works[str(size)] = lambda a=weights, b=basis, c=out: blend_into(a, b, c)
        middles = [statistics.median(values) for values in interleaved(works, rounds).values()]
        slope = np.polyfit(np.log(sizes), np.log(middles), 1)[0]
        line = np.polynomial.Polynomial.fit(sizes, middles, 1, w=1 / np.array(middles))
        off = 100 * np.max(np.abs(line(np.array(sizes)) / middles - 1))
        listed = ", ".join(f"{1e3 * value:.1f}" for value in middles)
        print(f"| {name} | {', '.join(map(str, sizes))} | {listed} | {slope:.2f} | {off:.0f} % |")


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--models", type=int, default=7775)
    parser.add_argument("--vertices", type=int, default=5071)
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument(
        "--disk", type=Path, default=None, help="folder on the disk to measure; a temporary one by default"
    )
    arguments = parser.parse_args()
    in_memory(arguments.models, arguments.vertices, arguments.rounds)
    with tempfile.TemporaryDirectory(dir=arguments.disk) as folder:
        to_disk(arguments.models, arguments.vertices, Path(folder), max(3, arguments.rounds // 3))
    growth(arguments.rounds)


if __name__ == "__main__":
    main()
