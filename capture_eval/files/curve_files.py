"""Curves files: YAML or JSON, by file ending."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import yaml

from capture_eval.curves.curve_specification import CurveSpecification, dump_curves, parse_curves
from capture_eval.errors import InputError
from capture_eval.files.atomic import write_text


def read_curves(path: Path) -> tuple[CurveSpecification, ...]:
    """Read a curves file.

    Parameters
    ----------
    path : Path
        YAML (``.yaml``, ``.yml``) or JSON (``.json``) with a list ``curves``.

    Raises
    ------
    InputError
        Unreadable file, bad syntax, or a curve that is not well described; one line that names file and curve.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
        document = json.loads(text) if path.suffix.lower() == ".json" else _load_yaml(text)
    except (OSError, UnicodeDecodeError) as problem:
        raise InputError(f"{path}: cannot be read ({problem})") from problem
    except (json.JSONDecodeError, yaml.YAMLError) as problem:
        raise InputError(f"{path}: {' '.join(str(problem).split())}") from problem
    return parse_curves(document, str(path))


def _load_yaml(text: str) -> object:
    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
    return yaml.load(text, Loader=loader)  # a safe loader either way


def write_curves(path: Path, specifications: Sequence[CurveSpecification], comment: str = "") -> None:
    """Write a curves file that `read_curves` turns into the same specifications.

    Parameters
    ----------
    path : Path
        YAML or, with the ending ``.json``, JSON; written atomically.
    specifications : sequence of CurveSpecification
        Curves in order.
    comment : str
        Lines for the top of a YAML file.
    """
    path = Path(path)
    document = dump_curves(specifications)
    if path.suffix.lower() == ".json":
        write_text(path, json.dumps(document, indent=1) + "\n")
        return
    header = "".join(f"# {line}\n" for line in comment.splitlines())
    body = yaml.safe_dump(document, sort_keys=False, default_flow_style=None, width=110, allow_unicode=True)
    write_text(path, header + body)
