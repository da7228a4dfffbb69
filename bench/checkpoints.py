#!/usr/bin/env python3
"""Kills the mapper at drawn moments and goes on, until the models are there.

    bench/checkpoints.py [--program target/release/tiepoint] [--kills 40] [--seed 0] [--frames 60]

A rendered drive of two cameras is mapped once without a kill. Then runs of `map` get SIGKILL after
a drawn time of up to 0.6 of that; the next run goes on, until one ends before its kill. Each
chain must end with the same models, points and rig, byte for byte. Chains are begun until there
were as many kills as wanted. Printed: kills, runs that went on from a checkpoint, faults."""

import argparse
import pathlib
import random
import re
import shutil
import subprocess
import tempfile
import time

from durability import hashes, run

RESULTS = ["ws/sparse", "ws/points.ply", "ws/rig.json"]
MAP = "map {d}/ws --rolling-shutter estimate"
WENT_ON = re.compile(r"goes on from a checkpoint: (\d+) of (\d+) images")


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--program", default="target/release/tiepoint")
    parser.add_argument("--kills", type=int, default=40)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--frames", type=int, default=60)
    args = parser.parse_args()
    program = str(pathlib.Path(args.program).resolve())
    root = pathlib.Path(tempfile.mkdtemp(prefix="tiepoint-checkpoints-"))
    base, folder = root / "base", root / "run"
    base.mkdir()
    for line in [
        f"synth -o {{d}}/drive --frames {args.frames} --size 320x240 --effects rolling-shutter",
        "features {d}/drive -o {d}/ws --timestamps {d}/drive/timestamps.csv",
        "match {d}/ws --pairs sequential:6",
    ]:
        made = run(program, line, base)
        assert made.returncode == 0, made.stderr
    shutil.copytree(base, folder)
    began = time.time()
    made = run(program, MAP, folder)
    assert made.returncode == 0, made.stderr
    seconds, expected = time.time() - began, hashes(folder, RESULTS)
    shutil.rmtree(folder)
    print(f"{len(expected)} files in {seconds:.0f} s without a kill", flush=True)
    draw = random.Random(args.seed)
    kills, resumed, chains, faults = 0, 0, 0, []
    while kills < args.kills:
        shutil.copytree(base, folder)
        chains += 1
        done = []
        while True:
            words = [word.replace("{d}", str(folder)) for word in MAP.split()]
            process = subprocess.Popen(
                [program, *words], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
            )
            try:
                out, _ = process.communicate(timeout=draw.uniform(0.02, 0.6) * seconds)
            except subprocess.TimeoutExpired:
                process.kill()
                out, _ = process.communicate()
                kills += 1
            found = WENT_ON.search(out)
            resumed += found is not None
            done.append(found.group(1) if found else "-")
            if process.returncode != -9:
                break
        if process.returncode != 0:
            faults.append(f"chain {chains}: {out}")
        elif hashes(folder, RESULTS) != expected:
            faults.append(f"chain {chains}: other bytes")
        print(f"chain {chains}: images with poses at the start of each run: {' '.join(done)}")
        shutil.rmtree(folder)
    print(f"{kills} kills in {chains} chains, {resumed} runs went on, {len(faults)} faults")
    print("\n".join(faults))
    shutil.rmtree(root)


if __name__ == "__main__":
    main()
