"""The report of a job: what each task did, and the sums."""

from typing import Any, TypedDict

from .tasks import STAGES, Work


class StageTotals(TypedDict):
    """Sums over the tasks of a stage. `seconds`: of all tasks; `wall_s`: from begin to end.
    `kept`: tasks that an earlier job did, whose images and pairs are not counted."""

    tasks: int
    kept: int
    seconds: float
    wall_s: float
    images: int
    keypoints: int
    pairs: int
    matches: int
    inliers: int


class NodeTotals(TypedDict):
    """Sums over the tasks of a node."""

    tasks: int
    seconds: float


class Report(TypedDict):
    """`report` is that of the program."""

    stages: dict[str, StageTotals]
    nodes: dict[str, NodeTotals]
    tasks: list[Work]
    report: dict[str, Any]


def report_of(tasks: list[Work], wall_s: dict[str, float]) -> Report:
    """The report, from the tasks in the order in which they ended. `wall_s`: by stage."""
    stages, nodes = {}, {}
    for stage in STAGES:
        own = [task for task in tasks if task["stage"] == stage]
        stages[stage] = StageTotals(
            tasks=len(own),
            kept=sum(task["is_kept"] for task in own),
            seconds=sum(task["seconds"] for task in own),
            wall_s=wall_s[stage],
            images=sum(task["images"] for task in own),
            keypoints=sum(task["keypoints"] for task in own),
            pairs=sum(task["pairs"] for task in own),
            matches=sum(task["matches"] for task in own),
            inliers=sum(task["inliers"] for task in own),
        )
    for node in sorted({task["node"] for task in tasks}):
        own = [task for task in tasks if task["node"] == node]
        nodes[node] = NodeTotals(tasks=len(own), seconds=sum(task["seconds"] for task in own))
    return Report(stages=stages, nodes=nodes, tasks=tasks, report=tasks[-1]["report"])


def text_of(report: Report) -> str:
    """A table of stages and nodes."""
    width = max(map(len, [*report["stages"], *report["nodes"]]))
    lines = [f"{'':{width}} {'tasks':>6} {'seconds':>9} {'wall':>8} {'images':>8} {'pairs':>8}"]
    for stage, sums in report["stages"].items():
        kept = f"  ({sums['kept']} kept)" if sums["kept"] else ""
        lines.append(
            f"{stage:{width}} {sums['tasks']:6} {sums['seconds']:9.1f} {sums['wall_s']:8.1f} "
            f"{sums['images']:8} {sums['pairs']:8}{kept}"
        )
    for node, of_node in report["nodes"].items():
        lines.append(f"{node:{width}} {of_node['tasks']:6} {of_node['seconds']:9.1f}")
    for model in report["report"].get("models", []):
        lines.append(f"{model['path']}: {model['registered']} images, {model['points']} points")
    return "\n".join(lines)
