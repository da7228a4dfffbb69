#!/usr/bin/env python3
"""The paper's Tables 3 and 4 in the rendered world with COLMAP's columns: `tiepoint experiment`,
then COLMAP on the same matches.

  pip install numpy pycolmap==4.2.1
  cargo build --release
  python bench/experiment.py --output tiepoint-experiment [-- --seed 2 --size 640x480 ...]

What stands behind `--` goes to `tiepoint experiment`. COLMAP maps a copy of each database:
keypoints, matches, camera model and first focal length are ours. For Traditional it knows of no
rig. For Constrained (row `paper`) it is run twice, as its documentation has it for an unknown rig:
without, then with the rig that the first run gives (`apply_rig_config`), whose frames are the
images nearest to each other by their stamps; that takes the place of the paper's
rig_bundle_adjuster, which COLMAP no longer has. Each of its rows gets so many minutes. Models are
put into `colmap/sparse/0` of the workspaces, where `tiepoint experiment` finds and judges them like
its own."""

import argparse
import multiprocessing
import shutil
import sqlite3
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pycolmap
from colmap import largest, make_rig, map_database
from program import program_of

THREADS, SEED = 2, 0
MOUNTINGS = ("front", "right", "rear", "left")


def stamps_of(drive):
    lines = (drive / "timestamps.csv").read_text().splitlines()[1:]
    return {name: float(seconds) for name, seconds in (line.split(",") for line in lines)}


def partners(stamps):
    """Right images with the left one nearest in time, each used once."""
    lefts, rights = (
        [name for name in stamps if name.startswith(side)] for side in ("left/", "right/")
    )
    times = np.array([stamps[name] for name in lefts])
    found = {}
    for right in rights:
        nearest = int(np.argmin(np.abs(times - stamps[right])))
        off = abs(times[nearest] - stamps[right])
        if lefts[nearest] not in found or off < found[lefts[nearest]][1]:
            found[lefts[nearest]] = (right, off)
    return {right: left for left, (right, _) in found.items()}


def write(model, folder, names=None):
    """A model where `tiepoint experiment` looks for it; `names` are those that images had
    before."""
    target = folder / "colmap/sparse/0"
    shutil.rmtree(folder / "colmap", ignore_errors=True)
    target.mkdir(parents=True)
    for image in model.images.values():
        image.name = (names or {}).get(image.name, image.name)
    model.write(target)


def ended(minutes, function, *arguments):
    """Calls it in a process of its own, which is killed after so many minutes; whether it came to
    its end."""
    process = multiprocessing.Process(target=function, args=arguments)
    process.start()
    process.join(60 * minutes)
    alive = process.is_alive()
    process.kill()
    process.join()
    return not alive


def copy_database(workspace):
    """COLMAP does not map a fisheye unless it is told that the focal length is known roughly."""
    copy = workspace / "colmap.db"
    shutil.copy(workspace / "database.db", copy)
    connection = sqlite3.connect(copy)
    connection.execute("UPDATE cameras SET prior_focal_length = 1")
    connection.commit()
    connection.close()
    return copy


def map_largest(database, drive, sparse):
    shutil.rmtree(sparse, ignore_errors=True)
    return largest(map_database(database, drive, sparse, None, THREADS, SEED).values())


def traditional(workspace, drive):
    copy = copy_database(workspace)
    model = map_largest(copy, drive, workspace / "colmap.sparse")
    if model:
        write(model, workspace)


def with_frames(database, drive):
    """Renames right images after the left ones nearest in time, since COLMAP joins images of one
    file name to frames. Returns the old names."""
    pairs = partners(stamps_of(drive))
    renamed = {right: f"right/{left.removeprefix('left/')}" for right, left in pairs.items()}
    connection = sqlite3.connect(database)
    names = [
        name for (name,) in connection.execute("SELECT name FROM images WHERE name LIKE 'right/%'")
    ]
    new = {name: renamed.get(name, f"right/alone-{name.removeprefix('right/')}") for name in names}
    connection.executemany(
        "UPDATE images SET name = ? WHERE name = ?", [(f"{to}.new", was) for was, to in new.items()]
    )
    connection.executemany(
        "UPDATE images SET name = ? WHERE name = ?", [(to, f"{to}.new") for to in new.values()]
    )
    connection.commit()
    connection.close()
    return {to: was for was, to in new.items()}


def constrained(workspace, drive):
    copy = copy_database(workspace)
    names = with_frames(copy, drive)
    first = map_largest(copy, drive, workspace / "colmap.sparse")
    if first is None:
        return
    make_rig(copy, first)
    model = map_largest(copy, drive, workspace / "colmap.sparse")
    if model:
        write(model, workspace, names)


def main():
    own = sys.argv[1 : sys.argv.index("--")] if "--" in sys.argv else sys.argv[1:]
    options = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else []
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--output", type=Path, default=Path("tiepoint-experiment"))
    parser.add_argument("--only", choices=["mounting", "baseline"])
    parser.add_argument("--minutes", type=float, default=15.0)
    parser.add_argument("--program", type=Path)
    arguments = parser.parse_args(own)
    program = program_of(arguments)
    pycolmap.logging.minloglevel = pycolmap.logging.Level.ERROR.value
    for which in ("mounting", "baseline"):
        if arguments.only not in (None, which):
            continue
        command = [program, "experiment", which, "-o", arguments.output, *options]
        subprocess.run(list(map(str, command)), check=True, stdout=subprocess.DEVNULL)
        folder = arguments.output / which
        if which == "mounting":
            tasks = [
                (folder / name / "off", folder / name / "drive", traditional) for name in MOUNTINGS
            ]
        else:
            tasks = [
                (folder / "off", folder / "drive", traditional),
                (folder / "paper", folder / "drive", constrained),
            ]
        for workspace, drive, run in tasks:
            if (workspace / "colmap/sparse/0").exists():
                continue
            start = time.perf_counter()
            how = "" if ended(arguments.minutes, run, workspace, drive) else ", not done"
            print(f"{workspace}: COLMAP, {time.perf_counter() - start:.0f} s{how}", file=sys.stderr)
        subprocess.run(list(map(str, command)), check=True)


if __name__ == "__main__":
    main()
