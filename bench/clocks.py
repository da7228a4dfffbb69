#!/usr/bin/env python3
"""Two cameras whose clocks disagree, with stops and turns: this program and COLMAP on the same
matches.

  pip install numpy pycolmap==4.2.1
  cargo build --release
  python bench/clocks.py --seeds 1,2,3

A rendered loop (`synth --effects clocks`, front cameras half a metre apart) is matched once. Ours
maps it with `--rig off` and `auto`. COLMAP maps a copy of the database without a rig; again with
the rig that this first run gives and frames of the images nearest in time (what its documentation
has for an unknown rig, so it needs the first among the peers); on the same frames with the true
calibration; and with its global mapper and a rig of unknown calibration. Each gets so many minutes.
The last columns have the true intrinsics: `auto`, whose clocks end within 0.1 ms, so that they are
as good as given, while stamps jitter as they do; the oracle, `--rig rigid` with the true moment of
each image as its stamp, without that jitter; and the same drive whose cameras are triggered
together, which are other images of the same street. ATE in metres, as drift.py has it."""

import argparse
import csv
import json
import shutil
import statistics
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pycolmap
from colmap import largest, make_rig, map_globally
from drift import align, run, truth_of
from experiment import SEED, THREADS, copy_database, ended, map_largest, with_frames
from program import program_of

PEERS = ("no rig", "two passes", "known rig", "global mapper")


def ate(model, centres, names=None):
    if names:
        for image in model.images.values():
            image.name = names.get(image.name, image.name)
    registered, found, truth = align(model, centres)
    return {
        "ate_m": float(np.sqrt((np.linalg.norm(found - truth, axis=1) ** 2).mean())),
        "registered": len(registered),
        "images": len(centres),
    }


def true_calibration(drive):
    """cam_from_rig of each camera."""
    values = {}
    for row in csv.DictReader((drive / "truth/cameras.csv").open()):
        if row["quantity"].startswith("rig_"):
            values.setdefault(row["camera"], {})[row["quantity"][-2:]] = float(row["value"])

    def pose(of):
        return pycolmap.Rigid3d(
            pycolmap.Rotation3d(np.array([of[k] for k in ("qx", "qy", "qz", "qw")])),
            np.array([of[k] for k in ("tx", "ty", "tz")]),
        )

    return {camera: pose(of) for camera, of in values.items()}


def peer(which, work, drive, target):
    """In a process of its own: COLMAP's model, judged, as a file."""
    pycolmap.logging.minloglevel = pycolmap.logging.Level.ERROR.value
    centres, _ = truth_of(drive)
    workspace, first = work / which, work / "no rig/model"
    shutil.copytree(work / "off", workspace)
    copy, sparse, names = copy_database(workspace), workspace / "colmap.sparse", None
    if which != "no rig":
        names = with_frames(copy, drive)
    if which == "two passes":
        if not first.exists():
            return
        model, new = pycolmap.Reconstruction(first), {was: to for to, was in names.items()}
        for image in model.images.values():
            image.name = new.get(image.name, image.name)
        make_rig(copy, model)
    elif which == "known rig":
        make_rig(copy, calibration=true_calibration(drive))
    elif which == "global mapper":
        make_rig(copy)
    if which == "global mapper":
        model = largest(map_globally(copy, drive, sparse, None, THREADS, SEED).values())
    else:
        model = map_largest(copy, drive, sparse)
    if model:
        (workspace / "model").mkdir()
        model.write(workspace / "model")
        target.write_text(json.dumps(ate(model, centres, names)))


def true_stamps(drive, target):
    rows = csv.DictReader((drive / "truth/poses.csv").open())
    target.write_text(
        "".join(["image,seconds\n"] + [f"{row['image']},{row['true_seconds']}\n" for row in rows])
    )
    return target


def run_seed(seed, arguments, work):
    program, log, rows = arguments.program, work / "log", {}
    synth = [
        program,
        "synth",
        "--length",
        arguments.length,
        "--rate",
        arguments.rate,
        "--size",
        arguments.size,
        "--seed",
        seed,
        "--json",
    ]
    drive, together, made = work / "drive", work / "together", work / "off"
    rendered = run([*synth, "-o", drive, "--effects", "clocks"], log)
    focal = json.loads(rendered)["cameras"][0]["focal_px"]

    def command(drive, stamps=None):
        stamps = stamps or drive / "timestamps.csv"
        return [
            program,
            "reconstruct",
            drive,
            "--timestamps",
            stamps,
            "--pairs",
            arguments.pairs,
            "--threads",
            THREADS,
            "--json",
        ]

    centres, _ = truth_of(drive)
    run([*command(drive), "-o", made, "--focal-prior", focal, "--rig", "off"], log)
    shutil.copytree(made, work / "auto")
    run(
        [
            *command(drive),
            "-o",
            work / "auto",
            "--focal-prior",
            focal,
            "--rig",
            "auto",
            "--redo",
            "map",
        ],
        log,
    )
    for rig in ("off", "auto"):
        rows[rig] = ate(pycolmap.Reconstruction(work / rig / "sparse/0"), centres)
    for which in arguments.peers:
        target, start = work / f"{which}.json", time.perf_counter()
        if not ended(arguments.minutes, peer, which, work, drive, target):
            rows[which] = {"why": f"not done after {arguments.minutes} minutes"}
        elif target.exists():
            rows[which] = json.loads(target.read_text())
        else:
            rows[which] = {"why": "no model"}
        print(f"seed {seed}, {which}: {time.perf_counter() - start:.0f} s", file=sys.stderr)
    width, height = map(float, arguments.size.split("x"))
    lens = ["--intrinsics", f"{focal},{focal},{width / 2},{height / 2}", "--refine", "none"]
    known = [*lens, "--rig", "rigid"]
    run([*command(drive), "-o", work / "lens", *lens, "--rig", "auto"], log)
    rows["true lens"] = ate(pycolmap.Reconstruction(work / "lens/sparse/0"), centres)
    run(
        [*command(drive, true_stamps(drive, work / "true.csv")), "-o", work / "oracle", *known], log
    )
    rows["oracle"] = ate(pycolmap.Reconstruction(work / "oracle/sparse/0"), centres)
    run([*synth, "-o", together, "--effects", "none"], log)
    run([*command(together), "-o", work / "triggered", *known], log)
    rows["oracle, triggered"] = ate(
        pycolmap.Reconstruction(work / "triggered/sparse/0"), truth_of(together)[0]
    )
    return rows


def main():
    words = lambda text: text.split(",")
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=words, default=["1", "2", "3"])
    parser.add_argument("--length", type=float, default=160.0)
    parser.add_argument("--rate", type=float, default=5.0)
    parser.add_argument("--size", default="640x480")
    parser.add_argument("--pairs", default="sequential:6+ends")
    parser.add_argument(
        "--peers", nargs="*", choices=PEERS, default=list(PEERS), help="of COLMAP; none for no peer"
    )
    parser.add_argument("--minutes", type=float, default=15.0)
    parser.add_argument("--program", type=Path)
    parser.add_argument("--work", type=Path, help="where to put workspaces (default: the system's)")
    arguments = parser.parse_args()
    arguments.program = program_of(arguments)
    columns, results = [
        "off",
        "auto",
        *arguments.peers,
        "true lens",
        "oracle",
        "oracle, triggered",
    ], []
    print(
        "| seed | ours, `off` | ours, `auto` | "
        + "".join(f"COLMAP, {peer} | " for peer in arguments.peers)
        + "true lens | oracle | oracle, triggered |"
    )
    print("|---" * (len(columns) + 1) + "|")
    for seed in arguments.seeds:
        with tempfile.TemporaryDirectory(dir=arguments.work) as folder:
            rows = run_seed(seed, arguments, Path(folder))
        results.append(rows)

        def cell(row):
            if "why" in row:
                return row["why"]
            missing = row["images"] - row["registered"]
            return f"{row['ate_m']:.4f}" + (f" ({missing} missing)" if missing else "")

        print(
            f"| {seed} | " + " | ".join(cell(rows[column]) for column in columns) + " |", flush=True
        )
    medians = [
        [rows[column]["ate_m"] for rows in results if "ate_m" in rows[column]] for column in columns
    ]
    print(
        "| median | "
        + " | ".join(f"{statistics.median(values):.4f}" if values else "-" for values in medians)
        + " |"
    )


if __name__ == "__main__":
    main()
