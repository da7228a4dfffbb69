#!/usr/bin/env python3
"""Dense clouds of a shaking camera with a rolling shutter, beside those with a global one.

    pip install numpy scipy blake3 pycolmap==4.2.1
    cargo build --release
    python bench/dense_shutter.py [--seed 1] [--view front] [--frames 8] [--keep FOLDER]

Two rendered drives that differ in the shutter alone. Each is reconstructed, and dense clouds are
made with its own and with the true poses: of the drive with a rolling shutter also from one pose an
image, as if its readout time was not known. The true surface is that of the drive with the global
shutter, as in `dense.py`. Prints, for each cloud, its number of points, the median and the mean
distance to the surface in footprints (one of over 5 counts as 5), and accuracy, completeness and
F1 at 1, 2 and 5 footprints.

The first frame is left out: the vehicle begins to move amid its readout."""

import argparse
import json
import pathlib
import shutil
import tempfile

import numpy as np
import pycolmap
from blake3 import blake3

from dense import Surface, aligned, cloud_of, map_of, set_true_poses
from program import tiepoint


def drive(folder, effects, options, words=()):
    tiepoint(
        "synth", "-o", folder, "--view-direction", options.view, "--seed", options.seed,
        "--frames", options.frames + 1, "--size", f"{options.size[0]}x{options.size[1]}",
        "--effects", effects, *words,
    )


def photos_of(drive, folder):
    """Copies all photos but the first of each camera."""
    for side in sorted(path for path in drive.iterdir() if (path / "000001.png").exists()):
        (folder / side.name).mkdir(parents=True)
        for path in sorted(side.glob("*.png"))[1:]:
            shutil.copy(path, folder / side.name / path.name)


def vouch(folder):
    """Makes the tiepoint.json beside a rewritten model belong to it."""
    path = folder / "tiepoint.json"
    content = json.loads(path.read_text())
    for name in content["files"]:
        digest = blake3((folder / name).read_bytes()).digest()
        content["files"][name] = blake3(digest).hexdigest()
    path.write_text(json.dumps(content))


def forget_shutters(folder):
    """Takes the readout times out of the tiepoint.json beside a model."""
    path = folder / "tiepoint.json"
    content = json.loads(path.read_text())
    for camera in content["cameras"]:
        camera.pop("readout_s", None)
    path.write_text(json.dumps(content))


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--view", default="front")
    parser.add_argument("--frames", type=int, default=8)
    parser.add_argument("--keep", type=pathlib.Path)
    options = parser.parse_args()
    options.size = (480, 360)
    with tempfile.TemporaryDirectory() as temporary:
        run(options.keep or pathlib.Path(temporary), options)


def run(scratch, options):
    drive(scratch / "global", "vibration", options, ["--depths"])
    drive(scratch / "rolling", "vibration+rolling-shutter", options)
    truth = pycolmap.Reconstruction(scratch / "global/truth/model")
    focal = next(iter(truth.cameras.values())).params[0]
    middle = np.array(options.size) / 2
    views = {}
    for image in truth.images.values():
        if image.name.endswith("000000.png"):
            continue
        depth = map_of(scratch / f"global/truth/depth_maps/{image.name}.bin")
        pose = image.cam_from_world().matrix()
        views[image.name] = (pose[:, :3], pose[:, 3], depth)
    surface = Surface(views, focal, middle)
    true = {name: np.column_stack([r.T, -r.T @ t]) for name, (r, t, _) in views.items()}
    for shutter in ("global", "rolling"):
        photos, workspace = scratch / f"photos-{shutter}", scratch / f"ws-{shutter}"
        photos_of(scratch / shutter, photos)
        known = ["--intrinsics", f"{focal},{focal},{middle[0]},{middle[1]}", "--refine", "none"]
        known += ["--timestamps", scratch / shutter / "timestamps.csv"]
        if shutter == "rolling":
            # The readout of `synth --effects rolling-shutter`.
            known += ["--rolling-shutter", "16ms"]
        tiepoint("reconstruct", photos, "-o", workspace, *known)
        for poses in ("own", "true"):
            if poses == "true":
                set_true_poses(workspace / "sparse/0", views, focal, middle)
                vouch(workspace / "sparse/0")
            for rows in (True, False) if shutter == "rolling" else (True,):
                saved = (workspace / "sparse/0/tiepoint.json").read_text()
                if not rows:
                    forget_shutters(workspace / "sparse/0")
                report = tiepoint("dense", workspace, "--redo", "dense")["stages"]["dense"]
                count = report.get("depth_maps_with_row_poses", 0)
                assert (count > 0) == (rows and shutter == "rolling"), report
                model = pycolmap.Reconstruction(workspace / "sparse/0")
                (workspace / "sparse/0/tiepoint.json").write_text(saved)
                cloud = cloud_of(workspace / "dense/fused.ply")
                cloud = aligned(cloud, model, true) if poses == "own" else cloud
                distances = surface.distances(cloud)
                found = {"shutter": shutter, "poses": poses, "row_poses": count}
                found |= {"points": len(cloud), "median": float(np.median(distances))}
                found |= {"mean_to_5": float(np.minimum(distances, 5).mean())}
                print(json.dumps(found | surface.quality(cloud)), flush=True)


if __name__ == "__main__":
    main()
