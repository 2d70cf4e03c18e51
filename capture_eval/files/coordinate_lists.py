"""Coordinates as users write them in YAML: lists of so many finite numbers."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture_eval.errors import InputError


def coordinates(path: Path, owner: str, values: Any, count: int) -> NDArray[np.float64]:
    """The numbers (count,) that a file gives for something.

    Parameters
    ----------
    path : Path
        The file, for the message.
    owner : str
        Whose numbers they are, for the message: ``landmark nose_tip``.
    values : Any
        As read from the file.
    count : int

    Raises
    ------
    InputError
        Not a list of that many finite numbers.
    """
    usable = isinstance(values, Sequence) and not isinstance(values, str) and len(values) == count
    try:
        array = np.array(values if usable else [np.nan], dtype=np.float64)
    except (TypeError, ValueError):
        array = np.array([np.nan])
    if array.shape != (count,) or not np.all(np.isfinite(array)):
        raise InputError(f"{path}: {owner}: {values!r} is not a list of {count} numbers")
    return array
