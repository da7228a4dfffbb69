#!/usr/bin/env python3
"""Rendered collections of photos in no order (`tiepoint synth --collection`): how many photos the
models have and how accurate the poses are, beside COLMAP.

  pip install numpy pycolmap==4.2.1
  cargo build --release
  python bench/photo_collections.py SCRATCH [--kinds table,room] [--seeds 1,2] [--before PROGRAM]

`tiepoint reconstruct` with its defaults; COLMAP's incremental and global mapper with its own
features and exhaustive matches (camera mode auto), and with our database. What is in SCRATCH is not
computed again. A line in Markdown for each: the photos of the models, largest first; the area under
the recall curve of the pose error up to 1, 5 and 10 degrees over all pairs of photos (the larger of
the angles between the relative rotations and between the directions of the relative translations;
a pair that is not in the largest model fails); the share of the pairs of the largest model whose
error is above 10 degrees, which is large where parts are in wrong places."""

import argparse
import itertools
import subprocess
from pathlib import Path

import numpy as np
import pycolmap
from colmap import map_database, map_globally, read_models
from program import program_of

KINDS = {"table": 80, "room": 80, "drone": 80, "facade": 80, "twins": 96, "twins-apart": 96}
LIMITS_DEG = (1, 5, 10)
SEED = 0


def poses(model):
    return {image.name: image.cam_from_world() for image in model.images.values() if image.has_pose}


def angle_deg(cosine):
    return np.degrees(np.arccos(np.clip(cosine, -1, 1)))


def pair_errors(found, truth):
    """The error of each pair of photos of the truth, in degrees; infinite if one has no pose."""
    errors = []
    for pair in itertools.combinations(sorted(truth), 2):
        if not all(name in found for name in pair):
            errors.append(np.inf)
            continue
        ours, true = (of[pair[1]] * of[pair[0]].inverse() for of in (found, truth))
        turned = (ours.rotation.inverse() * true.rotation).angle()
        lengths = np.linalg.norm(ours.translation) * np.linalg.norm(true.translation)
        moved = angle_deg(ours.translation @ true.translation / max(lengths, 1e-12))
        errors.append(max(np.degrees(turned), moved))
    return np.array(errors)


def area(errors, limit):
    """The area under the recall curve up to a limit, as a share."""
    seen = np.sort(errors[errors <= limit])
    edges = np.concatenate([[0], seen, [limit]])
    recall = np.arange(len(seen) + 1) / len(errors)
    return np.sum(np.diff(edges) * recall) / limit


def describe(folder, truth):
    models = read_models(folder) if folder.is_dir() else []
    found = sorted((poses(model) for model in models), key=len, reverse=True)
    errors = pair_errors(found[0] if found else {}, truth)
    registered = errors[np.isfinite(errors)]
    wrong = np.mean(registered > LIMITS_DEG[-1]) if len(registered) else 0
    areas = " / ".join(f"{100 * area(errors, limit):.1f}" for limit in LIMITS_DEG)
    return f"{', '.join(str(len(model)) for model in found) or '-'} | {areas} | {100 * wrong:.1f} %"


def colmap_database(photos, path):
    if not path.exists():
        pycolmap.set_random_seed(SEED)
        cpu = pycolmap.Device.cpu
        pycolmap.extract_features(path, photos, camera_mode=pycolmap.CameraMode.AUTO, device=cpu)
        pycolmap.match_exhaustive(path, device=cpu)
    return path


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scratch", type=Path)
    parser.add_argument("--kinds", default=",".join(KINDS))
    parser.add_argument("--seeds", default="1")
    parser.add_argument("--photos", type=int, help="number of photos of each collection")
    parser.add_argument("--program", type=Path)
    parser.add_argument("--before", type=Path, help="another build, which maps our database, too")
    parser.add_argument("--no-colmap", action="store_true")
    options = parser.parse_args()
    program = program_of(options)
    pycolmap.logging.minloglevel = 2
    print("| collection, seed | photos | mapper | in models | AUC 1° / 5° / 10° | wrong pairs |")
    print("|---|--:|---|---|---|--:|")
    for kind, seed in itertools.product(options.kinds.split(","), options.seeds.split(",")):
        count = options.photos or KINDS[kind]
        work = options.scratch / f"{kind}-{seed}-{count}"
        photos, ours = work / "photos", work / "tiepoint/database.db"
        synth = ["synth", "--collection", kind, "--photos", count, "--seed", seed, "-o", work]

        def run(which, *words):
            subprocess.run([which, *map(str, words)], check=True, capture_output=True)

        run(program, *synth)
        truth = poses(pycolmap.Reconstruction(work / "truth/model"))

        def ours_by(which, to):
            if not (to / "sparse").exists():
                run(which, "reconstruct", photos, "-o", to)
            return to / "sparse"

        def theirs_by(mapper, database, to):
            if not to.exists():
                mapper(database(), photos, to, None, -1, SEED)
            return to

        mappers = {"tiepoint": lambda: ours_by(program, work / "tiepoint")}
        if options.before:
            mappers["before"] = lambda: ours_by(options.before, work / "before")
        if not options.no_colmap:
            for name, mapper in (("incremental", map_database), ("global", map_globally)):
                for label, database in (
                    ("", lambda: colmap_database(photos, work / "colmap.db")),
                    (", our matches", lambda: ours),
                ):
                    to = work / f"{name}{'-ours' if label else ''}"
                    mappers[f"COLMAP {name}{label}"] = lambda m=mapper, d=database, t=to: theirs_by(
                        m, d, t
                    )
        for label, mapper in mappers.items():
            row = describe(mapper(), truth)
            print(f"| {kind}, {seed} | {len(truth)} | {label} | {row} |", flush=True)


if __name__ == "__main__":
    main()
