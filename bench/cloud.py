#!/usr/bin/env python3
"""`tiepoint evaluate cloud` beside CloudCompare (and scipy) on the same clouds: mean absolute
distance and its deviation.

  apt install cloudcompare xvfb; pip install numpy scipy
  cargo build --release
  python bench/cloud.py [--points 30000] [--seed 1]
  python bench/cloud.py --cloud WORKSPACE/points.ply --reference scan.ply

Without files of yours it makes a street of two facades with windows and a road: the reference dense
and with the noise of a laser scanner, the cloud sparse, noisier, with a few points far out, and 0.3
m and 1 degree off. Measured twice: as the clouds lie (all three must agree to what single precision
leaves), and after a rigid alignment by closest points with 80 % overlap."""

import argparse
import json
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from program import program_of
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

TOLERANCE_M = (
    1e-4  # of distances where nothing is aligned: coordinates in single precision, up to 100 m
)


def street(count, rng):
    """Random points on a road, and on two facades with windows set back by 0.2 m, 80 m long."""
    along, height = rng.uniform(0, 80, count), rng.uniform(0, 9, count)
    depth = np.where(
        (along % 3 > 1) & (along % 3 < 2.2) & (height % 3 > 1) & (height % 3 < 2.4), 0.2, 0.0
    )
    side = rng.integers(0, 3, count)
    wall = np.stack([along, np.where(side == 0, -8 - depth, 8 + depth), height], 1)
    road = np.stack([along, rng.uniform(-8, 8, count), np.zeros(count)], 1)
    return np.where((side == 2)[:, None], road, wall)


def write_ply(path, points):
    header = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\n"
    header += "".join(f"property float {axis}\n" for axis in "xyz") + "end_header\n"
    path.write_bytes(header.encode() + points.astype("<f4").tobytes())


def tiepoint(program, cloud, reference, align):
    done = subprocess.run(
        [program, "evaluate", "cloud", cloud, reference, "--align", align, "--json"],
        capture_output=True,
        text=True,
    )
    if done.returncode != 0:
        sys.exit(done.stderr)
    distance = json.loads(done.stdout)["distance"]
    return distance["mean"], distance["std"]


def cloudcompare(cloud, reference, align, folder):
    """Its command line prints "Mean distance = ... / std deviation = ..."."""
    for file in (cloud, reference):  # it writes beside what it reads
        shutil.copy(file, folder / file.name)
    command = [
        "CloudCompare",
        "-SILENT",
        "-AUTO_SAVE",
        "OFF",
        "-O",
        folder / cloud.name,
        "-O",
        folder / reference.name,
    ]
    command += (
        ["-ICP", "-OVERLAP", "80", "-ITER", "200", "-RANDOM_SAMPLING_LIMIT", "1000000"]
        if align == "rigid"
        else []
    )
    command += ["-C2C_DIST"]
    if shutil.which("xvfb-run"):
        command = ["xvfb-run", "-a", *command]
    done = subprocess.run(list(map(str, command)), capture_output=True, text=True, timeout=300)
    found = re.findall(
        r"[Mm]ean distance = ([\d.eE+-]+) / std deviation = ([\d.eE+-]+)", done.stdout
    )
    if not found:
        sys.exit("CloudCompare printed no distance:\n" + done.stdout[-2000:] + done.stderr[-2000:])
    return tuple(map(float, found[-1]))


def scipy(cloud, reference, align):
    """The same by the simplest means."""
    tree, kept = cKDTree(reference), int(np.ceil(0.8 * len(cloud)))
    for _ in range(200 if align == "rigid" else 0):
        distance, nearest = tree.query(cloud)
        best = np.argsort(distance, kind="stable")[:kept]
        source, target = cloud[best], reference[nearest[best]]
        mean_s, mean_t = source.mean(0), target.mean(0)
        u, _, vt = np.linalg.svd((target - mean_t).T @ (source - mean_s))
        rotation = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
        cloud = (cloud - mean_s) @ rotation.T + mean_t
    distance, _ = tree.query(cloud)
    return distance.mean(), distance.std()


def read_ply(path):
    """Of the binary files that tiepoint writes: coordinates in single precision, then bytes."""
    head, body = path.read_bytes().split(b"end_header\n", 1)
    count = int(re.search(rb"element vertex (\d+)", head)[1])
    width = 12 + head.count(b"property uchar")
    return (
        np.frombuffer(body, np.uint8, count * width)
        .reshape(count, width)[:, :12]
        .copy()
        .view("<f4")
        .astype(float)
    )


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--points", type=int, default=30_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--cloud", type=Path)
    parser.add_argument("--reference", type=Path)
    parser.add_argument("--program", type=Path)
    arguments = parser.parse_args()
    program = program_of(arguments)
    rng, failed = np.random.default_rng(arguments.seed), False
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        cloud_file, reference_file = (
            arguments.cloud or folder / "cloud.ply",
            arguments.reference or folder / "reference.ply",
        )
        if not arguments.cloud:
            cloud = street(arguments.points, rng) + rng.normal(0, 0.05, (arguments.points, 3))
            cloud[: arguments.points // 50] += rng.normal(0, 5, (arguments.points // 50, 3))
            cloud = cloud @ Rotation.from_rotvec([0, 0, np.radians(1)]).as_matrix().T + [
                0.2,
                -0.2,
                0.1,
            ]
            write_ply(cloud_file, cloud)
            write_ply(
                reference_file,
                street(20 * arguments.points, rng)
                + rng.normal(0, 0.015, (20 * arguments.points, 3)),
            )
        cloud, reference = read_ply(cloud_file), read_ply(reference_file)
        print(
            f"{len(cloud)} points against {len(reference)}: mean and standard deviation of the"
            " distances\n"
        )
        print("| alignment | tiepoint | CloudCompare | scipy |\n|---|---|---|---|")
        for align in ("none", "rigid"):
            ours, simple = tiepoint(program, cloud_file, reference_file, align), scipy(
                cloud, reference, align
            )
            theirs = None
            if shutil.which("CloudCompare"):
                (folder / align).mkdir()
                theirs = cloudcompare(cloud_file, reference_file, align, folder / align)
            show = lambda pair: f"{pair[0]:.5f} ± {pair[1]:.5f}" if pair else "not installed"
            print(f"| {align} | {show(ours)} | {show(theirs)} | {show(simple)} |", flush=True)
            if align == "none":
                failed = any(
                    abs(a - b) > TOLERANCE_M
                    for other in (theirs, simple)
                    if other
                    for a, b in zip(ours, other)
                )
    if failed:
        sys.exit("FAILED: they disagree where nothing is aligned")


if __name__ == "__main__":
    main()
