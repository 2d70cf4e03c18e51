"""`doctor`: what this machine can do, and what it lacks."""

from __future__ import annotations

import os
import platform
import shutil
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path

from capture_eval.system_packages import SYSTEM_LIBRARIES, missing_libraries

PACKAGES = (
    "numpy", "scipy", "numba", "pycolmap", "pycolmap-cuda12", "open3d", "pymeshlab", "opencv-python-headless",
    "matplotlib", "plotly", "pydantic", "snakemake", "typer",
)  # fmt: skip
IMPORTS = ("pycolmap", "open3d", "pymeshlab", "cv2", "numba")
ADVISED_MEMORY_GB = 4.0
ADVISED_DISK_GB = 5.0


@dataclass(frozen=True)
class Diagnosis:
    """One fact about the machine; ``good`` is False for what stops work, ``advice`` says what to do."""

    what: str
    value: str
    good: bool = True
    advice: str = ""


def diagnose(folder: Path) -> list[Diagnosis]:
    """Facts about Python, packages, libraries, cores, memory, GPU and disk.

    Parameters
    ----------
    folder : Path
        Where results would go; its free space is measured.
    """
    return [
        *_system(),
        *(_package(name) for name in PACKAGES),
        *_libraries(),
        *(_import(name) for name in IMPORTS),
        _dense(),
        *_resources(folder),
    ]


def _system() -> list[Diagnosis]:
    version = platform.python_version_tuple()
    good = (int(version[0]), int(version[1])) >= (3, 11)
    libc = " ".join(platform.libc_ver()).strip()
    return [
        Diagnosis("system", f"{platform.platform()} ({libc or 'unknown C library'})"),
        Diagnosis("Python", platform.python_version(), good, "" if good else "install Python 3.11 or newer"),
    ]


def _package(name: str) -> Diagnosis:
    try:
        return Diagnosis(f"package {name}", metadata.version(name))
    except metadata.PackageNotFoundError:
        optional = name in ("pycolmap-cuda12", "pycolmap")  # one of the two; importing shows it
        return Diagnosis(f"package {name}", "not installed", optional, "" if optional else f"pip install {name}")


def _libraries() -> list[Diagnosis]:
    missing = missing_libraries()
    rows = []
    for name, package in SYSTEM_LIBRARIES.items():
        good = name not in missing
        advice = "" if good else f"apt-get install {package}"
        rows.append(Diagnosis(f"library {name}", "there" if good else "missing", good, advice))
    return rows


def _import(name: str) -> Diagnosis:
    """Import in a process of its own, since a broken native library may end it."""
    import subprocess
    import sys

    found = subprocess.run([sys.executable, "-c", f"import {name}"], capture_output=True, text=True, check=False)
    if found.returncode == 0:
        return Diagnosis(f"import {name}", "works")
    lines = found.stderr.strip().splitlines() or [f"ended with code {found.returncode}"]
    return Diagnosis(f"import {name}", "fails", False, lines[-1])


def _dense() -> Diagnosis:
    try:
        import pycolmap
    except ImportError:
        return Diagnosis("dense stereo", "none", False, "pip install pycolmap")
    if bool(getattr(pycolmap, "has_cuda", False)):
        if Path("/dev/nvidiactl").exists() or Path("/dev/nvidia0").exists():
            return Diagnosis("dense stereo", "CUDA (pycolmap) and CPU")
        return Diagnosis("dense stereo", "CPU", True, "pycolmap has CUDA, but no NVIDIA device is visible here")
    return Diagnosis(
        "dense stereo", "CPU", True, "for CUDA install the extra `cuda` (pycolmap-cuda12) in place of pycolmap"
    )


def _resources(folder: Path) -> list[Diagnosis]:
    import psutil

    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    memory = psutil.virtual_memory().total / 2**30
    existing = next(path for path in (folder.resolve(), *folder.resolve().parents) if path.exists())
    disk = shutil.disk_usage(existing).free / 2**30
    side_by_side = max(1, min(cores, int(memory / 2.5)))
    return [
        Diagnosis("cores", str(cores), True, f"run with --cores {side_by_side}"),
        _enough("memory", memory, ADVISED_MEMORY_GB),
        _enough(f"free disk at {existing}", disk, ADVISED_DISK_GB),
        Diagnosis("writable", str(existing), os.access(existing, os.W_OK), "choose a folder you may write to"),
    ]


def _enough(what: str, found: float, advised: float) -> Diagnosis:
    good = found >= advised
    return Diagnosis(what, f"{found:.1f} GB", good, "" if good else f"{advised:g} GB or more are advised")
