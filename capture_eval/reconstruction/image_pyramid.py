"""Photos prepared for stereo: halved again and again, grey values packed for bilinear sampling."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capture_eval.errors import InputError

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]

_COARSEST_WIDTH = 160.0
_SMALLEST_SIDE = 32


@dataclass(frozen=True)
class StereoView:
    """A photo without lens distortion, and its camera.

    Parameters
    ----------
    name : str
    grey : (H, W) float32
        0 to 255.
    matrix : (3, 3) float64
        Pixels; the centre of the top-left pixel is (0.5, 0.5).
    rotation, translation : (3, 3), (3,) float64
        view_from_world.
    mask : (H, W) bool, optional
        Where to look for a surface.
    """

    name: str
    grey: Singles
    matrix: Floats
    rotation: Floats
    translation: Floats
    mask: NDArray[np.bool_] | None = None

    def __post_init__(self) -> None:
        if self.grey.ndim != 2:
            raise InputError(f"{self.name}: grey image has shape {self.grey.shape}, expected (H, W)")
        if self.mask is not None and self.mask.shape != self.grey.shape:
            raise InputError(f"{self.name}: mask {self.mask.shape} and photo {self.grey.shape} differ in size")


@dataclass(frozen=True)
class PyramidLevel:
    """One level: grey values, packed bilinear cells, calibration in pixel-index coordinates."""

    grey: Singles
    texels: NDArray[np.uint32]
    matrix: Floats
    active: NDArray[np.uint8]


@dataclass(frozen=True)
class Pyramid:
    """A view at every level, finest first."""

    view: StereoView
    levels: tuple[PyramidLevel, ...]


def pack_texels(grey: Singles) -> NDArray[np.uint32]:
    """Pack the four corners of every bilinear cell into one uint32, (H, W) -> (H, W)."""
    quantised = np.clip(np.rint(grey), 0, 255).astype(np.uint32)
    padded = np.pad(quantised, ((0, 1), (0, 1)), mode="edge")
    packed = padded[:-1, :-1] | padded[:-1, 1:] << 8 | padded[1:, :-1] << 16 | padded[1:, 1:] << 24
    return np.ascontiguousarray(packed.astype(np.uint32))


def level_count(width: int, height: int) -> int:
    """Levels so that the longer side of the coarsest is about 160 pixels."""
    return int(np.clip(np.rint(np.log2(max(width, height) / _COARSEST_WIDTH)) + 1, 1, 7))


def build_pyramid(view: StereoView, levels: int) -> Pyramid:
    """Halve the photo `levels` - 1 times by averaging 2 x 2 pixels.

    Odd last rows and columns are left out, so that a pixel is always exactly four finer ones and the
    calibration scales by exactly one half.
    """
    grey = view.grey.astype(np.float32)
    mask: NDArray[np.bool_] = np.ones(grey.shape, np.bool_) if view.mask is None else view.mask
    matrix = view.matrix.astype(np.float64)
    result = []
    for _ in range(levels):
        index_matrix = matrix.copy()
        index_matrix[:2, 2] -= 0.5
        active = np.ascontiguousarray(mask.astype(np.uint8))
        result.append(PyramidLevel(np.ascontiguousarray(grey), pack_texels(grey), index_matrix, active))
        height, width = grey.shape[0] // 2 * 2, grey.shape[1] // 2 * 2
        if min(height, width) < 2 * _SMALLEST_SIDE:
            break
        quads = grey[:height, :width].reshape(height // 2, 2, width // 2, 2)
        grey = quads.mean(axis=(1, 3), dtype=np.float32)
        mask = np.asarray(mask[:height, :width].reshape(height // 2, 2, width // 2, 2).any(axis=(1, 3)))
        matrix = np.diag([0.5, 0.5, 1.0]) @ matrix
    return Pyramid(view, tuple(result))
