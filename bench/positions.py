#!/usr/bin/env python3
"""What measured positions of the photos do: drives of keypoints with their truth, photos with
positions in EXIF, and control points.

    cargo build --release -p tiepoint -p tiepoint-sfm --example positions --bin tiepoint
    python bench/positions.py drives [--length 600] [--seeds 5] [--clock]
    python bench/positions.py photos FOLDER
    cargo build --release -p tiepoint-pipeline --example control_points
    python bench/positions.py points [--seeds 8] [--control 4] [--ceres]

`drives` prints the table of the example `positions`: the root mean square distance of the cameras
from the truth, without positions in the adjustments, with them, and of what is kept; with `--clock`
the errors of the clock offset and the lever arm of tracks, beside their deviations. `photos`
reconstructs a folder without positions, then with them, and prints what the program says of them,
and of both models the photos, the reprojection error and the time of mapping. `points` prints the
tables of the example `control_points`: errors of check points, and wrong points that are named;
with `--ceres` the errors alone, and those of COLMAP's bundle adjustment (Ceres) with the same
points: the models with a wrong lens, which is refined."""

import argparse
import csv
import json
import math
import subprocess
import tempfile
from pathlib import Path

from program import TARGET, program_of


def drives(args):
    example = TARGET / "release/examples/positions"
    arguments = ["--length", str(args.length), "--seeds", str(args.seeds)]
    arguments += ["--clock", "1"] if args.clock else []
    subprocess.run([example, *arguments], check=True)


def photos(args):
    program = program_of(args)
    with tempfile.TemporaryDirectory() as folder:
        workspace = Path(folder) / "ws"
        run = [program, "reconstruct", args.folder, "-o", workspace, "--json"]
        for priors in ["off", "auto"]:
            command = [*run, "--position-priors", priors, "--redo", "map"]
            done = subprocess.run(command, check=True, capture_output=True, text=True)
            report = json.loads(done.stdout)
            model, stage = report["models"][0], report["stages"]["map"]
            print(
                f"{priors}: {model['registered']} of {model['images']} photos,"
                f" {model['mean_reprojection_error_px']:.4f} px, {stage['seconds']:.1f} s"
            )
            for note in stage.get("notes", []):
                print(f"  {note}")


# Scale of the Cauchy loss of keypoints, in standard deviations, as in tiepoint's adjustments.
CAUCHY = 2.385


def read_points(np, path):
    """Surveyed points with their marks by image names."""
    points = {}
    with path.open() as file:
        for row in csv.DictReader(file):
            of_point = points.setdefault(row["point"], {"marks": []})
            of_point["xyz"] = np.array([float(row[axis]) for axis in "xyz"])
            of_point["sigma"] = float(row["sigma"])
            of_point["sigma_px"] = float(row["sigma_px"])
            pixel = np.array([float(row["px"]), float(row["py"])])
            of_point["marks"].append((row["image"], pixel))
    return points


def triangulated(np, views, marks):
    """The point with the least squared reprojection errors, by Gauss-Newton from the linear
    solution. `views` have rotation, translation and intrinsics."""
    rows = []
    for image, pixel in marks:
        rotation, translation, (f, cx, cy, _) = views[image]
        u, v = (pixel - [cx, cy]) / f
        matrix = np.column_stack([rotation, translation])
        rows += [u * matrix[2] - matrix[0], v * matrix[2] - matrix[1]]
    solution = np.linalg.svd(np.array(rows))[2][-1]
    xyz = solution[:3] / solution[3]
    for _ in range(10):
        residuals, jacobians = [], []
        for image, pixel in marks:
            rotation, translation, (f, cx, cy, k) = views[image]
            p = rotation @ xyz + translation
            u = p[:2] / p[2]
            r2 = u @ u
            residuals.append(f * (1 + k * r2) * u + [cx, cy] - pixel)
            by_u = f * ((1 + k * r2) * np.eye(2) + 2 * k * np.outer(u, u))
            by_p = np.array([[1, 0, -u[0]], [0, 1, -u[1]]]) / p[2]
            jacobians.append(by_u @ by_p @ rotation)
        xyz = xyz - np.linalg.lstsq(np.vstack(jacobians), np.concatenate(residuals), rcond=None)[0]
    return xyz


def ceres(folder):
    """Squared distances of the check points from their places, in m2: of tiepoint's model, and of
    the model before that COLMAP's bundle adjustment (Ceres) adjusts with the same points."""
    import numpy as np
    import pyceres
    import pycolmap
    from pycolmap.cost_functions import ReprojErrorCost

    before, after = (pycolmap.Reconstruction(folder / name) for name in ["before", "after"])
    points = read_points(np, folder / "points.csv")
    check = {name: point for name, point in points.items() if name.startswith("CHK-")}
    control = {name: point for name, point in points.items() if name not in check}

    def views_of(model):
        views = {}
        for image in model.images.values():
            if image.has_pose:
                pose = image.cam_from_world()
                rotation, translation = pose.rotation.matrix(), np.array(pose.translation)
                views[image.name] = (rotation, translation, np.array(model.cameras[1].params))
        return views

    def squares_m2(model):
        views = views_of(model)
        errors = [triangulated(np, views, p["marks"]) - p["xyz"] for p in check.values()]
        return [error @ error for error in errors]

    # The similarity of the control points (Umeyama 1991).
    views = views_of(before)
    source = np.array([triangulated(np, views, p["marks"]) for p in control.values()])
    target = np.array([p["xyz"] for p in control.values()])
    a, b = source - source.mean(0), target - target.mean(0)
    u, s, vt = np.linalg.svd(b.T @ a)
    sign = np.diag([1, 1, np.sign(np.linalg.det(u @ vt))])
    rotation, scale = u @ sign @ vt, (s @ np.diag(sign)) / (a**2).sum()
    translation = target.mean(0) - scale * rotation @ source.mean(0)
    before.transform(pycolmap.Sim3d(scale, pycolmap.Rotation3d(rotation), translation))

    residuals = []
    for point in after.points3D.values():
        for element in point.track.elements:
            image = after.images[element.image_id]
            found = image.project_point(point.xyz)
            residuals.append(found - image.points2D[element.point2D_idx].xy)
    # The median norm of two normal variables is 1.1774.
    sigma_px = float(np.median(np.linalg.norm(residuals, axis=1))) / 1.1774

    # COLMAP's residuals of keypoints are in pixels: all squares are in units of the variance of
    # keypoints.
    config = pycolmap.BundleAdjustmentConfig()
    poses = {}
    for image in before.images.values():
        if image.has_pose:
            config.add_image(image.image_id)
            poses[image.name] = image.frame.rig_from_world.params
    options = pycolmap.BundleAdjustmentOptions()
    options.print_summary = False
    options.ceres.loss_function_type = pycolmap.LossFunctionType.CAUCHY
    options.ceres.loss_function_scale = CAUCHY * sigma_px
    adjuster = pycolmap.create_default_ceres_bundle_adjuster(options, config, before)
    problem, camera = adjuster.problem, before.cameras[1]
    views, landmarks = views_of(before), {}
    for name, point in control.items():
        landmarks[name] = triangulated(np, views, point["marks"])
        covariance = (point["sigma_px"] / sigma_px) ** 2 * np.eye(2)
        for image, pixel in point["marks"]:
            cost = ReprojErrorCost(camera.model, covariance, pixel)
            problem.add_residual_block(cost, None, [landmarks[name], poses[image], camera.params])
        covariance = (point["sigma"] / sigma_px) ** 2 * np.eye(3)
        cost = pyceres.factors.NormalPrior(point["xyz"], covariance)
        problem.add_residual_block(cost, None, [landmarks[name]])
    solver = options.ceres.create_solver_options(config, problem)
    solver.max_num_iterations = 200
    # 1e-10 takes three times the steps and moves the check points by 1e-4 cm.
    solver.function_tolerance = 1e-6
    summary = pyceres.SolverSummary()
    pyceres.solve(solver, problem, summary)
    return squares_m2(after), squares_m2(before), summary.num_successful_steps


def points(args):
    example = TARGET / "release/examples/control_points"
    arguments = ["--seeds", str(args.seeds), "--control", str(args.control)]
    if not args.ceres:
        subprocess.run([example, *arguments], check=True)
        return
    with tempfile.TemporaryDirectory() as folder:
        arguments += ["--only", "errors", "--write", folder]
        subprocess.run([example, *arguments], check=True)
        of_scene = {}
        for model in sorted(Path(folder).iterdir()):
            of_scene.setdefault(model.name.split("-")[0], []).append(ceres(model))
    print("\n| scene | seeds | tiepoint, cm | Ceres, cm | largest difference, cm | steps |")
    print("|---|--:|--:|--:|--:|--:|")

    def rms_cm(squares_m2):
        return 100 * math.sqrt(sum(squares_m2) / len(squares_m2))

    for scene, seeds in of_scene.items():
        ours, theirs, steps = zip(*seeds)
        pairs = [[rms_cm(squares) for squares in pair] for pair in zip(ours, theirs)]
        largest = max(abs(a - b) for a, b in pairs)
        ours, theirs = (rms_cm(sum(all_seeds, [])) for all_seeds in (ours, theirs))
        print(
            f"| {scene} | {len(seeds)} | {ours:.3f} | {theirs:.3f} | {largest:.3f}"
            f" | {min(steps)} to {max(steps)} |"
        )


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    commands = parser.add_subparsers(required=True)
    command = commands.add_parser("drives")
    command.add_argument("--length", type=float, default=600)
    command.add_argument("--seeds", type=int, default=5)
    command.add_argument("--clock", action="store_true", help="tracks with a clock of their own")
    command.set_defaults(run=drives)
    command = commands.add_parser("photos")
    command.add_argument("folder")
    command.add_argument("--program", type=Path, help="by default that of the release build")
    command.set_defaults(run=photos)
    command = commands.add_parser("points")
    command.add_argument("--seeds", type=int, default=8)
    command.add_argument("--control", type=int, default=4, help="number of control points")
    command.add_argument("--ceres", action="store_true", help="also by pyceres and pycolmap")
    command.set_defaults(run=points)
    args = parser.parse_args()
    args.run(args)


if __name__ == "__main__":
    main()
