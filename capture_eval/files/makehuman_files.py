"""Reading the upstream files of MakeHuman from a folder."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from capture_eval.errors import InputError

# Where the assets lie in a checkout, in a fetched data set, or when a user points right at them.
_PLACES = ("makehuman/data", "data", ".")
_MARK = "3dobjs/base.obj"
_LARGEST = 64_000_000


def find_makehuman_data(folder: Path) -> Path:
    """The folder that holds ``3dobjs/base.obj``: the given one, its ``data`` or its ``makehuman/data``.

    Raises
    ------
    InputError
        There is none.
    """
    for place in _PLACES:
        if (folder / place / _MARK).is_file():
            return folder / place
    raise InputError(f"{folder}: no MakeHuman files here (looked for makehuman/data/{_MARK})")


def read_makehuman_texts(folder: Path, names: Iterable[str]) -> dict[str, str]:
    """Texts of the named files (relative to the folder of `find_makehuman_data`).

    Raises
    ------
    InputError
        A file is missing, unreasonably large or no text.
    """
    data = find_makehuman_data(folder)
    texts = {}
    for name in names:
        path = data / name
        try:
            if path.stat().st_size > _LARGEST:
                raise InputError(f"{path}: larger than {_LARGEST // 1_000_000} MB, so it is not the upstream file")
            texts[name] = path.read_text(encoding="utf-8")
        except FileNotFoundError:
            raise InputError(f"{path}: missing; fetch the files again with capture-eval data fetch makehuman") from None
        except (OSError, UnicodeDecodeError) as error:
            raise InputError(f"{path}: cannot be read ({error})") from None
    return texts
