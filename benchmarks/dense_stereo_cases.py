"""What the dense stereo benchmark measures: a stated fraction of all combinations, each factor varied round a centre.

A *scene* is one rendered pose of one head; a *case* is one way of reconstructing it. Parameters of the program were
chosen on the scenes `TUNED`; everything else is reported on heads that were not looked at while choosing.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass, field, replace
from typing import Any


@dataclass(frozen=True)
class Scene:
    """One pose of one head and how it is photographed."""

    dataset: str
    identity: int
    motion: str
    amount: float
    skin: str = "normal"
    width: int = 640
    height: int = 480
    views: int = 24

    @property
    def name(self) -> str:
        """Folder of its photos."""
        pose = "neutral" if self.amount == 0 else self.motion
        return f"{self.dataset}{self.identity}_{pose}_{self.skin}_{self.width}x{self.height}"

    @property
    def megapixels(self) -> float:
        """Of one photo."""
        return self.width * self.height / 1e6


@dataclass(frozen=True)
class Case:
    """One reconstruction of one scene.

    Attributes
    ----------
    group
        What it is for: heads, large, photos, sizes, effort, fusion, peers, threads.
    known
        True poses of the cameras; otherwise they are solved from the photos.
    photos
        How many of the scene's photos, spread evenly; 0 means all.
    method
        own, sgbm, openmvs, or colmap_fusion of the maps that the scene's own case has left.
    dense
        Options of the dense stage that differ from the defaults.
    stereo
        Options of PatchMatch that differ from the defaults.
    maps
        Also compare the depth maps with the true depth, by tilt and contrast.
    """

    name: str
    group: str
    scene: Scene
    known: bool = True
    photos: int = 0
    method: str = "own"
    dense: dict[str, Any] = field(default_factory=dict)
    stereo: dict[str, Any] = field(default_factory=dict)
    maps: bool = False

    @property
    def photo_count(self) -> int:
        """Photos given to the program."""
        return self.photos or self.scene.views

    @property
    def twin(self) -> str:
        """Name of the case that does the same scene with our own program and true cameras."""
        return self.name.removeprefix(f"{self.method}_") + "_true"

    @property
    def fingerprint(self) -> str:
        """Changes when the case means something else."""
        return hashlib.sha256(json.dumps(asdict(self), sort_keys=True).encode()).hexdigest()[:16]


CENTRE = Scene("makehuman", 2, "grin", 1.0)
WEAK = replace(CENTRE, skin="weak")
TUNED = (Scene("makehuman", 0, "jaw_open", 0.0), Scene("mannequin", 0, "jaw_open", 0.0, "weak"))
SIZES = ((320, 240), (480, 360))
PHOTOS = (6, 8, 12, 16)
SOURCES = (2, 4, 12)


def _heads() -> list[Case]:
    """Heads, poses, skins and camera poses at 640 x 480."""
    others = (
        Scene("makehuman", 3, "blink_frown", 1.0),
        Scene("makehuman", 4, "jaw_open", 1.0),
        Scene("mannequin", 1, "jaw_open", 1.0),
        Scene("mannequin", 2, "grin", 1.0, "weak"),
    )
    scenes = (CENTRE, WEAK)
    cases = [Case(f"{scene.name}_true", "heads", scene, maps=True) for scene in scenes]
    cases += [Case(f"{scene.name}_true", "heads", scene) for scene in others]
    cases += [Case(f"{scene.name}_solved", "heads", scene, known=False) for scene in (*scenes, others[1])]
    return cases + [Case(f"tuned_{scene.name}", "heads", scene) for scene in TUNED]


def _large() -> list[Case]:
    normal, weak = (replace(scene, width=1280, height=960) for scene in (CENTRE, WEAK))
    return [
        Case(f"{normal.name}_true", "large", normal, maps=True),
        Case(f"{normal.name}_solved", "large", normal, known=False),
        Case(f"{weak.name}_true", "large", weak),
    ]


def all_cases() -> list[Case]:
    """Every case, those first that should be there when time is short."""
    cases = _heads()
    cases += [Case(f"colmap_fusion_{scene.name}", "fusion", scene, method="colmap_fusion") for scene in (CENTRE, WEAK)]
    cases += [Case(f"sgbm_{scene.name}", "peers", scene, method="sgbm", maps=True) for scene in (CENTRE, WEAK)]
    cases += [Case(f"openmvs_{CENTRE.name}", "peers", CENTRE, method="openmvs")]
    cases += [Case(f"photos_{count}", "photos", CENTRE, photos=count) for count in PHOTOS]
    cases += [
        Case(f"size_{width}x{height}", "sizes", replace(CENTRE, width=width, height=height)) for width, height in SIZES
    ]
    cases += _large()[:1]
    cases += [Case(f"sources_{count}", "effort", CENTRE, dense={"sources": count}) for count in SOURCES]
    cases += [
        Case("half_scale", "effort", CENTRE, dense={"max_image_size": 320}),
        Case("passes_fewer", "effort", CENTRE, stereo={"coarse_passes": 2, "fine_passes": 1}),
        Case("passes_more", "effort", CENTRE, stereo={"coarse_passes": 8, "fine_passes": 4}),
    ]
    cases += _large()[1:]
    small = replace(CENTRE, width=320, height=240)
    cases += [
        Case(f"threads_{count}", "threads", small, photos=12, dense={"threads": count}, stereo={"threads": count})
        for count in (1, 2)
    ]
    return cases
