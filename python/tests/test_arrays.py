"""Models, features and poses as arrays."""

import json

import numpy as np
import pytest
import tiepoint

CAMERA = tiepoint.Camera("PINHOLE", 640, 480, [500.0, 500.0, 320.0, 240.0])


def rotation(axis_angle):
    """Rodrigues."""
    angle = np.linalg.norm(axis_angle)
    x, y, z = axis_angle / angle
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k


def scene(count=200, seed=1):
    """Points in front of two cameras: the points, the second pose and the pixels of both."""
    rng = np.random.default_rng(seed)
    points = rng.uniform([-2, -2, 4], [2, 2, 8], (count, 3))
    pose = np.c_[rotation(np.array([0.05, -0.1, 0.02])), [0.6, 0.1, 0.05]]
    pixels = [CAMERA.project(points), CAMERA.project(points @ pose[:, :3].T + pose[:, 3])]
    return points, pose, pixels


def test_cameras_project_and_unproject():
    points = np.array([[0.1, -0.2, 1.0], [0.0, 0.0, 2.0], [0.0, 0.0, -1.0]])
    pixels = CAMERA.project(points)
    assert np.allclose(pixels[:2], [[370, 140], [320, 240]]) and np.isnan(pixels[2]).all()
    rays = CAMERA.unproject(pixels[:2])
    assert np.allclose(rays, points[:2] / np.linalg.norm(points[:2], axis=1, keepdims=True))
    assert (CAMERA.model, CAMERA.width, CAMERA.param_names) == (
        "PINHOLE",
        640,
        ["fx", "fy", "cx", "cy"],
    )
    with pytest.raises(tiepoint.UsageError, match="NO_SUCH"):
        tiepoint.Camera("NO_SUCH", 640, 480, [1.0])


def test_poses_of_exact_pixels_with_outliers():
    points, pose, (one, other) = scene()
    other = other.copy()
    other[::4] += 50 * np.sign(other[::4] - 240)
    found = tiepoint.relative_pose(one, other, CAMERA, CAMERA, max_error=1.0)
    expected = np.c_[pose[:, :3], pose[:, 3] / np.linalg.norm(pose[:, 3])]
    assert np.abs(found["cam2_from_cam1"] - expected).max() < 1e-6
    assert found["inliers"].dtype == bool and found["inliers"].sum() == found["num_inliers"]
    assert not found["inliers"][::4].all() and found["inliers"][1::4].all()
    found = tiepoint.absolute_pose(other, points, CAMERA, max_error=1.0)
    assert np.abs(found["cam_from_world"] - pose).max() < 1e-6
    found = tiepoint.fundamental(one, other, max_error=1.0)
    homogeneous = [np.c_[pixels, np.ones(len(pixels))] for pixels in (one, other)]
    errors = np.sum(homogeneous[1] @ found["fundamental"] * homogeneous[0], axis=1)
    assert np.abs(errors[found["inliers"]]).max() < 1e-4 * np.abs(errors).max()


def test_pose_of_a_rig():
    points, pose, _ = scene()
    cams_from_rig = np.array([np.eye(4)[:3], np.c_[rotation(np.array([0, 0.1, 0])), [-0.5, 0, 0]]])
    indices = np.arange(len(points)) % 2
    in_rig = points @ pose[:, :3].T + pose[:, 3]
    in_cam = np.einsum("nij,nj->ni", cams_from_rig[indices, :, :3], in_rig)
    pixels = CAMERA.project(in_cam + cams_from_rig[indices, :, 3])
    pixels[::5] += 40
    arguments = (pixels, points, indices, cams_from_rig, [CAMERA, CAMERA])
    found = tiepoint.generalized_absolute_pose(*arguments, max_error=1.0)
    assert np.abs(found["rig_from_world"] - pose).max() < 1e-6
    assert (found["inliers"] == (np.arange(len(points)) % 5 != 0)).all()
    with pytest.raises(tiepoint.UsageError, match="camera_indices must be of the 2 cameras"):
        tiepoint.generalized_absolute_pose(*arguments[:2], indices + 1, *arguments[3:])


def test_similarity_and_triangulation():
    points, pose, (one, other) = scene()
    turn = 1.7 * rotation(np.array([0.3, 0.2, -0.1]))
    moved = points @ turn.T + [1, 2, 3]
    moved[::3] += 1
    found = tiepoint.similarity(points, moved, max_error=0.01)
    assert np.abs(found["b_from_a"] - np.c_[turn, [1, 2, 3]]).max() < 1e-9
    assert abs(found["scale"] - 1.7) < 1e-9 and found["num_inliers"] == len(points) * 2 // 3
    poses = np.array([np.eye(4)[:3], pose, pose])
    pixels = [one[5], other[5], other[5] + 30]
    found = tiepoint.triangulate(pixels, poses, CAMERA, max_error=1.0)
    assert np.abs(found["point"] - points[5]).max() < 1e-9
    assert found["inliers"].tolist() == [True, True, False]
    assert tiepoint.triangulate(pixels[:2], poses[:2], [CAMERA, CAMERA], min_angle=60) is None


def test_rig_of_two_trajectories():
    """A vehicle that turns left and right; the clock of its second camera is 0.13 s behind."""

    def at(time):
        turn = rotation(np.array([0, 0.6 * np.sin(0.9 * time) + 1e-9, 0]))
        return np.c_[turn, -turn @ [np.sin(0.5 * time), 0, 3 * time]]

    cam2_from_cam1 = np.c_[rotation(np.array([0, 0.1, 0])), [-0.5, 0.02, 0.0]]

    def second(time):
        pose = at(time)
        turn = cam2_from_cam1[:, :3]
        return np.c_[turn @ pose[:, :3], turn @ pose[:, 3] + cam2_from_cam1[:, 3]]

    times1, times2 = 0.1 * np.arange(80), 0.1 * np.arange(75) + 0.04
    poses1, poses2 = ([at(t) for t in times1], [second(t + 0.13) for t in times2])
    found = tiepoint.clock_offset(times1, poses1, times2, poses2)
    assert abs(found["offset"] - 0.13) < 1e-3 and found["sd"] > 0
    found = tiepoint.average_relative_pose(poses1, [second(t) for t in times1])
    assert np.abs(found["cam2_from_cam1"] - cam2_from_cam1).max() < 1e-9
    assert found["rms_translation"] < 1e-9 and abs(found["second_over_first_half"] - 1) < 1e-9
    assert tiepoint.average_relative_pose(poses1[:1], poses1[:1]) is None
    with pytest.raises(tiepoint.UsageError, match="times1 must be finite and ascending"):
        tiepoint.clock_offset(times1[::-1], poses1, times2, poses2)
    with pytest.raises(tiepoint.UsageError, match="poses1 must be matrices"):
        tiepoint.average_relative_pose(2 * np.array(poses1), poses1)


def test_homography_of_a_plane():
    truth = np.array([[1.1, 0.02, 5.0], [-0.03, 0.95, -8.0], [1e-4, 2e-5, 1.0]])
    one = np.random.default_rng(2).uniform(0, 500, (60, 2))
    other = np.c_[one, np.ones(60)] @ truth.T
    found = tiepoint.homography(one, other[:, :2] / other[:, 2:])
    assert np.allclose(found["homography"] / found["homography"][2, 2], truth, atol=1e-6)


def test_wrong_arrays_are_errors():
    one = np.zeros((10, 2))
    with pytest.raises(tiepoint.UsageError, match=r"shape \(N, 2\)"):
        tiepoint.homography(one, np.zeros((10, 3)))
    with pytest.raises(tiepoint.UsageError, match="equally many"):
        tiepoint.homography(one, np.zeros((9, 2)))
    with pytest.raises(tiepoint.UsageError, match="finite"):
        tiepoint.homography(one, np.full((10, 2), np.nan))
    assert tiepoint.homography(np.zeros((2, 2)), np.zeros((2, 2))) is None
    with pytest.raises(tiepoint.UsageError, match=r"points1 .* \(N, 2\), not float64 of .* \(4,\)"):
        tiepoint.homography(np.zeros(4), one)
    with pytest.raises(tiepoint.UsageError, match="points2 .*, not <class 'str'>"):
        tiepoint.homography(one, "left.jpg")
    with pytest.raises(tiepoint.UsageError, match=r"not <class 'list'> of shape \(2,\)"):
        tiepoint.homography([0, 0], one)
    with pytest.raises(tiepoint.UsageError, match="not <class 'list'>$"):
        tiepoint.homography([[0, 0], [0]], one)
    with pytest.raises(tiepoint.UsageError, match="mask must be an array of uint8 or bool"):
        tiepoint.sift(np.zeros((9, 9), np.uint8), mask=np.zeros((9, 9)))
    with pytest.raises(tiepoint.UsageError, match="mask must have the shape of image"):
        tiepoint.sift(np.zeros((9, 9), np.uint8), mask=np.zeros((9, 8), bool))
    with pytest.raises(tiepoint.UsageError, match=r"uint8 of shape \(H, W\), not .* \(9, 9, 3\)"):
        tiepoint.sift(np.zeros((9, 9, 3), np.uint8))
    with pytest.raises(tiepoint.UsageError, match=r"\(N, 128\), not float32"):
        tiepoint.match(np.zeros((3, 128), np.float32), np.zeros((3, 128), np.uint8))


def test_coordinates_may_have_any_type_of_numbers():
    one = np.random.default_rng(6).integers(0, 500, (60, 2))
    other = one + [3, -4]
    expected = tiepoint.homography(one.astype(float), other.astype(float))["homography"]
    for convert in (np.float32, np.int16):
        found = tiepoint.homography(one.astype(convert), other.astype(convert))
        assert (found["homography"] == expected).all()
    assert (tiepoint.homography(one.tolist(), other.tolist())["homography"] == expected).all()
    camera = tiepoint.Camera("PINHOLE", 640, 480, [500, 500, 320, 240])
    assert (camera.project([[0, 0, 1]]) == [[320, 240]]).all()


def test_sift_and_matches():
    rng = np.random.default_rng(3)
    image = np.zeros((240, 320))
    y, x = np.mgrid[:240, :320]
    for _ in range(120):
        cx, cy, sigma = rng.uniform(0, 320), rng.uniform(0, 240), rng.uniform(1.5, 6)
        image += rng.uniform(-80, 80) * np.exp(-((x - cx) ** 2 + (y - cy) ** 2) / 2 / sigma**2)
    image = np.clip(image + 128, 0, 255).astype(np.uint8)
    keypoints, descriptors = tiepoint.sift(image)
    assert keypoints.shape == (len(descriptors), 4) and descriptors.shape[1] == 128
    assert len(keypoints) > 50 and descriptors.dtype == np.uint8
    shifted = np.roll(image, 7, axis=1)
    other, others = tiepoint.sift(shifted)
    pairs = tiepoint.match(descriptors, others)
    moved = other[pairs[:, 1], :2] - keypoints[pairs[:, 0], :2]
    assert len(pairs) > 30 and np.abs(np.median(moved, axis=0) - [7, 0]).max() < 0.05
    mask = np.zeros_like(image)
    mask[:, :100] = 255
    masked = tiepoint.sift(image, mask=mask)[0]
    assert masked[:, 0].max() < 101
    assert (tiepoint.sift(image, mask=mask > 0)[0] == masked).all()
    with pytest.raises(tiepoint.UsageError, match="128"):
        tiepoint.match(np.zeros((3, 64), np.uint8), descriptors)


def test_undistortion():
    camera = tiepoint.Camera("SIMPLE_RADIAL", 64, 48, [50.0, 32.0, 24.0, -0.05])
    image = np.full((48, 64, 3), 90, np.uint8)
    flat, pinhole = tiepoint.undistort(image, camera)
    assert pinhole.model == "PINHOLE" and flat.shape == (pinhole.height, pinhole.width, 3)
    assert (flat == 90).all(), "no blank pixels"
    with pytest.raises(tiepoint.UsageError):
        tiepoint.undistort(image, camera, blank_pixels=2.0)
    with pytest.raises(tiepoint.UsageError, match=r"\(H, W, 3\), not uint8 of shape \(48, 64\)"):
        tiepoint.undistort(image[:, :, 0], camera)
    with pytest.raises(tiepoint.UsageError, match=r"\(H, W, 3\), not uint8 of .*, 2\)"):
        tiepoint.undistort(image[:, :, :2], camera)
    with pytest.raises(tiepoint.UsageError, match="48 x 64"):
        tiepoint.undistort(image.transpose(1, 0, 2), camera)


def test_models_are_arrays(workspace, tmp_path):
    model = tiepoint.Reconstruction.read(workspace)
    count, points = len(model.image_names), len(model.points)
    assert model.poses.shape == (count, 3, 4) and model.centers.shape == (count, 3)
    assert model.colors.shape == (points, 3) and model.point_errors.shape == (points,)
    # The pixel of a point is where its keypoint is, to within the error of the point.
    point, image, keypoint = model.observations[0]
    pose = model.poses[image]
    in_cam = (pose[:, :3] @ model.points[point] + pose[:, 3])[None]
    pixel = model.cameras[model.image_cameras[image]].project(in_cam)[0]
    assert np.linalg.norm(pixel - model.keypoints(image)[keypoint]) < 4
    assert np.allclose(model.centers[image], -pose[:, :3].T @ pose[:, 3])

    model.write(tmp_path / "copy", text=True)
    copy = tiepoint.Reconstruction.read(tmp_path / "copy")
    assert (copy.poses == model.poses).all() and (copy.image_ids == model.image_ids).all()
    foreign = tmp_path / "foreign"
    foreign.mkdir()
    (foreign / "cameras.txt").write_text("of another program")
    with pytest.raises(tiepoint.Error, match="cameras.txt"):
        model.write(foreign, text=True)
    assert (foreign / "cameras.txt").read_text() == "of another program"
    moved = np.eye(4)
    moved[:3] *= 2
    copy.transform(moved)
    assert np.allclose(copy.points, 2 * model.points)
    with pytest.raises(tiepoint.UsageError, match="similarity"):
        copy.transform(np.diag([1.0, 2.0, 3.0, 1.0]))
    with pytest.raises(tiepoint.UsageError, match="rotations"):
        copy.poses = np.zeros((count, 3, 4))
    with pytest.raises(tiepoint.Error, match="absent"):
        tiepoint.Reconstruction.read(tmp_path / "absent")
    with pytest.raises(tiepoint.Error, match="is a workspace"):
        model.write(workspace)


def test_rows_of_rolling_shutters(workspace, tmp_path):
    drive, mapped = tmp_path / "drive", tmp_path / "ws"
    tiepoint.synth(drive, frames=12, rate=4, size="400x300", effects="rolling-shutter")
    times = drive / "timestamps.csv"
    tiepoint.reconstruct(drive, mapped, rig="off", rolling_shutter="16ms", timestamps=times)
    model = tiepoint.Reconstruction.read(mapped)
    assert np.allclose(model.readout_times, 0.016)
    tiepoint.export(mapped, to="gsplat", output=tmp_path / "gsplat")
    frames = json.loads((tmp_path / "gsplat/rolling_shutter.json").read_text())["frames"]
    assert [frame["image_name"] for frame in frames] == model.image_names
    assert any(frame["rolling_shutter"] != "GLOBAL" for frame in frames)
    rows = model.row_poses
    for frame, (first, last), velocities in zip(frames, rows, model.row_velocities):
        assert np.allclose(first, frame["viewmats"][:3], atol=1e-12)
        assert np.allclose(last, frame["viewmats_rs"][:3], atol=1e-12)
        if frame["rolling_shutter"] != "GLOBAL":
            expected = frame["velocity_in_world"] + frame["angular_velocity_in_camera"]
            assert np.allclose(velocities, expected, atol=1e-12)
    assert not np.allclose(rows[:, 0], rows[:, 1])
    # They follow the model.
    model.transform(np.c_[2 * np.eye(3), np.zeros(3)])
    assert np.allclose(model.row_poses[..., 3], 2 * rows[..., 3])
    # A global shutter, and a model alone.
    still = tiepoint.Reconstruction.read(workspace)
    assert not still.readout_times.any() and np.isnan(still.row_velocities).all()
    assert np.array_equal(still.row_poses[:, 0], still.poses)
    model.write(tmp_path / "alone")
    assert not tiepoint.Reconstruction.read(tmp_path / "alone").readout_times.any()


def test_bundle_adjustment_lowers_the_cost(workspace):
    model = tiepoint.Reconstruction.read(workspace)
    rng = np.random.default_rng(4)
    model.points = model.points + 0.05 * rng.standard_normal(model.points.shape)
    before = model.point_errors.mean()
    summary = tiepoint.bundle_adjust(model, refine="")
    assert summary["final_cost"] < 0.1 * summary["initial_cost"]
    assert model.point_errors.mean() < before
    with pytest.raises(tiepoint.UsageError, match="everything"):
        tiepoint.bundle_adjust(model, refine="everything")


def test_adjustment_keeps_what_is_fixed_and_follows_what_is_known(workspace):
    model = tiepoint.Reconstruction.read(workspace)
    rng = np.random.default_rng(5)
    truth = model.centers.copy()
    model.points = model.points + 0.02 * rng.standard_normal(model.points.shape)
    before = model.poses
    tiepoint.bundle_adjust(model, refine=["none"], fixed_poses=[0, 1, 2], loss="huber")
    moved = np.abs(model.poses - before).max(axis=(1, 2))
    assert (moved[:3] == 0).all() and moved[3:].min() > 0
    # Centres that are scaled by 1 % pull the model with them.
    wanted = 1.01 * truth
    free = np.bincount(model.observations[:, 1]).argmax()
    wanted[free] = np.nan
    tiepoint.bundle_adjust(model, refine="none", centers=wanted, center_sigmas=1e-4)
    errors = np.linalg.norm(model.centers - 1.01 * truth, axis=1)
    # The image without a centre follows its keypoints: there are most of them.
    assert np.delete(errors, free).max() < 1e-3 and errors[free] < 1e-2
    focal = model.cameras[0].params[0]
    prior = (0, 1.02 * focal, 1e-3)
    tiepoint.bundle_adjust(model, refine="focal", focal_priors=[prior], loss="cauchy")
    assert abs(model.cameras[0].params[0] / focal - 1.02) < 1e-3
    for keywords, message in (
        ({"loss": "square"}, "trivial, huber, soft_l1, cauchy, tukey"),
        ({"loss_scale": 0}, "loss scale"),
        ({"fixed_poses": [len(truth)]}, "fixed_poses has"),
        ({"fixed_poses": [-1]}, "fixed_poses has -1"),
        ({"fixed_poses": np.zeros(2, bool)}, "fixed_poses must be an array of bool"),
        ({"focal_priors": [(9, 500, 1)]}, "camera 9"),
        ({"focal_priors": [(0, np.nan, 1)]}, "mean_px"),
        ({"centers": truth}, "center_sigmas"),
        ({"centers": truth[1:], "center_sigmas": 1}, "centers must be an array"),
        ({"centers": truth, "center_sigmas": 0}, "greater than 0"),
        ({"centers": truth, "center_sigmas": [1, 2]}, "center_sigmas must be an array"),
        ({"refine": 3}, "refine must be"),
    ):
        with pytest.raises(tiepoint.UsageError, match=message):
            tiepoint.bundle_adjust(model, **keywords)


def test_models_are_edited(workspace, tmp_path):
    model = tiepoint.Reconstruction.read(workspace)
    points, observations, names = len(model.points), model.observations, model.image_names
    assert isinstance(names, list) and len(names) > 4
    removed = model.point_errors > np.quantile(model.point_errors, 0.9)
    kept_ids = model.point_ids[~removed]
    model.remove_points(removed)
    assert (model.point_ids == kept_ids).all()
    assert len(model.observations) == (~removed[observations[:, 0]]).sum()
    # All but one observation of the first point: it cannot stay.
    first = np.flatnonzero(model.observations[:, 0] == 0)
    gone = model.point_ids[0]
    model.remove_observations(first[1:])
    assert gone not in model.point_ids and len(model.points) == len(kept_ids) - 1
    model.remove_observations([])
    model.remove_images(np.array([1, 3]))
    assert model.image_names == [name for at, name in enumerate(names) if at not in (1, 3)]
    assert model.poses.shape == (len(names) - 2, 3, 4) and len(model.points) < points
    assert model.observations[:, 1].max() < len(names) - 2
    model.write(tmp_path / "edited")
    again = tiepoint.Reconstruction.read(tmp_path / "edited")
    assert (again.point_ids == model.point_ids).all() and again.image_names == model.image_names
    with pytest.raises(tiepoint.UsageError, match="points has"):
        model.remove_points([len(model.points)])
    with pytest.raises(tiepoint.UsageError, match="images must be an array of bool, or of"):
        model.remove_images(names[0])


def test_images_have_the_names_of_pycolmap(workspace):
    model = tiepoint.Reconstruction(workspace)
    assert list(model.images) == model.image_ids.tolist()
    for row, (key, image) in enumerate(model.images.items()):
        assert (image.image_id, image.index, image.name) == (key, row, model.image_names[row])
        assert (image.cam_from_world() == model.poses[row]).all()
        assert (image.projection_center() == model.centers[row]).all()
        assert (image.keypoints == model.keypoints(row)).all()
        assert repr(image.camera) == repr(model.cameras[model.image_cameras[row]])
        of_image = model.observations[model.observations[:, 1] == row]
        ids = np.full(len(image.keypoints), -1)
        ids[of_image[:, 2]] = model.point_ids[of_image[:, 0]]
        assert (image.point_ids == ids).all()
    # It follows the model, also when it is gone.
    model.remove_images([0])
    assert image.index == row - 1
    model.remove_images(np.ones(row, bool))
    with pytest.raises(tiepoint.UsageError, match="was removed from the model"):
        image.cam_from_world()


def test_folders_without_a_model_say_what_to_pass(drive, workspace, tmp_path):
    with pytest.raises(tiepoint.Error, match="holds no COLMAP model: give a folder with cameras"):
        tiepoint.Reconstruction(drive)
    with pytest.raises(tiepoint.Error, match="give one, as .*sparse/0"):
        tiepoint.Reconstruction(workspace / "sparse")
    tiepoint.extract_features(drive, tmp_path / "ws")
    with pytest.raises(tiepoint.Error, match="a workspace that holds no .* run map_images first"):
        tiepoint.Reconstruction(tmp_path / "ws")


def test_pycolmap_reads_it(workspace):
    pytest.importorskip("pycolmap")
    model = tiepoint.Reconstruction(workspace)
    there = tiepoint.to_pycolmap(model)
    assert there.num_reg_images() == len(model.image_names)
    assert there.num_points3D() == len(model.points)
    for key, image in model.images.items():
        other = there.images[key]
        assert other.name == image.name and other.camera.params.tolist() == [*image.camera.params]
        assert np.allclose(other.cam_from_world().matrix(), image.cam_from_world(), atol=1e-12)
        assert np.allclose(other.projection_center(), image.projection_center(), atol=1e-9)
    back = tiepoint.from_pycolmap(there)
    assert list(back.images) == list(model.images) and (back.point_ids == model.point_ids).all()
    assert np.abs(back.poses - model.poses).max() < 1e-12 and (back.points == model.points).all()


def test_lists_texts_and_arrays_are_alike(workspace):
    params = [500.0, 500.0, 320.0, 240.0]
    for alike in (params, tuple(params), np.array(params), np.array(params, np.float32)):
        assert repr(tiepoint.Camera("PINHOLE", 640, 480, alike)) == repr(CAMERA)
    models = [tiepoint.Reconstruction(str(workspace)) for _ in range(3)]
    for model, refine in zip(models, ("focal,distortion", ["focal", "distortion"], ("focal",))):
        tiepoint.bundle_adjust(
            model, refine=refine, fixed_poses=(0, 1), focal_priors=[[0, 300.0, 50.0]]
        )
    assert (models[0].poses == models[1].poses).all()
    assert tiepoint.model_info(str(workspace)) == tiepoint.model_info(workspace)
    points, pose, (one, _) = scene(20)
    poses = [np.eye(4)[:3].tolist(), pose.tolist()]
    assert tiepoint.triangulate(one[:2].tolist(), poses, (CAMERA, CAMERA)) is None
