"""The command ``capture-eval``: its verbs and the one door through which errors leave.

The modules of the verbs import nothing heavy, so that ``--help`` answers at once.
"""

from __future__ import annotations

import importlib
import os
import sys
from typing import Annotated, NoReturn

import typer

from capture_eval import __version__
from capture_eval.errors import CaptureEvalError, StageError

# verb, module of capture_eval.command_line, name in it (a function, or an application with verbs of its own)
VERBS = (
    ("synthesize", "synthesize", "synthesize"),
    ("validate", "validate", "validate"),
    ("landmarks", "landmarks", "landmarks"),
    ("run", "run", "run"),
    ("compare", "compare", "compare"),
    ("check", "check", "check"),
    ("plan", "plan", "plan"),
    ("blend", "blend", "blend"),
    ("edit", "edit", "edit"),
    ("doctor", "doctor", "doctor"),
    ("data", "data", "application"),
    ("curves", "curves", "application"),
    ("dense", "dense", "dense"),
    ("stage", "stage", "stage"),
)
HIDDEN = {"stage"}
INPUT_ERROR, STAGE_ERROR = 1, 3  # 2 is a usage error, typer's own

SUMMARY = """From photos of a moving face to error tables of shape interpolation, without a GPU and without hand work.

Example: capture-eval synthesize mannequin --out capture, then capture-eval run capture/manifest.yaml --out result
"""


def build_application() -> typer.Typer:
    """The command with all its verbs."""
    application = typer.Typer(
        add_completion=False,
        no_args_is_help=True,
        pretty_exceptions_enable=False,
        rich_markup_mode=None,
        help=SUMMARY,
        context_settings={"help_option_names": ["-h", "--help"]},
    )
    application.callback()(_common)
    for verb, module_name, attribute in VERBS:
        target = getattr(importlib.import_module(f"capture_eval.command_line.{module_name}"), attribute)
        if isinstance(target, typer.Typer):
            application.add_typer(target, name=verb)
        else:
            application.command(verb, hidden=verb in HIDDEN)(target)
    return application


def main() -> NoReturn:
    """Run the command; an error of the suite becomes one line and an exit code, any other a traceback."""
    try:
        build_application()()
    except StageError as error:
        _leave(error, STAGE_ERROR)
    except CaptureEvalError as error:
        _leave(error, INPUT_ERROR)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(INPUT_ERROR)
    except OSError as error:
        if error.filename is None and error.errno is None:
            raise
        where = f"{error.filename}: " if error.filename is not None else ""
        _leave(f"{where}{error.strerror or error}", INPUT_ERROR)
    sys.exit(0)


def _leave(message: object, code: int) -> NoReturn:
    line = " ".join(str(message).split())
    print(f"capture-eval: {line}", file=sys.stderr)
    sys.exit(code)


def _print_version(wanted: bool) -> None:
    if wanted:
        print(f"capture-eval {__version__}")
        raise typer.Exit


def _common(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and leave.")
    ] = False,
) -> None:
    del version
