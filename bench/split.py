#!/usr/bin/env python3
"""Drives whose ends split, and healthy ones: `--rig off`, `paper`, `soft` and `auto` on the same
matches, over several seeds.

  pip install numpy pycolmap==4.2.1
  cargo build --release
  python bench/split.py --seeds 1,2,3,4,5

A healthy drive is a rendered loop around a block with a bit of street twice, as it comes. A split
one is the same drive, after its first images of the right camera have lost their matches to the
start and kept those to the end, where the vehicle is again, and all others have lost theirs between
start and end: those images then stand at the end of the drift while their partners stand at its
beginning, as in section 4.3 of Huang, Elhashash & Qin 2022. Matches are taken out of the database;
features, pairs and everything else stay. ATE is that of drift.py; the gap is the error of the
relative position of the split pairs, the median over them; the cloud is the mean (and median)
distance of the points to a laser scan, all in metres. `adjusted` is the model of `soft` after an
adjustment of its own without any rig term: whether a split that was closed stays closed. Recovery
is (e_off - e_soft) / (e_off - e_healthy), in ATE, where e_healthy is `soft` on the healthy drive.
Prints tables in Markdown; raw numbers go to bench/results/split-*.json."""

import argparse
import datetime
import json
import shutil
import sqlite3
import statistics
import sys
import tempfile
from pathlib import Path

import numpy as np
import pycolmap
from drift import MODELS, align, run, truth_of
from program import ROOT, program_of

# Images of the right camera that are split off, and how far apart in time (in seconds) images of
# the start and the end lie at least.
NUM_SPLIT = 8
MIN_APART_S = 20.0
# COLMAP's: pair_id = id1 * MAX_IMAGES + id2, id1 < id2.
MAX_IMAGES = 2147483647


def split(database, stamps, first):
    """Takes matches of the images `first` out of a database; returns how many pairs hold them at
    the end."""
    connection = sqlite3.connect(database)
    names = dict(connection.execute("SELECT image_id, name FROM images"))
    kept, dropped = 0, []
    for (pair,) in connection.execute("SELECT pair_id FROM two_view_geometries WHERE rows > 0"):
        a, b = names[pair // MAX_IMAGES], names[pair % MAX_IMAGES]
        spans = abs(stamps[a] - stamps[b]) > MIN_APART_S
        if (a in first) == (b in first):
            drop = spans
        else:
            drop = not spans
        dropped += [(pair,)] if drop else []
        kept += (a in first) != (b in first) and spans
    for table in ("two_view_geometries", "matches"):
        connection.executemany(f"DELETE FROM {table} WHERE pair_id = ?", dropped)
    connection.commit()
    connection.close()
    return kept


def measure(model, centres, first):
    """ATE and the gap, in metres of the truth."""
    names, found, truth = align(model, centres)
    aligned = dict(zip(names, found))
    errors = np.linalg.norm(found - truth, axis=1)
    gaps = []
    for name in first:
        left = name.replace("right/", "left/")
        if name in aligned and left in aligned:
            gaps.append(
                np.linalg.norm((aligned[name] - aligned[left]) - (centres[name] - centres[left]))
            )
    return {
        "registered": len(names),
        "images": len(centres),
        "ate_m": float(np.sqrt((errors**2).mean())),
        "gap_m": float(np.median(gaps)) if gaps else None,
    }


def run_drive(seed, arguments, work):
    drive, log, program = work / "drive", work / "log", arguments.program
    rendered = run(
        [
            program,
            "synth",
            "-o",
            drive,
            "--scan",
            "--effects",
            arguments.effects,
            "--route",
            "loop",
            "--length",
            arguments.length,
            "--rate",
            arguments.rate,
            "--size",
            arguments.size,
            "--seed",
            seed,
            "--json",
        ],
        log,
    )
    centres, stamps = truth_of(drive)
    made = work / "made"
    model = ["--camera-model", MODELS.get(arguments.effects, "SIMPLE_RADIAL")]
    prior = ["--focal-prior", json.loads(rendered)["cameras"][0]["focal_px"]]
    base = [
        program,
        "reconstruct",
        drive,
        "--timestamps",
        drive / "timestamps.csv",
        "--pairs",
        arguments.pairs,
        *model,
        *prior,
    ]
    first = sorted(name for name in stamps if name.startswith("right/"))[:NUM_SPLIT]
    rows = {}
    run([*base, "-o", made, "--rig", "off", "--json"], log)
    for kind in ("healthy", "split"):
        if kind == "split":
            kept = split(made / "database.db", stamps, first)
            print(f"seed {seed}: {kept} pairs hold the split images at the end", file=sys.stderr)
        for rig in arguments.rigs:
            workspace = work / f"{kind}-{rig}"
            shutil.copytree(made, workspace)
            seconds = json.loads(
                run([*base, "-o", workspace, "--rig", rig, "--redo", "map", "--json"], log)
            )["stages"]["map"]["seconds"]
            row = measure(pycolmap.Reconstruction(workspace / "sparse/0"), centres, first)
            cloud = json.loads(
                run(
                    [
                        program,
                        "evaluate",
                        "cloud",
                        workspace,
                        drive / "truth/scan.ply",
                        "--truth",
                        f"colmap:{drive / 'truth/model'}",
                        "--json",
                    ],
                    log,
                )
            )["distance"]
            row |= {"cloud_m": cloud["mean"], "cloud_median_m": cloud["median"], "seconds": seconds}
            rows.setdefault(kind, {})[rig] = row
            if rig == "soft":
                run(
                    [
                        program,
                        "adjust",
                        workspace / "sparse/0",
                        "-o",
                        workspace / "adjusted",
                        "--json",
                    ],
                    log,
                )
                rows[kind]["adjusted"] = measure(
                    pycolmap.Reconstruction(workspace / "adjusted"), centres, first
                )
            shutil.rmtree(workspace)
    return rows


def main():
    words = lambda text: text.split(",")
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=words, default=["1", "2", "3", "4", "5"])
    parser.add_argument("--rigs", type=words, default=["off", "paper", "soft", "auto"])
    parser.add_argument("--effects", default="all")
    parser.add_argument("--length", type=float, default=200.0)
    parser.add_argument("--rate", type=float, default=4.0)
    parser.add_argument("--size", default="640x480")
    parser.add_argument("--pairs", default="sequential:6+ends")
    parser.add_argument("--program", type=Path)
    parser.add_argument("--work", type=Path, help="where to put workspaces (default: the system's)")
    arguments = parser.parse_args()
    arguments.program = program_of(arguments)
    pycolmap.logging.minloglevel = pycolmap.logging.Level.ERROR.value
    results = []
    columns = [*arguments.rigs, *(["adjusted"] if "soft" in arguments.rigs else [])]
    header = " | ".join(f"`{rig}`" for rig in arguments.rigs) + (
        " | `soft`, then adjusted without" if "soft" in arguments.rigs else ""
    )
    print(f"| seed | drive | {header} |")
    print("|---" * (len(columns) + 2) + "|")
    number = lambda value: "-" if value is None else f"{value:.3f}"
    for seed in arguments.seeds:
        with tempfile.TemporaryDirectory(dir=arguments.work) as folder:
            rows = run_drive(int(seed), arguments, Path(folder))
        results.append({"seed": int(seed), **rows})
        for kind, row in rows.items():
            cell = lambda r: f"{r['ate_m']:.3f} / {number(r['gap_m'])}"
            missing = lambda r: (
                f" ({r['images'] - r['registered']} missing)"
                if r["registered"] < r["images"]
                else ""
            )
            print(
                f"| {seed} | {kind} | "
                + " | ".join(cell(row[rig]) + missing(row[rig]) for rig in columns)
                + " |",
                flush=True,
            )
    of = lambda kind, rig, what: [
        r[kind][rig][what] for r in results if r[kind][rig].get(what) is not None
    ]
    median = lambda values: number(statistics.median(values) if values else None)
    for kind in ("healthy", "split"):
        cells = [
            f"{median(of(kind, rig, 'ate_m'))} / {median(of(kind, rig, 'gap_m'))}"
            for rig in columns
        ]
        print(f"| median | {kind} | " + " | ".join(cells) + " |")
    print(
        "\n| cloud, mean / median over the points | "
        + " | ".join(f"`{rig}`" for rig in arguments.rigs)
        + " |"
    )
    print("|---" * (len(arguments.rigs) + 1) + "|")
    for kind in ("healthy", "split"):
        for result in results:
            cells = [
                f"{number(result[kind][rig]['cloud_m'])} /"
                f" {number(result[kind][rig]['cloud_median_m'])}"
                for rig in arguments.rigs
            ]
            print(f"| seed {result['seed']}, {kind} | " + " | ".join(cells) + " |")
    if {"off", "soft"} <= set(arguments.rigs):
        ate = lambda r, kind, rig: r[kind][rig]["ate_m"]
        recovery = lambda r: (ate(r, "split", "off") - ate(r, "split", "soft")) / (
            ate(r, "split", "off") - ate(r, "healthy", "soft")
        )
        print("\nrecovery: " + ", ".join(f"{100 * recovery(r):.0f} %" for r in results))
    folder = ROOT / "bench/results"
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"split-{datetime.datetime.now().strftime('%Y%m%d-%H%M%S')}.json"
    settings = {key: str(value) for key, value in vars(arguments).items()}
    path.write_text(json.dumps({"settings": settings, "drives": results}, indent=1))
    print(f"\n{path.relative_to(ROOT)}")


if __name__ == "__main__":
    main()
