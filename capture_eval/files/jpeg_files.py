"""Photos on disk: JPEG with the EXIF tags a camera writes."""

from __future__ import annotations

import io
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture_eval.errors import InputError
from capture_eval.files.atomic import write_bytes

ByteArray = NDArray[np.uint8]

# EXIF 2.32 tag numbers.
_MAKE, _MODEL, _SOFTWARE, _EXIF_FOLDER = 0x010F, 0x0110, 0x0131, 0x8769
_EXPOSURE, _F_NUMBER, _ISO, _FOCAL = 0x829A, 0x829D, 0x8827, 0x920A
_WIDTH, _HEIGHT, _PLANE_X, _PLANE_Y, _PLANE_UNIT = 0xA002, 0xA003, 0xA20E, 0xA20F, 0xA210
_CENTIMETRE = 3
_PLANE_UNIT_MM = {2: 25.4, 3: 10.0, 4: 1.0}


@dataclass(frozen=True)
class PhotoTags:
    """What the camera says about itself.

    Attributes
    ----------
    focal_px
        Focal length in pixels, or None when the photo does not tell.
    sensor_width
        Longer side of the sensor in millimetres; with `focal_px` it gives the focal length in millimetres.
    """

    focal_px: float | None
    sensor_width: float = 36.0
    make: str = "capture_eval"
    model: str = "ray casting camera"
    f_number: float = 11.0
    iso: int = 100
    exposure: float = 1.0 / 125.0


def write_jpeg(path: Path, image: ByteArray, tags: PhotoTags, quality: int = 95) -> None:
    """Write a JPEG (4:4:4) with EXIF; the same image gives the same bytes.

    The focal length is stored in millimetres with the pixel pitch of the sensor, which together are exact; the rounded
    35-mm equivalent is left out, because readers prefer it and it is up to a percent off.

    Raises
    ------
    InputError
        The image is no (H, W, 3) uint8 array.
    """
    from PIL import Image

    if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8:
        raise InputError(f"{path}: a photo must be (H, W, 3) uint8, not {image.shape} {image.dtype}")
    height, width = image.shape[:2]
    exif = Image.Exif()
    exif[_MAKE] = tags.make
    exif[_MODEL] = tags.model
    exif[_SOFTWARE] = "capture_eval"
    folder = exif.get_ifd(_EXIF_FOLDER)
    folder[_EXPOSURE] = _rational(tags.exposure)
    folder[_F_NUMBER] = _rational(tags.f_number)
    folder[_ISO] = tags.iso
    folder[_WIDTH] = width
    folder[_HEIGHT] = height
    if tags.focal_px is not None:
        folder[_FOCAL] = _rational(tags.focal_px * tags.sensor_width / max(width, height))
        pitch = _rational(max(width, height) / (tags.sensor_width / 10.0))
        folder[_PLANE_X], folder[_PLANE_Y], folder[_PLANE_UNIT] = pitch, pitch, _CENTIMETRE
    data = io.BytesIO()
    Image.fromarray(image).save(data, format="JPEG", quality=quality, subsampling=0, exif=exif)
    write_bytes(path, data.getvalue())


def _rational(value: float) -> Any:
    from PIL.TiffImagePlugin import IFDRational

    fraction = Fraction(value).limit_denominator(100_000)
    return IFDRational(fraction.numerator, fraction.denominator)


def read_photo(path: Path) -> ByteArray:
    """Read a photo as (H, W, 3) uint8 RGB.

    Raises
    ------
    InputError
        The file is missing, empty, truncated or no image.
    """
    from PIL import Image, UnidentifiedImageError

    try:
        with Image.open(path) as image:
            return np.asarray(image.convert("RGB"), dtype=np.uint8)
    except FileNotFoundError:
        raise InputError(f"{path}: no such photo") from None
    except (UnidentifiedImageError, OSError, SyntaxError, Image.DecompressionBombError) as error:
        raise InputError(f"{path}: cannot be read as an image ({error})") from None


def read_photo_tags(path: Path) -> PhotoTags:
    """What the EXIF of a photo says; `focal_px` is None when focal length or pixel pitch is missing.

    Raises
    ------
    InputError
        The file is missing or no image.
    """
    from PIL import Image, UnidentifiedImageError

    try:
        with Image.open(path) as image:
            exif, width, height = image.getexif(), image.width, image.height
    except FileNotFoundError:
        raise InputError(f"{path}: no such photo") from None
    except (UnidentifiedImageError, OSError, SyntaxError) as error:
        raise InputError(f"{path}: cannot be read as an image ({error})") from None
    folder = exif.get_ifd(_EXIF_FOLDER)
    focal_mm, pitch = float(folder.get(_FOCAL, 0.0)), float(folder.get(_PLANE_X, 0.0))
    unit = _PLANE_UNIT_MM.get(int(folder.get(_PLANE_UNIT, 0)))
    focal_px, sensor = None, 36.0
    if focal_mm > 0.0 and pitch > 0.0 and unit is not None:
        focal_px, sensor = focal_mm * pitch / unit, max(width, height) * unit / pitch
    return PhotoTags(
        focal_px,
        sensor,
        str(exif.get(_MAKE, "")),
        str(exif.get(_MODEL, "")),
        float(folder.get(_F_NUMBER, 0.0)),
        int(folder.get(_ISO, 0)),
        float(folder.get(_EXPOSURE, 0.0)),
    )
