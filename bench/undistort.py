#!/usr/bin/env python3
"""Undistortion beside COLMAP: the PNG images of `tiepoint undistort` and of `undistort_image`, the
keypoints of the models, and the time without codecs on one thread.

    pip install numpy pillow pycolmap==4.2.1
    cargo build --release -p tiepoint && cargo build --release -p tiepoint-dense --example undistort
    TIEPOINT_DATA=... python bench/undistort.py [--results FILE] [--runs N]

Each camera model that both programs know gets a camera of the size of a photo of fountain-P11, with
a distortion of some ten per cent. The same camera also undistorts an image of uniform noise, where
each error of a thousandth of a pixel counts most. A pixel counts if COLMAP has a colour for it:
within half a pixel of the border it has none, where tiepoint takes the colour of the border. Times
are processor times, the least of N runs."""

import argparse
import json
import os
import pathlib
import subprocess
import sys
import tempfile
import time

import numpy as np
import pycolmap
from PIL import Image
from program import TARGET, program_of

WIDTH, HEIGHT = 1536, 1024
# Of the camera models: focal lengths (one or two), principal point, and these.
F, CX, CY = 1400.0, 771.3, 508.9
FISHEYE_F = 780.0
CAMERAS = {
    "SIMPLE_PINHOLE": [F, CX, CY],
    "PINHOLE": [F, F + 3, CX, CY],
    "SIMPLE_RADIAL": [F, CX, CY, -0.12],
    "RADIAL": [F, CX, CY, -0.15, 0.04],
    "OPENCV": [F, F + 3, CX, CY, -0.15, 0.04, 0.001, -0.002],
    "FULL_OPENCV": [F, F + 3, CX, CY, -0.1, 0.04, 0.001, -0.002, 0.01, 0.05, 0.01, 0.0],
    "FOV": [F, F + 3, CX, CY, 0.7],
    "SIMPLE_DIVISION": [F, CX, CY, -0.12],
    "DIVISION": [F, F + 3, CX, CY, -0.12],
    "SIMPLE_FISHEYE": [FISHEYE_F, CX, CY],
    "FISHEYE": [FISHEYE_F, FISHEYE_F + 2, CX, CY],
    "SIMPLE_RADIAL_FISHEYE": [FISHEYE_F, CX, CY, 0.02],
    "RADIAL_FISHEYE": [FISHEYE_F, CX, CY, 0.02, -0.004],
    "OPENCV_FISHEYE": [FISHEYE_F, FISHEYE_F + 2, CX, CY, 0.02, -0.008, 0.002, -0.0004],
    "THIN_PRISM_FISHEYE": [
        *(FISHEYE_F, FISHEYE_F + 2, CX, CY, 0.02, -0.008, 0.0005, -0.0003, 0.001, 0.0),
        *(0.0004, -0.0002),
    ],
    "RAD_TAN_THIN_PRISM_FISHEYE": [
        *(FISHEYE_F, FISHEYE_F + 2, CX, CY, 0.02, -0.008, 0.001, 0.0, 0.0, 0.0),
        *(0.0005, -0.0003, 0.0004, -0.0002, 0.0, 0.0),
    ],
    "EUCM": [F, F + 3, CX, CY, 0.6, 1.1],
}
KEYPOINTS = 2000


def photo():
    data = os.environ.get("TIEPOINT_DATA")
    if data is None:
        sys.exit("TIEPOINT_DATA is not set: it is the folder of the reference data")
    first = min((pathlib.Path(data) / "fountain-P11").rglob("*.[jJp][pPn][gG]"))
    return np.asarray(Image.open(first).convert("RGB").resize((WIDTH, HEIGHT)))


def write_model(folder, model, params, names, keypoints):
    folder.mkdir(parents=True)
    numbers = " ".join(map(repr, params))
    (folder / "cameras.txt").write_text(f"1 {model} {WIDTH} {HEIGHT} {numbers}\n")
    images = ""
    for index, name in enumerate(names, 1):
        points = " ".join(f"{x!r} {y!r} {k}" for k, (x, y) in enumerate(keypoints.tolist(), 1))
        images += f"{index} 1 0 0 0 {index} 0 0 1 {name}\n{points}\n"
    (folder / "images.txt").write_text(images)
    lines = (
        f"{k + 1} {k % 7} {k % 5} 9 1 2 3 0.5 1 {k} 2 {k}\n" for k in range(len(keypoints))
    )
    (folder / "points3D.txt").write_text("".join(lines))


def compared(ours, colmap):
    """Shares of the pixels within 1 grey level, where COLMAP has a colour."""
    # Within half a pixel of the border COLMAP's is black.
    counts = colmap.any(axis=2)
    off = np.abs(ours.astype(int) - colmap.astype(int)).max(axis=2)[counts]
    return float((off <= 1).mean()), int(off.max()), float(counts.mean())


def measure(model, params, images, runs):
    with tempfile.TemporaryDirectory() as scratch:
        scratch = pathlib.Path(scratch)
        (scratch / "photos").mkdir()
        for name, pixels in images.items():
            Image.fromarray(pixels).save(scratch / "photos" / name)
        rng = np.random.default_rng(0)
        keypoints = rng.uniform([1, 1], [WIDTH - 1, HEIGHT - 1], (KEYPOINTS, 2))
        write_model(scratch / "model", model, params, images, keypoints)
        command = [program_of(), "undistort", scratch / "model", "--images", scratch / "photos"]
        subprocess.run([*map(str, command), "-o", str(scratch / "ours")], check=True,
                       stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        pycolmap.undistort_images(scratch / "colmap", scratch / "model", scratch / "photos")
        ours = pycolmap.Reconstruction(scratch / "ours/sparse/0")
        theirs = pycolmap.Reconstruction(scratch / "colmap/sparse")
        new, reference = ours.cameras[1], theirs.cameras[1]
        same = (new.width, new.height) == (reference.width, reference.height)
        found = {
            "model": model,
            "size": [new.width, new.height],
            "same_size": same,
            "camera_off": float(
                np.abs(new.calibration_matrix() - reference.calibration_matrix()).max()
            ),
        }
        # Keypoints through the new camera, from the rays of COLMAP's model of the old one.
        old = pycolmap.Camera(model=model, width=WIDTH, height=HEIGHT, params=params)
        rays = np.asarray(old.cam_from_img(keypoints)).reshape(len(keypoints), -1)
        through = np.asarray(new.img_from_cam(np.c_[rays[:, :2], np.ones(len(rays))]))
        image = next(image for image in ours.images.values())
        has = np.array([point.has_point3D() for point in image.points2D])
        xy = np.array([point.xy for point in image.points2D])
        found["keypoints"] = int(has.sum())
        found["keypoint_off_px"] = float(np.abs(xy - through)[has].max())
        options = pycolmap.UndistortCameraOptions()
        for name, pixels in images.items():
            png = np.asarray(Image.open(scratch / "ours/images" / name).convert("RGB"))
            # `undistort_images` takes SIMPLE_FISHEYE and FISHEYE for undistorted and copies the
            # files; of the others its PNGs are these.
            bitmap = pycolmap.Bitmap.from_array(pixels)
            reference = pycolmap.undistort_image(options, bitmap, old)[0].to_array()
            file = np.asarray(Image.open(scratch / "colmap/images" / name).convert("RGB"))
            is_file = file.shape == reference.shape and bool((file == reference).all())
            share, worst, counted = compared(png, reference)
            found[name] = {"share": share, "worst": worst, "counted": counted, "is_file": is_file}
        first = next(iter(images.values()))
        bitmap = pycolmap.Bitmap.from_array(first)
        times = []
        for _ in range(runs):
            start = time.process_time()
            pycolmap.undistort_image(options, bitmap, old)
            times.append(time.process_time() - start)
        found["colmap_s"] = min(times)
        (scratch / "in.raw").write_bytes(first.tobytes())

        def of_children(count):
            words[-3] = count
            before = os.times()
            subprocess.run(list(map(str, words)), check=True, stdout=subprocess.DEVNULL,
                           env=dict(os.environ, RAYON_NUM_THREADS="1"))
            after = os.times()
            return sum(after[2:4]) - sum(before[2:4])

        words = [TARGET / "release/examples/undistort", model, WIDTH, HEIGHT]
        words += [",".join(map(repr, params)), 0, 1, scratch / "in.raw", scratch / "out.raw"]
        # Without what the program does once.
        many = 20
        found["tiepoint_s"] = min(
            (of_children(1 + many) - of_children(1)) / many for _ in range(runs)
        )
        return found


def main():
    pycolmap.logging.minloglevel = pycolmap.logging.WARNING
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--results", type=pathlib.Path)
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--models", nargs="*", default=list(CAMERAS))
    arguments = parser.parse_args()
    noise = np.random.default_rng(1).integers(0, 256, (HEIGHT, WIDTH, 3), dtype=np.uint8)
    images = {"photo.png": photo(), "noise.png": noise}
    runs = []
    for model in arguments.models:
        if model not in pycolmap.CameraModelId.__members__:
            print(f"COLMAP knows no {model}")
            continue
        runs.append(measure(model, CAMERAS[model], images, arguments.runs))
        print(json.dumps(runs[-1]), flush=True)
    if arguments.results:
        arguments.results.write_text(json.dumps({"runs": runs}))


if __name__ == "__main__":
    main()
