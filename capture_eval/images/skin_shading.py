"""Soft studio light on a posed head, and the picture a camera sees of it.

Light and backdrop belong to the frame of the head, so a shaded place moves over the skin only because the skin moves.
Irradiance (sky-like fill plus two soft boxes, both with occlusion) is computed per vertex and pose by ray casting;
the gloss depends on the view.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from capture_eval.cameras import View
from capture_eval.images.head import Head
from capture_eval.images.ray_casting import SAMPLES_PER_SIDE, TriangleScene, sample_pixels
from capture_eval.images.sensor import linear_from_srgb, srgb_from_linear
from capture_eval.triangle_geometry import vertex_normals

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
ByteArray = NDArray[np.uint8]


@dataclass(frozen=True)
class SoftBox:
    """A square lamp that looks at the head.

    Attributes
    ----------
    position
        Millimetres, head frame.
    side
        Edge length, millimetres.
    power
        Irradiance on a surface at the head's origin that faces the lamp (1 = white paper comes out white).
    """

    position: tuple[float, float, float]
    side: float
    power: float


@dataclass(frozen=True)
class Lighting:
    """Light of the studio.

    Attributes
    ----------
    boxes
        Soft boxes.
    fill_top, fill_bottom
        Irradiance of the surrounding light from above and from below (linear in the direction's height).
    backdrop
        sRGB grey of the background.
    shine
        Strength of the highlight of skin.
    shininess
        Blinn exponent of skin.
    """

    boxes: tuple[SoftBox, ...] = (
        SoftBox((620.0, 520.0, 900.0), 420.0, 0.62),
        SoftBox((-760.0, 160.0, 760.0), 520.0, 0.34),
    )
    fill_top: float = 0.52
    fill_bottom: float = 0.30
    backdrop: int = 96
    shine: float = 0.035
    shininess: float = 22.0

    def turned(self, degrees: float) -> Lighting:
        """The same light with its boxes walked round the head's vertical axis, from its left towards its front."""
        cosine, sine = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
        boxes = []
        for box in self.boxes:
            x, y, z = box.position
            boxes.append(replace(box, position=(cosine * x - sine * z, y, sine * x + cosine * z)))
        return replace(self, boxes=tuple(boxes))


@dataclass(frozen=True)
class TexturePyramids:
    """Textures with their reduced copies, in one array as the compiled loop wants them.

    Attributes
    ----------
    texels
        (N, 3) uint8 sRGB.
    table
        (textures, levels, 3): first texel, width, height; width 0 where the level does not exist.
    """

    texels: ByteArray
    table: IntArray


@dataclass(frozen=True)
class HeadModel:
    """What does not change with the pose: triangles of skin and blockers, colours, textures.

    Attributes
    ----------
    triangles
        (K, 3) vertices; skin first, then the blockers in their order.
    skin_vertices, skin_triangles
        How many of the vertices and triangles are skin.
    triangle_texture
        (K,) texture, -1 where vertex colours are used.
    triangle_uv
        (K, 3, 2) texture coordinates, v up.
    colors
        (V, 3) linear albedo (used where there is no texture).
    gloss, shininess
        (K,) strength and exponent of the highlight.
    textures
        Textures of the skin and of the blockers.
    """

    triangles: IntArray
    skin_vertices: int
    skin_triangles: int
    triangle_texture: IntArray
    triangle_uv: FloatArray
    colors: FloatArray
    gloss: FloatArray
    shininess: FloatArray
    textures: TexturePyramids


def texture_pyramids(images: Sequence[ByteArray]) -> TexturePyramids:
    """Textures and their halvings (2 x 2 box means in linear light) down to one texel side."""
    levels: list[list[tuple[int, int, int]]] = []
    blocks: list[ByteArray] = []
    start = 0
    for image in images:
        rows = []
        while True:
            height, width = image.shape[:2]
            rows.append((start, width, height))
            blocks.append(image.reshape(-1, 3))
            start += width * height
            if min(width, height) < 8 or width % 2 or height % 2:
                break
            image = _halved(image)
        levels.append(rows)
    depth = max((len(rows) for rows in levels), default=1)
    table = np.zeros((len(levels), depth, 3), dtype=np.int64)
    for texture, rows in enumerate(levels):
        table[texture, : len(rows)] = rows
    texels = np.concatenate(blocks) if blocks else np.zeros((1, 3), dtype=np.uint8)
    return TexturePyramids(texels, table)


def _halved(image: ByteArray) -> ByteArray:
    linear = _linear_table()[image]
    mean = 0.25 * (linear[0::2, 0::2] + linear[1::2, 0::2] + linear[0::2, 1::2] + linear[1::2, 1::2])
    return np.rint(255.0 * srgb_from_linear(mean)).astype(np.uint8)


def _linear_table() -> NDArray[np.float32]:
    return linear_from_srgb(np.arange(256) / 255.0).astype(np.float32)


def build_head_model(head: Head, albedo: ByteArray, lighting: Lighting | None = None) -> HeadModel:
    """Gather skin and blockers of a head into one set of triangles.

    Parameters
    ----------
    head
        The subject.
    albedo
        (H, W, 3) uint8 sRGB skin colour, from ``head.albedo``.
    lighting
        Gives the gloss of skin.
    """
    lighting = lighting or Lighting()
    images = [albedo]
    triangles, texture, uv, gloss, shininess = [], [], [], [], []
    colors = [np.zeros((len(head.skin.vertices), 3))]
    start = 0
    for mesh, image, vertex_colors, shine in [(head.skin, None, None, 1.0)] + [
        (part.mesh, part.texture, part.colors, part.gloss) for part in head.blockers
    ]:
        corners = mesh.triangles()[0]
        triangles.append(corners + start)
        start += len(mesh.vertices)
        if vertex_colors is not None:
            colors.append(linear_from_srgb(vertex_colors / 255.0))
            texture.append(np.full(len(corners), -1, dtype=np.int64))
            uv.append(np.zeros((len(corners), 3, 2)))
        else:
            if mesh is not head.skin:
                images.append(np.asarray(image, dtype=np.uint8))
                colors.append(np.zeros((len(mesh.vertices), 3)))
            texture.append(np.full(len(corners), len(images) - 1, dtype=np.int64))
            uv.append(mesh.corner_texture_coordinates())
        gloss.append(np.full(len(corners), shine * lighting.shine))
        # Wet parts (gloss above 1) have sharper highlights.
        shininess.append(np.full(len(corners), lighting.shininess * max(1.0, shine) ** 1.5))
    return HeadModel(
        np.concatenate(triangles),
        len(head.skin.vertices),
        len(triangles[0]),
        np.concatenate(texture),
        np.concatenate(uv),
        np.concatenate(colors),
        np.concatenate(gloss),
        np.concatenate(shininess),
        texture_pyramids(images),
    )


@dataclass(frozen=True)
class LitHead:
    """A posed head with its light, ready to be photographed.

    Attributes
    ----------
    scene
        Triangles for ray casting.
    normals
        (V, 3) shading normals.
    irradiance
        (V,) diffuse light on the vertices (1 = white paper comes out white).
    light_visibility
        (V, lights) share of every soft box that a vertex sees.
    """

    model: HeadModel
    lighting: Lighting
    scene: TriangleScene
    normals: FloatArray
    irradiance: FloatArray
    light_visibility: FloatArray


def light_head(model: HeadModel, vertices: FloatArray, lighting: Lighting | None = None) -> LitHead:
    """Compute the light that falls on every vertex of a posed head.

    Parameters
    ----------
    model
        The head's triangles.
    vertices
        (V, 3) posed vertices of skin and blockers, millimetres, head frame.
    """
    lighting = lighting or Lighting()
    scene = TriangleScene(vertices, model.triangles)
    normals = vertex_normals(scene.vertices, model.triangles)
    starts = scene.vertices + 0.3 * normals
    irradiance = _fill_light(scene, starts, normals, lighting)
    visibility = np.zeros((len(vertices), len(lighting.boxes)))
    for number, box in enumerate(lighting.boxes):
        visibility[:, number], received = _box_light(scene, starts, normals, box)
        irradiance = irradiance + received
    return LitHead(model, lighting, scene, normals, irradiance, visibility)


def sphere_directions(count: int) -> FloatArray:
    """Evenly spread unit vectors (count, 3) on a Fibonacci spiral."""
    index = np.arange(count) + 0.5
    height = 1.0 - 2.0 * index / count
    angle = np.pi * (1.0 + np.sqrt(5.0)) * index
    ring = np.sqrt(1.0 - height**2)
    return np.stack([ring * np.cos(angle), height, ring * np.sin(angle)], axis=1)


def _fill_light(
    scene: TriangleScene, starts: FloatArray, normals: FloatArray, lighting: Lighting, count: int = 384
) -> FloatArray:
    directions = sphere_directions(count)
    middle, slope = lighting.fill_top + lighting.fill_bottom, lighting.fill_top - lighting.fill_bottom
    brightness = 0.5 * (middle + slope * directions[:, 1])
    cosines = np.maximum(normals @ directions.T, 0.0)
    vertex, direction = np.nonzero(cosines > 0.02)
    free = scene.escapes(starts[vertex], directions[direction])
    light = cosines[vertex, direction] * brightness[direction] * free
    return np.asarray(np.bincount(vertex, light, minlength=len(starts)) * (4.0 / count), dtype=np.float64)


def _box_light(
    scene: TriangleScene, starts: FloatArray, normals: FloatArray, box: SoftBox, side: int = 7
) -> tuple[FloatArray, FloatArray]:
    """Share of the box that is seen from every vertex, and the irradiance it gives."""
    position = np.asarray(box.position)
    distance = float(np.linalg.norm(position))
    facing = -position / distance
    right = np.cross(facing, [0.0, 1.0, 0.0])
    right = right / np.linalg.norm(right)
    up = np.cross(right, facing)
    steps = ((np.arange(side) + 0.5) / side - 0.5) * box.side
    grid = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    points = position + grid[:, :1] * right + grid[:, 1:] * up
    seen = np.zeros(len(starts))
    received = np.zeros(len(starts))
    for point in points:
        towards = point - starts
        length = np.linalg.norm(towards, axis=1)
        cosine = np.einsum("ij,ij->i", normals, towards) / length
        lit = np.flatnonzero(cosine > -0.1)
        free = np.zeros(len(starts), dtype=np.bool_)
        free[lit] = ~scene.occluded(starts[lit], np.broadcast_to(point, (len(lit), 3)))
        seen += free / len(points)
        emitted = -(towards @ facing) / length
        received += free * np.maximum(cosine, 0.0) * emitted * (distance / length) ** 2 * box.power / len(points)
    return seen, received


def photograph(lit: LitHead, view: View, samples_per_side: int = SAMPLES_PER_SIDE) -> FloatArray:
    """The light that reaches the pixels of a view (box filter over each pixel, before sensor and coding).

    Returns
    -------
    (height, width, 3) linear light, 1 = white.
    """
    from capture_eval.images.shading_kernels import Lamps, Surface, Textures, shade_pixels

    backdrop = np.full(3, float(linear_from_srgb(lit.lighting.backdrop / 255.0)))
    picture = np.empty((view.intrinsics.height, view.intrinsics.width, 3))
    picture[:] = backdrop
    seen = sample_pixels(lit.scene, view, samples_per_side)
    light = np.zeros((len(seen.rows), 3))
    boxes = lit.lighting.boxes
    model = lit.model
    shade_pixels(
        Surface(
            lit.scene.vertices,
            lit.scene.triangles,
            lit.normals,
            lit.irradiance,
            lit.light_visibility,
            model.triangle_texture,
            model.triangle_uv,
            model.colors,
            model.gloss,
            model.shininess,
        ),
        Textures(model.textures.table, model.textures.texels, _linear_table()),
        Lamps(
            np.array([box.position for box in boxes], dtype=np.float64).reshape(-1, 3),
            np.array([box.power for box in boxes], dtype=np.float64),
        ),
        seen.triangles,
        seen.directions,
        seen.center,
        1.0 / (float(view.intrinsics.matrix[0, 0]) * samples_per_side),
        backdrop,
        light,
    )
    picture[seen.rows, seen.columns] = light
    return picture
