#!/usr/bin/env python3
"""Robust estimators of tiepoint-geometry beside PoseLib's and OpenCV's, on the same
correspondences.

    pip install numpy opencv-python-headless poselib
    cargo build --release -p tiepoint-geometry --example estimate
    TIEPOINT_DATA=... python bench/geometry.py [--pairs 20] [--repetitions 3]

Photos: SIFT matches (ratio 0.85) between the photos of fountain-P11 and Herz-Jesus-P8, poses by
laser scan; with synthetic data besides, whose truth is exact and whose share of outliers is chosen.
All get the same threshold, the same least and most iterations and the same confidence. Time is the
least of the repetitions, on one thread. AUC is the area under the recall curve of max(rotation
error, direction error) up to 1, 5 and 10 degrees."""

import argparse
import itertools
import os
import pathlib
import subprocess
import time

import cv2
import numpy as np
import poselib
from program import TARGET, degrees

CONFIDENCE, MIN_ITERATIONS, MAX_ITERATIONS, SEED = 0.9999, 100, 10000, 1


# ---- problems ------------------------------------------------------------------------------------


class Problem:
    """One estimation: kind, data, calibration, truth."""

    def __init__(self, kind, a, b, max_error, k=None, pose=None, clean=None):
        self.kind, self.a, self.b, self.max_error = kind, a, b, max_error
        self.k, self.pose, self.clean = k, pose, clean


def read_strecha(path):
    """K, and cam_from_world as (R, t)."""
    numbers = [[float(v) for v in line.split()] for line in path.read_text().splitlines()]
    k, rotation, centre = np.array(numbers[0:3]), np.array(numbers[4:7]).T, np.array(numbers[7])
    return k, (rotation, -rotation @ centre)


def photo_pairs(folder, limit):
    """Pixels (top-left pixel centre at 0.5), K and relative pose of pairs of photos with enough
    matches."""
    sift = cv2.SIFT_create(nfeatures=4000)
    photos = []
    for path in sorted((folder / "images").glob("*.jpg")):
        k, pose = read_strecha(folder / "cameras" / (path.name + ".camera"))
        image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        keypoints, descriptors = sift.detectAndCompute(image, None)
        k[:2, 2] += 0.5
        photos.append((k, pose, np.array([p.pt for p in keypoints]) + 0.5, descriptors))
    matcher = cv2.BFMatcher()
    pairs = []
    for (k, (r1, t1), x1, d1), (_, (r2, t2), x2, d2) in itertools.combinations(photos, 2):
        matches = [m for m, n in matcher.knnMatch(d1, d2, k=2) if m.distance < 0.85 * n.distance]
        if len(matches) < 50:
            continue
        r = r2 @ r1.T
        a = x1[[m.queryIdx for m in matches]]
        b = x2[[m.trainIdx for m in matches]]
        pairs.append((a, b, k, (r, t2 - r @ t1)))
        if len(pairs) == limit:
            break
    return pairs


def rotation(axis_angle):
    return cv2.Rodrigues(np.asarray(axis_angle, float))[0]


def synthetic_pair(rng, outliers, count=1000, noise=1.0):
    k = np.array([[1000, 0, 800], [0, 1000, 600], [0, 0, 1.0]])
    depth = rng.uniform(4, 12, count)
    points = np.stack(
        [rng.uniform(-0.8, 0.8, count) * depth, rng.uniform(-0.6, 0.6, count) * depth, depth], 1
    )
    r, t = rotation(rng.uniform(-0.2, 0.2, 3)), rng.normal(size=3)
    t /= np.linalg.norm(t)
    image = lambda p: p[:, :2] / p[:, 2:] * 1000 + [800, 600]
    clean = image(points), image(points @ r.T + t)
    a, b = (x + rng.normal(size=x.shape) * noise for x in clean)
    bad = int(outliers * count)
    b[:bad] = rng.uniform([0, 0], [1600, 1200], (bad, 2))
    order = rng.permutation(count)
    clean = tuple(x[bad:] for x in clean)
    return a[order], b[order], points[order], k, (r, t), clean


def problem_sets(data, limit):
    sets = {}
    if data:
        for name in ("fountain-P11", "Herz-Jesus-P8"):
            pairs = photo_pairs(pathlib.Path(data) / name, limit)
            for kind in ("relative_pose", "fundamental"):
                sets[f"{name} {kind}"] = [
                    Problem(kind, a, b, 2.0, k, pose) for a, b, k, pose in pairs
                ]
    for outliers in (0.3, 0.6):
        rng = np.random.default_rng(3)
        made = [synthetic_pair(rng, outliers) for _ in range(limit)]
        name = f"synthetic {outliers:.0%} outliers"
        for kind in ("relative_pose", "fundamental"):
            sets[f"{name} {kind}"] = [
                Problem(kind, a, b, 4.0, k, p, c) for a, b, _, k, p, c in made
            ]
        sets[f"{name} absolute_pose"] = [
            Problem("absolute_pose", b, x, 8.0, k, p) for _, b, x, k, p, _ in made
        ]
    return sets


# ---- estimators: problem -> seconds, inliers, (R, t) or matrix -----------------------------------


def tiepoint(problems, repetitions):
    text = []
    for p in problems:
        camera = f" PINHOLE {p.k[0, 0]!r} {p.k[1, 1]!r} {p.k[0, 2]!r} {p.k[1, 2]!r}".replace(
            "np.float64(", ""
        ).replace(")", "")
        cameras = camera * {"absolute_pose": 1, "relative_pose": 2}.get(p.kind, 0)
        text.append(
            f"{p.kind} {p.max_error} {MIN_ITERATIONS} {MAX_ITERATIONS} {SEED} {len(p.a)}"
            f" {repetitions}{cameras}"
        )
        text += [" ".join(f"{v:.17g}" for v in row) for row in np.hstack([p.a, p.b])]
    run = subprocess.run(
        [TARGET / "release/examples/estimate"],
        input="\n".join(text) + "\n",
        text=True,
        capture_output=True,
        check=True,
    )
    for p, line in zip(problems, run.stdout.splitlines()):
        words = line.split()
        if words[1] == "none":
            yield float(words[0]), 0, None
            continue
        model = np.array([float(v) for v in words[4:]])
        if p.kind.endswith("pose"):
            w, x, y, z = model[:4]
            r = np.array(
                [
                    [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                    [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                    [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
                ]
            )
            yield float(words[0]), int(words[1]), (r, model[4:])
        else:
            yield float(words[0]), int(words[1]), model.reshape(3, 3)


def timed(repetitions, f):
    best = np.inf
    for _ in range(repetitions):
        start = time.perf_counter()
        result = f()
        best = min(best, time.perf_counter() - start)
    return best, result


def with_poselib(problems, repetitions):
    for p in problems:
        camera = {
            "model": "PINHOLE",
            "width": 4000,
            "height": 4000,
            "params": [p.k[0, 0], p.k[1, 1], p.k[0, 2], p.k[1, 2]],
        }
        options = {
            "max_iterations": MAX_ITERATIONS,
            "min_iterations": MIN_ITERATIONS,
            "success_prob": CONFIDENCE,
            "max_error": p.max_error,
            "max_epipolar_error": p.max_error,
            "max_reproj_error": p.max_error,
            "seed": SEED,
        }
        if p.kind == "absolute_pose":
            call = lambda: poselib.estimate_absolute_pose(p.a, p.b, camera, options, {})
        elif p.kind == "relative_pose":
            call = lambda: poselib.estimate_relative_pose(p.a, p.b, camera, camera, options, {})
        else:
            call = lambda: poselib.estimate_fundamental(p.a, p.b, options, {})
        seconds, (model, info) = timed(repetitions, call)
        if p.kind != "fundamental":
            model = model.R, model.t
        yield seconds, info["num_inliers"], model


def with_opencv(problems, repetitions):
    for p in problems:
        if p.kind == "absolute_pose":

            def call():
                _, r, t, inliers = cv2.solvePnPRansac(
                    p.b,
                    p.a,
                    p.k,
                    None,
                    iterationsCount=MAX_ITERATIONS,
                    reprojectionError=p.max_error,
                    confidence=CONFIDENCE,
                )
                return (rotation(r.ravel()), t.ravel()), 0 if inliers is None else len(inliers)

        elif p.kind == "relative_pose":

            def call():
                e, mask = cv2.findEssentialMat(
                    p.a, p.b, p.k, cv2.USAC_ACCURATE, CONFIDENCE, p.max_error
                )
                _, r, t, _ = cv2.recoverPose(e[:3], p.a, p.b, p.k, mask=mask.copy())
                return (r, t.ravel()), int(mask.sum())

        else:

            def call():
                f, mask = cv2.findFundamentalMat(
                    p.a, p.b, cv2.USAC_ACCURATE, p.max_error, CONFIDENCE, MAX_ITERATIONS
                )
                return f, int(mask.sum())

        seconds, (model, inliers) = timed(repetitions, call)
        yield seconds, inliers, model


# ---- judging -------------------------------------------------------------------------------------


def pose_error(p, model):
    """Degrees; for a known scale the translation counts by its length, of one."""
    if model is None:
        return 180.0
    if p.kind == "fundamental":
        e = p.k.T @ model @ p.k
        u, _, vt = np.linalg.svd(e)
        w = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1.0]])
        candidates = []
        for m in (w, w.T):
            r = u @ m @ vt
            r *= np.sign(np.linalg.det(r))
            candidates += [(r, u[:, 2]), (r, -u[:, 2])]
        return min(
            pose_error(Problem("relative_pose", None, None, 0, p.k, p.pose), c) for c in candidates
        )
    (r, t), (true_r, true_t) = model, p.pose
    angle = degrees((np.trace(r.T @ true_r) - 1) / 2)
    if p.kind == "absolute_pose":
        return max(angle, np.degrees(np.linalg.norm(t - true_t)))
    return max(angle, degrees(t @ true_t / np.linalg.norm(t) / np.linalg.norm(true_t)))


def auc(errors, limit):
    errors = np.sort(errors)
    return np.mean(np.maximum(0, 1 - errors / limit))


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--pairs", type=int, default=55)
    parser.add_argument("--repetitions", type=int, default=3)
    parser.add_argument("--only", default="")
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    data = os.environ.get("TIEPOINT_DATA")
    if not data:
        print("SKIPPED photos: TIEPOINT_DATA is not set")
    print(f"{'':44}{'':10}  median°  AUC@1  @5    @10    inliers  ms (mean)")
    for name, problems in problem_sets(data, arguments.pairs).items():
        if arguments.only not in name:
            continue
        for peer in (tiepoint, with_poselib, with_opencv):
            results = list(peer(problems, arguments.repetitions))
            errors = np.array([pose_error(p, model) for p, (_, _, model) in zip(problems, results)])
            scores = "  ".join(f"{100 * auc(errors, limit):5.1f}" for limit in (1, 5, 10))
            print(
                f"{name:44}{peer.__name__:14}{np.median(errors):7.3f}  {scores} "
                f" {np.mean([n for _, n, _ in results]):7.1f} "
                f" {1e3 * np.mean([s for s, _, _ in results]):8.3f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
