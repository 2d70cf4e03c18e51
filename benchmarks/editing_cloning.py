"""Errors of expression cloning against the truth: persons of one topology, of which the second's motion is known.

    python benchmarks/editing_cloning.py [--makehuman ../shared/data/makehuman_upstream/makehuman/data]

% of D over the face (scalp, neck, ears and the mouth's inside left out). Correspondence: how far the place found for a
vertex of person 1 lies from the same vertex of person 0, on person 0. Motion: how far the cloned expression of person 0
at full amount is from person 1's own; beside it the same with displacements copied as they are, and the motion itself.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from capture_eval.editing.dense_correspondence import dense_correspondence
from capture_eval.editing.expression_cloning import motion_transfer
from capture_eval.stages.subjects import load_subjects
from capture_eval.triangle_geometry import diameter

HIDDEN = ("scalp", "neck", "inner", "ears")


def measure(dataset: str, folder: Path | None) -> list[str]:
    """Rows of the table."""
    template, target = load_subjects(dataset, 0, 1, folder)
    face = np.unique(np.concatenate([rows for name, rows in target.regions.items() if name not in HIDDEN]))
    pairs = np.array([[vertex, target.landmarks[name]] for name, vertex in template.landmarks.items()])
    found = dense_correspondence(template.skin, target.skin, pairs)
    here, there = target.skin.vertices, template.skin.vertices
    miss = 100.0 * np.linalg.norm(found.carry(there) - there, axis=1)[face] / diameter(there)
    transfer = motion_transfer(template.skin, target.skin, found)
    size, rows = diameter(here), []
    for motion in template.motions:
        displacement = template.pose(motion, 1.0)[0] - there
        truth = target.pose(motion, 1.0)[0]
        answers = (transfer.clone(displacement), here + found.carry(displacement), here)
        errors = [100.0 * float(np.linalg.norm(answer - truth, axis=1)[face].mean()) / size for answer in answers]
        cells = (dataset, len(pairs), f"{miss.mean():.2f}", f"{np.percentile(miss, 95):.2f}", motion)
        rows.append("| " + " | ".join([*map(str, cells), *(f"{error:.2f}" for error in errors)]) + " |")
    return rows


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--makehuman", type=Path, help="MakeHuman's data folder; only the mannequin without it")
    asked = parser.parse_args()
    print("| head | landmarks | correspondence mean | 95 % | motion | cloned | copied | its mean size |")
    print("| --- | ---: | ---: | ---: | --- | ---: | ---: | ---: |")
    for dataset in ("mannequin", "makehuman") if asked.makehuman else ("mannequin",):
        print("\n".join(measure(dataset, asked.makehuman)), flush=True)


if __name__ == "__main__":
    main()
