#!/usr/bin/env python3
"""What features are worth: COLMAP's own matcher and mapper run on tiepoint's features and on COLMAP's.

  pip install numpy opencv-python-headless pycolmap
  TIEPOINT_DATA=... python bench/sift_sfm.py [SCENE...] [--with-k] [--seeds N]

Scenes: fountain-P11 and Herz-Jesus-P8 (with the error of camera centres after a similarity), sceaux, temple_ring,
kitti04 (left and right, with the intrinsics of its calib.txt, 10 neighbours before and after in both).
"""
import argparse, glob, os, sys, tempfile, time
import cv2, numpy as np, pycolmap
from sift import Colmap, OpenCV, Tiepoint, DATA

FLAGS = {"tiepoint": [], "tiepoint exact limit": ["--exact"]}


def truth_centres(scene):
    centres = {}
    for path in glob.glob(os.path.join(DATA, scene, "cameras", "*.camera")):
        rows = open(path).read().split("\n")
        centres[os.path.basename(path).removesuffix(".camera")] = np.array(rows[7].split(), float)
    return centres


def align(source, target):
    """Umeyama: the similarity that maps source to target."""
    cs, ct = source.mean(0), target.mean(0)
    u, s, vt = np.linalg.svd((target - ct).T @ (source - cs))
    d = np.diag([1, 1, np.sign(np.linalg.det(u @ vt))])
    r = u @ d @ vt
    scale = np.trace(np.diag(s) @ d) / ((source - cs) ** 2).sum()
    return scale * (source - cs) @ r.T + ct


def reconstruct(folder, names, features, k, seed, database_path):
    reader = pycolmap.ImageReaderOptions()
    if k is not None:
        reader.camera_model = "PINHOLE"
        reader.camera_params = ",".join(map(str, k))
    pycolmap.Database.open(database_path).close()
    pycolmap.import_images(database_path, folder, pycolmap.CameraMode.PER_FOLDER if "/" in names[0] else pycolmap.CameraMode.SINGLE, image_names=names, options=reader)
    db = pycolmap.Database.open(database_path)
    for image in db.read_all_images():
        keypoints, descriptors = features[names.index(image.name)]
        db.write_keypoints(image.image_id, keypoints)
        bytes_ = pycolmap.FeatureDescriptors(pycolmap.FeatureExtractorType.SIFT, np.clip(np.round(descriptors), 0, 255).astype(np.uint8))
        db.write_descriptors(image.image_id, bytes_)
    db.close()
    matching = pycolmap.FeatureMatchingOptions(use_gpu=False, num_threads=2)
    if len(names) <= 50:
        pycolmap.match_exhaustive(database_path, matching_options=matching)
    else:
        frame = lambda name: int(os.path.splitext(os.path.basename(name))[0])
        listed = os.path.join(os.path.dirname(database_path), "pairs.txt")
        with open(listed, "w") as file:
            file.writelines(f"{a} {b}\n" for i, a in enumerate(names) for b in names[i + 1:] if abs(frame(a) - frame(b)) <= 10)
        pairing = pycolmap.ImportedPairingOptions()
        pairing.match_list_path = listed
        pycolmap.match_image_pairs(database_path, matching, pairing, device=pycolmap.Device.cpu)
    options = pycolmap.IncrementalPipelineOptions(num_threads=2, random_seed=seed)
    if k is not None:
        options.ba_refine_focal_length = options.ba_refine_extra_params = False
    with tempfile.TemporaryDirectory() as out:
        models = pycolmap.incremental_mapping(database_path, folder, out, options)
    return max(models.values(), key=lambda m: m.num_reg_images()) if models else None


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("scenes", nargs="*", default=["fountain-P11", "Herz-Jesus-P8"])
    parser.add_argument("--with-k", action="store_true")
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--max", type=int, default=8192)
    parser.add_argument("--only", default="")
    args = parser.parse_args()
    pycolmap.logging.minloglevel = 2
    programs = {"COLMAP": Colmap(), **{n: Tiepoint(*f) for n, f in FLAGS.items()}}
    for scene in args.scenes:
        folder = os.path.join(DATA, scene) if scene == "temple_ring" else os.path.join(DATA, scene, "images")
        paths = [p for e in ("jpg", "JPG", "png") for under in ("*.", "*/*.") for p in glob.glob(os.path.join(folder, under + e))]
        names = sorted(os.path.relpath(p, folder) for p in paths)
        images = [cv2.imread(os.path.join(folder, n), cv2.IMREAD_GRAYSCALE) for n in names]
        k = None
        if args.with_k:
            m = np.loadtxt(os.path.join(DATA, scene, "K.txt"), comments="#")[:3, :3]
            k = (m[0, 0], m[1, 1], m[0, 2] + .5, m[1, 2] + .5)
        if scene.startswith("kitti"):
            m = np.array(open(os.path.join(DATA, scene, "calib.txt")).readline().split()[1:], float).reshape(3, 4)
            k = (m[0, 0], m[1, 1], m[0, 2] + .5, m[1, 2] + .5)
        truth = truth_centres(scene)
        print(f"{scene}{' with K' if args.with_k else ''}: {len(names)} images, at most {args.max} features")
        for name, program in programs.items():
            if args.only and args.only != name:
                continue
            features, _ = program(images, args.max, 2)
            for seed in range(args.seeds):
                with tempfile.TemporaryDirectory() as scratch:
                    start = time.perf_counter()
                    model = reconstruct(folder, names, features, k, seed, os.path.join(scratch, "database.db"))
                    seconds = time.perf_counter() - start
                    db = pycolmap.Database.open(os.path.join(scratch, "database.db"))
                    matches, inliers = db.num_matches(), db.num_inlier_matches()
                    db.close()
                line = f"  {name:20s} {np.mean([len(f[0]) for f in features]):6.0f} features, {matches:7d} matches, {inliers:7d} verified"
                if model is not None:
                    line += (f", {model.num_reg_images():3d} images, {model.num_points3D():6d} points, {model.compute_num_observations():7d} observations,"
                             f" track {model.compute_mean_track_length():.3f}, {model.compute_mean_reprojection_error():.4f} px")
                    if truth:
                        poses = [(i.projection_center(), truth[i.name]) for i in model.images.values() if i.has_pose]
                        ours, true = map(np.array, zip(*poses))
                        error = np.linalg.norm(align(ours, true) - true, axis=1)
                        line += f", centres {1000 * error.mean():.2f} mm"
                print(line + f" ({seconds:.0f} s)", flush=True)


if __name__ == "__main__":
    main()
