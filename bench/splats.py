#!/usr/bin/env python3
"""Row poses of rolling-shutter images, as `export --to gsplat` gives them, against the truth
of rendered drives.

    pip install numpy pycolmap==4.2.1
    cargo build --release
    python bench/splats.py [--view-directions front right] [--frames 40] [--results RESULTS.json]

Each drive is rendered with a readout of 16 ms and nothing else that disturbs, and reconstructed.
Poses: `estimate` are those of a model whose readout times are estimated, `given` those of one with
the true readout, and `true` are the true poses of the middle rows with the true readout, from which
the motion is computed.

All is relative to the middle row: first and last row have the pose that moves the camera of the
middle row, in metres by the similarity of the model to the truth, so that the drift of a model does
not count. Flow: the surface point that a pixel shows is projected again with the pose of its row,
which lies between that of the first and the last row (rotations by slerp and translations
linearly, as gsplat does); it is the flow between the frame and a frame that is rendered from the
exported poses. Beside it that of a frame rendered from the pose of the middle row alone. Every 4th
pixel of every 4th row of every 4th image, all with the true camera. The image at which a drive
begins does not count: the rendered vehicle stands still while its upper rows are exposed."""

import argparse
import csv
import json
import pathlib
import tempfile

import numpy as np
import pycolmap
from colmap import umeyama
from program import degrees, tiepoint

SIZE = (640, 480)
READOUT = "16ms"
RATE_HZ = 5
STEP = 4
ITERATIONS = 8


def pose_of(row):
    """R and t of a row of a table."""
    q = [float(row[key]) for key in ("qx", "qy", "qz", "qw")]
    t = np.array([float(row[key]) for key in ("tx", "ty", "tz")])
    return pycolmap.Rotation3d(np.array(q)).matrix(), t


def truth_of(drive):
    """Of each image the true pose of its middle row and its time, and those of its first and last
    row; the camera (f, cx, cy)."""
    poses = csv.DictReader((drive / "truth/poses.csv").open())
    middle = {row["image"]: (*pose_of(row), float(row["true_seconds"])) for row in poses}
    rows = {}
    for row in csv.DictReader((drive / "truth/rows.csv").open()):
        rows.setdefault(row["image"], []).append(pose_of(row))
    camera = {}
    for row in csv.DictReader((drive / "truth/cameras.csv").open()):
        camera.setdefault(row["quantity"], float(row["value"]))
    return middle, rows, [camera[key] for key in ("focal_px", "cx", "cy")]


def depths_of(drive, name):
    data = (drive / f"truth/depth_maps/{name}.bin").read_bytes()
    width, height, _, rest = data.split(b"&", 3)
    return np.frombuffer(rest, "<f4").reshape(int(height), int(width))


def relative(row, middle, scale=1.0):
    """The pose of a row relative to the middle one, in metres."""
    turn = row[0] @ middle[0].T
    return turn, scale * (row[1] - turn @ middle[1])


def angle(turn):
    return degrees((np.trace(turn) - 1) / 2)


def exp(vectors):
    """Rotations of rotation vectors (n × 3)."""
    size = np.linalg.norm(vectors, axis=1)[:, None, None]
    x, y, z = vectors.T
    zero = np.zeros_like(x)
    k = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)
    first = np.sinc(size / np.pi)
    second = 0.5 * np.sinc(size / (2 * np.pi)) ** 2
    return np.eye(3) + first * k + second * k @ k


def log(turn):
    axis = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    sine = np.linalg.norm(axis) / 2
    return axis / 2 * (np.arcsin(min(sine, 1.0)) / sine if sine > 1e-12 else 1.0)


class Rows:
    """Poses between those of the first and the last row, relative to the middle one."""

    def __init__(self, first, last, height):
        self.first, self.last, self.height = first, last, height
        self.turn = log(last[0] @ first[0].T)

    def at(self, y):
        part = (np.asarray(y) - 0.5) / (self.height - 1)
        turns = exp(part[:, None] * self.turn) @ self.first[0]
        return turns, (1 - part[:, None]) * self.first[1] + part[:, None] * self.last[1]


def points_of(depths, rows, camera):
    """Pixels and the surface points that they show, in the frame of the middle row."""
    focal, *centre = camera
    height, width = depths.shape
    y, x = np.mgrid[STEP // 2 : height : STEP, STEP // 2 : width : STEP]
    depth = depths[y, x].ravel().astype(float)
    pixels = np.stack([x.ravel() + 0.5, y.ravel() + 0.5], axis=1)[depth > 0]
    depth = depth[depth > 0]
    turns, shifts = rows.at(pixels[:, 1])
    rays = np.column_stack([(pixels - centre) / focal, np.ones(len(pixels))])
    # A point on the ray of its row has its depth in the middle one.
    rays = np.einsum("nji,nj->ni", turns, rays)
    origins = -np.einsum("nji,nj->ni", turns, shifts)
    return pixels, origins + rays * ((depth - origins[:, 2]) / rays[:, 2])[:, None]


def flow(pixels, points, rows, camera):
    """Distance of each pixel from where a frame of these rows shows its point."""
    focal, *centre = camera
    found = pixels
    for _ in range(ITERATIONS):
        turns, shifts = rows.at(found[:, 1])
        seen = np.einsum("nij,nj->ni", turns, points) + shifts
        found = focal * seen[:, :2] / seen[:, 2:] + centre
    return np.linalg.norm(found - pixels, axis=1)


def exported(workspace, folder):
    """First, last and middle pose of each image with a motion; their number, and readouts in ms."""
    tiepoint("export", workspace, "--to", "gsplat", "-o", folder)
    frames = json.loads((folder / "rolling_shutter.json").read_text())["frames"]
    found, readouts = {}, {}
    for frame in frames:
        if frame["rolling_shutter"] == "GLOBAL":
            continue
        keys = ("viewmats", "viewmats_rs", "viewmat_middle_row")
        matrices = [np.array(frame[key]) for key in keys]
        found[frame["image_name"]] = [(matrix[:3, :3], matrix[:3, 3]) for matrix in matrices]
        readouts[frame["camera_id"]] = 1000 * frame["readout_s"]
    return found, len(frames), list(readouts.values())


def compared(drive, found, truth):
    middle, true_rows, camera = truth
    # A drive begins at time 0.
    names = sorted(name for name in found if middle[name][2] > 0)
    centres = [-turn.T @ shift for turn, shift in (found[name][2] for name in names)]
    true_centres = [-turn.T @ shift for turn, shift, _ in (middle[name] for name in names)]
    scale = umeyama(np.array(centres), np.array(true_centres))[0]
    moved, turned, flows, flows_of_middle = [], [], [], []
    still = (np.eye(3), np.zeros(3))
    for number, name in enumerate(names):
        *rows, own = found[name]
        rows = [relative(row, own, scale) for row in rows]
        exact = [relative(row, middle[name]) for row in true_rows[name]]
        for (turn, shift), (true_turn, true_shift) in zip(rows, exact):
            place, true_place = -turn.T @ shift, -true_turn.T @ true_shift
            moved.append(1000 * np.linalg.norm(place - true_place))
            turned.append(angle(turn @ true_turn.T))
        if number % STEP == 0:
            depths = depths_of(drive, name)
            exact = Rows(*exact, SIZE[1])
            pixels, points = points_of(depths, exact, camera)
            # What the truth itself gives, as a check of this script.
            assert flow(pixels, points, exact, camera).max() < 1e-6
            flows.append(flow(pixels, points, Rows(*rows, SIZE[1]), camera))
            flows_of_middle.append(flow(pixels, points, Rows(still, still, SIZE[1]), camera))

    def of(values, digits=4):
        values = np.concatenate(values) if isinstance(values[0], np.ndarray) else values
        quantiles = {"median": 50, "p90": 90, "max": 100}
        return {key: round(float(np.percentile(values, q)), digits) for key, q in quantiles.items()}

    return {
        "images": len(names),
        "moved_mm": of(moved),
        "turned_deg": of(turned, 5),
        "flow_px": of(flows),
        "flow_of_middle_px": of(flows_of_middle),
    }


def set_true_poses(folder, middle):
    model = pycolmap.Reconstruction(folder)
    for image in model.images.values():
        turn, shift, _ = middle[image.name]
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(turn), shift)
        image.frame.set_cam_from_world(image.camera_id, pose)
    model.write(folder)


def measure(direction, options, scratch):
    drive, workspace = scratch / "drive", scratch / "ws"
    tiepoint(
        "synth", "-o", drive, "--effects", "rolling-shutter", "--rate", RATE_HZ, "--depths",
        "--frames", options.frames, "--view-direction", direction, "--size", f"{SIZE[0]}x{SIZE[1]}",
    )
    truth = truth_of(drive)
    shutter = ["--rig", "off", "--rolling-shutter"]
    times = ["--timestamps", drive / "timestamps.csv"]
    tiepoint("reconstruct", drive, "-o", workspace, *times, *shutter, "estimate")
    runs = []
    for poses in ("estimate", "given", "true"):
        if poses == "given":
            tiepoint("map", workspace, "--redo", "map", *shutter, READOUT)
        elif poses == "true":
            set_true_poses(workspace / "sparse/0", truth[0])
        found, total, readouts = exported(workspace, scratch / f"gsplat-{poses}")
        run = {"view_direction": direction, "poses": poses, "exported": total}
        runs.append(run | {"readouts_ms": readouts} | compared(drive, found, truth))
        print(json.dumps(runs[-1]), flush=True)
    return runs


def main():
    pycolmap.logging.minloglevel = pycolmap.logging.WARNING
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--view-directions", nargs="+", default=["front", "right"])
    parser.add_argument("--frames", type=int, default=40)
    parser.add_argument("--results", type=pathlib.Path)
    options = parser.parse_args()
    runs = []
    for direction in options.view_directions:
        with tempfile.TemporaryDirectory() as scratch:
            runs += measure(direction, options, pathlib.Path(scratch))
    if options.results:
        options.results.write_text(json.dumps({"runs": runs}))


if __name__ == "__main__":
    main()
