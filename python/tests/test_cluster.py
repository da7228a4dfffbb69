"""Reconstruction on Ray: nodes of one processor each on this machine."""

import contextlib
import logging
import os
import pathlib
import sqlite3
import sys
import threading

import pytest
import tiepoint

try:
    import ray
    from ray.cluster_utils import Cluster
except ImportError:
    pytest.skip("NO RAY: THE CLUSTER IS NOT TESTED (pip install ray)", allow_module_level=True)

from tiepoint.cluster import reconstruct

SHARDS = 3
# Seconds between two looks at the processes: far less than a task takes.
POLL_S = 0.02
# In two sub-maps of sixty images.
OPTIONS = {"pairs": "sequential:3", "rig": "off", "submaps": 50}
TABLES = ["cameras", "images", "keypoints", "descriptors", "matches", "two_view_geometries"]
MODEL = ["cameras.bin", "images.bin", "points3D.bin"]


def rows(workspace):
    with contextlib.closing(sqlite3.connect(workspace / "database.db")) as database:
        return [database.execute(f"SELECT * FROM {t} ORDER BY 1").fetchall() for t in TABLES]


def models(workspace):
    return [(workspace / "sparse/0" / name).read_bytes() for name in MODEL]


@pytest.fixture(scope="module")
def photos(tmp_path_factory):
    folder = tmp_path_factory.mktemp("cluster") / "drive"
    tiepoint.synth(folder, frames=30, size="160x120", rate=2.5, route="open", seed=3)
    return folder


@pytest.fixture(scope="module")
def alone(photos, tmp_path_factory):
    """What one process makes."""
    folder = tmp_path_factory.mktemp("alone") / "ws"
    tiepoint.reconstruct(photos, folder, progress=False, **OPTIONS)
    return folder


@pytest.fixture(scope="module")
def store():
    """An S3 of moto on this machine, which processes find by their environment."""
    server = pytest.importorskip("moto.server").ThreadedMotoServer("127.0.0.1", port=0)
    s3fs = pytest.importorskip("s3fs")
    server.start()
    logging.getLogger("werkzeug").setLevel(logging.ERROR)
    host, port = server.get_host_and_port()
    keys = {"AWS_ACCESS_KEY_ID": "any", "AWS_SECRET_ACCESS_KEY": "any", "AWS_REGION": "us-east-1"}
    os.environ.update(keys, AWS_ENDPOINT_URL=f"http://{host}:{port}", NO_PROXY=host)
    found = s3fs.S3FileSystem()
    found.mkdir("bucket")
    yield found
    server.stop()


@pytest.fixture
def one_node(store):
    """Its processes know where the store is."""
    ray.init(address="local", num_cpus=2, log_to_driver=False)
    yield
    ray.shutdown()


@pytest.fixture(scope="module")
def nodes():
    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 0})
    # Two of them get lost.
    for _ in range(3):
        cluster.add_node(num_cpus=1)
    ray.init(address=cluster.address, log_to_driver=False)
    yield cluster
    ray.shutdown()
    cluster.shutdown()


def check(report, alone, workspace):
    """The rows and models of one process, and sums that are those of its report."""
    assert rows(workspace) == rows(alone)
    assert models(workspace) == models(alone)
    stages, program = report["stages"], report["report"]["stages"]
    assert stages["features"]["images"] == program["features"]["images"] == 60
    assert stages["features"]["keypoints"] == program["features"]["keypoints"]
    assert stages["match"]["pairs"] == program["match"]["pairs"]
    tasks = report["tasks"]
    for sums in (stages, report["nodes"]):
        assert sum(part["tasks"] for part in sums.values()) == len(tasks)
        total = sum(task["seconds"] for task in tasks)
        assert sum(part["seconds"] for part in sums.values()) == pytest.approx(total)


def test_photos_and_workspace_in_s3(photos, alone, store, one_node, tmp_path):
    store.put(str(photos), "bucket/drive", recursive=True)
    place = {"inputs": "s3://bucket/drive", "output": "s3://bucket/ws"}
    report = reconstruct(**place, shards=SHARDS, progress=False, **OPTIONS)
    store.get("bucket/ws", str(tmp_path / "ws"), recursive=True)
    check(report, alone, tmp_path / "ws")
    names = [path.removeprefix("bucket/ws/") for path in store.find("bucket/ws")]
    assert not [name for name in names if name.startswith(".")], "the archive and the tiles"
    again = reconstruct(**place, shards=SHARDS, progress=False, **OPTIONS)
    assert all(task["is_kept"] for task in again["tasks"])
    store.pipe_file("bucket/mine/photo.txt", b"mine")
    with pytest.raises(tiepoint.Error, match="has files and is no workspace"):
        reconstruct("s3://bucket/drive", "s3://bucket/mine", shards=1)
    with pytest.raises(tiepoint.Error, match="s3://bucket/absent does not exist"):
        reconstruct("s3://bucket/absent", "s3://bucket/ws2", shards=1)


def running(nodes, task):
    """The worker node that runs a task; None if none does. Ray names processes by their task."""
    raylets = {node.all_processes["raylet"][0].process.pid: node for node in nodes.worker_nodes}
    for process in pathlib.Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            if (process / "cmdline").read_text().startswith(f"ray::{task}"):
                parent = int((process / "stat").read_text().rpartition(")")[2].split()[1])
                if parent in raylets:
                    return raylets[parent]
    return None


@pytest.mark.skipif(sys.platform != "linux", reason="processes are found in /proc")
def test_a_lost_node_changes_nothing(photos, alone, nodes, tmp_path):
    """One is lost while it matches, and another one while it maps a part."""
    lost, has_ended = [], threading.Event()

    def lose():
        for task in ("match shard", "sub-map"):
            while (node := running(nodes, task)) is None:
                if has_ended.wait(POLL_S):
                    return
            nodes.remove_node(node, allow_graceful=False)
            lost.append(task)

    killer = threading.Thread(target=lose)
    killer.start()
    try:
        report = reconstruct(photos, tmp_path / "ws", shards=SHARDS, progress=False, **OPTIONS)
    finally:
        has_ended.set()
        killer.join()
    assert lost == ["match shard", "sub-map"]
    check(report, alone, tmp_path / "ws")
    again = reconstruct(photos, tmp_path / "ws", shards=SHARDS, progress=False, **OPTIONS)
    assert all(task["is_kept"] for task in again["tasks"])


def test_the_sentence_of_a_command_that_fails(photos, nodes, tmp_path):
    with pytest.raises(tiepoint.Error, match=r"features shard ./3 on node .*absent"):
        reconstruct(tmp_path / "absent", tmp_path / "ws", shards=SHARDS)
    with pytest.raises(tiepoint.UsageError, match="rig"):
        reconstruct(photos, tmp_path / "ws", rig="wrong")
    with pytest.raises(TypeError, match="no_such_option"):
        reconstruct(photos, tmp_path / "ws", no_such_option=1)
    with pytest.raises(tiepoint.UsageError, match="largest node of the cluster has 1"):
        reconstruct(photos, tmp_path / "ws", cpus=2)
    assert not (tmp_path / "ws" / "database.db").exists()
