#!/usr/bin/env python3
"""What features and matches are worth: COLMAP's own mapper runs on its features, on ours, and on
our whole database.

  pip install numpy opencv-python-headless pycolmap
  cargo build --release -p tiepoint
  TIEPOINT_DATA=... python bench/sift_sfm.py [SCENE...] [--with-k] [--seeds N]

"COLMAP" and "tiepoint" are features that COLMAP's matcher matches; "tiepoint database" is the
database of `tiepoint features` and `tiepoint match`, with our matches and two-view geometries.
Scenes: fountain-P11, Herz-Jesus-P8, sceaux, temple_ring, kitti04 (left and right, with the
intrinsics of its calib.txt, 10 neighbours before and after in both). Where truth is known, the
error of camera centres after a similarity, and the pose AUC: over all pairs of images the larger
one of two angles, that between the relative rotations and that between the directions of
translation (an image without a pose is wrong by more than any limit), and the area below its
cumulative curve up to 1, 3, 5 and 10 degrees."""

import argparse, glob, os, subprocess, sys, tempfile, time
import cv2, numpy as np, pycolmap
from program import program_of
from sift import Colmap, Tiepoint, DATA

OURS = "tiepoint database"
REACH = 10


AUC_DEGREES = (1, 3, 5, 10)


def truth_poses(scene):
    """(world_from_cam rotation, centre) by image name."""
    folder, poses = os.path.join(DATA, scene), {}
    for path in glob.glob(os.path.join(folder, "cameras", "*.camera")):
        rows = [row.split() for row in open(path).read().split("\n")]
        poses[os.path.basename(path).removesuffix(".camera")] = np.array(
            rows[4:7], float
        ), np.array(rows[7], float)
    if scene == "temple_ring":
        # The files were turned since they were calibrated, so that the temple stands upright: those
        # taken from the one side by a quarter to the left, those from the other side to the right.
        angles = (row.split() for row in open(os.path.join(folder, "templeR_ang.txt")))
        turns = {row[2]: -np.sign(float(row[0])) for row in angles if len(row) == 3}
        for row in open(os.path.join(folder, "templeR_par.txt")).read().split("\n")[1:]:
            name, *numbers = row.split() or [""]
            if name:
                r = np.array(numbers[9:18], float).reshape(3, 3)
                turn = np.array([[0, -turns[name], 0], [turns[name], 0, 0], [0, 0, 1]])
                poses[name] = r.T @ turn, -r.T @ np.array(numbers[18:], float)
    if scene.startswith("kitti"):
        lines = open(os.path.join(folder, "calib.txt")).read().split("\n")
        p1 = np.array(lines[1].split()[1:], float).reshape(3, 4)
        for i, pose in enumerate(np.loadtxt(os.path.join(folder, "poses.txt")).reshape(-1, 3, 4)):
            right = pose @ [-p1[0, 3] / p1[0, 0], 0, 0, 1]
            for side, centre in (("left", pose[:, 3]), ("right", right)):
                poses[f"{side}/{i:06d}.png"] = pose[:, :3], centre
    return poses


def angle_between(a, b):
    return np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b))


def pose_errors(model, truth):
    """Of all pairs of images with a true pose, in degrees; infinite where one has none in the
    model."""
    found = {}
    for image in model.images.values():
        if image.has_pose:
            pose = image.cam_from_world()
            found[image.name] = pose.rotation.matrix().T, image.projection_center()
    errors, names = [], sorted(truth)
    for i, a in enumerate(names):
        for b in names[i + 1 :]:
            if a not in found or b not in found:
                errors.append(np.inf)
                continue
            relative = []
            for poses in (found, truth):
                (ra, ca), (rb, cb) = poses[a], poses[b]
                relative.append((rb.T @ ra, ra.T @ (cb - ca)))
            (r, t), (r_true, t_true) = relative
            turn = r @ r_true.T
            axis = np.array(
                [turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]
            )
            errors.append(
                max(
                    np.degrees(np.arctan2(np.linalg.norm(axis), np.trace(turn) - 1)),
                    angle_between(t, t_true),
                )
            )
    return np.array(errors)


def auc(errors, limit):
    """The area below the cumulative curve of the errors up to a limit, 1 where all are 0."""
    return np.clip(1 - np.asarray(errors) / limit, 0, None).mean()


def align(source, target):
    """Umeyama: the similarity that maps source to target."""
    cs, ct = source.mean(0), target.mean(0)
    u, s, vt = np.linalg.svd((target - ct).T @ (source - cs))
    d = np.diag([1, 1, np.sign(np.linalg.det(u @ vt))])
    r = u @ d @ vt
    scale = np.trace(np.diag(s) @ d) / ((source - cs) ** 2).sum()
    return scale * (source - cs) @ r.T + ct


def match_colmap(folder, names, features, k, database_path):
    """COLMAP's matches of given features, in a new database."""
    reader = pycolmap.ImageReaderOptions()
    if k is not None:
        reader.camera_model = "PINHOLE"
        reader.camera_params = ",".join(map(str, k))
    pycolmap.Database.open(database_path).close()
    pycolmap.import_images(
        database_path,
        folder,
        pycolmap.CameraMode.PER_FOLDER if "/" in names[0] else pycolmap.CameraMode.SINGLE,
        image_names=names,
        options=reader,
    )
    db = pycolmap.Database.open(database_path)
    for image in db.read_all_images():
        keypoints, descriptors = features[names.index(image.name)]
        db.write_keypoints(image.image_id, keypoints)
        bytes_ = pycolmap.FeatureDescriptors(
            pycolmap.FeatureExtractorType.SIFT,
            np.clip(np.round(descriptors), 0, 255).astype(np.uint8),
        )
        db.write_descriptors(image.image_id, bytes_)
    db.close()
    matching = pycolmap.FeatureMatchingOptions(use_gpu=False, num_threads=2)
    if len(names) <= 50:
        pycolmap.match_exhaustive(database_path, matching_options=matching)
    else:
        frame = lambda name: int(os.path.splitext(os.path.basename(name))[0])
        listed = os.path.join(os.path.dirname(database_path), "pairs.txt")
        with open(listed, "w") as file:
            file.writelines(
                f"{a} {b}\n"
                for i, a in enumerate(names)
                for b in names[i + 1 :]
                if abs(frame(a) - frame(b)) <= REACH
            )
        pairing = pycolmap.ImportedPairingOptions()
        pairing.match_list_path = listed
        pycolmap.match_image_pairs(database_path, matching, pairing, device=pycolmap.Device.cpu)


def match_tiepoint(folder, names, k, workspace):
    """Our database, of our own features and matches."""
    program = program_of()
    intrinsics = (
        [] if k is None else ["--camera-model", "PINHOLE", "--intrinsics", ",".join(map(str, k))]
    )
    pairs = "exhaustive" if len(names) <= 50 else f"sequential:{REACH}"
    subprocess.run(
        [program, "features", folder, "-o", workspace, "--threads", "2", *intrinsics],
        check=True,
        capture_output=True,
    )
    subprocess.run(
        [program, "match", workspace, "--pairs", pairs, "--threads", "2"],
        check=True,
        capture_output=True,
    )


def reconstruct(folder, k, seed, database_path):
    options = pycolmap.IncrementalPipelineOptions(num_threads=2, random_seed=seed)
    if k is not None:
        options.ba_refine_focal_length = options.ba_refine_extra_params = False
        options.mapper.abs_pose_refine_focal_length = (
            options.mapper.abs_pose_refine_extra_params
        ) = False
    with tempfile.TemporaryDirectory() as out:
        models = pycolmap.incremental_mapping(database_path, folder, out, options)
    return max(models.values(), key=lambda m: m.num_reg_images()) if models else None


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("scenes", nargs="*", default=["fountain-P11", "Herz-Jesus-P8"])
    parser.add_argument("--with-k", action="store_true")
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--max", type=int, default=8192)
    parser.add_argument("--exact", action="store_true", help="also exactly that many features")
    parser.add_argument("--only", default="", help="one program")
    args = parser.parse_args()
    pycolmap.logging.minloglevel = 2
    programs = {"COLMAP": Colmap(), "tiepoint": Tiepoint(), OURS: None}
    if args.exact:
        programs["tiepoint exact limit"] = Tiepoint("--exact")
    for scene in args.scenes:
        folder = (
            os.path.join(DATA, scene)
            if scene == "temple_ring"
            else os.path.join(DATA, scene, "images")
        )
        paths = [
            p
            for e in ("jpg", "JPG", "png")
            for under in ("*.", "*/*.")
            for p in glob.glob(os.path.join(folder, under + e))
        ]
        names = sorted(os.path.relpath(p, folder) for p in paths)
        images = [cv2.imread(os.path.join(folder, n), cv2.IMREAD_GRAYSCALE) for n in names]
        k = None
        if args.with_k:
            m = np.loadtxt(os.path.join(DATA, scene, "K.txt"), comments="#")[:3, :3]
            k = (m[0, 0], m[1, 1], m[0, 2] + 0.5, m[1, 2] + 0.5)
        if scene.startswith("kitti"):
            m = np.array(
                open(os.path.join(DATA, scene, "calib.txt")).readline().split()[1:], float
            ).reshape(3, 4)
            k = (m[0, 0], m[1, 1], m[0, 2] + 0.5, m[1, 2] + 0.5)
        truth = {name: pose for name, pose in truth_poses(scene).items() if name in names}
        print(
            f"{scene}{' with K' if k else ''}: {len(names)} images, at most {args.max} features",
            flush=True,
        )
        for name, program in programs.items():
            if args.only and args.only != name:
                continue
            with tempfile.TemporaryDirectory() as scratch:
                database_path = os.path.join(scratch, "database.db")
                start = time.perf_counter()
                if name == OURS:
                    match_tiepoint(folder, names, k, scratch)
                else:
                    match_colmap(folder, names, program(images, args.max, 2)[0], k, database_path)
                matching_s = time.perf_counter() - start
                db = pycolmap.Database.open(database_path)
                found = (
                    f"{db.num_keypoints() / len(names):6.0f} features, {db.num_matches():7d}"
                    f" matches, {db.num_inlier_matches():7d} verified"
                )
                db.close()
                for seed in range(args.seeds):
                    start = time.perf_counter()
                    model = reconstruct(folder, k, seed, database_path)
                    print(
                        f"  {name:20s} {found}, {worth(model, truth)} ({matching_s:.0f} +"
                        f" {time.perf_counter() - start:.0f} s)",
                        flush=True,
                    )


def worth(model, truth):
    """What a model is like, and how far from the truth."""
    if model is None:
        return "no model"
    line = (
        f"{model.num_reg_images():3d} images, {model.num_points3D():6d} points,"
        f" {model.compute_num_observations():7d} observations, track"
        f" {model.compute_mean_track_length():.3f},"
        f" {model.compute_mean_reprojection_error():.4f} px"
    )
    if truth:
        poses = [
            (i.projection_center(), truth[i.name][1]) for i in model.images.values() if i.has_pose
        ]
        ours, true = map(np.array, zip(*poses))
        error = np.linalg.norm(align(ours, true) - true, axis=1)
        errors = pose_errors(model, truth)
        line += (
            f", centres {1000 * error.mean():.2f} mm, AUC@"
            + "/".join(map(str, AUC_DEGREES))
            + " "
            + " ".join(f"{auc(errors, limit):.4f}" for limit in AUC_DEGREES)
            + f", median {np.median(errors):.4f} deg"
        )
    return line


if __name__ == "__main__":
    main()
