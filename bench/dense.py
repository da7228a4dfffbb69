#!/usr/bin/env python3
"""Dense clouds against exact surfaces, beside OpenMVS.

    pip install numpy scipy pycolmap==4.2.1
    cargo build --release
    TIEPOINT_DATA=... python bench/dense.py [CASE ...] [--openmvs DensifyPointCloud] \\
        [--seed 1] [--threads 2] [--size PX] [--results RESULTS.json] [--keep FOLDER]

Cases: `room` (bench/dense_scene.py: no planes), `street` (tiepoint synth), photos (fountain-P11,
sceaux, Herz-Jesus-P8), kitti04, and for time and memory fountain-P11 at 3 megapixels and drives of
100 to 400 images. Each reconstructs the photos, then measures `tiepoint dense` with the model's own
poses; the first two also with the true poses, whose tracks are triangulated again. OpenMVS gets the
scene.mvs of the same model, at the same size and with the same threads; without --openmvs it is
left out, as it is for time and memory.

With truth and true poses, also how many depths are off by over five footprints, among all and among
those of a confidence of at least 0.8.

With truth, a true surface is sampled at every second pixel of every second row that two images see.
Accuracy is the share of the cloud within k footprints of it, completeness the share of it within k
footprints of the cloud; a footprint is the size of a pixel at the surface, in the nearest image
that sees it. A point's distance to the surface is that to the plane of the nearest sample, and the
distance beside it as far as that exceeds the spacing of samples. CPU is user and system time."""

import argparse
import json
import os
import pathlib
import resource
import shutil
import subprocess
import sys
import tempfile

import numpy as np
import pycolmap
from scipy.spatial import cKDTree

import dense_scene
from program import kitti_intrinsics, program_of, tiepoint

SCENES = {"room": (12, (480, 360)), "street": (12, (480, 360))}
PHOTOS = {"fountain-P11": 1024, "sceaux": 1024, "Herz-Jesus-P8": 1024}
KITTI_FRAMES = 16
# Only for time and memory, without OpenMVS: 11 photos of 3 megapixels, and drives.
LARGE, LARGE_SIDE = "fountain-P11 3 megapixels", 2121
DRIVES = {f"drive of {count} images": count for count in (100, 200, 400)}
DRIVE_SIZE = (240, 180)
FOOTPRINTS = [1, 2, 5]
# Confidence from which on at most 5 % of the depths are off by over five footprints.
CONFIDENT = 0.8
# Samples are two pixels apart, so that the nearest one is up to √2 pixels aside.
SPACING = 2**0.5
# Largest distance of a lidar point to a cloud that covers it, in metres: three cells of the
# reference.
LIDAR_REACH_M = 0.3

# Types of PLY by both of their names.
TYPES = {"float": "<f4", "uchar": "u1", "uint": "<u4", "int": "<i4"}
TYPES |= {"float32": "<f4", "uint8": "u1", "uint32": "<u4", "int32": "<i4"}


def measured(command):
    """Runs a command; its CPU seconds, wall seconds and peak memory in MiB."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    words = ["/usr/bin/env", "time", "-f", "%e %M", *map(str, command)]
    if shutil.which("time") is None:
        words = [str(word) for word in command]
    done = subprocess.run(words, capture_output=True, text=True)
    if done.returncode != 0:
        sys.exit(f"{' '.join(map(str, command))}: {(done.stderr or done.stdout)[-400:]}")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    found = {"cpu_s": after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime}
    if words[0] == "/usr/bin/env":
        wall, peak = done.stderr.strip().splitlines()[-1].split()
        found |= {"wall_s": float(wall), "peak_mib": float(peak) / 1024}
    return found


def cloud_of(path):
    """Points of a binary PLY file."""
    return coloured_cloud_of(path)[0]


def coloured_cloud_of(path):
    """Points and colours of a binary PLY file, whose vertices may have lists (of OpenMVS: views and
    their weights)."""
    data = path.read_bytes()
    end = data.index(b"end_header\n") + len(b"end_header\n")
    fields, count, has_lists, element = [], 0, False, ""
    for line in data[:end].decode().splitlines():
        words = line.split()
        if words[:1] == ["element"]:
            element = words[1]
            if element == "vertex":
                count = int(words[2])
        elif words[:1] == ["property"] and element == "vertex":
            has_lists |= words[1] == "list"
            if not has_lists:
                fields.append((words[2], TYPES[words[1]]))
    head = np.dtype(fields)
    if has_lists:
        vertices = vertices_before_lists(data, end, count, head)
    else:
        vertices = np.frombuffer(data, head, count, end)
    points = np.column_stack([vertices[axis] for axis in "xyz"]).astype(float)
    if "red" not in head.names:
        return points, np.full((count, 3), 128, np.uint8)
    return points, np.column_stack([vertices[name] for name in ("red", "green", "blue")])


def vertices_before_lists(data, at, count, head):
    """The fields of vertices before their first list."""
    lines = data[: data.index(b"end_header")].decode().splitlines()
    start = next(index for index, line in enumerate(lines) if line.startswith("element vertex"))
    steps = []
    for line in lines[start + 1 :]:
        words = line.split()
        if words[0] == "element":
            break
        if words[0] == "property":
            sizes = [np.dtype(TYPES[word]).itemsize for word in words[1:-1] if word in TYPES]
            steps.append((words[1] == "list", sizes))
    found = bytearray()
    for _ in range(count):
        found += data[at : at + head.itemsize]
        for is_list, sizes in steps:
            if is_list:
                length = int.from_bytes(data[at : at + sizes[0]], "little")
                at += sizes[0] + length * sizes[1]
            else:
                at += sizes[0]
    return np.frombuffer(bytes(found), head, count)


class Surface:
    """Samples of the true surface: points, unit normals, footprints."""

    def __init__(self, views, focal, middle):
        points, normals, footprints = [], [], []
        for name, (turn, shift, depth) in views.items():
            height, width = depth.shape
            rows, columns = np.mgrid[0:height, 0:width]
            u, v = (columns + 0.5 - middle[0]) / focal, (rows + 0.5 - middle[1]) / focal
            rays = np.stack([u, v, np.ones_like(depth)])
            place = np.moveaxis(rays * depth, 0, -1)
            # The normal of the surface from its neighbours, where they are on one surface.
            inner = place[1:-1, 1:-1]
            du, dv = place[1:-1, 2:] - place[1:-1, :-2], place[2:, 1:-1] - place[:-2, 1:-1]
            normal = np.cross(du, dv)
            z = depth[1:-1, 1:-1]
            length = np.linalg.norm(normal, axis=-1)
            jump = np.maximum(np.linalg.norm(du, axis=-1), np.linalg.norm(dv, axis=-1))
            good = (z > 0) & (length > 0) & (jump < 20 * z / focal)
            good[::2], good[:, ::2] = False, False
            normal = normal[good] / length[good][:, None]
            point = (inner[good] - shift) @ turn
            seen, nearest = np.ones(len(point), int), z[good] / focal
            for other, (turn2, shift2, depth2) in views.items():
                if other == name:
                    continue
                x, y, far = (point @ turn2.T + shift2).T
                with np.errstate(divide="ignore", invalid="ignore"):
                    u, v = focal * x / far + middle[0], focal * y / far + middle[1]
                is_in = (far > 0) & (u >= 0) & (v >= 0) & (u < width) & (v < height)
                found = np.zeros(len(point))
                found[is_in] = depth2[v[is_in].astype(int), u[is_in].astype(int)]
                sees = is_in & (abs(found - far) < 0.01 * far)
                seen += sees
                nearest = np.where(sees, np.minimum(nearest, far / focal), nearest)
            kept = seen >= 2
            points.append(point[kept])
            normals.append((normal @ turn)[kept])
            footprints.append(nearest[kept])
        self.points, self.normals = np.concatenate(points), np.concatenate(normals)
        self.footprints = np.concatenate(footprints)
        self.tree = cKDTree(self.points)

    def distances(self, cloud):
        """Of each point to the surface, in footprints."""
        _, nearest = self.tree.query(cloud, workers=-1)
        offset = cloud - self.points[nearest]
        across = abs((offset * self.normals[nearest]).sum(1))
        beside = np.sqrt(np.maximum((offset**2).sum(1) - across**2, 0))
        footprint = self.footprints[nearest]
        beside = np.maximum(beside - SPACING * footprint, 0)
        return np.hypot(across, beside) / footprint

    def quality(self, cloud):
        """Accuracy, completeness and F1 in percent, by footprints."""
        if len(cloud) == 0:
            return {"accuracy": [0] * 3, "completeness": [0] * 3, "f1": [0] * 3}
        distance = self.distances(cloud)
        back = cKDTree(cloud).query(self.points, workers=-1)[0] / self.footprints
        share = lambda values, limit: 100 * float((values <= limit).mean())
        accuracy = [share(distance, k) for k in FOOTPRINTS]
        completeness = [share(back, k) for k in FOOTPRINTS]
        f1 = [2 * a * c / max(a + c, 1e-9) for a, c in zip(accuracy, completeness)]
        return {"accuracy": accuracy, "completeness": completeness, "f1": f1}


def aligned(cloud, model, poses):
    """The cloud in the frame of true poses (camera to world), 3 x 4 each: by their rotations, since
    centres on a straight line leave the rotation about it free."""
    images = [image for image in model.images.values() if image.name in poses]
    turns = [poses[i.name][:, :3] @ i.cam_from_world().rotation.matrix() for i in images]
    u, _, vt = np.linalg.svd(np.sum(turns, axis=0))
    turn = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
    source = np.array([image.projection_center() for image in images]) @ turn.T
    target = np.array([poses[image.name][:, 3] for image in images])
    s, t = source - source.mean(0), target - target.mean(0)
    scale = (s * t).sum() / (s * s).sum()
    return scale * (cloud @ turn.T - source.mean(0)) + target.mean(0)


def set_true_poses(folder, views, focal, middle):
    """Gives the model in a folder the true poses and pinhole, and triangulates its tracks again.
    Each image has a frame of its own, since the extrinsics of an estimated rig are not true."""
    found = pycolmap.Reconstruction(folder)
    model = pycolmap.Reconstruction()
    for camera in found.cameras.values():
        camera.model = pycolmap.CameraModelId.PINHOLE
        camera.params = [focal, focal, *middle]
        model.add_camera_with_trivial_rig(camera)
    for number, image in found.images.items():
        turn, shift, _ = views[image.name]
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(turn), shift)
        points = pycolmap.Point2DList([pycolmap.Point2D(p.xy) for p in image.points2D])
        copy = pycolmap.Image(
            name=image.name, camera_id=image.camera_id, image_id=number, points2D=points
        )
        model.add_image_with_trivial_frame(copy, pose)
    for point in found.points3D.values():
        model.add_point3D(point.xyz, point.track, point.color)
    for number, point in list(model.points3D.items()):
        rows, seen = [], []
        for element in point.track.elements:
            image = model.images[element.image_id]
            turn, shift, _ = views[image.name]
            matrix = np.column_stack([turn, shift])
            x, y = (image.points2D[element.point2D_idx].xy - middle) / focal
            rows += [x * matrix[2] - matrix[0], y * matrix[2] - matrix[1]]
            seen.append((matrix, np.array([x, y])))
        solution = np.linalg.svd(np.array(rows))[2][-1]
        place = solution / solution[3] if abs(solution[3]) > 1e-12 else solution
        error = max(
            np.linalg.norm((m @ place)[:2] / (m @ place)[2] - xy) if (m @ place)[2] > 0 else np.inf
            for m, xy in seen
        )
        # The mapper's own limit of the reprojection error.
        if error * focal > 4:
            model.delete_point3D(number)
        else:
            point.xyz = place[:3]
    model.write(folder)


def run_programs(workspace, scratch, options):
    """Clouds and costs of `tiepoint dense` and of OpenMVS on the model of a workspace."""
    found, clouds = {}, {}
    size = ["--max-size", options.size] if options.size else []
    threads = ["--threads", options.threads]
    shutil.rmtree(workspace / "dense", ignore_errors=True)
    redo = ["--redo", "dense"]
    cost = measured([program_of(), "dense", workspace, *size, *threads, *redo])
    report = json.loads((workspace / "report.json").read_text())["stages"]["dense"]
    megapixels = report["megapixels"]
    clouds["tiepoint"] = cloud_of(workspace / "dense/fused.ply")
    found["tiepoint"] = cost | {"megapixels": megapixels, "points": len(clouds["tiepoint"])}
    if options.openmvs:
        scene = scratch / "mvs"
        shutil.rmtree(scene, ignore_errors=True)
        tiepoint("export", workspace, "--to", "openmvs", "-o", scene)
        largest = ["--max-resolution", options.size, "--min-resolution", 0] if options.size else []
        # The whole scene, and no lower priority than ours.
        level = ["--resolution-level", 0, "--estimate-roi", 0, "--crop-to-roi", 0]
        level += ["--process-priority", 0]
        words = [options.openmvs, scene / "scene.mvs", "-w", scene, "-o", scene / "dense.mvs"]
        cost = measured([*words, *level, *largest, "--max-threads", options.threads])
        clouds["openmvs"] = cloud_of(scene / "dense.ply")
        found["openmvs"] = cost | {"megapixels": megapixels, "points": len(clouds["openmvs"])}
    return found, clouds


def street(folder, seed, count, size, rate_hz=4):
    """Photos of a rendered drive; focal length, and views as those of dense_scene."""
    drive = folder.parent / "drive"
    # Less than 12 m a second.
    length = max(60, 6 * count / rate_hz)
    words = ["--frames", count // 2, "--size", f"{size[0]}x{size[1]}", "--rate", rate_hz]
    words += ["--length", length]
    tiepoint(
        "synth", "-o", drive, "--view-direction", "right", "--route", "open", "--seed", seed,
        "--depths", *words,
    )
    truth = pycolmap.Reconstruction(drive / "truth/model")
    views = {}
    for image in truth.images.values():
        (folder / image.name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(drive / image.name, folder / image.name)
        data = (drive / f"truth/depth_maps/{image.name}.bin").read_bytes()
        width, height, _, rest = data.split(b"&", 3)
        depth = np.frombuffer(rest, "<f4").reshape(int(height), int(width))
        pose = image.cam_from_world().matrix()
        views[image.name] = (pose[:, :3], pose[:, 3], depth)
    return next(iter(truth.cameras.values())).params[0], views


def map_of(path):
    width, height, channels, numbers = path.read_bytes().split(b"&", 3)
    values = np.frombuffer(numbers, "<f4").reshape(int(channels), int(height), int(width))
    return values[0]


def confidence_quality(stereo, views, focal):
    """Shares of depths off by over five footprints, in percent: of all, and of those of at least
    the stated confidence; the share of the right ones that these keep; and of ten classes of
    confidence the size, the mean and the share of right depths."""
    sure, right = [], []
    for name, (_, _, truth) in views.items():
        depths = map_of(stereo / f"depth_maps/{name}.geometric.bin")
        known = (depths > 0) & (truth > 0)
        sure.append(map_of(stereo / f"confidence_maps/{name}.geometric.bin")[known])
        right.append(abs(depths - truth)[known] <= 5 * truth[known] / focal)
    sure, right = np.concatenate(sure), np.concatenate(right)
    kept = sure >= CONFIDENT
    classes = []
    for index in range(10):
        inside = np.minimum((10 * sure).astype(int), 9) == index
        if inside.any():
            shares = inside.mean(), sure[inside].mean(), right[inside].mean()
            classes.append([round(100 * float(share), 1) for share in shares])
    return {
        "depths_wrong": 100 * float((~right).mean()),
        "confident_wrong": 100 * float((~right[kept]).mean()),
        "right_kept": 100 * float(right[kept].sum() / right.sum()),
        "confidence_classes": classes,
    }


def scene_case(name, scratch, options):
    count, size = SCENES[name]
    photos, workspace = scratch / "photos", scratch / "ws"
    make = dense_scene.write if name == "room" else street
    focal, views = make(photos, options.seed, count, size)
    middle = np.array(size) / 2
    known = ["--intrinsics", f"{focal},{focal},{middle[0]},{middle[1]}", "--refine", "none"]
    tiepoint("reconstruct", photos, "-o", workspace, *known, "--threads", options.threads)
    surface = Surface(views, focal, middle)
    true_poses = {
        name: np.column_stack([turn.T, -turn.T @ shift]) for name, (turn, shift, _) in views.items()
    }
    cases = []
    for poses in ("ours", "true"):
        if poses == "true":
            set_true_poses(workspace / "sparse/0", views, focal, middle)
        model = pycolmap.Reconstruction(workspace / "sparse/0")
        found, clouds = run_programs(workspace, scratch, options)
        if poses == "true":
            found["tiepoint"] |= confidence_quality(workspace / "dense/stereo", views, focal)
        for program, cloud in clouds.items():
            placed = aligned(cloud, model, true_poses) if poses == "ours" else cloud
            found[program] |= surface.quality(placed)
        cases.append({"case": name, "poses": poses, "programs": found})
        print(json.dumps(cases[-1]), flush=True)
    return cases


def photo_case(name, scratch, options):
    photos, workspace = data() / name / "images", scratch / "ws"
    options = argparse.Namespace(**{**vars(options), "size": options.size or PHOTOS[name]})
    tiepoint("reconstruct", photos, "-o", workspace, "--threads", options.threads)
    found, clouds = run_programs(workspace, scratch, options)
    if len(clouds) == 2:
        # Agreement: points of one cloud within two footprints of the other one.
        model = pycolmap.Reconstruction(workspace / "dense/sparse")
        centres = np.array([image.projection_center() for image in model.images.values()])
        focal = next(iter(model.cameras.values())).mean_focal_length()
        for one, other in (("tiepoint", "openmvs"), ("openmvs", "tiepoint")):
            cloud = clouds[one]
            footprint = cKDTree(centres).query(cloud)[0] / focal
            near = cKDTree(clouds[other]).query(cloud)[0] <= 2 * footprint
            found[one]["agreement"] = 100 * float(near.mean())
    print(json.dumps(found), flush=True)
    return [{"case": name, "poses": "ours", "programs": found}]


def large_case(name, scratch, options):
    changed = {"size": LARGE_SIDE, "openmvs": None}
    options = argparse.Namespace(**{**vars(options), **changed})
    return [photo_case("fountain-P11", scratch, options)[0] | {"case": name}]


def drive_case(name, scratch, options):
    photos, workspace = scratch / "photos", scratch / "ws"
    # Frames so near to each other that all images of this size are registered.
    street(photos, options.seed, DRIVES[name], DRIVE_SIZE, rate_hz=10)
    words = ["--pairs", "sequential:5", "--threads", options.threads]
    tiepoint("reconstruct", photos, "-o", workspace, *words)
    options = argparse.Namespace(**{**vars(options), "openmvs": None})
    found, _ = run_programs(workspace, scratch, options)
    print(json.dumps(found), flush=True)
    return [{"case": name, "poses": "ours", "programs": found}]


def case_of(name):
    if name in SCENES:
        return scene_case
    if name in DRIVES:
        return drive_case
    return {LARGE: large_case, "kitti04": kitti_case}.get(name, photo_case)


def kitti_case(name, scratch, options):
    folder, photos, workspace = data() / name, scratch / "photos", scratch / "ws"
    for side in ("left", "right"):
        (photos / side).mkdir(parents=True)
        for path in sorted((folder / "images" / side).iterdir())[:KITTI_FRAMES]:
            shutil.copy(path, photos / side / path.name)
    known = ",".join(map(repr, kitti_intrinsics(folder)))
    words = ["--intrinsics", known, "--refine", "none", "--pairs", "sequential:5"]
    words += ["--threads", options.threads]
    tiepoint("reconstruct", photos, "-o", workspace, *words)
    model = pycolmap.Reconstruction(workspace / "sparse/0")
    poses = np.loadtxt(folder / "poses.txt").reshape(-1, 3, 4)
    names = sorted(path.name for path in (photos / "left").iterdir())
    poses = {f"left/{name}": pose for name, pose in zip(names, poses)}
    lidar = cloud_of(folder / "lidar_reference_voxel10cm.ply")
    tree = cKDTree(lidar)
    found, clouds = run_programs(workspace, scratch, options)
    for program, cloud in clouds.items():
        placed = aligned(cloud, model, poses)
        distance = tree.query(placed, workers=-1)[0]
        # Cropped to the overlap: what the scan does not cover has no truth.
        inside = distance <= LIDAR_REACH_M
        found[program]["lidar_median_m"] = float(np.median(distance[inside]))
        found[program]["lidar_share"] = 100 * float(inside.mean())
    print(json.dumps(found), flush=True)
    return [{"case": name, "poses": "ours", "programs": found}]


def data():
    folder = os.environ.get("TIEPOINT_DATA")
    if folder is None:
        sys.exit("TIEPOINT_DATA is not set: it is the folder of the reference data")
    return pathlib.Path(folder)


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    cases = [*SCENES, *PHOTOS, "kitti04", LARGE, *DRIVES]
    parser.add_argument("cases", nargs="*", metavar="CASE", default=cases)
    parser.add_argument("--openmvs", type=pathlib.Path, default=os.environ.get("OPENMVS_DENSIFY"))
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--size", type=int, help="largest side of the depth maps")
    parser.add_argument("--results", type=pathlib.Path)
    parser.add_argument("--keep", type=pathlib.Path)
    options = parser.parse_args()
    results = []
    for name in options.cases:
        run = case_of(name)
        with tempfile.TemporaryDirectory() as temporary:
            scratch = options.keep / name if options.keep else pathlib.Path(temporary)
            results += run(name, scratch, options)
        # After each case, so that an interrupted run keeps what it has measured.
        if options.results:
            options.results.write_text(json.dumps({"cases": results}, indent=1))


if __name__ == "__main__":
    main()
