"""Structure from motion of one pose: SIFT, exhaustive matching, incremental mapping (pycolmap, CPU).

With one thread and a fixed seed the result repeats bit for bit.
"""

from __future__ import annotations

import logging
import os
import shutil
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from capture_eval.cameras import Intrinsics, View
from capture_eval.errors import InputError, ReconstructionError
from capture_eval.files.atomic import write_json
from capture_eval.files.camera_files import read_cameras

if TYPE_CHECKING:
    import pycolmap

logger = logging.getLogger("capture_eval.sparse")

MINIMUM_PHOTOS = 3


@dataclass(frozen=True)
class SparseOptions:
    """How a pose is solved.

    Attributes
    ----------
    camera_model : str
        COLMAP camera model; SIMPLE_RADIAL has one focal length and one distortion term.
    peak_threshold : float
        Contrast below which a SIFT extremum is dropped. COLMAP's own .0067 leaves too few points on skin.
    share_intrinsics : bool
        One camera for all photos of the pose (photos of different sizes always get their own).
    intrinsics : Intrinsics or None
        Known camera: its model becomes OPENCV and it is kept fixed.
    known_cameras : Path or None
        cameras.json with known poses: the mapper is skipped and points are triangulated.
    masks : Path or None
        Folder with `<photo name>.png` or `<photo stem>.png`; black pixels carry no features.
    minimum_registered_share : float
        Fewer registered photos than this share of all photos make the pose a failed one.
    """

    camera_model: str = "SIMPLE_RADIAL"
    peak_threshold: float = 0.002
    max_features: int = 8192
    share_intrinsics: bool = True
    intrinsics: Intrinsics | None = None
    known_cameras: Path | None = None
    masks: Path | None = None
    minimum_registered_share: float = 0.6
    threads: int = 1
    seed: int = 0


def reconstruct_sparse(photos: Sequence[Path], pose_folder: Path, options: SparseOptions) -> dict[str, Any]:
    """Solve the cameras of one pose and write `database.db`, `sparse/` and `sparse.json` into its folder.

    Parameters
    ----------
    photos : sequence of Path
        Photos of the pose, all in one folder.
    pose_folder : Path
        Folder of the pose in the work directory; its name is the name of the pose.

    Returns
    -------
    dict
        The content of sparse.json: status `ok` or `failed` with a reason, the share of registered photos,
        mean reprojection error in pixels, mean track length, points, and a row for every photo.

    Raises
    ------
    InputError
        When photos lie in different folders, share a name, or a mask has another size than its photo.
    """
    started = time.perf_counter(), time.process_time()
    folder = _common_folder(photos)
    pose_folder.mkdir(parents=True, exist_ok=True)
    _remove_previous(pose_folder)
    sizes, faults = _photo_sizes(photos)
    usable = sorted(sizes)
    quality: dict[str, Any] = {"status": "failed", "reason": "", "photo_folder": str(folder.resolve())}
    reconstruction = None
    try:
        if len(usable) < MINIMUM_PHOTOS:
            raise ReconstructionError(
                f"{pose_folder.name}: {len(usable)} readable photos; at least {MINIMUM_PHOTOS} are needed"
            )
        reconstruction = _solve(folder, sizes, pose_folder, options)
    except ReconstructionError as error:
        quality["reason"] = str(error)
    quality |= _model_quality(reconstruction, [path.name for path in photos], faults)
    if reconstruction is not None:
        quality |= _judge(quality, pose_folder.name, options)
        _write_model(reconstruction, pose_folder / "sparse")
    quality["threads"] = options.threads
    quality["repeatable"] = options.threads == 1
    quality["seconds"] = round(time.perf_counter() - started[0], 3)
    quality["cpu_seconds"] = round(time.process_time() - started[1], 3)
    write_json(pose_folder / "sparse.json", quality)
    logger.info("sparse %s: %s, %d/%d photos", pose_folder.name, quality["status"], quality["registered"], len(photos))
    return quality


def _common_folder(photos: Sequence[Path]) -> Path:
    if not photos:
        raise InputError("no photos given; a pose needs a folder with photos")
    folders = {path.parent for path in photos}
    if len(folders) > 1:
        raise InputError(f"photos of one pose lie in {len(folders)} folders: {', '.join(map(str, sorted(folders)))}")
    names = [path.name for path in photos]
    if len(set(names)) < len(names):
        raise InputError(f"{photos[0].parent}: a photo is listed twice")
    return folders.pop()


def _remove_previous(pose_folder: Path) -> None:
    (pose_folder / "sparse.json").unlink(missing_ok=True)
    for pattern in ("database.db*", "database.partial.db*"):
        for path in pose_folder.glob(pattern):
            path.unlink()
    for name in ("sparse", "sparse.partial"):
        shutil.rmtree(pose_folder / name, ignore_errors=True)


def _photo_sizes(photos: Sequence[Path]) -> tuple[dict[str, tuple[int, int]], dict[str, str]]:
    """Width and height of every photo that decodes, and the fault of every photo that does not."""
    from PIL import Image

    sizes: dict[str, tuple[int, int]] = {}
    faults: dict[str, str] = {}
    for path in photos:
        try:
            with Image.open(path) as image:
                image.load()
                sizes[path.name] = image.size
        except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
            faults[path.name] = f"unreadable: {error}"
    return sizes, faults


def _solve(
    folder: Path, sizes: dict[str, tuple[int, int]], pose_folder: Path, options: SparseOptions
) -> pycolmap.Reconstruction:
    import pycolmap

    pycolmap.logging.minloglevel = 2
    pycolmap.set_random_seed(options.seed)
    known = None
    if options.known_cameras is not None:
        poses = read_cameras(options.known_cameras)
        if pose_folder.name not in poses:
            raise InputError(f"{options.known_cameras}: no camera of {pose_folder.name}")
        known = {view.name: view for view in poses[pose_folder.name]}
    database = pose_folder / "database.partial.db"
    logger.info("sparse %s: features of %d photos", pose_folder.name, len(sizes))
    _extract(database, folder, sizes, known, options, pose_folder)
    logger.info("sparse %s: matching %d pairs", pose_folder.name, len(sizes) * (len(sizes) - 1) // 2)
    matching = pycolmap.FeatureMatchingOptions()
    matching.num_threads = options.threads
    verification = pycolmap.TwoViewGeometryOptions()
    verification.ransac.random_seed = options.seed
    pycolmap.match_exhaustive(
        str(database),
        matching_options=matching,
        verification_options=verification,
        device=pycolmap.Device.cpu,
    )
    logger.info("sparse %s: mapping", pose_folder.name)
    if known is None:
        model = _map_incrementally(database, folder, pose_folder, options)
    else:
        model = _triangulate(database, folder, pose_folder, known, options)
    os.replace(database, pose_folder / "database.db")
    return model


def _extract(
    database: Path,
    folder: Path,
    sizes: dict[str, tuple[int, int]],
    known: dict[str, View] | None,
    options: SparseOptions,
    pose_folder: Path,
) -> None:
    import pycolmap

    reader = pycolmap.ImageReaderOptions()
    reader.camera_model = options.camera_model
    if known is not None:
        reader.camera_model = "OPENCV"
    elif options.intrinsics is not None:
        reader.camera_model = "OPENCV"
        reader.camera_params = ",".join(repr(float(v)) for v in opencv_parameters(options.intrinsics))
    mask_folder = None
    if options.masks is not None:
        mask_folder = _collect_masks(options.masks, sizes, pose_folder / "masks.partial")
        reader.mask_path = str(mask_folder)
    extraction = pycolmap.FeatureExtractionOptions()
    extraction.num_threads = options.threads
    extraction.sift.peak_threshold = options.peak_threshold
    extraction.sift.max_num_features = options.max_features
    one_camera = options.share_intrinsics and known is None and len(set(sizes.values())) == 1
    try:
        pycolmap.extract_features(
            str(database),
            str(folder),
            image_names=sorted(sizes),
            camera_mode=pycolmap.CameraMode.SINGLE if one_camera else pycolmap.CameraMode.PER_IMAGE,
            reader_options=reader,
            extraction_options=extraction,
            device=pycolmap.Device.cpu,
        )
    finally:
        if mask_folder is not None:
            shutil.rmtree(mask_folder, ignore_errors=True)


def _collect_masks(masks: Path, sizes: dict[str, tuple[int, int]], target: Path) -> Path:
    """Masks under the names COLMAP expects; a photo without a mask is used whole."""
    from PIL import Image

    target.mkdir(parents=True, exist_ok=True)
    for name, size in sizes.items():
        candidates = [masks / f"{name}.png", masks / f"{Path(name).stem}.png"]
        found = next((path for path in candidates if path.is_file()), None)
        if found is None:
            continue
        with Image.open(found) as image:
            if image.size != size:
                raise InputError(f"{found}: mask is {image.size[0]}x{image.size[1]}, its photo {size[0]}x{size[1]}")
        shutil.copyfile(found, target / f"{name}.png")
    return target


def opencv_parameters(intrinsics: Intrinsics) -> list[float]:
    """COLMAP OPENCV parameters fx, fy, cx, cy, k1, k2, p1, p2."""
    matrix = intrinsics.matrix
    return [matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2], *map(float, intrinsics.distortion)]


def _pipeline_options(options: SparseOptions) -> pycolmap.IncrementalPipelineOptions:
    import pycolmap

    pipeline = pycolmap.IncrementalPipelineOptions()
    pipeline.num_threads = options.threads
    pipeline.random_seed = options.seed
    pipeline.mapper.num_threads = options.threads
    pipeline.mapper.random_seed = options.seed
    pipeline.triangulation.random_seed = options.seed
    pipeline.min_model_size = MINIMUM_PHOTOS
    if options.intrinsics is not None:
        pipeline.ba_refine_focal_length = False
        pipeline.ba_refine_extra_params = False
        pipeline.mapper.abs_pose_refine_focal_length = False
        pipeline.mapper.abs_pose_refine_extra_params = False
    return pipeline


def _map_incrementally(
    database: Path, folder: Path, pose_folder: Path, options: SparseOptions
) -> pycolmap.Reconstruction:
    import pycolmap

    output = pose_folder / "sparse.partial"
    output.mkdir(parents=True, exist_ok=True)
    models = pycolmap.incremental_mapping(str(database), str(folder), str(output), options=_pipeline_options(options))
    shutil.rmtree(output, ignore_errors=True)
    if not models:
        raise ReconstructionError(f"{pose_folder.name}: no two photos could be oriented to each other")
    largest = max(sorted(models), key=lambda key: (models[key].num_reg_images(), models[key].num_points3D()))
    return models[largest]


def _triangulate(
    database: Path, folder: Path, pose_folder: Path, known: dict[str, View], options: SparseOptions
) -> pycolmap.Reconstruction:
    import pycolmap

    handle = pycolmap.Database.open(str(database))
    images = sorted(handle.read_all_images(), key=lambda image: image.name)
    handle.close()
    start = pycolmap.Reconstruction()
    for image in images:
        view = known.get(image.name)
        if view is None:
            continue
        camera = pycolmap.Camera(
            camera_id=image.camera_id,
            model=pycolmap.CameraModelId.OPENCV,
            width=view.intrinsics.width,
            height=view.intrinsics.height,
            params=opencv_parameters(view.intrinsics),
        )
        start.add_camera_with_trivial_rig(camera)
        start.add_image_with_trivial_frame(
            pycolmap.Image(name=image.name, camera_id=image.camera_id, image_id=image.image_id),
            pycolmap.Rigid3d(pycolmap.Rotation3d(view.rotation), view.translation),
        )
    if start.num_images() < MINIMUM_PHOTOS:
        raise ReconstructionError(f"{pose_folder.name}: only {start.num_images()} photos have a known camera")
    output = pose_folder / "sparse.partial"
    output.mkdir(parents=True, exist_ok=True)
    model = pycolmap.triangulate_points(
        start, str(database), str(folder), str(output), options=_pipeline_options(options)
    )
    shutil.rmtree(output, ignore_errors=True)
    return model


def _model_quality(
    model: pycolmap.Reconstruction | None, names: Sequence[str], faults: dict[str, str]
) -> dict[str, Any]:
    """Figures of the model and one row per photo, unregistered ones included."""
    images = {} if model is None else {im.name: im for im in model.images.values() if im.has_pose}
    rows = []
    for name in names:
        image = images.get(name)
        row: dict[str, Any] = {"photo": name, "registered": image is not None}
        if name in faults:
            row["reason"] = faults[name]
        if image is not None and model is not None:
            errors = [model.points3D[point.point3D_id].error for point in image.points2D if point.has_point3D()]
            row["keypoints"] = len(image.points2D)
            row["points"] = len(errors)
            row["reprojection_error_px"] = float(np.mean(errors)) if errors else None
        rows.append(row)
    figures: dict[str, Any] = {
        "photos": len(names),
        "registered": len(images),
        "points": 0 if model is None else int(model.num_points3D()),
        "reprojection_error_px": None,
        "track_length": None,
        "focal_length_px": None,
        "per_photo": rows,
    }
    if model is not None and model.num_points3D() > 0:
        figures["reprojection_error_px"] = float(model.compute_mean_reprojection_error())
        figures["track_length"] = float(model.compute_mean_track_length())
        camera = model.cameras[min(model.cameras)]
        figures["focal_length_px"] = float(camera.mean_focal_length())
        figures["camera_model"] = str(camera.model_name)
        figures["camera_parameters"] = [float(value) for value in camera.params]
    return figures


def _judge(quality: dict[str, Any], pose: str, options: SparseOptions) -> dict[str, Any]:
    share = quality["registered"] / quality["photos"]
    if quality["points"] == 0:
        return {"status": "failed", "reason": f"{pose}: no point could be triangulated"}
    if share < options.minimum_registered_share:
        return {
            "status": "failed",
            "reason": f"{pose}: {quality['registered']} of {quality['photos']} photos registered, "
            f"fewer than {options.minimum_registered_share:.0%}",
        }
    return {"status": "ok", "reason": ""}


def _write_model(model: pycolmap.Reconstruction, folder: Path) -> None:
    partial = folder.with_name("sparse.partial")
    partial.mkdir(parents=True, exist_ok=True)
    model.write_binary(str(partial))
    os.replace(partial, folder)
