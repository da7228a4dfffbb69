#!/usr/bin/env python3
"""A known rig on KITTI, where matches of some frames are deleted.

    pip install numpy pycolmap==4.2.1
    cargo build --release
    TIEPOINT_DATA=... python bench/known_rig.py [--drives kitti04] [--seeds 3] [--program FILE]

Each camera has its own calibration (`--calibration left=calib.txt#P0`, `right=calib.txt#P1`). The
rig is COLMAP's rig_config.json with the baseline of calib.txt. Six frames in the middle of each
clip of 51 lose verified matches in the database:

    all     nothing is deleted
    right   all matches of the right images
    both    all but those of 24 keypoints of each image, fewer than a registration needs (30)

The error is that of the camera centres of both cameras against the truth after a similarity
(Umeyama 1991): the root mean square over all registered images, and the largest of the poor
frames' images. `scale` is the length of the truth over that of the model: with the known rig both
are in metres. pycolmap reads the models."""

import argparse
import json
import os
import shutil
import sqlite3
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pycolmap
from colmap import umeyama
from program import program_of

POOR, KEPT = range(22, 28), 24
MODES = ["off", "auto", "known"]
CASES = ["all", "right", "both"]
MAX_IMAGES = 2147483647


def run(program, *words):
    command = [str(word) for word in (program, *words)]
    done = subprocess.run([*command, "--json"], capture_output=True, text=True)
    if done.returncode != 0:
        sys.exit(f"{' '.join(command)}: {done.stderr.strip().splitlines()[-1]}")


def calibration(folder):
    """The projection matrices P0 and P1; their names are left out in some files."""
    lines = (folder / "calib.txt").read_text().splitlines()[:2]
    return [[float(word) for word in line.split()[-12:]] for line in lines]


def write_inputs(folder, scratch):
    matrices = calibration(folder)
    text = "".join(f"P{n}: {' '.join(map(repr, m))}\n" for n, m in enumerate(matrices))
    (scratch / "calib.txt").write_text(text)
    right_from_left = matrices[1][3] / matrices[1][0]
    cameras = [
        {"image_prefix": "left/", "ref_sensor": True},
        {
            "image_prefix": "right/",
            "cam_from_rig_rotation": [1, 0, 0, 0],
            "cam_from_rig_translation": [right_from_left, 0, 0],
        },
    ]
    (scratch / "rig_config.json").write_text(json.dumps([{"cameras": cameras}]))
    return right_from_left


def delete_matches(database, case):
    """Deletes verified matches of the poor frames."""
    connection = sqlite3.connect(database)
    names = dict(connection.execute("SELECT image_id, name FROM images"))
    numbers = {image: int(Path(name).stem) for image, name in names.items()}
    first = min(numbers.values())
    limits = {}
    for image, name in names.items():
        if numbers[image] - first in POOR and (case == "both" or name.startswith("right/")):
            limits[image] = KEPT if case == "both" else 0
    kept = {image: set() for image in limits}

    def is_kept(image, keypoint):
        if image not in limits or keypoint in kept[image]:
            return True
        if len(kept[image]) < limits[image]:
            kept[image].add(keypoint)
            return True
        return False

    geometries = connection.execute("SELECT pair_id, rows, data FROM two_view_geometries")
    for pair, rows, data in geometries.fetchall():
        images = divmod(pair, MAX_IMAGES)
        if not rows or not any(image in limits for image in images):
            continue
        matches = np.frombuffer(data, np.uint32).reshape(rows, 2)
        mask = [all(is_kept(i, int(k)) for i, k in zip(images, match)) for match in matches]
        matches = matches[mask]
        connection.execute(
            "UPDATE two_view_geometries SET rows = ?, data = ? WHERE pair_id = ?",
            (len(matches), matches.tobytes(), pair),
        )
    connection.commit()
    connection.close()


def measure(model, folder, right_from_left):
    poses = np.loadtxt(folder / "poses.txt").reshape(-1, 3, 4)
    images = [image for image in model.images.values() if image.has_pose]
    numbers = [int(Path(image.name).stem) for image in images]
    sides = [image.name.startswith("right/") for image in images]
    # The centre of the right camera in the left camera is minus the translation.
    truth = np.array(
        [poses[n] @ [-right_from_left if side else 0, 0, 0, 1] for n, side in zip(numbers, sides)]
    )
    found = np.array([image.projection_center() for image in images])
    scale, rotation, translation = umeyama(found, truth)
    errors = np.linalg.norm(scale * found @ rotation.T + translation - truth, axis=1)
    poor = errors[[n in POOR for n in numbers]]
    return {
        "registered": len(images),
        "poor_registered": len(poor),
        "ate_cm": 100 * float(np.sqrt((errors**2).mean())),
        "poor_max_cm": 100 * float(poor.max()) if len(poor) else None,
        "scale": float(scale),
        "rigs": model.num_rigs(),
        "frames": model.num_reg_frames(),
    }


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--drives", nargs="+", default=["kitti04", "kitti01"])
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--program", type=Path)
    parser.add_argument("--results", type=Path)
    arguments = parser.parse_args()
    program = program_of(arguments)
    runs = []
    for drive in arguments.drives:
        folder = Path(os.environ["TIEPOINT_DATA"]) / drive
        with tempfile.TemporaryDirectory() as scratch:
            scratch = Path(scratch)
            right_from_left = write_inputs(folder, scratch)
            whole = scratch / "ws"
            sides = enumerate(("left", "right"))
            lenses = [f"{side}={scratch}/calib.txt#P{n}" for n, side in sides]
            calibrations = [word for lens in lenses for word in ("--calibration", lens)]
            run(program, "features", folder / "images", "-o", whole, *calibrations)
            run(program, "match", whole, "--pairs", "sequential:10")
            for case in CASES:
                workspace = scratch / case
                shutil.copytree(whole, workspace)
                if case != "all":
                    delete_matches(workspace / "database.db", case)
                for mode in MODES:
                    for seed in range(arguments.seeds):
                        rig = ["--rig", mode]
                        if mode == "known":
                            rig = ["--rig-calibration", scratch / "rig_config.json"]
                        run(program, "map", workspace, *rig, "--seed", seed, "--redo", "map")
                        model = pycolmap.Reconstruction(str(workspace / "sparse/0"))
                        found = measure(model, folder, right_from_left)
                        found |= {"drive": drive, "case": case, "mode": mode, "seed": seed}
                        runs.append(found)
                        print(found, flush=True)
    if arguments.results:
        arguments.results.write_text(json.dumps({"runs": runs}))


if __name__ == "__main__":
    main()
