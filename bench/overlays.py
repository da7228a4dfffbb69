#!/usr/bin/env python3
"""Overlays: what stands still in the images of rendered drives, and how much of it is found.

    pip install numpy pillow
    cargo build --release
    python bench/overlays.py -o FOLDER --before PROGRAM [--sets straight two]

PROGRAM is a build without the removal, which matches first. All images are of `tiepoint synth`,
480 x 360 pixels, encoded again with a quality of 92 and noise of two grey values, so that keypoints
on an overlay have noise, too. Without an overlay:

    straight, fast, corner, side, traffic   drives at 5, 20 and 2 images a second, to the right, and
                                            among other vehicles
    stop, wait                              a stop of 8 images on the way, of 12 at the beginning
    pan                                     a tripod that turns by 3 degrees an image
    spot, spots                             12 photos from one spot, and 6 from each of two

With one, pasted on `straight`, `corner` or `side`: a logo of a third and of a sixth of the width, a
time stamp whose digits run, a bonnet, dirt, a still frame around (a turntable), and a logo on half
of the images; and `two`: two streets with one logo.

Printed for each set, exhaustive pairs: `lost`, the inlier matches of verified pairs away from the
overlay that are inliers no more, in per cent (pairs that are verified again may lose a few or win
some); `left`, the still inlier matches on the overlay that remain, in per cent; pairs across the
two streets that are verified."""

import argparse
import shutil
import sqlite3
import subprocess
import sys
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFilter

sys.path.insert(0, str(Path(__file__).parent))
from program import program_of  # noqa: E402

WIDTH, HEIGHT = 480, 360
QUALITY, NOISE = 92, 2.0
STILL_PX = 1.5


def run(*words):
    done = subprocess.run([str(word) for word in words], capture_output=True, text=True)
    if done.returncode:
        sys.exit(f"{' '.join(map(str, words))}\n{done.stderr}")


def drive(program, root, name, options, size=(WIDTH, HEIGHT)):
    folder = root / "drives" / name
    if not folder.is_dir():
        run(program, "synth", "-o", folder, "--size", f"{size[0]}x{size[1]}", *options.split())
    return [np.array(Image.open(f).convert("RGB")) for f in sorted((folder / "left").iterdir())]


def pattern(height, width, cell, seed):
    cells = np.random.RandomState(seed).rand(height // cell + 1, width // cell + 1, 3) * 255
    big = Image.fromarray(cells.astype(np.uint8)).resize(
        ((width // cell + 1) * cell, (height // cell + 1) * cell), Image.NEAREST)
    return np.array(big)[:height, :width]


def pasted(kind, image, index):
    """The image with an overlay, and where it is."""
    out, mask = image.copy(), np.zeros(image.shape[:2], bool)
    if kind.startswith("logo") or kind in ("half", "two"):
        height, width = (28, 80) if kind == "logo17" else (54, 163)
        out[8:8 + height, WIDTH - width - 8:WIDTH - 8] = pattern(height, width, 5, 7)
        mask[8:8 + height, WIDTH - width - 8:WIDTH - 8] = True
    elif kind == "stamp":
        picture = Image.fromarray(out)
        text = f"DASHCAM PRO 4K  2026-03-01 12:{index:02d}:{7 * index % 60:02d}  47 KM/H"
        ImageDraw.Draw(picture).text((8, HEIGHT - 24), text, fill=(255, 255, 0), font_size=18)
        out, mask[HEIGHT - 28:] = np.array(picture), True
    elif kind == "bonnet":
        rows, columns = np.mgrid[:HEIGHT, :WIDTH]
        mask = rows > 0.72 * HEIGHT + 40 * ((columns - WIDTH / 2) / (WIDTH / 2)) ** 2
        texture = Image.fromarray(pattern(HEIGHT, WIDTH, 9, 3)).filter(ImageFilter.GaussianBlur(2))
        out[mask] = np.array(texture)[mask]
    elif kind == "dirt":
        picture, rng = Image.new("L", (WIDTH, HEIGHT)), np.random.RandomState(5)
        for _ in range(40):
            x, y, r = rng.uniform(20, WIDTH - 20), rng.uniform(20, HEIGHT - 20), rng.uniform(2, 8)
            ImageDraw.Draw(picture).ellipse((x - r, y - r, x + r, y + r), fill=230)
        alpha = np.array(picture.filter(ImageFilter.GaussianBlur(1.2)))[..., None] / 255.0
        out, mask = (out * (1 - alpha) + 30 * alpha).astype(np.uint8), alpha[..., 0] > 0.02
    elif kind == "around":
        mask[:] = True
        mask[60:-60, 90:-90] = False
        out[mask] = pattern(HEIGHT, WIDTH, 6, 11)[mask]
    return out, mask


def pan(image, step_deg, count, focal):
    """Views of a camera that turns about its centre, out of one wide image."""
    rows, columns = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    rays = np.stack([(columns - WIDTH / 2) / 700, (rows - HEIGHT / 2) / 700, np.ones_like(rows)])
    height, width = image.shape[:2]
    for index in range(count):
        angle = np.radians(step_deg * (index - (count - 1) / 2))
        x = np.cos(angle) * rays[0] + np.sin(angle) * rays[2]
        z = np.cos(angle) * rays[2] - np.sin(angle) * rays[0]
        u, v = focal * x / z + width / 2 - 0.5, focal * rays[1] / z + height / 2 - 0.5
        u0, v0 = np.floor(u).astype(int), np.floor(v).astype(int)
        fu, fv = (u - u0)[..., None], (v - v0)[..., None]
        at = lambda r, c: image[r.clip(0, height - 1), c.clip(0, width - 1)].astype(float)
        top = at(v0, u0) * (1 - fu) + at(v0, u0 + 1) * fu
        low = at(v0 + 1, u0) * (1 - fu) + at(v0 + 1, u0 + 1) * fu
        yield (top * (1 - fv) + low * fv).astype(np.uint8)


DRIVES = {
    "straight": "--route open --rate 5 --frames 24",
    "fast": "--route open --rate 20 --frames 24",
    "corner": "--rate 2 --frames 24",
    "side": "--route open --rate 5 --frames 24 --view-direction right",
    "traffic": "--route open --rate 5 --frames 24 --effects traffic",
    "other": "--route open --rate 5 --frames 10 --seed 2 --view-direction right",
}
KINDS = ["logo34", "logo17", "stamp", "bonnet", "dirt", "around", "half"]
SETS = ["straight", "fast", "corner", "side", "traffic", "stop", "wait", "pan", "spot", "spots",
        *(f"{kind}_{of}" for kind in KINDS for of in ("straight", "corner", "side")), "two"]


def images_of(program, root, name):
    """Images and masks of a set."""
    get = lambda of: drive(program, root, of, DRIVES[of])
    kind, _, of = name.partition("_")
    if kind in KINDS:
        every = 2 if kind == "half" else 1
        blank = np.zeros((HEIGHT, WIDTH), bool)
        return [pasted(kind, image, index) if index % every == 0 else (image, blank)
                for index, image in enumerate(get(of))]
    if name == "two":
        both = get("side")[:10] + get("other")
        return [pasted("two", image, index) for index, image in enumerate(both)]
    if name == "stop":
        images = get("straight")
        images = images[:8] + [images[8]] * 8 + images[9:17]
    elif name == "wait":
        images = [get("straight")[0]] * 12 + get("straight")[1:13]
    elif name == "pan":
        wide = drive(program, root, "wide", "--frames 1 --view-direction right", (1920, 1440))
        images = list(pan(wide[0], 3.0, 14, 0.6 * 1920))
    elif name == "spot":
        images = [get("side")[0]] * 12
    elif name == "spots":
        images = [get("side")[0]] * 6 + [get("side")[3]] * 6
    else:
        images = get(name)
    return [(image, np.zeros((HEIGHT, WIDTH), bool)) for image in images]


def inliers(path):
    """Pixels of the inlier matches of verified pairs."""
    with sqlite3.connect(path) as db:
        keypoints = {}
        for image, rows, columns, data in db.execute("SELECT * FROM keypoints"):
            keypoints[image] = np.frombuffer(data, np.float32).reshape(rows, columns)[:, :2]
        query = "SELECT pair_id, rows, data FROM two_view_geometries WHERE rows > 0 AND config > 1"
        query += " AND config < 7"
        found = {}
        for pair, rows, data in db.execute(query):
            one, other = divmod(pair, 2147483647)
            index = np.frombuffer(data, np.uint32).reshape(rows, 2)
            found[one, other] = keypoints[one][index[:, 0]], keypoints[other][index[:, 1]], index
        names = dict(db.execute("SELECT image_id, name FROM images"))
        return found, names


def measure(before, after, masks, num_first):
    lost = kept = gone = left = across = 0
    (old, names), (new, _) = inliers(before), inliers(after)
    index_of = {image: int(name[:4]) for image, name in names.items()}
    on = lambda image, pixels: masks[index_of[image]][
        pixels[:, 1].astype(int).clip(0, HEIGHT - 1), pixels[:, 0].astype(int).clip(0, WIDTH - 1)]
    for (one, other), (a, b, index) in old.items():
        still = np.linalg.norm(a - b, axis=1) < STILL_PX
        overlay = still & (on(one, a) | on(other, b))
        scene = ~(on(one, a) | on(other, b))
        now = {tuple(row) for row in new.get((one, other), (0, 0, np.zeros((0, 2))))[2].tolist()}
        is_now = np.array([tuple(row) in now for row in index.tolist()], bool)
        lost, kept = lost + (scene & ~is_now).sum(), kept + (scene & is_now).sum()
        gone, left = gone + (overlay & ~is_now).sum(), left + (overlay & is_now).sum()
    if num_first:
        across = sum((index_of[a] < num_first) != (index_of[b] < num_first) for a, b in new)
    share = lambda part, rest: 100.0 * part / max(1, part + rest)
    return share(lost, kept), share(left, gone), gone + left, across


def images_written(program, root, name):
    """The folder of a set, and the masks of its overlay."""
    folder, rng = root / "sets" / name, np.random.RandomState(1)
    images = images_of(program, root, name)
    if not folder.is_dir():
        folder.mkdir(parents=True)
        for index, (image, _) in enumerate(images):
            noisy = image + rng.normal(0, NOISE, image.shape)
            noisy = Image.fromarray(noisy.clip(0, 255).astype(np.uint8))
            noisy.save(folder / f"{index:04}.jpg", quality=QUALITY)
    wider = ImageFilter.MaxFilter(17)
    masks = [np.array(Image.fromarray(mask).filter(wider)) for _, mask in images]
    return folder, masks


def main():
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("-o", "--output", type=Path, required=True)
    arguments.add_argument("--sets", nargs="*", default=SETS)
    arguments.add_argument("--before", type=Path, required=True)
    options = arguments.parse_args()
    program, before, root = program_of(), options.before, options.output
    print(f"{'set':18} {'lost %':>7} {'left %':>7} {'of':>6} {'across':>7}")
    for name in options.sets:
        folder, masks = images_written(program, root, name)
        path = root / f"{name}.db"
        raw = root / f"{name}_all.db"
        if not raw.is_file():
            part = root / "part.db"
            part.unlink(missing_ok=True)
            run(before, "colmap", "feature_extractor", "--database_path", part, "--image_path",
                folder, "--ImageReader.single_camera", "1")
            run(before, "colmap", "exhaustive_matcher", "--database_path", part)
            part.rename(raw)
        path.unlink(missing_ok=True)
        shutil.copy(raw, path)
        run(program, "colmap", "exhaustive_matcher", "--database_path", path)
        lost, left, overlay, across = measure(raw, path, masks, 10 if name == "two" else 0)
        print(f"{name:18} {lost:7.2f} {left:7.2f} {overlay:6} {across:7}", flush=True)


if __name__ == "__main__":
    main()
