"""Compares `tiepoint model` with pycolmap's functions on the same model.

    pip install numpy pycolmap==4.2.1
    python bench/models.py TIEPOINT MODEL

TIEPOINT is the program, MODEL a folder with a COLMAP model of at least eight images. Prints one
line for each function, with the largest difference of camera centres and points in units of the
extent of the centres, and of rotations in radians; or both programs' counts. pycolmap 4.2.1 has no
function for COLMAP's model_merger.
"""

import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pycolmap

program, source = sys.argv[1], Path(sys.argv[2])
work = Path(tempfile.mkdtemp())
rng = np.random.default_rng(27)


def tiepoint(*words):
    command = [program, "model", *map(str, words), "--json"]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    return json.loads(done.stdout)


def images(model):
    return {i.name: i.cam_from_world() for i in model.images.values() if i.has_pose}


def points(model):
    """The points in an order that does not depend on ids."""
    xyz = np.array([p.xyz for p in model.points3D.values()])
    return xyz[np.lexsort(np.round(xyz, 6).T)]


def compare(name, ours, theirs):
    a, b = images(ours), images(theirs)
    assert a.keys() == b.keys(), (len(a), len(b))
    centre = lambda pose: -pose.rotation.matrix().T @ pose.translation  # noqa: E731
    centres = {key: (centre(a[key]), centre(b[key])) for key in a}
    extent = np.ptp([pair[1] for pair in centres.values()], axis=0).max()
    moved = max(np.linalg.norm(p - q) for p, q in centres.values()) / extent
    turned = max((a[key].rotation.inverse() * b[key].rotation).angle() for key in a)
    p, q = points(ours), points(theirs)
    cloud = np.abs(p - q).max() / extent if p.shape == q.shape else float("nan")
    print(
        f"{name:12} centres {moved:.1e}, rotations {turned:.1e} rad, points {cloud:.1e}, "
        f"{len(a)} images, {len(p)} / {len(q)} points"
    )


model = pycolmap.Reconstruction(source)
similarity = pycolmap.Sim3d(
    1.7, pycolmap.Rotation3d(np.array([0.2, -0.5, 0.1, 0.8])), np.array([3.0, -20.0, 5.0])
)
q = similarity.rotation.quat
(work / "transform.txt").write_text(
    " ".join(f"{v:.17g}" for v in [similarity.scale, q[3], *q[:3], *similarity.translation])
)
tiepoint("transform", source, "--by", work / "transform.txt", "-o", work / "transformed")
transformed = pycolmap.Reconstruction(source)
transformed.transform(similarity)
compare("transform", pycolmap.Reconstruction(work / "transformed"), transformed)

info = tiepoint("info", source)
theirs = {
    "images": model.num_reg_images(),
    "points": model.num_points3D(),
    "observations": model.compute_num_observations(),
    "mean_track_length": model.compute_mean_track_length(),
    "mean_observations_per_image": model.compute_mean_observations_per_reg_image(),
    "mean_reprojection_error_px": model.compute_mean_reprojection_error(),
}
difference = max(abs(info[key] / value - 1) for key, value in theirs.items())
print(f"info         largest relative difference {difference:.1e}")

# Positions with noise of a thousandth of the extent, and one of eight wrong by the extent.
names = sorted(images(transformed))
centres = np.array([transformed.find_image_with_name(n).projection_center() for n in names])
extent = np.ptp(centres, axis=0).max()
positions = centres + rng.normal(0, 1e-3 * extent, centres.shape)
positions[::8] += extent
lines = [f"{n} {x:.17g} {y:.17g} {z:.17g}\n" for n, (x, y, z) in zip(names, positions)]
(work / "positions.txt").write_text("".join(lines))
threshold = 0.01 * extent
tiepoint(
    *["align", source, "--positions", work / "positions.txt", "--max-error", threshold],
    *["-o", work / "aligned"],
)
options = pycolmap.RANSACOptions(max_error=threshold)
found = pycolmap.align_reconstruction_to_locations(model, names, positions, 3, options)
aligned = pycolmap.Reconstruction(source)
aligned.transform(found)
compare("align", pycolmap.Reconstruction(work / "aligned"), aligned)
ours = pycolmap.Reconstruction(work / "aligned")
for name, result in (("tiepoint", ours), ("pycolmap", aligned)):
    errors = [
        np.linalg.norm(result.find_image_with_name(n).projection_center() - c)
        for n, c in zip(names, centres)
    ]
    print(f"  {name} to the true centres: rms {np.sqrt(np.mean(np.square(errors))) / extent:.1e}")

tiepoint("align", source, "--to", work / "transformed", "-o", work / "aligned_to_model")
found = pycolmap.align_reconstructions_via_reprojections(model, transformed)
aligned = pycolmap.Reconstruction(source)
aligned.transform(found)
compare("align --to", pycolmap.Reconstruction(work / "aligned_to_model"), aligned)

tiepoint("crop", source, "--quantiles", "0.1,0.8", "-o", work / "cropped")
cropped = model.crop(model.compute_bounding_box(0.1, 0.8))
compare("crop", pycolmap.Reconstruction(work / "cropped"), cropped)
