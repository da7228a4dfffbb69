"""The job: stages one after the other, each a set of tasks of Ray."""

import contextlib
import inspect
import json
import logging
import os
import re
import socket
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Optional, Union
from uuid import uuid4

import ray
import tiepoint
from ray.exceptions import OutOfMemoryError, RayError, RayTaskError, WorkerCrashedError
from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy
from tiepoint.progress import default_progress

from .report import Report, report_of
from .store import Workspace, forget_copy, is_url
from .tasks import STAGES, Board, Task, Work, work

Path = Union[str, "os.PathLike[str]"]

# Tasks of a stage, if no other number is given. It does not depend on the cluster: a job that goes
# on elsewhere finds the tiles of the same shards. A shard of matching reads the keypoints of all
# images first: with twice as many shards that is done twice as often, and with half as many more
# processors wait for the last one. More than 16 processors need more of them.
SHARDS = 32
# Seconds between two looks at the board.
INTERVAL_S = 0.5
# Seconds for an answer of the board: without one, the progress stands still.
BOARD_S = 5.0
# Seconds for a node to answer.
CONNECT_S = 10.0
# What tasks give themselves, and what is no work for shards.
NOT_OPTIONS = {"inputs", "output", "workspace", "shard", "submap", "merge", "redo", "threads"}
NOT_OPTIONS |= {"progress", "database", "every"}


def reconstruct(
    inputs: Union[Path, Sequence[Path]],
    output: Path,
    *,
    address: Optional[str] = None,
    shards: int = SHARDS,
    cpus: int = 1,
    redo: Optional[str] = None,
    progress: Union[None, bool, Callable[[dict[str, Any]], object]] = None,
    **options: Any,
) -> Report:
    """Features, matches and a model of photos, made by all nodes of a Ray cluster.

    inputs: folders of photos; output: the workspace. Each is a path that all nodes have, or an
    address of a store that fsspec knows, as `s3://bucket/photos`; so are options that are files.
    address: of the cluster, as in `ray.init`; by default RAY_ADDRESS, or else one that is started
    on this machine and ends with the job.
    shards: number of tasks of features and of matching. A job that was interrupted goes on if it
    is given the same number.
    cpus: processors, and threads, of each of them.
    redo: this stage and the later ones are computed again.
    progress: as of the other commands.
    Other options are those of `tiepoint.reconstruct`, for photos.

    Raises `tiepoint.Error` if the work fails, with the task and its node, and
    `tiepoint.UsageError` if an option is invalid. Completed tasks are kept.
    """
    several = [inputs] if isinstance(inputs, (str, os.PathLike)) else inputs
    given = [_absolute(value) for value in several]
    by_stage = _options_of_stages(options, redo)
    workspace = Workspace(_absolute(output), uuid4().hex)
    with _connected(address, cpus) as largest, default_progress(progress) as on_event:
        job = _Job(given, workspace, by_stage, (cpus, largest), on_event)
        parts = [f"{number}/{shards}" for number in range(1, shards + 1)]
        for stage in ("features", "match"):
            with job.stage(stage):
                job.run(stage, parts)
                job.run(stage, [None])
        with job.stage("map"):
            job.map()
        workspace.publish()
        job.forget_copies()
        return report_of(job.done, job.wall_s)


def _absolute(value: Path) -> str:
    text = os.fspath(value)
    return text if is_url(text) else os.path.abspath(text)


def _options_of_stages(options: dict[str, Any], redo: Optional[str]) -> dict[str, dict[str, Any]]:
    """The options that each stage takes. Those that are invalid in themselves are named before
    anything runs."""
    by_stage: dict[str, dict[str, Any]] = {stage: {} for stage in STAGES}
    for name, value in options.items():
        takers = [
            stage
            for stage, command in STAGES.items()
            if name in inspect.signature(command).parameters and name not in NOT_OPTIONS
        ]
        if not takers:
            raise TypeError(f"reconstruct() got an unexpected keyword argument {name!r}")
        for stage in takers:
            by_stage[stage][name] = value
    if redo is not None:
        if redo not in STAGES:
            raise tiepoint.UsageError(f"redo is one of {', '.join(STAGES)}, and not {redo}")
        by_stage[redo]["redo"] = redo
    with tempfile.TemporaryDirectory() as nothing:
        for stage, given in by_stage.items():
            # No folder of photos, and no workspace: only the options can be wrong in themselves.
            place = {"inputs": nothing, "output": nothing} if stage == "features" else {}
            place = place or {"workspace": nothing}
            with contextlib.suppress(tiepoint.Error):
                STAGES[stage](**place, **given, progress=False)
    return by_stage


@contextlib.contextmanager
def _connected(address: Optional[str], cpus: int) -> Iterator[int]:
    """Connects to the cluster, unless the caller has; the processors of its largest node."""
    is_ours = not ray.is_initialized()
    if is_ours:
        # A library tells nobody what it does.
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
        # Ray's own number is infinity: a task that is too large would never end. This one is that
        # of its retries after other deaths. Each waits longer than the last one.
        os.environ.setdefault("RAY_task_oom_retries", "3")
        # By itself, Ray would also look for a cluster that ran on this machine once.
        address = address or os.environ.get("RAY_ADDRESS") or "local"
        _knock(address)
        try:
            ray.init(address=address, log_to_driver=False, logging_level=logging.ERROR)
        except (ConnectionError, ValueError, RuntimeError, RayError) as error:
            raise tiepoint.Error(
                f"cannot join the Ray cluster at {address}: {str(error).strip().splitlines()[0]}; "
                "if it has a token, set RAY_AUTH_MODE=token and RAY_AUTH_TOKEN"
            ) from None
    try:
        largest = max(int(node["Resources"].get("CPU", 0)) for node in _nodes())
        if not 1 <= cpus <= largest:
            raise tiepoint.UsageError(
                f"cpus is {cpus}, and the largest node of the cluster has {largest} processors"
            )
        yield largest
    finally:
        if is_ours:
            ray.shutdown()


def _knock(address: str) -> None:
    """Whether somebody listens. Ray itself tries for a quarter of an hour."""
    host, _, port = address.rpartition(":")
    if port.isdecimal() and "://" not in address:
        try:
            socket.create_connection((host.strip("[]"), int(port)), CONNECT_S).close()
        except (OSError, OverflowError) as error:
            raise tiepoint.Error(f"no Ray cluster answers at {address}: {error}") from None


def _nodes() -> list[dict[str, Any]]:
    return [node for node in ray.nodes() if node["Alive"]]  # type: ignore[no-untyped-call]


class Lost(tiepoint.Error):
    """A task that did not come to its end."""


class _Job:
    """`cpus`: of a shard, and of a command that completes a stage."""

    def __init__(
        self,
        inputs: list[str],
        workspace: Workspace,
        options: dict[str, dict[str, Any]],
        cpus: tuple[int, int],
        on_event: Optional[Callable[[str], object]],
    ) -> None:
        self.inputs, self.workspace, self.options, self.cpus = inputs, workspace, options, cpus
        self.on_event = on_event
        self.done: list[Work] = []
        self.wall_s: dict[str, float] = {}
        # Where the driver is: if this node is lost, so is the job.
        here = ray.get_runtime_context().get_node_id()
        place = NodeAffinitySchedulingStrategy(here, soft=False)
        board = ray.remote(num_cpus=0, max_restarts=-1)(Board)
        self.board: Any = board.options(scheduling_strategy=place).remote()

    @contextlib.contextmanager
    def stage(self, stage: str) -> Iterator[None]:
        start = time.monotonic()
        yield
        self.wall_s[stage] = time.monotonic() - start
        self.tell({"event": "stage_done", "stage": stage, "seconds": self.wall_s[stage]})

    def map(self) -> None:
        """Sub-maps if there are any: what is wrong with the first one is said by the command for
        one map, too."""
        try:
            [first] = self.run("map", ["1"])
        except Lost:
            raise
        except tiepoint.Error as error:
            self.tell({"event": "noted", "what": f"mapping on one node: {error}"})
            self.run("map", [None])
            return
        if first["report"]["tile"] is not None:
            count = int(str(first["shard"]).partition("/")[2])
            self.run("map", [str(number) for number in range(2, count + 1)])
        self.run("map", ["merge"])

    def run(self, stage: str, parts: Sequence[Optional[str]]) -> list[Work]:
        """Runs a set of tasks side by side. The first that fails ends the others."""
        tasks: dict[Any, Task] = {}
        options = self.options[stage]
        for part in parts:
            is_shard = part not in (None, "merge")
            cpus = self.cpus[0 if is_shard else 1]
            task = Task(stage, part, self.inputs, self.workspace, options, cpus)
            tasks[work.options(num_cpus=cpus, name=task.key()).remote(task, self.board)] = task
        self.tell({"event": "stage_began", "stage": stage, "total": len(tasks), "done": 0})
        found: list[Work] = []
        waiting = list(tasks)
        try:
            while waiting:
                ended, waiting = ray.wait(waiting, timeout=INTERVAL_S)
                for ref in ended:
                    found.append(self.result(ref, tasks[ref]))
                self.tell_board(stage, list(tasks.values()))
        finally:
            for ref in waiting:
                ray.cancel(ref)
        self.done += found
        return found

    def result(self, ref: Any, task: Task) -> Work:
        """What a task has done; an error in a sentence."""
        try:
            done: Work = ray.get(ref)
            return done
        except RayError as error:
            cause = error.cause if isinstance(error, RayTaskError) else error
            if isinstance(cause, (tiepoint.Error, tiepoint.UsageError)):
                raise cause from None
            raise Lost(self.why(error, task)) from None

    def why(self, error: RayError, task: Task) -> str:
        began = self.state().get(task.key(), {})
        where = f"{task.key()} on node {began['node']}" if began else task.key()
        if isinstance(error, OutOfMemoryError):
            found = re.search(r"IP: ([^,]+), ID: (\w{6})\w*\) was ([^(]+) \(", str(error))
            if found is not None:
                where = f"{task.key()} on node {found[1]} ({found[2]}: {found[3]})"
            return (
                f"{where} ran out of memory: give more `cpus`, so that fewer tasks share a node, "
                "or nodes with more memory; a further call goes on from the completed tasks"
            )
        if isinstance(error, WorkerCrashedError):
            return (
                f"{where} was killed {began.get('tries', 1)} times, as the system does when memory "
                "runs out: give more `cpus`, so that fewer tasks share a node"
            )
        cause = error.cause if isinstance(error, RayTaskError) else error
        text = str(cause).strip() or type(cause).__name__
        why = text.splitlines()[0].rstrip(".")
        return f"{where} failed: {why}; a further call goes on from the completed tasks"

    def state(self) -> dict[str, dict[str, Any]]:
        state: dict[str, dict[str, Any]] = {}
        with contextlib.suppress(RayError):
            state = ray.get(self.board.state.remote(), timeout=BOARD_S)
        return state

    def tell_board(self, stage: str, tasks: list[Task]) -> None:
        """The steps of all tasks that have begun. Others are taken to be as large."""
        if self.on_event is None:
            return
        state = self.state()
        began = [state[task.key()] for task in tasks if task.key() in state]
        known = [task["total"] for task in began if task["total"]]
        total = round(sum(known) / len(known) * len(tasks)) if known else len(tasks)
        done = sum(task["done"] for task in began)
        nodes = len({task["node"] for task in began})
        event = {"event": "nodes", "stage": stage, "done": done, "total": total, "nodes": nodes}
        self.tell({**event, "retries": sum(task["tries"] - 1 for task in began)})

    def tell(self, event: dict[str, Any]) -> None:
        if self.on_event is not None:
            self.on_event(json.dumps(event))

    def forget_copies(self) -> None:
        """Removes the copies that nodes have of what is in a store."""
        urls = [self.workspace.url, *self.inputs]
        for options in self.options.values():
            urls += [value for value in options.values() if is_url(value)]
        urls = [url for url in urls if is_url(url)]
        if urls:
            remove = ray.remote(num_cpus=0)(forget_copy)
            waiting = []
            for node in _nodes():
                place = NodeAffinitySchedulingStrategy(node["NodeID"], soft=True)
                on_node = remove.options(scheduling_strategy=place)
                waiting += [on_node.remote(url) for url in urls]
            ray.get(waiting)
