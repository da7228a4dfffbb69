"""Existing models and databases: localisation of held-out photos, and models and databases that
this program and COLMAP exchange.

    pip install numpy pycolmap==4.2.1
    TIEPOINT_DATA=... python bench/existing_models.py TIEPOINT [localize] [exchange] [--colmap OLD]

TIEPOINT is the program. OLD is an old COLMAP (3.8 of apt), whose databases and models are exchanged
as well. `localize`: every third photo of fountain-P11, Herz-Jesus-P8 and the left camera of kitti01
is held out, the others are mapped, and the poses of the held-out ones are compared with the truth
after the similarity of the mapped ones, beside pycolmap's absolute pose of the same 2D-3D
correspondences (those of the model that `localize` wrote, and the wrong ones that 30 % random pairs
add). `exchange`: counts of images
and errors of models that one program continued from the other's.
"""

import json
import os
import shutil
import sqlite3
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pycolmap

words = sys.argv[1:]
colmap = words[words.index("--colmap") + 1] if "--colmap" in words else None
program = words[0]
parts = [word for word in ("localize", "exchange") if word in words[1:]] or ["localize", "exchange"]
data = Path(os.environ["TIEPOINT_DATA"])
work = Path(tempfile.mkdtemp())
rng = np.random.default_rng(27)
SHARE_OF_WRONG = 0.3


def tiepoint(*arguments, may_fail=False):
    command = [program, *map(str, arguments), "--json"]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode and not may_fail:
        sys.exit(f"{' '.join(command)}: {done.stderr[-500:]}")
    return json.loads(done.stdout) if not done.returncode else None


def truth(folder):
    """World-from-camera poses of the photos: rotations and centres."""
    poses = {}
    for file in sorted(folder.glob("*.camera")):
        rows = [list(map(float, line.split())) for line in file.read_text().splitlines() if line]
        poses[file.name.removesuffix(".camera")] = (np.array(rows[4:7]), np.array(rows[7]))
    return poses


def poses_of(model):
    found = {}
    for image in model.images.values():
        if image.has_pose:
            pose = image.cam_from_world()
            rotation = pose.rotation.matrix()
            found[image.name] = (rotation.T, -rotation.T @ pose.translation)
    return found


def similarity(source, target):
    """Scale, rotation and translation of target from source (Umeyama 1991)."""
    a, b = source - source.mean(0), target - target.mean(0)
    u, s, vt = np.linalg.svd(b.T @ a)
    d = np.diag([1, 1, np.sign(np.linalg.det(u @ vt))])
    rotation = u @ d @ vt
    scale = np.trace(np.diag(s) @ d) / (a**2).sum()
    return scale, rotation, target.mean(0) - scale * rotation @ source.mean(0)


def errors(found, true, old):
    """For each image: error of the centre in units of the truth, and of the rotation in degrees;
    after the similarity of the images `old`."""
    names = [name for name in old if name in found]
    scale, rotation, shift = similarity(
        np.array([found[n][1] for n in names]), np.array([true[n][1] for n in names])
    )
    result = {}
    for name, (turn, centre) in found.items():
        if name in true:
            moved = scale * rotation @ centre + shift
            cosine = (np.trace((rotation @ turn).T @ true[name][0]) - 1) / 2
            angle = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
            result[name] = (np.linalg.norm(moved - true[name][1]), angle)
    return result


def photos_of(name):
    kitti = data / name / "poses.txt"
    if kitti.exists():
        photos = sorted((data / name / "images/left").iterdir())
        poses = np.loadtxt(kitti).reshape(-1, 3, 4)
        return photos, {p.name: (pose[:, :3], pose[:, 3]) for p, pose in zip(photos, poses)}
    folder = next(p for p in (data / name / "images", data / name) if any(p.glob("*.jpg")))
    cameras = next(iter(sorted({p.parent for p in (data / name).rglob("*.camera")})))
    return sorted(folder.glob("*.jpg")), truth(cameras)


def localize(name):
    photos, true = photos_of(name)
    root = work / name
    for k, photo in enumerate(photos):
        folder = root / ("held" if k % 3 == 1 else "old")
        folder.mkdir(parents=True, exist_ok=True)
        shutil.copy(photo, folder)
    held = [p.name for p in sorted((root / "held").iterdir())]
    old = [p.name for p in sorted((root / "old").iterdir())]
    tiepoint("reconstruct", root / "old", "-o", root / "ws")
    report = tiepoint("localize", root / "ws", root / "held", "-o", root / "out")
    model = pycolmap.Reconstruction(root / "out")
    ours = errors(poses_of(model), true, old)
    theirs = dict(poses_of(model))
    for image in model.images.values():
        if image.name not in held:
            continue
        seen = [p for p in image.points2D if p.has_point3D()]
        pixels = np.array([p.xy for p in seen])
        points = np.array([model.points3D[p.point3D_id].xyz for p in seen])
        count = int(SHARE_OF_WRONG * len(seen))
        pixels = np.vstack([pixels, pixels[rng.integers(0, len(seen), count)]])
        points = np.vstack([points, points[rng.integers(0, len(seen), count)]])
        options = pycolmap.AbsolutePoseEstimationOptions()
        options.ransac.max_error = 12
        camera = model.cameras[image.camera_id]
        answer = pycolmap.estimate_and_refine_absolute_pose(pixels, points, camera, options)
        if answer is not None:
            rotation = answer["cam_from_world"].rotation.matrix()
            centre = -rotation.T @ answer["cam_from_world"].translation
            theirs[image.name] = (rotation.T, centre)
    theirs = errors(theirs, true, old)
    for image in held:
        entry = next(p for p in report["photos"] if p["image"] == image)
        mine, their = (e.get(image, (np.nan, np.nan)) for e in (ours, theirs))
        print(
            f"{name:14} {image}: {entry['inliers']} of {entry['correspondences']} inliers, "
            f"centre {1e3 * mine[0]:.2f} mm, {mine[1]:.4f} deg; "
            f"pycolmap {1e3 * their[0]:.2f} mm, {their[1]:.4f} deg",
            flush=True,
        )
    count, seconds = report["localized"], report["seconds"]
    print(f"{name:14} {count} of {len(held)} in {seconds:.1f} s", flush=True)


def summary(label, model, true, old):
    found = errors(poses_of(model), true, old)
    centre = 1e3 * np.mean([e[0] for e in found.values()])
    print(f"{label:44} {len(found)} images, {centre:.2f} mm", flush=True)


def largest(folder):
    folders = sorted(Path(folder).glob("[0-9]*"))
    models = [pycolmap.Reconstruction(f) for f in folders]
    return max(models, key=lambda m: m.num_reg_images()) if models else None


def maps(label, database, images, true, names, model=None):
    """pycolmap's mapper on a database, and from a model."""
    out = work / "out" / label.replace(" ", "_").replace("/", "_")
    out.mkdir(parents=True)
    copy = out / "database.db"
    shutil.copy(database, copy)
    found = pycolmap.incremental_mapping(copy, images, out, input_path=str(model) if model else "")
    best = max(found.values(), key=lambda m: m.num_reg_images()) if found else None
    summary(f"pycolmap: {label}", best, true, names) if best else print(f"pycolmap: {label} FAILED")


def ours(label, arguments, true, names):
    out = work / "ours" / label.replace(" ", "_").replace("/", "_")
    if tiepoint(*arguments, "-o", out, may_fail=True) is None:
        print(f"tiepoint: {label} FAILED", flush=True)
        return None
    summary(f"tiepoint: {label}", pycolmap.Reconstruction(out / "sparse/0"), true, names)
    return out


def theirs_of(folder, images, name):
    """Databases and a model of pycolmap: all, matches alone, geometries alone, ids with gaps."""
    folder.mkdir(parents=True)
    database = folder / "all.db"
    if name == "pycolmap":
        pycolmap.extract_features(database, images, camera_mode=pycolmap.CameraMode.SINGLE)
        pycolmap.match_exhaustive(database)
        models = pycolmap.incremental_mapping(database, images, folder)
    else:

        def run(*arguments):
            subprocess.run([colmap, *map(str, arguments)], check=True, capture_output=True)

        paths = ("--database_path", database)
        single = ("--ImageReader.single_camera", 1, "--SiftExtraction.use_gpu", 0)
        run("feature_extractor", *paths, "--image_path", images, *single)
        run("exhaustive_matcher", *paths, "--SiftMatching.use_gpu", 0)
        run("mapper", *paths, "--image_path", images, "--output_path", folder)
    for label, sql in (
        ("matches", "DELETE FROM two_view_geometries"),
        ("geometries", "DELETE FROM matches"),
        ("floats", "UPDATE descriptors SET cols = 512, data = zeroblob(rows * 512)"),
        (
            "gaps",
            "DELETE FROM images WHERE image_id = 3; DELETE FROM keypoints WHERE image_id = 3",
        ),
    ):
        shutil.copy(database, folder / f"{label}.db")
        with sqlite3.connect(folder / f"{label}.db") as connection:
            connection.executescript(f"PRAGMA foreign_keys = OFF; {sql}")
        connection.close()
    return folder


def exchange(name):
    photos, true = photos_of(name)
    images = work / f"{name}-images"
    images.mkdir()
    for photo in photos:
        shutil.copy(photo, images)
    names = [p.name for p in photos]
    old = work / f"{name}-old"
    old.mkdir()
    for photo in photos[: len(photos) // 2]:
        shutil.copy(photo, old)
    ws = ours("photos", ("reconstruct", images), true, names)
    half = ours("half of the photos", ("reconstruct", old), true, names)
    maps("database of tiepoint", ws / "database.db", images, true, names)
    maps("model of tiepoint", ws / "database.db", images, true, names, ws / "sparse/0")
    for fixed in ((), ("--fix-existing-frames",)):
        label = f"from half {' '.join(fixed)}"
        ours(label, ("reconstruct", images, "--input-model", half, *fixed), true, names)
    for other in ("pycolmap", "colmap") if colmap else ("pycolmap",):
        folder = theirs_of(work / f"{name}-{other}", images, other)
        for kind in ("all", "matches", "geometries", "floats", "gaps"):
            file = folder / f"{kind}.db"
            before = file.read_bytes()
            arguments = ("reconstruct", images, "--database", file)
            out = ours(f"{other} {kind}.db", arguments, true, names)
            assert file.read_bytes() == before
            if out and kind in ("all", "gaps"):
                maps(f"copy of {other} {kind}.db", out / "database.db", images, true, names)
                model = out / "sparse/0"
                maps(f"model of {other} {kind}.db", out / "database.db", images, true, names, model)
        model = folder / "0"
        summary(f"{other}: its own model", pycolmap.Reconstruction(model), true, names)
        text = folder / "text"
        text.mkdir()
        pycolmap.Reconstruction(model).write_text(text)
        for path in (model, text):
            for fixed in ((), ("--fix-existing-frames",)):
                label = f"model of {other} {path.name} {' '.join(fixed)}"
                ours(label, ("reconstruct", images, "--input-model", path, *fixed), true, names)


if "localize" in parts:
    for name in ("fountain-P11", "Herz-Jesus-P8", "kitti01"):
        localize(name)
if "exchange" in parts:
    exchange("fountain-P11")
