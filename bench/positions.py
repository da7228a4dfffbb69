#!/usr/bin/env python3
"""What measured positions of the photos do: drives of keypoints with their truth, photos with
positions in EXIF, and control points.

    cargo build --release -p tiepoint -p tiepoint-sfm --example positions --bin tiepoint
    python bench/positions.py drives [--length 600] [--seeds 5] [--clock]
    python bench/positions.py photos FOLDER
    cargo build --release -p tiepoint-pipeline --example control_points
    python bench/positions.py points [--seeds 8] [--ceres]

`drives` prints the table of the example `positions`: the root mean square distance of the cameras
from the truth, without positions in the adjustments, with them, and of what is kept; with `--clock`
the errors of the clock offset and the lever arm of tracks, beside their deviations. `photos`
reconstructs a folder without positions, then with them, and prints what the program says of them,
and of both models the photos, the reprojection error and the time of mapping. `points` prints the
tables of the example `control_points`: errors of check points, and wrong points that are named;
with `--ceres` also those of the same problems, of the first seed, solved by Ceres with residuals
that are written here."""

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


def reprojection(pyceres, pixel, sigma_px):
    """The reprojection error of a SIMPLE_RADIAL camera: quaternion xyzw, translation, point,
    intrinsics."""

    class Reprojection(pyceres.CostFunction):
        def __init__(self):
            pyceres.CostFunction.__init__(self)
            self.set_num_residuals(2)
            self.set_parameter_block_sizes([4, 3, 3, 4])

        def Evaluate(self, parameters, residuals, jacobians):
            q, t, point, (f, cx, cy, k) = (block.tolist() for block in parameters)
            x, y, z = point
            a, b, c, w = q
            # v x X, then X + 2 w v x X + 2 v x (v x X).
            vx, vy, vz = b * z - c * y, c * x - a * z, a * y - b * x
            px = x + 2 * (w * vx + b * vz - c * vy) + t[0]
            py = y + 2 * (w * vy + c * vx - a * vz) + t[1]
            pz = z + 2 * (w * vz + a * vy - b * vx) + t[2]
            u, v = px / pz, py / pz
            r2 = u * u + v * v
            d = 1 + k * r2
            residuals[0] = (f * d * u + cx - pixel[0]) / sigma_px
            residuals[1] = (f * d * v + cy - pixel[1]) / sigma_px
            if jacobians is None:
                return True
            s = f / sigma_px
            du, dv = [d + 2 * k * u * u, 2 * k * u * v], [2 * k * u * v, d + 2 * k * v * v]
            in_camera = [
                [s * g[0] / pz, s * g[1] / pz, -s * (g[0] * u + g[1] * v) / pz] for g in (du, dv)
            ]
            dot = a * x + b * y + c * z
            xs, vs = (x, y, z), (a, b, c)
            cross = ((0, -z, y), (z, 0, -x), (-y, x, 0))
            by_v = [
                [
                    -2 * w * cross[i][j]
                    + 2 * ((dot if i == j else 0) + vs[i] * xs[j] - 2 * xs[i] * vs[j])
                    for j in range(3)
                ]
                for i in range(3)
            ]
            by_w = (2 * vx, 2 * vy, 2 * vz)
            rotation = (
                (1 - 2 * (b * b + c * c), 2 * (a * b - c * w), 2 * (a * c + b * w)),
                (2 * (a * b + c * w), 1 - 2 * (a * a + c * c), 2 * (b * c - a * w)),
                (2 * (a * c - b * w), 2 * (b * c + a * w), 1 - 2 * (a * a + b * b)),
            )
            if jacobians[0] is not None:
                jacobians[0][:] = [
                    sum(row[i] * column[i] for i in range(3))
                    for row in in_camera
                    for column in (*zip(*by_v), by_w)
                ]
            if jacobians[1] is not None:
                jacobians[1][:] = [value for row in in_camera for value in row]
            if jacobians[2] is not None:
                jacobians[2][:] = [
                    sum(row[i] * rotation[i][j] for i in range(3))
                    for row in in_camera
                    for j in range(3)
                ]
            if jacobians[3] is not None:
                jacobians[3][:] = [
                    value / sigma_px
                    for value in (d * u, 1, 0, f * r2 * u, d * v, 0, 1, f * r2 * v)
                ]
            return True

    return Reprojection()


def prior(pyceres, np, mean, sigma):
    class Prior(pyceres.CostFunction):
        def __init__(self):
            pyceres.CostFunction.__init__(self)
            self.set_num_residuals(3)
            self.set_parameter_block_sizes([3])

        def Evaluate(self, parameters, residuals, jacobians):
            residuals[:] = (parameters[0] - mean) / sigma
            if jacobians is not None and jacobians[0] is not None:
                jacobians[0][:] = (np.eye(3) / sigma).ravel()
            return True

    return Prior()


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
    """Root mean square distance of the check points, in metres: of tiepoint's model, and of the
    same problem from the model before, solved by Ceres."""
    import numpy as np
    import pyceres
    import pycolmap

    before, after = (pycolmap.Reconstruction(folder / name) for name in ["before", "after"])
    points = read_points(np, folder / "points.csv")
    check = {name: point for name, point in points.items() if name.startswith("CHK-")}
    control = {name: point for name, point in points.items() if name not in check}

    def views_of(model):
        views = {}
        for image in model.images.values():
            pose = image.cam_from_world()
            rotation, translation = pose.rotation.matrix(), np.array(pose.translation)
            views[image.name] = (rotation, translation, np.array(model.cameras[1].params))
        return views

    def rms_m(views):
        errors = [triangulated(np, views, p["marks"]) - p["xyz"] for p in check.values()]
        return math.sqrt(np.mean([error @ error for error in errors]))

    # The similarity of the control points (Umeyama 1991).
    views = views_of(before)
    source = np.array([triangulated(np, views, p["marks"]) for p in control.values()])
    target = np.array([p["xyz"] for p in control.values()])
    a, b = source - source.mean(0), target - target.mean(0)
    u, s, vt = np.linalg.svd(b.T @ a)
    sign = np.diag([1, 1, np.sign(np.linalg.det(u @ vt))])
    rotation, scale = u @ sign @ vt, (s @ np.diag(sign)) / (a**2).sum()
    translation = target.mean(0) - scale * rotation @ source.mean(0)
    similarity = pycolmap.Sim3d(scale, pycolmap.Rotation3d(rotation), translation)
    before.transform(similarity)

    residuals = []
    for point in after.points3D.values():
        for element in point.track.elements:
            image = after.images[element.image_id]
            found = image.project_point(point.xyz)
            residuals.append(found - image.points2D[element.point2D_idx].xy)
    # The median norm of two normal variables is 1.1774.
    sigma_px = float(np.median(np.linalg.norm(residuals, axis=1))) / 1.1774
    problem = pyceres.Problem()
    intrinsics = np.array(before.cameras[1].params)
    poses, landmarks, by_name = {}, {}, {}
    for image in before.images.values():
        pose = image.cam_from_world()
        poses[image.image_id] = (np.array(pose.rotation.quat), np.array(pose.translation))
        by_name[image.name] = poses[image.image_id]
    keep = []

    def add(pose, landmark, pixel, sigma, loss):
        cost = reprojection(pyceres, pixel.tolist(), sigma)
        keep.append(cost)
        problem.add_residual_block(cost, loss, [*pose, landmark, intrinsics])

    for point_id, point in before.points3D.items():
        landmarks[point_id] = np.array(point.xyz)
        for element in point.track.elements:
            pixel = before.images[element.image_id].points2D[element.point2D_idx].xy
            loss = pyceres.CauchyLoss(CAUCHY)
            add(poses[element.image_id], landmarks[point_id], pixel, sigma_px, loss)
    views = views_of(before)
    for name, point in control.items():
        landmarks[name] = triangulated(np, views, point["marks"])
        for image, pixel in point["marks"]:
            add(by_name[image], landmarks[name], pixel, point["sigma_px"], None)
        cost = prior(pyceres, np, point["xyz"], point["sigma"])
        keep.append(cost)
        problem.add_residual_block(cost, None, [landmarks[name]])
    for quaternion, _ in poses.values():
        problem.set_manifold(quaternion, pyceres.EigenQuaternionManifold())
    problem.set_manifold(intrinsics, pyceres.SubsetManifold(4, [1, 2]))
    options = pyceres.SolverOptions()
    options.linear_solver_type = pyceres.LinearSolverType.SPARSE_SCHUR
    options.max_num_iterations = 200
    options.function_tolerance = 1e-9
    summary = pyceres.SolverSummary()
    pyceres.solve(options, problem, summary)
    views = {}
    for image in before.images.values():
        quaternion, translation = poses[image.image_id]
        views[image.name] = (pycolmap.Rotation3d(quaternion).matrix(), translation, intrinsics)
    return rms_m(views_of(after)), rms_m(views), summary.num_successful_steps


def points(args):
    example = TARGET / "release/examples/control_points"
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run([example, "--seeds", str(args.seeds), "--write", folder], check=True)
        if args.ceres:
            print("\n| scene | tiepoint, cm | Ceres, cm | steps of Ceres |\n|---|--:|--:|--:|")
            for scene in sorted(Path(folder).iterdir()):
                ours, theirs, steps = ceres(scene)
                print(f"| {scene.name} | {100 * ours:.3f} | {100 * theirs:.3f} | {steps} |")


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
    command.add_argument("--ceres", action="store_true", help="also by pyceres and pycolmap")
    command.set_defaults(run=points)
    args = parser.parse_args()
    args.run(args)


if __name__ == "__main__":
    main()
