"""``capture-eval plan``: files in, files out, one line for what is wrong."""

from __future__ import annotations

import csv
import json
import subprocess
from pathlib import Path

import numpy as np
import pytest
from fake_stages import command
from synthetic_rigs import bump_rig, tiny_rig, tiny_target

from capture_eval.errors import InputError
from capture_eval.files.atomic import write_npz
from capture_eval.files.mesh_files import read_mesh, write_mesh
from capture_eval.files.plan_rule_files import NamedRules, read_plan_rules
from capture_eval.files.rig_files import read_rig
from capture_eval.planning.blendshape_rig import BlendshapeRig
from capture_eval.planning.planner import PlanOptions
from capture_eval.polygon_mesh import PolygonMesh
from capture_eval.report.plan_sheet import group_labels
from capture_eval.stages.plan import PlanRequest, plan_capture

REPOSITORY = Path(__file__).parents[1]


def write_rig(folder: Path, rig: BlendshapeRig, ending: str = ".obj") -> Path:
    """Neutral and shapes as files."""
    neutral = PolygonMesh.from_faces(rig.neutral, rig.triangles)
    write_mesh(folder / f"neutral{ending}", neutral)
    for name, shape in zip(rig.names, rig.shapes, strict=True):
        write_mesh(folder / f"{name}{ending}", neutral.with_vertices(shape))
    return folder


def _tiny_request(folder: Path, **fields: object) -> PlanRequest:
    write_rig(folder / "rig", tiny_rig())
    target = folder / "target.obj"
    write_mesh(target, PolygonMesh.from_faces(tiny_target(), tiny_rig().triangles))
    rules = NamedRules(pairs=(("shape_4", "shape_5"),))
    options = PlanOptions(alpha=1.0, symmetry="given", mode="minimum")
    return PlanRequest(**({"rig": folder / "rig", "target": target, "rules": rules, "options": options} | fields))  # type: ignore[arg-type]


def test_the_tiny_plan_on_disk(tmp_path: Path) -> None:
    out = tmp_path / "out"
    plan_capture(_tiny_request(tmp_path), out)
    document = json.loads((out / "plan.json").read_text())
    found = [[shape["name"] for shape in part["shapes"]] for part in document["expressions"]]
    assert found == [["shape_0", "shape_2", "shape_4", "shape_5"], ["shape_1", "shape_3"]]
    assert document["expressions"][0]["importance"] == pytest.approx(1.45)
    assert document["fewest"]["proven_fewest"]
    rows = list(csv.DictReader((out / "plan.csv").read_text().splitlines()))
    assert {row["shape"]: row["expression"] for row in rows}["shape_3"] == "2"
    assert {row["weight"] for row in rows} == {"1.0"}
    # The meshes are the target's neutral with the rig's displacements.
    rig = tiny_rig()
    mesh = read_mesh(out / "meshes" / "expression_02.obj")
    assert mesh.vertices == pytest.approx(tiny_target() + rig.displacements[1] + rig.displacements[3])
    assert read_mesh(out / "meshes" / "expression_00_neutral.obj").vertices == pytest.approx(tiny_target())
    page = (out / "plan.html").read_text()
    assert "no plan does with fewer (proven)" in page
    assert page.count("data:image/png") == 4  # curve, neutral, two expressions
    for name in ("plan_sheet", "coverage"):
        assert (out / "figures" / f"{name}.png").stat().st_size > 1000
        assert (out / "figures" / f"{name}.pdf").read_bytes().startswith(b"%PDF")


def test_two_plans_of_one_rig_are_the_same_bytes_and_old_meshes_go(tmp_path: Path) -> None:
    out = tmp_path / "out"
    greedy = _tiny_request(tmp_path, options=PlanOptions(alpha=1.0, symmetry="given"))
    plan_capture(greedy, out)
    assert (out / "meshes" / "expression_03.obj").exists()
    plan_capture(_tiny_request(tmp_path), out)
    assert not (out / "meshes" / "expression_03.obj").exists()
    plan_capture(_tiny_request(tmp_path), tmp_path / "again")
    for path in sorted(out.rglob("*.*")):
        assert path.read_bytes() == (tmp_path / "again" / path.relative_to(out)).read_bytes(), path.name


def test_every_way_of_storing_a_rig_reads_the_same(tmp_path: Path) -> None:
    rig = bump_rig(9, 11, 2, 1, 0)
    order = np.argsort(rig.names)
    places = [write_rig(tmp_path / "obj", rig), write_rig(tmp_path / "ply", rig, ".ply")]
    places += [tmp_path / "stack.npz", tmp_path / "named.npz", tmp_path / "mixed", tmp_path / "single"]
    faces = rig.triangles
    write_npz(places[2], {"neutral": rig.neutral, "shapes": rig.shapes, "names": np.array(rig.names), "faces": faces})
    named = dict(zip(rig.names, rig.shapes, strict=True))
    write_npz(places[3], {"neutral": rig.neutral, "triangles": faces, **named})
    write_mesh(places[4] / "neutral.obj", PolygonMesh.from_faces(rig.neutral, faces))
    write_npz(places[4] / "shapes.npz", named)
    for name, shape in {"neutral": rig.neutral, **named}.items():
        write_npz(places[5] / f"{name}.npz", {"vertices": shape, "faces": faces})
    for place in places:
        found = read_rig(place).rig
        assert found.names == tuple(rig.names[k] for k in order)
        assert np.array_equal(found.shapes, rig.shapes[order])
        assert np.array_equal(found.triangles, faces)


def test_bad_rig_folders(tmp_path: Path) -> None:
    rig = tiny_rig()
    with pytest.raises(InputError, match="there is no such folder"):
        read_rig(tmp_path / "none")
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match=r"no \.obj, \.ply or \.npz file"):
        read_rig(tmp_path / "empty")
    place = write_rig(tmp_path / "rig", rig)
    with pytest.raises(InputError, match=r"no mesh is called 'rest' \(found neutral, shape_0"):
        read_rig(place, "rest")
    other = PolygonMesh.from_faces(rig.neutral[:9], [[0, 1, 2]])
    write_mesh(place / "wrong.obj", other)
    with pytest.raises(InputError, match=r"wrong\.obj: wrong has 9 vertices, neutral has 10"):
        read_rig(place)
    write_mesh(place / "wrong.obj", PolygonMesh.from_faces(rig.neutral, rig.triangles[:, [1, 2, 0]]))
    with pytest.raises(InputError, match=r"wrong\.obj: wrong has other faces than neutral"):
        read_rig(place)
    (place / "wrong.obj").unlink()
    write_npz(place / "more.npz", {"shape_1": rig.neutral})
    with pytest.raises(InputError, match=r"shape_1\.obj: a mesh called shape_1 was read from more\.npz already"):
        read_rig(place)
    write_npz(tmp_path / "bare.npz", {"neutral": rig.neutral, "a": rig.shapes[0]})
    with pytest.raises(InputError, match="no faces; add an array 'faces'"):
        read_rig(tmp_path / "bare.npz")
    write_npz(tmp_path / "nothing.npz", {"x": np.zeros(3)})
    with pytest.raises(InputError, match="neither 'vertices', 'shapes' nor arrays"):
        read_rig(tmp_path / "nothing.npz")
    write_npz(tmp_path / "nan.npz", {"neutral": rig.neutral, "a": rig.shapes[0] * np.nan, "faces": rig.triangles})
    with pytest.raises(InputError, match=r"nan\.npz: rig: shape a holds numbers that are not finite"):
        read_rig(tmp_path / "nan.npz")
    write_mesh(tmp_path / "small.obj", other)
    with pytest.raises(InputError, match="target must have the rig's topology"):
        plan_capture(_tiny_request(tmp_path / "t", target=tmp_path / "small.obj"), tmp_path / "out")
    with pytest.raises(InputError, match="masked vertex 10"):
        plan_capture(_tiny_request(tmp_path / "t", rules=NamedRules(masked_vertices=(10,))), tmp_path / "out")
    with pytest.raises(InputError, match="the rig has no shape 'smile'"):
        plan_capture(_tiny_request(tmp_path / "t", rules=NamedRules(left_out=("smile",))), tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[1]", "expected a mapping"),
        ("pair: []", "unknown key 'pair'"),
        ("pairs: [a]", "'pairs' is a list of names of shapes"),
        ("left_out: a", "'left_out' is a list"),
        ("never_together: 3", "'never_together' is a list of lists"),
        ("expressions: {one: {include: [a]}}", "expressions: one"),
        ("expressions: {1: {inside: [a]}}", "expressions: 1"),
        ("masked_vertices: [a]", "list of whole numbers"),
    ],
)
def test_bad_rule_files(text: str, message: str, tmp_path: Path) -> None:
    (tmp_path / "rules.yaml").write_text(text)
    with pytest.raises(InputError, match=message):
        read_plan_rules(tmp_path / "rules.yaml")


def test_labels_of_groups() -> None:
    assert group_labels(("blink_L", "blink_R")) == ("blink (L + R)",)
    assert group_labels(("LeftBrowUp", "RightBrowUp")) == ("BrowUp (L + R)",)
    assert group_labels(("LeftEyeRight", "RightEyeLeft")) == ("LeftEyeRight + RightEyeLeft",)
    assert group_labels(("LeftEyeLeft", "RightEyeRight")) == ("LeftEyeLeft + RightEyeRight",)
    assert group_labels(("jaw",)) == ("jaw",)
    assert len(group_labels(("x" * 30, "y" * 30))) == 2


def test_the_command_with_rules_and_its_exit_codes(tmp_path: Path) -> None:
    def call(*arguments: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(command("plan", *arguments), capture_output=True, text=True, check=False, cwd=REPOSITORY)

    place = str(write_rig(tmp_path / "rig", tiny_rig()))
    out = str(tmp_path / "out")
    (tmp_path / "rules.yaml").write_text(
        "never_together: [[shape_0, shape_3]]\nexpressions: {1: {include: [shape_1]}}\n"
    )
    good = call(
        place, "--out", out, "--rules", str(tmp_path / "rules.yaml"), "--pair", "shape_4,shape_5", "--symmetry",
        "given", "--no-pictures", "--exclude", "1:shape_3",
    )  # fmt: skip
    assert good.returncode == 0, good.stderr
    document = json.loads((tmp_path / "out" / "plan.json").read_text())
    found = [{shape["name"] for shape in part["shapes"]} for part in document["expressions"]]
    assert found[0] == {"shape_1"}
    assert not any({"shape_0", "shape_3"} <= part for part in found)
    assert f"{len(found)} expressions" in good.stdout
    for bad, code in (
        ((place, "--out", out, "--threshold", "0"), 1),
        ((place, "--out", out, "--leave-out", "smile"), 1),
        ((str(tmp_path / "none"), "--out", out), 1),
        ((place, "--out", out, "--view", "behind"), 1),
        ((place, "--out", out, "--mode", "fast"), 2),
        ((place, "--out", out, "--include", "shape_1"), 2),
    ):
        failed = call(*bad)
        assert failed.returncode == code, failed.stderr
        assert "Traceback" not in failed.stderr
        if code == 1:
            assert failed.stderr.strip().splitlines()[-1].startswith("capture-eval: ")
