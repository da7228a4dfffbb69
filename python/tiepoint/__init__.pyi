"""Type stubs, written by stubs.py."""

import os
from collections.abc import Callable, Sequence
from typing import Any, Literal, Optional, TypedDict, Union

import numpy as np
from numpy.typing import ArrayLike, NDArray

# What the program reads: a path, a text, a number, or a list of them.
Value = Union[str, int, float, "os.PathLike[str]", Sequence[Any]]
Progress = Union[None, bool, Callable[[dict[str, Any]], object]]
Floats = NDArray[np.float64]

__version__: str

class Error(RuntimeError): ...
class UsageError(ValueError): ...

class Camera:
    def __init__(
        self, model: str, width: int, height: int, params: ArrayLike
    ) -> None: ...
    @property
    def model(self) -> str: ...
    @property
    def width(self) -> int: ...
    @property
    def height(self) -> int: ...
    @property
    def params(self) -> Floats: ...
    @property
    def param_names(self) -> list[str]: ...
    def project(self, points_in_cam: ArrayLike) -> Floats: ...
    def unproject(self, pixels: ArrayLike) -> Floats: ...

class Image:
    @property
    def image_id(self) -> int: ...
    @property
    def index(self) -> int: ...
    @property
    def name(self) -> str: ...
    @property
    def camera(self) -> Camera: ...
    def cam_from_world(self) -> Floats: ...
    def projection_center(self) -> Floats: ...
    @property
    def keypoints(self) -> Floats: ...
    @property
    def point_ids(self) -> NDArray[np.int64]: ...

class Reconstruction:
    def __init__(self, path: Union[str, "os.PathLike[str]"]) -> None: ...
    @staticmethod
    def read(path: Union[str, "os.PathLike[str]"]) -> Reconstruction: ...
    def write(self, path: Union[str, "os.PathLike[str]"], *, text: bool = False) -> None: ...
    @property
    def cameras(self) -> list[Camera]: ...
    @property
    def camera_ids(self) -> NDArray[np.uint64]: ...
    def set_camera(self, index: int, camera: Camera) -> None: ...
    @property
    def images(self) -> dict[int, Image]: ...
    @property
    def image_names(self) -> list[str]: ...
    @property
    def image_ids(self) -> NDArray[np.uint64]: ...
    @property
    def image_cameras(self) -> NDArray[np.uint32]: ...
    @property
    def poses(self) -> Floats: ...
    @poses.setter
    def poses(self, value: ArrayLike) -> None: ...
    @property
    def centers(self) -> Floats: ...
    def keypoints(self, image: int) -> Floats: ...
    @property
    def points(self) -> Floats: ...
    @points.setter
    def points(self, value: ArrayLike) -> None: ...
    @property
    def point_ids(self) -> NDArray[np.uint64]: ...
    @property
    def colors(self) -> NDArray[np.uint8]: ...
    @property
    def point_errors(self) -> Floats: ...
    @property
    def observations(self) -> NDArray[np.uint32]: ...
    def remove_points(self, points: ArrayLike) -> None: ...
    def remove_observations(self, observations: ArrayLike) -> None: ...
    def remove_images(self, images: ArrayLike) -> None: ...
    @property
    def rigs(self) -> list[dict[str, Any]]: ...
    @property
    def frames(self) -> list[dict[str, Any]]: ...
    @property
    def readout_times(self) -> Floats: ...
    @property
    def row_poses(self) -> Floats: ...
    @property
    def row_velocities(self) -> Floats: ...
    def transform(self, new_from_old: ArrayLike) -> None: ...

class RelativePose(TypedDict):
    cam2_from_cam1: Floats
    num_inliers: int
    inliers: NDArray[np.bool_]

class AbsolutePose(TypedDict):
    cam_from_world: Floats
    num_inliers: int
    inliers: NDArray[np.bool_]

class GeneralizedAbsolutePose(TypedDict):
    rig_from_world: Floats
    num_inliers: int
    inliers: NDArray[np.bool_]

class Similarity(TypedDict):
    b_from_a: Floats
    scale: float
    num_inliers: int
    inliers: NDArray[np.bool_]

class Point(TypedDict):
    point: Floats
    inliers: NDArray[np.bool_]

class AverageRelativePose(TypedDict):
    cam2_from_cam1: Floats
    median_baseline: float
    rms_translation: float
    rms_rotation: float
    second_over_first_half: float

class ClockOffset(TypedDict):
    offset: float
    sd: float

class Homography(TypedDict):
    homography: Floats
    num_inliers: int
    inliers: NDArray[np.bool_]

class Fundamental(TypedDict):
    fundamental: Floats
    num_inliers: int
    inliers: NDArray[np.bool_]

class Adjustment(TypedDict):
    initial_cost: float
    final_cost: float
    iterations: int
    converged: bool

def sift(
    image: NDArray[np.uint8],
    *,
    max_features: int = 8192,
    upright: bool = False,
    mask: Optional[Union[NDArray[np.uint8], NDArray[np.bool_]]] = None,
) -> tuple[NDArray[np.float32], NDArray[np.uint8]]: ...
def match(
    a: NDArray[np.uint8],
    b: NDArray[np.uint8],
    *,
    max_ratio: Optional[float] = 0.8,
    max_angle: Optional[float] = 0.7,
    cross_check: bool = True,
) -> NDArray[np.uint32]: ...
def relative_pose(
    pixels1: ArrayLike,
    pixels2: ArrayLike,
    camera1: Camera,
    camera2: Camera,
    *,
    max_error: float = 4.0,
    seed: int = 0,
) -> Optional[RelativePose]: ...
def absolute_pose(
    pixels: ArrayLike,
    points_in_world: ArrayLike,
    camera: Camera,
    *,
    max_error: float = 4.0,
    seed: int = 0,
) -> Optional[AbsolutePose]: ...
def generalized_absolute_pose(
    pixels: ArrayLike,
    points_in_world: ArrayLike,
    camera_indices: ArrayLike,
    cams_from_rig: ArrayLike,
    cameras: Sequence[Camera],
    *,
    max_error: float = 4.0,
    seed: int = 0,
) -> Optional[GeneralizedAbsolutePose]: ...
def similarity(
    points_a: ArrayLike,
    points_b: ArrayLike,
    *,
    max_error: float,
    with_scale: bool = True,
    seed: int = 0,
) -> Optional[Similarity]: ...
def triangulate(
    pixels: ArrayLike,
    poses: ArrayLike,
    cameras: Union[Camera, Sequence[Camera]],
    *,
    max_error: float = 4.0,
    min_angle: float = 1.5,
) -> Optional[Point]: ...
def average_relative_pose(
    poses1: ArrayLike, poses2: ArrayLike
) -> Optional[AverageRelativePose]: ...
def clock_offset(
    times1: ArrayLike, poses1: ArrayLike, times2: ArrayLike, poses2: ArrayLike
) -> Optional[ClockOffset]: ...
def homography(
    points1: ArrayLike, points2: ArrayLike, *, max_error: float = 4.0, seed: int = 0
) -> Optional[Homography]: ...
def fundamental(
    points1: ArrayLike, points2: ArrayLike, *, max_error: float = 4.0, seed: int = 0
) -> Optional[Fundamental]: ...
def bundle_adjust(
    reconstruction: Reconstruction,
    *,
    refine: Union[None, str, Sequence[str]] = None,
    fixed_poses: Optional[ArrayLike] = None,
    fixed_rigs: bool = False,
    loss: Literal["trivial", "huber", "soft_l1", "cauchy", "tukey"] = "soft_l1",
    loss_scale: float = 4.0,
    focal_priors: Union[Sequence[Sequence[float]], Floats] = ...,
    centers: Optional[ArrayLike] = None,
    center_sigmas: Optional[ArrayLike] = None,
    max_iterations: int = 100,
) -> Adjustment: ...
def undistort(
    image: NDArray[np.uint8],
    camera: Camera,
    *,
    blank_pixels: float = 0.0,
    min_scale: float = 0.2,
    max_scale: float = 2.0,
    max_size: Optional[int] = None,
) -> tuple[NDArray[np.uint8], Camera]: ...
def to_pycolmap(reconstruction: Reconstruction) -> Any: ...
def from_pycolmap(reconstruction: Any) -> Reconstruction: ...
def commands() -> list[str]: ...
def reconstruct(
    inputs: Optional[Value] = None,
    output: Optional[Value] = None,
    *,
    database: Optional[Value] = None,
    every: Optional[Value] = None,
    timestamps: Optional[Value] = None,
    masks: Optional[Value] = None,
    max_size: Optional[Value] = None,
    max_megapixels: Optional[Value] = None,
    cameras: Optional[Value] = None,
    intrinsics: Optional[Value] = None,
    calibration: Optional[Value] = None,
    focal_prior: Optional[Value] = None,
    camera_model: Optional[Value] = None,
    pairs: Optional[Value] = None,
    rig: Optional[Value] = None,
    rig_calibration: Optional[Value] = None,
    refine: Optional[Value] = None,
    calibration_sigma: Optional[Value] = None,
    baseline: Optional[Value] = None,
    position_priors: Optional[Value] = None,
    control_points: Optional[Value] = None,
    input_model: Optional[Value] = None,
    fix_existing_frames: bool = False,
    rolling_shutter: Optional[Value] = None,
    submaps: Optional[Value] = None,
    max_memory: Optional[Value] = None,
    seed: Optional[Value] = None,
    dense: bool = False,
    redo: Optional[Value] = None,
    threads: Optional[int] = None,
    progress: Progress = None,
) -> dict[str, Any]: ...
def extract_features(
    inputs: Optional[Value] = None,
    output: Optional[Value] = None,
    *,
    database: Optional[Value] = None,
    every: Optional[Value] = None,
    timestamps: Optional[Value] = None,
    masks: Optional[Value] = None,
    max_size: Optional[Value] = None,
    max_megapixels: Optional[Value] = None,
    cameras: Optional[Value] = None,
    intrinsics: Optional[Value] = None,
    calibration: Optional[Value] = None,
    focal_prior: Optional[Value] = None,
    camera_model: Optional[Value] = None,
    shard: Optional[Value] = None,
    redo: Optional[Value] = None,
    threads: Optional[int] = None,
    progress: Progress = None,
) -> dict[str, Any]: ...
def match_images(
    workspace: Value,
    *,
    pairs: Optional[Value] = None,
    seed: Optional[Value] = None,
    shard: Optional[Value] = None,
    redo: Optional[Value] = None,
    threads: Optional[int] = None,
    progress: Progress = None,
) -> dict[str, Any]: ...
def map_images(
    workspace: Value,
    *,
    rig: Optional[Value] = None,
    rig_calibration: Optional[Value] = None,
    refine: Optional[Value] = None,
    calibration_sigma: Optional[Value] = None,
    baseline: Optional[Value] = None,
    position_priors: Optional[Value] = None,
    control_points: Optional[Value] = None,
    input_model: Optional[Value] = None,
    fix_existing_frames: bool = False,
    rolling_shutter: Optional[Value] = None,
    submaps: Optional[Value] = None,
    max_memory: Optional[Value] = None,
    seed: Optional[Value] = None,
    submap: Optional[Value] = None,
    merge: bool = False,
    redo: Optional[Value] = None,
    threads: Optional[int] = None,
    progress: Progress = None,
) -> dict[str, Any]: ...
def dense(
    workspace: Value,
    *,
    max_size: Optional[Value] = None,
    masks: Optional[Value] = None,
    normal_maps: bool = False,
    depth_pngs: bool = False,
    redo: Optional[Value] = None,
    threads: Optional[int] = None,
    progress: Progress = None,
) -> dict[str, Any]: ...
def localize(
    model: Value,
    inputs: Value,
    output: Value,
    *,
    intrinsics: Optional[Value] = None,
    calibration: Optional[Value] = None,
    focal_prior: Optional[Value] = None,
    camera_model: Optional[Value] = None,
    masks: Optional[Value] = None,
    max_size: Optional[Value] = None,
    seed: Optional[Value] = None,
    threads: Optional[int] = None,
    progress: Progress = None,
) -> dict[str, Any]: ...
def adjust(
    model: Value,
    *,
    output: Optional[Value] = None,
    overwrite: bool = False,
    fix_intrinsics: bool = False,
    control_points: Optional[Value] = None,
    threads: Optional[int] = None,
    progress: Progress = None,
) -> dict[str, Any]: ...
def evaluate_poses(
    model: Value,
    truth: Value,
    *,
    images: Optional[Value] = None,
    threads: Optional[int] = None,
    progress: Progress = None,
) -> dict[str, Any]: ...
def evaluate_cloud(
    cloud: Value,
    reference: Value,
    *,
    align: Optional[Value] = None,
    truth: Optional[Value] = None,
    threads: Optional[int] = None,
    progress: Progress = None,
) -> dict[str, Any]: ...
def evaluate_points(
    model: Value,
    points: Value,
    *,
    threads: Optional[int] = None,
    progress: Progress = None,
) -> dict[str, Any]: ...
def model_info(
    model: Value,
    *,
    threads: Optional[int] = None,
    progress: Progress = None,
) -> dict[str, Any]: ...
def model_transform(
    model: Value,
    by: Value,
    output: Value,
    *,
    inverse: bool = False,
    threads: Optional[int] = None,
    progress: Progress = None,
) -> dict[str, Any]: ...
def model_align(
    model: Value,
    output: Value,
    *,
    to: Optional[Value] = None,
    positions: Optional[Value] = None,
    max_error: Optional[Value] = None,
    control_points: Optional[Value] = None,
    max_error_px: Optional[Value] = None,
    save_transform: Optional[Value] = None,
    overwrite: bool = False,
    threads: Optional[int] = None,
    progress: Progress = None,
) -> dict[str, Any]: ...
def model_crop(
    model: Value,
    output: Value,
    *,
    box: Optional[Value] = None,
    quantiles: Optional[Value] = None,
    threads: Optional[int] = None,
    progress: Progress = None,
) -> dict[str, Any]: ...
def model_merge(
    models: Value,
    output: Value,
    *,
    max_error_px: Optional[Value] = None,
    threads: Optional[int] = None,
    progress: Progress = None,
) -> dict[str, Any]: ...
def export(
    workspace: Value,
    to: Value,
    output: Value,
    *,
    overwrite: bool = False,
    crs: Optional[Value] = None,
    images: Optional[Value] = None,
    rigid: bool = False,
    detected_keypoints: bool = False,
    threads: Optional[int] = None,
    progress: Progress = None,
) -> dict[str, Any]: ...
def undistort_images(
    model: Value,
    output: Value,
    *,
    images: Optional[Value] = None,
    masks: Optional[Value] = None,
    detected_keypoints: bool = False,
    downscale: Optional[Value] = None,
    blank_pixels: Optional[Value] = None,
    min_scale: Optional[Value] = None,
    max_scale: Optional[Value] = None,
    max_size: Optional[Value] = None,
    threads: Optional[int] = None,
    progress: Progress = None,
) -> dict[str, Any]: ...
def view(
    workspace: Value,
    *,
    threads: Optional[int] = None,
    progress: Progress = None,
) -> dict[str, Any]: ...
def synth(
    output: Value,
    *,
    collection: Optional[Value] = None,
    photos: Optional[Value] = None,
    frames: Optional[Value] = None,
    size: Optional[Value] = None,
    seed: Optional[Value] = None,
    rate: Optional[Value] = None,
    route: Optional[Value] = None,
    carrier: Optional[Value] = None,
    length: Optional[Value] = None,
    view_direction: Optional[Value] = None,
    effects: Optional[Value] = None,
    scan: bool = False,
    depths: bool = False,
    threads: Optional[int] = None,
    progress: Progress = None,
) -> dict[str, Any]: ...
def demo(
    *,
    output: Optional[Value] = None,
    frames: Optional[Value] = None,
    size: Optional[Value] = None,
    seed: Optional[Value] = None,
    threads: Optional[int] = None,
    progress: Progress = None,
) -> dict[str, Any]: ...
def experiment_mounting(
    *,
    output: Optional[Value] = None,
    frames: Optional[Value] = None,
    size: Optional[Value] = None,
    seed: Optional[Value] = None,
    rate: Optional[Value] = None,
    route: Optional[Value] = None,
    length: Optional[Value] = None,
    effects: Optional[Value] = None,
    pairs: Optional[Value] = None,
    no_dense: bool = False,
    threads: Optional[int] = None,
    progress: Progress = None,
) -> dict[str, Any]: ...
def experiment_baseline(
    *,
    output: Optional[Value] = None,
    frames: Optional[Value] = None,
    size: Optional[Value] = None,
    seed: Optional[Value] = None,
    rate: Optional[Value] = None,
    route: Optional[Value] = None,
    length: Optional[Value] = None,
    effects: Optional[Value] = None,
    pairs: Optional[Value] = None,
    no_dense: bool = False,
    rig: Optional[Value] = None,
    threads: Optional[int] = None,
    progress: Progress = None,
) -> dict[str, Any]: ...
