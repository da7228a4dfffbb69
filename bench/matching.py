#!/usr/bin/env python3
"""Nearest neighbours of OpenCV (brute force, FLANN) and tiepoint on the same descriptors, in one
run; and what preemptive matching loses.

  pip install numpy opencv-python-headless
  TIEPOINT_DATA=... python bench/matching.py [search] [large] [preempt]

search 8192 x 8192 RootSIFT descriptors of two photos: time of brute force, recall over time of the
kd-forests. large the same forests with 100,000 and 1,000,000 points (all features of three data
sets), 2,000 queries. preempt pairs of four sequences: verified pairs (fundamental matrix, 15
inliers) that the largest features alone would
         have given up.

Everything runs on one thread; times are the minimum over the repetitions. Let nothing else run
meanwhile."""

import glob, json, os, subprocess, sys, tempfile, time
import cv2, numpy as np

ROOT = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
DATA = os.environ.get("TIEPOINT_DATA") or sys.exit("TIEPOINT_DATA is not set")
REPEAT = 5
CHECKS = (8, 16, 32, 64, 128, 256, 512)
MIN_INLIERS = 15
cv2.setNumThreads(1)


def sift(path, limit=8192, scale=1.0, contrast=0.02 / 3 * 2):
    """Keypoints (x, y, sigma) and RootSIFT bytes. OpenCV's contrast threshold is COLMAP's, times
    the 3 levels, over 1.5."""
    image = cv2.imread(path, cv2.IMREAD_GRAYSCALE)
    if scale != 1.0:
        image = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    points, descriptors = cv2.SIFT_create(limit, contrastThreshold=contrast).detectAndCompute(
        image, None
    )
    if limit:
        points, descriptors = points[:limit], descriptors[:limit]
    root = np.sqrt(descriptors / np.maximum(descriptors.sum(1, keepdims=True), 1e-9))
    keypoints = np.array([(p.pt[0], p.pt[1], p.size / 2) for p in points], np.float32)
    return keypoints, np.clip(np.round(512 * root), 0, 255).astype(np.uint8)


def example(name, *arguments):
    command = [
        "cargo",
        "run",
        "--quiet",
        "--release",
        "-p",
        "tiepoint-matching",
        "--example",
        name,
        "--",
        *map(str, arguments),
    ]
    lines = subprocess.run(
        command, cwd=ROOT, check=True, stdout=subprocess.PIPE, text=True
    ).stdout.splitlines()
    return [json.loads(line) for line in lines]


def shortest(work, repeat=REPEAT):
    times = []
    for _ in range(repeat):
        start = time.perf_counter()
        result = work()
        times.append(time.perf_counter() - start)
    return min(times), result


def nearest_distances(queries, points, block=65536):
    q = queries.astype(np.float32)
    best = np.full(len(q), np.inf, np.float32)
    for start in range(0, len(points), block):
        p = points[start : start + block].astype(np.float32)
        d = (q**2).sum(1)[:, None] + (p**2).sum(1)[None] - 2 * q @ p.T
        best = np.minimum(best, d.min(1))
    return best


def compare(queries, points, trees_list):
    print(f"\n{len(queries)} queries, {len(points)} points")
    with tempfile.TemporaryDirectory() as folder:
        paths = [os.path.join(folder, name) for name in ("queries", "points")]
        for path, data in zip(paths, (queries, points)):
            data.tofile(path)
        ours = example("search", *paths)
    for row in ours:
        if row["method"] != "forest":
            print(f"  {row['method']:36} {1e3 * row['seconds']:9.1f} ms")
    truth = nearest_distances(queries, points)
    q, p = queries.astype(np.float32), points.astype(np.float32)
    if len(points) < 20000:
        seconds, _ = shortest(lambda: cv2.BFMatcher(cv2.NORM_L2).knnMatch(q, p, k=2), 1)
        print(f"  {'OpenCV brute force, one way':36} {1e3 * seconds:9.1f} ms")
    print(
        "  trees checks | FLANN us/query  recall | tiepoint us/query  recall | build FLANN,"
        " tiepoint s"
    )
    for trees in trees_list:
        flann_build, index = shortest(lambda: cv2.flann_Index(p, dict(algorithm=1, trees=trees)), 1)
        for checks in CHECKS:
            seconds, (found, _) = shortest(
                lambda: index.knnSearch(q, 2, params=dict(checks=checks))
            )
            difference = (queries.astype(np.int64) - points[found[:, 0]].astype(np.int64)) ** 2
            recall = (difference.sum(1) <= truth + 0.5).mean()
            (row,) = [
                r
                for r in ours
                if r["method"] == "forest" and (r["trees"], r["checks"]) == (trees, checks)
            ]
            print(
                f"  {trees:5} {checks:6} | {1e6 * seconds / len(q):14.1f}  {recall:.4f} |"
                f" {1e6 * row['seconds'] / len(q):17.1f}  {row['recall']:.4f} | {flann_build:.2f} "
                f" {row['build_seconds']:.2f}",
                flush=True,
            )


def images(*pattern):
    return sorted(glob.glob(os.path.join(DATA, *pattern)))


def search():
    photos = images("fountain-P11", "images", "*.jpg")
    compare(sift(photos[4])[1], sift(photos[5])[1], (1, 4, 8))


def large():
    everything = []
    for photo in (
        images("fountain-P11", "images", "*.jpg")
        + images("sceaux", "images", "*")
        + images("Herz-Jesus-P8", "images", "*.jpg")
    ):
        everything.append(sift(photo, 0, 0.7, 0.004)[1])
    everything = np.concatenate(everything)
    everything = everything[np.random.default_rng(0).permutation(len(everything))]
    queries, points = everything[:2000], everything[2000:]
    for count in (100_000, 1_000_000):
        compare(queries, points[:count], (8,))


def preempt():
    sequences = {
        "fountain-P11": (images("fountain-P11", "images", "*.jpg"), 10),
        "Herz-Jesus-P8": (images("Herz-Jesus-P8", "images", "*.jpg"), 7),
        "sceaux": (images("sceaux", "images", "*"), 10),
        "temple_ring": (images("temple_ring", "*.png"), 46),
        "kitti04 left": (images("kitti04", "images", "left", "*.png"), 20),
    }
    for name, (photos, reach) in sequences.items():
        photos = [p for p in photos if cv2.haveImageReader(p)]
        with tempfile.TemporaryDirectory() as folder:
            stems, keypoints = [], []
            for k, photo in enumerate(photos):
                points, descriptors = sift(photo)
                stems.append(os.path.join(folder, str(k)))
                descriptors.tofile(stems[-1] + ".u8")
                points[:, 2].tofile(stems[-1] + ".f32")
                keypoints.append(points[:, :2])
            rows = example("preempt", reach, *stems)
        for row in rows:
            a, b = keypoints[row["i"]][row["a"]], keypoints[row["j"]][row["b"]]
            row["inliers"] = 0
            if len(a) >= MIN_INLIERS:
                cv2.setRNGSeed(0)
                _, mask = cv2.findFundamentalMat(a, b, cv2.USAC_DEFAULT, 4.0, 0.999, 10000)
                row["inliers"] = 0 if mask is None else int(mask.sum())
        full, hasty = (np.mean([row[key] for row in rows]) for key in ("full_ms", "preempt_ms"))
        verified = [row for row in rows if row["inliers"] >= MIN_INLIERS]
        print(
            f"\n{name}: {len(rows)} pairs, {len(verified)} verified; {full:.2f} ms in full,"
            f" {hasty:.3f} ms on 512 features"
        )
        print("  leading  at least | verified pairs lost (their inliers) | other pairs given up")
        for k, leading in enumerate(rows[0]["leading"]):
            for least in (1, 2, 3, 4, 6, 8):
                lost = sorted(row["inliers"] for row in verified if row["counts"][k] < least)
                others = [row["counts"][k] < least for row in rows if row["inliers"] < MIN_INLIERS]
                print(
                    f"  {leading:7} {least:9} | {len(lost):4} {lost[-6:]} | {sum(others)} of"
                    f" {len(others)}",
                    flush=True,
                )


if __name__ == "__main__":
    for part in sys.argv[1:] or ("search", "large", "preempt"):
        {"search": search, "large": large, "preempt": preempt}[part]()
