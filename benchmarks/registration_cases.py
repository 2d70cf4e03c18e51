"""What the registration benchmark photographs and registers: every case by name, in the order of importance."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from capture_eval.images.timing import parse_timing

TEMPLATE_IDENTITY = 1
MOTIONS = ("jaw_open", "grin", "blink_frown")
IDENTITIES = (2, 3)  # neither the template's nor the one (0) whose captures options were chosen on
STEPS = (0.0, 0.2, 0.5, 0.8, 1.0)
FEWER = (0, 2, 3, 4)  # of the steps, where five poses would only repeat what other sequences say
HALVES = (0.0, 0.5, 1.0)
TIMINGS = ("linear", "eased")
LIGHT_TURN = 40.0
COARSE = (1092, "triangles")  # a quarter of the vertices of the skin's mesh: edges twice as long
# Error bars take as long again as the rest; they are made where they are tried, and change no vertex.
NO_BARS = {"uncertainty": {"photo_halves": False, "landmark_repeats": 0}}
# A pose that lost a texture step on purpose must not be refused for it.
ANYTHING_GOES = {"reliability": {"minimum_stereo_share": 0.0, "minimum_skin_agreement": 0.0}}
SIZES = (2000, 5000, 10000, 20000, 50000)
KINDS = ("triangles", "quads")


@dataclass(frozen=True)
class Shots:
    """A capture: whose head, which motion, how far it has gone in every pose, and how it is photographed."""

    head: str
    identity: int
    motion: str
    amounts: tuple[float, ...]
    width: int = 640
    height: int = 480
    views: int = 24
    skin: str = "normal"
    light_turn: float = 0.0

    @property
    def name(self) -> str:
        """Folder of the capture."""
        parts = [f"{self.head}{self.identity}", self.motion, f"{len(self.amounts)}x{self.views}"]
        parts += [] if self.width == 640 else [str(self.width)]
        parts += [] if self.skin == "normal" else [self.skin]
        parts += [] if self.light_turn == 0.0 else ["light"]
        return "_".join(parts)

    @property
    def person(self) -> str:
        """Who it is, for tables."""
        return f"{'MakeHuman' if self.head == 'makehuman' else self.head} {self.identity}"


@dataclass(frozen=True)
class Case:
    """One registration and what is asked of it.

    Attributes
    ----------
    order
        Poses of the capture in the order in which they are registered; the first is the neutral.
    options
        Options that differ from the defaults, by stage and nested as they are.
    template
        Number of vertices and kind of faces of a template made from the usual one; None is the usual one.
    timings
        Laws under which the same poses are evaluated: a pose that has gone the amount a stands at the time at which
        the law reaches a.
    masks_of
        Case whose seen and confident vertices count (options that are taken away must not choose other vertices).
    """

    name: str
    group: str
    shots: Shots
    order: tuple[int, ...] = ()
    options: dict[str, Any] = field(default_factory=dict)
    template: tuple[int, str] | None = None
    timings: tuple[str, ...] = ()
    masks_of: str | None = None

    @property
    def poses(self) -> tuple[int, ...]:
        """Numbers of the capture's poses in the order of the registration."""
        return self.order or tuple(range(len(self.shots.amounts)))

    @property
    def amounts(self) -> tuple[float, ...]:
        """How far the motion has gone in every registered pose."""
        return tuple(self.shots.amounts[number] for number in self.poses)


def time_of(amount: float, timing: str) -> float:
    """Time in [0, 1] at which a rising timing law reaches an amount."""
    law = parse_timing(timing)
    if amount in (0.0, 1.0):
        return amount
    times = np.linspace(0.0, 1.0, 100001)
    return float(np.interp(amount, law(times), times))


def all_cases() -> list[Case]:
    """Every case, the most important first."""
    sequences = _sequences()
    jaw = next(case for case in sequences if case.shots.motion == "jaw_open")
    return [*sequences, *_ablations(jaw), *_drift(), *_hard(jaw), *_large(), *_growth(jaw)]


def _sequences() -> list[Case]:
    """Both people in all motions, and the mannequin."""
    first, second = IDENTITIES
    cases = []
    for identity in IDENTITIES:
        for motion in MOTIONS:
            shots = Shots("makehuman", identity, motion, STEPS)
            order = FEWER if motion == "blink_frown" or (identity, motion) == (second, "grin") else ()
            options = {} if (identity, motion) == (first, "jaw_open") else {"register": NO_BARS}
            cases.append(Case(f"makehuman{identity}_{motion}", "sequences", shots, order, options, timings=TIMINGS))
    shots = Shots("mannequin", 0, "jaw_open", STEPS)
    options = {"register": NO_BARS}
    return [*cases, Case("mannequin_jaw_open", "sequences", shots, FEWER, options, timings=TIMINGS)]


def _ablations(jaw: Case) -> list[Case]:
    """The jaw sequence again without some of the texture steps, on the same scans and the same vertices."""
    none = {"half_ranges": ()}
    variants = {
        "neither": {"neutral_rounds": none, "pose_rounds": none},
        "flow_only": {"neutral_rounds": none, "pose_rounds": {"use_stereo": False}},
        "stereo_only": {"pose_rounds": {"use_flow": False}},
    }
    cases = []
    for name, register in variants.items():
        options = {"register": register | NO_BARS | ANYTHING_GOES}
        cases.append(replace(jaw, name=f"ablation_{name}", group="ablation", options=options, masks_of=jaw.name))
    return cases


def _drift() -> list[Case]:
    """Eleven poses there, and the same photos in the order there and back."""
    shots = Shots("makehuman", 0, "jaw_open", tuple(round(0.1 * k, 1) for k in range(11)))
    options = {"register": NO_BARS}
    there_and_back = (0, 2, 4, 6, 8, 10, 9, 7, 5, 3, 1)
    return [
        Case("drift_there", "drift", shots, options=options),
        Case("drift_there_and_back", "drift", shots, there_and_back, options, masks_of="drift_there"),
    ]


def _hard(jaw: Case) -> list[Case]:
    halves = replace(jaw.shots, amounts=HALVES)
    options = {"register": NO_BARS}
    return [
        Case("hard_light_turned", "hard", replace(halves, light_turn=LIGHT_TURN), options=options),
        Case("hard_weak_skin", "hard", replace(halves, skin="weak"), options=options),
        Case("hard_coarse_template", "hard", jaw.shots, (0, 2, 4), options, COARSE),
    ]


def _large() -> list[Case]:
    cases = []
    for head, identity in (("makehuman", IDENTITIES[0]), ("mannequin", 0)):
        shots = Shots(head, identity, "jaw_open", HALVES, width=1280, height=960)
        cases.append(Case(f"{head}_1280", "large", shots, options={"register": NO_BARS}, timings=("linear",)))
    return cases


def _growth(jaw: Case) -> list[Case]:
    """The neutral and one pose with templates of all sizes and kinds."""
    return [
        Case(f"growth_{kind}_{size}", "growth", jaw.shots, (0, 2), {"register": NO_BARS}, (size, kind))
        for size in SIZES
        for kind in KINDS
    ]
