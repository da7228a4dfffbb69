#!/usr/bin/env python3
"""Sets with truth made thin: every n-th photo at a reduced size, and sets cut apart. How many
photos the models have and how accurate they are, beside COLMAP on the same matches.

  pip install numpy pycolmap==4.2.1
  cargo build --release
  TIEPOINT_DATA=... python bench/thin.py sets [--before PROGRAM]
  TIEPOINT_DATA=... python bench/thin.py cuts --draws 12 [--before PROGRAM]
  python bench/thin.py collections --draws 10 [--before PROGRAM]

`sets`: fountain-P11, Herz-Jesus-P8, temple_ring and the left cameras of kitti04 and kitti01. `cuts`
maps temple_ring from the matches within two arcs that have 1, 2 or 5 photos in common, drawn at
random; all other matches are taken out of the database. A line for each model, largest first: its
photos and the mean (cuts: largest) distance of the centres from the truth after a similarity, in
thousandths of the rms extent of the true centres. `--before` maps with another build, too.

`collections` does the same with rendered collections (a room, streets from a drone), which a drawn
direction divides. A draw is *joined* if a model has photos of both parts beside the common ones, or
*wrong* if in it more than a tenth of the pairs of such photos have an error above 10 degrees; else
it is *apart*, or *silent* without a warning that there are several models. The last columns are the
largest share of pairs with such an error over all models of all draws, and the photos of the models
of each draw."""

import argparse
import json
import os
import random
import shutil
import sqlite3
import subprocess
import tempfile
from pathlib import Path

import numpy as np
import pycolmap
from colmap import read_models, strecha_centres, umeyama
from photo_collections import LIMITS_DEG, pair_errors, poses
from program import program_of

STRIDES, WIDTHS = (1, 2, 3, 4, 6), (1024, 400, 240)
COMMON, SEED = (1, 2, 5), 45
COLLECTIONS, PHOTOS, COLLECTION_SEED = ("room", "drone"), 60, 12
# Share of wrong pairs across the parts of a wrong join: one that has the place, the size or the
# direction of a part wrong has most of them.
MAX_WRONG = 0.1
# COLMAP's: pair_id = id1 * MAX_IMAGES + id2, id1 < id2.
MAX_IMAGES = 2147483647


def temple_centres(path):
    """Camera centres of the Middlebury format: name, K (9), R (9), t (3) a line."""
    centres = {}
    for line in path.read_text().splitlines()[1:]:
        name, *numbers = line.split()
        pose = np.array(numbers[9:], float)
        centres[name] = -pose[:9].reshape(3, 3).T @ pose[9:]
    return centres


def load(data):
    """Name, folder of photos and true centres of each set, by the stems of the photos' names."""
    for name in ("fountain-P11", "Herz-Jesus-P8"):
        centres = strecha_centres(data / name / "cameras")
        yield name, data / name / "images", centres
    folder = data / "temple_ring"
    yield "temple_ring", folder, temple_centres(folder / "templeR_par.txt")
    for name in ("kitti04", "kitti01"):
        poses = np.loadtxt(data / name / "poses.txt").reshape(-1, 3, 4)
        centres = {f"{i:06d}.png": pose[:, 3] for i, pose in enumerate(poses)}
        yield name, data / name / "images/left", centres


def describe(folder, truth, measure):
    """The models of a folder, largest first."""
    found = []
    for path in folder.iterdir() if folder.is_dir() else []:
        images = pycolmap.Reconstruction(path).images.values()
        centres = {Path(i.name).stem: i.projection_center() for i in images if i.has_pose}
        names = sorted(centres.keys() & truth.keys())
        text = f"{len(centres)}"
        if len(names) >= 3:
            source, target = (np.array([of[name] for name in names]) for of in (centres, truth))
            scale, rotation, translation = umeyama(source, target)
            moved = scale * source @ rotation.T + translation
            error = measure(np.linalg.norm(moved - target, axis=1))
            extent = np.sqrt(np.sum((target - target.mean(0)) ** 2, axis=1).mean())
            text += f": {1000 * error / extent:.2f}"
        found.append((len(centres), text))
    return ", ".join(text for _, text in sorted(found, reverse=True)) or "-"


def run(program, *words):
    subprocess.run([program, *map(str, words)], check=False, capture_output=True)


def remap(program, workspace, to, truth, measure):
    shutil.copytree(workspace, to)
    run(program, "map", to, "--redo", "map")
    return describe(to / "sparse", truth, measure)


def colmap(workspace, photos, to, truth):
    """COLMAP's incremental mapper on our matches."""
    to.mkdir()
    shutil.copy(workspace / "database.db", to)
    options = pycolmap.IncrementalPipelineOptions()
    options.random_seed = 0
    pycolmap.incremental_mapping(to / "database.db", photos, to / "sparse", options)
    return describe(to / "sparse", truth, np.mean)


def sets(data, programs, scratch):
    print("| set, every n-th, width | photos | COLMAP | " + " | ".join(programs) + " |")
    print("|---|--:|---|" + "---|" * len(programs))
    for name, folder, truth in load(data):
        truth = {Path(key).stem: centre for key, centre in truth.items()}
        photos = sorted(p for p in folder.iterdir() if p.suffix.lower() in (".jpg", ".png"))
        for stride, width in ((s, w) for s in STRIDES for w in WIDTHS):
            work = scratch / f"{name}-{stride}-{width}"
            (work / "images").mkdir(parents=True)
            for path in photos[::stride]:
                bitmap = pycolmap.Bitmap.read(path, True)
                to = min(width, bitmap.width)
                bitmap.rescale(to, round(bitmap.height * to / bitmap.width))
                bitmap.write(work / "images" / f"{path.stem}.png")
            count = len(photos[::stride])
            if count < 4:
                continue
            run(programs["now"], "features", work / "images", "-o", work / "workspace")
            run(programs["now"], "match", work / "workspace")
            row = [colmap(work / "workspace", work / "images", work / "colmap", truth)]
            for label, program in programs.items():
                row.append(remap(program, work / "workspace", work / label, truth, np.mean))
            print(f"| {name}, {stride}, {width} | {count} | " + " | ".join(row) + " |", flush=True)


def cut(database, arcs):
    """Takes the pairs that are in no arc out of a database."""
    connection = sqlite3.connect(database)
    names = dict(connection.execute("SELECT image_id, name FROM images"))
    dropped = []
    for (pair,) in connection.execute("SELECT pair_id FROM two_view_geometries"):
        images = {names[pair // MAX_IMAGES], names[pair % MAX_IMAGES]}
        if not any(images <= arc for arc in arcs):
            dropped.append((pair,))
    for table in ("two_view_geometries", "matches"):
        connection.executemany(f"DELETE FROM {table} WHERE pair_id = ?", dropped)
    connection.commit()
    connection.close()


def cuts(data, programs, scratch, draws):
    folder = data / "temple_ring"
    truth = temple_centres(folder / "templeR_par.txt")
    truth = {Path(key).stem: centre for key, centre in truth.items()}
    names = sorted(path.name for path in folder.glob("*.png"))
    run(programs["now"], "features", folder, "-o", scratch / "whole")
    run(programs["now"], "match", scratch / "whole")
    rng = random.Random(SEED)
    print("| common | arcs | " + " | ".join(programs) + " |\n|--:|--:|" + "---|" * len(programs))
    for common, draw in ((common, draw) for common in COMMON for draw in range(draws)):
        start, quarter = rng.randrange(len(names)), len(names) // 4
        ring = names[start:] + names[:start]
        middle = rng.randrange(quarter, len(names) - quarter - common)
        arcs = [set(ring[: middle + common]), set(ring[middle:])]
        work = scratch / f"{common}-{draw}"
        shutil.copytree(scratch / "whole", work)
        cut(work / "database.db", arcs)
        row = [
            remap(program, work, scratch / f"{common}-{draw}-{label}", truth, np.max)
            for label, program in programs.items()
        ]
        sizes = "+".join(str(len(arc)) for arc in arcs)
        print(f"| {common} | {sizes} | " + " | ".join(row) + " |", flush=True)


def verdict(workspace, truth, parts):
    """What became of two parts, the share of wrong pairs, and the photos of the models."""
    sparse = workspace / "sparse"
    found = [poses(model) for model in read_models(sparse)] if sparse.is_dir() else []
    sizes = ", ".join(str(size) for size in sorted(map(len, found), reverse=True)) or "-"
    what, most = None, 0.0

    def wrong(model, names, count):
        """The share of wrong pairs of some photos, of which there are `count`."""
        of_names = {name: truth[name] for name in names}
        return np.sum(pair_errors(model, of_names) > LIMITS_DEG[-1]) / max(count, 1)

    for model in found:
        one, other = (model.keys() & (part - of) for part, of in (parts, parts[::-1]))
        most = max(most, wrong(model, model, len(model) * (len(model) - 1) / 2))
        if one and other:
            count = len(one) * len(other)
            within = sum(wrong(model, part, 1) for part in (one, other))
            is_wrong = (wrong(model, one | other, 1) - within) / count > MAX_WRONG
            what = "wrong" if is_wrong or what == "wrong" else "joined"
    warnings = json.loads((workspace / "report.json").read_text()).get("warnings", [])
    said = any(warning["kind"] == "several_models" for warning in warnings)
    return what or ("apart" if said else "silent"), most, sizes


def collections(programs, scratch, draws):
    verdicts = ("joined", "apart", "silent", "wrong")
    print(f"| set | common | program | {' | '.join(verdicts)} | wrong pairs | models |")
    print("|---|--:|---|" + "--:|" * len(verdicts) + "--:|---|")
    for kind in COLLECTIONS:
        whole = scratch / kind
        words = ["--collection", kind, "--photos", PHOTOS, "--seed", COLLECTION_SEED]
        run(programs["now"], "synth", *words, "-o", whole)
        run(programs["now"], "features", whole / "photos", "-o", whole / "workspace")
        run(programs["now"], "match", whole / "workspace")
        truth = poses(pycolmap.Reconstruction(whole / "truth/model"))
        centres = {name: pose.inverse().translation for name, pose in truth.items()}
        rng = random.Random(SEED)
        for common in COMMON:
            found = {label: [] for label in programs}
            for draw in range(draws):
                angle = rng.uniform(0, 2 * np.pi)
                along = np.array([np.cos(angle), np.sin(angle), 0])
                names = sorted(centres, key=lambda name: centres[name] @ along)
                quarter = len(names) // 4
                middle = rng.randrange(quarter, len(names) - quarter - common)
                parts = [set(names[: middle + common]), set(names[middle:])]
                work = scratch / f"{kind}-{common}-{draw}"
                shutil.copytree(whole / "workspace", work)
                cut(work / "database.db", parts)
                for label, program in programs.items():
                    to = scratch / f"{kind}-{common}-{draw}-{label}"
                    shutil.copytree(work, to)
                    run(program, "map", to, "--redo", "map")
                    found[label].append(verdict(to, truth, parts))
                    shutil.rmtree(to)
                shutil.rmtree(work)
            for label, of in found.items():
                row = " | ".join(str(sum(it[0] == what for it in of)) for what in verdicts)
                most, photos = max(it[1] for it in of), "; ".join(it[2] for it in of)
                text = f"{row} | {100 * most:.1f} % | {photos}"
                print(f"| {kind} | {common} | {label} | {text} |", flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", choices=["sets", "cuts", "collections"])
    parser.add_argument("--draws", type=int, default=12)
    parser.add_argument("--program", type=Path)
    parser.add_argument("--before", type=Path)
    options = parser.parse_args()
    programs = {"before": options.before} if options.before else {}
    programs["now"] = program_of(options)
    with tempfile.TemporaryDirectory() as scratch:
        if options.what == "collections":
            collections(programs, Path(scratch), options.draws)
            return
        data = Path(os.environ["TIEPOINT_DATA"])
        if options.what == "sets":
            sets(data, programs, Path(scratch))
        else:
            cuts(data, programs, Path(scratch), options.draws)


if __name__ == "__main__":
    main()
