#!/usr/bin/env python3
"""What the loss of the last bundle adjustment is worth: finished models through pycolmap's bundle
adjustment with other losses and other weights.

    pip install numpy pycolmap==4.2.1
    tiepoint map WORKSPACE --rig off --refine none     (features with --intrinsics K)
    TIEPOINT_DATA=... python bench/loss.py kitti04=WORKSPACE/sparse/0 [fountain-P11=...] \\
        [--parts whole windows ...] [--losses squared cauchy:1] [--start own truth] \\
        [--lens frozen free] [--rig rigid] [--results RESULTS.jsonl]
    python bench/loss.py --pool RESULTS.jsonl

The observations are those of the model, so all losses see the same ones. `whole` adjusts the model;
`windows` parts of it (kitti: 31 of 51 frames from 0, 10 and 20, which overlap, and 17 frames from
0, 17 and 34, which do not; Strecha's sets: without two photos); `halves` random halves of the
tracks; `tails` prints the weights of Cauchy's loss by position in the track, depth and length.

`own` starts at the model, `truth` at the true poses, with the points adjusted to them first. `free`
refines the eight parameters of OPENCV for each camera, from the model's values. After a squared
loss, observations above 4 px are deleted and the rest is adjusted again, up to three times, as in
COLMAP. Weights: `track` is one weight for each track, that of Cauchy's loss for its rms error,
computed five times; `ends`, `near`, `far` give a quarter of the weight to the first and last
observation of each track (by time; ordered views only), to the nearer and to the farther half.
pycolmap has no weights: an observation of weight w is seen by a virtual camera with √w times the
focal length, the principal point and the pixel. The weights are rounded to a power of √2.

The error is the root mean square over camera centres (kitti: of the left camera) after a
similarity. `--pool` divides it by that with the squared loss on the same part: geometric means over
the parts of each set, then over the sets, with Student's interval of 95 % over the means of the
sets, which are independent, and over the windows of 17 frames, which are disjoint."""

import argparse
import json
import math
import os
import random
from itertools import combinations
from pathlib import Path

import numpy as np
import pycolmap
from colmap import strecha_centres, umeyama

pycolmap.logging.minloglevel = pycolmap.logging.WARNING.value
MAX_ERROR_PX, RAYLEIGH, CAUCHY_SIGMAS = 4, math.sqrt(2 * math.log(2)), 2.385
LOSSES = ["squared", *(f"{k}:{s}" for k in ("soft-l1", "cauchy") for s in (0.5, 1, 2, 4))]
LOSSES += [OURS := "cauchy:2.385σ"]
WEIGHTS = ["track", "ends", "near", "far"]
WINDOWS = {"windows": (31, (0, 10, 20)), "thirds": (17, (0, 17, 34))}  # frames and first frames
PARTS = ["whole", *WINDOWS, "halves", "tails"]
KINDS = {"soft-l1": pycolmap.LossFunctionType.SOFT_L1, "cauchy": pycolmap.LossFunctionType.CAUCHY}
STUDENT_975 = [math.nan, 12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262, 2.228]


def sensor(camera, level):
    return pycolmap.sensor_t(pycolmap.SensorType.CAMERA, int(camera) * 100 + level + 1)


class Model:
    """Poses, points and observations as arrays; images are ordered by camera and time."""

    def __init__(self, folder):
        model = pycolmap.Reconstruction(folder)
        images = sorted((i for i in model.images.values() if i.has_pose), key=lambda i: i.name)
        ids = {image.image_id: n for n, image in enumerate(images)}
        self.names = [image.name for image in images]
        self.poses = [image.cam_from_world() for image in images]
        cameras = sorted({image.camera_id for image in images})
        self.camera_of = np.array([cameras.index(image.camera_id) for image in images])
        self.cameras = [model.cameras[camera] for camera in cameras]
        self.xyz = np.array([point.xyz for point in model.points3D.values()])
        seen = [
            (ids[e.image_id], n, *model.images[e.image_id].points2D[e.point2D_idx].xy)
            for n, point in enumerate(model.points3D.values())
            for e in point.track.elements
        ]
        seen = np.array(seen)
        self.built = {}
        self.image, self.point = seen[:, :2].astype(int).T
        self.xy = seen[:, 2:]

    def kept(self, observations, images=None):
        """Those observations, of the images with these numbers, in tracks of at least two."""
        mask = np.asarray(observations).copy()
        if images is not None:
            mask &= np.isin(self.image, images)
        mask &= np.bincount(self.point[mask], minlength=len(self.xyz))[self.point] >= 2
        other = object.__new__(Model)
        other.__dict__.update(self.__dict__, built={})
        used = np.unique(self.image[mask])
        points, other.point = np.unique(self.point[mask], return_inverse=True)
        other.image, other.xy = np.searchsorted(used, self.image[mask]), self.xy[mask]
        other.names, other.poses = ([x[i] for i in used] for x in (self.names, self.poses))
        other.camera_of, other.xyz = self.camera_of[used], self.xyz[points]
        return other

    def in_camera(self):
        matrices = np.array([pose.matrix() for pose in self.poses])[self.image]
        return np.einsum("nij,nj->ni", matrices[:, :, :3], self.xyz[self.point]) + matrices[:, :, 3]

    def errors(self):
        found, rays = np.empty_like(self.xy), self.in_camera()
        for n, camera in enumerate(self.cameras):
            mask = self.camera_of[self.image] == n
            found[mask] = camera.img_from_cam(rays[mask])
        return np.linalg.norm(found - self.xy, axis=1)

    def cost(self, loss):
        """Mean of ρ."""
        kind, _, scale = loss.partition(":")
        scale = float(scale or 1)
        s = (self.errors() / scale) ** 2
        rho = {"squared": s, "soft-l1": 2 * np.sqrt(1 + s) - 2, "cauchy": np.log1p(s)}[kind]
        return scale**2 * rho.mean()

    def noise(self):
        """As relative_noise in crates/adjust: the median error, for the degrees of freedom."""
        equations, unknowns = 2 * len(self.xy), 3 * len(self.xyz) + 6 * len(self.poses)
        return np.median(self.errors()) / RAYLEIGH / math.sqrt(1 - unknowns / equations)

    def centres(self):
        return np.array([pose.inverse().translation for pose in self.poses])

    def moved_to(self, truth):
        """The same tracks with the true poses."""
        other = self.kept(np.ones(len(self.xy), bool))
        other.poses = [truth[name] for name in self.names]
        scale, rotation, translation = umeyama(self.centres(), other.centres())
        other.xyz = scale * self.xyz @ rotation.T + translation
        return other.in_front()

    def colmap_model(self, free, rigid, weights=None):
        """As a reconstruction whose images are (image, rounded weight) of ours, and the number of
        one of them for each of our images."""
        levels = np.zeros(len(self.xy), int)
        if weights is not None:
            levels = np.round(-2 * np.log2(np.maximum(weights, 2.0**-10))).astype(int)
        model = pycolmap.Reconstruction()
        self.add_rigs(model, free, rigid, [int(level) for level in np.unique(levels)])
        order = np.lexsort((levels, self.image))
        keys = np.stack([self.image[order], levels[order]], 1)
        keys, starts = np.unique(keys, axis=0, return_index=True)
        place, frames, number_of = np.empty((len(self.xy), 2), int), {}, {}
        for n, chosen in enumerate(np.split(order, starts[1:])):
            place[chosen] = np.stack([np.full(len(chosen), n + 1), np.arange(len(chosen))], 1)
            image = int(keys[n, 0])
            number_of.setdefault(image, n + 1)
            frames.setdefault(Path(self.names[image]).stem if rigid else image, []).append(
                (n + 1, image, int(keys[n, 1]), chosen)
            )
        for frame_id, views in enumerate(frames.values(), 1):
            camera = int(self.camera_of[views[0][1]])
            frame = pycolmap.Frame(frame_id=frame_id, rig_id=1 if rigid else camera + 1)
            frame.rig_from_world = self.poses[views[0][1]]
            for number, image, level, _ in views:
                frame.add_data_id(pycolmap.data_t(sensor(self.camera_of[image], level), number))
            model.add_frame(frame)
            for number, image, level, chosen in views:
                made = pycolmap.Image(
                    name=str(number),
                    keypoints=self.xy[chosen] * 2 ** (-level / 4),
                    camera_id=sensor(self.camera_of[image], level).id,
                    image_id=number,
                )
                made.frame_id = frame_id
                model.add_image(made)
            model.register_frame(frame_id)
        by_point = np.argsort(self.point, kind="stable")
        ends = np.cumsum(np.bincount(self.point, minlength=len(self.xyz)))[:-1]
        for xyz, group in zip(self.xyz, np.split(place[by_point], ends)):
            track = pycolmap.Track([pycolmap.TrackElement(int(i), int(k)) for i, k in group])
            model.add_point3D(xyz, track)
        return model, number_of

    def add_rigs(self, model, free, rigid, levels):
        """Cameras for each weight; each is its own rig, or the second is fixed to the first."""
        for n, given in enumerate(self.cameras):
            if n == 0 or not rigid:
                rig = pycolmap.Rig(rig_id=n + 1)
                rig.add_ref_sensor(sensor(n, levels[0]))
            else:
                stems = [Path(name).stem for name in self.names]
                other = len(stems) - 1
                first = self.poses[stems.index(stems[other])]
                rig.add_sensor(sensor(n, levels[0]), self.poses[other] * first.inverse())
            for level in levels[1:]:
                rig.add_sensor(sensor(n, level), pycolmap.Rigid3d())
            for level in levels:
                values = np.zeros(8)
                values[: len(given.params)] = given.params
                values[:4] *= 2 ** (-level / 4)
                name = "OPENCV" if free or values[4:].any() else "PINHOLE"
                lens = pycolmap.Camera(
                    camera_id=sensor(n, level).id,
                    model=name,
                    width=given.width,
                    height=given.height,
                    params=values if name == "OPENCV" else values[:4],
                )
                model.add_camera(lens)
            if n + 1 == len(self.cameras) or not rigid:
                model.add_rig(rig)

    def adjusted(self, loss, free=False, rigid=False, weights=None, points_only=False):
        """After one bundle adjustment."""
        if weights is not None:
            model, number_of = self.colmap_model(free, rigid, weights)
        else:
            if (free, rigid) not in self.built:
                self.built[free, rigid] = self.colmap_model(free, rigid)
            model, number_of = self.built[free, rigid]
            model = pycolmap.Reconstruction(model)
        options = pycolmap.BundleAdjustmentOptions()
        options.refine_focal_length = options.refine_principal_point = free
        options.refine_extra_params, options.refine_sensor_from_rig = free, rigid
        options.refine_rig_from_world, options.print_summary = not points_only, False
        solver = options.ceres.solver_options
        solver.num_threads = 1
        # A free lens is nearly equivalent to a bend of the path, so that the cost is flat.
        solver.max_num_iterations, solver.function_tolerance = (300, 1e-9) if free else (50, 1e-6)
        kind, _, scale = loss.partition(":")
        if kind != "squared":
            options.ceres.loss_function_type = KINDS[kind]
            options.ceres.loss_function_scale = float(scale)
        pycolmap.bundle_adjustment(model, options)
        other = self.kept(np.ones(len(self.xy), bool))
        numbers = [number_of[n] for n in range(len(self.poses))]
        other.poses = [model.images[number].cam_from_world() for number in numbers]
        other.xyz = np.array([model.points3D[n + 1].xyz for n in range(len(self.xyz))])
        if free:
            other.cameras = [model.cameras[sensor(n, 0).id] for n in range(len(self.cameras))]
        return other.in_front()

    def in_front(self):
        """Without observations behind their camera, which pycolmap deletes before it begins."""
        front = self.in_camera()[:, 2] > 0
        return self if front.all() else self.kept(front)

    def solved(self, loss, free, rigid):
        """With the loss, or with squares and the weights of that name."""
        if loss in WEIGHTS:
            found = self
            for _ in range(5 if loss == "track" else 1):
                found = found.adjusted("squared", free, rigid, found.weights(loss))
            return found
        found = self.adjusted(loss, free, rigid)
        for _ in range(3 if loss == "squared" else 0):
            small = found.errors() <= MAX_ERROR_PX
            if small.all():
                break
            found = found.kept(small).adjusted(loss, free, rigid)
        return found

    def weights(self, name):
        if name == "track":
            count = np.bincount(self.point)
            squares = np.bincount(self.point, self.errors() ** 2) / count
            return 1 / (1 + squares / (CAUCHY_SIGMAS * self.noise()) ** 2)[self.point]
        if name == "ends":
            small = np.minimum(*self.places()) == 0
        else:
            depth = self.relative_depth()
            small = depth <= np.median(depth) if name == "near" else depth > np.median(depth)
        return np.where(small, 0.25, 1.0)

    def places(self):
        """Images of the track before and after the observation's, by time."""
        time = np.array([int("".join(filter(str.isdigit, Path(n).stem))) for n in self.names])
        time, first, last = time[self.image], {}, {}
        first, last = np.full(len(self.xyz), 1 << 40), np.zeros(len(self.xyz), int)
        np.minimum.at(first, self.point, time)
        np.maximum.at(last, self.point, time)
        return time - first[self.point], last[self.point] - time

    def relative_depth(self):
        """Depth in units of the median."""
        depth = self.in_camera()[:, 2]
        return depth / np.median(depth)


def truth_of(name):
    """cam_from_world by image name."""
    folder = Path(os.environ["TIEPOINT_DATA"]) / name
    if name.startswith("kitti"):
        rows = [line.split()[-12:] for line in (folder / "calib.txt").read_text().splitlines()[:2]]
        baseline = -float(rows[1][3]) / float(rows[1][0])
        out = {}
        for n, pose in enumerate(np.loadtxt(folder / "poses.txt").reshape(-1, 3, 4)):
            for side, x in (("left", 0), ("right", baseline)):
                moved = np.column_stack([pose[:, :3], pose @ [x, 0, 0, 1]])
                out[f"{side}/{n:06d}.png"] = pycolmap.Rigid3d(moved).inverse()
        return out
    out = {}
    for image, centre in strecha_centres(folder / "cameras").items():
        lines = (folder / "cameras" / f"{image}.camera").read_text().splitlines()[4:7]
        rotation = np.array([[float(word) for word in line.split()] for line in lines])
        out[image] = pycolmap.Rigid3d(np.column_stack([rotation, centre])).inverse()
    return out


def error(model, truth):
    """In metres."""
    chosen = [n for n, name in enumerate(model.names) if not name.startswith("right/")]
    centres = model.centres()[chosen]
    true = np.array([truth[model.names[n]].inverse().translation for n in chosen])
    scale, rotation, translation = umeyama(centres, true)
    return math.sqrt(((scale * centres @ rotation.T + translation - true) ** 2).sum(1).mean())


def halves(model):
    """Random halves of the tracks. They scatter about the model by the standard deviation of the
    model itself (half-sample replication, McCarthy 1969)."""
    for seed in range(5):
        first = np.random.default_rng(seed).random(len(model.xyz)) < 0.5
        for k, chosen in enumerate((first, ~first)):
            yield f"half {seed}{'ab'[k]}", model.kept(chosen[model.point])


def windows(part, name, model):
    """Label and the numbers of the images."""
    if name.startswith("kitti"):
        frames = np.array([int(Path(n).stem) for n in model.names])
        length, firsts = WINDOWS[part]
        for first in firsts:
            yield f"{length}@{first}", np.flatnonzero((frames - first) // length == 0)
    elif part == "windows":
        pairs = list(combinations(range(len(model.names)), 2))
        for pair in random.Random(5).sample(pairs, 10):
            yield f"without {pair}", np.setdiff1d(np.arange(len(model.names)), pair)


def tails(model):
    """Mean weight of Cauchy's loss and rms error, of groups of observations."""
    scale = CAUCHY_SIGMAS * model.noise()
    found = model.adjusted(f"cauchy:{scale}")
    errors = found.errors()
    weight = 1 / (1 + (errors / scale) ** 2)
    before, after = found.places()
    depth, length = found.relative_depth(), np.bincount(found.point)[found.point]
    quarters = np.quantile(depth, [0.25, 0.5, 0.75])
    groups = {"all": depth > 0, "first": before == 0, "last": after == 0}
    groups["inside"] = (before > 0) & (after > 0)
    groups |= {f"depth {k + 1}/4": np.digitize(depth, quarters) == k for k in range(4)}
    groups |= {
        f"track {low} to {high}": (length >= low) & (length <= high)
        for low, high in ((2, 3), (4, 7), (8, 15), (16, 999))
    }
    squares = errors**2
    by_track = np.bincount(found.point, squares) / np.bincount(found.point)
    within = (squares - by_track[found.point])[length >= 4]
    share = 1 - within.var() / squares[length >= 4].var()
    return {
        "noise_px": found.noise(),
        "share_of_tracks_in_variance_of_squares": share,
        "groups": {
            label: [float(mask.mean()), float(weight[mask].mean()), float(rms(errors[mask]))]
            for label, mask in groups.items()
        },
    }


def rms(values):
    return np.sqrt((values**2).mean()) if len(values) else math.nan


def measure(arguments, out):
    for text in arguments.models:
        name, _, folder = text.partition("=")
        model, truth = Model(folder), truth_of(name)
        rigid = arguments.rig == "rigid"
        is_kitti = name.startswith("kitti")
        everything = np.ones(len(model.xy), bool)
        parts = [("whole", model)] if "whole" in arguments.parts else []
        for part in set(WINDOWS) & set(arguments.parts):
            chosen = windows(part, name, model)
            parts += [(label, model.kept(everything, images)) for label, images in chosen]
        if "halves" in arguments.parts:
            parts += halves(model)
        if "tails" in arguments.parts:
            out({"set": name, "model": folder, "part": "tails", **tails(model)})
        for label, part in parts[: arguments.most]:
            ours = f"cauchy:{CAUCHY_SIGMAS * part.noise()}"
            for start in arguments.start:
                for lens in arguments.lens:
                    for loss in arguments.losses:
                        is_weighted, kind = loss in WEIGHTS, ours if loss == OURS else loss
                        if is_weighted and lens == "free" or loss == "ends" and not is_kitti:
                            continue
                        first = part
                        if start == "truth":
                            loose = "squared" if is_weighted else kind
                            first = part.moved_to(truth).adjusted(loose, points_only=True)
                        found = first.solved(kind, lens == "free", rigid)
                        row = {"set": name, "model": folder, "part": label, "start": start}
                        row["rig"] = arguments.rig
                        row |= {"lens": lens, "loss": loss, "error_m": error(found, truth)}
                        row |= {"observations": len(found.xy), "before_m": error(first, truth)}
                        row["mean_cost"] = None if is_weighted else found.cost(kind)
                        out(row)


def interval(logarithms):
    """Geometric mean with Student's interval of 95 %."""
    count, centre = len(logarithms), np.mean(logarithms)
    if count < 2:
        return f"{math.exp(centre):.3f}"
    half = STUDENT_975[count - 1] * np.std(logarithms, ddof=1) / math.sqrt(count)
    return f"{math.exp(centre):.3f} [{math.exp(centre - half):.3f}, {math.exp(centre + half):.3f}]"


def pool(rows):
    """Error over that with the squared loss, by rig, lens and loss."""
    base, ratios = {}, {}
    for row in rows:
        if row["part"] != "tails" and row["start"] == "own":
            key = (row["set"], row["model"], row["part"], row["lens"], row["rig"])
            base.setdefault(key, {})[row["loss"]] = row["error_m"]
    for (name, _, part, lens, rig), found in base.items():
        kind = "whole" if part == "whole" else "halves" if part.startswith("half") else "windows"
        for loss in sorted(found.keys() - {"squared"}) if "squared" in found else []:
            value = math.log(found[loss] / found["squared"]), math.log(found["squared"]), part
            ratios.setdefault((kind, rig, lens, loss), {}).setdefault(name, []).append(value)
    for (kind, *key), sets in sorted(ratios.items()):
        print(f"{kind}, rig {' '.join(key)}")
        for name, values in sets.items():
            logs, errors, _ = zip(*values)
            low, high = math.exp(min(logs)), math.exp(max(logs))
            print(
                f"    {name}: {math.exp(np.mean(logs)):.3f} ({low:.3f} to {high:.3f}, {len(logs)}"
                f" parts); squared {1e3 * np.exp(np.mean(errors)):.2f} mm"
                f" ± {np.std(errors):.1%}"
            )
        print("    over sets:", interval([np.mean([v[0] for v in x]) for x in sets.values()]))
        thirds = [v[0] for values in sets.values() for v in values if v[2].startswith("17@")]
        if thirds:
            print(f"    over {len(thirds)} disjoint windows:", interval(thirds))


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("models", nargs="*", metavar="SET=MODEL")
    parser.add_argument("--parts", nargs="+", default=PARTS)
    parser.add_argument("--losses", nargs="+", default=LOSSES + WEIGHTS)
    parser.add_argument("--start", nargs="+", default=["own"])
    parser.add_argument("--lens", nargs="+", default=["frozen", "free"])
    parser.add_argument("--rig", choices=["off", "rigid"], default="off")
    parser.add_argument("--most", type=int, help="parts of a set")
    parser.add_argument("--results", type=Path)
    parser.add_argument("--pool", type=Path)
    arguments = parser.parse_args()
    if arguments.pool:
        return pool([json.loads(line) for line in arguments.pool.read_text().splitlines()])

    def out(row):
        print(json.dumps(row), flush=True)
        if arguments.results:
            with arguments.results.open("a") as file:
                file.write(json.dumps(row) + "\n")

    measure(arguments, out)


if __name__ == "__main__":
    main()
