"""What `synthesize` photographs and how: options that are checked before any work is done."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from capture_eval.errors import InputError
from capture_eval.images.head import Contrast
from capture_eval.images.timing import parse_timing

_LARGEST_DISTORTION = 0.4  # beyond it the corners of the picture fold over


@dataclass(frozen=True)
class SynthesizeOptions:
    """What to photograph and how.

    Attributes
    ----------
    motion, timing
        Motion of the head, and its timing law (`linear`, `eased`, `power:p`).
    poses
        Number of poses at t = 0, 1/(poses-1), ..., 1; `times` overrides it.
    views
        Photos of every pose.
    width, height
        Picture size in pixels.
    seed
        Of camera jitter, sensor noise and landmark noise.
    skin
        ``normal``, or ``weak`` for a low-contrast skin that is hard to match.
    noise
        Sensor noise in grey levels; None means 1.5 (normal skin) or 2.5 (weak skin).
    distortion
        k1, k2, p1, p2 of the lens.
    texture_size
        Side of the skin texture; None means 2048, or 3072 for pictures wider than 960 pixels.
    landmark_noise
        Pixels.
    light_turn
        Degrees by which the lamps have been walked round the head at t = 1; they go there evenly.
    template_scale, template_turn
        The template stands in another frame: scaled, and turned by so many degrees.
    """

    motion: str = "jaw_open"
    timing: str = "linear"
    poses: int = 11
    times: tuple[float, ...] | None = None
    views: int = 30
    width: int = 640
    height: int = 480
    seed: int = 0
    skin: Contrast = "normal"
    noise: float | None = None
    quality: int = 95
    distortion: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    texture_size: int | None = None
    landmark_noise: float = 1.0
    template_scale: float = 1.13
    template_turn: float = 17.0
    light_turn: float = 0.0

    def pose_times(self) -> tuple[float, ...]:
        """Time of every pose.

        Raises
        ------
        InputError
            Fewer than two poses, or times that do not rise from 0 to 1.
        """
        times = self.times
        if times is None:
            if self.poses < 2:
                raise InputError(f"{self.poses} poses asked for; a motion needs at least 2")
            times = tuple(round(k / (self.poses - 1), 12) for k in range(self.poses))
        if len(times) < 2 or times[0] != 0.0 or times[-1] != 1.0 or min(np.diff(times)) <= 0.0:
            raise InputError(f"pose times {times} must rise from 0 to 1")
        return times

    def check(self) -> None:
        """Refuse what makes no sense before any work is done.

        Raises
        ------
        InputError
            One line that names the option.
        """
        self.pose_times()
        parse_timing(self.timing)
        if self.views < 2:
            raise InputError(f"{self.views} views asked for; at least 2 are needed")
        if min(self.width, self.height) < 96 or max(self.width, self.height) > 8192:
            raise InputError(f"picture size {self.width}x{self.height}: give 96 to 8192 pixels a side")
        if self.skin not in ("normal", "weak"):
            raise InputError(f"skin {self.skin!r} is unknown; use normal or weak")
        if not np.isfinite(self.light_turn) or abs(self.light_turn) > 180.0:
            raise InputError(f"light turn {self.light_turn:g}: give degrees within ±180")
        if not all(np.isfinite(self.distortion)) or abs(self.distortion[0]) > _LARGEST_DISTORTION:
            raise InputError(f"distortion k1 = {self.distortion[0]:g}: give a number within ±{_LARGEST_DISTORTION:g}")

    def sensor_noise(self) -> float:
        """Sensor noise in grey levels."""
        if self.noise is not None:
            return self.noise
        return 2.5 if self.skin == "weak" else 1.5

    def skin_texture_size(self) -> int:
        """Side of the skin texture in texels."""
        if self.texture_size is not None:
            return self.texture_size
        return 3072 if max(self.width, self.height) > 960 else 2048
