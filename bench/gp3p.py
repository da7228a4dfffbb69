#!/usr/bin/env python3
"""PoseLib's gp3p on the problems of the benchmark of ours (bench/criterion, `geometry`, `gp3p`).

    pip install numpy poselib
    python bench/gp3p.py [--problems 20000]

Points are in the 90 degree field of view of the world frame at depths of 1 to 10; the rig is at a
distance of 1, turned by up to 1 radian; each ray has a centre of its own at up to 1 from the origin
of the rig. Found is the share of problems whose true pose is among the solutions to 1e-6 (angle
plus translation), as there. The time includes the call from Python, and that of an empty call of
the same kind (a pose of three rays that are degenerate) is printed beside it."""

import argparse
import time

import numpy as np
import poselib


def direction(rng):
    vector = rng.normal(size=3)
    return vector / np.linalg.norm(vector)


def rotation(axis_angle):
    """Rodrigues' formula."""
    angle = np.linalg.norm(axis_angle)
    x, y, z = axis_angle / angle
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k


def problem(rng):
    while True:
        depths = rng.uniform(1, 10, 3)
        points = np.column_stack([rng.uniform(-1, 1, (3, 2)) * depths[:, None], depths])
        r, t = rotation(direction(rng) * rng.uniform()), direction(rng)
        in_rig = points @ r.T + t
        if (in_rig[:, 2] > 0.1).all():
            break
    centres = np.array([direction(rng) * rng.uniform() for _ in range(3)])
    rays = in_rig - centres
    rays /= np.linalg.norm(rays, axis=1)[:, None]
    return list(centres), list(rays), list(points), r, t


def seconds(problems):
    best = np.inf
    for _ in range(5):
        start = time.perf_counter()
        for centres, rays, points, *_ in problems:
            poselib.gp3p(centres, rays, points)
        best = min(best, time.perf_counter() - start)
    return best / len(problems)


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--problems", type=int, default=20000)
    arguments = parser.parse_args()
    rng = np.random.default_rng(1)
    problems = [problem(rng) for _ in range(arguments.problems)]
    found = solutions = 0
    for centres, rays, points, r, t in problems:
        poses = poselib.gp3p(centres, rays, points)
        solutions += len(poses)
        errors = []
        for pose in poses:
            cosine = (np.trace(pose.R.T @ r) - 1) / 2
            # The angle by the sine where the cosine is flat.
            sine = np.linalg.norm(pose.R - r) / np.sqrt(8)
            angle = 2 * np.arcsin(min(1, sine)) if cosine > 0 else np.arccos(max(-1, cosine))
            errors.append(angle + np.linalg.norm(pose.t - t))
        found += min(errors, default=np.inf) < 1e-6
    empty = [([np.zeros(3)] * 3, [np.array([0.0, 0.0, 1.0])] * 3, [np.zeros(3)] * 3)]
    call_us, empty_us = 1e6 * seconds(problems[:2000]), 1e6 * seconds(empty * 2000)
    print(
        f"PoseLib gp3p: truth found {100 * found / len(problems):.4f} %, "
        f"{solutions / len(problems):.2f} solutions, {call_us:.2f} us a call "
        f"(degenerate: {empty_us:.2f} us)"
    )


if __name__ == "__main__":
    main()
