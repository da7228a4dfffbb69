#!/usr/bin/env python3
"""Known, wrong and unknown intrinsics over many short inputs, beside COLMAP.

  pip install numpy pycolmap==4.2.1
  cargo build --release
  TIEPOINT_DATA=... python bench/windows.py run --work WORK [--sets kitti01 street] [--modes frozen]
  python bench/windows.py table | focal | sigmas        what the results so far say

Sets, each of a source:
  kitti01@0 ... kitti04@20  frames 0-30, 10-40 and 20-50 of a clip of 51 frames (they overlap)
  fountain-P11-0+3 ...      the photos without two; 10 pairs of fountain-P11, 8 of Herz-Jesus-P8
  street-1 ... highway-3    rendered drives of five kinds (street, loop, handheld, drone, highway),
                            two cameras with a lens field, misalignment, exposure, noise and JPEG
Modes, each with --rig off and auto (photos: off):
  frozen            --intrinsics K --refine none
  default           --intrinsics K
  prior             the same with a standard deviation of K of 1 px at the border, stated
  half, double      the same with half and twice the standard deviation
  free              --intrinsics K,0,0,0,0 --calibration-sigma 30
  uncalibrated      no intrinsics
  wrong-1%, wrong-0.3%, wrong+0.3%, wrong+1%   default, with focal lengths that are off
  colmap-frozen, colmap-free   COLMAP's incremental mapper on the databases of frozen and of free

`run` appends every result to --results at once and goes on where it ended; --minutes stops it
before a run. Results of another program (its SHA-256) go to another file. Features and matches are
made once for each set and camera. The error is the ATE of the left camera, of photos of all, after
a similarity. A model with less than 90 % of the images has none.

Pooled ratios are geometric means: over the sets of a source, then over sources, which weigh the
same. Intervals of 95 % are bootstraps over sources, since windows of one clip and the photos of one
place are not independent; a rendered drive is a source. Of one or two sources none is given."""

import argparse
import csv
import hashlib
import itertools
import json
import math
import os
import random
import shutil
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
from program import ROOT, kitti_intrinsics, program_of
from rig import rotation, true_cameras

# Camera that is given, and options of `map`.
MODES = {
    "frozen": ("pinhole", ["--refine", "none"]),
    "default": ("pinhole", []),
    "prior": ("pinhole", ["--calibration-sigma", "1"]),
    "half": ("pinhole", ["--calibration-sigma", "0.5"]),
    "double": ("pinhole", ["--calibration-sigma", "2"]),
    "free": ("opencv", ["--calibration-sigma", "30"]),
    "uncalibrated": ("none", []),
    "wrong-1%": ("pinhole*0.99", []),
    "wrong-0.3%": ("pinhole*0.997", []),
    "wrong+0.3%": ("pinhole*1.003", []),
    "wrong+1%": ("pinhole*1.01", []),
    "colmap-frozen": ("pinhole", None),
    "colmap-free": ("opencv", None),
}
# Options of `synth` and pairs to match of each kind: about 40 images a camera.
EFFECTS = "misalignment+photometry+lens-field"
KINDS = {
    "street": ("--route open --length 160 --rate 2.5 --frames 40", "sequential:10"),
    "loop": ("--route loop --length 160 --rate 2", "sequential:10+ends"),
    "handheld": (
        "--carrier handheld --route open --length 80 --rate 2 --frames 40",
        "sequential:10",
    ),
    "drone": ("--carrier drone --route loop --length 160 --rate 1.5 --frames 40", "exhaustive"),
    "highway": ("--route highway --length 300 --rate 10 --frames 40", "sequential:10"),
}
DRIVE_SEEDS = [1, 2, 3]
WINDOW, STARTS = 31, [0, 10, 20]
LEFT_OUT = {"fountain-P11": (11, 10), "Herz-Jesus-P8": (8, 8)}  # photos, pairs of them to draw
LEAST_REGISTERED = 0.9
# With its default of 16, COLMAP finds no initial pair in windows of kitti04.
INITIAL_ANGLE_DEG = 4.0
DRAWS = 10_000


class Set:
    """An input with its truth; `source` is what it shares with sets that depend on it."""

    def __init__(self, name, source, kind, arguments):
        self.name, self.source, self.kind = name, source, kind
        self.folder, self.data = arguments.work / "inputs" / name, arguments.data / source
        self.images, self.pairs = self.folder, "exhaustive"
        self.rigs = ["off", "auto"]

    def copy(self, files):
        """Puts photos into the folder, under the names that FILES has beside them."""
        for source, name in files:
            (self.folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(source, self.folder / name)


class Window(Set):
    def __init__(self, clip, start, arguments):
        super().__init__(f"{clip}@{start}", clip, "clips", arguments)
        self.start, self.pairs = start, "sequential:10"
        self.truth = f"kitti:{self.data / 'poses.txt'}"

    def prepare(self, program):
        frames = range(self.start, self.start + WINDOW)
        names = [f"{side}/{k:06d}.png" for side in ("left", "right") for k in frames]
        self.copy((self.data / "images" / name, name) for name in names)

    def calibration(self):
        return kitti_intrinsics(self.data)


class Photos(Set):
    def __init__(self, place, left_out, arguments):
        super().__init__(f"{place}-{'+'.join(map(str, left_out))}", place, "photos", arguments)
        self.left_out, self.rigs = left_out, ["off"]
        self.truth = f"strecha:{self.data / 'cameras'}"

    def prepare(self, program):
        photos = sorted((self.data / "images").iterdir())
        self.copy((p, p.name) for k, p in enumerate(photos) if k not in self.left_out)

    def calibration(self):
        k = np.loadtxt(self.data / "K.txt")
        return k[0, 0], k[1, 1], k[0, 2], k[1, 2]


class Drive(Set):
    def __init__(self, kind, seed, arguments):
        super().__init__(f"{kind}-{seed}", f"{kind}-{seed}", kind, arguments)
        self.seed, self.effects = seed, arguments.effects
        self.options, self.pairs = KINDS[kind]
        self.truth = f"colmap:{self.folder / 'truth/left_model'}"

    def prepare(self, program):
        effects = ["--effects", self.effects, *self.options.split()]
        run(program, "synth", "-o", self.folder, "--seed", self.seed, *effects)
        # Of both cameras, images of one file name would be compared with each other.
        model = self.folder / "truth/left_model"
        model.mkdir(exist_ok=True)
        focal, _, cx, cy = self.calibration()
        left = true_cameras(self.folder)["left"]
        size = f"{left['width']:.0f} {left['height']:.0f}"
        (model / "cameras.txt").write_text(f"1 PINHOLE {size} {focal} {focal} {cx} {cy}\n")
        (model / "points3D.txt").write_text("")
        with open(self.folder / "truth/poses.csv") as lines:
            poses = [row for row in csv.DictReader(lines) if row["image"].startswith("left/")]
        columns = ("qw", "qx", "qy", "qz", "tx", "ty", "tz")
        (model / "images.txt").write_text(
            "".join(
                f"{k} {' '.join(row[c] for c in columns)} 1 {row['image']}\n\n"
                for k, row in enumerate(poses, 1)
            )
        )

    def calibration(self):
        left = true_cameras(self.folder)["left"]
        return left["focal_px"], left["focal_px"], left["cx"], left["cy"]


def all_sets(arguments):
    sets = [Window(clip, s, arguments) for clip in ("kitti01", "kitti04") for s in STARTS]
    for place, (photos, count) in LEFT_OUT.items():
        pairs = list(itertools.combinations(range(photos), 2))
        drawn = sorted(random.Random(0).sample(pairs, count))
        sets += [Photos(place, pair, arguments) for pair in drawn]
    # The first drives of all kinds come before the second ones: an early end leaves every kind.
    return sets + [Drive(kind, seed, arguments) for seed in DRIVE_SEEDS for kind in KINDS]


def run(program, *words):
    command = [*map(str, (program, *words)), "--json"]
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    if done.returncode != 0:
        raise RuntimeError(f"{words[0]}: {done.stderr.strip().splitlines()[-1]}")
    return json.loads(done.stdout)


def prepared(window, camera, arguments):
    """A workspace with the features and matches of a set under a given camera."""
    folder = arguments.work / arguments.sha256[:8] / window.name / camera.replace("*", "-")
    done = folder.with_suffix(folder.suffix + ".done")
    if done.exists():
        return folder
    shutil.rmtree(folder, ignore_errors=True)
    model, _, factor = camera.partition("*")
    fx, fy, cx, cy = window.calibration()
    scale = float(factor or 1)
    numbers = [fx * scale, fy * scale, cx, cy] + ([0] * 4 if model == "opencv" else [])
    known = [] if model == "none" else ["--intrinsics", ",".join(repr(float(v)) for v in numbers)]
    times = window.images / "timestamps.csv"
    known += ["--timestamps", times] if times.exists() else []
    if window.rigs != ["off"]:
        inputs = [window.images / "left", window.images / "right"]
    else:
        inputs = [window.images]
    threads = ["--threads", arguments.threads]
    run(arguments.program, "features", *inputs, "-o", folder, *known, *threads)
    run(arguments.program, "match", folder, "--pairs", window.pairs, *threads)
    done.touch()
    return folder


def evaluate(model, window, arguments):
    found = run(arguments.program, "evaluate", "poses", model, "--truth", window.truth)
    out = {"ate_m": found["centre_error"]["rmse"], "scale": found["scale"]}
    return out | {"focal_px": [lens["model_px"] for lens in found["focal_lengths"]]}


def rig_errors(workspace, window, scale):
    """Errors of extrinsics and clocks with the deviations that rig.json states."""
    path = workspace / "rig.json"
    if not isinstance(window, Drive) or not path.exists():
        return []
    true, found = true_cameras(window.folder), []
    for camera in json.loads(path.read_text())["cameras"]:
        truth, variances = true[camera["name"]], np.diag(camera["covariance"] or np.eye(8))
        turn = (
            rotation(*camera["rotation_wxyz"])
            @ rotation(*(truth[f"rig_q{axis}"] for axis in "wxyz")).T
        )
        # Of a small rotation; standard deviations of left perturbations in radians.
        error = 0.5 * np.array(
            [turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]
        )
        clock = camera["clock"]
        pivot, drift = clock["pivot_s"], 1 + truth["clock_drift"]
        offset = pivot + clock["offset_s"] - (pivot - truth["clock_offset_s"]) / drift
        length = scale * np.linalg.norm(camera["translation"])
        found.append(
            {
                "rotation_rad": error.tolist(),
                "rotation_sd_rad": np.sqrt(variances[:3]).tolist()
                if camera["covariance"]
                else None,
                "length_ratio": length / np.linalg.norm([truth[f"rig_t{axis}"] for axis in "xyz"]),
                # Of numbered frames without times, the offset is not in seconds.
                "offset_s": None if "assumed_frame_s" in clock else offset,
                "offset_sd_s": None if "assumed_frame_s" in clock else clock["offset_sd_s"],
            }
        )
    return found


def map_window(window, mode, rig, arguments):
    """One result."""
    camera, options = MODES[mode]
    workspace = prepared(window, camera, arguments)
    copy = workspace.with_name(workspace.name + "-copy")
    shutil.rmtree(copy, ignore_errors=True)
    copy.mkdir()
    files = ["database.db"] if options is None else os.listdir(workspace)
    for name in files:
        path = workspace / name
        (shutil.copytree if path.is_dir() else shutil.copy)(path, copy / name)
    try:
        if options is None:
            return map_by_colmap(copy, window, mode == "colmap-frozen", arguments)
        threads = ["--threads", arguments.threads]
        run(arguments.program, "map", copy, "--rig", rig, *options, *threads)
        # Whatever the program states about its cameras is kept, deviations included.
        model = json.loads((copy / "report.json").read_text())["models"][0]
        out = {key: model[key] for key in ("registered", "images", "observations", "cameras")}
        out |= evaluate(copy, window, arguments)
        out["chosen"] = ((model["rig"] or {}).get("extrinsics") or {}).get("chosen")
        return out | {"rig": rig_errors(copy, window, out["scale"])}
    finally:
        shutil.rmtree(copy, ignore_errors=True)


def map_by_colmap(folder, window, is_frozen, arguments):
    import pycolmap
    from colmap import largest, map_database

    pycolmap.logging.minloglevel = pycolmap.logging.Level.ERROR.value
    database, sparse = folder / "database.db", folder / "sparse"
    models = map_database(
        database,
        window.images,
        sparse,
        is_frozen,
        arguments.threads,
        0,
        principal_point=not is_frozen,
        initial_angle_deg=INITIAL_ANGLE_DEG,
    )
    model = largest(models.values())
    if model is None:
        raise RuntimeError("COLMAP made no model")
    best = folder / "best"
    best.mkdir()
    model.write(best)
    with pycolmap.Database.open(database) as opened:
        images = opened.num_images()
    out = {
        "registered": model.num_reg_images(),
        "images": images,
        "observations": model.compute_num_observations(),
    }
    return out | evaluate(best, window, arguments)


def measure(arguments):
    """Every result that is asked for and not there yet."""
    end = time.monotonic() + 60 * arguments.minutes
    out = read(arguments.results) or {
        "program": arguments.sha256,
        "effects": arguments.effects,
        "runs": {},
    }
    for key in ("program", "effects"):
        if out[key] != (arguments.sha256 if key == "program" else arguments.effects):
            sys.exit(f"{arguments.results} is of other {key}: give another file with --results")
    for window in chosen(all_sets(arguments), arguments.sets):
        tasks = [
            (mode, rig)
            for mode in arguments.modes
            for rig in window.rigs
            if rig in arguments.rigs or window.rigs == ["off"]
        ]
        # COLMAP gets no rig.
        tasks = [(m, r) for m, r in tasks if r == "off" or not m.startswith("colmap")]
        tasks = [task for task in tasks if "|".join((window.name, *task)) not in out["runs"]]
        # Modes of one camera follow each other.
        for mode, rig in sorted(tasks, key=lambda task: MODES[task[0]][0]):
            if time.monotonic() > end:
                print(f"stopped before {window.name} {mode} {rig}: run again to go on")
                return
            try:
                if not (window.folder / ".done").exists():
                    if not isinstance(window, Drive):
                        shutil.rmtree(window.folder, ignore_errors=True)
                    window.prepare(arguments.program)
                    (window.folder / ".done").touch()
                result = map_window(window, mode, rig, arguments)
            except RuntimeError as error:
                result = {"failed": str(error)}
            calibration = window.calibration()
            result |= {"source": window.source, "kind": window.kind, "true_focal": calibration[0]}
            out["runs"][f"{window.name}|{mode}|{rig}"] = result
            part = arguments.results.with_suffix(".part")
            part.write_text(json.dumps(out, indent=1))
            part.replace(arguments.results)
            error = result.get("ate_m")
            told = f"{100 * error:8.3f} cm" if error is not None else result["failed"]
            print(f"{window.name:16} {mode:15} {rig:5} {told}", flush=True)
        if not arguments.keep:
            shutil.rmtree(arguments.work / arguments.sha256[:8] / window.name, ignore_errors=True)


def chosen(sets, names):
    if not names:
        return sets
    found = [
        w
        for w in sets
        if any(w.name == name or w.source == name or w.kind == name for name in names)
    ]
    return found or sys.exit(f"no set is one of {', '.join(names)}")


def read(path):
    return json.loads(path.read_text()) if path.exists() else None


# ---- what the results say -----------------------------------------------------------------------


def errors_of(runs):
    """ATE by set, mode and rig; models without most images have none."""
    found = {}
    for key, run in runs.items():
        name, mode, rig = key.split("|")
        if "ate_m" in run and run["registered"] >= LEAST_REGISTERED * run["images"]:
            found.setdefault((mode, rig), {})[name] = run["ate_m"]
    return found


def better(errors, rig):
    """The better of frozen and free of each set that has both."""
    frozen, free = (errors.get((mode, rig), {}) for mode in ("frozen", "free"))
    return {name: min(frozen[name], free[name]) for name in frozen.keys() & free.keys()}


def pooled(logs):
    """Mean over sources of the mean of each, with its bootstrap over sources, all as ratios."""
    means = np.array([np.mean(values) for values in logs.values()])
    rng = np.random.default_rng(0)
    draws = means[rng.integers(len(means), size=(DRAWS, len(means)))].mean(axis=1)
    low, high = np.percentile(draws, [2.5, 97.5])
    return math.exp(means.mean()), math.exp(low), math.exp(high), len(means)


def print_table(head, rows):
    print("| " + " | ".join(head) + " |\n" + "| --- " * len(head) + "|")
    for row in rows:
        print("| " + " | ".join(row) + " |")
    print()


def table(runs):
    """Geometric means of the error of each source or kind, and ratios to the better of frozen and
    free with the same rig."""
    order = ["clips", "photos", *KINDS]
    about = {key.split("|")[0]: run for key, run in runs.items()}
    about = dict(sorted(about.items(), key=lambda item: order.index(item[1]["kind"])))
    place = {
        n: r["source"] if r["kind"] in ("clips", "photos") else r["kind"] for n, r in about.items()
    }
    errors = errors_of(runs)
    modes = [m for m in MODES if (m, "off") in errors or (m, "auto") in errors]
    places = [p for p in dict.fromkeys(place.values())]
    rows = []
    for mode in modes:
        cells = []
        for where in places:
            sides = []
            for rig in ("off", "auto"):
                names = [n for n in about if place[n] == where and f"{n}|{mode}|{rig}" in runs]
                values = [errors.get((mode, rig), {}).get(n) for n in names]
                found = [100 * v for v in values if v is not None]
                if names:
                    mean = f"{math.exp(np.mean(np.log(found))):.2f}" if found else "-"
                    lost = len(values) - len(found)
                    sides.append(mean + (f" ({lost} lost)" if lost else ""))
            cells.append(" / ".join(sides))
        rows.append([f"`{mode}`", *cells])
    print_table(["ATE (cm), `off` / `auto`", *places], rows)

    kinds = dict.fromkeys(r["kind"] for r in about.values())
    kinds = {kind: [kind] for kind in kinds} | {"all": list(kinds)}
    rows = []
    for mode, rig in itertools.product(modes, ("off", "auto")):
        if (mode, rig) not in errors:
            continue
        base, cells = better(errors, rig), []
        for kind in kinds.values():
            logs = {}
            for name, error in errors[mode, rig].items():
                if name in base and about[name]["kind"] in kind:
                    logs.setdefault(about[name]["source"], []).append(math.log(error / base[name]))
            if not logs:
                cells.append("")
                continue
            mean, low, high, count = pooled(logs)
            # Of fewer sources no interval is known.
            cells.append(f"{mean:.2f}" + (f" ({low:.2f} to {high:.2f})" if count > 2 else ""))
        rows.append([f"`{mode}`, `{rig}`", *cells])
    print_table(["ratio to the better of `frozen` and `free`", *kinds], rows)


def deviation_of(camera):
    """The deviation of a camera's focal length in report.json, where a program states one."""
    deviations = camera.get("params_sd")
    return deviations[0] if deviations else None


def print_normalised(label, pairs):
    """Errors beside their deviations; only the errors where none is stated."""
    errors = np.abs([error for error, _ in pairs])
    line = f"{label}: {len(pairs)} values, median error {np.median(errors):.4g}"
    stated = [(error, sd) for error, sd in pairs if sd]
    if stated:
        ratios = np.array([error / sd for error, sd in stated])
        deviations = np.array([sd for _, sd in stated])
        line += (
            f", median σ {np.median(deviations):.4g}; error / σ of {len(stated)}: rms"
            f" {np.sqrt((ratios**2).mean()):.2f}, median {np.median(np.abs(ratios)):.2f}"
        )
    print(line)


def focal(runs):
    """Focal lengths of uncalibrated sets, as parts of the true ones."""
    rows, pairs = [], {"off": [], "auto": []}
    for key, run in runs.items():
        name, mode, rig = key.split("|")
        if mode != "uncalibrated" or "cameras" not in run:
            continue
        true, cells = run["true_focal"], []
        for camera in run["cameras"]:
            error, sd = camera["params"][0] / true - 1, deviation_of(camera)
            pairs[rig].append((error, sd / true if sd else None))
            cells.append(f"{100 * error:+.2f}" + (f" ± {100 * sd / true:.2f}" if sd else ""))
        rows.append([name, rig, f"{true:.1f}", ", ".join(cells)])
    print_table(["set", "rig", "true focal length (px)", "error of each camera (%)"], rows)
    for rig, found in pairs.items():
        if found:
            print_normalised(f"focal length, part of the true one, `{rig}`", found)


def sigmas(runs):
    """Errors of extrinsics and clocks of rendered drives over their stated deviations."""
    for mode in MODES:
        turns, clocks = [], []
        for key, run in runs.items():
            if key.split("|")[1:] == [mode, "auto"]:
                for camera in run.get("rig", []):
                    sd = camera["rotation_sd_rad"] or [None] * 3
                    turns += zip(
                        np.degrees(camera["rotation_rad"]),
                        [value and math.degrees(value) for value in sd],
                    )
                    if camera["offset_sd_s"]:
                        clocks.append((1e3 * camera["offset_s"], 1e3 * camera["offset_sd_s"]))
        if turns:
            print_normalised(f"{mode}: rotation of the extrinsics about an axis (degrees)", turns)
        if clocks:
            print_normalised(f"{mode}: time offset (ms)", clocks)


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", choices=["run", "table", "focal", "sigmas"])
    parser.add_argument("--results", type=Path, default=ROOT / "bench/results/windows.json")
    parser.add_argument("--work", type=Path, help="scratch folder for inputs and workspaces")
    parser.add_argument("--sets", nargs="+", help="names of sets, sources or kinds")
    parser.add_argument("--modes", nargs="+", choices=MODES, default=list(MODES), metavar="MODE")
    parser.add_argument("--rigs", nargs="+", choices=["off", "auto"], default=["off", "auto"])
    parser.add_argument("--effects", default=EFFECTS, help="of rendered drives")
    parser.add_argument("--minutes", type=float, default=20.0, help="no run begins after these")
    parser.add_argument("--keep", action="store_true", help="leave workspaces in --work")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--program", type=Path, help="the tiepoint to run")
    parser.add_argument("--data", type=Path, default=os.environ.get("TIEPOINT_DATA"))
    arguments = parser.parse_args()
    if arguments.what != "run":
        found = read(arguments.results) or sys.exit(f"{arguments.results} is not there: run first")
        {"table": table, "focal": focal, "sigmas": sigmas}[arguments.what](found["runs"])
        return
    if arguments.data is None or arguments.work is None:
        sys.exit("run needs --work, and TIEPOINT_DATA or --data")
    arguments.data = Path(arguments.data)
    arguments.program = program_of(arguments)
    arguments.sha256 = hashlib.sha256(arguments.program.read_bytes()).hexdigest()
    arguments.results.parent.mkdir(parents=True, exist_ok=True)
    measure(arguments)


if __name__ == "__main__":
    main()
