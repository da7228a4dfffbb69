#!/usr/bin/env python3
"""Drift of `--rig off` and `--rig paper` against each effect of the rendered world, and COLMAP
without a rig beside them.

  pip install numpy pycolmap==4.2.1
  cargo build --release
  python bench/drift.py     every effect alone, none and all; open drive and closed loop
  python bench/drift.py --effects none,lens --routes loop --rigs off --seeds 1,2

Each drive is rendered by `tiepoint synth` (two cameras half a metre apart) and reconstructed by
`tiepoint reconstruct`, features and matches made once for it. COLMAP's incremental mapper gets the
same database: the same keypoints, verified matches, cameras and camera model; it knows of no rig.
Both begin from the focal length of the lens on its axis, as a camera's data sheet gives it, and
refine it: from 1.2 image widths, twice the true one, COLMAP finds two images of an open drive and
no third (`--no-prior` repeats that). ATE is the root mean square distance of all camera centres of
both cameras from the truth after a similarity (Umeyama 1991); the baseline's spread is the standard
deviation of the distance of the two cameras' images nearest in time, as a part of its mean. Models
that jump (one step between neighbours wrong by more than 2 m) are told, since that is no drift.
COLMAP should drift within a factor two of `off`, else something is wrong. Prints a table in
Markdown; raw numbers go to bench/results/drift-*.json. Missing images are told by their number;
models with less than 90 % of them are not compared."""

import argparse
import csv
import datetime
import json
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pycolmap
from colmap import largest, map_database, umeyama
from program import ROOT, program_of

EFFECTS = [
    "none",
    "lens",
    "rolling-shutter",
    "vibration",
    "misalignment",
    "traffic",
    "clocks",
    "photometry",
    "all",
]
# The action camera's lens is no perspective lens with a little distortion; this is the nearest
# family that both programs fit.
MODELS = {"lens": "THIN_PRISM_FISHEYE", "all": "THIN_PRISM_FISHEYE"}


def run(command, log):
    with open(log, "a") as file:
        done = subprocess.run(
            list(map(str, command)), stdout=subprocess.PIPE, stderr=file, text=True
        )
    if done.returncode != 0:
        raise RuntimeError(
            f"{command[1]} failed: " + Path(log).read_text()[-500:].strip().split("\n")[-1]
        )
    return done.stdout


def truth_of(drive):
    """True centre and stamp of each image."""
    centres = {}
    for row in csv.DictReader((drive / "truth/poses.csv").open()):
        w, x, y, z = (float(row[k]) for k in ("qw", "qx", "qy", "qz"))
        rotation = np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
            ]
        )
        centres[row["image"]] = -rotation.T @ np.array([float(row[k]) for k in ("tx", "ty", "tz")])
    stamps = {
        row["image"]: float(row["seconds"])
        for row in csv.DictReader((drive / "timestamps.csv").open())
    }
    return centres, stamps


def align(model, centres):
    """Names of the images with a pose, their centres moved onto the truth, and the truth."""
    images = {image.name: image for image in model.images.values() if image.has_pose}
    names = sorted(images)
    found = np.array([images[name].projection_center() for name in names])
    truth = np.array([centres[name] for name in names])
    scale, rotation, translation = umeyama(found, truth)
    return names, scale * found @ rotation.T + translation, truth


def measure(model, centres, stamps):
    """ATE in metres, and the spread of the baseline as a part of its mean."""
    names, found, truth = align(model, centres)
    place = dict(zip(names, found))
    errors = np.linalg.norm(found - truth, axis=1)
    left, right = (
        [name for name in names if name.startswith(side)] for side in ("left/", "right/")
    )
    interval = np.median(
        np.diff(sorted(stamps[name] for name in stamps if name.startswith("left/")))
    )
    jump = max(
        (
            abs(np.linalg.norm(found[a] - found[a - 1]) - np.linalg.norm(truth[a] - truth[a - 1]))
            for a in range(1, len(names))
            if names[a].split("/")[0] == names[a - 1].split("/")[0]
        ),
        default=0.0,
    )
    baselines = []
    for name in left:
        partner = min(right, key=lambda other: abs(stamps[other] - stamps[name]), default=None)
        if partner and abs(stamps[partner] - stamps[name]) <= interval / 2:
            baselines.append(np.linalg.norm(place[name] - place[partner]))
    return {
        "registered": len(names),
        "images": len(centres),
        "ate_m": float(np.sqrt((errors**2).mean())),
        "baseline_m": float(np.mean(baselines)) if baselines else None,
        "baseline_spread": float(np.std(baselines) / np.mean(baselines)) if baselines else None,
        "error_px": model.compute_mean_reprojection_error(),
        "jump_m": float(jump),
    }


def run_drive(effect, route, seed, arguments, work):
    """All programs on one drive: rows by name."""
    drive, log, program = work / "drive", work / "log", arguments.program
    frames = ["--frames", arguments.frames] if arguments.frames else []
    rendered = run(
        [
            program,
            "synth",
            "-o",
            drive,
            "--effects",
            effect,
            "--route",
            route,
            "--length",
            arguments.length,
            "--rate",
            arguments.rate,
            "--size",
            arguments.size,
            "--seed",
            seed,
            "--view-direction",
            arguments.view_direction,
            "--json",
            *frames,
        ],
        log,
    )
    centres, stamps = truth_of(drive)
    rows, first = {}, None
    for rig in arguments.rigs:
        workspace = work / rig
        if first:
            shutil.copytree(first, workspace)
        command = [
            program,
            "reconstruct",
            drive,
            "-o",
            workspace,
            "--timestamps",
            drive / "timestamps.csv",
            "--pairs",
            arguments.pairs,
            "--rig",
            rig,
            "--threads",
            arguments.threads,
        ]
        command += ["--camera-model", MODELS[effect]] if effect in MODELS else []
        command += (
            ["--focal-prior", json.loads(rendered)["cameras"][0]["focal_px"]]
            if arguments.prior
            else []
        )
        command += ["--redo", "map"] if first else []
        report = json.loads(run([*command, "--json"], log))
        first = first or workspace
        rows[rig] = measure(pycolmap.Reconstruction(workspace / "sparse/0"), centres, stamps)
        rows[rig]["seconds"] = report["stages"]["map"]["seconds"]
    if arguments.colmap:
        # A copy: COLMAP may migrate or lock what it opens.
        shutil.copy(first / "database.db", work / "database.db")
        start = time.perf_counter()
        model = largest(
            map_database(
                work / "database.db", drive, work / "sparse", None, arguments.threads, seed
            ).values()
        )
        if model is None:
            raise RuntimeError("COLMAP made no model")
        rows["colmap"] = {**measure(model, centres, stamps), "seconds": time.perf_counter() - start}
    return rows


# A step between two images that is wrong by more is no drift: a facade's windows were taken for
# others, one period on.
JUMP_M = 2.0


def is_whole(row):
    return row["registered"] >= 0.9 * row["images"]


def cell(rows):
    """Medians over the seeds."""
    missing = sum(row["images"] - row["registered"] for row in rows)
    rows = [row for row in rows if is_whole(row)]
    told = f" ({missing} images missing)" if missing else ""
    if not rows:
        return "-" + told
    ate, spread = (
        statistics.median(row[key] for row in rows) for key in ("ate_m", "baseline_spread")
    )
    jumps = sum(row["jump_m"] > JUMP_M for row in rows)
    told += f" (jumps in {jumps} of {len(rows)})" if jumps else ""
    return f"{ate:.3f} / {100 * spread:.2f} %{told}"


def main():
    words = lambda text: text.split(",")
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--effects", type=words, default=EFFECTS, help="commas between; + joins effects"
    )
    parser.add_argument("--routes", type=words, default=["open", "loop"])
    parser.add_argument("--rigs", type=words, default=["off", "paper"])
    parser.add_argument("--seeds", type=words, default=["1"])
    parser.add_argument(
        "--no-prior",
        dest="prior",
        action="store_false",
        help="leave the focal length to the programs",
    )
    parser.add_argument("--no-colmap", dest="colmap", action="store_false")
    parser.add_argument("--length", type=float, default=160.0, help="of the street, in metres")
    parser.add_argument("--rate", type=float, default=2.5, help="images a second")
    parser.add_argument("--frames", type=int, help="at most so many of each camera")
    parser.add_argument("--size", default="640x480")
    parser.add_argument("--view-direction", default="front")
    parser.add_argument("--pairs", default="sequential:6+ends")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--program", type=Path)
    parser.add_argument("--work", type=Path, help="where to put workspaces (default: the system's)")
    arguments = parser.parse_args()
    arguments.program = program_of(arguments)
    pycolmap.logging.minloglevel = pycolmap.logging.Level.ERROR.value
    columns = arguments.rigs + (["colmap"] if arguments.colmap else [])
    print(
        "ATE in metres / spread of the baseline; medians over the seeds "
        + ", ".join(arguments.seeds)
        + ".\n"
    )
    titles = [f"`{name}`" if name != "colmap" else "COLMAP, no rig" for name in columns]
    print("| route | effect | " + " | ".join(titles) + " | COLMAP's ATE / ours |")
    print("|---" * (len(columns) + 3) + "|")
    results = []
    for route in arguments.routes:
        for effect in arguments.effects:
            found, failed = {name: [] for name in columns}, []
            for seed in arguments.seeds:
                with tempfile.TemporaryDirectory(dir=arguments.work) as folder:
                    try:
                        rows = run_drive(effect, route, int(seed), arguments, Path(folder))
                    except RuntimeError as error:
                        failed.append(f"seed {seed}: {error}")
                        continue
                results.append({"route": route, "effect": effect, "seed": int(seed), **rows})
                for name, row in rows.items():
                    found[name].append(row)
            cells = [cell(found[name]) if found[name] else "-" for name in columns]
            ratios = [
                c["ate_m"] / o["ate_m"]
                for c, o in zip(found.get("colmap", []), found.get("off", []))
                if is_whole(c) and is_whole(o)
            ]
            ratio = f"{statistics.median(ratios):.2f}" if ratios else "-"
            print(f"| {route} | {effect} | " + " | ".join(cells) + f" | {ratio} |", flush=True)
            for line in failed:
                print(f"{effect}, {line}", file=sys.stderr, flush=True)
    folder = ROOT / "bench/results"
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"drift-{datetime.datetime.now().strftime('%Y%m%d-%H%M%S')}.json"
    settings = {key: str(value) for key, value in vars(arguments).items()}
    path.write_text(
        json.dumps(
            {"settings": settings, "pycolmap": pycolmap.__version__, "drives": results}, indent=1
        )
    )
    print(f"\n{path.relative_to(ROOT)}")


if __name__ == "__main__":
    main()
