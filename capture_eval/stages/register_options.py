"""Options of the register stage."""

from __future__ import annotations

from dataclasses import dataclass, field

from capture_eval.registration.lifted_matches import LiftingOptions
from capture_eval.registration.nonrigid_icp import NonrigidIcpOptions
from capture_eval.registration.pose_tracking import TrackingOptions
from capture_eval.registration.reliability import ReliabilityOptions
from capture_eval.registration.texture_rounds import RoundOptions
from capture_eval.registration.vertex_confidence import ConfidenceOptions
from capture_eval.stages.uncertainty import UncertaintyOptions


@dataclass(frozen=True)
class RegisterOptions:
    """Options of the register stage; lengths are in units of a template that is 300 large.

    Attributes
    ----------
    neutral_rounds, pose_rounds : RoundOptions
        Texture rounds of the neutral and of every other pose.
    flow_texels, stereo_texels : int
        Sizes of the two atlases.
    minimum_match_share : float
        A pose in which fewer of the cross-pose matches fit the registered mesh is a failed one.
    minimum_matches : int
        So is a pose with fewer matches in use.
    straighten_cameras : bool
        Adjust the cameras of every pose to the texture of its registered mesh before the texture rounds.
    stabilise : bool
        Afterwards bring the skin that did not move back to where it is in the neutral.
    rigid_region : tuple of int or None
        Template vertices that do not move (skull); the stabilisation looks at no others.
    uncertainty : UncertaintyOptions
        Error bars.
    reliability : ReliabilityOptions
        When a pose is not to be believed.
    """

    neutral: NonrigidIcpOptions = field(default_factory=NonrigidIcpOptions)
    lifting: LiftingOptions = field(default_factory=LiftingOptions)
    tracking: TrackingOptions = field(default_factory=TrackingOptions)
    neutral_rounds: RoundOptions = field(
        default_factory=lambda: RoundOptions(half_ranges=(1.5, 0.8, 0.5), stiffness=1.5, solves=2, use_flow=False)
    )
    pose_rounds: RoundOptions = field(default_factory=RoundOptions)
    confidence: ConfidenceOptions = field(default_factory=ConfidenceOptions)
    flow_texels: int = 1024
    stereo_texels: int = 512
    minimum_match_share: float = 0.25
    minimum_matches: int = 40
    straighten_cameras: bool = True
    stabilise: bool = True
    rigid_region: tuple[int, ...] | None = None
    uncertainty: UncertaintyOptions = field(default_factory=UncertaintyOptions)
    reliability: ReliabilityOptions = field(default_factory=ReliabilityOptions)
