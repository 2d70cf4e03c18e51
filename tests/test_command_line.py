"""The command line: every verb answers --help with an example, errors are one line, exit codes are as documented."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from fake_stages import command
from small_capture import write_capture

from capture_eval import __version__
from capture_eval.command_line.main import HIDDEN, VERBS

REPOSITORY = Path(__file__).parents[1]


def _call(*arguments: str, cwd: Path = REPOSITORY, **environment: str) -> subprocess.CompletedProcess[str]:
    import os

    env = {**os.environ, "PYTHONPATH": str(REPOSITORY), "COLUMNS": "120", **environment}
    return subprocess.run(command(*arguments), capture_output=True, text=True, check=False, cwd=cwd, env=env)


def test_help_lists_the_verbs() -> None:
    found = _call("--help")
    assert found.returncode == 0
    for verb, _, _ in VERBS:
        assert (f"\n  {verb} " in found.stdout) == (verb not in HIDDEN)


@pytest.mark.parametrize("verb", [verb for verb, _, _ in VERBS])
def test_every_verb_has_help_with_an_example(verb: str) -> None:
    found = _call(verb, "--help")
    assert found.returncode == 0, found.stderr
    assert "Example: capture-eval" in " ".join(found.stdout.split())


def test_nothing_heavy_is_imported_for_help() -> None:
    code = (
        "import sys; from capture_eval.command_line.main import build_application; build_application(); "
        "heavy = {'open3d','pycolmap','pymeshlab','cv2','numba','snakemake','plotly','matplotlib','scipy','pydantic'}; "
        "print(sorted(heavy & set(sys.modules)))"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=REPOSITORY)
    assert found.stdout.strip() == "[]"


def test_the_version() -> None:
    assert _call("--version").stdout == f"capture-eval {__version__}\n"


@pytest.mark.parametrize(
    ("arguments", "code"),
    [
        ((), 2),
        (("nonsense",), 2),
        (("run",), 2),
        (("run", "x.yaml"), 2),
        (("run", "x.yaml", "--out", "o", "--cores", "none"), 2),
        (("run", "x.yaml", "--out", "o", "--cores", "0"), 2),
        (("validate", "none.yaml"), 1),
        (("run", "none.yaml", "--out", "out"), 1),
        (("compare", "none.yaml", "--out", "out"), 1),
        (("check", "none", "--baseline", "none.json"), 1),
        (("data", "fetch", "none"), 1),
        (("stage", "scan", "--out", "none"), 1),
    ],
)
def test_exit_codes_and_one_line(arguments: tuple[str, ...], code: int, tmp_path: Path) -> None:
    found = _call(*arguments, cwd=tmp_path)
    assert found.returncode == code, found.stderr
    assert "Traceback" not in found.stderr
    if code == 1:
        assert found.stderr.startswith("capture-eval: ")
        assert found.stderr.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_validate_prints_one_line_per_problem(tmp_path: Path) -> None:
    manifest = write_capture(tmp_path / "capture")
    good = _call("validate", str(manifest))
    assert (good.returncode, good.stdout) == (0, f"{manifest}: good, 2 poses\n")
    (manifest.parent / "pose_0" / "view_1.jpg").write_bytes(b"")
    (manifest.parent / "pose_1" / "view_2.jpg").write_text("text")
    bad = _call("validate", str(manifest))
    assert bad.returncode == 1
    assert len(bad.stdout.splitlines()) == 3
    assert "view_1.jpg: empty file (0 bytes)" in bad.stdout
    assert bad.stdout.endswith("2 problems found\n")


def test_run_refuses_what_no_stage_can_work_around(tmp_path: Path) -> None:
    manifest = write_capture(tmp_path / "capture")
    (manifest.parent / "curves.yaml").write_text("curves: [{name: far, vertices: [0, 999], closed: false}]\n")
    found = _call("run", str(manifest), "--out", str(tmp_path / "out"))
    assert found.returncode == 1
    assert "curve 'far': vertex 999 is not in the mesh" in found.stderr
    assert found.stderr.splitlines()[-1].endswith("1 of the problems above must be solved first")


def test_no_permission_and_a_file_in_the_way_are_one_line(tmp_path: Path) -> None:
    manifest = write_capture(tmp_path / "capture")
    (tmp_path / "file").write_text("in the way")
    found = _call("run", str(manifest), "--out", str(tmp_path / "file"))
    assert found.returncode == 1
    assert "Traceback" not in found.stderr
    assert str(tmp_path / "file") in found.stderr.splitlines()[-1]


def test_meshes_are_sent_to_compare_and_photos_to_run(tmp_path: Path) -> None:
    manifest = write_capture(tmp_path / "capture")
    assert "compare needs `source: meshes`" in _call("compare", str(manifest), "--out", str(tmp_path / "o")).stderr
    text = (
        "name: m\nsource: meshes\nposes: [{t: 0.0, mesh: template.obj}, {t: 1.0, mesh: b.obj}]\ncurves: curves.yaml\n"
    )
    meshes = manifest.parent / "meshes.yaml"
    meshes.write_text(text)
    (manifest.parent / "b.obj").write_bytes((manifest.parent / "template.obj").read_bytes())
    assert "use capture-eval compare" in _call("run", str(meshes), "--out", str(tmp_path / "o")).stderr


def test_compare_evaluates_meshes_without_the_engine(tmp_path: Path) -> None:
    """Three grids that move on a straight line: linear interpolation is exact, its E_M is rounding."""
    from small_capture import grid_mesh

    from capture_eval.files.mesh_files import write_mesh

    grid = grid_mesh()
    for index, t in enumerate((0.0, 0.25, 1.0)):
        moved = grid.vertices.copy()
        moved[14, 2] += 2.0 * t
        write_mesh(tmp_path / f"{index}.obj", grid.with_vertices(moved))
    (tmp_path / "curves.yaml").write_text("curves: [{name: row, vertices: [13, 14, 15], closed: false}]\n")
    manifest = tmp_path / "m.yaml"
    manifest.write_text(
        "name: m\nsource: meshes\ncurves: curves.yaml\nmethods: [linear, pde_quadratic]\n"
        "poses: [{t: 0.0, mesh: 0.obj}, {t: 0.25, mesh: 1.obj}, {t: 1.0, mesh: 2.obj}]\n"
    )
    found = _call("compare", str(manifest), "--out", str(tmp_path / "out"))
    assert found.returncode == 0, found.stderr
    assert found.stdout.strip() == f"report: {tmp_path / 'out' / 'report' / 'report.html'}"
    rows = (tmp_path / "out" / "report" / "errors.csv").read_text().splitlines()
    errors = {row.split(",")[0]: float(row.split(",")[5]) for row in rows[1:]}
    diameter = (5.0**2 + 5.0**2 + 2.5**2) ** 0.5
    assert errors["linear"] == pytest.approx(0.0, abs=1e-12)
    # an open curve of three points has one harmonic, B = k pi^4, whose warp is t (t - 2a) / (1 - 2a) with a = c / B
    a, t = np.pi**-4, 0.25
    assert errors["pde_quadratic"] == pytest.approx(2.0 * (t - t * (t - 2 * a) / (1 - 2 * a)) / diameter, rel=1e-9)


def test_data_sets_come_from_a_folder_and_only_as_they_should_be(tmp_path: Path) -> None:
    upstream = REPOSITORY.parent / "shared" / "data" / "makehuman_upstream"
    if not upstream.is_dir():
        pytest.skip("the upstream files of MakeHuman are not beside this checkout")
    cache = {"CAPTURE_EVAL_DATA": str(tmp_path / "cache")}
    first = _call("data", "fetch", "makehuman", "--from", str(upstream), **cache)
    assert "17 files brought" in first.stdout
    assert "0 files brought" in _call("data", "fetch", "makehuman", "--from", str(tmp_path), **cache).stdout
    target = tmp_path / "cache" / "makehuman" / "makehuman" / "data" / "3dobjs" / "base.obj"
    target.write_text("damaged")
    refused = _call("data", "fetch", "makehuman", "--from", str(tmp_path), **cache)
    assert refused.returncode == 1
    assert "base.obj: no such file" in refused.stderr
    assert "1 files brought" in _call("data", "fetch", "makehuman", "--from", str(upstream), **cache).stdout


def test_doctor_looks_at_everything_and_names_missing_packages(monkeypatch: pytest.MonkeyPatch) -> None:
    from capture_eval import system_packages
    from capture_eval.stages import doctor

    rows = {row.what: row for row in doctor.diagnose(REPOSITORY)}
    for what in (
        "Python",
        "package pycolmap",
        "library libgomp.so.1",
        "import open3d",
        "dense stereo",
        "memory",
        "cores",
    ):
        assert what in rows
    assert rows["Python"].good
    monkeypatch.setitem(system_packages.SYSTEM_LIBRARIES, "libnot-there.so.9", "libnot-there9")
    row = next(row for row in doctor._libraries() if row.what == "library libnot-there.so.9")
    assert (row.good, row.advice) == (False, "apt-get install libnot-there9")
    assert "libnot-there9" in system_packages.missing_packages()
