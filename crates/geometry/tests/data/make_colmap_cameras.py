"""Projections and rays of COLMAP's camera models, for the test `colmap_cameras`.

    pip install numpy pycolmap==4.2.1
    python make_colmap_cameras.py > colmap_cameras.txt

Rows: `project MODEL parameters point pixel`, `ray MODEL parameters pixel ray`, and `model ID NAME
parameter names`. COLMAP's perspective and fisheye models image no point with z <= 0; its division
and equirectangular models do, and rows for them have such points. FOV: COLMAP replaces the formula
by a truncated series for r/z < 0.01; the points here are farther from the axis.
"""

import numpy as np
import pycolmap

rng = np.random.default_rng(27)
F, C = [810.5, 795.25], [640.75, 472.25]
LENSES = {
    "SIMPLE_PINHOLE": [F[0], *C],
    "PINHOLE": [*F, *C],
    "SIMPLE_RADIAL": [F[0], *C, -0.12],
    "RADIAL": [F[0], *C, -0.12, 0.03],
    "OPENCV": [*F, *C, -0.12, 0.03, 0.002, -0.004],
    "OPENCV_FISHEYE": [*F, *C, 0.03, -0.02, 0.01, -0.002],
    "FULL_OPENCV": [*F, *C, 0.1, 0.02, 0.002, -0.004, 0.003, 0.2, 0.05, 0.01],
    "FOV": [*F, *C, 0.9],
    "SIMPLE_RADIAL_FISHEYE": [F[0], *C, 0.03],
    "RADIAL_FISHEYE": [F[0], *C, 0.03, -0.02],
    "THIN_PRISM_FISHEYE": [*F, *C, 0.03, -0.02, 0.002, -0.004, 0.01, -0.002, 0.003, -0.001],
    "RAD_TAN_THIN_PRISM_FISHEYE": [
        *[*F, *C, 0.03, -0.02, 0.01, -0.002, 0.001, -0.0003],
        *[0.002, -0.004, 0.003, -0.001, 0.002, 0.0005],
    ],
    "SIMPLE_DIVISION": [F[0], *C, -0.2],
    "DIVISION": [*F, *C, 0.05],
    "SIMPLE_FISHEYE": [F[0], *C],
    "FISHEYE": [*F, *C],
    "EUCM": [*F, *C, 0.6, 1.1],
    "EQUIRECTANGULAR": [1280.0, 640.0],
}
BEHIND = ("SIMPLE_DIVISION", "EQUIRECTANGULAR")


def row(tag, *values):
    print(tag, *[f"{v:.17g}" for value in values for v in np.ravel(value)])


print(f"# COLMAP {pycolmap.__version__}, make_colmap_cameras.py")
for model in pycolmap.CameraModelId.__members__:
    if model == "INVALID":
        continue
    camera = pycolmap.Camera(model=model, width=1280, height=960, params=LENSES[model])
    names = camera.params_info.replace(" ", "").split(",")
    print("model", int(camera.model), model, *names)
    for index in range(12):
        point = np.array([rng.uniform(-3, 3), rng.uniform(-2, 2), rng.uniform(2.5, 6)])
        if model in BEHIND and index % 3 == 0:
            point[2] *= -1
        pixel = camera.img_from_cam(point)
        row(f"project {model}", LENSES[model], point, pixel)
        ray = camera.cam_ray_from_img(pixel)
        # A ray behind the camera: COLMAP's division model returns the opposite one.
        if model != "SIMPLE_DIVISION" or point[2] > 0:
            row(f"ray {model}", LENSES[model], pixel, ray)
