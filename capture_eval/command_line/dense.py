"""``capture-eval dense``: depth and normal maps for any COLMAP workspace, without a GPU."""

from __future__ import annotations

import logging
import sys
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer


class Backend(StrEnum):
    """Who makes the depth maps."""

    auto = "auto"
    cpu = "cpu"
    cuda = "cuda"


def dense(
    workspace: Annotated[
        Path, typer.Argument(help="Folder with images/ and sparse/ as COLMAP's image_undistorter leaves it.")
    ],
    backend: Annotated[Backend, typer.Option(help="auto takes CUDA where pycolmap has it.")] = Backend.auto,
    fused: Annotated[
        Path | None, typer.Option(help="Also write the points that the photos agree on to this PLY file.")
    ] = None,
    masks: Annotated[
        Path | None, typer.Option(help="Folder with NAME.png per photo; what is black is left out.")
    ] = None,
    sources: Annotated[int, typer.Option(min=1, max=64, help="Photos each photo is compared with.")] = 8,
    threads: Annotated[int, typer.Option(min=1, help="The result does not depend on it.")] = 1,
    seed: Annotated[int, typer.Option(min=0, help="Of the search's random numbers.")] = 0,
) -> None:
    """Dense stereo: a depth and a normal map for every photo of a COLMAP workspace, in COLMAP's files.

    Writes stereo/depth_maps, stereo/normal_maps (photometric and geometric) and stereo/fusion.cfg into the workspace,
    so that `colmap stereo_fusion` or pycolmap.stereo_fusion goes on from there.

    Example: capture-eval dense work/dense --threads 2 --fused fused.ply
    """
    from capture_eval.reconstruction.patch_match import PatchMatchOptions
    from capture_eval.stages.dense import DenseOptions, dense_workspace

    progress = logging.getLogger("capture_eval.dense")
    progress.setLevel(logging.INFO)
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(logging.Formatter("%(message)s"))
    progress.addHandler(handler)
    options = DenseOptions(
        backend=backend.value,
        sources=sources,
        masks=masks,
        threads=threads,
        stereo=PatchMatchOptions(seed=seed),
    )
    try:
        result = dense_workspace(workspace, fused, options)
    finally:
        progress.removeHandler(handler)
    kept = sum(row["kept_share"] for row in result["photos"]) / len(result["photos"])
    print(f"{len(result['photos'])} photos, {100 * kept:.1f} % of the depths confirmed by other photos")
    print(f"maps in {workspace / 'stereo'}" + (f", {result['points']} points in {fused}" if fused else ""))
