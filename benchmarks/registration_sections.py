"""Sections of the registration benchmark's page: texture steps, drift, hard cases, larger photos, time, growth."""

# ruff: noqa: E501  (the long lines are rows of the Markdown that is written)
from __future__ import annotations

from typing import Any

from registration_cases import LIGHT_TURN
from registration_tables import Results, curve_table, good_poses, label, of_group, pair, sequence_table, table


def ablation(results: Results, plots: dict[str, str]) -> str:
    """What the two texture steps buy."""
    reference = results.get("makehuman2_jaw_open")
    found = of_group(results, "ablation")
    if not reference or not found:
        return ""
    rows = []
    for name, row in [*found.items(), ("both", reference)]:
        for pose in good_poses(row)[1:]:
            cells = [pair(pose["regions"].get("face"), "tracking")]
            cells += [
                pair(pose["regions"].get("confident"), part) for part in ("tracking", "tangential", "normal", "surface")
            ]
            rows.append([name.removeprefix("ablation_").replace("_", " "), f"{pose['amount']:g}", *cells])
    titles = ["texture steps", "amount", "face: tracking", "tracking", "tangential", "normal", "surface"]
    text = "\n## What the texture steps buy\n\nMakeHuman 2 jaw_open, same scans; flow against the neutral's texture and stereo on the mesh taken away. *neither* and *flow only* have no stereo on the neutral either. In the rounds the lifted matches keep a tenth of their weight and the scan less, because flow and stereo are there; taking one of them away therefore leaves that direction with less to hold it than *neither*, which stops before the rounds. The vertices that are confident with both steps count everywhere (last four columns).\n\n"
    return text + table(titles, rows) + "\n" + plots.get("registration_ablation.png", "")


def error_bars(results: Results) -> str:
    """Share of true errors inside their 95 % bars, where bars were made."""
    rows = []
    for row in of_group(results, "sequences").values():
        for kind, groups in (row.get("error_bars") or {}).items():
            for name, found in groups.items():
                if found["inside"] is not None:
                    figures = [f"{100 * found[key]:.3f}" for key in ("bar_median", "error_p95")]
                    rows.append(
                        [label(row), kind, name, str(found["count"]), f"{100 * found['inside']:.1f} %", *figures]
                    )
    if not rows:
        return ""
    text = "\n## Error bars\n\nShare of true errors inside their 95 % bars, all poses but the neutral. *Position*: of the place of the skin point; *motion*: without the vertex's own distance from the skin in the neutral.\n\n"
    return text + table(["sequence", "bar", "vertices", "number", "inside", "bar, median", "true error, p95"], rows)


def drift(results: Results) -> str:
    """Error late in a sequence beside the error early in it when motion is no part of it."""
    there, back = results.get("drift_there"), results.get("drift_there_and_back")
    if not there:
        return ""
    notes = "".join(f"; its scans: {note}" for note in there.get("notes") or ())
    text = f"\n## Drift\n\nMakeHuman 0 jaw_open, eleven poses (the person whose captures options were chosen on{notes}). Asked: error at pose 10 at most 1.3 times that at pose 5 when motion is removed.\n\n**Skin that stands still** (moves less than 0.02 % of D in the whole sequence), confident vertices, relative to the neutral:\n\n"
    rows = []
    poses = {pose["pose"]: pose for pose in good_poses(there)}
    for name, pose in poses.items():
        rows.append(
            [
                name,
                f"{pose['amount']:g}",
                *(
                    pair(pose["regions"].get("still"), part)
                    for part in ("relative", "tracking", "tangential", "normal")
                ),
            ]
        )
    text += table(["pose", "amount", "relative", "tracking", "tangential", "normal"], rows)
    if {"pose_05", "pose_10"} <= set(poses):
        ratios = [
            [
                poses["pose_10"]["regions"]["still"][part][k] / poses["pose_05"]["regions"]["still"][part][k]
                for k in (0, 1)
            ]
            for part in ("relative", "tracking")
        ]
        text += f"\nPose 10 over pose 5: relative {ratios[0][0]:.2f} (median), {ratios[0][1]:.2f} (p95); tracking {ratios[1][0]:.2f}, {ratios[1][1]:.2f}.\n"
    return text + (there_and_back(there, back) if back else "")


def there_and_back(there: dict[str, Any], back: dict[str, Any]) -> str:
    """The same photos met early and late."""
    early = {pose["amount"]: (index, pose) for index, pose in enumerate(there["poses"]) if pose["status"] == "ok"}
    rows = []
    for index, pose in enumerate(back["poses"]):
        if index < 6 or pose["status"] != "ok" or pose["amount"] not in early:
            continue
        first, other = early[pose["amount"]]
        a, b = other["regions"]["confident"]["tracking"], pose["regions"]["confident"]["tracking"]
        rows.append(
            [
                f"{pose['amount']:g}",
                str(first),
                str(index),
                pair(other["regions"]["confident"], "tracking"),
                pair(pose["regions"]["confident"], "tracking"),
                f"{b[0] / a[0]:.2f} / {b[1] / a[1]:.2f}",
            ]
        )
    text = "\n**The same photos, met on the way there and on the way back** (order 0 .2 .4 .6 .8 1 .9 .7 .5 .3 .1): motion and scans are equal, only the way to the pose differs. Tracking, confident:\n\n"
    return text + table(
        ["amount", "steps from the neutral, there", "there and back", "error, there", "error, there and back", "ratio"],
        rows,
    )


def hard(results: Results) -> str:
    """Hard cases beside the plain one."""
    names = {
        "makehuman2_jaw_open": "plain (5 poses)",
        "hard_light_turned": f"lamps walked round by {LIGHT_TURN:g}°",
        "hard_weak_skin": "weak-contrast skin, more noise",
        "hard_coarse_template": "template with edges twice as long",
    }
    rows = []
    for name, title in names.items():
        for pose in results.get(name, {"poses": []})["poses"]:
            if pose["amount"] not in (0.0, 0.5, 1.0):
                continue
            share = f"{100 * results[name]['confident_share_of_seen']:.0f} %"
            if pose["status"] != "ok":
                rows.append([title, f"{pose['amount']:g}", share, pose["status"], *[""] * 5])
                continue
            parts = pose["regions"]
            cells = [
                pair(parts.get("seen"), "tracking"),
                pair(parts.get("seen"), "surface"),
                pair(parts.get("confident"), "tracking"),
                pair(parts.get("lips"), "tracking"),
                pair(parts.get("eyes"), "tracking"),
            ]
            rows.append([title, f"{pose['amount']:g}", share, *cells])
    if len({row[0] for row in rows}) < 2:
        return ""
    text = "\n## Hard cases\n\nMakeHuman 2 jaw_open, 24 photos at 640x480, poses at 0, .5 and 1.\n\n"
    return text + table(
        [
            "case",
            "amount",
            "confident of seen",
            "tracking, seen",
            "surface, seen",
            "tracking, confident",
            "lips, seen",
            "eyes, seen",
        ],
        rows,
    )


def large(results: Results) -> str:
    """Two cases at 1280x960."""
    if not of_group(results, "large"):
        return ""
    text = "\n## 24 photos a pose at 1280x960\n\nPoses at 0, .5 and 1 of jaw_open.\n\n"
    return text + sequence_table(results, "large") + curve_table(results, "large", "confident")


def time_table(results: Results) -> str:
    """Seconds a pose and the peer."""
    cores, peer = results.get("time_two_cores"), results.get("time_peer")
    text = "\n## Time\n\n"
    rows = [
        [label(row), f"{row['vertices']}", *(f"{value:.1f}" for value in cpu_parts(row))]
        for row in of_group(results, "sequences").values()
    ]
    if rows:
        text += (
            "CPU seconds on one thread, with other work on the machine; MakeHuman 2 jaw_open with error bars, the others without:\n\n"
            + table(
                ["sequence", "vertices", "align, all poses", "neutral", "a pose: tracking", "a pose: texture steps"],
                rows,
            )
        )
    if cores:
        wall = cores["wall_seconds"]
        text += f"\nTwo cores, nothing else running, template of {cores['vertices']} vertices: neutral {wall['neutral']:.1f} s, align three poses {wall['align']:.1f} s, track two poses {wall['track']:.1f} s, their texture steps side by side {wall['refine_two_poses']:.1f} s: **{cores['wall_seconds_a_pose']:.1f} s a pose** (asked: 20 s at 5,000 vertices).\n"
    if peer:
        text += peer_table(peer)
    return text if rows or cores or peer else ""


def cpu_parts(row: dict[str, Any]) -> list[float]:
    """CPU seconds of align, neutral, and of tracking and refining a pose."""
    seconds = row["cpu_seconds"]
    refine = [value for key, value in seconds.items() if key.startswith("refine_")][1:]
    poses = max(len(refine), 1)
    return [
        seconds.get("align", 0.0),
        seconds.get("neutral", 0.0),
        seconds.get("track", 0.0) / poses,
        sum(refine) / poses,
    ]


def peer_table(peer: dict[str, Any]) -> str:
    """The neutral fit beside trimesh."""
    titles = {
        "own": "capture_eval, fit to the scan",
        "own_with_stereo": "capture_eval, whole neutral step (texture stereo and error bars)",
        "trimesh": "trimesh nricp_amberg, its defaults",
    }
    rows = []
    for name, row in peer["rows"].items():
        title = titles[name] + (f" ({row['version']})" if "version" in row else "")
        if "skipped" in row:
            rows.append([title, row["skipped"], "", ""])
            continue
        rows.append([title, f"{row['cpu_seconds']:.1f}", pair(row, "surface"), pair(row, "correspondence")])
    text = f"\nThe neutral of MakeHuman 2, template of {peer['vertices']} vertices, same scan ({peer['scan_triangles']} triangles; trimesh gets it with 20,000), same landmarks. *Own vertices*: distance from the person's vertex of the same number, which the template shares; how well two people correspond, not a truth about drift.\n\n"
    return text + table(["fit", "CPU s", "surface, seen", "own vertices, seen"], rows)


def growth(results: Results, plots: dict[str, str]) -> str:
    """Templates of all sizes."""
    rows = []
    for row in of_group(results, "growth").values():
        kind = "quads" if "quads" in row["case"] else "triangles"
        _, neutral, track, refine = cpu_parts(row)
        last = good_poses(row)[-1]["regions"]
        rows.append(
            [
                kind,
                str(row["vertices"]),
                f"{neutral:.1f}",
                f"{track:.1f}",
                f"{refine:.1f}",
                f"{row['peak_memory_mb']:.0f}",
                pair(last.get("seen"), "tracking"),
                pair(last.get("seen"), "surface"),
            ]
        )
    if not rows:
        return ""
    text = "\n## Templates of 2,000 to 50,000 vertices\n\nThe usual template subdivided or decimated; quads by splitting the triangles of a smaller one. No texture layout of their own, so a cylinder serves. The neutral and the pose at .5 of MakeHuman 2 jaw_open, one thread.\n\n"
    return (
        text
        + table(
            [
                "faces",
                "vertices",
                "neutral, CPU s",
                "tracking, CPU s",
                "texture steps, CPU s",
                "peak MB",
                "tracking, seen, pose .5",
                "surface, seen, pose .5",
            ],
            rows,
        )
        + "\n"
        + plots.get("registration_growth.png", "")
    )
