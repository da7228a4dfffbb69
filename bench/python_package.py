#!/usr/bin/env python3
"""The Python package beside the program and pycolmap: bytes, time, import, other threads.

    release/wheel                               and its wheel, installed into an environment
    pip install pycolmap==4.2.1
    cargo build --release -p tiepoint --features las
    TIEPOINT_DATA=... python bench/python_package.py --python ENVIRONMENT/bin/python [--runs 3]

Prints JSON. Each run of `tiepoint.reconstruct` alternates with one of the program, on fountain-P11
with 2 threads, each in a process of its own; then all files of both workspaces are compared but
those that hold times. pycolmap extracts features, matches all pairs and maps, on the CPU with 2
threads. The speed of another Python thread beside `threads=1` is that of a loop that counts, in
loops a second, beside its speed alone; and beside the program with `--threads 1`, which shares the
machine but no lock. Let nothing else run.
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from program import program_of

# What holds times, and what holds a hash of that.
TIMED = {"report.json", "tiepoint-files.json"}

RECONSTRUCT = """
import sys, tiepoint
tiepoint.reconstruct(sys.argv[1], sys.argv[2], threads=2)
"""
IMPORT = """
import time
start = time.perf_counter()
import numpy
middle = time.perf_counter()
import tiepoint
print(middle - start, time.perf_counter() - middle)
"""
# Each line is the loops a second of a counting thread, while the named work was done.
THREADS = """
import subprocess, sys, threading, time, tiepoint
program, photos, scratch, rounds = *sys.argv[1:4], int(sys.argv[4])
counts, stop = [0], threading.Event()
def count():
    while not stop.is_set():
        for _ in range(1000):
            counts[0] += 1
def speed(work):
    before, start = counts[0], time.perf_counter()
    work()
    return (counts[0] - before) / (time.perf_counter() - start)
threading.Thread(target=count).start()
try:
    for k in range(rounds):
        folder = f"{scratch}/threads{k}"
        words = [program, "reconstruct", photos, "-o", folder + "p", "--threads", "1"]
        print(
            speed(lambda: time.sleep(5)),
            speed(lambda: tiepoint.reconstruct(photos, folder, threads=1)),
            speed(lambda: subprocess.run(words, check=True, capture_output=True)),
            flush=True,
        )
finally:
    stop.set()
"""
PYCOLMAP = """
import sys, pycolmap
photos, database, models = sys.argv[1:4]
cpu = pycolmap.Device.cpu
extraction = pycolmap.FeatureExtractionOptions(num_threads=2)
matching = pycolmap.FeatureMatchingOptions(num_threads=2)
single = pycolmap.CameraMode.SINGLE
pycolmap.extract_features(
    database, photos, camera_mode=single, extraction_options=extraction, device=cpu
)
pycolmap.match_exhaustive(database, matching_options=matching, device=cpu)
found = pycolmap.incremental_mapping(
    database, photos, models, pycolmap.IncrementalPipelineOptions(num_threads=2)
)
print(max(model.num_reg_images() for model in found.values()))
"""


def timed(command):
    """Wall and processor seconds of a command and what it started, and what it printed."""
    before, start = os.times(), time.perf_counter()
    done = subprocess.run(list(map(str, command)), capture_output=True, text=True)
    wall, after = time.perf_counter() - start, os.times()
    if done.returncode != 0:
        sys.exit(f"{command[0]}: {done.stderr.strip().splitlines()[-1]}")
    processor = after.children_user - before.children_user
    processor += after.children_system - before.children_system
    return {"wall_s": wall, "cpu_s": processor}, done.stdout


def files_of(folder):
    paths = (path for path in folder.rglob("*") if path.is_file() and path.name not in TIMED)
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in paths}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--python", type=Path, required=True, help="has the package installed")
    parser.add_argument("--program", type=Path)
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--without", choices=["pycolmap", "threads"], action="append", default=[])
    arguments = parser.parse_args()
    program, python = program_of(arguments), arguments.python
    photos = Path(os.environ["TIEPOINT_DATA"]) / "fountain-P11/images"
    found = {"cores": len(os.sched_getaffinity(0)), "load_average": os.getloadavg()[0]}
    with tempfile.TemporaryDirectory() as scratch:
        scratch = Path(scratch)
        imports = [timed([python, "-c", IMPORT])[1].split() for _ in range(7)]
        for place, name in enumerate(["import_numpy_s", "import_tiepoint_s"]):
            found[name] = statistics.median(float(words[place]) for words in imports)
        runs = {"program": [], "package": []}
        for k in range(arguments.runs):
            one, other = scratch / f"program{k}", scratch / f"package{k}"
            words = ["reconstruct", photos, "-o", one, "--threads", "2"]
            runs["program"].append(timed([program, *words])[0])
            runs["package"].append(timed([python, "-c", RECONSTRUCT, photos, other])[0])
            files = files_of(one)
            found["files"] = sorted(files)
            found["bytes_differ"] = sorted(
                name for name in files | files_of(other)
                if files.get(name) != files_of(other).get(name)
            )
            if found["bytes_differ"]:
                break
        found["runs"] = runs
        for key in ("wall_s", "cpu_s"):
            medians = {name: statistics.median(r[key] for r in runs[name]) for name in runs}
            found[f"package_over_program_{key}"] = medians["package"] / medians["program"]
        if "pycolmap" not in arguments.without:
            names = [scratch / "db.db", scratch / "models"]
            names[1].mkdir()
            command = [sys.executable, "-c", PYCOLMAP, photos, *names]
            found["pycolmap"], registered = timed(command)
            found["pycolmap"]["registered"] = int(registered.split()[-1])
        if "threads" not in arguments.without:
            command = [python, "-c", THREADS, program, photos, scratch, arguments.runs]
            speeds = [
                list(map(float, line.split())) for line in timed(command)[1].splitlines() if line
            ]
            alone, package, beside = map(statistics.median, zip(*speeds))
            found["other_thread_loops_a_second"] = speeds
            found["other_thread_keeps"] = package / alone
            found["other_thread_keeps_beside_program"] = beside / alone
    print(json.dumps(found, indent=1))


main()
