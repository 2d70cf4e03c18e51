"""Registration figures: every pose has a panel, failed poses say so, edges behind the surface are not drawn."""

import numpy as np
import pytest
import textured_sphere
from matplotlib.collections import LineCollection

from capture_eval.errors import InputError
from capture_eval.report import capture_figures
from capture_eval.triangle_geometry import unique_edges


def _panels(figure: object) -> list:
    return [axes for axes in figure.axes if axes.get_label() != "<colorbar>"]  # type: ignore[attr-defined]


def test_only_edges_in_front_are_drawn_over_a_photo() -> None:
    vertices, triangles, _ = textured_sphere.mesh(columns=12, rows=8)
    behind = vertices - [0.0, 0.0, 60.0]
    both = np.concatenate([vertices, behind])
    all_triangles = np.concatenate([triangles, triangles + len(vertices)])
    edges = unique_edges(all_triangles)
    view = textured_sphere.views()[1]
    photo = np.full((240, 320, 3), 90, dtype=np.uint8)
    figure = capture_figures.mesh_over_photos([photo], [view], [both], all_triangles, edges, ["front"])
    lines = [item for item in figure.axes[0].get_children() if isinstance(item, LineCollection)]
    drawn = len(lines[0].get_segments())
    front = len(unique_edges(triangles))
    assert 0.6 * front < drawn < 1.35 * front  # the rim of the ball behind shows beside the one in front


def test_maps_have_a_panel_per_pose_and_say_which_failed() -> None:
    vertices, triangles, _ = textured_sphere.mesh(columns=12, rows=8)
    failed = np.full_like(vertices, np.nan)
    values = np.linspace(0.0, 1.0, len(vertices))
    figure = capture_figures.drift_maps(
        [vertices, failed], triangles, [values, np.full(len(vertices), np.nan)], ["t = 0.0", "t = 0.3"]
    )
    panels = _panels(figure)
    assert next(p.get_title(loc="left") or p.get_title() for p in panels).startswith("t = 0.0")
    assert any(text.get_text() == "failed" for text in panels[1].texts)
    confidence = capture_figures.confidence_maps([vertices], triangles, [values], ["t = 0.0"])
    assert len(_panels(confidence)) == 1


def test_textures_are_cropped_alike() -> None:
    image = np.full((64, 64, 3), 100.0, dtype=np.float32)
    mask = np.zeros((64, 64), dtype=bool)
    mask[10:30, 5:60] = True
    figure = capture_figures.textures_side_by_side([image, image[..., 0]], [mask, mask], ["a", "b"])
    shapes = {axes.get_images()[0].get_array().shape for axes in figure.axes if axes.get_images()}
    assert shapes == {(20, 55, 3)}


def test_sequences_of_different_length_are_refused() -> None:
    with pytest.raises(InputError, match="figure"):
        capture_figures.textures_side_by_side([np.zeros((4, 4))], [], ["a"])
