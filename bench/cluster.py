#!/usr/bin/env python3
"""Two Ray nodes in network namespaces of this machine, one processor each, against one process.

    sudo bench/cluster.py [--frames 100] [--size 640x480] [--submaps 60] [--shards 8]

Needs Linux with two processors, root, iproute2, and a Python with ray and the package (pip install
'./python[ray]'). Renders a drive of two cameras and reconstructs it by one process with one thread,
by one node, by two, by two of which one is killed while it matches (every process of its namespace
gets SIGKILL), by two of which one is killed while it maps a part, and by two with photos and
workspace in the S3 of moto's server (pip install 'moto[server]' s3fs), where each node has a
temporary folder of its own. The rows of the database and the models must be those of the one
process. Bytes are those that went over the cable. Then a node whose memory is too small, for its
sentence."""

import argparse
import contextlib
import json
import os
import secrets
import signal
import sqlite3
import subprocess
import sys
import tempfile
import time
from pathlib import Path

TABLES = ["cameras", "images", "keypoints", "descriptors", "matches", "two_view_geometries"]
MODEL = ["cameras.bin", "images.bin", "points3D.bin"]
# Names of the namespaces, and of the ends of the cable between them.
NODES = {"tiepoint-a": "10.77.0.1", "tiepoint-b": "10.77.0.2"}
ENDS = dict(zip(NODES, ["tiepoint-0", "tiepoint-1"]))
PORT = 6379
S3_PORT = 5000
# Without it Ray asks for the token of a file in the home of its user.
ENVIRONMENT = {"RAY_USAGE_STATS_ENABLED": "0", "RAY_AUTH_MODE": "token"}
ENVIRONMENT["RAY_AUTH_TOKEN"] = secrets.token_hex(32)
# Each further one waits a minute.
ENVIRONMENT["RAY_task_oom_retries"] = "1"
# Of the store. What is in these networks is behind no proxy.
ENVIRONMENT |= dict.fromkeys(["AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY"], "any")
ENVIRONMENT |= {"AWS_REGION": "us-east-1", "NO_PROXY": "*"}
ENVIRONMENT["AWS_ENDPOINT_URL"] = f"http://{NODES['tiepoint-a']}:{S3_PORT}"
COPY = """
import sys, s3fs
way, place, other = sys.argv[1:]
store = s3fs.S3FileSystem()
if way == "put":
    store.mkdir("bucket")
getattr(store, way)(place, other, recursive=True)
"""
# Seconds in which the server of the store begins to answer.
STORE_S = 60.0


def sh(*words, **options):
    return subprocess.run([str(word) for word in words], check=True, **options)


def inside(node, *words):
    """A command in a namespace, on its own processor."""
    core = list(NODES).index(node)
    return ["ip", "netns", "exec", node, "taskset", "-c", core, *words]


@contextlib.contextmanager
def network():
    first, second = ENDS.values()
    try:
        sh("ip", "link", "add", first, "type", "veth", "peer", "name", second)
        for node, address in NODES.items():
            end = ENDS[node]
            sh("ip", "netns", "add", node)
            sh("ip", "link", "set", end, "netns", node)
            sh("ip", "-n", node, "addr", "add", f"{address}/24", "dev", end)
            sh("ip", "-n", node, "link", "set", end, "up")
            sh("ip", "-n", node, "link", "set", "lo", "up")
        yield
    finally:
        for node in NODES:
            kill(node)
            subprocess.run(["ip", "netns", "del", node], stderr=subprocess.DEVNULL)
        subprocess.run(["ip", "link", "del", first], stderr=subprocess.DEVNULL)


def moved():
    """Bytes that went over the cable so far, in both directions."""
    node, end = next(iter(ENDS.items()))
    words = ["ip", "-n", node, "-s", "-j", "link", "show", "dev", end]
    [link] = json.loads(sh(*words, capture_output=True).stdout)
    return link["stats64"]["rx"]["bytes"] + link["stats64"]["tx"]["bytes"]


def start_store():
    """Starts the server of the store beside the first node, and waits for it."""
    head, address = next(iter(NODES.items()))
    server = str(Path(sys.executable).parent / "moto_server")
    words = inside(head, server, "-H", address, "-p", S3_PORT)
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    subprocess.Popen([str(word) for word in words], **quiet)
    probe = f"import socket; socket.create_connection(('{address}', {S3_PORT}))"
    until = time.monotonic() + STORE_S
    while True:
        found = subprocess.run([str(w) for w in inside(head, sys.executable, "-c", probe)], **quiet)
        if found.returncode == 0:
            return
        if time.monotonic() > until:
            sys.exit("the server of the store does not answer")
        time.sleep(1.0)


def copy(way, place, other):
    """Copies between a folder and the store."""
    head = next(iter(NODES))
    sh(*inside(head, sys.executable, "-c", COPY, way, place, other), env=environment_of(None))


def environment_of(temporary):
    """`temporary`: what is not Ray's."""
    given = {**os.environ, **ENVIRONMENT}
    if temporary is not None:
        temporary.mkdir(exist_ok=True)
        given |= {"RAY_TMPDIR": "/tmp", "TMPDIR": str(temporary)}
    return given


def kill(node):
    """Every process of a namespace."""
    found = subprocess.run(["ip", "netns", "pids", node], capture_output=True, text=True)
    for pid in found.stdout.split():
        with contextlib.suppress(ProcessLookupError):
            os.kill(int(pid), signal.SIGKILL)


def start(node, temporary, memory_threshold=None):
    """Starts the Ray node of a namespace."""
    head = next(iter(NODES))
    place = ["--head", f"--port={PORT}", "--include-dashboard=false"]
    if node != head:
        place = [f"--address={NODES[head]}:{PORT}"]
    environment = environment_of(temporary)
    if memory_threshold is not None:
        environment["RAY_memory_usage_threshold"] = str(memory_threshold)
    ray = str(Path(sys.executable).parent / "ray")
    words = [ray, "start", *place, f"--node-ip-address={NODES[node]}", "--num-cpus=1"]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    sh(*inside(node, *words), **quiet, env=environment)


def rows(workspace):
    with contextlib.closing(sqlite3.connect(workspace / "database.db")) as database:
        return [database.execute(f"SELECT * FROM {t} ORDER BY 1").fetchall() for t in TABLES]


def models(workspace):
    folders = sorted(path.name for path in (workspace / "sparse").iterdir())
    return {(f, n): (workspace / "sparse" / f / n).read_bytes() for f in folders for n in MODEL}


def runs(node, task):
    """Whether a task runs on a node: Ray names processes by it."""
    found = subprocess.run(["ip", "netns", "pids", node], capture_output=True, text=True)
    for pid in found.stdout.split():
        with contextlib.suppress(OSError):
            if Path(f"/proc/{pid}/cmdline").read_text().startswith(f"ray::{task}"):
                return True
    return False


def reconstruct(name, photos, folder, arguments, job):
    """Runs a job; the second node is killed when it runs a task `killed_in`."""
    nodes, killed_in = job["nodes"], job.get("killed_in")
    for node in nodes:
        start(node, folder / node, job.get("threshold"))
    workspace, (head, other) = folder / name, list(NODES)
    places = [photos, workspace]
    if job.get("has_store"):
        start_store()
        copy("put", photos, "bucket/photos")
        places = ["s3://bucket/photos", "s3://bucket/workspace"]
    words = [sys.executable, "-m", "tiepoint.cluster", places[0], "-o", places[1], "--json"]
    words += [f"--address={NODES[head]}:{PORT}", f"--shards={arguments.shards}"]
    words += options(arguments)
    begin, moved_before = time.monotonic(), moved()
    words = [str(word) for word in inside(head, *words)]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    process = subprocess.Popen(words, **pipes, text=True, env=environment_of(folder / head))
    is_killed = killed_in is None
    while not is_killed and process.poll() is None:
        time.sleep(0.02)
        if runs(other, killed_in):
            kill(other)
            is_killed = True
    output, errors = process.communicate()
    seconds, sent = time.monotonic() - begin, moved() - moved_before
    if job.get("has_store") and process.returncode == 0:
        copy("get", "bucket/workspace", workspace)
    for node in nodes:
        kill(node)
    lines = errors.strip().splitlines() or ["no sentence"]
    if not is_killed:
        lines, process.returncode = [f"the second node never ran {killed_in}"], 1
    report = json.loads(output) if process.returncode == 0 else lines[-1]
    return report, seconds, sent, workspace


def options(arguments):
    return ["--pairs=sequential:6", "--rig=off", f"--submaps={arguments.submaps}"]


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=100)
    parser.add_argument("--size", default="640x480")
    parser.add_argument("--submaps", type=int, default=60)
    parser.add_argument("--shards", type=int, default=8)
    arguments = parser.parse_args()
    import tiepoint

    with tempfile.TemporaryDirectory() as folder, network():
        folder = Path(folder)
        photos, one = folder / "drive", folder / "one"
        drive = {"route": "open", "rate": 2.5, "seed": 3}
        tiepoint.synth(photos, frames=arguments.frames, size=arguments.size, **drive)
        given = {"pairs": "sequential:6", "rig": "off", "submaps": arguments.submaps}
        begin = time.monotonic()
        tiepoint.reconstruct(photos, one, threads=1, progress=False, **given)
        print(f"one process, one thread: {time.monotonic() - begin:.1f} s")
        expected = rows(one), models(one)
        head, other = list(NODES)
        jobs = {
            "one node": {"nodes": [head]},
            "two nodes": {"nodes": [head, other]},
            "a node killed in matching": {"nodes": [head, other], "killed_in": "match shard"},
            "a node killed in a sub-map": {"nodes": [head, other], "killed_in": "sub-map"},
            "two nodes and a store": {"nodes": [head, other], "has_store": True},
        }
        failed = 0
        for name, job in jobs.items():
            found = reconstruct(name, photos, folder, arguments, job)
            report, seconds, sent, workspace = found
            if isinstance(report, str):
                print(f"{name}: FAILED: {report}")
                failed += 1
                continue
            same = [rows(workspace) == expected[0], models(workspace) == expected[1]]
            failed += same != [True, True]
            tasks = {node: sums["tasks"] for node, sums in report["nodes"].items()}
            busy = sum(sums["seconds"] for sums in report["nodes"].values())
            print(
                f"{name}: {seconds:.1f} s, tasks took {busy:.1f} s; {sent / 1e6:.1f} MB moved; "
                f"rows {word(same[0])}, models {word(same[1])}; tasks by node {tasks}"
            )
        job = {"nodes": [head], "threshold": 0.01}
        report = reconstruct("small", photos, folder, arguments, job)[0]
        print(f"a node without memory: {report if isinstance(report, str) else 'NO SENTENCE'}")
        sys.exit(1 if failed else 0)


def word(is_same):
    return "the same" if is_same else "DIFFER"


if __name__ == "__main__":
    main()
