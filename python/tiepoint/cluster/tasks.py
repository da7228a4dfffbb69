"""What runs on the nodes of a Ray cluster: one command of the program for each task."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Optional, TypedDict

import ray
import tiepoint

from .store import Workspace, localised

# Seconds between two messages of a task to the board.
INTERVAL_S = 0.5
STAGES: dict[str, Callable[..., dict[str, Any]]] = {
    "features": tiepoint.extract_features,
    "match": tiepoint.match_images,
    "map": tiepoint.map_images,
}


class Work(TypedDict):
    """What one task has done. `shard`: `2/8`, or None for the command that completes the stage."""

    stage: str
    shard: Optional[str]
    node: str
    seconds: float
    images: int
    keypoints: int
    pairs: int
    matches: int
    inliers: int
    # Whether an earlier job did it.
    is_kept: bool
    report: dict[str, Any]


@dataclass(frozen=True)
class Task:
    """A command. `part`: `2/8` of a stage in shards, the number of a sub-map, `merge` for the
    command that assembles them, or None."""

    stage: str
    part: Optional[str]
    inputs: list[str]
    workspace: Workspace
    options: dict[str, Any]
    threads: int

    def key(self) -> str:
        what = {None: self.stage, "merge": f"the merge of {self.stage}"}
        kind = "sub-map" if self.stage == "map" else f"{self.stage} shard"
        return what.get(self.part, f"{kind} {self.part}")

    def is_shard(self) -> bool:
        return self.part not in (None, "merge")

    def tiles(self) -> list[str]:
        """Patterns of the names of the tiles that it reads."""
        if not self.is_shard():
            return [] if (self.stage, self.part) == ("map", None) else [f"{self.stage}-*-of-*"]
        numbers = {str(self.part).partition("/")[0]} | ({"1"} if self.stage == "map" else set())
        return [f"{self.stage}-{number}-of-*" for number in sorted(numbers)]


class Board:
    """How far each task is: its node, its steps and how often it began. Where memory runs out, it
    may be lost, too, and begins again."""

    def __init__(self) -> None:
        self.tasks: dict[str, dict[str, Any]] = {}

    def begin(self, key: str, node: str) -> None:
        tries = self.tasks.get(key, {"tries": 0})["tries"] + 1
        self.tasks[key] = {"node": node, "done": 0, "total": 0, "tries": tries}

    def step(self, key: str, done: int, total: int) -> None:
        if key in self.tasks:
            self.tasks[key].update(done=done, total=total)

    def state(self) -> dict[str, dict[str, Any]]:
        return self.tasks


class Watch:
    """Counts the events of a command, and tells the board."""

    def __init__(self, key: str, board: Any) -> None:
        self.key, self.board, self.told_at = key, board, 0.0
        self.done = self.total = 0
        self.counts = dict.fromkeys(("images", "keypoints", "pairs", "matches", "inliers"), 0)
        self.is_kept = False

    def event(self, event: dict[str, Any]) -> None:
        kind, counts = event["event"], self.counts
        if kind == "stage_began":
            self.done, self.total = event["done"], event["total"]
        elif kind == "stage_kept":
            self.is_kept = True
        elif kind == "image_done":
            counts["images"] += 1
            counts["keypoints"] += event["keypoints"]
        elif kind == "pair_done":
            counts["pairs"] += 1
            counts["matches"] += event["matches"]
            counts["inliers"] += event["inliers"]
        if kind in ("image_done", "image_skipped", "pair_done"):
            self.done += 1
        elif kind == "image_registered":
            self.done = event["registered"]
        if time.monotonic() - self.told_at >= INTERVAL_S:
            self.told_at = time.monotonic()
            self.board.step.remote(self.key, self.done, self.total)


@ray.remote
def work(task: Task, board: Any) -> Work:
    """Runs a command on the node where Ray has placed it. A shard that has its tile does nothing,
    so that Ray may run it again when a node is lost."""
    start = time.monotonic()
    address = ray.util.get_node_ip_address()  # type: ignore[no-untyped-call]
    # Nodes of one machine have one address.
    node = f"{address} ({ray.get_runtime_context().get_node_id()[:6]})"
    board.begin.remote(task.key(), node)
    watch = Watch(task.key(), board)
    try:
        report = _run(task, watch)
    except tiepoint.UsageError:
        raise
    except (tiepoint.Error, OSError) as error:
        raise tiepoint.Error(f"{task.key()} on node {node}: {error}") from None
    # Images of a command that completes a stage are those of the shards.
    counts = watch.counts if task.is_shard() else dict.fromkeys(watch.counts, 0)
    board.step.remote(task.key(), watch.total, watch.total)
    return Work(
        stage=task.stage,
        shard=report["shard"] if task.is_shard() else None,
        node=node,
        seconds=time.monotonic() - start,
        images=counts["images"],
        keypoints=counts["keypoints"],
        pairs=counts["pairs"],
        matches=counts["matches"],
        inliers=counts["inliers"],
        is_kept=watch.is_kept,
        report=report,
    )


def _run(task: Task, watch: Watch) -> dict[str, Any]:
    workspace = task.workspace
    folder = workspace.folder()
    workspace.take_tiles(folder, task.tiles())
    options = {name: localised(value) for name, value in task.options.items()}
    options.update(threads=task.threads, progress=watch.event)
    if task.stage == "features":
        options["inputs"] = [localised(given) for given in task.inputs]
        options["output"] = folder
    else:
        options["workspace"] = folder
    if task.part == "merge":
        options["merge"] = True
    elif task.part is not None:
        options["submap" if task.stage == "map" else "shard"] = task.part
    report = STAGES[task.stage](**options)
    if not task.is_shard():
        if not watch.is_kept:
            workspace.put(folder, task.stage)
    elif report["tile"] is not None:
        workspace.put_tile(str(Path(report["tile"])))
    return report
