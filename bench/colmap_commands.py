#!/usr/bin/env python3
"""The commands of scripts that drive COLMAP, run by COLMAP and by tiepoint under the name colmap.

    pip install numpy pillow pycolmap==4.2.1
    cargo build --release
    TIEPOINT_DATA=... python bench/colmap_commands.py --colmap $(which colmap)

Two sequences of commands, each as its script issues it, with the same arguments for both programs:

    3dgs          graphdeco-inria/gaussian-splatting, convert.py --no_gpu
    nerfstudio    nerfstudio, ns-process-data images (colmap_utils.run_colmap), exhaustive matching

COLMAP before 4 does not know --alignment_max_error, which convert.py gives to model_aligner: it
gets --robust_alignment_max_error in its place, and a line says so.

Photos are the first of fountain-P11, reduced. Compared are: the exit codes; the files below the
folder of the script; tables and columns of the database (COLMAP's must be there); registered
images; camera model, focal lengths and principal point; centres and rotations after a similarity
(Umeyama 1991), beside the error of each program against the truth of Strecha et al. (pycolmap reads
the models for that); sizes of the undistorted images."""

import argparse
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
from program import program_of

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
# Script: commands, folder of the database, models.
SCRIPTS = {
    "3dgs": (THREE_DGS, "distorted", ["distorted/sparse/0", "sparse/0"]),
    "nerfstudio": (NERFSTUDIO, "colmap", ["colmap/sparse/0"]),
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


def run(program, script, folder, photos):
    text, of_database, _ = SCRIPTS[script]
    (folder / of_database / "sparse").mkdir(parents=True)
    shutil.copytree(photos, folder / "input")
    is_old = int(version(program).split(".")[0]) < 4 and "tiepoint" not in str(
        subprocess.run([program, "-h"], capture_output=True, text=True).stdout
    )
    ok = True
    for command in commands(text):
        if is_old and "--alignment_max_error" in command:
            command = command.replace("--alignment_max_error", "--robust_alignment_max_error")
            print("    COLMAP 3: --robust_alignment_max_error for --alignment_max_error")
        start = time.monotonic()
        # Files have relative names, so that project.ini can be compared.
        done = subprocess.run(
            [str(program), *shlex.split(command.format(s="."))],
            cwd=folder,
            capture_output=True,
            text=True,
            env={**os.environ, "QT_QPA_PLATFORM": "offscreen"},
        )
        seconds = time.monotonic() - start
        verb = command.split()[0]
        print(f"    {verb:20} exit code {done.returncode}  {seconds:6.2f} s")
        if done.returncode != 0:
            print(done.stderr[-500:])
            ok = False
    if script == "3dgs" and (folder / "sparse").is_dir():
        # What convert.py does then: all files of sparse, also hidden ones, go to sparse/0.
        (folder / "sparse/0").mkdir(exist_ok=True)
        for file in sorted((folder / "sparse").iterdir()):
            if file.name != "0":
                shutil.move(file, folder / "sparse/0" / file.name)
    return ok


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


def compare_models(reference, other, truth):
    found = [poses(reference), poses(other)]
    names = sorted(set(found[0][1]) & set(found[1][1]))
    for label, (model, centres, _) in zip(["colmap", "tiepoint"], found):
        camera = next(iter(model.cameras.values()))
        error = np.array([truth[name] for name in sorted(centres)])
        own = np.array([centres[name] for name in sorted(centres)])
        scale, rotation, translation = umeyama(own, error)
        moved = scale * own @ rotation.T + translation
        millimetres = 1000 * np.linalg.norm(moved - error, axis=1).mean()
        params = " ".join(f"{value:.2f}" for value in camera.params[:4])
        print(
            f"    {label:9} {len(centres)} images {len(model.points3D):5} points "
            f"{model.compute_mean_reprojection_error():.3f} px  {camera.model.name} {params}  "
            f"centres {millimetres:.2f} mm from the truth"
        )
    ours = np.array([found[1][1][name] for name in names])
    theirs = np.array([found[0][1][name] for name in names])
    scale, rotation, translation = umeyama(ours, theirs)
    moved = scale * ours @ rotation.T + translation
    extent = np.linalg.norm(theirs - theirs.mean(axis=0), axis=1).max()
    turns = [
        np.degrees(
            np.arccos(
                np.clip((np.trace(found[1][2][n] @ rotation.T @ found[0][2][n].T) - 1) / 2, -1, 1)
            )
        )
        for n in names
    ]
    print(
        f"    between   centres {1000 * np.linalg.norm(moved - theirs, axis=1).max() / extent:.2f} "
        f"thousandths of their extent, rotations {max(turns):.3f}° at most"
    )


def compare_images(reference, other):
    names = sorted(path.name for path in (reference / "images").glob("*"))
    if not names:
        return
    if {path.name for path in (other / "images").glob("*")} != set(names):
        print("    the undistorted images differ in their names")
        return
    for name in names:
        one, two = (Image.open(folder / "images" / name) for folder in (reference, other))
        if one.size != two.size:
            print(f"    {name}: {one.size} and {two.size} pixels")
            return
    print(f"    {len(names)} undistorted images of {one.size} pixels in both")


def main():
    formatter = argparse.RawTextHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=formatter)
    parser.add_argument("--colmap", default=shutil.which("colmap"), help="COLMAP's program")
    parser.add_argument("--program", type=Path, help="the program; else the release build")
    parser.add_argument("--images", type=int, default=6)
    parser.add_argument("--width", type=int, default=800)
    parser.add_argument("--scripts", nargs="+", choices=SCRIPTS, default=list(SCRIPTS))
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
        programs = {"colmap": args.colmap, "tiepoint": link}
        print(", ".join(f"{name} says COLMAP {version(path)}" for name, path in programs.items()))
        failed = False
        for script in args.scripts:
            print(f"{script}, {args.images} photos {args.width} wide")
            folders = {}
            for name, program in programs.items():
                print(f"  {name}")
                folders[name] = root / script / name
                shutil.rmtree(folders[name], ignore_errors=True)
                failed |= not run(program, script, folders[name], photos)
            one, two = folders["colmap"], folders["tiepoint"]
            print("  compared")
            missing, more = files(one) - files(two), files(two) - files(one)
            print(f"    files that only COLMAP makes: {' '.join(sorted(missing)) or 'none'}")
            print(f"    files that only tiepoint makes: {' '.join(sorted(more)) or 'none'}")
            _, of_database, models = SCRIPTS[script]
            schemas = [schema(folder / of_database / "database.db") for folder in (one, two)]
            absent = sorted(".".join(column) for column in schemas[0] - schemas[1])
            print(f"    columns that only COLMAP's database has: {' '.join(absent) or 'none'}")
            for model in models:
                if all((folder / model).is_dir() for folder in (one, two)):
                    print(f"   {model}")
                    compare_models(one / model, two / model, truth)
            if script == "3dgs":
                compare_images(one, two)
            failed |= bool(missing)
    sys.exit(failed)


if __name__ == "__main__":
    main()
