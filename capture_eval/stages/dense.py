"""Dense stereo of one pose: undistort, a depth map per photo, what the photos agree on as one cloud.

Depth maps come from pycolmap's CUDA stereo where there is one, else from the project's own CPU PatchMatch; both
leave COLMAP's depth and normal maps and ``fusion.cfg`` in the workspace, so COLMAP's fusion can go on from there.
"""

from __future__ import annotations

import logging
import shutil
import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture_eval.cameras import View, pixel_rays, project
from capture_eval.errors import InputError, ReconstructionError, ToolError
from capture_eval.files.atomic import read_json, write_json
from capture_eval.files.colmap_files import read_sparse_model
from capture_eval.files.colmap_workspace import (
    DenseWorkspace,
    map_path,
    read_colours,
    read_map,
    read_mask,
    read_workspace,
    write_fusion_configuration,
    write_map,
    write_mask,
)
from capture_eval.reconstruction.depth_filtering import DepthMap, FilterOptions, make_consistent
from capture_eval.reconstruction.foreground_mask import textured_region
from capture_eval.reconstruction.image_pyramid import Pyramid, StereoView, build_pyramid, level_count
from capture_eval.reconstruction.patch_match import PatchMatchOptions, match_view
from capture_eval.reconstruction.view_selection import choose_sources, depth_range, pair_scores
from capture_eval.stages.fusion import fuse_maps

logger = logging.getLogger("capture_eval.dense")

BACKENDS = ("auto", "cpu", "cuda")
FUSIONS = ("own", "colmap")
_CACHED_PHOTOS = 32
_CACHED_PIXELS = 50_000_000  # of all photos kept; a pyramid takes 17 bytes a pixel, a depth map with its worth 20


@dataclass(frozen=True)
class DenseOptions:
    """How the depth maps are made and fused.

    Attributes
    ----------
    backend : str
        `auto` (CUDA where pycolmap has it, else CPU), `cpu` or `cuda`.
    sources : int
        Photos each photo is compared with.
    neighbours : int
        Photos asked to confirm a depth.
    max_image_size : int
        Longer side of the undistorted photos in pixels, -1 for their own size.
    fusion : str
        `own` or `colmap` (pycolmap.stereo_fusion).
    point_spacing : float
        Distance of fused points in pixels of the photos (own fusion).
    minimum_pixels : int
        Photos that must see a point (pycolmap.stereo_fusion).
    most_deviation : float
        Points so many times more uncertain than the median are left out (own fusion).
    masks : Path or None
        Folder with `<photo name>.png` or `<photo stem>.png`; black is left out. Masks of a pose belong to the photos as
        taken, masks of a workspace to its undistorted photos.
    keep_maps : bool
        Keep depth and normal maps of a pose (5 bytes times 4 per pixel and photo).
    threads : int
        The result of the CPU backend does not depend on it.
    """

    backend: str = "auto"
    sources: int = 8
    neighbours: int = 10
    max_image_size: int = -1
    fusion: str = "own"
    point_spacing: float = 1.0
    minimum_pixels: int = 3
    most_deviation: float = 5.0
    masks: Path | None = None
    keep_maps: bool = False
    threads: int = 1
    stereo: PatchMatchOptions = field(default_factory=PatchMatchOptions)
    filter: FilterOptions = field(default_factory=FilterOptions)

    def __post_init__(self) -> None:
        if self.backend not in BACKENDS:
            raise InputError(f"dense backend '{self.backend}' is not known, choose one of {', '.join(BACKENDS)}")
        if self.fusion not in FUSIONS:
            raise InputError(f"fusion '{self.fusion}' is not known, choose one of {', '.join(FUSIONS)}")


def choose_backend(backend: str, has_cuda: bool) -> str:
    """`cpu` or `cuda`.

    Raises
    ------
    ToolError
        CUDA was asked for and pycolmap has none.
    """
    if backend == "cuda" and not has_cuda:
        raise ToolError(
            "dense backend cuda: this pycolmap was built without CUDA (install pycolmap-cuda12, or use cpu)"
        )
    return "cuda" if has_cuda and backend in ("auto", "cuda") else "cpu"


def reconstruct_dense(pose_folder: Path, options: DenseOptions) -> dict[str, Any]:
    """Dense cloud of a pose whose sparse model is solved.

    Reads ``sparse/`` and ``sparse.json`` (key `photo_folder`), writes ``dense/``, ``fused.ply`` and ``dense.json``.

    Returns
    -------
    dict
        The content of dense.json; status `ok`, `failed` (with a reason) or `skipped` (the sparse stage failed).
    """
    pose_folder = Path(pose_folder)
    sparse = read_json(pose_folder / "sparse.json")
    if sparse.get("status") != "ok":
        return _save(pose_folder, {"status": "skipped", "reason": "the sparse stage failed", "points": 0})
    start = time.process_time()
    photos = _photo_folder(pose_folder, sparse)
    workspace = pose_folder / "dense"
    _undistort(pose_folder / "sparse", photos, workspace, options)
    undistorted = time.process_time()
    stereo_options = options
    if options.masks is not None:
        _undistort_masks(pose_folder / "sparse", workspace, options.masks)
        stereo_options = replace(options, masks=workspace / "masks")
    try:
        result = dense_workspace(workspace, pose_folder / "fused.ply", stereo_options)
    except ReconstructionError as error:
        return _save(pose_folder, {"status": "failed", "reason": str(error), "points": 0})
    result["seconds"] = {"undistort": undistorted - start, **result["seconds"]}
    if not options.keep_maps:
        shutil.rmtree(workspace / "stereo", ignore_errors=True)
    logger.info("dense %s: %d points", pose_folder.name, result["points"])
    return _save(pose_folder, result)


def dense_workspace(folder: Path, fused: Path | None, options: DenseOptions) -> dict[str, Any]:
    """Depth and normal maps for every photo of a COLMAP workspace and, with `fused`, the cloud they agree on.

    Returns
    -------
    dict
        status, backend, points, seconds (CPU) of the steps and a row for every photo.

    Raises
    ------
    InputError
        The workspace is not usable; the text names the file.
    ReconstructionError
        No two photos share sparse points, or no point is confirmed by enough photos.
    """
    import pycolmap

    workspace = read_workspace(Path(folder))
    backend = choose_backend(options.backend, bool(pycolmap.has_cuda))
    start = time.process_time()
    names = [view.name for view in workspace.views]
    scores = pair_scores(np.array([view.center for view in workspace.views]), workspace.points, workspace.visible)
    partners = choose_sources(scores, max(options.sources, options.neighbours))
    if not any(len(row) for row in partners):
        raise ReconstructionError(f"{folder}: no two photos share sparse points, so nothing can be matched")
    if backend == "cuda":
        _cuda_maps(workspace, options)
    else:
        _cpu_maps(workspace, [row[: options.sources] for row in partners], options)
    matched = time.process_time()
    stage = "photometric" if backend == "cpu" else "geometric"
    rows = _filter_maps(workspace, [row[: options.neighbours] for row in partners], stage, options)
    write_fusion_configuration(workspace.folder, names)
    filtered = time.process_time()
    points = 0
    if fused is not None:
        points = fuse_maps(
            workspace, fused, options.fusion, options.point_spacing, options.minimum_pixels, options.most_deviation
        )
    seconds = {"stereo": matched - start, "filter": filtered - matched, "fusion": time.process_time() - filtered}
    return {"status": "ok", "backend": backend, "points": points, "seconds": seconds, "photos": rows}


def _save(pose_folder: Path, result: dict[str, Any]) -> dict[str, Any]:
    write_json(pose_folder / "dense.json", result)
    return result


def _photo_folder(pose_folder: Path, sparse: dict[str, Any]) -> Path:
    text = sparse.get("photo_folder")
    if not isinstance(text, str):
        raise InputError(f"{pose_folder / 'sparse.json'}: no 'photo_folder'; run the sparse stage again")
    folder = Path(text) if Path(text).is_absolute() else pose_folder / text
    if not folder.is_dir():
        raise InputError(f"{folder}: the photos of {pose_folder.name} are no longer there (sparse.json names them)")
    return folder


def _undistort(sparse: Path, photos: Path, workspace: Path, options: DenseOptions) -> None:
    import pycolmap

    shutil.rmtree(workspace, ignore_errors=True)
    camera_options = pycolmap.UndistortCameraOptions()
    camera_options.max_image_size = options.max_image_size
    pycolmap.logging.minloglevel = 2
    try:
        pycolmap.undistort_images(
            workspace, sparse, photos, undistort_options=camera_options, jpeg_quality=100, num_threads=options.threads
        )
    except (RuntimeError, ValueError) as error:
        raise ToolError(f"{photos}: the photos cannot be undistorted ({error})") from error


def _cuda_maps(workspace: DenseWorkspace, options: DenseOptions) -> None:
    import pycolmap

    settings = pycolmap.PatchMatchOptions()
    settings.geom_consistency = True
    settings.max_image_size = options.max_image_size
    pycolmap.patch_match_stereo(str(workspace.folder), options=settings)


def _kept_photos(workspace: DenseWorkspace) -> int:
    """How many photos (or maps) stay in memory: what bounds it, whatever their number and size."""
    largest = max(view.intrinsics.width * view.intrinsics.height for view in workspace.views)
    return int(np.clip(_CACHED_PIXELS // largest, 2, _CACHED_PHOTOS))


class _Photos:
    """Pyramids of the photos, the most recent ones kept."""

    def __init__(self, workspace: DenseWorkspace, options: DenseOptions) -> None:
        self._workspace = workspace
        self._options = options
        sizes = [(view.intrinsics.width, view.intrinsics.height) for view in workspace.views]
        self.levels = max(level_count(width, height) for width, height in sizes)
        self.pyramid = lru_cache(maxsize=_kept_photos(workspace))(self._load)

    def _load(self, index: int) -> Pyramid:
        view = self._workspace.views[index]
        colours = read_colours(self._workspace.image_path(index), view)
        # The mean of the channels has less noise than the luminance.
        grey = np.asarray(colours.mean(axis=2), dtype=np.float32)
        mask = textured_region(colours, self._options.stereo.window)
        given = _mask(self._options.masks, view)
        mask = mask if given is None else mask & given
        stereo_view = StereoView(view.name, grey, view.intrinsics.matrix, view.rotation, view.translation, mask)
        return build_pyramid(stereo_view, self.levels)


def _mask(folder: Path | None, view: View) -> NDArray[np.bool_] | None:
    if folder is None:
        return None
    for name in (f"{view.name}.png", f"{Path(view.name).with_suffix('')}.png"):
        if (folder / name).is_file():
            return read_mask(folder / name, view)
    return None


def _undistort_masks(sparse: Path, workspace: Path, masks: Path) -> None:
    """Bring the masks of photos as taken to the undistorted photos, into ``masks/`` of the workspace."""
    taken = read_sparse_model(sparse).views
    for straight in read_workspace(workspace).views:
        mask = _mask(masks, taken[straight.name])
        if mask is None:
            continue
        width, height = straight.intrinsics.width, straight.intrinsics.height
        columns, rows = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
        origin, rays = pixel_rays(straight, np.stack([columns.ravel(), rows.ravel()], axis=1))
        pixels = np.floor(project(taken[straight.name], origin + rays)[0]).astype(np.int64)
        inside = np.all((pixels >= 0) & (pixels < np.array(mask.shape[::-1])), axis=1)
        result = np.zeros(height * width, np.bool_)
        result[inside] = mask[pixels[inside, 1], pixels[inside, 0]]
        write_mask(workspace / "masks" / f"{straight.name}.png", result.reshape(height, width))


def _cpu_maps(workspace: DenseWorkspace, sources: Sequence[NDArray[np.int64]], options: DenseOptions) -> None:
    """Photometric maps of every photo by PatchMatch."""
    photos = _Photos(workspace, options)
    settings = replace(options.stereo, threads=options.threads)
    for index, view in enumerate(workspace.views):
        _, depths = project(view, workspace.points[workspace.visible[index]])
        shape = (view.intrinsics.height, view.intrinsics.width)
        if len(sources[index]) == 0 or not np.any(depths > 0):
            logger.warning("dense %s: %s shares no points with other photos", workspace.folder.parent.name, view.name)
            _write_maps(workspace, view.name, "photometric", np.zeros(shape), np.zeros((*shape, 3)))
            write_map(map_path(workspace.folder, "confidence", view.name, "photometric"), np.zeros((*shape, 2)))
            continue
        span = depth_range(depths, view.name)
        found = match_view(photos.pyramid(index), [photos.pyramid(int(k)) for k in sources[index]], span, settings)
        _write_maps(workspace, view.name, "photometric", found.depth, found.normal)
        confidence = np.stack([found.likeness, found.deviation], axis=2)
        write_map(map_path(workspace.folder, "confidence", view.name, "photometric"), confidence)
        logger.info("dense %s: %d/%d photos", workspace.folder.parent.name, index + 1, len(workspace.views))


def _write_maps(workspace: DenseWorkspace, name: str, stage: str, depth: NDArray[Any], normal: NDArray[Any]) -> None:
    write_map(map_path(workspace.folder, "depth", name, stage), depth)
    write_map(map_path(workspace.folder, "normal", name, stage), normal)


def _read_depth_map(workspace: DenseWorkspace, index: int, stage: str, options: DenseOptions) -> DepthMap:
    """A photometric map with its worth; maps of COLMAP's own stereo carry no confidence and count equally."""
    view = workspace.views[index]
    depth = read_map(map_path(workspace.folder, "depth", view.name, stage))
    normal = read_map(map_path(workspace.folder, "normal", view.name, stage))
    if stage == "photometric":
        confidence = read_map(map_path(workspace.folder, "confidence", view.name, stage))
        kept = (confidence[..., 0] >= options.filter.minimum_likeness) & (depth > 0)
        weight = np.where(kept, 1.0 / np.maximum(confidence[..., 1], 1e-12) ** 2, 0.0)
    else:
        kept = depth > 0
        weight = kept.astype(np.float64)
    return DepthMap(
        depth=np.where(kept, depth, 0).astype(np.float32),
        normal=normal,
        weight=weight.astype(np.float32),
        matrix=view.intrinsics.matrix,
        rotation=view.rotation,
        translation=view.translation,
    )


def _filter_maps(
    workspace: DenseWorkspace, neighbours: Sequence[NDArray[np.int64]], stage: str, options: DenseOptions
) -> list[dict[str, Any]]:
    """Geometric maps: what other photos confirm."""
    load = lru_cache(maxsize=_kept_photos(workspace))(lambda index: _read_depth_map(workspace, index, stage, options))
    rows = []
    # COLMAP's own maps are read until the last photo is done, so theirs are replaced only then.
    kept_under = "geometric" if stage == "photometric" else "filtered"
    for index, view in enumerate(workspace.views):
        reference = load(index)
        result = make_consistent(reference, [load(int(k)) for k in neighbours[index]], options.filter)
        _write_maps(workspace, view.name, kept_under, result.depth, result.normal)
        confidence = np.stack([result.weight, result.supporters.astype(np.float32), result.deviation], axis=2)
        write_map(map_path(workspace.folder, "confidence", view.name, "geometric"), confidence)
        found = int(np.count_nonzero(reference.depth))
        kept = int(np.count_nonzero(result.depth))
        rows.append(
            {
                "photo": view.name,
                "sources": len(neighbours[index]),
                "pixels": found,
                "kept_share": kept / max(found, 1),
                "supporters_median": float(np.median(result.supporters[result.depth > 0])) if kept else 0.0,
            }
        )
    if kept_under != "geometric":
        for view in workspace.views:
            for kind in ("depth", "normal"):
                source = map_path(workspace.folder, kind, view.name, kept_under)
                source.replace(map_path(workspace.folder, kind, view.name, "geometric"))
    return rows
