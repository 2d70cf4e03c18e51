"""System packages that Python wheels cannot bring: which are missing here, and the Debian/Ubuntu package of each.

Also a script for a machine that has nothing but Python (so only the standard library, and no newer syntax):
``python3 capture_eval/system_packages.py`` says what is missing, with ``--install`` it installs it (as root).
"""

from __future__ import annotations

import ctypes
import os
import subprocess
import sys

# library that the wheels of Open3D, PyMeshLab or COLMAP load -> Debian/Ubuntu package that has it
SYSTEM_LIBRARIES = {
    "libGL.so.1": "libgl1",
    "libEGL.so.1": "libegl1",
    "libOpenGL.so.0": "libopengl0",
    "libgomp.so.1": "libgomp1",
    "libusb-1.0.so.0": "libusb-1.0-0",
    "libX11.so.6": "libx11-6",
    "libglib-2.0.so.0": "libglib2.0-0",
}
OLDEST_PYTHON = (3, 11)


def missing_libraries() -> dict[str, str]:
    """Libraries that cannot be loaded, with the package that has each."""
    missing = {}
    for library, package in SYSTEM_LIBRARIES.items():
        try:
            ctypes.CDLL(library)
        except OSError:
            missing[library] = package
    return missing


def missing_packages() -> list[str]:
    """Debian/Ubuntu packages to install, python3-venv included."""
    packages = set(missing_libraries().values())
    try:
        import ensurepip

        del ensurepip
    except ImportError:
        packages.add("python3-venv")
    return sorted(packages)


def main(arguments: list[str]) -> int:
    """Say or install what is missing; 0 when nothing is."""
    if sys.version_info[:2] < OLDEST_PYTHON:
        found = ".".join(str(part) for part in sys.version_info[:2])
        sys.stderr.write(f"Python {found} is too old; 3.11 or newer is needed (make PYTHON=python3.12 ...)\n")
        return 1
    packages = missing_packages()
    if not packages:
        return 0
    command = ["apt-get", "install", "-y", "--no-install-recommends", *packages]
    if "--install" not in arguments:
        sys.stderr.write(f"Missing system packages: {' '.join(packages)}\n")
        sys.stderr.write(f"Install them with `make system-packages` (as root), or: {' '.join(command)}\n")
        return 1
    if os.geteuid() != 0:
        sys.stderr.write(f"Not root; run: sudo {' '.join(command)}\n")
        return 1
    environment = dict(os.environ, DEBIAN_FRONTEND="noninteractive")
    subprocess.check_call(["apt-get", "update", "-q"], env=environment)
    subprocess.check_call(command, env=environment)
    left = missing_packages()
    if left:
        sys.stderr.write(f"Still missing after the installation: {' '.join(left)}\n")
    return 1 if left else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
