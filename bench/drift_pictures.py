#!/usr/bin/env python3
"""The dense clouds of `tiepoint experiment baseline` from above, as Figures 3 and 4 of the paper.

    pip install numpy scipy matplotlib
    tiepoint experiment baseline --route open --length 520 --rate 5 -o FOLDER
    python bench/drift_pictures.py FOLDER/baseline -o PICTURE.jpg [--rows off paper auto]

A column for each row of the table: its cloud, aligned to the truth by its cameras, with the true
path; below, the part whose mean distance to the scan is largest in the first row. Colours are the
distances to the cloud of the true cameras."""

import argparse
import json
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from dense import coloured_cloud_of
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

VOXEL_M = 0.15
MAX_HEIGHT_M = 12.0
MAX_RANGE_M = 30.0
MAX_COLOUR_M = 1.0


def thinned(points, colours):
    """One point in each voxel."""
    _, first = np.unique(np.floor(points / VOXEL_M).astype(int), axis=0, return_index=True)
    return points[first], colours[first]


def cloud_of(workspace, world_from_model):
    points, colours = coloured_cloud_of(workspace / "dense/fused.ply")
    if world_from_model is not None:
        scale, w, x, y, z, *translation = world_from_model
        turn = Rotation.from_quat([x, y, z, w]).as_matrix()
        points = scale * points @ turn.T + translation
    return thinned(points, colours)


def true_path(drive):
    lines = (drive / "truth/poses.csv").read_text().splitlines()[1:]
    centres = []
    for line in lines:
        name, _, w, x, y, z, *translation = line.split(",")
        if name.startswith("left/"):
            turn = Rotation.from_quat([float(v) for v in (x, y, z, w)]).as_matrix()
            centres.append(-turn.T @ np.array(translation, float))
    return np.array(centres)


def from_above(points, colours, box, size_px):
    """Mean colour of the points of each cell; white where there are none."""
    (left, bottom), side = box
    cell = side / size_px
    at = np.floor((points[:, :2] - (left, bottom)) / cell).astype(int)
    inside = ((at >= 0) & (at < size_px)).all(axis=1)
    flat = at[inside, 1] * size_px + at[inside, 0]
    count = np.bincount(flat, minlength=size_px**2)
    sums = [np.bincount(flat, colours[inside, c], size_px**2) for c in range(3)]
    with np.errstate(invalid="ignore"):
        picture = np.column_stack(sums) / count[:, None]
    picture[count == 0] = 255
    return picture.reshape(size_px, size_px, 3).astype(np.uint8)


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("experiment", type=Path)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--rows", nargs="+", default=["off", "paper", "auto"])
    parser.add_argument("--side", type=float, default=60.0, help="of the part, in metres")
    options = parser.parse_args()
    runs = {
        row: json.loads((options.experiment / row / "evaluation.json").read_text())["result"]
        for row in options.rows
    }
    path = true_path(options.experiment / "drive")
    truth, _ = cloud_of(options.experiment / "true", None)
    near = cKDTree(path).query(truth, distance_upper_bound=MAX_RANGE_M)[0] < MAX_RANGE_M
    near &= truth[:, 2] < path[:, 2].max() + MAX_HEIGHT_M
    tree = cKDTree(truth[near])
    # The part of the drive where the first row is farthest from the scan, beyond the true cameras.
    first = runs[options.rows[0]]
    along = np.array(first["dense"]["along"])
    exact = dict(map(tuple, np.round(first["exact_dense"]["along"], 3)))
    excess = np.array([y - exact.get(round(x, 3), y) for x, y in along])
    smooth = np.convolve(excess, np.ones(15) / 15, "same")
    length = np.r_[0, np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))]
    worst = np.array([np.interp(along[smooth.argmax(), 0], length, path[:, c]) for c in range(2)])
    part = (worst - options.side / 2, options.side)
    middle, reach = (path[:, :2].max(0) + path[:, :2].min(0)) / 2, np.ptp(path[:, :2], axis=0).max()
    whole = (middle - 0.55 * reach, 1.1 * reach)

    figure, axes = plt.subplots(
        2, len(runs), figsize=(3.4 * len(runs), 6.4), dpi=110, squeeze=False,
        gridspec_kw={"hspace": 0.12, "wspace": 0.14},
    )
    for (row, run), (above, below) in zip(runs.items(), axes.T):
        points, _ = cloud_of(options.experiment / row, run["world_from_model"])
        points = points[points[:, 2] < path[:, 2].max() + MAX_HEIGHT_M]
        points = points[cKDTree(path).query(points)[0] < MAX_RANGE_M]
        distance = tree.query(points, workers=2)[0]
        shades = 255 * plt.get_cmap("turbo")(np.clip(distance / MAX_COLOUR_M, 0, 1))[:, :3]
        for axis, box, size_px in ((above, whole, 420), (below, part, 420)):
            extent = (box[0][0], box[0][0] + box[1], box[0][1], box[0][1] + box[1])
            axis.imshow(from_above(points, shades, box, size_px), origin="lower", extent=extent)
            axis.plot(*path[:, :2].T, color="k", lw=0.7)
            axis.set_xlim(extent[:2])
            axis.set_ylim(extent[2:])
        above.add_patch(plt.Rectangle(part[0], part[1], part[1], fill=False, color="k", lw=1))
        mean = run["dense"]["distance"]["mean_m"]
        above.set_title(f"{row}: ATE {run['ate_m']:.2f} m, to the scan {mean:.3f} m", fontsize=9)
    for axis in figure.axes:
        axis.tick_params(labelsize=7)
    bar = plt.cm.ScalarMappable(plt.Normalize(0, MAX_COLOUR_M), "turbo")
    bar = figure.colorbar(bar, ax=axes, fraction=0.02, pad=0.01)
    bar.set_label("distance to the cloud of the true cameras, m", fontsize=7)
    bar.ax.tick_params(labelsize=7)
    figure.savefig(options.output, bbox_inches="tight", pil_kwargs={"quality": 82})


if __name__ == "__main__":
    main()
