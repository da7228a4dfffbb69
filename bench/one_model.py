#!/usr/bin/env python3
"""Why the photos of a walk are in several models, and whether they are rightly in one.

  pip install numpy pycolmap==4.2.1
  tiepoint reconstruct PHOTOS -o WORKSPACE
  python bench/one_model.py WORKSPACE PHOTOS [--last 26.jpg]

Prints, from the database and the models of the workspace, in Markdown:

1. each photo with the next one: putative matches, inliers of the verification, and how many of
   these have a triangulation angle of at least 1.5, 1.0 and 0.5 degrees with the relative pose of
   the pair (estimated again with the camera of the largest model, within 4 px);
2. each photo without a pose in the largest model: its keypoints with a match that observes a point
   of this model (2D-3D correspondences at the moment of failure, as every such photo is tried once
   more when no other is left), with those that the best absolute pose explains within 12 px, and
   its best verified pair with an image of the model;
3. for each model the photos, the points, and the root mean square distance of the centres from the
   EXIF positions in the plane after a similarity, in metres (photos up to `--last`, as a telephone
   may have ceased to measure); neighbours that are out of the order of their names along the
   principal direction of the centres."""

import argparse
import itertools
import sqlite3
from pathlib import Path

import numpy as np
import pycolmap
from colmap import umeyama

# COLMAP's: pair_id = id1 * MAX_IMAGES + id2, id1 < id2.
MAX_IMAGES = 2147483647
ANGLES_DEG = [1.5, 1.0, 0.5]
# Thresholds of verification and of registration.
PAIR_PX, POSE_PX = 4.0, 12.0
EARTH_RADIUS_M = 6_371_000.0


class Workspace:
    """The database and the models, by names of images."""

    def __init__(self, folder):
        database = sqlite3.connect(folder / "database.db")
        self.names = dict(database.execute("SELECT image_id, name FROM images"))
        self.cameras = dict(database.execute("SELECT name, camera_id FROM images"))
        self.keypoints = {
            self.names[image]: np.frombuffer(data or b"", np.float32).reshape(rows, cols)[:, :2]
            for image, rows, cols, data in database.execute("SELECT * FROM keypoints")
        }
        self.putative = self.pairs(database, "matches")
        self.verified = self.pairs(database, "two_view_geometries")
        folders = sorted((folder / "sparse").iterdir(), key=lambda path: int(path.name))
        self.models = [pycolmap.Reconstruction(path) for path in folders]

    def pairs(self, database, table):
        found = {}
        for pair, rows, data in database.execute(f"SELECT pair_id, rows, data FROM {table}"):
            matches = np.frombuffer(data or b"", np.uint32).reshape(rows, 2)
            a, b = self.names[pair // MAX_IMAGES], self.names[pair % MAX_IMAGES]
            found[a, b], found[b, a] = matches, matches[:, ::-1]
        return found

    def camera_of(self, name):
        """The camera of a photo in the largest model that has it."""
        models = [model for model in self.models if self.cameras[name] in model.cameras]
        return models[0].cameras[self.cameras[name]]


def posed(model):
    return {image.name: image for image in model.images.values() if image.has_pose}


def angles(workspace, a, b, seed=0):
    """The triangulation angles of the inliers of a pair, in degrees."""
    matches = workspace.verified.get((a, b), np.zeros((0, 2), np.uint32))
    if len(matches) < 8:
        return np.zeros(0)
    cameras = [workspace.camera_of(name) for name in (a, b)]
    pixels = [workspace.keypoints[name].astype(float) for name in (a, b)]
    options = pycolmap.TwoViewGeometryOptions()
    options.ransac.max_error, options.ransac.random_seed = PAIR_PX, seed
    options.compute_relative_pose = True
    found = pycolmap.estimate_calibrated_two_view_geometry(
        cameras[0], pixels[0], cameras[1], pixels[1], matches, options
    )
    pose, inliers = found.cam2_from_cam1, found.inlier_matches
    if pose is None:
        return np.zeros(0)
    rays = [
        np.column_stack([cameras[k].cam_from_img(pixels[k][inliers[:, k]]), np.ones(len(inliers))])
        for k in (0, 1)
    ]
    rays = [one / np.linalg.norm(one, axis=1)[:, None] for one in rays]
    cosines = np.sum((rays[0] @ pose.rotation.matrix().T) * rays[1], axis=1)
    return np.degrees(np.arccos(np.clip(cosines, -1, 1)))


def correspondences(workspace, model, name):
    """Keypoints of a photo and the points of a model that their matches observe."""
    found = set()
    for other, image in posed(model).items():
        for a, b in workspace.verified.get((name, other), []):
            if image.points2D[b].has_point3D():
                found.add((int(a), image.points2D[b].point3D_id))
    return sorted(found)


def plane_positions(photos, names):
    """EXIF positions in metres east and north of their mean, by name."""
    found = {}
    for name in names:
        bitmap = pycolmap.Bitmap.read(photos / name, True)
        latitude, longitude = bitmap.exif_latitude(), bitmap.exif_longitude()
        if latitude is not None and longitude is not None:
            found[name] = np.radians([longitude, latitude])
    mean = np.mean(list(found.values()), axis=0)
    scale = EARTH_RADIUS_M * np.array([np.cos(mean[1]), 1.0])
    return {name: (position - mean) * scale for name, position in found.items()}


def compare(model, positions):
    """Root mean square distance of the centres from positions, and neighbours out of order."""
    centres = {name: image.projection_center() for name, image in posed(model).items()}
    names = sorted(centres.keys() & positions.keys())
    if len(names) < 3:
        return None, []
    found = np.array([centres[name] for name in names])
    truth = np.array([[*positions[name], 0.0] for name in names])
    # The plane of the centres: a phone is held at one height.
    _, _, axes = np.linalg.svd(found - found.mean(axis=0))
    flat = (found - found.mean(axis=0)) @ axes[:2].T
    errors = []
    for mirror in (1.0, -1.0):
        source = np.column_stack([flat * [1.0, mirror], np.zeros(len(flat))])
        scale, rotation, translation = umeyama(source, truth)
        moved = scale * source @ rotation.T + translation
        errors.append(np.sqrt(np.mean(np.sum((moved - truth) ** 2, axis=1))))
    along = dict(zip(names, flat[:, 0], strict=True))
    forwards = np.sign(along[names[-1]] - along[names[0]])
    steps = itertools.pairwise(names)
    wrong = [f"{a}-{b}" for a, b in steps if forwards * (along[b] - along[a]) < 0]
    return min(errors), wrong


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("workspace", type=Path)
    parser.add_argument("photos", type=Path)
    parser.add_argument("--last", help="the last photo whose EXIF position counts")
    options = parser.parse_args()
    workspace = Workspace(options.workspace)
    names = sorted(workspace.names.values())
    first = workspace.models[0]

    print("| photos | putative | verified | " + " | ".join(f"{a}°" for a in ANGLES_DEG) + " |")
    print("|---|--:|--:|" + "--:|" * len(ANGLES_DEG))
    for a, b in itertools.pairwise(names):
        counts = [len(table.get((a, b), [])) for table in (workspace.putative, workspace.verified)]
        seen = angles(workspace, a, b)
        counts += [int(np.sum(seen >= least)) for least in ANGLES_DEG]
        print(f"| {a} {b} | " + " | ".join(map(str, counts)) + " |")

    print("\n| photo | 2D-3D | inliers | best pair with the model |\n|---|--:|--:|---|")
    for name in (name for name in names if name not in posed(first)):
        pairs = correspondences(workspace, first, name)
        pixels = workspace.keypoints[name][[a for a, _ in pairs]].astype(float)
        points = np.array([first.points3D[point].xyz for _, point in pairs]).reshape(-1, 3)
        ransac = pycolmap.AbsolutePoseEstimationOptions()
        ransac.ransac.max_error = POSE_PX
        camera = workspace.camera_of(name)
        pose = len(pairs) > 3 and pycolmap.estimate_absolute_pose(pixels, points, camera, ransac)
        inliers = pose["num_inliers"] if pose else 0
        matched = ((len(workspace.verified.get((name, o), [])), o) for o in posed(first))
        count, other = max(matched, default=(0, ""))
        print(f"| {name} | {len(pairs)} | {inliers} | {count} with {other} |")

    counted = [name for name in names if options.last is None or name <= options.last]
    positions = plane_positions(options.photos, counted)
    print("\n| model | photos | points | rms to EXIF, m | out of order |\n|---|---|--:|--:|---|")
    for index, model in enumerate(workspace.models):
        rms, wrong = compare(model, positions)
        rms = "-" if rms is None else f"{rms:.1f}"
        images = sorted(posed(model))
        text = f"{len(images)}: {' '.join(name.rsplit('.', 1)[0] for name in images)}"
        print(f"| {index} | {text} | {len(model.points3D)} | {rms} | {' '.join(wrong) or '-'} |")


if __name__ == "__main__":
    main()
