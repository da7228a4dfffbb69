#!/usr/bin/env python3
"""A real rig without calibration: the extrinsics that tiepoint finds from 13 pairs of a chessboard,
beside OpenCV's stereo calibration.

  pip install opencv-python-headless numpy scipy
  cargo build --release
  TIEPOINT_DATA=... python bench/chess.py

The set is OpenCV's (stereo_chess: left01..left14.jpg, right01..right14.jpg, without 10). Two
cameras stand still on a stand and the board is moved before them: seen from the board, the rig
moves. A chessboard's corners look all alike, so that keypoints by appearance match nothing (2 of 26
images): both programs get the same corners, found by OpenCV, and who is who; tiepoint as keypoints
and matches in its database, without the corners' places on the board, with a focal length that is
20 % wrong and no distortion to begin with, OpenCV with their places. Prints the angle between the
two rotations of the extrinsics, the angle between the baselines, and the ratio of focal lengths.

Which of the two is nearer to the truth? OpenCV believes the board to be flat and its corners to be
where they should be. So a third calibration stands beside both: scipy's least squares over the same
corners with OpenCV's lens, cameras rigid to each other and the corners' places free, begun from
OpenCV's calibration; and the jackknife's standard deviation of OpenCV's rotation (Efron 1982: each
pair left out in turn)."""

import argparse
import itertools
import json
import os
import sqlite3
import subprocess
import sys
import tempfile
from pathlib import Path

import cv2
import numpy as np
from program import degrees, program_of
from scipy.optimize import least_squares
from scipy.sparse import lil_matrix
from scipy.spatial.transform import Rotation

CORNERS = (9, 6)
# To begin with, in pixels: 1.2 times what it is.
FOCAL_PRIOR_PX = 640.0
# COLMAP's: pair_id = id1 * MAX_IMAGES + id2, id1 < id2; configuration of a calibrated pair.
MAX_IMAGES = 2147483647
CALIBRATED = 2


def corners_of(path):
    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    found, corners = cv2.findChessboardCorners(image, CORNERS)
    if not found:
        return image, None
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 50, 1e-4)
    return image, cv2.cornerSubPix(image, corners, (5, 5), (-1, -1), criteria)


def board():
    """Its corners as they should be; the unit is a square."""
    grid = np.zeros((CORNERS[0] * CORNERS[1], 3), np.float32)
    grid[:, :2] = np.mgrid[0 : CORNERS[0], 0 : CORNERS[1]].T.reshape(-1, 2)
    return grid


def opencv_calibration(pairs, size):
    """Intrinsics, R and T of right_from_left; the unit is a square of the board."""
    grids = [board()] * len(pairs)
    lefts, rights = [left for left, _ in pairs], [right for _, right in pairs]
    _, k1, d1, _, _ = cv2.calibrateCamera(grids, lefts, size, None, None)
    _, k2, d2, _, _ = cv2.calibrateCamera(grids, rights, size, None, None)
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 200, 1e-9)
    rms, k1, d1, k2, d2, r, t, _, _ = cv2.stereoCalibrate(
        grids,
        lefts,
        rights,
        k1,
        d1,
        k2,
        d2,
        size,
        criteria=criteria,
        flags=cv2.CALIB_USE_INTRINSIC_GUESS,
    )
    return rms, (k1, k2), (d1, d2), r, t.ravel()


def degrees_between(a, b):
    return degrees((np.trace(a @ b.T) - 1) / 2)


def jackknife_deg(pairs, size, r):
    """Standard deviation of the angle of OpenCV's rotation."""
    left_out = [opencv_calibration(pairs[:k] + pairs[k + 1 :], size) for k in range(len(pairs))]
    turns = np.array([Rotation.from_matrix(found[3] @ r.T).as_rotvec() for found in left_out])
    return np.degrees(np.sqrt((len(pairs) - 1) / len(pairs) * ((turns - turns.mean(0)) ** 2).sum()))


def free_board(pairs, size, r, t):
    """Least squares over cameras (f, cx, cy, k1, k2, p1, p2; pixels are square), extrinsics, the
    board's poses and its corners, from a calibration's R and T: rms, principal points, R and T."""
    grid = board()
    count = len(grid)
    lenses, poses = [], []
    for corners in zip(*pairs):
        _, k, d, turns, places = cv2.calibrateCamera(
            [grid] * len(pairs), corners, size, None, None, flags=cv2.CALIB_FIX_K3
        )
        lenses.append([k[0, 0], k[0, 2], k[1, 2], *d.ravel()[:4]])
        poses.append(np.hstack([np.squeeze(turns), np.squeeze(places)]))
    # Seven coordinates hold the board's place, turn and size.
    last, low = 3 * (CORNERS[0] - 1), 3 * (count - CORNERS[0])
    moving = np.setdiff1d(np.arange(3 * count), [0, 1, 2, last, last + 1, last + 2, low + 2])
    rig = np.concatenate([*lenses, Rotation.from_matrix(r).as_rotvec(), t])
    first_pose, first_corner = len(rig), len(rig) + 6 * len(pairs)
    start = np.concatenate([rig, poses[0].ravel(), grid.ravel()[moving]])

    def project(lens, points):
        f, cx, cy, k1, k2, p1, p2 = lens
        a, b = points[:, 0] / points[:, 2], points[:, 1] / points[:, 2]
        r2 = a * a + b * b
        radial = 1 + k1 * r2 + k2 * r2**2
        u = a * radial + 2 * p1 * a * b + p2 * (r2 + 2 * a * a)
        v = b * radial + p1 * (r2 + 2 * b * b) + 2 * p2 * a * b
        return np.stack([f * u + cx, f * v + cy], 1)

    def residuals(x):
        board = grid.astype(float).ravel()
        board[moving] = x[first_corner:]
        rotation, rows = Rotation.from_rotvec(x[14:17]).as_matrix(), []
        for pose, (left, right) in zip(x[first_pose:first_corner].reshape(-1, 6), pairs):
            in_left = board.reshape(-1, 3) @ Rotation.from_rotvec(pose[:3]).as_matrix().T + pose[3:]
            rows.append(project(x[:7], in_left) - left.reshape(-1, 2))
            rows.append(project(x[7:14], in_left @ rotation.T + x[17:20]) - right.reshape(-1, 2))
        return np.concatenate(rows).ravel()

    pattern = lil_matrix((4 * count * len(pairs), len(start)), dtype=int)
    for image in range(2 * len(pairs)):
        rows = slice(2 * count * image, 2 * count * (image + 1))
        pose = first_pose + 6 * (image // 2)
        pattern[rows, :7], pattern[rows, 7:20], pattern[rows, pose : pose + 6] = (
            1 - image % 2,
            image % 2,
            1,
        )
        for column, coordinate in enumerate(moving):
            row = 2 * (count * image + coordinate // 3)
            pattern[row : row + 2, first_corner + column] = 1
    found = least_squares(
        residuals, start, jac_sparsity=pattern, x_scale="jac", max_nfev=200, xtol=1e-12, ftol=1e-12
    )
    rms = np.sqrt((found.fun**2).sum() / (len(found.fun) / 2))
    x = found.x
    return rms, (x[1:3], x[8:10]), Rotation.from_rotvec(x[14:17]).as_matrix(), x[17:20]


def put_corners(database, corners, size):
    """Replaces keypoints, matches and two-view geometries by those of the corners; pixels count
    from the first one's corner."""
    connection = sqlite3.connect(database)
    names = connection.execute("SELECT image_id, name FROM images ORDER BY image_id").fetchall()
    for table in ("keypoints", "descriptors", "matches", "two_view_geometries"):
        connection.execute(f"DELETE FROM {table}")
    points = {image: corners[name].reshape(-1, 2).astype(np.float64) + 0.5 for image, name in names}
    for image, pixels in points.items():
        connection.execute(
            "INSERT INTO keypoints(image_id, rows, cols, data) VALUES (?, ?, 2, ?)",
            (image, len(pixels), pixels.astype("<f4").tobytes()),
        )
    k = np.array([[FOCAL_PRIOR_PX, 0, size[0] / 2], [0, FOCAL_PRIOR_PX, size[1] / 2], [0, 0, 1]])
    for a, b in itertools.combinations(sorted(points), 2):
        count = len(points[a])
        rows = np.repeat(np.arange(count, dtype="<u4")[:, None], 2, axis=1).tobytes()
        essential, _ = cv2.findEssentialMat(points[a], points[b], k, cv2.RANSAC, 0.999, 2.0)
        if essential is None or essential.shape != (3, 3):
            continue
        fundamental = np.linalg.inv(k).T @ essential @ np.linalg.inv(k)
        _, rotation, direction, _ = cv2.recoverPose(essential, points[a], points[b], k)
        x, y, z, w = Rotation.from_matrix(rotation).as_quat()
        pair = a * MAX_IMAGES + b
        connection.execute(
            "INSERT INTO matches(pair_id, rows, cols, data) VALUES (?, ?, 2, ?)",
            (pair, count, rows),
        )
        blob = lambda values: np.asarray(values, "<f8").tobytes()
        connection.execute(
            "INSERT INTO two_view_geometries(pair_id, rows, cols, data, config, F, E, qvec, tvec)"
            " VALUES (?, ?, 2, ?, ?, ?, ?, ?, ?)",
            (
                pair,
                count,
                rows,
                CALIBRATED,
                blob(fundamental),
                blob(essential),
                blob([w, x, y, z]),
                blob(direction.ravel()),
            ),
        )
    connection.commit()
    connection.close()


def run(command):
    done = subprocess.run(
        list(map(str, command)), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    if done.returncode:
        sys.exit(done.stderr.strip().splitlines()[-1])
    return done.stdout


def extrinsics(arguments, program, folder, known, corners, size):
    """The largest model of the report, the rig's second camera, and its R and T, of the corners;
    `known`: options of the intrinsics."""
    workspace = folder / known[0].strip("-")
    run([program, "features", folder / "photos", "-o", workspace, *known])
    run([program, "match", workspace, "--seed", arguments.seed])
    put_corners(workspace / "database.db", corners, size)
    done = run(
        [program, "map", workspace, "--rig", arguments.rig, "--seed", arguments.seed, "--json"]
    )
    model = json.loads(done)["models"][0]
    print(
        f"tiepoint {known[0]}: {model['registered']} of {model['images']} images,"
        f" {model['points']} points, {model['mean_reprojection_error_px']:.3f} px"
    )
    if not (workspace / "rig.json").exists():
        sys.exit("tiepoint: no extrinsics were found")
    camera = json.loads((workspace / "rig.json").read_text())["cameras"][0]
    rotation = Rotation.from_quat(np.roll(camera["rotation_wxyz"], -1)).as_matrix()
    return model, camera, rotation, np.array(camera["translation"])


def calibration_files(folder, k, distortions, size):
    """OpenCV's calibration of both cameras as its own YAML, and the options that name them."""
    options = []
    for name, matrix, distortion in zip(("left", "right"), k, distortions):
        path = folder / f"{name}.yml"
        storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
        storage.write("image_width", size[0])
        storage.write("image_height", size[1])
        storage.write("camera_matrix", matrix)
        storage.write("distortion_coefficients", distortion)
        storage.release()
        options += ["--calibration", f"{name}={path}"]
    return options


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rig", default="rigid")
    parser.add_argument("--seed", default="0")
    parser.add_argument(
        "--work", type=Path, help="where to put the workspace (default: the system's)"
    )
    parser.add_argument("--program", type=Path)
    arguments = parser.parse_args()
    program = program_of(arguments)
    if "TIEPOINT_DATA" not in os.environ:
        sys.exit("SKIPPED: TIEPOINT_DATA is not set")
    data = Path(os.environ["TIEPOINT_DATA"]) / "stereo_chess"
    with tempfile.TemporaryDirectory(dir=arguments.work) as folder:
        folder = Path(folder)
        pairs, by_name, size = [], {}, None
        for left in sorted(data.rglob("left*.jpg")):
            right = left.with_name(left.name.replace("left", "right"))
            found = [corners_of(path) for path in (left, right)]
            size = found[0][0].shape[::-1]
            if any(corners is None for _, corners in found):
                print(f"{left.name}: no board", file=sys.stderr)
                continue
            pairs.append(tuple(corners for _, corners in found))
            for camera, path, (_, corners) in zip(("left", "right"), (left, right), found):
                number = "".join(filter(str.isdigit, path.stem))
                (folder / "photos" / camera).mkdir(parents=True, exist_ok=True)
                (folder / "photos" / camera / f"{number}.jpg").write_bytes(path.read_bytes())
                by_name[f"{camera}/{number}.jpg"] = corners
        rms, (k1, k2), distortions, r, t = opencv_calibration(pairs, size)
        print(
            f"OpenCV: {len(pairs)} pairs, {rms:.3f} px, focal {k1[0, 0]:.1f} / {k2[0, 0]:.1f} px,"
            f" baseline {np.linalg.norm(t):.4f} squares"
        )
        lens = ["--focal-prior", FOCAL_PRIOR_PX, "--camera-model", "OPENCV"]
        model, camera, own_r, own_t = extrinsics(arguments, program, folder, lens, by_name, size)
        direction_from = lambda t: degrees(own_t @ t / np.linalg.norm(own_t) / np.linalg.norm(t))
        angle, direction = degrees_between(own_r, r), direction_from(t)
        focal = [c["params"][0] for c in model["cameras"]]
        ratio = " / ".join(f"{100 * (own / k[0, 0] - 1):+.2f} %" for own, k in zip(focal, (k1, k2)))
        print(
            f"rotation off by {angle:.3f} degrees, direction of the baseline by {direction:.3f}"
            f" degrees, focal lengths by {ratio}"
        )
        middles = [c["params"][2:4] for c in model["cameras"]]
        shifts = ", ".join(
            f"{name} ({own[0] - 0.5 - k[0, 2]:+.2f}, {own[1] - 0.5 - k[1, 2]:+.2f}) px"
            for name, own, k in zip(("left", "right"), middles, (k1, k2))
        )
        print(f"principal points, ours less OpenCV's: {shifts}")
        # What a shift of the principal points alone would turn the extrinsics by.
        turn = [
            np.array([(own[0] - 0.5 - k[0, 2]) / k[0, 0], (own[1] - 0.5 - k[1, 2]) / k[1, 1]])
            for own, k in zip(middles, (k1, k2))
        ]
        print(
            "of which their difference is worth"
            f" {np.degrees(np.linalg.norm(turn[1] - turn[0])):.3f} degrees; our standard deviation"
            f" {camera['rotation_sd_deg']:.3f} degrees, OpenCV's"
            f" {jackknife_deg(pairs, size, r):.3f} by jackknife"
        )
        rms, free_middles, free_r, free_t = free_board(pairs, size, r, t)
        shifts = ", ".join(
            f"{name} ({own[0] - 0.5 - k[0]:+.2f}, {own[1] - 0.5 - k[1]:+.2f}) px"
            for name, own, k in zip(("left", "right"), middles, free_middles)
        )
        print(
            f"scipy, the board's corners free: {rms:.3f} px; rotation"
            f" {degrees_between(free_r, r):.3f} degrees from OpenCV's,"
            f" {degrees_between(free_r, own_r):.3f} from ours; direction"
            f" {direction_from(free_t):.3f} degrees from ours; principal points, ours less these:"
            f" {shifts}"
        )
        known = calibration_files(folder, (k1, k2), distortions, size)
        model, _, own_r, own_t = extrinsics(arguments, program, folder, known, by_name, size)
        changed = max(
            abs(c["params"][i] - value)
            for c, k in zip(model["cameras"], (k1, k2))
            for i, value in ((0, k[0, 0]), (1, k[1, 1]), (2, k[0, 2] + 0.5), (3, k[1, 2] + 0.5))
        )
        print(
            f"with OpenCV's intrinsics given: rotation off by {degrees_between(own_r, r):.3f}"
            f" degrees, direction by {direction_from(t):.3f} degrees; intrinsics changed by"
            f" {changed:.1e} px"
        )


if __name__ == "__main__":
    main()
