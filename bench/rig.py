"""Rigs against the truth: trajectory, calibration and clock of each `--rig` mode.

    cargo build --release -p tiepoint
    python bench/rig.py --drive DRIVE --workspace WS [--rig off auto]
        (a drive of `tiepoint synth` or `tiepoint demo`)
    python bench/rig.py --kitti DATA/kitti04 --workspace WS \\
        [--variant shifted|interleaved|wrong] [--rig auto]

WS is a workspace with features and matches (`tiepoint features`, `tiepoint match`); it is copied,
not changed. Variants of KITTI: `shifted` gives the right camera's images the times of the ones
before; `interleaved` takes even images of the left and odd ones of the right camera, at their own
times; `wrong` swaps one right image in ten with one from elsewhere. They change `timestamps.csv` or
take matches away, so they need no other features. Needs numpy only. With `--peer` the rig adjuster
of a program `colmap` 3.8 (`rig_bundle_adjuster`, what the paper compares with) gets the model of
`off`: one calibration, found from it, of images of the same file name; intrinsics stay where the
workspace has them known. With `--global-mapper 0 1 2` COLMAP's global mapper (pip install
pycolmap==4.2.1) gets the same matches and KITTI's images of one name as frames of a rig of unknown
calibration, with those seeds."""

import argparse
import csv
import json
import shutil
import sqlite3
import subprocess
import tempfile
from pathlib import Path

import numpy as np
from program import degrees, program_of


def run(program, *arguments):
    done = subprocess.run([program, "--json", *map(str, arguments)], capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f"{' '.join(map(str, arguments))}: {done.stderr[-2000:]}")
    return json.loads(done.stdout)


def rotation(w, x, y, z):
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def true_cameras(drive):
    cameras = {}
    with open(drive / "truth" / "cameras.csv") as lines:
        for row in csv.DictReader(lines):
            cameras.setdefault(row["camera"], {})[row["quantity"]] = float(row["value"])
    return cameras


def compare_rig(found, true, metres_per_unit):
    """Errors of one camera's calibration and clock, and the same over their standard deviations."""
    turn = rotation(*found["rotation_wxyz"]) @ rotation(*(true[f"rig_q{a}"] for a in "wxyz")).T
    t = np.array(found["translation"]) * metres_per_unit
    true_t = np.array([true[f"rig_t{a}"] for a in "xyz"])
    clock = found["clock"]
    pivot = clock["pivot_s"]
    offset_ms = 1e3 * (
        pivot + clock["offset_s"] - (pivot - true["clock_offset_s"]) / (1 + true["clock_drift"])
    )
    # Of numbered frames without times, the offset is not in seconds.
    if "assumed_frame_s" in clock:
        offset_ms = float("nan")
    drift_ppm = clock["drift_ppm"] - 1e6 * (1 / (1 + true["clock_drift"]) - 1)
    sd_ms = 1e3 * (clock["offset_sd_s"] or float("nan"))
    return {
        "rotation_deg": degrees((np.trace(turn) - 1) / 2),
        "rotation_sd_deg": found["rotation_sd_deg"],
        "direction_deg": degrees(t @ true_t / np.linalg.norm(t) / np.linalg.norm(true_t)),
        "length_percent": 100 * (np.linalg.norm(t) / np.linalg.norm(true_t) - 1),
        "t_error_mm": (1e3 * (t - true_t)).round(2).tolist(),
        "offset_error_ms": offset_ms,
        "offset_sd_ms": sd_ms,
        "drift_error_ppm": drift_ppm,
        "clock_state": clock["state"],
    }


def show(label, evaluation, report, errors):
    rig = report["models"][0]["rig"]
    extrinsics = (rig or {}).get("extrinsics") or {}
    chosen = extrinsics.get("chosen") or "off"
    line = f"{label:12} ATE {100 * evaluation['centre_error']['rmse']:8.3f} cm  chose {chosen}"
    if extrinsics:
        line += (
            f"  held-out {extrinsics['held_out_error_off_px']:.3f} ->"
            f" {extrinsics['held_out_error_px']:.3f} px"
        )
        line += f"  sigma {extrinsics['sigma_translation']}  bad {len(extrinsics['bad_pairs'])}"
    if rig and rig["cameras"]:
        camera = rig["cameras"][0]
        line += (
            f"  spread {100 * camera['relative_translation_rms']:.3f} %"
            f" {camera['rotation_rms_deg']:.4f} deg"
        )
    print(line, flush=True)
    for name, error in errors.items():
        print(
            f"    {name}: "
            + ", ".join(
                f"{k} {v:.4f}" if isinstance(v, float) else f"{k} {v}" for k, v in error.items()
            ),
            flush=True,
        )


def alter(workspace, variant, kitti):
    """Other time stamps, fewer images or wrong ones."""
    path = workspace / "timestamps.csv"
    header = ["image", "seconds"]
    times = [float(line) for line in open(kitti / "times.txt")]
    with sqlite3.connect(workspace / "database.db") as database:
        names = sorted(name for (name,) in database.execute("SELECT name FROM images"))
    rows = [(name, times[int(Path(name).stem)]) for name in names]
    cameras = sorted({name.split("/")[0] for name, _ in rows})
    left, right = (
        [row for row in rows if row[0].startswith(camera + "/")] for camera in cameras[:2]
    )
    if variant == "shifted":
        right = [
            (name, right[max(k - 1, 0)][1] if k else 2 * right[0][1] - right[1][1])
            for k, (name, _) in enumerate(right)
        ]
    dropped = []
    if variant == "interleaved":
        dropped = [name for name, _ in left[1::2]] + [name for name, _ in right[0::2]]
    if variant == "wrong":
        wrong = list(range(3, len(right) - 10, 10))
        half = len(wrong) // 2
        times = [seconds for _, seconds in right]
        swapped = dict(
            zip(wrong[:half] + wrong[half : 2 * half], wrong[half : 2 * half] + wrong[:half])
        )
        right = [(name, times[swapped.get(k, k)]) for k, (name, _) in enumerate(right)]
        print("wrong:", " ".join(right[k][0] for k in sorted(swapped)))
    with open(path, "w") as out:
        out.write(",".join(header) + "\n")
        for name, seconds in left + right:
            out.write(f"{name},{seconds:.6f}\n")
    if dropped:
        with sqlite3.connect(workspace / "database.db") as database:
            ids = dict(database.execute("SELECT name, image_id FROM images"))
            for name in dropped:
                image = ids[name]
                database.execute(
                    "UPDATE keypoints SET rows = 0, data = NULL WHERE image_id = ?", (image,)
                )
                for table in ("matches", "two_view_geometries"):
                    pairs = [
                        pair
                        for (pair,) in database.execute(f"SELECT pair_id FROM {table}")
                        if image in (pair % 2147483647, (pair - pair % 2147483647) // 2147483647)
                    ]
                    database.executemany(
                        f"DELETE FROM {table} WHERE pair_id = ?", [(pair,) for pair in pairs]
                    )


def adjust_by_peer(model, cameras, known, output):
    """COLMAP 3.8's rig adjuster on a model."""
    config = [
        {
            "ref_camera_id": 1,
            "cameras": [
                {"camera_id": k + 1, "image_prefix": f"{name}/"} for k, name in enumerate(cameras)
            ],
        }
    ]
    output.mkdir()
    path = output / "rig.json"
    path.write_text(json.dumps(config))
    command = [
        "colmap",
        "rig_bundle_adjuster",
        "--input_path",
        model,
        "--output_path",
        output,
        "--rig_config_path",
        path,
    ]
    if known:
        command += [
            "--BundleAdjustment.refine_focal_length",
            "0",
            "--BundleAdjustment.refine_extra_params",
            "0",
        ]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f"rig_bundle_adjuster: {(done.stdout + done.stderr)[-2000:]}")


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--program", type=Path)
    parser.add_argument("--workspace", type=Path, required=True)
    parser.add_argument("--drive", type=Path)
    parser.add_argument("--kitti", type=Path)
    parser.add_argument("--variant", choices=["shifted", "interleaved", "wrong"])
    parser.add_argument("--rig", nargs="+", default=["off", "auto"])
    parser.add_argument("--seed", default="0")
    parser.add_argument("--peer", action="store_true", help="COLMAP 3.8 on the model of off")
    parser.add_argument(
        "--global-mapper",
        type=int,
        nargs="+",
        default=[],
        metavar="SEED",
        help="COLMAP's, on the matches of the workspace",
    )
    parser.add_argument("--keep", type=Path, help="leave the workspaces here")
    options = parser.parse_args()
    if options.global_mapper and not options.kitti:
        parser.error("--global-mapper goes with --kitti")
    options.program = program_of(options)
    truth = (
        f"colmap:{options.drive / 'truth' / 'model'}"
        if options.drive
        else f"kitti:{options.kitti / 'poses.txt'}"
    )
    with sqlite3.connect(options.workspace / "database.db") as database:
        cameras = sorted(
            {name.split("/")[0] for (name,) in database.execute("SELECT name FROM images")}
        )
    if options.global_mapper:
        import pycolmap
        from colmap import make_rig, map_globally

        pycolmap.logging.minloglevel = pycolmap.logging.Level.ERROR.value
    for seed in options.global_mapper:
        with tempfile.TemporaryDirectory() as scratch:
            database, sparse = Path(scratch) / "database.db", Path(scratch) / "sparse"
            shutil.copy(options.workspace / "database.db", database)
            make_rig(database, cameras=cameras)
            map_globally(database, options.kitti / "images", sparse, True, 2, seed)
            evaluation = run(options.program, "evaluate", "poses", sparse / "0", "--truth", truth)
            print(
                f"global mapper, seed {seed}: ATE"
                f" {100 * evaluation['centre_error']['rmse']:8.3f} cm",
                flush=True,
            )
    for mode in options.rig:
        with tempfile.TemporaryDirectory() as scratch:
            workspace = (options.keep or Path(scratch)) / f"rig-{mode}"
            shutil.rmtree(workspace, ignore_errors=True)
            shutil.copytree(options.workspace, workspace)
            if options.variant:
                alter(workspace, options.variant, options.kitti)
            report = run(
                options.program,
                "map",
                workspace,
                "--rig",
                mode,
                "--redo",
                "map",
                "--seed",
                options.seed,
            )
            evaluation = run(options.program, "evaluate", "poses", workspace, "--truth", truth)
            errors = {}
            if (workspace / "rig.json").exists():
                rig = json.loads((workspace / "rig.json").read_text())
                true = true_cameras(options.drive) if options.drive else {}
                for camera in rig["cameras"]:
                    name = camera["name"]
                    if name in true:
                        errors[name] = compare_rig(camera, true[name], evaluation["scale"])
                    else:
                        length = np.linalg.norm(camera["translation"]) * evaluation["scale"]
                        clock = camera["clock"]
                        unit_ms = float("nan") if "assumed_frame_s" in clock else 1e3
                        errors[name] = {
                            "length_m": length,
                            "offset_ms": unit_ms * clock["offset_s"],
                            "offset_sd_ms": unit_ms * (clock["offset_sd_s"] or float("nan")),
                            "clock_state": clock["state"],
                        }
            if "report" in report:
                report = report["report"]
            show(mode, evaluation, report, errors)
            if options.peer and mode == "off":
                adjusted = Path(scratch) / "peer"
                adjust_by_peer(workspace / "sparse/0", cameras, options.kitti, adjusted)
                evaluation = run(options.program, "evaluate", "poses", adjusted, "--truth", truth)
                print(
                    f"COLMAP 3.8   ATE {100 * evaluation['centre_error']['rmse']:8.3f} cm",
                    flush=True,
                )


if __name__ == "__main__":
    main()
