"""The 49 named edge loops of a MakeHuman head, as start edges on the upstream base mesh (hm08).

Each is an edge loop in the usual sense (straight on through vertices of valence 4); a few turn at named vertices, and
open ones end at their `stop` or where the rule ends. Numbers are 0-based vertices of base.obj.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class BaseLoop:
    """An edge loop on the base mesh.

    Attributes
    ----------
    name, region
        For people.
    start_edge
        First two vertices.
    turns
        Vertex -> next vertex, where the loop leaves the rule.
    stop
        Last vertex, or None.
    """

    name: str
    region: str
    start_edge: tuple[int, int]
    turns: Mapping[int, int] = field(default_factory=dict)
    stop: int | None = None


BASE_LOOPS: tuple[BaseLoop, ...] = (
    BaseLoop("mouth_ring_1", "mouth", (119, 125)),
    BaseLoop("mouth_ring_2", "mouth", (5062, 5064)),
    BaseLoop("mouth_ring_3", "mouth", (161, 184)),
    BaseLoop("mouth_ring_4", "mouth", (197, 203)),
    BaseLoop("lip_ring_1", "mouth", (374, 377)),
    BaseLoop("lip_ring_2", "mouth", (402, 403)),
    BaseLoop("lip_ring_3", "mouth", (412, 413)),
    BaseLoop("lip_ring_4", "mouth", (414, 415)),
    BaseLoop("lip_ring_5", "mouth", (497, 498)),
    BaseLoop("lip_ring_6", "mouth", (418, 419)),
    BaseLoop("right_eye_ring_1", "eye", (114, 118)),
    BaseLoop("left_eye_ring_1", "eye", (6898, 6902)),
    BaseLoop("right_eye_ring_2", "eye", (109, 113)),
    BaseLoop("left_eye_ring_2", "eye", (6893, 6897)),
    BaseLoop("right_eye_ring_3", "eye", (104, 108)),
    BaseLoop("left_eye_ring_3", "eye", (6888, 6892)),
    BaseLoop("right_eye_ring_4", "eye", (75, 76)),
    BaseLoop("left_eye_ring_4", "eye", (6859, 6860)),
    BaseLoop("right_eye_ring_5", "eye", (4, 5)),
    BaseLoop("left_eye_ring_5", "eye", (6788, 6789)),
    BaseLoop("right_eye_ring_6", "eye", (0, 1)),
    BaseLoop("left_eye_ring_6", "eye", (6784, 6785)),
    BaseLoop("goggles", "eye", (219, 5133)),
    BaseLoop("face_ring_1", "head", (732, 7621)),
    BaseLoop("face_ring_2", "head", (246, 248)),
    BaseLoop("jaw_nape_ring", "head", (745, 748), {886: 887, 7588: 7587}),
    BaseLoop("face_contour_ring", "head", (239, 241), {5299: 5298, 11904: 7455}),
    BaseLoop("nose_tip_ring", "nose", (278, 280), {7119: 7057, 358: 286}),
    BaseLoop("eyes_chin_ring", "cheek", (229, 230), {11750: 11934, 5136: 5075}),
    BaseLoop("crown_ring", "head", (882, 1029)),
    BaseLoop("neck_ring_1", "head", (749, 750)),
    BaseLoop("nostril_right", "nose", (274, 298)),
    BaseLoop("nostril_left", "nose", (7043, 7064)),
    BaseLoop("nose_bridge_1", "nose", (7770, 13360), stop=1078),
    BaseLoop("nose_bridge_2", "nose", (7767, 13369), stop=1075),
    BaseLoop("nose_ridge_right", "nose", (472, 462)),
    BaseLoop("nose_ridge_left", "nose", (7228, 7221)),
    BaseLoop("midline_lower", "mouth", (1522, 815), stop=523),
    BaseLoop("midline_upper", "head", (474, 468)),
    BaseLoop("head_horizontal", "head", (6779, 27), stop=13375),
    BaseLoop("cheek_forehead_1", "cheek", (7179, 7177), stop=419),
    BaseLoop("cheek_forehead_2", "cheek", (433, 430), stop=7193),
    BaseLoop("mouthcorner_jaw_neck_right", "cheek", (1462, 931), stop=432),
    BaseLoop("mouthcorner_jaw_neck_left", "cheek", (8150, 7633), stop=7192),
    BaseLoop("undereye_cheek_neck_right", "cheek", (1464, 773), stop=1068),
    BaseLoop("undereye_cheek_neck_left", "cheek", (8152, 7492), stop=7760),
    BaseLoop("lip_chin_neck_right", "mouth", (1461, 796), stop=475),
    BaseLoop("lip_chin_neck_left", "mouth", (8149, 7511), stop=7230),
    BaseLoop("temple_jaw_contour", "head", (6759, 15), stop=13355),
)
