"""Captures that cannot be registered, and what the pipeline says about each.

    python benchmarks/registration_honesty.py CAPTURE RESULT OTHER_CAPTURE BLANK_CAPTURE OUT [--cases CASE ...]

CAPTURE and RESULT: a capture of `capture-eval synthesize` with at least four poses and the finished `capture-eval run`
of it. OTHER_CAPTURE: the same of another person, BLANK_CAPTURE: of a skin without texture. Each case is made from
copies in OUT: scans that stay the same are taken over, the rest runs again. Printed: what was reported, where, and
what each pose measured. A case that is registered without a word, or a good capture that is doubted, makes the exit
status 1.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import shutil
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import yaml

from capture_eval.errors import CaptureEvalError
from capture_eval.files.manifest_files import read_manifest
from capture_eval.stages.reliability import troubled_poses
from capture_eval.workflow.step_calls import STEP_CALLS, StepContext

WRONG = 2  # the pose that is made wrong
QUICK = {"uncertainty": {"photo_halves": False, "landmark_repeats": 0}}  # the error bars are of no interest here
UNGUARDED = {"register": {"minimum_match_share": 0.0, "minimum_matches": 0, **QUICK}}


@dataclasses.dataclass(frozen=True)
class Setting:
    """Folders of the benchmark."""

    capture: Path
    result: Path
    other: Path
    blank: Path
    out: Path


class Case:
    """One case under way: a copy of the capture, its manifest, and the work folder."""

    def __init__(self, setting: Setting, name: str) -> None:
        self.setting, self.folder = setting, setting.out / name
        self.capture, self.work = self.folder / "capture", self.folder / "result" / "work"
        shutil.rmtree(self.folder, ignore_errors=True)
        shutil.copytree(setting.capture, self.capture)
        self.set(options={"register": QUICK})
        self.fresh: set[int] = set()  # poses whose photos are reconstructed again
        self.source = list(range(len(list(setting.result.glob("work/pose_*")))))

    def photos(self, pose: int, capture: Path | None = None) -> Path:
        """Folder of the photos of a pose."""
        return (capture or self.capture) / "photos" / f"pose_{pose:02d}"

    def set(self, **values: Any) -> None:
        """Change keys of the manifest."""
        path = self.capture / "manifest.yaml"
        path.write_text(yaml.safe_dump(yaml.safe_load(path.read_text()) | values))

    def run(self) -> None:
        """Scans of the fresh poses, then the registration.

        Raises
        ------
        CaptureEvalError
            The stage that stopped, in ``args[0]``.
        """
        for index, source in enumerate(self.source):
            if index not in self.fresh:
                folder = self.setting.result / "work" / f"pose_{source:02d}"
                ignored = shutil.ignore_patterns("registered.*", "matches.npz", "dense", "fused.ply")
                shutil.copytree(folder, self.work / f"pose_{index:02d}", ignore=ignored)
        capture = read_manifest(self.capture / "manifest.yaml")
        names = capture.manifest.pose_names
        steps: list[tuple[str, str | None]] = [
            (step, names[index]) for index in sorted(self.fresh) for step in ("sparse", "dense", "surface")
        ]
        steps += [("align", None), ("neutral", None), ("track", None)]
        steps += [*(("refine", name) for name in names), ("collect", None)]
        for step, pose in steps:
            self.step = step
            STEP_CALLS[step](StepContext(capture, self.folder / "result", pose, 1))


def run_case(setting: Setting, name: str) -> dict[str, Any]:
    """Make one case and run it: `reported`, `where`, `words`, and the rows of every pose."""
    case = Case(setting, name)
    CASES[name](case)
    started = time.process_time()
    try:
        case.run()
    except CaptureEvalError as error:
        return {"case": name, "reported": True, "where": f"stage {case.step} stops", "words": str(error), "poses": []}
    rows = json.loads((case.work / "register" / "registered.json").read_text())["poses"]
    for row in rows:
        found = case.work / row["pose"] / "registered.json"
        row["evidence"] = json.loads(found.read_text()).get("evidence") if found.is_file() else None
    words = troubled_poses(case.folder / "result")
    seconds = round(time.process_time() - started, 1)
    return {
        "case": name, "reported": bool(words), "where": "row of the pose", "words": " | ".join(words), "poses": rows,
        "cpu_seconds": seconds,
    }  # fmt: skip


def good(case: Case) -> None:
    """Nothing is wrong: must not be reported."""


def other_person(case: Case) -> None:
    """The photos of one pose show somebody else."""
    shutil.rmtree(case.photos(WRONG))
    shutil.copytree(case.photos(WRONG, case.setting.other), case.photos(WRONG))
    case.fresh = {WRONG}


def other_person_same_rig(case: Case) -> None:
    """The same with known cameras, so that no match is needed for the alignment, and without the matches' guard."""
    other_person(case)
    case.fresh = set(case.source)
    name = f"pose_{WRONG:02d}"
    cameras = case.capture / "truth" / "cameras.json"
    own, other = (json.loads(path.read_text()) for path in (cameras, case.setting.other / "truth" / "cameras.json"))
    kept = [row for row in own["views"] if row["pose"] != name]
    own["views"] = kept + [row for row in other["views"] if row["pose"] == name]
    cameras.write_text(json.dumps(own))
    case.set(camera={"known_views": "truth/cameras.json"}, options=UNGUARDED)


def half_of_the_photos(case: Case) -> None:
    """Every second photo of one pose is missing."""
    _remove(case, lambda photos: photos[1::2])


def one_side_of_the_photos(case: Case) -> None:
    """One pose was photographed from one side only."""
    _remove(case, lambda photos: photos[len(photos) // 2 :])


def _remove(case: Case, choose: Callable[[list[Path]], list[Path]]) -> None:
    for photo in choose(sorted(case.photos(WRONG).iterdir())):
        photo.unlink()
    case.fresh = {WRONG}


def exchanged(case: Case) -> None:
    """Two poses in the middle have each other's photos."""
    case.source[1], case.source[2] = 2, 1


def mirrored_landmarks(case: Case) -> None:
    """Left and right are confused in the landmarks: each has the pixels of its partner."""
    path = case.capture / "landmarks.yaml"
    document = yaml.safe_load(path.read_text())
    photos = {row["name"]: row.get("photos") for row in document["landmarks"]}
    for row in document["landmarks"]:
        partner = row["name"].replace("left", "*").replace("right", "left").replace("*", "right")
        row["photos"] = photos.get(partner, photos[row["name"]])
    path.write_text(yaml.safe_dump(document))


def blank_skin(case: Case) -> None:
    """The skin has no texture in any pose."""
    shutil.rmtree(case.capture)
    shutil.copytree(case.setting.blank, case.capture)
    case.set(options={"register": QUICK})
    case.fresh = set(case.source)


def blank_skin_known_cameras(case: Case) -> None:
    """The same with a calibrated rig, so that no texture is needed to place the cameras, and no matches' guard."""
    blank_skin(case)
    case.set(camera={"known_views": "truth/cameras.json"}, options=UNGUARDED)


CASES: dict[str, Callable[[Case], None]] = {
    "good": good,
    "other_person": other_person,
    "other_person_same_rig": other_person_same_rig,
    "half_of_the_photos": half_of_the_photos,
    "one_side_of_the_photos": one_side_of_the_photos,
    "exchanged": exchanged,
    "mirrored_landmarks": mirrored_landmarks,
    "blank_skin": blank_skin,
    "blank_skin_known_cameras": blank_skin_known_cameras,
}


def print_table(found: list[dict[str, Any]]) -> None:
    """One row per case, then what the poses measured."""
    print("| case | reported | where | words |\n| --- | --- | --- | --- |")
    for row in found:
        print(f"| {row['case']} | {'yes' if row['reported'] else 'no'} | {row['where']} | {row['words']} |")
    print("\n| case | pose | status | stereo share | skin agreement |\n| --- | --- | --- | --- | --- |")
    for row in found:
        for pose in row["poses"]:
            evidence = pose["evidence"] or {}
            shares = [evidence.get("stereo_share"), evidence.get("skin_agreement")]
            cells = " | ".join("" if share is None else f"{share:.2f}" for share in shares)
            print(f"| {row['case']} | {pose['pose']} | {pose['status']} | {cells} |")


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name in ("capture", "result", "other", "blank", "out"):
        parser.add_argument(name, type=Path)
    parser.add_argument("--cases", nargs="*", default=list(CASES), choices=list(CASES))
    arguments = vars(parser.parse_args())
    names = arguments.pop("cases")
    setting = Setting(**arguments)
    found = [run_case(setting, name) for name in names]
    setting.out.mkdir(parents=True, exist_ok=True)
    (setting.out / "honesty.json").write_text(json.dumps(found, indent=1))
    print_table(found)
    return int(any(row["reported"] == (row["case"] == "good") for row in found))


if __name__ == "__main__":
    sys.exit(main())
