"""Stages that do nothing but say so: the engine, its keys, markers, locks and logs around them are the real ones.

``environment`` makes every Python process of a run replace the calls of its steps when it starts.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

REPOSITORY = Path(__file__).parents[1]

HOOK = """
import importlib.abc, importlib.util, os, sys

class Replacer(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path, target=None):
        if name != "capture_eval.workflow.step_calls":
            return None
        sys.meta_path.remove(self)
        spec = importlib.util.find_spec(name)
        load = spec.loader.exec_module
        def exec_module(module):
            load(module)
            for step in module.STEP_CALLS:
                module.STEP_CALLS[step] = fake(module, step)
        spec.loader.exec_module = exec_module
        return spec

def fake(module, step):
    def call(context):
        import logging, time
        from capture_eval.errors import InputError, ReconstructionError
        title = step if context.pose is None else f"{step} {context.pose}"
        logging.getLogger("capture_eval.fake").info("%s: halfway", title)
        print("a native library says something")
        time.sleep(float(os.environ.get("FAKE_SECONDS", "0")))
        if os.environ.get("FAKE_FAILURE") == title:
            raise ReconstructionError("no two photos match")
        if os.environ.get("FAKE_BAD_INPUT") == title:
            raise InputError("template.obj: no such vertex")
        if os.environ.get("FAKE_CRASH") == title:
            os.kill(os.getpid(), 9)
        for name in module.STEP_OUTPUTS.get(step, ()):
            path = context.out / name.format(pose=context.pose)
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(title)
        with open(os.environ["FAKE_RECORD"], "a") as stream:
            stream.write(title + "\\\\n")
    return call

sys.meta_path.insert(0, Replacer())
""".replace("\\\\n", "\\n")


def environment(folder: Path, **settings: str) -> dict[str, str]:
    """Environment of a command whose steps are fake; `folder` gets the hook and the record of finished steps."""
    folder.mkdir(exist_ok=True)
    (folder / "sitecustomize.py").write_text(HOOK)
    paths = [str(folder), str(REPOSITORY)]
    values = {"PYTHONPATH": os.pathsep.join(paths), "FAKE_RECORD": str(folder / "record.txt")}
    return {**os.environ, **values, **settings}


def finished_steps(folder: Path) -> list[str]:
    """Steps that ended well since the record was last cleared, in order."""
    record = folder / "record.txt"
    return record.read_text().splitlines() if record.is_file() else []


def clear_record(folder: Path) -> None:
    (folder / "record.txt").unlink(missing_ok=True)


def command(*arguments: str) -> list[str]:
    return [sys.executable, "-m", "capture_eval", *arguments]
