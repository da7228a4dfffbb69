#!/usr/bin/env python3
"""Kills the program at its system calls and looks at what is left.

    bench/durability.py [--program target/release/tiepoint] [--stops 1000] [--seed 0]

For each of a set of system calls that change files, strace (apt install strace) sends SIGKILL at
the n-th call of a run of `reconstruct`, of its redoings, exports and `adjust`, on four small
rendered photos. Then: the photos must be the same bytes, and the same command (with --redo where
the program asks for it) must end with the models of an undisturbed run. The sweep inside the
process, with full disks and failing writes, is TIEPOINT_ALL_FAULTS=1 cargo test -p tiepoint --test
program faults."""

import argparse
import collections
import hashlib
import pathlib
import random
import re
import shutil
import subprocess
import tempfile
import time

CALLS = [
    "openat",
    "write",
    "pwrite64",
    "fsync",
    "fdatasync",
    "ftruncate",
    "rename",
    "renameat",
    "unlink",
    "unlinkat",
    "mkdir",
    "rmdir",
    "fchmod",
    "close",
]
COMMANDS = [
    ("reconstruct", "reconstruct {d}/drive -o {d}/ws --rig off --threads 1"),
    (
        "redo features",
        (
            "reconstruct {d}/drive -o {d}/ws --rig off --threads 1 --camera-model RADIAL --redo"
            " features"
        ),
    ),
    (
        "redo match",
        "reconstruct {d}/drive -o {d}/ws --rig off --threads 1 --pairs sequential:2 --redo match",
    ),
    ("redo map", "reconstruct {d}/drive -o {d}/ws --rig off --threads 1 --redo map"),
    ("colmap", "export {d}/ws --to colmap -o {d}/out --threads 1"),
    ("nerfstudio", "export {d}/ws --to nerfstudio -o {d}/out --threads 1"),
    ("openmvs", "export {d}/ws --to openmvs -o {d}/out --threads 1"),
    ("ply", "export {d}/ws --to ply -o {d}/a.ply --threads 1"),
    ("adjust", "adjust {d}/ws -o {d}/out --threads 1"),
    ("dense", "dense {d}/ws --threads 1"),
]


def run(program, line, folder, prefix=()):
    words = [word.replace("{d}", str(folder)) for word in line.split()]
    return subprocess.run([*prefix, program, *words], capture_output=True, text=True)


def hashes(folder, names):
    found = {}
    for name in names:
        for path in (
            sorted((folder / name).rglob("*")) if (folder / name).is_dir() else [folder / name]
        ):
            if path.is_file() and not any(
                part.startswith(".") for part in path.relative_to(folder).parts
            ):
                found[str(path.relative_to(folder))] = hashlib.blake2b(
                    path.read_bytes()
                ).hexdigest()
    return found


def results(folder):
    workspace = ["ws/sparse", "ws/dense", "ws/points.ply", "ws/timestamps.csv"]
    return hashes(folder, [*workspace, "out", "a.ply"])


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--program", default="target/release/tiepoint")
    parser.add_argument("--stops", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    program = str(pathlib.Path(args.program).resolve())
    root = pathlib.Path(tempfile.mkdtemp(prefix="tiepoint-durability-"))
    base = root / "base"
    base.mkdir()
    run(program, "synth -o {d}/drive --frames 2 --size 240x180", base)
    for extra in ["truth", "timestamps.csv", "synth.json"]:
        path = base / "drive" / extra
        shutil.rmtree(path) if path.is_dir() else path.unlink(missing_ok=True)
    made = run(program, COMMANDS[0][1], base)
    assert made.returncode == 0, made.stderr
    cases, expected = [], {}
    for name, line in COMMANDS:
        folder = root / "count"
        shutil.copytree(base, folder)
        if name == "reconstruct":
            shutil.rmtree(folder / "ws")
        # The absolute paths of inputs are in the workspace; each folder has the same name, so that
        # they stay true.
        log = root / "log"
        ended = run(
            program,
            line,
            folder,
            ["strace", "-f", "-qq", "-e", "trace=" + ",".join(CALLS), "-o", str(log)],
        )
        assert ended.returncode == 0, ended.stderr
        counts = collections.Counter(
            re.findall(r"^\d+ +(\w+)\(", log.read_text(errors="replace"), re.M)
        )
        for call, count in counts.items():
            cases.extend((name, line, call, n) for n in range(1, count + 1))
        expected[name] = results(folder)
        shutil.rmtree(folder)
    random.Random(args.seed).shuffle(cases)
    print(f"{len(cases)} calls; stopping at up to {args.stops} of them", flush=True)
    photos = hashes(base, ["drive"])
    stops, faults, began = 0, [], time.time()
    for name, line, call, n in cases:
        if stops >= args.stops:
            break
        folder = root / "count"
        shutil.copytree(base, folder)
        if name == "reconstruct":
            shutil.rmtree(folder / "ws")
        inject = f"inject={call}:signal=SIGKILL:when={n}"
        killed = run(
            program,
            line,
            folder,
            ["strace", "-f", "-qq", "-o", "/dev/null", "-e", f"trace={call}", "-e", inject],
        )
        stops += killed.returncode != 0
        case = f"{name}: {call} {n}"
        if hashes(folder, ["drive"]) != photos:
            faults.append(f"{case}: photos changed")
        again = run(program, re.sub(r" --redo \w+", "", line), folder)
        if again.returncode != 0 and "--redo" in again.stderr:
            again = run(program, line, folder)
        if again.returncode != 0:
            faults.append(f"{case}: stuck: {again.stderr.strip()}")
        elif results(folder) != expected[name]:
            faults.append(f"{case}: other bytes")
        shutil.rmtree(folder)
    print(f"{stops} stops in {time.time() - began:.0f} s, {len(faults)} faults")
    print("\n".join(faults))
    shutil.rmtree(root)


if __name__ == "__main__":
    main()
