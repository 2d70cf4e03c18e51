"""A small capture on disk that nobody photographed: textured noise, a grid of quads, landmarks, one curve."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import yaml
from PIL import Image
from scipy import ndimage

from capture_eval.files.mesh_files import write_mesh
from capture_eval.polygon_mesh import PolygonMesh

SIDE = 6
PHOTOS = 9


def picture(seed: int, width: int = 160, height: int = 120) -> np.ndarray:
    """A textured picture: noise at several scales round middle grey."""
    generator = np.random.default_rng(seed)
    total = np.zeros((height, width, 3))
    for sigma, strength in ((0.7, 18.0), (3.0, 22.0), (12.0, 30.0)):
        layer = ndimage.gaussian_filter(generator.normal(size=(height, width, 3)), (sigma, sigma, 0))
        total += strength * layer / layer.std()
    return np.clip(120 + total, 0, 255).astype(np.uint8)


def save_photo(path: Path, pixels: np.ndarray, **options: object) -> None:
    Image.fromarray(pixels).save(path, quality=92, **options)


def grid_mesh() -> PolygonMesh:
    rows, columns = np.mgrid[0:SIDE, 0:SIDE]
    vertices = np.stack([columns.ravel(), rows.ravel(), 0.1 * (columns * rows).ravel()], axis=1).astype(float)
    corner = (np.arange(SIDE - 1)[:, None] * SIDE + np.arange(SIDE - 1)).ravel()
    quads = np.stack([corner, corner + 1, corner + SIDE + 1, corner + SIDE], axis=1)
    plain = PolygonMesh.from_faces(vertices, quads)
    return PolygonMesh(
        plain.vertices, plain.face_offsets, plain.face_vertices, vertices[:, :2] / SIDE, plain.face_vertices.copy()
    )


def write_capture(folder: Path, poses: int = 2) -> Path:
    """Write the capture and return its manifest."""
    for pose in range(poses):
        (folder / f"pose_{pose}").mkdir(parents=True)
        for index in range(PHOTOS):
            save_photo(folder / f"pose_{pose}" / f"view_{index}.jpg", picture(100 * pose + index))
    write_mesh(folder / "template.obj", grid_mesh())
    landmarks = [
        {"name": f"mark_{k}", "vertex": k, "photos": {"view_0.jpg": [10.0, 10.0], "view_1.jpg": [12.0, 9.0]}}
        for k in range(7)
    ]
    (folder / "landmarks.yaml").write_text(yaml.safe_dump({"landmarks": landmarks}))
    (folder / "curves.yaml").write_text(
        yaml.safe_dump({"curves": [{"name": "row", "vertices": [6, 7, 8], "closed": False}]})
    )
    manifest = {
        "name": "good",
        "source": "photos",
        "poses": [{"t": index / (poses - 1), "photos": f"pose_{index}"} for index in range(poses)],
        "template": {"mesh": "template.obj", "landmarks": "landmarks.yaml"},
        "curves": "curves.yaml",
    }
    (folder / "manifest.yaml").write_text(yaml.safe_dump(manifest))
    return folder / "manifest.yaml"
