"""How far the frames of the poses are from the truth, by the ways to align them.

    python benchmarks/pose_alignment.py CAPTURE RESULT

CAPTURE is a synthetic capture with truth/cameras.json, RESULT a finished run of it. The points of every pose are placed
once more with the true cameras; the similarity between the two places (thousands of points, thousandths of a per cent
of D) is the truth that the alignments are measured against. Rendered captures move their cameras from pose to pose, so
that a rig must fail there.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from capture_eval.errors import RegistrationError
from capture_eval.files.atomic import read_npz
from capture_eval.files.camera_files import read_cameras
from capture_eval.files.manifest_files import read_manifest
from capture_eval.registration.pose_alignment import AlignedPose, AlignmentOptions, align_all_poses
from capture_eval.registration.rig_alignment import align_by_rig, place_points
from capture_eval.registration.robust_similarity import fit_robust_similarity
from capture_eval.similarity import Similarity
from capture_eval.stages.align import AlignOptions, load_observed_points, rigid_points
from capture_eval.stages.align_inputs import load_photographed_points
from capture_eval.triangle_geometry import diameter
from capture_eval.workflow.stage_options import stage_options

SAMPLING, FINAL = 0.003, 0.002  # of D


def true_frames(capture: Path, work: Path, names: list[str], size: float) -> list[Similarity]:
    """`truth_from_pose` of every pose."""
    known = read_cameras(capture / "truth" / "cameras.json")
    frames = []
    for name in names:
        seen, _ = load_photographed_points(work / name)
        places, placed = place_points({view.name: view for view in known[name]}, seen)
        fit = fit_robust_similarity(seen.points[placed], places[placed], SAMPLING * size, FINAL * size)
        print(f"{name}: points against the true cameras: median {100 * fit.median_residual / size:.4f} % of D")
        frames.append(fit.target_from_source)
    return frames


def error(
    pose: AlignedPose, points: NDArray[np.float64], truth: Similarity, neutral_truth: Similarity, size: float
) -> float:
    """Median distance over the points of a pose, % of D; NaN for a failed one."""
    if pose.neutral_from_pose is None:
        return float("nan")
    placed = neutral_truth.apply(pose.neutral_from_pose.apply(points))
    return float(100 * np.median(np.linalg.norm(placed - truth.apply(points), axis=1)) / size)


def main() -> None:
    """Print one row per way and pose."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("capture", type=Path)
    parser.add_argument("result", type=Path)
    parser.add_argument("--poses", type=int, default=None, help="only the first so many poses")
    arguments = parser.parse_args()
    work = arguments.result / "work"
    capture = read_manifest(arguments.capture / "manifest.yaml")
    names = capture.manifest.pose_names[: arguments.poses]
    size = diameter(read_npz(arguments.capture / "truth" / "truth.npz")["vertices"][0])
    observed = [load_observed_points(work / name) for name in names]
    options = stage_options(capture, "align", 1)
    if not isinstance(options, AlignOptions):
        raise RegistrationError("the align stage has other options than expected")
    region = rigid_points(work / names[0], observed[0], options)
    truth = true_frames(arguments.capture, work, names, size)
    _, views = load_photographed_points(work / names[0])
    footprint = observed[0].footprint

    def by_rig() -> list[AlignedPose]:
        rows = [AlignedPose(Similarity.identity(), 0.0, 0, 0, "rig", "")]
        seen = [load_photographed_points(work / name)[0] for name in names[1:]]
        return rows + [align_by_rig(views, points, footprint, AlignmentOptions()) for points in seen]

    ways: dict[str, Callable[[], list[AlignedPose]]] = {
        "matches, one by one": lambda: align_all_poses(observed, AlignmentOptions(joint=False), region),
        "matches, together": lambda: align_all_poses(observed, AlignmentOptions(), region),
        "matches, no rigid region": lambda: align_all_poses(observed, AlignmentOptions()),
        "rig": by_rig,
    }
    print("\n| way | median over the head, % of D: mean over poses | worst pose | failed poses | CPU s |")
    print("| --- | --- | --- | --- | --- |")
    for way, solve in ways.items():
        started = time.process_time()
        poses = solve()
        seconds = time.process_time() - started
        errors = np.array([error(poses[k], observed[k].points, truth[k], truth[0], size) for k in range(1, len(names))])
        good = errors[np.isfinite(errors)]
        figures = f"{good.mean():.4f} | {good.max():.4f}" if good.size else "- | -"
        print(f"| {way} | {figures} | {np.count_nonzero(~np.isfinite(errors))} | {seconds:.1f} |")


if __name__ == "__main__":
    main()
