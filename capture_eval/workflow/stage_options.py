"""Options of the stages, taken from a manifest: defaults exist once, in the stages' own frozen dataclasses."""

from __future__ import annotations

import dataclasses
import importlib
from typing import TYPE_CHECKING, Any

import numpy as np

from capture_eval.errors import InputError
from capture_eval.files.manifest_files import read_yaml

if TYPE_CHECKING:
    from capture_eval.cameras import Intrinsics
    from capture_eval.files.manifest_files import Capture, IntrinsicsEntry

# stage -> (module of capture_eval.stages, options dataclass in it)
OPTION_CLASSES = {
    "sparse": ("sparse", "SparseOptions"),
    "dense": ("dense", "DenseOptions"),
    "surface": ("surface", "SurfaceOptions"),
    "align": ("align", "AlignOptions"),
    "register": ("register", "RegisterOptions"),
    "evaluate": ("evaluate", "EvaluateOptions"),
    "truth": ("truth", "TruthOptions"),
    "report": ("report", "ReportOptions"),
}


def options_class(stage: str) -> type:
    """The frozen dataclass with the options of a stage.

    Raises
    ------
    InputError
        If there is no such stage.
    """
    if stage not in OPTION_CLASSES:
        raise InputError(f"no stage {stage!r}; stages with options are {', '.join(OPTION_CLASSES)}")
    module, name = OPTION_CLASSES[stage]
    found = getattr(importlib.import_module(f"capture_eval.stages.{module}"), name)
    if not isinstance(found, type):
        raise TypeError(f"{module}.{name} is not a class")
    return found


def stage_options(capture: Capture, stage: str, threads: int = 1) -> Any:
    """Options of one stage: its defaults, what the manifest says, and what the manifest's other parts imply.

    Raises
    ------
    InputError
        If the manifest names an option that the stage does not have, or gives a value of the wrong type.
    """
    kind = options_class(stage)
    values = _checked(capture, stage, kind, capture.manifest.options.get(stage, {}))
    known = {field.name for field in dataclasses.fields(kind)}
    implied = _implied(capture, stage) | {"threads": threads}
    for name, value in implied.items():
        if name in known and name not in values and value is not None:
            values[name] = value
    return kind(**values)


def check_options(capture: Capture) -> None:
    """Refuse options of unknown stages, unknown options and values of the wrong type.

    Raises
    ------
    InputError
        Names the manifest, stage and option.
    """
    for stage, values in capture.manifest.options.items():
        if stage not in OPTION_CLASSES:
            raise InputError(
                f"{capture.path}: options.{stage}: no such stage; stages with options are {', '.join(OPTION_CLASSES)}"
            )
        _checked(capture, stage, options_class(stage), values)


def _checked(capture: Capture, stage: str, kind: type, values: dict[str, Any]) -> dict[str, Any]:
    """The values converted to the types of the dataclass (a YAML 3 becomes 3.0, a list a tuple)."""
    return _converted(kind, values, f"{capture.path}: options.{stage}")


def _converted(kind: type, values: dict[str, Any], where: str) -> dict[str, Any]:
    import typing

    from pydantic import TypeAdapter, ValidationError

    types = typing.get_type_hints(kind)
    converted = {}
    for name, value in values.items():
        if name not in types:
            raise InputError(f"{where}.{name}: unknown option; there are {', '.join(sorted(types))}")
        wanted = types[name]
        if dataclasses.is_dataclass(wanted) and isinstance(wanted, type) and isinstance(value, dict):
            converted[name] = wanted(**_converted(wanted, value, f"{where}.{name}"))
            continue
        try:
            converted[name] = TypeAdapter(wanted).validate_python(value)
        except ValidationError as error:
            raise InputError(f"{where}.{name}: {error.errors()[0]['msg']} (is {value!r})") from None
    return converted


def _implied(capture: Capture, stage: str) -> dict[str, Any]:
    """What other keys of the manifest say about the options of a stage."""
    manifest = capture.manifest
    if stage == "sparse":
        camera = manifest.camera
        return {
            "camera_model": camera.model,
            "share_intrinsics": camera.shared_intrinsics,
            "intrinsics": None if camera.intrinsics is None else _intrinsics(camera.intrinsics),
            "known_cameras": None if camera.known_views is None else capture.resolve(camera.known_views),
        }
    if stage == "align":
        template = manifest.template
        return {
            "shared_frame": manifest.camera.known_views is not None,
            "fixed_rig": manifest.camera.fixed_rig,
            "markers": None if manifest.markers is None else capture.resolve(manifest.markers),
            "rigid_region": rigid_region(capture),
            "template": None if template is None else capture.resolve(template.mesh),
            "landmarks": None if template is None else capture.resolve(template.landmarks),
        }
    if stage == "register":
        return {"rigid_region": rigid_region(capture)}
    if stage == "dense":
        return {"backend": manifest.dense.back_end, "max_image_size": manifest.dense.max_image_size}
    return {}


def rigid_region(capture: Capture) -> tuple[int, ...] | None:
    """Template vertices that do not move, from the manifest or the file it names.

    Raises
    ------
    InputError
        The file is not a list of vertex numbers.
    """
    region: Any = capture.manifest.rigid_region
    if isinstance(region, str):
        path = capture.resolve(region)
        region = read_yaml(path)
        if not isinstance(region, list) or not all(isinstance(vertex, int) and vertex >= 0 for vertex in region):
            raise InputError(f"{path}: must be a list of vertex numbers")
    return None if region is None else tuple(region)


def _intrinsics(entry: IntrinsicsEntry) -> Intrinsics:
    from capture_eval.cameras import Intrinsics

    matrix = np.eye(3)
    matrix[0, 0], matrix[1, 1] = entry.focal_length
    matrix[:2, 2] = entry.principal_point
    return Intrinsics(entry.width, entry.height, matrix, np.array(entry.distortion))
