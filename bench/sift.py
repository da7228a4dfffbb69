#!/usr/bin/env python3
"""SIFT of OpenCV, COLMAP and tiepoint on the same pixels, in one run: time, agreement,
repeatability, matching.

  pip install numpy opencv-python-headless pycolmap
  TIEPOINT_DATA=... python bench/sift.py [quality] [time] [files] [--threads 2] [--repeat 3]

Decoding is excluded at first: OpenCV gets arrays, COLMAP gets bitmaps, tiepoint gets PGM files that
it reads before its clock starts. Each gets a pool of as many threads as asked for and one image per
thread; times are wall seconds per image, the minimum over the repetitions. Then from files to
features: OpenCV reads within its threads, COLMAP and tiepoint run their whole first stage into a
database (the program `tiepoint`, built in release mode)."""

import argparse, concurrent.futures, glob, os, re, subprocess, sys, tempfile, threading, time
import cv2, numpy as np, pycolmap
from program import ROOT, TARGET, program_of

DATA = os.environ.get("TIEPOINT_DATA") or sys.exit("TIEPOINT_DATA is not set")
MAX_FEATURES = 8192
ALL = 10**6


def grey(path):
    return cv2.imread(os.path.join(DATA, path), cv2.IMREAD_GRAYSCALE)


def pooled(work, images, threads):
    with concurrent.futures.ThreadPoolExecutor(threads) as pool:
        start = time.perf_counter()
        results = list(pool.map(work, images))
        return results, (time.perf_counter() - start) / len(images)


class OpenCV:
    """Keypoints in our conventions: (0.5, 0.5) is the centre of the first pixel; sigma is half of
    `size`."""

    def __call__(self, images, limit, threads):
        cv2.setNumThreads(1)

        def work(image):
            sift = cv2.SIFT_create(nfeatures=0 if limit == ALL else limit)
            points, descriptors = sift.detectAndCompute(image, None)
            keypoints = np.array(
                [(p.pt[0] + 0.5, p.pt[1] + 0.5, p.size / 2, np.deg2rad(p.angle)) for p in points],
                np.float32,
            )
            d = descriptors / np.maximum(descriptors.sum(1, keepdims=True), 1e-9)
            return keypoints, np.sqrt(d) * 512

        return pooled(work, images, threads)


class Colmap:
    def __init__(self, dsp=False):
        self.dsp = dsp

    def __call__(self, images, limit, threads):
        options = pycolmap.FeatureExtractionOptions()
        options.sift.max_num_features = limit
        options.sift.domain_size_pooling = self.dsp
        options.num_threads = 1
        extractors = threading.local()

        def work(image):
            if not hasattr(extractors, "one"):
                extractors.one = pycolmap.FeatureExtractor.create(options, pycolmap.Device.cpu)
            return extractors.one.extract_from_uint8_array(image)

        results, seconds = pooled(work, images, threads)
        return [self.arrays(k, d) for k, d in results], seconds

    @staticmethod
    def arrays(keypoints, descriptors):
        rows = [(k.x, k.y, k.compute_scale(), k.compute_orientation()) for k in keypoints]
        return np.array(rows, np.float32), np.asarray(
            descriptors.data if hasattr(descriptors, "data") else descriptors, np.float32
        )


class Tiepoint:
    def __init__(self, *flags):
        self.flags = flags
        subprocess.run(
            [
                "cargo",
                "build",
                "--quiet",
                "--release",
                "-p",
                "tiepoint-features",
                "--example",
                "extract_pgm",
            ],
            cwd=ROOT,
            check=True,
        )
        self.program = str(TARGET / "release/examples/extract_pgm")

    def __call__(self, images, limit, threads):
        with tempfile.TemporaryDirectory() as folder:
            paths = [os.path.join(folder, f"{i}.pgm") for i in range(len(images))]
            for path, image in zip(paths, images):
                with open(path, "wb") as file:
                    file.write(b"P5\n%d %d\n255\n" % image.shape[::-1] + image.tobytes())
            run = [
                self.program,
                "--threads",
                str(threads),
                "--max",
                str(limit),
                *self.flags,
                *paths,
            ]
            seconds = float(subprocess.run(run, check=True, capture_output=True, text=True).stdout)
            return [self.read(p.replace(".pgm", ".features")) for p in paths], seconds

    @staticmethod
    def read(path):
        data = open(path, "rb").read()
        n = int.from_bytes(data[:4], "little")
        keypoints = np.frombuffer(data, np.float32, 4 * n, 4).reshape(n, 4)
        return keypoints, np.frombuffer(data, np.uint8, 128 * n, 4 + 16 * n).reshape(n, 128).astype(
            np.float32
        )


def from_files(folder, threads):
    """Seconds an image from files to features, for each program."""
    paths = sorted(glob.glob(os.path.join(folder, "*")))
    seconds = {}
    cv2.setNumThreads(1)
    work = lambda path: cv2.SIFT_create(nfeatures=MAX_FEATURES).detectAndCompute(
        cv2.imread(path, cv2.IMREAD_GRAYSCALE), None
    )
    _, seconds["OpenCV"] = pooled(work, paths, threads)
    options = pycolmap.FeatureExtractionOptions(use_gpu=False, num_threads=threads)
    options.sift.max_num_features = MAX_FEATURES
    with tempfile.TemporaryDirectory() as scratch:
        start = time.perf_counter()
        pycolmap.extract_features(
            os.path.join(scratch, "database.db"), folder, extraction_options=options
        )
        seconds["COLMAP"] = (time.perf_counter() - start) / len(paths)
    program = program_of()
    for _ in range(3):
        with tempfile.TemporaryDirectory() as scratch:
            start = time.perf_counter()
            subprocess.run(
                [
                    program,
                    "features",
                    folder,
                    "-o",
                    os.path.join(scratch, "ws"),
                    "--threads",
                    str(threads),
                ],
                check=True,
                capture_output=True,
            )
            seconds["tiepoint"] = min(
                seconds.get("tiepoint", np.inf), (time.perf_counter() - start) / len(paths)
            )
    return seconds


def nearest_two(a, b):
    """For each row of a: its nearest row of b, and the squared distances to it and to the next
    one."""
    index, first, second = [], [], []
    for part in np.array_split(a, max(1, len(a) // 1000)):
        d = (part**2).sum(1)[:, None] + (b**2).sum(1)[None] - 2 * part @ b.T
        two = np.argpartition(d, 1, axis=1)[:, :2]
        values = np.take_along_axis(d, two, 1)
        order = np.argsort(values, axis=1)
        index.append(np.take_along_axis(two, order, 1)[:, 0])
        values = np.maximum(np.take_along_axis(values, order, 1), 0)
        first.append(values[:, 0])
        second.append(values[:, 1])
    return np.concatenate(index), np.concatenate(first), np.concatenate(second)


def agreement(ours, theirs):
    """How many of their features are among ours, and how well they agree."""
    (k, d), (kt, dt) = ours, theirs
    found, px, scale, angle, distance = 0, [], [], [], []
    order = np.argsort(k[:, 0])
    k, d = k[order], d[order]
    for q, dq in zip(kt, dt):
        lo, hi = np.searchsorted(k[:, 0], [q[0] - 1, q[0] + 1])
        near = k[lo:hi]
        turn = np.abs((near[:, 3] - q[3] + np.pi) % (2 * np.pi) - np.pi)
        offset = np.hypot(*(near[:, :2] - q[:2]).T)
        ratio = np.abs(np.log2(near[:, 2] / q[2]))
        ok = (offset < 1) & (ratio < 0.25) & (turn < 0.2)
        if not ok.any():
            continue
        found += 1
        i = np.argmin(np.where(ok, offset + turn, np.inf))
        px.append(offset[i])
        scale.append(ratio[i])
        angle.append(turn[i])
        distance.append(np.linalg.norm(d[lo + i] - dq))
    return (
        f"{found}/{len(kt)} = {found / len(kt):.3f} found; median offset {np.median(px):.4f} px,"
        f" scale 2^{np.median(scale):.4f}, angle {np.median(angle):.4f} rad, descriptor"
        f" {np.median(distance):.1f} of 512 (90 %: {np.quantile(distance, .9):.1f})"
    )


def quality(a, b, h, shape, pixels=3.0):
    """Repeatability and matching score between two images related by a homography (in our pixel
    convention)."""

    def project(h, x):
        p = np.c_[x, np.ones(len(x))] @ h.T
        return p[:, :2] / p[:, 2:]

    def inside(x):
        return (x[:, 0] > 0) & (x[:, 1] > 0) & (x[:, 0] < shape[1]) & (x[:, 1] < shape[0])

    (ka, da), (kb, db) = a, b
    pa, pb = project(h, ka[:, :2]), project(np.linalg.inv(h), kb[:, :2])
    sa, sb = inside(pa), inside(pb)
    ka, da, pa, kb, db = ka[sa], da[sa], pa[sa], kb[sb], db[sb]
    unique = lambda x: np.unique(x.round(3), axis=0)
    ua, ub = unique(pa), unique(kb[:, :2])
    i, dab, _ = nearest_two(ua, ub)
    j, _, _ = nearest_two(ub, ua)
    repeated = ((dab < pixels**2) & (j[i] == np.arange(len(ua)))).sum() / min(len(ua), len(ub))
    i, first, second = nearest_two(da, db)
    j, _, _ = nearest_two(db, da)
    good = (first < 0.8**2 * second) & (j[i] == np.arange(len(da)))
    error = np.hypot(*(pa - kb[i, :2]).T)
    correct = good & (error < pixels)
    return (
        f"{len(ka):6d} {len(kb):6d} features, repeatability {repeated:.3f}, {good.sum():5d}"
        f" matches, {correct.sum():5d} correct (precision {correct.sum() / max(1, good.sum()):.3f},"
        f" score {correct.sum() / min(len(ka), len(kb)):.4f}, median"
        f" {np.median(error[correct]):.3f} px)"
    )


def compare_quality(programs):
    text = open(os.path.join(DATA, "vgg_homography/H1to3p.xml")).read()
    h = np.array(re.search(r"<data>(.*?)</data>", text, re.S)[1].split(), float).reshape(3, 3)
    shift = np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1]])
    h = shift @ h @ np.linalg.inv(shift)
    graf = [grey("vgg_homography/graf1.png"), grey("vgg_homography/graf3.png")]
    print("\ngraf 1-3")
    features = {}
    pooling = {"COLMAP DSP": Colmap(dsp=True), "tiepoint DSP": Tiepoint("--dsp")}
    for name, program in {**programs, **pooling}.items():
        for limit in (ALL, 2000):
            (a, b), _ = program(graf, limit, 1)
            features[name, limit] = a
            print(
                f"  {name:20s} {'all' if limit == ALL else limit:>5}"
                f" {quality(a, b, h, graf[1].shape)}"
            )
    for peer in ("COLMAP", "OpenCV"):
        print(
            f"  tiepoint has {peer}'s: {agreement(features['tiepoint', ALL], features[peer, ALL])}"
        )


def compare_time(programs, args):
    for scene in args.scenes:
        paths = sorted(glob.glob(os.path.join(DATA, scene, "images", "*")))
        images = [grey(p) for p in paths]
        print(
            f"\n{scene}: {len(images)} images of {images[0].shape[1]}x{images[0].shape[0]},"
            f" {MAX_FEATURES} features, {args.threads} threads"
        )
        ours = None
        for name, program in reversed(programs.items()):
            best, results = np.inf, None
            for _ in range(args.repeat if "tiepoint" in name else 1):
                results, seconds = program(images, MAX_FEATURES, args.threads)
                best = min(best, seconds)
            if name == "tiepoint":
                ours = best
            ratio = f", {best / ours:.1f} x tiepoint" if ours else ""
            print(
                f"  {name:20s} {best:.3f} s an image, {np.mean([len(k) for k, _ in results]):.0f}"
                f" features{ratio}"
            )
        a = programs["tiepoint"](images[:1], ALL, 1)[0][0]
        b = programs["COLMAP"](images[:1], ALL, 1)[0][0]
        print(f"  tiepoint has COLMAP's (first image, no limit): {agreement(a, b)}")


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("--scenes", nargs="*", default=["fountain-P11", "sceaux"])
    parser.add_argument("parts", nargs="*", default=["quality", "time", "files"])
    args = parser.parse_args()
    pycolmap.logging.minloglevel = 2
    programs = {
        "OpenCV": OpenCV(),
        "COLMAP": Colmap(),
        "tiepoint": Tiepoint(),
        "tiepoint exact limit": Tiepoint("--exact"),
    }
    print(f"OpenCV {cv2.__version__}, COLMAP {pycolmap.__version__}; load {os.getloadavg()[0]:.1f}")
    if "quality" in args.parts:
        compare_quality(programs)
    if "time" in args.parts:
        compare_time(programs, args)
    if "files" in args.parts:
        for scene in args.scenes:
            seconds = from_files(os.path.join(DATA, scene, "images"), args.threads)
            print(
                f"{scene}, from files to features: "
                + ", ".join(f"{name} {s:.3f} s an image" for name, s in seconds.items())
            )


if __name__ == "__main__":
    main()
