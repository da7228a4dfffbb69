#!/usr/bin/env python3
"""The commands of scripts that drive COLMAP, run by COLMAP and by tiepoint under the name colmap.

    pip install numpy pillow pycolmap==4.2.1
    cargo build --release
    TIEPOINT_DATA=... python bench/colmap_commands.py --colmap $(which colmap) \\
        [--results RESULTS.json]

Sequences of commands with the same arguments for both programs, the first two each as its script
issues them:

    3dgs          graphdeco-inria/gaussian-splatting, convert.py --no_gpu
    nerfstudio    nerfstudio, ns-process-data images (colmap_utils.run_colmap), exhaustive matching
    masks         masks of photos (ImageReader.mask_path), which hide the left quarter
    turned        photos whose EXIF says that they are to be turned by 90°
    continued     a model of the first images, and mapper --input_path with all

COLMAP runs twice, so that its own noise stands beside the difference to tiepoint.

COLMAP before 4 does not know --alignment_max_error, which convert.py gives to model_aligner: it
gets --robust_alignment_max_error in its place, and a line says so.

Then both read each other's database: COLMAP maps from that of tiepoint and tiepoint from that of
COLMAP (`3dgs`).

Photos are the first of fountain-P11, reduced. Compared are: the exit codes; the files below the
folder of the script; tables and columns of the database (COLMAP's must be there); registered
images; camera model, focal lengths and principal point; centres and rotations after a similarity
(Umeyama 1991), beside the error of each program against the truth of Strecha et al. (pycolmap reads
the models for that); sizes of the undistorted images."""

import argparse
import json
import os
import shlex
import shutil
import sqlite3
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pycolmap
from colmap import strecha_centres, umeyama
from PIL import Image
from program import degrees, program_of

# The tag of EXIF for how a photo is to be turned.
ORIENTATION = 0x0112

THREE_DGS = """
feature_extractor --database_path {s}/distorted/database.db --image_path {s}/input
    --ImageReader.single_camera 1 --ImageReader.camera_model OPENCV --SiftExtraction.use_gpu 0
exhaustive_matcher --database_path {s}/distorted/database.db --SiftMatching.use_gpu 0
mapper --database_path {s}/distorted/database.db --image_path {s}/input
    --output_path {s}/distorted/sparse --Mapper.ba_global_function_tolerance=0.000001
model_aligner --input_path {s}/distorted/sparse/0 --database_path {s}/distorted/database.db
    --alignment_max_error 0.1 --alignment_type plane --output_path {s}/distorted/sparse/0
image_undistorter --image_path {s}/input --input_path {s}/distorted/sparse/0 --output_path {s}
    --output_type COLMAP
"""
NERFSTUDIO = """
feature_extractor --database_path {s}/colmap/database.db --image_path {s}/input
    --ImageReader.single_camera 1 --ImageReader.camera_model OPENCV --SiftExtraction.use_gpu 0
exhaustive_matcher --database_path {s}/colmap/database.db --SiftMatching.use_gpu 0
mapper --database_path {s}/colmap/database.db --image_path {s}/input
    --output_path {s}/colmap/sparse --Mapper.ba_global_function_tolerance=1e-6
bundle_adjuster --input_path {s}/colmap/sparse/0 --output_path {s}/colmap/sparse/0
    --BundleAdjustment.refine_principal_point 1
"""
EXTRACT = """
feature_extractor --database_path {s}/colmap/database.db --image_path {s}/input
    --ImageReader.single_camera 1 --ImageReader.camera_model OPENCV --SiftExtraction.use_gpu 0"""
MATCH_AND_MAP = """
exhaustive_matcher --database_path {s}/colmap/database.db --SiftMatching.use_gpu 0
mapper --database_path {s}/colmap/database.db --image_path {s}/input
    --output_path {s}/colmap/sparse"""
MASKS = EXTRACT + """
    --ImageReader.mask_path {s}/masks""" + MATCH_AND_MAP
TURNED = EXTRACT + MATCH_AND_MAP + """
image_undistorter --image_path {s}/input --input_path {s}/colmap/sparse/0 --output_path {s}
    --output_type COLMAP
"""
CONTINUED = EXTRACT + MATCH_AND_MAP + """
    --image_list_path {s}/first.txt
mapper --database_path {s}/colmap/database.db --image_path {s}/input
    --input_path {s}/colmap/sparse/0 --output_path {s}/colmap/all
"""
# Script: commands, folder of the database, models.
SCRIPTS = {
    "3dgs": (THREE_DGS, "distorted", ["distorted/sparse/0", "sparse/0"]),
    "nerfstudio": (NERFSTUDIO, "colmap", ["colmap/sparse/0"]),
    "masks": (MASKS, "colmap", ["colmap/sparse/0"]),
    "turned": (TURNED, "colmap", ["colmap/sparse/0"]),
    "continued": (CONTINUED, "colmap", ["colmap/all"]),
}


def commands(text):
    command = []
    for line in text.strip().splitlines():
        if not line.startswith(" ") and command:
            yield " ".join(command)
            command = []
        command.append(line.strip())
    yield " ".join(command)


def version(program):
    """As nerfstudio finds it."""
    out = subprocess.run([program, "-h"], capture_output=True, text=True).stdout
    return next(line.split(" ")[1] for line in out.split("\n") if line.startswith("COLMAP"))


def prepare(script, folder, photos):
    _, of_database, _ = SCRIPTS[script]
    (folder / of_database / "sparse").mkdir(parents=True)
    (folder / of_database / "all").mkdir()
    shutil.copytree(photos, folder / "input")
    names = sorted(path.name for path in photos.iterdir())
    (folder / "first.txt").write_text("\n".join(names[: len(names) // 2 + 1]) + "\n")
    if script == "masks":
        (folder / "masks").mkdir()
        for name in names:
            width, height = Image.open(photos / name).size
            mask = np.full((height, width), 255, np.uint8)
            mask[:, : width // 4] = 0
            Image.fromarray(mask).save(folder / "masks" / f"{name}.png")
    if script == "turned":
        exif = Image.Exif()
        exif[ORIENTATION] = 6
        for name in names:
            image = Image.open(photos / name)
            image.save(folder / "input" / name, quality=97, exif=exif)


def run(program, script, folder, photos):
    """The seconds of all commands; `None` if one failed."""
    text, _, _ = SCRIPTS[script]
    prepare(script, folder, photos)
    is_old = is_before_4(program)
    total = 0
    for command in commands(text):
        if is_old and "--alignment_max_error" in command:
            command = command.replace("--alignment_max_error", "--robust_alignment_max_error")
            print("    COLMAP 3: --robust_alignment_max_error for --alignment_max_error")
        # Files have relative names, so that project.ini can be compared.
        seconds = issue(program, command.format(s="."), folder)
        if seconds is None:
            return None
        total += seconds
    if script == "3dgs" and (folder / "sparse").is_dir():
        # What convert.py does then: all files of sparse, also hidden ones, go to sparse/0.
        (folder / "sparse/0").mkdir(exist_ok=True)
        for file in sorted((folder / "sparse").iterdir()):
            if file.name != "0":
                shutil.move(file, folder / "sparse/0" / file.name)
    return total


def is_before_4(program):
    help_text = subprocess.run([program, "-h"], capture_output=True, text=True).stdout
    return int(version(program).split(".")[0]) < 4 and "tiepoint" not in help_text


def issue(program, command, folder):
    """The seconds of a command; `None` if it failed."""
    start = time.monotonic()
    done = subprocess.run(
        [str(program), *shlex.split(command)],
        cwd=folder,
        capture_output=True,
        text=True,
        env={**os.environ, "QT_QPA_PLATFORM": "offscreen"},
    )
    seconds = time.monotonic() - start
    print(f"    {command.split()[0]:20} exit code {done.returncode}  {seconds:6.2f} s")
    if done.returncode != 0:
        print(done.stderr[-500:])
        return None
    return seconds


def files(folder):
    every = (path.relative_to(folder) for path in folder.rglob("*") if path.is_file())
    return {str(path) for path in every if not str(path).startswith("input/")}


def schema(database):
    with sqlite3.connect(database) as connection:
        sql = "SELECT name FROM sqlite_master WHERE type = 'table'"
        tables = [row[0] for row in connection.execute(sql)]
        return {
            (table, row[1])
            for table in tables
            for row in connection.execute(f"PRAGMA table_info('{table}')")
        }


def poses(path):
    model = pycolmap.Reconstruction(path)
    registered = {image.name: image for image in model.images.values() if image.has_pose}
    centres = {name: image.projection_center() for name, image in registered.items()}
    rotations = {
        name: image.cam_from_world().rotation.matrix() for name, image in registered.items()
    }
    return model, centres, rotations


def measured(path, truth):
    """What is told of a model."""
    model, centres, _ = poses(path)
    names = sorted(centres)
    own, true = (np.array([table[name] for name in names]) for table in (centres, truth))
    scale, rotation, translation = umeyama(own, true)
    moved = scale * own @ rotation.T + translation
    camera = next(iter(model.cameras.values()))
    return {
        "images": len(centres),
        "points": len(model.points3D),
        "reprojection_px": model.compute_mean_reprojection_error(),
        "camera": camera.model.name,
        "params": list(map(float, camera.params)),
        "centres_mm": float(1000 * np.linalg.norm(moved - true, axis=1).mean()),
    }


def between(reference, other):
    """The largest difference of centres, in thousandths of their extent, and of rotations, in
    degrees, after a similarity."""
    _, one, one_turns = poses(reference)
    _, two, two_turns = poses(other)
    names = sorted(set(one) & set(two))
    theirs, ours = (np.array([table[name] for name in names]) for table in (one, two))
    scale, rotation, translation = umeyama(ours, theirs)
    moved = scale * ours @ rotation.T + translation
    extent = np.linalg.norm(theirs - theirs.mean(axis=0), axis=1).max()
    turns = [
        degrees((np.trace(two_turns[name] @ rotation.T @ one_turns[name].T) - 1) / 2)
        for name in names
    ]
    apart = np.linalg.norm(moved - theirs, axis=1).max() / extent
    return {"centres_per_mille": float(1000 * apart), "rotations_deg": float(max(turns))}


def images_differ(reference, other):
    """What differs of the undistorted images beside their pixels; `None` if nothing does."""
    names = sorted(path.name for path in (reference / "images").glob("*"))
    if {path.name for path in (other / "images").glob("*")} != set(names):
        return "names of the undistorted images"
    for name in names:
        one, two = (Image.open(folder / "images" / name) for folder in (reference, other))
        # Both programs choose the size by their own focal length and distortion.
        if max(abs(a - b) for a, b in zip(one.size, two.size)) > 2:
            return f"{name}: {one.size} and {two.size} pixels"
        if one.format != two.format or one.mode != two.mode:
            return f"{name}: {one.format} {one.mode} and {two.format} {two.mode}"
    return None


def case(script, programs, root, photos, truth):
    folders, seconds = {}, {}
    for name, program in programs.items():
        print(f"  {name}")
        folders[name] = root / script / name.replace(" ", "-")
        shutil.rmtree(folders[name], ignore_errors=True)
        seconds[name] = run(program, script, folders[name], photos)
    _, of_database, models = SCRIPTS[script]
    one, two = folders["colmap"], folders["tiepoint"]
    # Before SQLite opens the databases, which makes files beside them.
    made = [files(folder) for folder in (one, two)]
    schemas = [schema(folder / of_database / "database.db") for folder in (one, two)]
    found = {
        "script": script,
        "seconds": seconds,
        "missing": sorted(made[0] - made[1]),
        "more": sorted(made[1] - made[0]),
        "missing_columns": sorted(".".join(column) for column in schemas[0] - schemas[1]),
        "images_differ": images_differ(one, two) if script in ("3dgs", "turned") else None,
        "models": {name: measured(folder / models[-1], truth) for name, folder in folders.items()},
        "to_colmap": {
            name: between(one / models[-1], folders[name] / models[-1])
            for name in programs
            if name != "colmap"
        },
    }
    if script == "3dgs":
        found["crossed"] = {}
        for name, other in (("colmap", "tiepoint"), ("tiepoint", "colmap")):
            print(f"  {name}, from the database of {other}")
            output = folders[other] / f"mapped-by-{name}"
            output.mkdir()
            command = "mapper --database_path distorted/database.db --image_path input"
            command += f" --output_path {output.name}"
            if issue(programs[name], command, folders[other]) is not None:
                found["crossed"][name] = measured(output / "0", truth)
    print(json.dumps(found), flush=True)
    return found


def main():
    formatter = argparse.RawTextHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=formatter)
    parser.add_argument("--colmap", default=shutil.which("colmap"), help="COLMAP's program")
    parser.add_argument("--program", type=Path, help="the program; else the release build")
    parser.add_argument("--images", type=int, default=6)
    parser.add_argument("--width", type=int, default=800)
    parser.add_argument("--scripts", nargs="+", choices=SCRIPTS, default=list(SCRIPTS))
    parser.add_argument("--results", type=Path)
    parser.add_argument("--keep", type=Path, help="folder for the results, else they are deleted")
    args = parser.parse_args()
    data = Path(os.environ["TIEPOINT_DATA"]) / "fountain-P11"
    truth = strecha_centres(data / "cameras")
    with tempfile.TemporaryDirectory() as temporary:
        root = args.keep or Path(temporary)
        root.mkdir(parents=True, exist_ok=True)
        photos = root / "photos"
        photos.mkdir(exist_ok=True)
        for path in sorted((data / "images").glob("*.jpg"))[: args.images]:
            image = Image.open(path)
            size = (args.width, round(image.height * args.width / image.width))
            image.resize(size, Image.Resampling.LANCZOS).save(photos / path.name, quality=97)
        link = root / "colmap"
        link.unlink(missing_ok=True)
        link.symlink_to(program_of(args).resolve())
        programs = {"colmap": args.colmap, "colmap again": args.colmap, "tiepoint": link}
        versions = {name: version(path) for name, path in programs.items()}
        print(", ".join(f"{name} says COLMAP {said}" for name, said in versions.items()))
        cases = []
        for script in args.scripts:
            print(f"{script}, {args.images} photos {args.width} wide")
            cases.append(case(script, programs, root, photos, truth))
    if args.results:
        args.results.write_text(json.dumps({"versions": versions, "cases": cases}))
    failed = any(
        None in one["seconds"].values() or one["missing"] or one["missing_columns"] for one in cases
    )
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
