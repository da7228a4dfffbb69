#!/usr/bin/env python3
"""tiepoint-ba beside Ceres, on problems of "Bundle adjustment in the large".

    apt install g++ libceres-dev;  pip install numpy
    cargo build --release -p tiepoint-ba --example bal
    TIEPOINT_DATA=... python bench/ba.py [--threads 2] [--repetitions 5] [--stress]
        [PROBLEM.txt ...]

Both start from the same file; both have derivatives by hand (Ceres also by automatic
differentiation, as in its own bundle_adjuster). The final costs of both are evaluated here, by one
function, from the files that they write. A run's time counts from the problem in memory: the
analysis of its structure and all steps. What is compared is the time until the cost is within 0.1 %
of Ceres' final cost; of the repetitions, which take turns, the least counts. Ceres' quickest solver
is its best. Linux may leave both threads of a run of 20 ms on one core (medians far above the
least), so where it may the script runs both programs in the real-time class, as `chrt -f 1` does.
"""

import argparse
import json
import os
import pathlib
import subprocess
import tempfile

import numpy as np
from program import ROOT, TARGET

ITERATIONS = 50
WITHIN = 1e-3
# Long rows of cameras and short, starts near and far, with gross errors and without.
STRESS = [
    dict(cameras=16, points=3000, off=4.0),
    dict(cameras=16, points=3000, off=10.0),
    dict(cameras=60, points=6000, longest=6, off=2.0),
    dict(cameras=120, points=8000, longest=5, off=1.0),
    dict(cameras=16, points=3000, outliers=0.05),
    dict(cameras=60, points=6000, longest=6, off=3.0, outliers=0.02),
    dict(cameras=8, points=500, longest=3, off=5.0, outliers=0.1),
    dict(cameras=30, points=4000, longest=30, off=6.0),
]
CERES = [
    (solver, derivatives)
    for derivatives in ("analytic", "automatic")
    for solver in ("dense", "sparse", "iterative")
]


def final_cost(path):
    """Half the sum of squares of a problem file, from its numbers alone."""
    numbers = np.array(path.read_text().split(), dtype=float)
    cameras, points, observations = numbers[:3].astype(int)
    seen = numbers[3 : 3 + 4 * observations].reshape(-1, 4)
    rest = numbers[3 + 4 * observations :]
    camera = rest[: 9 * cameras].reshape(-1, 9)[seen[:, 0].astype(int)]
    point = rest[9 * cameras : 9 * cameras + 3 * points].reshape(-1, 3)[seen[:, 1].astype(int)]
    angle = np.linalg.norm(camera[:, :3], axis=1, keepdims=True)
    axis = camera[:, :3] / np.maximum(angle, 1e-300)
    along = axis * np.sum(axis * point, axis=1, keepdims=True)
    rotated = (
        point * np.cos(angle) + np.cross(axis, point) * np.sin(angle) + along * (1 - np.cos(angle))
    )
    in_cam = rotated + camera[:, 3:6]
    p = -in_cam[:, :2] / in_cam[:, 2:]
    s = np.sum(p * p, axis=1, keepdims=True)
    pixel = camera[:, 6:7] * (1 + s * (camera[:, 7:8] + s * camera[:, 8:9])) * p
    return 0.5 * np.sum((pixel - seen[:, 2:]) ** 2)


def made(path, seed=1, cameras=16, points=22106, longest=8, off=1.0, outliers=0.0):
    """A problem of the size of Dubrovnik-16 (which had 83,718 observations), from nothing: cameras
    on an arc around a ball. The start is `off` times as far away as usual; a share of the
    observations are up to 50 px wrong."""
    rng = np.random.default_rng(seed)
    angle = np.linspace(0, 1.5, cameras)
    centre = np.stack([15 * np.sin(angle), 0.3 * np.sin(5 * angle), 15 * np.cos(angle)], axis=1)
    world = rng.normal(size=(points, 3)) * 2
    length = np.minimum(2 + rng.geometric(0.36, size=points) - 1, longest)
    rows = []
    for j in range(points):
        first = rng.integers(0, cameras - length[j] + 1)
        for i in range(first, first + length[j]):
            c, s = np.cos(-angle[i]), np.sin(-angle[i])
            x, y, z = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]) @ (world[j] - centre[i])
            u, v = -x / z, -y / z
            scale = 800 * (1 - 0.05 * (u * u + v * v))
            wrong = (
                rng.uniform(-50, 50, size=2) if outliers and rng.random() < outliers else (0.0, 0.0)
            )
            x, y = (
                scale * u + rng.normal() * 0.5 + wrong[0],
                scale * v + rng.normal() * 0.5 + wrong[1],
            )
            rows.append(f"{i} {j} {x:.6f} {y:.6f}")
    numbers = []
    for i in range(cameras):
        c, s = np.cos(-angle[i]), np.sin(-angle[i])
        shift = -np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]) @ centre[i]
        numbers += [0.0, -angle[i], 0.0, *shift]
        numbers[-6:] = list(np.array(numbers[-6:]) + rng.normal(size=6) * 0.005 * off)
        numbers += [810.0, 0.0, 0.0]
    numbers += list((world + rng.normal(size=world.shape) * 0.05 * off).ravel())
    path.write_text(
        f"{cameras} {points} {len(rows)}\n"
        + "\n".join(rows)
        + "\n"
        + "\n".join(f"{x:.17g}" for x in numbers)
        + "\n"
    )
    return path


def trace(command):
    """Seconds and costs, after the set-up and after every step."""
    out = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    return np.array([[float(word) for word in line.split()] for line in out.splitlines()])


def time_to(steps, cost):
    reached = steps[steps[:, 1] <= cost]
    return reached[0, 0] if len(reached) else np.inf


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("problems", nargs="*", type=pathlib.Path)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--repetitions", type=int, default=5)
    parser.add_argument("--results", type=pathlib.Path, help="where raw results go, as JSON")
    parser.add_argument(
        "--stress",
        action="store_true",
        help="made problems that start badly or have gross errors, once each",
    )
    options = parser.parse_args()
    problems = options.problems or sorted(
        (pathlib.Path(os.environ["TIEPOINT_DATA"]) / "bal").glob("problem-*.txt")
    )
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
    except (AttributeError, PermissionError):
        print("not in the real-time class: threads may share a core")
    with tempfile.TemporaryDirectory() as folder:
        folder = pathlib.Path(folder)
        ceres = folder / "ceres_bal"
        subprocess.run(
            [
                "g++",
                "-O3",
                "-march=native",
                "-std=c++17",
                "-I/usr/include/eigen3",
                str(ROOT / "bench/ceres_bal.cpp"),
                "-o",
                str(ceres),
                "-lceres",
                "-lglog",
            ],
            check=True,
        )
        if options.stress:
            options.repetitions = 1
            for number, changes in enumerate(STRESS):
                compare(
                    made(folder / f"stress-{number}.txt", seed=2 + number, **changes),
                    ceres,
                    folder,
                    options,
                    changes,
                )
            return
        made_problems = [] if options.problems else [made(folder / "made-16-22106.txt")]
        rows = [compare(problem, ceres, folder, options) for problem in problems + made_problems]
        if options.results:
            options.results.write_text(json.dumps(rows, indent=1))


def compare(problem, ceres, folder, options, changes=None):
    commands = {
        "tiepoint": [
            str(TARGET / "release/examples/bal"),
            str(problem),
            "--threads",
            str(options.threads),
            "--trace",
            "--out",
            str(folder / "tiepoint.txt"),
        ]
    }
    for solver, derivatives in CERES:
        name = f"ceres {solver} {derivatives}"
        commands[name] = [
            str(ceres),
            str(problem),
            str(options.threads),
            solver,
            str(ITERATIONS),
            str(folder / f"{name}.txt"),
            derivatives,
        ]
    runs = {name: [] for name in commands}
    for _ in range(options.repetitions):
        for name, command in commands.items():
            runs[name].append(trace(command))
    costs = {name: final_cost(folder / f"{name}.txt") for name in commands}
    for name, steps in runs.items():
        # What a program says of its own end must be what the one function finds.
        assert abs(costs[name] - steps[-1][:, 1].min()) < 1e-6 * costs[name], (
            name,
            costs[name],
            steps[-1][-1],
        )
    goal = min(cost for name, cost in costs.items() if name != "tiepoint") * (1 + WITHIN)
    if changes is not None:
        best = goal / (1 + WITHIN)
        excess = costs["tiepoint"] / best - 1
        print(
            f"{changes}: Ceres {best:.6e}, ours {costs['tiepoint']:.6e}, {excess:+.1e}"
            f" {'' if excess <= WITHIN else 'ABOVE'}"
        )
        return
    print(f"\n{problem.name}, {options.threads} threads, goal {goal:.6e}")
    print(
        f"{'':28} {'final cost':>14} {'steps':>6} {'set-up ms':>10} {'ms a step':>10}"
        f" {'ms to goal':>11}"
    )
    to_goal, row = {}, {"problem": problem.stem, "solvers": {}}
    for name, steps in runs.items():
        to_goal[name] = 1e3 * min(time_to(run, goal) for run in steps)
        setup = 1e3 * min(run[0, 0] for run in steps)
        step = 1e3 * min((run[-1, 0] - run[0, 0]) / (len(run) - 1) for run in steps)
        row["solvers"][name] = {
            "final_cost": costs[name],
            "ms_a_step": step,
            "ms_to_goal": to_goal[name],
            "runs_ms_to_goal": [1e3 * time_to(run, goal) for run in steps],
        }
        print(
            f"{name:28} {costs[name]:14.6e} {len(steps[0]) - 1:6} {setup:10.1f} {step:10.2f}"
            f" {to_goal[name]:11.1f}"
        )
    for kind in ("analytic", "automatic"):
        best = min((time, name) for name, time in to_goal.items() if name.endswith(kind))
        print(f"quickest {best[1]}: tiepoint is {best[0] / to_goal['tiepoint']:.1f} times faster")
    return row


if __name__ == "__main__":
    main()
