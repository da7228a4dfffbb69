#!/usr/bin/env python3
"""How even dense clouds are: the distance of each point to its fourth neighbour, in footprints.

    pip install numpy scipy pycolmap==4.2.1
    python bench/dense_density.py WORKSPACE [WORKSPACE ...]

Each WORKSPACE has been through `tiepoint dense`. The footprint of a point is its depth over the
focal length in the best image that sees it (`fused.ply.vis`). *Thin* is the share of the surface on
which the median of that distance, over a point and its 32 neighbours, exceeds 2.2 footprints: holes
and patches, and not single points at rims. A point stands for the square of its distance, of at
most six footprints."""

import argparse
import json
import pathlib

import numpy as np
import pycolmap
from scipy.spatial import cKDTree

from dense import cloud_of

NEIGHBOURS = 32
QUANTILES = (0.5, 0.9, 0.97)
THIN, FAR = 2.2, 6


def visibility_of(path):
    """Index of a point and index of an image of each pair in `fused.ply.vis`."""
    words = np.fromfile(path, "<u4")
    (total,), words = words[:2].view("<u8"), words[2:]
    points, images, at = [], [], 0
    for point in range(total):
        count = words[at]
        points.append(np.full(count, point))
        images.append(words[at + 1 : at + 1 + count])
        at += 1 + count
    return np.concatenate(points), np.concatenate(images)


def footprints(cloud, workspace):
    model = pycolmap.Reconstruction(workspace / "dense/sparse")
    images = [model.images[number] for number in sorted(model.images)]
    points, seen = visibility_of(workspace / "dense/fused.ply.vis")
    smallest = np.full(len(cloud), np.inf)
    for index, image in enumerate(images):
        chosen = points[seen == index]
        pose = image.cam_from_world().matrix()
        focal = model.cameras[image.camera_id].mean_focal_length()
        depth = cloud[chosen] @ pose[2, :3] + pose[2, 3]
        smallest[chosen] = np.minimum(smallest[chosen], depth / focal)
    return smallest


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("workspaces", nargs="+", type=pathlib.Path)
    for workspace in parser.parse_args().workspaces:
        cloud = cloud_of(workspace / "dense/fused.ply")
        distances, neighbours = cKDTree(cloud).query(cloud, NEIGHBOURS + 1, workers=-1)
        fourth = distances[:, 4] / footprints(cloud, workspace)
        around = np.median(fourth[neighbours], axis=1)
        area = np.minimum(fourth, FAR) ** 2
        found = {
            "workspace": str(workspace),
            "points": len(cloud),
            "fourth_neighbour": [round(float(q), 2) for q in np.quantile(fourth, QUANTILES)],
            "thin_percent": round(100 * float(area[around > THIN].sum() / area.sum()), 1),
        }
        print(json.dumps(found), flush=True)


if __name__ == "__main__":
    main()
