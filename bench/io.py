#!/usr/bin/env python3
"""Do COLMAP and tiepoint-io read each other's models and databases, number by number?

    pip install pycolmap==4.2.1 numpy
    python bench/io.py [MODEL_FOLDER DATABASE]     (from the repository; builds two examples)

COLMAP makes a scene with rigs, a model (binary and text) and a database; tiepoint-io reads them and
writes its own; COLMAP reads those; both are compared. With arguments, COLMAP only opens a model and
a database that tiepoint wrote."""

import pathlib
import sqlite3
import subprocess
import sys
import tempfile

import numpy as np
import pycolmap
from program import ROOT


def example(name, *arguments):
    command = [
        "cargo",
        "run",
        "-q",
        "-p",
        "tiepoint-io",
        "--features",
        "database",
        "--example",
        name,
        "--",
    ]
    print(
        "  ",
        name,
        subprocess.run(
            command + [str(a) for a in arguments],
            cwd=ROOT,
            check=True,
            text=True,
            stdout=subprocess.PIPE,
        ).stdout.strip(),
    )


def pose(rigid):
    return np.concatenate([rigid.rotation.quat, rigid.translation])


def facts(model):
    """All numbers of a model, keyed by names; points by their position in the order of their
    ids."""
    points = {point_id: index for index, point_id in enumerate(sorted(model.points3D))}
    images = {}
    for image in model.images.values():
        xy = np.array([p.xy for p in image.points2D]).reshape(-1, 2)
        seen = [points[p.point3D_id] if p.has_point3D() else -1 for p in image.points2D]
        images[image.name] = (
            pose(image.cam_from_world()),
            xy,
            seen,
            model.cameras[image.camera_id].params,
        )
    track = lambda p: sorted(
        (model.images[e.image_id].name, e.point2D_idx) for e in p.track.elements
    )
    cloud = [(p.xyz, p.color, track(p)) for _, p in sorted(model.points3D.items())]
    rigs = [
        (r.ref_sensor_id.id, {s.id: pose(r.sensor_from_rig(s)) for s in r.non_ref_sensors})
        for _, r in sorted(model.rigs.items())
    ]
    frames = sorted(
        (sorted(model.images[d.id].name for d in f.data_ids), list(pose(f.rig_from_world)))
        for f in model.frames.values()
        if f.has_pose
    )
    return images, cloud, rigs, frames


def same(a, b, path="model"):
    if isinstance(a, dict):
        assert a.keys() == b.keys(), f"{path}: {a.keys()} != {b.keys()}"
        for key in a:
            same(a[key], b[key], f"{path}/{key}")
    elif isinstance(a, (list, tuple)):
        assert len(a) == len(b), f"{path}: {len(a)} != {len(b)}"
        for index, (x, y) in enumerate(zip(a, b)):
            same(x, y, f"{path}/{index}")
    else:
        # COLMAP normalises quaternions when it reads; all else is bit by bit.
        assert (
            np.allclose(a, b, rtol=0, atol=1e-15) if not isinstance(a, str) else a == b
        ), f"{path}: {a} != {b}"


def models(work):
    for name, rigs, cameras in [("alone", 2, 1), ("rig", 2, 3)]:
        options = pycolmap.SyntheticDatasetOptions(
            num_rigs=rigs, num_cameras_per_rig=cameras, num_frames_per_rig=5, num_points3D=50
        )
        options.camera_model_id = pycolmap.CameraModelId.SIMPLE_RADIAL
        scene = pycolmap.synthesize_dataset(options)
        for kind in ["binary", "text"]:
            for back in ["binary", "text"]:
                theirs, ours = work / f"{name}-{kind}", work / f"{name}-{kind}-{back}"
                theirs.mkdir(exist_ok=True)
                getattr(scene, f"write_{kind}")(theirs)
                example("convert_model", theirs, ours, back)
                read = pycolmap.Reconstruction(ours)
                same(facts(scene), facts(read))
                error = scene.compute_mean_reprojection_error()
                assert abs(error - read.compute_mean_reprojection_error()) < 1e-9
        print(f"{name}: the same numbers, binary and text, both ways")


def rows(path, table):
    with sqlite3.connect(path) as db:
        names = [row[1] for row in db.execute(f"PRAGMA table_info({table})")]
        return names, db.execute(f"SELECT * FROM {table} ORDER BY 1, 2").fetchall()


def databases(work):
    theirs, ours = work / "theirs.db", work / "ours.db"
    db = pycolmap.Database.open(theirs)
    options = pycolmap.SyntheticDatasetOptions(
        num_rigs=2, num_cameras_per_rig=2, num_frames_per_rig=4, num_points3D=200
    )
    pycolmap.synthesize_dataset(options, db)
    db.close()
    example("copy_database", theirs, ours)
    for table in [
        "cameras",
        "rigs",
        "rig_sensors",
        "frames",
        "frame_data",
        "images",
        "matches",
        "two_view_geometries",
    ]:
        (their_names, their_rows), (our_names, our_rows) = rows(theirs, table), rows(ours, table)
        assert their_names == our_names, table
        assert their_rows == our_rows, (table, their_rows[:2], our_rows[:2])
    with sqlite3.connect(ours) as a, sqlite3.connect(theirs) as b:
        tables = lambda db: sorted(
            (row[0], tuple(db.execute(f"PRAGMA table_info({row[0]})")))
            for row in db.execute("SELECT name FROM sqlite_master")
        )
        assert tables(a) == tables(b)
        assert (
            a.execute("PRAGMA user_version").fetchall()
            == b.execute("PRAGMA user_version").fetchall()
        )
    a, b = pycolmap.Database.open(theirs), pycolmap.Database.open(ours)
    for image in a.read_all_images():
        # Scale and orientation go through f32 and back.
        expected = affine(a.read_keypoints(image.image_id))
        np.testing.assert_allclose(b.read_keypoints(image.image_id), expected, rtol=1e-6, atol=1e-6)
        assert (
            a.read_descriptors(image.image_id).data == b.read_descriptors(image.image_id).data
        ).all()
    print(
        "database: the same rows; COLMAP opens ours:",
        b.num_images(),
        "images,",
        b.num_inlier_matches(),
        "inliers",
    )


def affine(keypoints):
    """COLMAP's six columns for any of its layouts."""
    count, columns = keypoints.shape
    if columns == 6:
        return keypoints
    scale = keypoints[:, 2] if columns == 4 else np.ones(count)
    angle = keypoints[:, 3] if columns == 4 else np.zeros(count)
    c, s = scale * np.cos(angle), scale * np.sin(angle)
    return np.stack([keypoints[:, 0], keypoints[:, 1], c, -s, s, c], axis=1)


if __name__ == "__main__":
    if len(sys.argv) == 3:
        model, db = pycolmap.Reconstruction(sys.argv[1]), pycolmap.Database.open(sys.argv[2])
        print(
            model.summary(),
            db.num_images(),
            "images,",
            db.num_keypoints(),
            "keypoints,",
            db.num_inlier_matches(),
            "inliers",
        )
    else:
        with tempfile.TemporaryDirectory() as folder:
            models(pathlib.Path(folder))
            databases(pathlib.Path(folder))
