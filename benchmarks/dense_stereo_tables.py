"""The dense stereo benchmark's page: tables from saved results, nothing is computed again."""

from __future__ import annotations

from typing import Any

import numpy as np
from dense_stereo_cases import CENTRE, PHOTOS, SIZES, SOURCES, Case

Results = dict[str, Any]

REGIONS = ("face", "head")
CENTRE_NAME = f"{CENTRE.name}_true"
LARGE_NAME = CENTRE_NAME.replace("640x480", "1280x960")

# The aims: CPU s per photo, truth→mesh 50/90/95/99 and mesh→truth 95 (% of D), completeness within .3 % of D.
AIMS: dict[str, tuple[float, list[float], float, float]] = {
    "640x480": (3.3, [0.032, 0.075, 0.097, 0.172], 0.10, 0.996),
    "1280x960": (12.0, [0.020, 0.036, 0.046, 0.086], 0.05, 0.998),
}
COLUMNS = (
    "scene",
    "poses",
    "region",
    "dense CPU s/photo",
    "surface CPU s",
    "peak MB",
    "MB/Mpx",
    "points",
    "accuracy 50/90/95",
    "complete <.1/<.3",
    "truth→mesh 50/90/95/99",
    "rms",
    "mesh→truth 50/90/95/99",
)
INTRODUCTION = """# Dense stereo and surface, measured

`python benchmarks/dense_stereo.py --makehuman DIR` renders, reconstructs, measures and writes this page and
`dense_stereo.json`; `--report` writes the page and the plots from the saved figures alone.

Every case is one pose of one rendered head with 24 photos (unless said otherwise), an exact truth, and eyes, teeth and
tongue in place. Lengths are % of D, the largest distance between two vertices of the neutral head. `head` is all skin
that three or more photos see at less than 75 degrees; `face` is the part of it in front of the ears, without
neck and scalp.
*Accuracy*: fused points to the true surfaces. *Complete*: share of the true region that has a point within .1 and
.3 % D. *truth→mesh*: places of the true region, spread evenly, to the mesh. *mesh→truth*: places of the mesh that
belong to the region, to the true surfaces. CPU seconds are of one thread and count loading of the compiled kernels;
*peak MB* is the larger of the two stages, the interpreter and its libraries included; *MB/Mpx* is what the dense
stage adds to them, per megapixel of one photo. *Poses*: `true` cameras, or `solved` from the photos and brought to
the truth by the camera centres and an ICP with scale. The aims come from a study whose pixels were .168 % D wide at
640 × 480; here they are {pixel} % D on average (distance of the cameras over focal length and D), so the same error in
pixels is a larger one in % D.

Parameters were chosen on the scenes marked *; all others were not looked at while choosing. Not the full product of
factors: each is varied round one centre, `{centre}`.
"""


def cell(values: list[float], digits: int = 3) -> str:
    """`.032/.075/...`."""
    return "/".join(f"{value:.{digits}f}".replace("0.", ".", 1) if value < 1 else f"{value:.2f}" for value in values)


def markdown(rows: list[dict[str, str]]) -> str:
    """Markdown table; its columns are those of the first row."""
    names = list(rows[0])
    lines = ["| " + " | ".join(names) + " |", "|" + " --- |" * len(names)]
    lines += ["| " + " | ".join(row.get(name, "-") for name in names) + " |" for row in rows]
    return "\n".join(lines) + "\n"


def figures(case: Case, record: Results, region: str, label: str) -> dict[str, str]:
    """Row of the main table."""
    row = dict.fromkeys(COLUMNS, "-") | {"scene": label, "poses": "true" if case.known else "solved", "region": region}
    if record["status"] != "ok":
        return row | {"accuracy 50/90/95": f"{record['status']}: {record.get('reason', '')}"}
    found = record["regions"][region]
    peak = max(record["dense_peak_mb"], record["surface_peak_mb"])
    added = (record["dense_peak_mb"] - record["base_mb"]) / case.scene.megapixels
    return row | {
        "dense CPU s/photo": f"{record['dense_cpu_s'] / record['photos']:.2f}",
        "surface CPU s": f"{record['surface_cpu_s']:.1f}",
        "peak MB": f"{peak:.0f}",
        "MB/Mpx": f"{added:.0f}",
        "points": f"{found['points'] / 1000:.0f} k",
        "accuracy 50/90/95": cell(found["accuracy"][:3]),
        "complete <.1/<.3": cell(found["complete"]),
        "truth→mesh 50/90/95/99": cell(found["truth_to_mesh"]),
        "rms": cell([found["truth_to_mesh_rms"]]),
        "mesh→truth 50/90/95/99": cell(found["mesh_to_truth"]),
    }


def scene_label(case: Case) -> str:
    """Head, pose, skin, and a star where parameters were chosen on it."""
    scene = case.scene
    pose = "neutral" if scene.amount == 0 else scene.motion
    star = " *" if case.name.startswith("tuned_") else ""
    return f"{scene.dataset} {scene.identity}, {pose}, {scene.skin} skin{star}"


def _mean_row(cases: list[Case], saved: Results, region: str) -> list[dict[str, str]]:
    """Mean over the heads that parameters were not chosen on; none where there are fewer than two."""
    pairs = [
        (case, figures_of)
        for case in cases
        if (figures_of := saved[case.name])["status"] == "ok" and not case.name.startswith("tuned_")
    ]
    if len(pairs) < 2:
        return []
    case, first = pairs[0]
    records = [record for _, record in pairs]
    mean = {**first, "regions": {region: _mean([record["regions"][region] for record in records])}}
    for key in ("dense_cpu_s", "surface_cpu_s", "dense_peak_mb", "surface_peak_mb"):
        mean[key] = float(np.mean([record[key] for record in records]))
    row = figures(case, mean, region, f"mean of {len(pairs)} heads without star, {case.scene.skin} skin")
    return [row]


def _mean(values: list[Results]) -> Results:
    return {key: np.mean([value[key] for value in values], axis=0).tolist() for key in values[0]}


def heads_section(cases: list[Case], saved: Results, group: str, size: str) -> str:
    """Main table of one image size, the aim in its first row."""
    chosen = [case for case in cases if case.group == group]
    if not chosen:
        return ""
    seconds, distances, back, complete = AIMS[size]
    aim = {"scene": "aim (heads like the study's)", "region": "face", "dense CPU s/photo": f"{seconds:g}"}
    aim |= {"complete <.1/<.3": f"-/{cell([complete])}", "truth→mesh 50/90/95/99": cell(distances)}
    rows = [dict.fromkeys(COLUMNS, "-") | aim | {"mesh→truth 50/90/95/99": f"-/-/{cell([back])}/-"}]
    for region in REGIONS:
        for known, skin in ((True, "normal"), (False, "normal"), (True, "weak"), (False, "weak")):
            rows += _mean_row(
                [case for case in chosen if (case.known, case.scene.skin) == (known, skin)], saved, region
            )
    for region in REGIONS:
        rows += [figures(case, saved[case.name], region, scene_label(case)) for case in chosen]
    return f"\n## Heads at {size.replace('x', ' × ')}\n\n" + markdown(rows)


def aims_section(cases: list[Case], saved: Results) -> str:
    """Each aim beside what the heads not tuned on reach with true poses and normal skin: face, worst and best head."""
    rows = []
    for size, (seconds, distances, back, complete) in AIMS.items():
        records = [
            saved[case.name]
            for case in cases
            if case.group in ("heads", "large") and case.known and case.scene.skin == "normal"
            if f"{case.scene.width}x{case.scene.height}" == size and not case.name.startswith("tuned_")
            if saved[case.name]["status"] == "ok"
        ]
        wanted = [("dense CPU s/photo", seconds, [r["dense_cpu_s"] / r["photos"] for r in records], 1)]
        for place, (share, aim) in enumerate(zip((50, 90, 95, 99), distances, strict=True)):
            wanted.append((f"truth→mesh {share} %", aim, [_face(r, "truth_to_mesh")[place] for r in records], 1))
        wanted.append(("mesh→truth 95 %", back, [_face(r, "mesh_to_truth")[2] for r in records], 1))
        wanted.append(("complete < .3 % D", complete, [_face(r, "complete")[1] for r in records], -1))
        for label, aim, values, sign in wanted if records else []:
            met = sum(sign * value <= sign * aim for value in values)
            best, worst = sorted(values, reverse=sign < 0)[0], sorted(values, reverse=sign < 0)[-1]
            digits = 4 if sign < 0 else 3
            row = {"photos": size.replace("x", " × "), "figure (face)": label, "aim": cell([aim], digits)}
            row |= {"best": cell([best], digits), "worst": cell([worst], digits)}
            rows.append(row | {"heads that meet it": f"{met} of {len(values)}"})
    return "\n## Aims\n\nTrue poses, normal skin, heads without star.\n\n" + markdown(rows) if rows else ""


def peers_section(cases: list[Case], saved: Results) -> str:
    """Our dense stage beside others on the same photos, with ratios."""
    names = {"sgbm": "OpenCV SGBM, 4 rectified pairs", "openmvs": "OpenMVS"}
    rows = []
    for case in cases:
        if case.group != "peers":
            continue
        own = saved.get(case.twin, {"status": "missing"})
        record = saved[case.name]
        twin = next((other for other in cases if other.name == case.twin), None)
        both = own["status"] == record["status"] == "ok"
        if both and twin is not None:
            rows.append(figures(twin, own, "face", f"ours, {case.scene.skin} skin") | {"CPU": "1", "p95": "1"})
        row = figures(case, record, "face", f"{names[case.method]}, {case.scene.skin} skin")
        if both:
            time = record["dense_cpu_s"] / own["dense_cpu_s"]
            tail = _face(record, "truth_to_mesh")[2] / _face(own, "truth_to_mesh")[2]
            row |= {"CPU": f"{time:.2f}", "p95": f"{tail:.2f}"}
        rows.append(row)
    if not rows:
        return ""
    for row in rows:
        row["CPU, ratio to ours"] = row.pop("CPU", "-")
        row["truth→mesh p95, ratio"] = row.pop("p95", "-")
    rows = [{key: value for key, value in row.items() if key not in ("poses", "region")} for row in rows]
    text = "\n## Peers on the same photos, face, true poses\n\nSGBM: depth maps of rectified pairs with the four best "
    text += "neighbours, the median where two agree; then the same confirmation between photos, the same fusion and "
    return (
        text
        + "surface. OpenMVS: `--resolution-level 0 --number-views 5`, its own fusion, our surface.\n\n"
        + markdown(rows)
    )


def crust_section(cases: list[Case], saved: Results) -> str:
    """Points far from anything true, by who fused."""
    rows = []
    for case in cases:
        if case.group != "fusion" or saved[case.name]["status"] != "ok":
            continue
        own = saved.get(case.twin, {"status": "missing"})
        for label, record in (("own fusion", own), ("pycolmap.stereo_fusion", saved[case.name])):
            if record["status"] == "ok":
                rows.append(
                    {
                        "skin": case.scene.skin,
                        "fusion": label,
                        "points": f"{record['points'] / 1000:.0f} k",
                        "farther than .3 % D": f"{100 * record['far_share']:.2f} %",
                        "accuracy, face, 50/90/95/99": cell(_face(record, "accuracy")),
                        "mesh→truth, face, 50/90/95/99": cell(_face(record, "mesh_to_truth")),
                    }
                )
    if not rows:
        return ""
    text = (
        "\n## Crust\n\nAll points of the cloud, wherever they are, against skin, eyes, teeth, tongue and collar; the "
    )
    return text + "same depth maps fused twice.\n\n" + markdown(rows)


def _face(record: Results, key: str) -> list[float]:
    return list(record["regions"]["face"][key])


def series(saved: Results, named: list[tuple[float, str]]) -> list[tuple[float, Results]]:
    """Measured records of a series in rising order of what is varied."""
    return sorted(
        ((value, saved[name]) for value, name in named if saved.get(name, {}).get("status") == "ok"),
        key=lambda pair: pair[0],
    )


def default_sources() -> int:
    """What the dense stage compares each photo with when nobody says otherwise."""
    from capture_eval.stages.dense import DenseOptions

    return DenseOptions().sources


def growth_series(saved: Results) -> dict[str, list[tuple[float, Results]]]:
    """Photos, megapixels and sources with the records measured for them."""
    sizes = [(width * height / 1e6, f"size_{width}x{height}") for width, height in SIZES]
    sizes += [(CENTRE.megapixels, CENTRE_NAME), (4 * CENTRE.megapixels, LARGE_NAME)]
    return {
        "photos": series(saved, [(n, f"photos_{n}") for n in PHOTOS] + [(CENTRE.views, CENTRE_NAME)]),
        "megapixels": series(saved, sizes),
        "sources": series(saved, [(n, f"sources_{n}") for n in SOURCES] + [(default_sources(), CENTRE_NAME)]),
    }


def seconds_of(kind: str, record: Results) -> float:
    """CPU seconds that grow: of the pose for photos, of one photo otherwise."""
    return record["dense_cpu_s"] / (1 if kind == "photos" else record["photos"])


def exponent(values: list[float], seconds: list[float]) -> float:
    """Slope of a straight line through the logarithms."""
    return float(np.polyfit(np.log(values), np.log(seconds), 1)[0])


def growth_section(saved: Results) -> str:
    """Time and memory against photos, pixels, sources and threads."""
    text = ""
    for kind, pairs in growth_series(saved).items():
        if len(pairs) < 2:
            continue
        values, seconds = [value for value, _ in pairs], [seconds_of(kind, record) for _, record in pairs]
        unit = "dense CPU s" if kind == "photos" else "dense CPU s/photo"
        row = [f"{value:g}: {second:.2f}" for value, second in zip(values, seconds, strict=True)]
        slope, start = np.polyfit(values, seconds, 1)
        memory = ", ".join(f"{record['dense_peak_mb']:.0f}" for _, record in pairs)
        text += f"- {kind} ({unit}): {', '.join(row)}; exponent {exponent(values, seconds):.2f}, "
        text += f"line {start:.2f} + {slope:.2f} per {kind.rstrip('s')}; peak MB {memory}\n"
    threads = [saved.get(f"threads_{count}", {}) for count in (1, 2)]
    if all(record.get("status") == "ok" for record in threads):
        wall = [record["dense_wall_s"] for record in threads]
        cpu = [record["dense_cpu_s"] for record in threads]
        text += (
            f"- threads (12 photos of 320 × 240, quiet machine): wall {wall[0]:.1f} s with one, {wall[1]:.1f} s with "
        )
        text += f"two (ratio {wall[0] / wall[1]:.2f}); CPU {cpu[0]:.1f} and {cpu[1]:.1f} s\n"
    note = f"Each photo is compared with up to {default_sources()} others; fewer photos have fewer others, so that the"
    note += " exponent over so few photos is above one.\n"
    return f"\n## Growth\n\n{text}\n{note}" if text else ""


def calibration_section(cases: list[Case], saved: Results) -> str:
    """Whether the stated deviation of points is the real one."""
    rows = []
    for case in cases:
        stated = saved[case.name].get("calibration", {})
        if case.group in ("heads", "large") and stated:
            row = {
                "scene": f"{scene_label(case)}, {case.scene.width} × {case.scene.height}",
                "poses": "true" if case.known else "solved",
            }
            for name, numbers in stated.items():
                row[f"{name}, within 1/2 deviations (.683/.954)"] = cell(numbers["within"])
            rows.append(row)
    if not rows:
        return ""
    text = (
        "\n## Stated uncertainty\n\nDistance of fused points and of vertices of the mesh to the true surfaces, against "
    )
    return text + "their `deviation`; normal errors would give .683 and .954.\n\n" + markdown(rows)


def variants_section(cases: list[Case], saved: Results) -> str:
    """The other cases: number of photos, sizes, effort."""
    chosen = [case for case in cases if case.group in ("photos", "sizes", "effort")]
    if not chosen:
        return ""
    rows = [figures(case, saved[case.name], "face", case.name.replace("_", " ")) for case in chosen]
    centre = next((case for case in cases if case.name == CENTRE_NAME), None)
    if centre is not None:
        rows.insert(0, figures(centre, saved[centre.name], "face", "centre: defaults, 24 photos, 640x480"))
    rows = [{key: value for key, value in row.items() if key not in ("poses", "region")} for row in rows]
    return "\n## Varied round the centre, face, true poses\n\n" + markdown(rows)


def _pixel(cases: list[Case], saved: Results) -> str:
    """Mean width of a pixel at the head, % of D, over the cases of 640 x 480."""
    widths = [
        saved[case.name]["pixel_percent"]
        for case in cases
        if case.group == "heads" and "pixel_percent" in saved[case.name]
    ]
    return cell([float(np.mean(widths))]) if widths else "-"


def write_page(cases: list[Case], saved: Results, plots: dict[str, str]) -> str:
    """The whole page; `plots` is file name -> caption. Cases without a row are named as missing."""
    missing = [case for case in cases if case.name not in saved]
    cases = [case for case in cases if case.name in saved]
    text = INTRODUCTION.format(centre=CENTRE_NAME, pixel=_pixel(cases, saved))
    commits = sorted({saved[case.name].get("commit", "") for case in cases} - {""})
    text += f"Measured at commit {', '.join(commits)}. {saved.get('note', {}).get('text', '')}".strip() + "\n"
    text += aims_section(cases, saved)
    text += heads_section(cases, saved, "heads", "640x480") + heads_section(cases, saved, "large", "1280x960")
    text += peers_section(cases, saved) + crust_section(cases, saved) + variants_section(cases, saved)
    text += growth_section(saved) + calibration_section(cases, saved)
    skipped = [case for case in cases if saved[case.name]["status"] == "skipped"]
    text += "".join(f"\nNot measured: {case.name} ({saved[case.name]['reason']}).\n" for case in skipped)
    if missing:
        text += f"\nNot measured yet: {', '.join(f'`{case.name}`' for case in missing)}.\n"
    if plots:
        text += "\n## Plots\n" + "".join(f"\n![{caption}]({name})\n\n{caption}\n" for name, caption in plots.items())
    return text
