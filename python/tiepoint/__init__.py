"""Structure from motion for cameras mounted on one vehicle: photos in, a COLMAP model out.

The commands of the program are functions: `reconstruct` and its stages `extract_features`,
`match_images`, `map_images` and `dense`; `localize`, `adjust`, `export`, `view`,
`evaluate_poses`, `model_info` and others (`commands()` lists them). Their options are keywords, and
they return the result of `--json` as a dictionary. `Reconstruction` holds a model as numpy arrays;
`sift`, `match`, `relative_pose`, `absolute_pose`, `generalized_absolute_pose`, `homography`,
`fundamental`, `similarity`, `triangulate`, `average_relative_pose`, `clock_offset`, `bundle_adjust`
and `undistort` work on arrays.
"""

from ._convert import from_pycolmap, to_pycolmap
from ._tiepoint import (
    Camera,
    Error,
    Image,
    Reconstruction,
    UsageError,
    __version__,
    absolute_pose,
    average_relative_pose,
    bundle_adjust,
    clock_offset,
    fundamental,
    generalized_absolute_pose,
    homography,
    match,
    relative_pose,
    sift,
    similarity,
    triangulate,
    undistort,
)
from .commands import FUNCTIONS as _FUNCTIONS
from .commands import commands

globals().update(_FUNCTIONS)

__all__ = [
    "Camera",
    "Error",
    "Image",
    "Reconstruction",
    "UsageError",
    "__version__",
    "absolute_pose",
    "average_relative_pose",
    "bundle_adjust",
    "clock_offset",
    "commands",
    "from_pycolmap",
    "fundamental",
    "generalized_absolute_pose",
    "homography",
    "match",
    "relative_pose",
    "sift",
    "similarity",
    "to_pycolmap",
    "triangulate",
    "undistort",
    *_FUNCTIONS,
]
