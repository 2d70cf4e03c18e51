"""``capture-eval data``: data sets by name."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

application = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    rich_markup_mode=None,
    help="List and fetch data sets.\n\nExample: capture-eval data fetch makehuman",
)


@application.command("list")
def list_sets() -> None:
    """List the data sets and whether they are in the cache.

    Example: capture-eval data list
    """
    from capture_eval.stages.data import data_set_folder, list_data_sets

    for item in list_data_sets():
        if item.kind == "embedded":
            state = "made by `capture-eval synthesize`, nothing to fetch"
        else:
            folder = data_set_folder(item.name)
            state = f"in {folder}" if folder is not None else f"{len(item.files)} files, not fetched"
        print(f"{item.name}: {item.title} ({item.licence}); {state}")


@application.command("fetch")
def fetch(
    name: Annotated[str, typer.Argument(help="Name of the data set, see `capture-eval data list`.")],
    source: Annotated[
        Path | None, typer.Option("--from", help="Take the files from this folder instead of the network.")
    ] = None,
) -> None:
    """Fetch a data set into the cache, each file checked by its SHA-256.

    Example: capture-eval data fetch makehuman --from downloads/makehuman
    """
    from capture_eval.command_line.progress_bar import counting_progress
    from capture_eval.stages.data import data_set, fetch_data_set

    if data_set(name).kind == "embedded":
        print(f"{name} is made by `capture-eval synthesize {name} --out DIR`; there is nothing to fetch")
        return
    with counting_progress("files") as progress:
        folder, brought = fetch_data_set(name, source, progress)
    print(f"{folder} ({brought} files brought, the others were there)")
