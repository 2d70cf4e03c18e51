"""What a user would hand in with the photos, made from a known head: template, landmarks, curves, manifest."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture_eval.cameras import View
from capture_eval.files.atomic import write_text
from capture_eval.files.mesh_files import write_mesh
from capture_eval.images.head import Head
from capture_eval.images.landmark_noise import click_landmarks
from capture_eval.images.skin_shading import HeadModel, light_head
from capture_eval.polygon_mesh import PolygonMesh
from capture_eval.similarity import Similarity
from capture_eval.stages.synthesize_options import SynthesizeOptions

FloatArray = NDArray[np.float64]


def template_from_head(options: SynthesizeOptions) -> Similarity:
    """The template's own frame: scaled, turned about a slanted axis, and moved."""
    from scipy.spatial.transform import Rotation

    axis = np.array([0.42, 0.86, -0.29])
    turn = Rotation.from_rotvec(np.radians(options.template_turn) * axis / np.linalg.norm(axis))
    return Similarity(options.template_scale, turn.as_matrix(), np.array([31.0, -12.0, 57.0]))


def write_capture_inputs(
    out: Path,
    head: Head,
    template: Head,
    model: HeadModel,
    neutral: FloatArray,
    options: SynthesizeOptions,
    times: Sequence[float],
    views: Sequence[View],
) -> None:
    """What a user would hand in with the photos: template, landmarks, curves, manifest."""
    move = template_from_head(options)
    write_mesh(out / "template.obj", template.skin.with_vertices(move.apply(template.skin.vertices)))
    if template.blockers:
        write_mesh(out / "occluders.obj", joined_blockers(template, move))
    lit = light_head(model, neutral)
    clicks = click_landmarks(lit.scene, lit.normals, views, head.landmarks, options.seed, options.landmark_noise)
    landmarks = [
        {
            "name": name,
            "vertex": int(template.landmarks[name]),
            "photos": {photo: [round(u, 3), round(v, 3)] for photo, (u, v) in photos.items()},
        }
        for name, photos in clicks.items()
        if len(photos) >= 2 and name in template.landmarks
    ]
    _write_yaml(out / "landmarks.yaml", {"landmarks": landmarks})
    _write_yaml(out / "curves.yaml", {"curves": [_plain(curve) for curve in head.curves]})
    _write_yaml(out / "rigid_region.yaml", [int(vertex) for vertex in template.rigid_region])
    _write_yaml(out / "manifest.yaml", manifest_of(head, template, options, times))


def manifest_of(head: Head, template: Head, options: SynthesizeOptions, times: Sequence[float]) -> dict[str, Any]:
    """Manifest of a synthetic capture, ready to be written as YAML."""
    parts = {"mesh": "template.obj", "landmarks": "landmarks.yaml"}
    if template.blockers:
        parts["occluders"] = "occluders.obj"
    return {
        "name": f"{head.name} {options.motion} {options.timing}",
        "description": (
            f"{len(times)} poses x {options.views} photos at {options.width}x{options.height}, {options.skin} skin, "
            f"seed {options.seed}; template {template.name}"
        ),
        "source": "synthetic",
        "poses": [{"t": float(t), "photos": f"photos/pose_{k:02d}"} for k, t in enumerate(times)],
        "template": parts,
        "rigid_region": "rigid_region.yaml",
        "curves": "curves.yaml",
        "methods": ["linear", "pde_linear", "pde_quadratic", "pde_cubic"],
        "truth": {"mesh": "truth/mesh.obj", "vertices": "truth/truth.npz", "cameras": "truth/cameras.json"},
    }


def joined_blockers(head: Head, move: Similarity) -> PolygonMesh:
    """Eyes, teeth and so on of a head as one mesh without texture, in the moved frame."""
    vertices: list[FloatArray] = []
    faces: list[NDArray[np.int64]] = []
    start = 0
    for part in head.blockers:
        vertices.append(move.apply(part.mesh.vertices))
        faces += [face + start for face in part.mesh.faces()]
        start += len(part.mesh.vertices)
    return PolygonMesh.from_faces(np.concatenate(vertices), faces)


def _plain(value: Any) -> Any:
    """Numbers and containers of NumPy and of mappings as plain Python, for YAML."""
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, np.generic):
        return value.item()
    if hasattr(value, "items"):
        return {_plain(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return value


def _write_yaml(path: Path, value: Any) -> None:
    import yaml

    write_text(path, yaml.safe_dump(value, sort_keys=False, default_flow_style=None, width=110, allow_unicode=True))
