"""The manifest: one YAML file that says what was photographed and what to do with it.

The models refuse unknown keys, paths that leave the manifest's folder and times that are not a sequence from 0 to 1.
Whether the named files exist and are any good is the business of :mod:`capture_eval.stages.validate`.
"""

from __future__ import annotations

import itertools
import json
import math
import re
from collections.abc import Hashable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from capture_eval.errors import InputError

LARGEST_MANIFEST_BYTES = 4_000_000
DEFAULT_METHODS: tuple[str | MethodEntry, ...] = ("linear", "pde_linear", "pde_quadratic", "pde_cubic")
POSE_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}")

RelativePath = Annotated[str, Field(min_length=1, description="path relative to the manifest")]


class ManifestModel(BaseModel):
    """Base of all parts of a manifest: nothing unknown, nothing changed afterwards."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class PoseEntry(ManifestModel):
    """One pose: its time and its photos (or its registered mesh)."""

    t: Annotated[float, Field(ge=0, le=1, description="time of the pose, 0 = neutral, 1 = last")]
    photos: RelativePath | None = Field(default=None, description="folder with the photos of this pose")
    mesh: RelativePath | None = Field(default=None, description="registered mesh of this pose (source: meshes)")
    masks: RelativePath | None = Field(
        default=None, description="folder with one mask per photo (same stem, PNG; 0 = ignore)"
    )
    name: str | None = Field(
        default=None, description="name of the pose; the photo folder's or mesh file's name by default"
    )

    @model_validator(mode="after")
    def _one_source(self) -> PoseEntry:
        if (self.photos is None) == (self.mesh is None):
            raise ValueError("give either `photos` or `mesh`")
        if not POSE_NAME.fullmatch(self.pose_name):
            raise ValueError(f"pose name {self.pose_name!r} may hold letters, digits, _ . - only; set `name`")
        return self

    @property
    def pose_name(self) -> str:
        """Name under which results of the pose are kept."""
        if self.name is not None:
            return self.name
        return Path(self.photos).name if self.photos is not None else Path(self.mesh or "").stem


Pair = Annotated[list[float], Field(min_length=2, max_length=2)]


class IntrinsicsEntry(ManifestModel):
    """A known camera, in pixels; it is kept fixed. The centre of the top-left pixel is (0.5, 0.5)."""

    width: Annotated[int, Field(ge=1)]
    height: Annotated[int, Field(ge=1)]
    focal_length: Pair = Field(description="fx, fy")
    principal_point: Pair = Field(description="cx, cy")
    distortion: Annotated[list[float], Field(min_length=4, max_length=4)] = Field(
        default_factory=lambda: [0.0, 0.0, 0.0, 0.0], description="k1, k2, p1, p2 (OpenCV)"
    )


class CameraEntry(ManifestModel):
    """What is known about the cameras."""

    model: Literal["SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV"] = Field(
        default="SIMPLE_RADIAL", description="COLMAP camera model to estimate"
    )
    shared_intrinsics: bool = Field(default=True, description="all photos come from the same camera and lens setting")
    intrinsics: IntrinsicsEntry | None = None
    known_views: RelativePath | None = Field(
        default=None,
        description="JSON with known intrinsics and extrinsics of every photo (layout of truth/cameras.json)",
    )
    fixed_rig: bool = Field(
        default=False,
        description="the cameras stay where they are: photos of one name are taken by one camera in every pose",
    )


class DenseEntry(ManifestModel):
    """How depth maps are computed."""

    back_end: Literal["auto", "cuda", "cpu"] = Field(
        default="auto", description="auto takes CUDA where pycolmap has it"
    )
    max_image_size: Annotated[int, Field(ge=64)] | None = Field(
        default=None, description="longer side in pixels that photos are shrunk to before stereo; all pixels by default"
    )


class TemplateEntry(ManifestModel):
    """The mesh whose topology all poses get."""

    mesh: RelativePath
    landmarks: RelativePath
    occluders: RelativePath | None = Field(default=None, description="eyes, teeth, tongue of the template as one OBJ")


class TruthEntry(ManifestModel):
    """Known truth of a synthetic or otherwise measured capture; used to judge, never as an input."""

    mesh: RelativePath | None = None
    vertices: RelativePath | None = Field(default=None, description="npz with t (P,) and vertices (P, V, 3)")
    cameras: RelativePath | None = None


class MethodEntry(ManifestModel):
    """An interpolation method with options; a bare name is enough for the defaults."""

    name: Annotated[str, Field(min_length=1)]
    options: dict[str, Any] = Field(default_factory=dict)


class TermsEntry(ManifestModel):
    """Under which terms the data may be used."""

    licence: str | None = None
    consent: str | None = None
    terms: str | None = None
    contact: str | None = None
    citation: str | None = None


class Manifest(ManifestModel):
    """What was photographed and what to do with it."""

    name: Annotated[str, Field(min_length=1, max_length=200)]
    source: Literal["photos", "meshes", "synthetic"]
    description: str | None = None
    poses: Annotated[list[PoseEntry], Field(min_length=1)]
    camera: CameraEntry = CameraEntry()
    dense: DenseEntry = DenseEntry()
    template: TemplateEntry | None = None
    rigid_region: list[Annotated[int, Field(ge=0)]] | RelativePath | None = Field(
        default=None, description="template vertices that do not move (skull): a list, or a JSON or YAML file with one"
    )
    markers: RelativePath | None = Field(
        default=None,
        description="named points of the poses that do not move, or the family of printed tags to look for",
    )
    curves: RelativePath | None = None
    methods: Annotated[list[str | MethodEntry], Field(min_length=1)] = Field(
        default_factory=lambda: list(DEFAULT_METHODS)
    )
    truth: TruthEntry | None = None
    options: dict[str, dict[str, Any]] = Field(
        default_factory=dict, description="options by stage: sparse, dense, surface, align, register, evaluate, report"
    )
    terms: TermsEntry | None = None
    sha256: dict[str, Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]] = Field(
        default_factory=dict, description="SHA-256 by relative path, where the set is published"
    )

    @field_validator("poses")
    @classmethod
    def _times_and_names(cls, poses: list[PoseEntry]) -> list[PoseEntry]:
        times = [pose.t for pose in poses]
        if times[0] != 0.0:
            raise ValueError(f"the first pose must have t = 0, not {times[0]:g}")
        for previous, following in itertools.pairwise(times):
            if not following > previous:
                raise ValueError(f"t must increase strictly, but {following:g} follows {previous:g}")
        if len(times) > 1 and times[-1] != 1.0:
            raise ValueError(f"the last pose must have t = 1, not {times[-1]:g}")
        names = [pose.pose_name for pose in poses]
        repeated = sorted({name for name in names if names.count(name) > 1})
        if repeated:
            raise ValueError(f"two poses are named {repeated[0]!r}; set `name`")
        return poses

    @model_validator(mode="after")
    def _source_matches_poses(self) -> Manifest:
        wanted = "mesh" if self.source == "meshes" else "photos"
        for index, pose in enumerate(self.poses):
            if getattr(pose, wanted) is None:
                raise ValueError(f"poses[{index}] needs `{wanted}`, because source is {self.source}")
        return self

    @property
    def pose_names(self) -> list[str]:
        """Names of all poses in the order of t."""
        return [pose.pose_name for pose in self.poses]

    @property
    def method_entries(self) -> list[MethodEntry]:
        """All methods with their options."""
        return [m if isinstance(m, MethodEntry) else MethodEntry(name=m) for m in self.methods]


@dataclass(frozen=True)
class Capture:
    """A manifest together with the folder that its paths are relative to.

    Attributes
    ----------
    manifest : Manifest
    path : Path
        The manifest file.
    allow_outside : bool
        Whether paths may leave the manifest's folder.
    """

    manifest: Manifest
    path: Path
    allow_outside: bool = False

    @property
    def folder(self) -> Path:
        """Folder of the manifest, absolute."""
        return self.path.resolve().parent

    def resolve(self, relative: str) -> Path:
        """Absolute path of a file that the manifest names.

        Raises
        ------
        InputError
            If it lies outside the manifest's folder and that was not allowed.
        """
        target = (self.folder / relative).resolve()
        if not self.allow_outside and not target.is_relative_to(self.folder):
            raise InputError(
                f"{self.path}: {relative} lies outside the manifest's folder; move it inside or pass --allow-outside"
            )
        return target


def named_paths(manifest: Manifest) -> Iterator[tuple[str, str]]:
    """Yield (key, relative path) of everything the manifest names, in a fixed order."""
    for index, pose in enumerate(manifest.poses):
        for key in ("photos", "mesh", "masks"):
            if getattr(pose, key) is not None:
                yield f"poses[{index}].{key}", getattr(pose, key)
    for group in ("template", "truth"):
        part = getattr(manifest, group)
        if part is not None:
            for key in type(part).model_fields:
                if getattr(part, key) is not None:
                    yield f"{group}.{key}", getattr(part, key)
    if manifest.camera.known_views is not None:
        yield "camera.known_views", manifest.camera.known_views
    if isinstance(manifest.rigid_region, str):
        yield "rigid_region", manifest.rigid_region
    if manifest.markers is not None:
        yield "markers", manifest.markers
    if manifest.curves is not None:
        yield "curves", manifest.curves
    for relative in manifest.sha256:
        yield "sha256", relative


def read_yaml(path: Path, largest_bytes: int = LARGEST_MANIFEST_BYTES) -> Any:
    """Read a YAML (or JSON) file safely; repeated keys are errors.

    Raises
    ------
    InputError
        If the file is missing, too large, no text or no YAML; the text names file and line.
    """
    try:
        if path.stat().st_size > largest_bytes:
            raise InputError(f"{path}: larger than {largest_bytes / 1e6:g} MB, so it is not a manifest or a small list")
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except UnicodeDecodeError:
        raise InputError(f"{path}: not UTF-8 text") from None
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or error}") from None
    try:
        return yaml.load(text, Loader=_StrictLoader)
    except yaml.MarkedYAMLError as error:
        line = error.problem_mark.line + 1 if error.problem_mark else 0
        raise InputError(f"{path}: line {line}: {error.problem or error.context}") from None
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        raise InputError(f"{path}: not readable as YAML ({str(error).splitlines()[0]})") from None


def read_manifest(path: Path, allow_outside: bool = False) -> Capture:
    """Read and check a manifest.

    Parameters
    ----------
    path : Path
        The YAML file.
    allow_outside : bool
        Let paths leave the manifest's folder.

    Raises
    ------
    InputError
        One line that names the file and the key.
    """
    content = read_yaml(path)
    if not isinstance(content, dict):
        raise InputError(f"{path}: a manifest is a mapping with name, source, poses, not {type(content).__name__}")
    try:
        manifest = Manifest.model_validate(content)
    except ValidationError as error:
        raise InputError(f"{path}: {_first_problem(error)}") from None
    capture = Capture(manifest, path, allow_outside)
    for key, relative in named_paths(manifest):
        try:
            capture.resolve(relative)
        except InputError as error:
            raise InputError(str(error).replace(f"{path}: ", f"{path}: {key}: ", 1)) from None
        except (OSError, ValueError) as error:
            raise InputError(f"{path}: {key}: {relative!r} is not a usable path ({error})") from None
    return capture


def manifest_schema() -> str:
    """JSON Schema of a manifest, as the text of data_manifests/manifest.schema.json."""
    return json.dumps(Manifest.model_json_schema(), indent=2, sort_keys=True) + "\n"


def _first_problem(error: ValidationError) -> str:
    """One line of text from pydantic's report: the key, then what is wrong with it."""
    problems = error.errors(include_url=False)
    unknown = [problem for problem in problems if problem["type"] == "extra_forbidden"]
    problem = (unknown or problems)[0]
    key = ""
    for part in problem["loc"]:
        if isinstance(part, int):
            key += f"[{part}]"
        elif part not in ("str", "MethodEntry", "list[constrained-int]", "constrained-str"):
            key += f".{part}" if key else str(part)
    text = problem["msg"].removeprefix("Value error, ")
    if problem["type"] == "extra_forbidden":
        text = "unknown key"
    elif problem["type"] == "missing":
        text = "missing"
    elif isinstance(problem["input"], (str, int, float)):
        text += f" (is {problem['input']!r})"
    more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
    return f"{key}: {text}{more}" if key else f"{text}{more}"


class _StrictLoader(yaml.SafeLoader):
    """Safe YAML in which a key given twice is an error and NaN is refused."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        seen: set[Any] = set()
        for key_node, _ in node.value:
            if key_node.tag == "tag:yaml.org,2002:merge":
                continue
            key = key_node.value
            if key in seen:
                raise yaml.constructor.ConstructorError(None, None, f"key {key!r} is given twice", key_node.start_mark)
            seen.add(key)
        return super().construct_mapping(node, deep=deep)

    def construct_yaml_float(self, node: yaml.ScalarNode) -> float:
        value = super().construct_yaml_float(node)
        if not math.isfinite(value):
            raise yaml.constructor.ConstructorError(None, None, f"{node.value} is not a finite number", node.start_mark)
        return value


_StrictLoader.add_constructor("tag:yaml.org,2002:float", _StrictLoader.construct_yaml_float)
