"""Photos of one pose of one head with everything that is true about it, for the dense stereo benchmark."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
from dense_stereo_cases import Scene

from capture_eval.evaluation.surface_error import TrueScene, face_proper, join_scene
from capture_eval.files.atomic import read_npz, write_json, write_npz
from capture_eval.files.camera_files import read_cameras, write_cameras
from capture_eval.files.jpeg_files import PhotoTags, write_jpeg
from capture_eval.images.camera_rig import intrinsics_for, place_cameras
from capture_eval.images.sensor import expose
from capture_eval.images.skin_shading import build_head_model, light_head, photograph
from capture_eval.stages.subjects import load_subjects
from capture_eval.stages.synthesize import aim_point
from capture_eval.stages.synthesize_options import SynthesizeOptions
from capture_eval.triangle_geometry import diameter

POSE = "pose_00"


def photo_folder(folder: Path) -> Path:
    """Where the photos of a scene are."""
    return folder / "photos" / POSE


def photograph_scene(scene: Scene, folder: Path, makehuman: Path | None) -> None:
    """Render a scene once; a finished one is kept, an unfinished one is made anew."""
    if (folder / "scene.json").is_file():
        return
    shutil.rmtree(folder, ignore_errors=True)
    head, _ = load_subjects(scene.dataset, scene.identity, scene.identity + 1, makehuman)
    options = SynthesizeOptions(
        motion=scene.motion, views=scene.views, width=scene.width, height=scene.height, skin=scene.skin
    )
    neutral = head.pose(scene.motion, 0.0)[0]
    skin, parts = head.pose(scene.motion, scene.amount)
    intrinsics = intrinsics_for(scene.width, scene.height)
    views = place_cameras(scene.views, intrinsics, aim_point(neutral), options.seed)
    model = build_head_model(head, head.albedo(options.skin_texture_size(), options.skin))
    lit = light_head(model, np.concatenate([skin, *parts]))
    for number, view in enumerate(views):
        image = expose(photograph(lit, view), options.sensor_noise(), (options.seed, 303, 0, number))
        tags = PhotoTags(float(view.intrinsics.matrix[0, 0]))
        write_jpeg(photo_folder(folder) / view.name, image, tags, options.quality)
    blockers = [(part, blocker.mesh.triangles()[0]) for part, blocker in zip(parts, head.blockers, strict=True)]
    face = face_proper(head.skin.vertices, head.regions)
    truth = join_scene((skin, head.skin.triangles()[0]), blockers, views, face, diameter(neutral))
    write_cameras(folder / "truth" / "cameras.json", {POSE: views})
    _write_truth(folder, truth)
    write_json(folder / "scene.json", {"scene": scene.name})


def _write_truth(folder: Path, truth: TrueScene) -> None:
    arrays = {
        "vertices": truth.vertices,
        "triangles": truth.triangles,
        "skin_triangles": np.array([truth.skin_triangles]),
        "size": np.array([truth.size]),
    }
    if truth.face_triangles is not None:
        arrays["face_triangles"] = truth.face_triangles
    write_npz(folder / "truth" / "scene.npz", arrays)


def read_truth(folder: Path) -> TrueScene:
    """The surfaces that were photographed, with the true cameras."""
    arrays = read_npz(folder / "truth" / "scene.npz")
    return TrueScene(
        arrays["vertices"],
        arrays["triangles"],
        int(arrays["skin_triangles"][0]),
        float(arrays["size"][0]),
        tuple(read_cameras(folder / "truth" / "cameras.json")[POSE]),
        arrays.get("face_triangles"),
    )
