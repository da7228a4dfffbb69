#!/usr/bin/env python3
"""COLMAP and tiepoint on the same photos in one run: wall time, accuracy against truth,
observations.

  pip install numpy pycolmap==4.2.1
  cargo build --release
  TIEPOINT_DATA=... python bench/colmap.py                     every data set, one seed
  TIEPOINT_DATA=... python bench/colmap.py fountain-P11 --calibration known --seeds 5 \\
      --only tiepoint
  TIEPOINT_DATA=... python bench/colmap.py sceaux --check
      (pycolmap opens what we wrote and maps from our matches)

Both run on the CPU with the same number of threads, from photos to a model on disk, each in a
process of its own. COLMAP has its defaults (SIFT, exhaustive matching or the same list of pairs as
ours, incremental mapper), but one camera a folder as ours. Truth is compared after a similarity
(Umeyama 1991): the mean distance of camera centres, and for kitti04 the root mean square (ATE) over
the left camera. Without known intrinsics COLMAP maps once more with the principal point refined, as
ours is. Results go to bench/results/colmap-*.json, or where --results says."""

import argparse
import contextlib
import datetime
import json
import os
import platform
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pycolmap
from program import ROOT, kitti_intrinsics, program_of

MODEL_TOLERANCE_PX = 1e-6  # both programs compute the same sum of distances, in double precision


class Dataset:
    """Photos, truth and how to run them; `known` is fx, fy, cx, cy with (0.5, 0.5) the centre of
    the first pixel."""

    def __init__(self, folder, known=None, truth=None, reach=None, uncalibrated=True):
        self.images = folder / "images"
        self.known, self.truth, self.reach, self.uncalibrated = known, truth, reach, uncalibrated
        files = (p for p in self.images.rglob("*") if p.suffix.lower() in (".jpg", ".png"))
        self.names = sorted(p.relative_to(self.images).as_posix() for p in files)

    def pairs(self):
        """The sequential pairs that tiepoint matches: neighbours up to `reach`, within and across
        cameras."""
        cameras = {}
        for name in self.names:
            cameras.setdefault(name.split("/")[0], []).append(name)
        pairs = set()
        for one in cameras.values():
            for other in cameras.values():
                for i, a in enumerate(one):
                    near = other[max(i - self.reach, 0) : i + self.reach + 1]
                    pairs.update((min(a, b), max(a, b)) for b in near if a != b)
        return sorted(pairs)


def matrix_k(path):
    k = np.loadtxt(path)
    return k[0, 0], k[1, 1], k[0, 2], k[1, 2]


def strecha_centres(folder):
    """Camera centres by image name: the line after the rotation of NAME.camera."""
    return {
        p.name.removesuffix(".camera"): np.loadtxt(p.open().readlines()[7:8])
        for p in sorted(folder.glob("*.camera"))
    }


def kitti_centres(path, prefix):
    poses = np.loadtxt(path).reshape(-1, 3, 4)
    return {f"{prefix}/{i:06d}.png": pose[:, 3] for i, pose in enumerate(poses)}


def load(name, data):
    folder = data / name
    if name in ("fountain-P11", "Herz-Jesus-P8"):
        return Dataset(folder, matrix_k(folder / "K.txt"), strecha_centres(folder / "cameras"))
    if name == "sceaux":
        return Dataset(folder, matrix_k(folder / "K.txt"))
    known, truth = kitti_intrinsics(folder), kitti_centres(folder / "poses.txt", "left")
    return Dataset(folder, known, truth, reach=10, uncalibrated=False)


DATASETS = ["fountain-P11", "Herz-Jesus-P8", "sceaux", "kitti04"]


def umeyama(source, target):
    """Scale, rotation and translation that bring `source` (n x 3) closest to `target` in the
    least-squares sense."""
    mean_s, mean_t = source.mean(0), target.mean(0)
    s, t = source - mean_s, target - mean_t
    u, d, vt = np.linalg.svd(t.T @ s / len(s))
    sign = np.diag([1, 1, np.sign(np.linalg.det(u @ vt))])
    rotation = u @ sign @ vt
    scale = np.trace(np.diag(d) @ sign) / s.var(0).sum()
    return scale, rotation, mean_t - scale * rotation @ mean_s


def measure(model, dataset):
    """What a model is worth."""
    images = [image for image in model.images.values() if image.has_pose]
    observations = model.compute_num_observations()
    out = {
        "registered": len(images),
        "images": len(dataset.names),
        "points": model.num_points3D(),
        "observations": observations,
        "mean_track_length": model.compute_mean_track_length(),
        "mean_reprojection_error_px": model.compute_mean_reprojection_error(),
        "focal_px": [camera.mean_focal_length() for camera in model.cameras.values()],
    }
    if dataset.truth:
        found = [image for image in images if image.name in dataset.truth]
        if len(found) >= 3:
            centres = np.array([image.projection_center() for image in found])
            truth = np.array([dataset.truth[image.name] for image in found])
            scale, rotation, translation = umeyama(centres, truth)
            errors = np.linalg.norm(scale * centres @ rotation.T + translation - truth, axis=1)
            out["compared"] = len(found)
            out["mean_centre_error_mm"] = 1e3 * errors.mean()
            out["ate_cm"] = 1e2 * np.sqrt((errors**2).mean())
    return out


def largest(models):
    return max(models, key=lambda model: model.num_reg_images(), default=None)


def run_colmap(work, images, known, pairs, threads, seed):
    """Runs in a process of its own: extraction, matching, mapping. Returns the seconds of each."""
    seconds, start = {}, time.perf_counter()

    def lap(stage):
        nonlocal start
        seconds[stage] = time.perf_counter() - start
        start = time.perf_counter()

    pycolmap.set_random_seed(seed)
    database, cpu = work / "database.db", pycolmap.Device.cpu
    reader, extraction = pycolmap.ImageReaderOptions(), pycolmap.FeatureExtractionOptions()
    extraction.num_threads = threads
    if known:
        reader.camera_model, reader.camera_params = "PINHOLE", ",".join(
            map(repr, map(float, known))
        )
    pycolmap.extract_features(
        database,
        images,
        camera_mode=pycolmap.CameraMode.PER_FOLDER,
        reader_options=reader,
        extraction_options=extraction,
        device=cpu,
    )
    lap("features")
    matching = pycolmap.FeatureMatchingOptions()
    matching.num_threads = threads
    if pairs:
        (work / "pairs.txt").write_text("".join(f"{a} {b}\n" for a, b in pairs))
        pairing = pycolmap.ImportedPairingOptions()
        pairing.match_list_path = work / "pairs.txt"
        pycolmap.match_image_pairs(database, matching, pairing, device=cpu)
    else:
        pycolmap.match_exhaustive(database, matching, device=cpu)
    lap("match")
    map_database(database, images, work / "sparse", known, threads, seed)
    lap("map")
    if not known:
        # The freedom that ours has: the principal point is refined too. Only the default is timed.
        map_database(database, images, work / "equal", known, threads, seed, principal_point=True)
    return seconds


def map_database(
    database, images, sparse, known, threads, seed, principal_point=False, initial_angle_deg=16.0
):
    mapping = pycolmap.IncrementalPipelineOptions()
    mapping.mapper.init_min_tri_angle = initial_angle_deg
    mapping.num_threads, mapping.random_seed = threads, seed
    mapping.ba_refine_principal_point = principal_point
    if known:
        mapping.ba_refine_focal_length = mapping.ba_refine_extra_params = False
        mapping.mapper.abs_pose_refine_focal_length = (
            mapping.mapper.abs_pose_refine_extra_params
        ) = False
    sparse.mkdir(parents=True, exist_ok=True)
    return pycolmap.incremental_mapping(database, images, sparse, mapping)


def make_rig(database, model=None, cameras=("left", "right"), calibration=None):
    """One rig of all cameras, a folder each; its calibration is given (cam_from_rig of each
    camera), the model's, or unknown."""
    sensors = [
        pycolmap.RigConfigCamera(image_prefix=f"{name}/", ref_sensor=k == 0)
        for k, name in enumerate(cameras)
    ]
    for sensor, name in list(zip(sensors, cameras))[1:] if calibration else []:
        sensor.cam_from_rig = calibration[name]
    with pycolmap.Database.open(database) as opened:
        pycolmap.apply_rig_config(
            [pycolmap.RigConfig(cameras=sensors)], opened, *([model] if model else [])
        )


def map_globally(database, images, sparse, known, threads, seed):
    """COLMAP's global mapper, with the rig that the database has."""
    options = pycolmap.GlobalPipelineOptions()
    options.num_threads, options.random_seed = threads, seed
    if known:
        adjustment = options.mapper.bundle_adjustment
        adjustment.refine_focal_length = adjustment.refine_principal_point = (
            adjustment.refine_extra_params
        ) = False
    sparse.mkdir(parents=True, exist_ok=True)
    return pycolmap.global_mapping(database, images, sparse, options)


def colmap_in_process(work, dataset, known, arguments, seed):
    """Its wall seconds as a user would see them, the start of the process left out."""
    job = dict(
        work=str(work),
        images=str(dataset.images),
        known=known,
        threads=arguments.threads,
        seed=seed,
    )
    job["pairs"] = dataset.pairs() if dataset.reach else None
    log = (work / "colmap.log").open("w")
    done = subprocess.run(
        [sys.executable, __file__, "--job", json.dumps(job)],
        stdout=subprocess.PIPE,
        stderr=log,
        text=True,
        check=True,
    )
    return json.loads(done.stdout.strip().split("\n")[-1])


def tiepoint(work, dataset, known, arguments, seed):
    command = [
        arguments.program,
        "reconstruct",
        dataset.images,
        "-o",
        work,
        "--seed",
        seed,
        "--json",
    ]
    command += ["--threads", arguments.threads, "--rig", "off"]
    if known:
        # COLMAP keeps them, too.
        command += ["--intrinsics", ",".join(repr(float(v)) for v in known), "--refine", "none"]
    if dataset.reach:
        command += ["--pairs", f"sequential:{dataset.reach}"]
    start = time.perf_counter()
    log = work.with_suffix(".log").open("w")
    done = subprocess.run(list(map(str, command)), stdout=subprocess.PIPE, stderr=log, text=True)
    wall = time.perf_counter() - start
    if done.returncode != 0:
        sys.exit(f"tiepoint failed, see {log.name}:\n" + Path(log.name).read_text()[-2000:])
    report = json.loads((work / "report.json").read_text())
    return {
        stage: report["stages"][stage]["seconds"] for stage in ("features", "match", "map")
    }, wall


def read_models(sparse):
    return [
        pycolmap.Reconstruction(folder)
        for folder in sorted(sparse.iterdir())
        if (folder / "images.bin").exists()
    ]


def check(work, dataset, known, arguments):
    """pycolmap reads our files, computes the error that we report, and maps every image from our
    matches."""
    report = json.loads((work / "report.json").read_text())
    problems, out = [], {}
    model = pycolmap.Reconstruction(work / "sparse/0")
    ours = report["models"][0]
    error = model.compute_mean_reprojection_error()
    model.update_point_3d_errors()
    recomputed = model.compute_mean_reprojection_error()
    out["error_px"] = {
        "reported": ours["mean_reprojection_error_px"],
        "stored": error,
        "recomputed": recomputed,
    }
    for name, value in (("stored", error), ("recomputed", recomputed)):
        if abs(value - ours["mean_reprojection_error_px"]) > MODEL_TOLERANCE_PX:
            problems.append(
                f"{name} error {value} px, reported {ours['mean_reprojection_error_px']} px"
            )
    for name, value in (
        ("registered", model.num_reg_images()),
        ("points", model.num_points3D()),
        ("observations", model.compute_num_observations()),
    ):
        out[name] = value
        if value != ours[name]:
            problems.append(f"{name} {value}, reported {ours[name]}")
    if not model.is_valid():
        problems.append("pycolmap finds the model not valid")
    # A copy: COLMAP may migrate or lock what it opens.
    with tempfile.TemporaryDirectory() as folder:
        database = Path(folder) / "database.db"
        shutil.copy(work / "database.db", database)
        with contextlib.closing(pycolmap.Database.open(database)) as opened:
            out["database"] = {
                "images": opened.num_images(),
                "keypoints": opened.num_keypoints(),
                "verified_pairs": opened.num_verified_image_pairs(),
                "inlier_matches": opened.num_inlier_matches(),
            }
            if opened.num_images() != len(dataset.names):
                problems.append(
                    f"database holds {opened.num_images()} images of {len(dataset.names)}"
                )
        models = map_database(
            database, dataset.images, Path(folder) / "sparse", known, arguments.threads, 0
        )
        best = largest(models.values())
        out["colmap_from_our_matches"] = measure(best, dataset) if best else None
        if not best or best.num_reg_images() != len(dataset.names):
            registered = best.num_reg_images() if best else 0
            problems.append(
                f"COLMAP registers {registered} of {len(dataset.names)} images from our matches"
            )
    out["problems"] = problems
    return out


def show(label, row):
    accuracy = (
        f"{row['mean_centre_error_mm']:7.2f} mm  ATE {row['ate_cm']:6.3f} cm"
        if "ate_cm" in row
        else " " * 26
    )
    stages = " ".join(f"{k} {v:.1f}" for k, v in row["seconds"].items())
    print(
        f"  {label:<10} {row['wall_s']:7.1f} s  {row['registered']:3d}/{row['images']}  {accuracy} "
        f" {row['mean_reprojection_error_px']:.4f} px  {row['observations']} observations  track"
        f" {row['mean_track_length']:.2f}  [{stages}]",
        flush=True,
    )


def summary(rows):
    keys = [
        "wall_s",
        "registered",
        "mean_centre_error_mm",
        "ate_cm",
        "mean_reprojection_error_px",
        "observations",
        "mean_track_length",
    ]
    return {
        key: statistics.median(row[key] for row in rows)
        for key in keys
        if all(key in row for row in rows)
    }


def run_case(name, calibration, arguments, out):
    dataset = load(name, arguments.data)
    known = dataset.known if calibration == "known" else None
    print(f"{name}, {'known intrinsics' if known else 'uncalibrated'}:", flush=True)
    case = {"data": name, "calibration": calibration, "colmap": [], "tiepoint": []}
    for seed in range(arguments.seeds):
        for program in ("colmap", "tiepoint"):
            if arguments.only not in (None, program) or (
                program == "colmap" and seed >= arguments.colmap_seeds
            ):
                continue
            with tempfile.TemporaryDirectory(dir=arguments.work) as folder:
                work = Path(folder) / "workspace"
                if program == "colmap":
                    work.mkdir()
                    seconds = colmap_in_process(work, dataset, known, arguments, seed)
                    wall = sum(seconds.values())
                else:
                    seconds, wall = tiepoint(work, dataset, known, arguments, seed)
                row = {
                    "seed": seed,
                    "wall_s": wall,
                    "seconds": seconds,
                    **measure(largest(read_models(work / "sparse")), dataset),
                }
                if (work / "equal").is_dir():
                    row["equal_freedom"] = measure(largest(read_models(work / "equal")), dataset)
                case[program].append(row)
                show(program, row)
                if program == "tiepoint" and arguments.check:
                    row["check"] = check(work, dataset, known, arguments)
                    for problem in row["check"]["problems"]:
                        print(f"  CHECK FAILED: {problem}", flush=True)
                    if not row["check"]["problems"]:
                        error = row["check"]["error_px"]
                        print(
                            f"  check: pycolmap finds {error['recomputed']:.6f} px, as reported,"
                            " and registers all images from our matches"
                        )
    case["median"] = {
        program: summary(case[program]) for program in ("colmap", "tiepoint") if case[program]
    }
    if len(case["median"]) == 2:
        case["time_ratio"] = (
            case["median"]["tiepoint"]["wall_s"] / case["median"]["colmap"]["wall_s"]
        )
        print(f"  tiepoint takes {case['time_ratio']:.3f} of COLMAP's time", flush=True)
    if arguments.seeds > 1:
        print(f"  medians: {json.dumps(case['median'])}", flush=True)
    out["cases"].append(case)


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "datasets", nargs="*", default=DATASETS, metavar="DATASET", help=", ".join(DATASETS)
    )
    parser.add_argument("--calibration", choices=["both", "known", "none"], default="both")
    parser.add_argument("--seeds", type=int, default=1, help="runs of ours, seeds 0, 1, ...")
    parser.add_argument("--colmap-seeds", type=int, default=1, help="runs of COLMAP")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--only", choices=["colmap", "tiepoint"], help="run one of the two")
    parser.add_argument(
        "--check", action="store_true", help="pycolmap reads and uses what we wrote"
    )
    parser.add_argument("--program", type=Path, default=None, help="the tiepoint to run")
    parser.add_argument("--data", type=Path, default=os.environ.get("TIEPOINT_DATA"))
    parser.add_argument(
        "--work", type=Path, default=None, help="where to put workspaces (default: the system's)"
    )
    parser.add_argument("--results", type=Path, default=None, help="where raw results go")
    parser.add_argument("--job", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    # Its log would drown ours; a job's goes to a file.
    pycolmap.logging.minloglevel = (
        pycolmap.logging.Level.INFO.value if arguments.job else pycolmap.logging.Level.ERROR.value
    )
    if arguments.job:
        job = json.loads(arguments.job)
        seconds = run_colmap(Path(job.pop("work")), Path(job.pop("images")), **job)
        print("\n" + json.dumps(seconds))
        return
    if arguments.data is None:
        sys.exit("TIEPOINT_DATA is not set: the folder of the reference data, or --data")
    unknown = [name for name in arguments.datasets if name not in DATASETS]
    if unknown:
        sys.exit(f"unknown data set {unknown[0]}: use {', '.join(DATASETS)}")
    if arguments.only != "colmap":
        arguments.program = program_of(arguments)
    out = {
        "when": datetime.datetime.now(datetime.timezone.utc).isoformat(timespec="seconds"),
        "machine": platform.processor() or platform.machine(),
        "threads": arguments.threads,
        "load_before": os.getloadavg(),
        "pycolmap": pycolmap.__version__,
        "cases": [],
    }
    for name in arguments.datasets:
        calibrations = (
            ["none", "known"] if arguments.calibration == "both" else [arguments.calibration]
        )
        for calibration in calibrations:
            if calibration == "known" or load(name, arguments.data).uncalibrated:
                run_case(name, calibration, arguments, out)
    stamp = datetime.datetime.now().strftime("%Y%m%d-%H%M%S")
    path = arguments.results or ROOT / f"bench/results/colmap-{stamp}.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(out, indent=1))
    print(path)
    failed = [
        p
        for case in out["cases"]
        for row in case["tiepoint"]
        for p in row.get("check", {}).get("problems", [])
    ]
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
