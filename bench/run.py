#!/usr/bin/env python3
"""Measures a table of docs/benchmarks and writes it.

    pip install numpy pycolmap==4.2.1
    cargo build --release && cargo build --release -p tiepoint-ba --example bal
    TIEPOINT_DATA=... python bench/run.py photos kitti demo ba-ceres dense    measures and writes
    python bench/run.py --refresh                                     generates all pages again

A measurement writes docs/benchmarks/results/NAME.json: the commit, whether files differed from it,
the processor and its instruction sets, the date, the seeds and every run. The page gets the table
between `<!-- table: NAME -->` and `<!-- end -->`, generated from that file alone. Below the table
stands what it was measured on, and, if the code that it measures has changed since, that it is
older than the code. Let nothing else run while times are measured.
"""

import argparse
import datetime
import json
import os
import pathlib
import statistics
import subprocess
import sys
import tempfile

from program import ROOT, kitti_intrinsics, program_of

PAGES = ROOT / "docs/benchmarks"
RESULTS = PAGES / "results"
SEEDS = [0, 1, 2]
# Instruction sets on which times depend.
INSTRUCTION_SETS = ["avx2", "fma", "avx512f", "avx512_vnni", "avx_vnni"]
LIBRARIES = ["geometry", "features", "matching", "ba", "rig", "scene", "adjust", "sfm", "io",
             "pipeline"]


def data():
    folder = os.environ.get("TIEPOINT_DATA")
    if folder is None:
        sys.exit("TIEPOINT_DATA is not set: it is the folder of the reference data")
    return pathlib.Path(folder)


def git(*words):
    done = subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=True)
    return done.stdout.strip()


def script(name, *words):
    """Runs a script beside this one; its raw results as JSON."""
    with tempfile.TemporaryDirectory() as folder:
        path = pathlib.Path(folder) / "results.json"
        command = [sys.executable, ROOT / "bench" / name, *words, "--results", path]
        subprocess.run(list(map(str, command)), check=True)
        return json.loads(path.read_text())


def tiepoint(*words):
    command = [str(word) for word in (program_of(), *words)]
    done = subprocess.run(command + ["--json"], capture_output=True, text=True)
    if done.returncode != 0:
        sys.exit(f"{' '.join(command)}: {done.stderr.strip().splitlines()[-1]}")
    return json.loads(done.stdout)


def middle(values, digits):
    return f"{statistics.median(values):.{digits}f}"


def grouped(value):
    return f"{round(value):,}"


# ---- photos: from photos to a model, beside COLMAP ----------------------------------------------


def measure_photos():
    sets = ["fountain-P11", "Herz-Jesus-P8", "sceaux"]
    words = ["--seeds", len(SEEDS), "--colmap-seeds", len(SEEDS)]
    return script("colmap.py", *sets, *words)["cases"]


def table_photos(cases):
    head = (
        "input | registered | mean centre error (mm): COLMAP | COLMAP, equal freedom | tiepoint"
        " | reprojection error (px): COLMAP / tiepoint | observations: COLMAP / tiepoint"
        " | wall time (s): COLMAP / tiepoint | ratio"
    )
    rows = [head.split(" | ")]
    for case in cases:
        colmap, ours = case["colmap"], case["tiepoint"]

        def error(runs):
            found = [run["mean_centre_error_mm"] for run in runs if "mean_centre_error_mm" in run]
            return middle(found, 2) if found else "no truth"

        def both(key, digits):
            return " / ".join(middle([run[key] for run in runs], digits) for runs in (colmap, ours))

        equal = [run["equal_freedom"] for run in colmap if "equal_freedom" in run]
        observations = " / ".join(
            grouped(statistics.median(run["observations"] for run in runs))
            for runs in (colmap, ours)
        )
        walls = [statistics.median(run["wall_s"] for run in runs) for runs in (colmap, ours)]
        is_known = case["calibration"] == "known"
        rows.append(
            [
                f"{case['data']}, {'K' if is_known else 'uncalibrated'}",
                f"{min(run['registered'] for run in ours)} / {ours[0]['images']}",
                error(colmap),
                "the same" if is_known else error(equal),
                error(ours),
                both("mean_reprojection_error_px", 3),
                observations,
                f"{walls[0]:.1f} / {walls[1]:.1f}",
                f"{walls[1] / walls[0]:.3f}",
            ]
        )
    return rows


# ---- phone_folders: folders of a phone, beside COLMAP and beside the clean folder ----------------


def measure_phone_folders():
    return script("phone_folders.py", "--seeds", len(SEEDS))["runs"]


def table_phone_folders(runs):
    head = (
        "set, folder | registered: COLMAP / tiepoint | distractors | error: COLMAP / tiepoint"
        " | tiepoint to its clean | focal lengths off by (%): COLMAP / tiepoint | cameras"
    )
    rows = [head.split(" | ")]

    def of(name, folder, program):
        keys = (name, folder, program)
        return [run for run in runs if (run["set"], run["folder"], run["program"]) == keys]

    def value(found, key, scale, digits):
        values = [scale * run[key] for run in found if key in run]
        return middle(values, digits) if values else "none"

    for name, folder in dict.fromkeys((run["set"], run["folder"]) for run in runs):
        colmap, ours = of(name, folder, "colmap"), of(name, folder, "tiepoint")
        clean = [run["error"] for run in of(name, "clean", "tiepoint") if "error" in run]
        errors = [run["error"] for run in ours if "error" in run]
        base = statistics.median(clean) if clean else 0
        # Without truth the clean folder's model is the reference, and its own error rounding.
        ratio = f"{statistics.median(errors) / base:.2f}" if errors and base > 1e-6 else "no truth"
        both = [found for found in (colmap, ours) if found]
        rows.append(
            [
                f"{name}, {folder}",
                " / ".join(f"{min(run['registered'] for run in found)}" for found in both)
                + f" of {ours[0]['photos']}",
                " / ".join(value(found, "distractors", 1, 0) for found in both),
                " / ".join(value(found, "error", 1, 2) for found in both),
                ratio,
                " / ".join(value(found, "focal", 100, 2) for found in both),
                value(ours, "cameras", 1, 0),
            ]
        )
    return rows


# ---- pairs: photos in no order, beside COLMAP's vocabulary tree ---------------------------------


def measure_pairs():
    return script("pairs.py")


def table_pairs(runs):
    head = (
        "1,000 photos in no order | pairs | true pairs found | share of true ones among the chosen"
        " | time (s) | peak memory (MiB)"
    )
    rows = [head.split(" | ")]
    for run in runs:
        selection = run["method"]
        if run["selection"] not in selection:
            selection += f" ({run['selection']})"
        rows.append(
            [
                selection,
                grouped(run["pairs"]),
                f"{run['recall']:.3f}",
                f"{run['precision']:.3f}",
                f"{run['seconds']:.1f}",
                f"{run['peak_mib']:.0f}",
            ]
        )
    return rows


# ---- kitti: the modes of --rig on clips of 51 frames --------------------------------------------

KITTI_MODES = ["off", "paper", "soft", "auto", "rigid"]


def measure_kitti():
    runs = []
    for drive in ["kitti04", "kitti01"]:
        folder = data() / drive
        intrinsics = ",".join(map(repr, kitti_intrinsics(folder)))
        with tempfile.TemporaryDirectory() as scratch:
            workspace = pathlib.Path(scratch) / "ws"
            images = folder / "images"
            tiepoint("features", images, "-o", workspace, "--intrinsics", intrinsics)
            tiepoint("match", workspace, "--pairs", "sequential:10")
            for mode in KITTI_MODES:
                for seed in SEEDS:
                    options = ["--rig", mode, "--seed", seed, "--redo", "map"]
                    tiepoint("map", workspace, *options)
                    truth = ["--truth", f"kitti:{folder / 'poses.txt'}"]
                    found = tiepoint("evaluate", "poses", workspace, *truth)
                    runs.append(
                        {
                            "drive": drive,
                            "mode": mode,
                            "seed": seed,
                            "registered": found["registered"],
                            "images": found["images"],
                            "ate_cm": 100 * found["centre_error"]["rmse"],
                        }
                    )
                    print(runs[-1], flush=True)
    return runs


def table_kitti(runs):
    rows = [["drive, 2 × 51 frames", *(f"`{mode}`" for mode in KITTI_MODES)]]
    for drive in dict.fromkeys(run["drive"] for run in runs):
        cells = []
        for mode in KITTI_MODES:
            errors = [r["ate_cm"] for r in runs if (r["drive"], r["mode"]) == (drive, mode)]
            cells.append(f"{middle(errors, 2)} ({min(errors):.2f} to {max(errors):.2f})")
        rows.append([drive, *cells])
    return rows


# ---- known-rig: a rig with known extrinsics, where matches of some frames are deleted -----------

DELETED = {
    "all": "nothing",
    "right": "all of 6 right images",
    "both": "all but 24 keypoints of each image of 6 frames",
}


def measure_known_rig():
    return script("known_rig.py", "--seeds", len(SEEDS))["runs"]


def table_known_rig(runs):
    head = (
        "drive | deleted matches | `--rig` | registered | ATE (cm)"
        " | largest error of an image of these frames (cm) | scale"
    )
    rows = [head.split(" | ")]
    for key in dict.fromkeys((run["drive"], run["case"], run["mode"]) for run in runs):
        chosen = [run for run in runs if (run["drive"], run["case"], run["mode"]) == key]
        drive, case, mode = key
        poor = [run["poor_max_cm"] for run in chosen if run["poor_max_cm"] is not None]
        rows.append(
            [
                drive,
                DELETED[case],
                "known" if mode == "known" else f"`{mode}`",
                f"{min(run['registered'] for run in chosen)} / 102",
                middle([run["ate_cm"] for run in chosen], 2),
                middle(poor, 1) if poor else "none registered",
                middle([run["scale"] for run in chosen], 4) if mode == "known" else "free",
            ]
        )
    return rows


# ---- demo: the drives of `tiepoint demo` with ten seeds -----------------------------------------

DEMO_MODES = ["off", "paper", "auto"]
DEMO_SEEDS = list(range(1, 11))


def measure_demo():
    runs = []
    for seed in DEMO_SEEDS:
        with tempfile.TemporaryDirectory() as scratch:
            outcome = tiepoint("demo", "-o", pathlib.Path(scratch) / "demo", "--seed", seed)
        for drive in outcome["drives"]:
            for run in drive["runs"]:
                runs.append(
                    {
                        "drive": drive["name"],
                        "mode": run["rig"],
                        "seed": seed,
                        "registered": run["poses"]["registered"],
                        "images": run["poses"]["images"],
                        "ate_cm": 100 * run["poses"]["centre_error"]["rmse"],
                        "scale_drift": run["scale_drift"],
                        "demo_s": outcome["seconds"],
                    }
                )
                print(runs[-1], flush=True)
    return runs


def demo_ratios(runs, drive):
    """ATE of `auto` over that of `off`, by seed."""
    found = {(r["mode"], r["seed"]): r["ate_cm"] for r in runs if r["drive"] == drive}
    return [found["auto", seed] / found["off", seed] for seed in DEMO_SEEDS]


def table_demo(runs):
    heads = (f"ATE (cm), `{mode}`" for mode in DEMO_MODES)
    rows = [["drive", *heads, "`auto` / `off`, seeds in order", "seeds at 0.5 or less"]]
    for drive in dict.fromkeys(run["drive"] for run in runs):
        cells = []
        for mode in DEMO_MODES:
            errors = [r["ate_cm"] for r in runs if (r["drive"], r["mode"]) == (drive, mode)]
            # The loop has no `paper`.
            if not errors:
                cells.append("-")
                continue
            cells.append(f"{middle(errors, 2)} ({min(errors):.2f} to {max(errors):.2f})")
        ratios = demo_ratios(runs, drive)
        halved = sum(ratio <= 0.5 for ratio in ratios)
        listed = ", ".join(f"{ratio:.2f}" for ratio in ratios)
        rows.append([drive, *cells, listed, f"{halved} of {len(ratios)}"])
    return rows


# ---- ba-ceres: bundle adjustment beside Ceres ---------------------------------------------------


# Problems of "Bundle adjustment in the large" by the names of their files.
BAL = {"problem-21-11315-pre": "Trafalgar-21", "problem-49-7776-pre": "Ladybug-49"}


def measure_ba_ceres():
    return script("ba.py")


def table_ba_ceres(problems):
    head = (
        "problem | final cost, Ceres | tiepoint-ba | ms a step, Ceres | tiepoint-ba"
        " | ms to Ceres' cost + 0.1 %, Ceres | tiepoint-ba | ratio"
    )
    rows = [head.split(" | ")]
    for problem in problems:
        solvers = dict(problem["solvers"])
        ours = solvers.pop("tiepoint")
        analytic = {name: s for name, s in solvers.items() if name.endswith("analytic")}
        quickest = min(analytic.values(), key=lambda solver: solver["ms_to_goal"])
        best = min(solver["final_cost"] for solver in solvers.values())
        rows.append(
            [
                BAL.get(problem["problem"], problem["problem"]),
                f"{best:.6e}",
                f"{ours['final_cost']:.6e}",
                f"{quickest['ms_a_step']:.1f}",
                f"{ours['ms_a_step']:.1f}",
                f"{quickest['ms_to_goal']:.1f}",
                f"{ours['ms_to_goal']:.1f}",
                f"{quickest['ms_to_goal'] / ours['ms_to_goal']:.1f}",
            ]
        )
    return rows


# ---- dense: dense clouds beside OpenMVS ---------------------------------------------------------


def measure_dense():
    return script("dense.py")["cases"]


def table_dense(cases):
    programs = list(dict.fromkeys(name for case in cases for name in case["programs"]))
    of = lambda what: " / ".join(programs) if len(programs) > 1 else what
    head = (
        f"input, poses | megapixels | CPU s a megapixel: {of('tiepoint')} | points"
        " | accuracy at 1, 2, 5 footprints (%) | completeness (%) | F1 (%) | other truth"
        " | peak (MiB)"
    )
    rows = [head.split(" | ")]
    for case in cases:
        found = [case["programs"][name] for name in programs if name in case["programs"]]

        def all_of(show):
            return " / ".join(show(one) for one in found)

        def shares(key):
            return all_of(lambda one: ", ".join(f"{value:.1f}" for value in one.get(key, [])))

        def other(one):
            if "lidar_median_m" in one:
                return f"{100 * one['lidar_median_m']:.1f} cm ({one['lidar_share']:.0f} % near it)"
            return f"{one['agreement']:.0f} % near the other" if "agreement" in one else ""

        rows.append(
            [
                f"{case['case']}, {case['poses']}",
                f"{found[0]['megapixels']:.1f}",
                all_of(lambda one: f"{one['cpu_s'] / one['megapixels']:.1f}"),
                all_of(lambda one: grouped(one["points"])),
                shares("accuracy"),
                shares("completeness"),
                shares("f1"),
                all_of(other),
                all_of(lambda one: grouped(one.get("peak_mib", 0))),
            ]
        )
    return rows


# ---- undistort: images and keypoints beside COLMAP -----------------------------------------------


def measure_undistort():
    return script("undistort.py")["runs"]


def table_undistort(runs):
    head = (
        "camera model | within 1 grey level (%): photo | noise | largest difference: photo | noise"
        " | keypoints off by (px) | ns a pixel: COLMAP | tiepoint | ratio"
    )
    rows = [head.split(" | ")]
    for run in runs:
        pixels = run["size"][0] * run["size"][1]
        # A time is a difference of two, and that of a copy may be noise below zero.
        times = [max(1e9 * run[key] / pixels, 0) for key in ("colmap_s", "tiepoint_s")]
        images = [run["photo.png"], run["noise.png"]]
        # A camera without distortion is copied.
        is_copied = run["model"] in ("SIMPLE_PINHOLE", "PINHOLE")
        rows.append(
            [
                f"`{run['model']}`",
                *(f"{100 * image['share']:.2f}" for image in images),
                *(str(image["worst"]) for image in images),
                f"{run['keypoint_off_px']:.0e}",
                f"{times[0]:.1f}",
                f"{times[1]:.1f}",
                "copied" if is_copied else f"{times[0] / times[1]:.1f}",
            ]
        )
    return rows


# ---- splats: poses of the rows of rolling-shutter images -----------------------------------------


def measure_splats():
    return script("splats.py")["runs"]


def table_splats(runs):
    head = (
        "drive | poses | readout (ms) | images | first and last row off by (mm): median | largest"
        " | (°): median | largest | flow (px): median | 90 % | median, pose of the middle row alone"
    )
    rows = [head.split(" | ")]
    for run in runs:
        moved, turned, flow = run["moved_mm"], run["turned_deg"], run["flow_px"]
        rows.append(
            [
                run["view_direction"],
                run["poses"],
                " and ".join(f"{value:.2f}" for value in run["readouts_ms"]),
                str(run["images"]),
                f"{moved['median']:.2f}",
                f"{moved['max']:.2f}",
                f"{turned['median']:.4f}",
                f"{turned['max']:.4f}",
                f"{flow['median']:.3f}",
                f"{flow['p90']:.3f}",
                f"{run['flow_of_middle_px']['median']:.2f}",
            ]
        )
    return rows


# ---- colmap-commands: scripts that drive COLMAP -------------------------------------------------


def measure_colmap_commands():
    return script("colmap_commands.py")["cases"]


def table_colmap_commands(cases):
    head = (
        "commands | files and columns that only COLMAP has | images: COLMAP / tiepoint | points"
        " | reprojection error (px) | centres off the truth (mm): COLMAP, twice / tiepoint"
        " | from COLMAP's first run, centres (‰ of their extent): COLMAP again / tiepoint"
        " | rotations (°) | time (s): COLMAP / tiepoint"
    )
    rows = [head.split(" | ")]
    for case in cases:
        models, apart = case["models"], case["to_colmap"]
        first, again, ours = (models[name] for name in ("colmap", "colmap again", "tiepoint"))
        both = [apart[name] for name in ("colmap again", "tiepoint")]
        absent = [f"`{name}`" for name in case["missing"] + case["missing_columns"]]

        def pair(key, digits):
            return " / ".join(f"{model[key]:.{digits}f}" for model in (first, ours))

        def away(key, digits):
            return " / ".join(f"{one[key]:.{digits}f}" for one in both)

        seconds = [case["seconds"][name] for name in ("colmap", "tiepoint")]
        rows.append(
            [
                case["script"],
                " ".join(absent) or "none",
                pair("images", 0),
                pair("points", 0),
                pair("reprojection_px", 3),
                f"{first['centres_mm']:.1f}, {again['centres_mm']:.1f} / {ours['centres_mm']:.1f}",
                away("centres_per_mille", 2),
                away("rotations_deg", 3),
                " / ".join("failed" if value is None else f"{value:.1f}" for value in seconds),
            ]
        )
    return rows


# ---- the tables ---------------------------------------------------------------------------------

SEEDED = f"medians of seeds {SEEDS[0]} to {SEEDS[-1]}"
LEAST = "the least of five runs"
ONCE = "one run each"
DEMO = f"medians of seeds {DEMO_SEEDS[0]} to {DEMO_SEEDS[-1]}"
ONE = "one run"
# Of each: its page, the crates that it measures, how to measure and how to show it, which run
# counts.
TABLES = {
    "photos": ("photos.md", LIBRARIES, measure_photos, table_photos, SEEDED),
    "phone_folders": ("photos.md", LIBRARIES, measure_phone_folders, table_phone_folders, SEEDED),
    "pairs": ("matching.md", ["matching", "pipeline", "synth"], measure_pairs, table_pairs, ONE),
    "kitti": ("drives.md", LIBRARIES, measure_kitti, table_kitti, SEEDED),
    "known-rig": ("drives.md", LIBRARIES, measure_known_rig, table_known_rig, SEEDED),
    "demo": ("experiments.md", [*LIBRARIES, "synth"], measure_demo, table_demo, DEMO),
    "dense": ("dense.md", ["dense", "geometry", "pipeline"], measure_dense, table_dense, ONCE),
    "undistort": (
        "undistort.md",
        ["dense", "geometry", "io"],
        measure_undistort,
        table_undistort,
        ONE,
    ),
    "splats": (
        "splats.md",
        ["geometry", "adjust", "sfm", "io", "pipeline", "synth"],
        measure_splats,
        table_splats,
        ONE,
    ),
    "colmap-commands": (
        "colmap_commands.md",
        [*LIBRARIES, "cli"],
        measure_colmap_commands,
        table_colmap_commands,
        ONE,
    ),
    "ba-ceres": ("ba.md", ["ba"], measure_ba_ceres, table_ba_ceres, LEAST),
}


def machine():
    lines = pathlib.Path("/proc/cpuinfo").read_text().splitlines()
    fields = dict(line.split(":", 1) for line in reversed(lines) if ":" in line)
    fields = {name.strip(): value.strip() for name, value in fields.items()}
    flags = fields.get("flags", "").split()
    return {
        "processor": fields.get("model name", "unknown"),
        "family": fields.get("cpu family"),
        "model": fields.get("model"),
        "instruction_sets": [name for name in INSTRUCTION_SETS if name in flags],
        "cores": os.cpu_count(),
    }


def measure(name):
    _, crates, run, _, which = TABLES[name]
    paths = [f"crates/{crate}/src" for crate in crates]
    result = {
        "table": name,
        "commit": git("rev-parse", "HEAD"),
        "has_local_changes": bool(git("status", "--porcelain", "--", *paths)),
        "date": datetime.date.today().isoformat(),
        "machine": machine(),
        "counts": which,
        "load_before": os.getloadavg()[0],
        "runs": run(),
    }
    RESULTS.mkdir(parents=True, exist_ok=True)
    (RESULTS / f"{name}.json").write_text(json.dumps(result, indent=1) + "\n")


def note(name, result):
    """What a table was measured on, and whether the code has changed since."""
    paths = [f"crates/{crate}/src" for crate in TABLES[name][1]]
    where = result["machine"]
    text = (
        f"Measured at {result['commit'][:7]} on {result['date']}: {where['processor']},"
        f" {where['cores']} cores, {', '.join(where['instruction_sets'])};"
        f" {result['counts']}."
    )
    if result["has_local_changes"]:
        text += " The files differed from that commit."
    changed = git("diff", "--stat", "--shortstat", result["commit"], "HEAD", "--", *paths)
    if changed:
        count = git("rev-list", "--count", f"{result['commit']}..HEAD", "--", *paths)
        text += f" **Older than the code**: {count} commits have changed it since."
    return wrapped(text)


def wrapped(text, columns=100):
    lines = [""]
    for word in text.split(" "):
        if lines[-1] and len(lines[-1]) + 1 + len(word) > columns:
            lines.append("")
        lines[-1] += (" " if lines[-1] else "") + word
    return "\n".join(lines)


def generate(name):
    result = result_of(name)
    if result is None:
        return
    page, _, _, show, _ = TABLES[name]
    text = f"{markdown(show(result['runs']))}\n\n{note(name, result)}"
    replace(PAGES / page, name, text)


def result_of(name):
    path = RESULTS / f"{name}.json"
    return json.loads(path.read_text()) if path.is_file() else None


def markdown(rows):
    head, *rows = rows
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines)


def replace(path, name, text):
    """Replaces what stands between the marks of a table."""
    page = path.read_text()
    begin, end = f"<!-- table: {name} -->\n", "<!-- end -->"
    before, rest = page.split(begin, 1)
    after = rest.split(end, 1)[1]
    path.write_text(f"{before}{begin}{text}\n{end}{after}")


# ---- the results of the README ------------------------------------------------------------------


def generate_readme():
    """The table of the README, from the results of `photos`, `kitti` and `demo`."""
    names = ("photos", "kitti", "demo")
    results = [result_of(name) for name in names]
    if None in results:
        return
    photos, kitti, demo = (result["runs"] for result in results)
    head = "input | COLMAP | COLMAP, equal freedom or rig | tiepoint | wall time, tiepoint / COLMAP"
    rows = [head.split(" | ")]
    for case in photos:
        colmap, ours = case["colmap"], case["tiepoint"]
        if "mean_centre_error_mm" not in ours[0]:
            continue
        is_known = case["calibration"] == "known"
        equal = [run["equal_freedom"] for run in colmap if "equal_freedom" in run]
        errors = [
            middle([run["mean_centre_error_mm"] for run in runs], 2) if runs else "the same"
            for runs in (colmap, [] if is_known else equal, ours)
        ]
        walls = [statistics.median(run["wall_s"] for run in runs) for runs in (colmap, ours)]
        label = f"{case['data']}, {'calibration known' if is_known else 'uncalibrated'}"
        rows.append([f"{label} (mm)", *errors, f"{walls[1] / walls[0]:.2f}"])
    pairs = [
        ("kitti04, 2 × 51 frames (cm)", "kitti04", kitti),
        ("kitti01, 2 × 51 frames (cm)", "kitti01", kitti),
        ("open street of the demo (cm)", "street", demo),
        ("loop of the demo (cm)", "loop", demo),
    ]
    for label, drive, runs in pairs:
        ate = {
            mode: middle([r["ate_cm"] for r in runs if (r["drive"], r["mode"]) == (drive, mode)], 2)
            for mode in ("off", "auto")
        }
        alone, with_rig = COLMAP_DRIVES.get(drive, ("not run", "not run"))
        ours = f"{ate['off']} without rig, {ate['auto']} `auto`"
        rows.append([label, alone, with_rig, ours, "not timed"])
    measured = ", ".join(
        f"{name} at {result['commit'][:7]} on {result['date']}"
        for name, result in zip(names, results)
    )
    text = wrapped(f"Measured: {measured}; {results[0]['machine']['processor']}, 2 cores.")
    replace(ROOT / "README.md", "results", f"{markdown(rows)}\n\n{text}")


# COLMAP 4.2.1 without a rig, and the better of its two ways with one of unknown calibration. Single
# runs, recorded on the page `drives`.
COLMAP_DRIVES = {
    "kitti04": ("2.37", "2.09 (two passes)"),
    "kitti01": ("29.4", "8.51 (global mapper)"),
}


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("tables", nargs="*", metavar="NAME", help=", ".join(TABLES))
    parser.add_argument("--refresh", action="store_true", help="generates pages, measures nothing")
    arguments = parser.parse_args()
    unknown = [name for name in arguments.tables if name not in TABLES]
    if unknown or not arguments.tables and not arguments.refresh:
        parser.error(f"name one or more of {', '.join(TABLES)}")
    for name in arguments.tables:
        if not arguments.refresh:
            measure(name)
    for name in arguments.tables or TABLES:
        generate(name)
    generate_readme()


if __name__ == "__main__":
    main()
