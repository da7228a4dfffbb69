#!/usr/bin/env python3
"""Writes tiepoint/__init__.pyi: the type stubs of the package, those of the commands from their
signatures. A test says if they are old.

    python python/stubs.py
"""

import inspect
import pathlib

import tiepoint
from tiepoint.commands import FUNCTIONS

STUBS = pathlib.Path(__file__).parent / "tiepoint/__init__.pyi"

HEAD = '''"""Type stubs, written by stubs.py."""

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
'''


def stub(name, function):
    lines, has_keywords = [], False
    for parameter in inspect.signature(function).parameters.values():
        if parameter.kind is parameter.KEYWORD_ONLY and not has_keywords:
            lines.append("    *,")
            has_keywords = True
        if parameter.name == "progress":
            lines.append("    progress: Progress = None,")
        elif parameter.name == "threads":
            lines.append("    threads: Optional[int] = None,")
        elif parameter.default is False:
            lines.append(f"    {parameter.name}: bool = False,")
        elif parameter.default is None:
            lines.append(f"    {parameter.name}: Optional[Value] = None,")
        else:
            lines.append(f"    {parameter.name}: Value,")
    return "\n".join([f"def {name}(", *lines, ") -> dict[str, Any]: ..."]) + "\n"


def text():
    return HEAD + "".join(stub(name, function) for name, function in FUNCTIONS.items())


if __name__ == "__main__":
    STUBS.write_text(text(), encoding="utf-8")
    print(f"{STUBS}: {tiepoint.__version__}")
