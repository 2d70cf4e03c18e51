"""``capture-eval landmarks``: where the template's named points are in the photos."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from capture_eval.stages.landmarks import LandmarkState, Placement

FEWEST = 6  # what registration wants


def landmarks(
    manifest: Annotated[Path, typer.Argument(help="The manifest of the capture (YAML).")],
    points: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[PHOTO NAME=X,Y ...]...", help="A photo (name or number on the sheet) and pixels in it; repeat."
        ),
    ] = None,
    remove: Annotated[
        list[str] | None, typer.Option(help="PHOTO:NAME takes a pixel out, NAME takes it out of all photos; repeat.")
    ] = None,
    define: Annotated[
        list[str] | None, typer.Option(help="NAME=VERTEX adds a landmark at a vertex of the template; repeat.")
    ] = None,
    detector: Annotated[
        str | None, typer.Option(help="Fill by a detector of an installed package (group capture_eval.landmarks).")
    ] = None,
    confidence: Annotated[float, typer.Option(min=0.0, max=1.0, help="Least confidence of a detection.")] = 0.5,
    sheet: Annotated[
        Path | None, typer.Option(help="The sheet, .png or .pdf; landmarks.png beside the manifest if not given.")
    ] = None,
    result: Annotated[
        Path | None, typer.Option(help="Folder of a run: its cameras tell how well the photos of a landmark agree.")
    ] = None,
    allow_outside: Annotated[
        bool, typer.Option("--allow-outside", help="Let the manifest name files outside its folder.")
    ] = False,
) -> None:
    """Tell where the template's named points are in photos of the neutral face.

    1. capture-eval landmarks capture/manifest.yaml draws a sheet: the template with its points, the photos numbered.

    2. Open photos in any viewer that shows the pixel under the mouse (x to the right, y down), and give 6 points or
    more in 2 photos or more each, the same points in photos from different sides.

    3. Look at the sheet again: every point with its number. With --result the disagreement is told in pixels.

    Example: capture-eval landmarks capture/manifest.yaml view_03.jpg nose_tip=312,201 chin=300,350 7 nose_tip=290,198

    The landmarks file of the manifest is written anew (its comments are lost). A point placed by hand wins over the
    detector.
    """
    from capture_eval.errors import InputError
    from capture_eval.files.manifest_files import read_manifest
    from capture_eval.stages.landmarks import LandmarkRequest, place_landmarks_by_hand

    request = LandmarkRequest(
        tuple(_definition(text) for text in define or []),
        parse_points(points or []),
        tuple(_removal(text) for text in remove or []),
        detector,
        confidence,
    )
    capture = read_manifest(manifest, allow_outside)
    picture = sheet or capture.folder / "landmarks.png"
    if picture.suffix.lower() not in (".png", ".pdf"):
        raise InputError(f"{picture}: the sheet is a .png or a .pdf")
    states = place_landmarks_by_hand(capture, request, picture, result)
    _tell(states)
    print(f"sheet in {picture}")


def parse_points(words: list[str]) -> tuple[Placement, ...]:
    """``PHOTO name=x,y name=x,y PHOTO …`` as placements.

    Raises
    ------
    InputError
        A pixel before any photo, a photo without pixels, or no two numbers.
    """
    from capture_eval.errors import InputError
    from capture_eval.stages.landmarks import Placement

    placements: list[Placement] = []
    photo, used = "", True
    for word in words:
        name, equals, numbers = word.rpartition("=")
        if not equals:
            if not used:
                raise InputError(f"no pixel after photo {photo}; give PHOTO NAME=X,Y")
            photo, used = word, False
            continue
        if not photo:
            raise InputError(f"{word}: which photo? give PHOTO NAME=X,Y")
        try:
            x, y = (float(number) for number in numbers.split(","))
        except ValueError:
            raise InputError(f"{word}: expected NAME=X,Y with two numbers") from None
        placements.append(Placement(photo, name, (x, y)))
        used = True
    if not used:
        raise InputError(f"no pixel after photo {photo}; give PHOTO NAME=X,Y")
    return tuple(placements)


def _definition(text: str) -> tuple[str, int]:
    from capture_eval.errors import InputError

    name, _, vertex = text.rpartition("=")
    if not name or not vertex.isdigit():
        raise InputError(f"--define {text}: expected NAME=VERTEX")
    return name, int(vertex)


def _removal(text: str) -> tuple[str | None, str]:
    photo, colon, name = text.rpartition(":")
    return (photo if colon else None), name


def _tell(states: list[LandmarkState]) -> None:
    for state in states:
        count = "point in space" if state.known_point else f"{state.photos} photo{'' if state.photos == 1 else 's'}"
        error = "" if state.error_px is None else f", agree to {state.error_px:.2f} px"
        print(f"{state.name}: {count}{error}{'; ' + state.problem if state.problem else ''}")
    usable = sum(state.known_point or (state.photos >= 2 and state.error_px is not None) or
                 (state.photos >= 2 and not state.problem) for state in states)  # fmt: skip
    more = "" if usable >= FEWEST else f"; registration wants {FEWEST} or more"
    print(f"{usable} of {len(states)} landmarks can be used{more}")
