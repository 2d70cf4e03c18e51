"""The house rules that a machine can read: layers, one-way imports, nothing heavy at import, sizes."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[1] / "capture_eval"
MODULES = sorted(PACKAGE.rglob("*.py"))

# the order of the data; a package may import those before it, and the ground
PURE = (
    "images",
    "reconstruction",
    "registration",
    "curves",
    "interpolation",
    "evaluation",
    "planning",
    "editing",
    "report",
)
GROUND = ("errors", "polygon_mesh", "cameras", "similarity", "triangle_geometry", "system_packages")
ABOVE = ("files", "stages", "workflow", "command_line")
HEAVY = {"open3d", "pymeshlab", "pycolmap", "numba", "cv2", "snakemake", "plotly", "matplotlib", "pooch", "psutil"}
NO_DISK = {"pathlib", "os", "shutil", "subprocess", "tempfile", "io"}
LONGEST_FUNCTION = 60
LONGEST_MODULE = 400


def _name(path: Path) -> str:
    return str(path.relative_to(PACKAGE.parent))


def _parts(path: Path) -> tuple[str, ...]:
    return path.relative_to(PACKAGE).with_suffix("").parts


def _layer(path: Path) -> str:
    parts = _parts(path)
    if len(parts) > 1:
        return parts[0]
    return "ground" if parts[0] in GROUND else "top"


def _imports(tree: ast.AST, path: Path) -> Iterator[str]:
    """Full names of everything a tree imports, those inside functions and under TYPE_CHECKING included."""
    package = ("capture_eval", *_parts(path)[:-1])
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield alias.name
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                base = ".".join([*package[: len(package) - node.level + 1], *([base] if base else [])])
            yield base
            for alias in node.names:
                yield f"{base}.{alias.name}"


def _own_layers(tree: ast.AST, path: Path) -> set[str]:
    """Packages of capture_eval that a module imports."""
    found = set()
    for name in _imports(tree, path):
        parts = name.split(".")
        if parts[0] == "capture_eval" and len(parts) > 1 and parts[1] in (*PURE, *ABOVE):
            found.add(parts[1])
    return found


def _top_level(tree: ast.Module) -> ast.Module:
    """What runs when the module is imported: no bodies of functions or methods, nothing under TYPE_CHECKING."""
    kept: list[ast.stmt] = []
    waiting = list(tree.body)
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            continue
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test):
            continue
        if isinstance(node, ast.ClassDef):
            waiting.extend(node.body)
            continue
        kept.append(node)
    return ast.Module(kept, [])


@cache
def _tree(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


def _is_kernel_module(path: Path) -> bool:
    """Modules of compiled loops: imported inside the function that uses them, so numba may stand at their top."""
    return path.stem.endswith("_kernels")


def test_there_are_modules_to_look_at() -> None:
    assert len(MODULES) > 30


@pytest.mark.parametrize("path", MODULES, ids=_name)
def test_imports_go_one_way(path: Path) -> None:
    layer, imported = _layer(path), _own_layers(_tree(path), path)
    if layer == "ground":
        allowed: set[str] = set()
    elif layer in PURE:
        allowed = set(PURE[: PURE.index(layer) + 1])
    elif layer == "files":
        allowed = {"files", *PURE}
    elif layer in ABOVE:
        allowed = {*PURE, *ABOVE[: ABOVE.index(layer) + 1]}
    else:
        allowed = {"command_line"}
    assert imported <= allowed, f"{layer} must not import {sorted(imported - allowed)}"


@pytest.mark.parametrize("path", [p for p in MODULES if not _is_kernel_module(p)], ids=_name)
def test_nothing_heavy_is_imported_with_a_module(path: Path) -> None:
    top = {name.split(".")[0] for name in _imports(_top_level(_tree(path)), path)}
    assert not top & HEAVY


@pytest.mark.parametrize("path", MODULES, ids=_name)
def test_kernels_are_imported_lazily(path: Path) -> None:
    if _is_kernel_module(path):
        return  # kernels may use kernels
    names = {name.split(".")[-1] for name in _imports(_top_level(_tree(path)), path)}
    kernels = {name for name in names if name.endswith("_kernels")}
    assert not kernels


@pytest.mark.parametrize("path", [p for p in MODULES if _layer(p) in (*PURE, "ground")], ids=_name)
def test_pure_modules_touch_no_disk_and_print_nothing(path: Path) -> None:
    if path.stem == "system_packages":
        pytest.skip("also a script for a machine without this package")
    tree = _tree(path)
    imported = {name.split(".")[0] for name in _imports(tree, path)}
    forbidden = NO_DISK - {"io"} if _layer(path) == "report" else NO_DISK
    assert not imported & forbidden
    if _layer(path) != "report":
        assert "matplotlib" not in imported
    calls = {node.func.id for node in ast.walk(tree) if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)}
    assert not calls & {"print", "open"}


@pytest.mark.parametrize("path", MODULES, ids=_name)
def test_input_is_checked_by_errors_not_by_assert(path: Path) -> None:
    bad = [node.lineno for node in ast.walk(_tree(path)) if isinstance(node, ast.Assert)]
    bare = [n.lineno for n in ast.walk(_tree(path)) if isinstance(n, ast.ExceptHandler) and n.type is None]
    assert not bad
    assert not bare


@pytest.mark.parametrize("path", MODULES, ids=_name)
def test_functions_and_modules_fit_a_reader(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    assert text.count("\n") <= LONGEST_MODULE
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            documentation = ast.get_docstring(node, clean=False)
            assert node.end_lineno is not None
            lines = node.end_lineno - node.lineno + 1 - (documentation.count("\n") + 1 if documentation else 0)
            assert lines <= LONGEST_FUNCTION, f"{node.name} has {lines} lines"


@pytest.mark.parametrize("path", MODULES, ids=_name)
def test_every_module_says_what_it_is(path: Path) -> None:
    assert ast.get_docstring(_tree(path)) or not path.read_text(encoding="utf-8").strip()
