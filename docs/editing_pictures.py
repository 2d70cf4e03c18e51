"""Draws the pictures of editing.md: python docs/editing_pictures.py (the embedded mannequin, about a minute)."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from capture_eval.cameras import Intrinsics, View, project
from capture_eval.editing.control_targets import ControlPoint
from capture_eval.editing.dense_correspondence import dense_correspondence
from capture_eval.editing.example_blending import blend_whole_face
from capture_eval.editing.expression_cloning import edit_through_template, motion_transfer
from capture_eval.editing.expression_editor import EditOptions, ExpressionEditor
from capture_eval.editing.principal_components import fit_components, principal_components
from capture_eval.editing.projection import Projection
from capture_eval.editing.radial_influence import RadialInfluenceEditor
from capture_eval.files.atomic import write_bytes
from capture_eval.images.mannequin import build_mannequin
from capture_eval.report.editing_sheet import (
    START_COLOUR,
    TARGET_COLOUR,
    EditPanel,
    drag_panels,
    draw_edit_sheet,
    map_colours,
)
from capture_eval.report.figure_style import paper_style

HERE = Path(__file__).parent
AMOUNTS = np.linspace(0.1, 1.0, 10)
HEAD = build_mannequin()
EXAMPLES = np.array([HEAD.skin.vertices, *(HEAD.pose(m, a)[0] for m in HEAD.motions for a in AMOUNTS)])
TRIANGLES = HEAD.skin.triangles()[0]
MARK = HEAD.landmarks


def face_view(width: int = 420, height: int = 560) -> View:
    """A long lens on the whole head, a little from the left."""
    angle = np.radians(14.0)
    turn = np.array([[np.cos(angle), 0, -np.sin(angle)], [0, 1, 0], [np.sin(angle), 0, np.cos(angle)]])
    rotation = np.diag([1.0, -1.0, -1.0]) @ turn
    focal = 2.75 * height
    matrix = np.array([[focal, 0.0, width / 2], [0.0, focal, height / 2], [0.0, 0.0, 1.0]])
    middle = rotation @ np.array([14.0, -25.0, 20.0])
    translation = np.array([-middle[0], -middle[1], 850.0 - middle[2]])
    return View("face", Intrinsics(width, height, matrix, np.zeros(4)), rotation, translation)


def drag(name: str, right: float, down: float, view: View) -> ControlPoint:
    """A landmark dragged by some pixels."""
    pixel = project(view, EXAMPLES[0, [MARK[name]]])[0][0]
    return ControlPoint(MARK[name], (float(pixel[0] + right), float(pixel[1] + down)))


def smile(name: str, view: View) -> ControlPoint:
    """A landmark dragged to where the full grin has it."""
    pixel = project(view, EXAMPLES[[2 * len(AMOUNTS)], MARK[name]])[0][0]
    return ControlPoint(MARK[name], (float(pixel[0]), float(pixel[1])))


def save(name: str, rows: list[list[EditPanel]], view: View) -> None:
    """Draw, reduce to 256 colours, write."""
    with paper_style():
        buffer = io.BytesIO()
        draw_edit_sheet(rows, TRIANGLES, view).savefig(buffer, format="png", dpi=150, metadata={"Software": None})
    full = Image.open(buffer).convert("RGB")
    chosen = full.quantize(248).getpalette() or []
    marks = [channel for colour in (START_COLOUR, TARGET_COLOUR) for channel in bytes.fromhex(colour[1:])]
    palette = Image.new("P", (1, 1))
    palette.putpalette([*chosen[: 3 * 248], *marks, 255, 255, 255])
    picture = full.quantize(palette=palette, dither=Image.Dither.FLOYDSTEINBERG)
    out = io.BytesIO()
    picture.save(out, "PNG", optimize=True)
    write_bytes(HERE / name, out.getvalue())


def kinds_of_edits(editor: ExpressionEditor, view: View) -> list[list[EditPanel]]:
    """One corner up, lip too far, brow and lip, asymmetric: the paper's kinds."""
    screen = Projection.from_view(view)
    edits = {
        "one corner up": [smile("lip_corner_left", view)],
        "lip dragged too far": [drag("lip_lower_bottom", 0, 150, view)],
        "brow and lip": [drag("brow_left", -1, 8, view), drag("lip_lower_bottom", 6, 40, view)],
        "asymmetric": [
            smile("lip_corner_left", view),
            drag("lip_corner_right", 0, 0, view),
            drag("lip_lower_bottom", 0, 0, view),
        ],
    }
    return [drag_panels(EXAMPLES[0], editor.edit(points, screen), view, title) for title, points in edits.items()]


def influence_row(editor: ExpressionEditor, view: View) -> list[list[EditPanel]]:
    """Coherency of single points."""
    names = {
        "mouth corner": "lip_corner_left",
        "lower lip": "lip_lower_bottom",
        "brow": "brow_left",
        "upper lid": "lid_upper_left",
    }
    screen = Projection.from_view(view)
    panels = []
    for title, name in names.items():
        edit = editor.edit([drag(name, 0, 0, view)], screen)
        start = project(view, EXAMPLES[0, [MARK[name]]])[0]
        panels.append(EditPanel(title, EXAMPLES[0], "", map_colours(edit.coherency[:, 0]), start))
    return [panels]


def methods(editor: ExpressionEditor, view: View) -> list[list[EditPanel]]:
    """The same drags given to every method."""
    screen = Projection.from_view(view)
    printed = ExpressionEditor(EXAMPLES, EditOptions.printed())
    radial = RadialInfluenceEditor(EXAMPLES)
    model = principal_components(editor.motion)
    questions = {
        "one-sided smile": [smile("lip_corner_left", view), drag("lip_corner_right", 0, 0, view)],
        "brow and lip": [drag("brow_left", -1, 8, view), drag("lip_lower_bottom", 6, 40, view)],
    }
    rows = []
    for title, points in questions.items():
        vertices = [point.vertex for point in points]
        starts, _ = project(view, EXAMPLES[0, vertices])
        targets = np.array([point.target for point in points])
        answers: dict[str, NDArray[np.float64]] = {
            "this editor": editor.edit(points, screen).vertices,
            "as printed": printed.edit(points, screen).vertices,
            "distance only (Zhang)": radial.edit(points, screen).vertices,
            "whole face": blend_whole_face(editor.motion, points, screen).vertices,
            "PCA": fit_components(editor.motion, model, points, screen).vertices,
        }
        row = [EditPanel(title, EXAMPLES[0], "", None, starts, targets)]
        for name, face in answers.items():
            reached, _ = project(view, face[vertices])
            miss = np.linalg.norm(reached - targets, axis=1).max()
            row.append(EditPanel(name, face, f"miss {miss:.1f} px", None, None, targets, reached))
        rows.append(row)
    return rows


def cloned_edits(editor: ExpressionEditor, view: View) -> list[list[EditPanel]]:
    """Another person, of whom only the neutral face is known, edited through the examples."""
    other = build_mannequin(4)
    rest = other.skin.vertices
    pairs = np.array([[vertex, other.landmarks[name]] for name, vertex in MARK.items()])
    transfer = motion_transfer(HEAD.skin, other.skin, dense_correspondence(HEAD.skin, other.skin, pairs))
    screen = Projection.from_view(view)
    questions: dict[str, dict[str, tuple[float, float]]] = {
        "one-sided smile": {"lip_corner_left": (8.0, -6.0), "lip_corner_right": (0.0, 0.0)},
        "mouth open": {"lip_lower_bottom": (4.0, 34.0)},
        "brow down": {"brow_left": (-1.0, 7.0)},
    }
    rows = []
    for title, drags in questions.items():
        vertices = [other.landmarks[name] for name in drags]
        starts, _ = project(view, rest[vertices])
        targets = starts + np.array(list(drags.values()))
        points = [ControlPoint(v, (float(p[0]), float(p[1]))) for v, p in zip(vertices, targets, strict=True)]
        face, edit = edit_through_template(editor, transfer, points, screen)
        reached, _ = project(view, face[vertices])
        miss = np.linalg.norm(reached - targets, axis=1).max()
        row = [EditPanel(title, rest, "", None, starts, targets)]
        row.append(EditPanel("result", face, f"miss {miss:.1f} px", None, None, targets, reached))
        rows.append([*row, EditPanel("the template", edit.vertices)])
    return rows


def main() -> None:
    """Write the four pictures."""
    view, editor = face_view(), ExpressionEditor(EXAMPLES)
    save("editing_kinds.png", kinds_of_edits(editor, view), view)
    save("editing_influence.png", influence_row(editor, view), view)
    save("editing_methods.png", methods(editor, view), view)
    save("editing_cloned.png", cloned_edits(editor, view), view)


if __name__ == "__main__":
    main()
