"""The table of methods: identifier → factory.

Other packages add theirs through the entry-point group ``capture_eval.methods``, whose entries are factories of
`InterpolationMethod` objects. They are looked up by name when one is asked for and never replace a method of the
table.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from importlib import metadata

from capture_eval.errors import InputError
from capture_eval.interpolation.causal_pde import CausalPde
from capture_eval.interpolation.dynamic_pde import DynamicPde
from capture_eval.interpolation.key_pose_splines import KeyPoseSpline
from capture_eval.interpolation.linear import LinearInterpolation
from capture_eval.interpolation.method import InterpolationMethod
from capture_eval.interpolation.pde_surface import PdeSurfaceInterpolation
from capture_eval.interpolation.time_warps import (
    BetaInterpolation,
    CosineInterpolation,
    MonotoneInterpolation,
    PowerInterpolation,
)

METHODS: dict[str, Callable[..., InterpolationMethod]] = {
    "linear": LinearInterpolation,
    "pde_linear": partial(DynamicPde, order=1),
    "pde_quadratic": partial(DynamicPde, order=2),
    "pde_cubic": partial(DynamicPde, order=3),
    "pde": DynamicPde,
    "pde_causal": CausalPde,
    "cosine": CosineInterpolation,
    "power": PowerInterpolation,
    "beta": BetaInterpolation,
    "monotone": MonotoneInterpolation,
    "catmull_rom": partial(KeyPoseSpline, kind="catmull_rom"),
    "b_spline": partial(KeyPoseSpline, kind="b_spline"),
    "pde_surface": PdeSurfaceInterpolation,
}
ENTRY_POINT_GROUP = "capture_eval.methods"
PAPER_METHODS = ("linear", "pde_linear", "pde_quadratic", "pde_cubic")


def known_methods() -> list[str]:
    """Identifiers of the table and of installed packages that offer further methods."""
    found = {entry.name for entry in metadata.entry_points(group=ENTRY_POINT_GROUP)}
    return [*METHODS, *sorted(found - set(METHODS))]


def _factory(identifier: str) -> Callable[..., InterpolationMethod]:
    if identifier in METHODS:
        return METHODS[identifier]
    for entry in metadata.entry_points(group=ENTRY_POINT_GROUP, name=identifier):
        try:
            factory: Callable[..., InterpolationMethod] = entry.load()
        except Exception as problem:  # whatever another package's import may raise
            raise InputError(f"method '{identifier}' ({entry.value}) cannot be loaded: {problem}") from problem
        return factory
    raise InputError(f"unknown interpolation method '{identifier}'; known are {', '.join(known_methods())}")


def _option_names(identifier: str, factory: Callable[..., InterpolationMethod]) -> list[str]:
    fixed = set(factory.keywords) if isinstance(factory, partial) else set()
    try:
        return [name for name in inspect.signature(factory).parameters if name not in fixed]
    except (TypeError, ValueError) as problem:
        raise InputError(f"method '{identifier}' is not made by a factory with named options") from problem


def create_method(identifier: str, options: Mapping[str, object] | None = None) -> InterpolationMethod:
    """A method by its identifier.

    Parameters
    ----------
    identifier : str
        A key of `METHODS`, or the name of an entry point of the group ``capture_eval.methods``.
    options : mapping, optional
        Parameters of the method (for example ``{"damping": 10}``).

    Raises
    ------
    InputError
        Unknown identifier or option, or a value that the method refuses; names them.

    Examples
    --------
    >>> create_method("pde_quadratic", {"closure": "linear"}).title
    'PDE quadratic'
    """
    factory = _factory(identifier)
    chosen = dict(options or {})
    known = _option_names(identifier, factory)
    for name in chosen:
        if name not in known:
            allowed = f"known are {', '.join(known)}" if known else "it has none"
            raise InputError(f"method '{identifier}': unknown option '{name}'; {allowed}")
    try:
        method = factory(**chosen)
    except TypeError as problem:
        raise InputError(f"method '{identifier}': options {chosen} have a wrong type ({problem})") from problem
    except InputError as problem:
        raise InputError(f"method '{identifier}': {problem}") from problem
    if not isinstance(method, InterpolationMethod):
        raise InputError(f"method '{identifier}': {type(method).__name__} does not keep the contract of a method")
    return method


def create_methods(entries: Sequence[tuple[str, Mapping[str, object]]]) -> dict[str, InterpolationMethod]:
    """Methods by the name under which their results are stored.

    Parameters
    ----------
    entries : sequence of (identifier, options)
        In the order of the results. An identifier used once is the name; one used with several options has them in
        its names, as in ``pde_quadratic(damping=10)``.

    Raises
    ------
    InputError
        No entry, an unknown identifier or option, or twice the same method.
    """
    if not entries:
        raise InputError("no interpolation method is asked for; 'linear' is the least")
    identifiers = [identifier for identifier, _ in entries]
    created: dict[str, InterpolationMethod] = {}
    for identifier, options in entries:
        name = identifier
        if identifiers.count(identifier) > 1 and options:
            name = f"{identifier}({','.join(f'{key}={options[key]}' for key in sorted(options))})"
        if name in created:
            raise InputError(f"method '{name}' is asked for twice with the same options")
        created[name] = create_method(identifier, options)
    return created
