"""The table of methods: identifier → factory. Nothing is registered by scanning."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from functools import partial

from capture_eval.errors import InputError
from capture_eval.interpolation.causal_pde import CausalPde
from capture_eval.interpolation.dynamic_pde import DynamicPde
from capture_eval.interpolation.linear import LinearInterpolation
from capture_eval.interpolation.method import InterpolationMethod
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
}
PAPER_METHODS = ("linear", "pde_linear", "pde_quadratic", "pde_cubic")


def create_method(identifier: str, options: Mapping[str, object] | None = None) -> InterpolationMethod:
    """A method by its identifier.

    Parameters
    ----------
    identifier : str
        A key of `METHODS`.
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
    if identifier not in METHODS:
        raise InputError(f"unknown interpolation method '{identifier}'; known are {', '.join(METHODS)}")
    factory = METHODS[identifier]
    chosen = dict(options or {})
    fixed = set(factory.keywords) if isinstance(factory, partial) else set()
    known = [name for name in inspect.signature(factory).parameters if name not in fixed]
    for name in chosen:
        if name not in known:
            allowed = f"known are {', '.join(known)}" if known else "it has none"
            raise InputError(f"method '{identifier}': unknown option '{name}'; {allowed}")
    try:
        return factory(**chosen)
    except TypeError as problem:
        raise InputError(f"method '{identifier}': options {chosen} have a wrong type ({problem})") from problem
    except InputError as problem:
        raise InputError(f"method '{identifier}': {problem}") from problem


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
