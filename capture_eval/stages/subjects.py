"""Who is photographed: the embedded mannequin, or a MakeHuman head from files that the user has fetched."""

from __future__ import annotations

from pathlib import Path

from capture_eval.errors import InputError
from capture_eval.images.head import Head

DATASETS = ("mannequin", "makehuman")


def load_subjects(
    dataset: str, identity: int = 0, template_identity: int = 1, makehuman_folder: Path | None = None
) -> tuple[Head, Head]:
    """The person to photograph and another one of the same topology, whose neutral mesh becomes the template.

    Parameters
    ----------
    dataset
        ``mannequin`` or ``makehuman``.
    identity, template_identity
        Which persons; they must differ, or registration would start from the answer.
    makehuman_folder
        Checkout or data folder of MakeHuman; None means the fetched data set in the cache.

    Raises
    ------
    InputError
        Unknown data set, equal or negative identities, or the MakeHuman files are not there.
    """
    if dataset not in DATASETS:
        raise InputError(f"dataset {dataset!r} is unknown; use {' or '.join(DATASETS)}")
    if identity == template_identity:
        raise InputError(f"identity and template identity are both {identity}; the template must be another person")
    if min(identity, template_identity) < 0:
        raise InputError(f"identities {identity} and {template_identity} must be 0 or more")
    if dataset == "mannequin":
        from capture_eval.images.mannequin import build_mannequin

        return build_mannequin(identity), build_mannequin(template_identity)
    return _makehuman_subjects(identity, template_identity, makehuman_folder or _fetched_makehuman())


def _makehuman_subjects(identity: int, template_identity: int, folder: Path) -> tuple[Head, Head]:
    from capture_eval.files.makehuman_files import read_makehuman_texts
    from capture_eval.images.makehuman_assets import REQUIRED_FILES, parse_assets
    from capture_eval.images.makehuman_head import cut_head, makehuman_head

    assets = parse_assets(read_makehuman_texts(folder, REQUIRED_FILES))
    cut = cut_head(assets)
    return makehuman_head(assets, identity, cut), makehuman_head(assets, template_identity, cut)


def _fetched_makehuman() -> Path:
    from capture_eval.stages.data import data_set_folder

    folder = data_set_folder("makehuman")
    if folder is None:
        raise InputError(
            "the MakeHuman files are not there: run capture-eval data fetch makehuman, or give --makehuman DIR"
        )
    return folder
