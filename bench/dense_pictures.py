#!/usr/bin/env python3
"""Pictures of two dense clouds of one model, beside each other and from two sides.

    pip install numpy opencv-python pycolmap==4.2.1
    python bench/dense_pictures.py MODEL OURS.ply OTHER.ply -o PICTURE.jpg [--image NAME]
        [--turn 25] [--crop 0.02]

MODEL is the folder of the sparse model (`dense/sparse` of a workspace) of both clouds. Each row is
a cloud, each column a side: the camera of the image NAME (by default the middle one), turned by so
many degrees to the left and to the right around the median of the points that it sees. A point
covers the pixels of its footprint; the nearest one shows."""

import argparse
import pathlib

import cv2
import numpy as np
import pycolmap

from dense import coloured_cloud_of

WIDTH = 640


def splat(points, colours, turn, shift, focal, size, footprint):
    """The picture of points that a camera with centred principal point sees."""
    width, height = size
    x, y, z = (points @ turn.T + shift).T
    with np.errstate(divide="ignore", invalid="ignore"):
        u, v = focal * x / z + width / 2, focal * y / z + height / 2
    inside = (z > 0) & (u > -1) & (v > -1) & (u < width) & (v < height)
    order = np.nonzero(inside)[0][np.argsort(-z[inside])]
    u, v, z, colours = u[order], v[order], z[order], colours[order]
    # Half the size of a point, in pixels.
    reach = np.clip(np.ceil(0.5 * footprint[order] * focal / z - 0.5), 0, 2).astype(int)
    depth, picture = np.full((height, width), np.inf), np.full((height, width, 3), 255, np.uint8)
    for dy in range(-2, 3):
        for dx in range(-2, 3):
            chosen = reach >= max(abs(dx), abs(dy))
            column, row = np.floor(u[chosen]).astype(int) + dx, np.floor(v[chosen]).astype(int) + dy
            inside = (column >= 0) & (row >= 0) & (column < width) & (row < height)
            column, row = column[inside], row[inside]
            far, colour = z[chosen][inside], colours[chosen][inside]
            # The farthest point comes first, so that the nearest one is written last.
            before = depth[row, column]
            nearer = far < before
            depth[row[nearer], column[nearer]] = far[nearer]
            picture[row[nearer], column[nearer]] = colour[nearer]
    return picture


def around(axis, angle):
    return cv2.Rodrigues(np.asarray(axis, float) * np.radians(angle))[0]


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("model", type=pathlib.Path)
    parser.add_argument("clouds", nargs="+", type=pathlib.Path)
    parser.add_argument("-o", "--output", type=pathlib.Path, required=True)
    parser.add_argument("--image")
    parser.add_argument("--turn", type=float, default=25)
    parser.add_argument("--back", type=float, default=1.1, help="distance over that of the camera")
    parser.add_argument("--quality", type=int, default=80)
    options = parser.parse_args()
    model = pycolmap.Reconstruction(options.model)
    images = sorted(model.images.values(), key=lambda image: image.name)
    images = [image for image in images if image.has_pose]
    chosen = images[len(images) // 2]
    if options.image:
        chosen = next(image for image in images if image.name == options.image)
    camera = model.cameras[chosen.camera_id]
    pose = chosen.cam_from_world().matrix()
    seen = [model.points3D[p.point3D_id].xyz for p in chosen.points2D if p.has_point3D()]
    in_camera = np.array(seen) @ pose[:, :3].T + pose[:, 3]
    middle = np.median(in_camera, axis=0)
    scale = WIDTH / camera.width
    size = (WIDTH, round(camera.height * scale))
    focal = camera.mean_focal_length() * scale
    centres = np.array([image.projection_center() for image in images])
    rows = []
    for path in options.clouds:
        points, colours = coloured_cloud_of(path)
        # The footprint of a pixel in the photo of the nearest camera.
        near = np.full(len(points), np.inf)
        for centre in centres:
            near = np.minimum(near, np.linalg.norm(points - centre, axis=1))
        footprint = near / camera.mean_focal_length()
        row = []
        for angle in (-options.turn, options.turn):
            turn = around([0, 1, 0], angle)
            # The camera turns around the middle of what it sees, and goes back.
            shift = middle - turn @ middle + [0, 0, (options.back - 1) * middle[2]]
            picture = splat(
                points, colours, turn @ pose[:, :3], turn @ pose[:, 3] + shift, focal, size,
                footprint,
            )
            row.append(picture)
        rows.append(np.hstack(row))
    picture = cv2.cvtColor(np.vstack(rows), cv2.COLOR_RGB2BGR)
    cv2.imwrite(str(options.output), picture, [cv2.IMWRITE_JPEG_QUALITY, options.quality])


if __name__ == "__main__":
    main()
