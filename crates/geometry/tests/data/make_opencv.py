#!/usr/bin/env python3
"""Writes opencv.txt: numbers computed by OpenCV, in our conventions, that tests/geometry/opencv.rs
compares with ours; a lens that OpenCV does not have is COLMAP's.

    pip install numpy opencv-python-headless pycolmap
    python make_opencv.py > opencv.txt

Our pixel centre is (0.5, 0.5), OpenCV's (0, 0): 0.5 is added to cx, cy and to every pixel.
"""

import cv2
import numpy as np
import pycolmap

rng = np.random.default_rng(1)


def row(tag, *values):
    print(tag, *[f"{v:.17g}" for value in values for v in np.ravel(value)])


print(f"# OpenCV {cv2.__version__}, COLMAP {pycolmap.__version__}, make_opencv.py")


# project MODEL: parameters, rotation vector, translation, point in world, pixel
def project(model, focal, centre, distortion, colmap_params):
    k = np.array([[focal[0], 0, centre[0]], [0, focal[1], centre[1]], [0, 0, 1.0]])
    for _ in range(8):
        rotation, translation = rng.uniform(-0.5, 0.5, 3), rng.uniform(-1, 1, 3)
        in_cam = np.array([rng.uniform(-3, 3), rng.uniform(-2, 2), rng.uniform(4, 6)])
        point = cv2.Rodrigues(rotation)[0].T @ (in_cam - translation)
        if model == "OPENCV_FISHEYE":
            pixel = cv2.fisheye.projectPoints(
                point.reshape(1, 1, 3), rotation, translation, k, np.array(distortion)
            )[0]
        else:
            pixel = cv2.projectPoints(
                point.reshape(1, 3), rotation, translation, k, np.array(distortion)
            )[0]
        row(f"project {model}", colmap_params, rotation, translation, point, pixel.ravel() + 0.5)


f, c, c_ours = (810.5, 795.25), (640.25, 471.75), (640.75, 472.25)
project("PINHOLE", f, c, [0, 0, 0, 0.0], [*f, *c_ours])
project("SIMPLE_RADIAL", (f[0], f[0]), c, [-0.12, 0, 0, 0], [f[0], *c_ours, -0.12])
project("RADIAL", (f[0], f[0]), c, [-0.12, 0.03, 0, 0], [f[0], *c_ours, -0.12, 0.03])
project("OPENCV", f, c, [-0.12, 0.03, 0.002, -0.004], [*f, *c_ours, -0.12, 0.03, 0.002, -0.004])
project(
    "OPENCV_FISHEYE", f, c, [0.03, -0.02, 0.01, -0.002], [*f, *c_ours, 0.03, -0.02, 0.01, -0.002]
)

# motion: rotation vector and translation of camera 2 from camera 1, point in camera 1, its image
# points in the planes z = 1 essential: the matrix that OpenCV's findEssentialMat finds for exact
# images of 30 points pose: what recoverPose makes of it (rotation vector and unit translation)
rotation, translation = np.array([0.1, -0.2, 0.05]), np.array([-0.8, 0.1, 0.3])
points = np.stack([rng.uniform(-2, 2, 30), rng.uniform(-2, 2, 30), rng.uniform(4, 8, 30)], 1)
r = cv2.Rodrigues(rotation)[0]
x1 = points[:, :2] / points[:, 2:]
in_cam2 = points @ r.T + translation
x2 = in_cam2[:, :2] / in_cam2[:, 2:]
essential, mask = cv2.findEssentialMat(x1, x2, np.eye(3), cv2.RANSAC, 0.9999, 1e-6)
_, found_r, found_t, _ = cv2.recoverPose(essential, x1, x2, np.eye(3))
row("essential", essential)
row("pose", cv2.Rodrigues(found_r)[0], found_t)
for point, a, b in zip(points, x1, x2):
    row("motion", rotation, translation, point, a, b)

# homography: a calibrated homography of a plane, and OpenCV's decompositions: rotation vector,
# translation, normal, each
normal = np.array([0.1, -0.2, 1.0])
normal /= np.linalg.norm(normal)
h = r + np.outer(translation / 5.0, normal)
_, rotations, translations, normals = cv2.decomposeHomographyMat(h, np.eye(3))
row(
    "homography",
    h,
    *[v for s in zip([cv2.Rodrigues(m)[0] for m in rotations], translations, normals) for v in s],
)

# as project, by COLMAP: the world's frame is the camera's
rng = np.random.default_rng(2)
lens = [*f, *c_ours, 0.03, -0.02, 0.002, -0.004, 0.01, -0.002, 0.003, -0.001]
camera = pycolmap.Camera(model="THIN_PRISM_FISHEYE", width=1280, height=960, params=lens)
for _ in range(8):
    point = np.array([rng.uniform(-3, 3), rng.uniform(-2, 2), rng.uniform(4, 6)])
    row("project THIN_PRISM_FISHEYE", lens, np.zeros(6), point, camera.img_from_cam(point))
