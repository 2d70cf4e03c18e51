"""Photograph a head with known truth: photos, cameras, true meshes, template, landmarks, curves, manifest."""

from __future__ import annotations

import hashlib
import json
import logging
import multiprocessing
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture_eval.cameras import View
from capture_eval.errors import InputError
from capture_eval.files.atomic import read_json, write_json, write_npz
from capture_eval.files.camera_files import write_cameras
from capture_eval.files.jpeg_files import PhotoTags, write_jpeg
from capture_eval.files.mesh_files import write_mesh
from capture_eval.images.camera_rig import intrinsics_for, place_cameras
from capture_eval.images.head import Head
from capture_eval.images.sensor import expose
from capture_eval.images.skin_shading import HeadModel, Lighting, build_head_model, light_head, photograph
from capture_eval.images.timing import parse_timing
from capture_eval.stages.capture_inputs import write_capture_inputs
from capture_eval.stages.synthesize_options import SynthesizeOptions
from capture_eval.triangle_geometry import diameter

FloatArray = NDArray[np.float64]
logger = logging.getLogger("capture_eval.synthesize")
# Raised whenever the same options give other pixels, so that half-finished captures are not mixed.
PICTURE_VERSION = 2
_STATE = "truth/state.json"


@dataclass(frozen=True)
class _PoseTask:
    """One pose's photos that are still to be made."""

    pose_index: int
    vertices: FloatArray
    folder: Path
    views: tuple[View, ...]
    view_numbers: tuple[int, ...]
    seed: int
    noise: float
    quality: int
    lighting: Lighting


def synthesize_capture(
    head: Head,
    template: Head,
    out: Path,
    options: SynthesizeOptions,
    cores: int = 1,
    progress: Callable[[int, int], None] | None = None,
) -> dict[str, Any]:
    """Write a capture folder with known truth.

    Photos that an interrupted call with the same options left are kept; the same options give the same bytes with any
    number of cores.

    Parameters
    ----------
    head
        The person in front of the cameras.
    template
        Another person with the same topology, handed on as the template mesh.
    out
        Capture folder.
    options
        What to photograph.
    cores
        Poses photographed at the same time.
    progress
        Called with the number of photos done and the number of all photos.

    Returns
    -------
    dict with `manifest` (path), `photos`, `kept` (photos that were there), `diameter_mm`.

    Raises
    ------
    InputError
        The head does not know the motion, template and head differ in topology, or an option makes no sense.
    """
    options.check()
    times = options.pose_times()
    amounts = parse_timing(options.timing)(np.array(times))
    _check_heads(head, template, options)
    posed = [head.pose(options.motion, float(amount)) for amount in amounts]
    vertices = [np.concatenate([skin, *parts]) for skin, parts in posed]
    truth = np.stack([skin for skin, _ in posed])
    pose_names = [f"pose_{number:02d}" for number in range(len(times))]
    intrinsics = intrinsics_for(options.width, options.height, options.distortion)
    aim = aim_point(truth[0])
    views_of_pose = {
        name: place_cameras(options.views, intrinsics, aim, options.seed, number)
        for number, name in enumerate(pose_names)
    }
    albedo = head.albedo(options.skin_texture_size(), options.skin)
    kept = _keep_state(out, _fingerprint(head, template, albedo, truth, options))
    model = build_head_model(head, albedo)
    tasks = [
        _pose_task(number, name, vertices[number], views_of_pose[name], out, options, kept)
        for number, name in enumerate(pose_names)
    ]
    total = options.views * len(times)
    missing = sum(len(task.views) for task in tasks)
    logger.info("%s: %d photos to make, %d are there", out, missing, total - missing)
    _photograph_all(model, [task for task in tasks if task.views], cores, total, total - missing, progress)
    _write_truth(out, head, options, times, amounts, truth, views_of_pose)
    write_capture_inputs(out, head, template, model, vertices[0], options, times, views_of_pose[pose_names[0]])
    return {
        "manifest": str(out / "manifest.yaml"),
        "photos": total,
        "kept": total - missing,
        "diameter_mm": diameter(truth[0]),
    }


def aim_point(skin: FloatArray) -> FloatArray:
    """Point the cameras look at: the middle of the head's height, 40 % of its depth behind the nose."""
    low, high = skin.min(axis=0), skin.max(axis=0)
    return np.array([0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1]), high[2] - 0.4 * (high[2] - low[2])])


def _check_heads(head: Head, template: Head, options: SynthesizeOptions) -> None:
    if options.motion not in head.motions:
        raise InputError(f"{head.name} has no motion {options.motion!r}; it has {', '.join(head.motions)}")
    if not np.array_equal(head.skin.face_vertices, template.skin.face_vertices):
        raise InputError(f"template {template.name} and head {head.name} have different faces")


def _fingerprint(
    head: Head, template: Head, albedo: NDArray[np.uint8], truth: FloatArray, options: SynthesizeOptions
) -> str:
    digest = hashlib.sha256()
    described = {"version": PICTURE_VERSION, "head": head.name, "template": template.name, **asdict(options)}
    if options.light_turn == 0.0:
        del described["light_turn"]  # photos made before there was such an option are the same
    digest.update(json.dumps(described, sort_keys=True).encode())
    for array in (albedo, truth, head.skin.face_vertices, template.skin.vertices):
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def _keep_state(out: Path, fingerprint: str) -> bool:
    """True when the folder holds photos of the same capture; those of another capture of ours are removed.

    The fingerprint is noted before the first photo, so that photos without one are somebody else's and are not touched.
    """
    state = out / _STATE
    if not state.is_file():
        if (out / "photos").exists():
            raise InputError(f"{out}: holds photos that synthesize did not make; choose another --out")
        write_json(state, {"fingerprint": fingerprint})
        return False
    try:
        content = read_json(state)
    except InputError:
        content = {}
    if isinstance(content, dict) and content.get("fingerprint") == fingerprint:
        return True
    stale = sorted((out / "photos").glob("pose_*/view_*.jpg"))
    logger.warning("%s: other options than before, %d photos are made anew", out, len(stale))
    for photo in stale:
        photo.unlink()
    for folder in (out / "photos").glob("pose_*"):
        if not any(folder.iterdir()):
            folder.rmdir()
    write_json(state, {"fingerprint": fingerprint})
    return False


def _pose_task(
    number: int,
    name: str,
    vertices: FloatArray,
    views: Sequence[View],
    out: Path,
    options: SynthesizeOptions,
    kept: bool,
) -> _PoseTask:
    folder = out / "photos" / name
    wanted = [k for k, view in enumerate(views) if not (kept and (folder / view.name).is_file())]
    return _PoseTask(
        number,
        vertices,
        folder,
        tuple(views[k] for k in wanted),
        tuple(wanted),
        options.seed,
        options.sensor_noise(),
        options.quality,
        Lighting().turned(options.light_turn * options.pose_times()[number]),
    )


_worker_model: HeadModel | None = None


def _start_worker(model: HeadModel) -> None:
    global _worker_model
    _worker_model = model


def _work(task: _PoseTask) -> int:
    if _worker_model is None:
        raise InputError("the photographer's worker was not started with a head")
    return _photograph_pose(_worker_model, task)


def _photograph_pose(model: HeadModel, task: _PoseTask, each: Callable[[], None] | None = None) -> int:
    lit = light_head(model, task.vertices, task.lighting)
    for number, view in zip(task.view_numbers, task.views, strict=True):
        light = photograph(lit, view)
        image = expose(light, task.noise, (task.seed, 303, task.pose_index, number))
        write_jpeg(task.folder / view.name, image, PhotoTags(float(view.intrinsics.matrix[0, 0])), task.quality)
        if each is not None:
            each()
    logger.info("%s: %d photos", task.folder.name, len(task.views))
    return len(task.views)


def _photograph_all(
    model: HeadModel,
    tasks: Sequence[_PoseTask],
    cores: int,
    total: int,
    done: int,
    progress: Callable[[int, int], None] | None,
) -> None:
    def advance(count: int = 1) -> None:
        nonlocal done
        done += count
        if progress is not None:
            progress(done, total)

    if progress is not None:
        progress(done, total)
    if min(cores, len(tasks)) <= 1:
        for task in tasks:
            _photograph_pose(model, task, advance)
        return
    # Fresh processes, because forking a process that has used Open3D's threads may hang.
    context = multiprocessing.get_context("spawn")
    workers = min(cores, len(tasks), os.cpu_count() or 1)
    with ProcessPoolExecutor(workers, context, _start_worker, (model,)) as pool:
        for future in as_completed([pool.submit(_work, task) for task in tasks]):
            advance(future.result())


def _write_truth(
    out: Path,
    head: Head,
    options: SynthesizeOptions,
    times: Sequence[float],
    amounts: FloatArray,
    truth: FloatArray,
    views_of_pose: dict[str, list[View]],
) -> None:
    write_cameras(out / "truth" / "cameras.json", views_of_pose)
    write_mesh(out / "truth" / "mesh.obj", head.skin.with_vertices(truth[0]))
    write_npz(out / "truth" / "truth.npz", {"t": np.array(times, dtype=np.float64), "vertices": truth})
    write_json(
        out / "truth" / "motion.json",
        {
            "head": head.name,
            "motion": options.motion,
            "timing": options.timing,
            "t": [float(t) for t in times],
            "amount": [float(amount) for amount in amounts],
            "diameter_mm": diameter(truth[0]),
            "unit": "mm",
            "seed": options.seed,
            "skin": options.skin,
            "noise_grey_levels": options.sensor_noise(),
            "light_turn_degrees": options.light_turn,
        },
    )
