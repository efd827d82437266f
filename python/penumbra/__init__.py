"""Tag tracking, shadow layers, camera calibration and pose errors: libpenumbra for Python.

Lengths are metres, angles radians, times nanoseconds, unless a name says otherwise (_px, _mm, _s).
T_a_b maps points of frame b to frame a; quaternions are in the order x, y, z, w. Images are numpy
arrays of uint8, which are read without a copy. Functions that fail raise penumbra.Error, whose
message is one line with the cause and the remedy. The document library.md describes the rest.

    camera = penumbra.CameraModel.load("camera.yaml")
    tracker = penumbra.Tracker(camera, penumbra.TagMap.load("tags.yaml"))
    result = tracker.track(image, time_ns)
    result.table.T_table_camera  # 4 x 4
"""

from ._penumbra import (
    ArgumentError,
    Calibration,
    Calibrator,
    CameraModel,
    Error,
    Errors,
    Estimate,
    GroupEstimate,
    Kernels,
    Layer,
    LightConstants,
    Model,
    Polygon,
    Pose,
    RejectedTag,
    Shadow,
    Statistics,
    TableEstimate,
    Tag,
    TagMap,
    Target,
    TrackedFrame,
    Tracker,
    Trajectory,
    ViewResult,
    __version__,
    calibrate_corners,
    evaluate,
    light_for_workspace,
    load_image,
    make_kernels,
    shadow_layers,
)
from ._calibrate import calibrate
from ._recording import Frame, Recording

__all__ = [
    "ArgumentError",
    "Calibration",
    "Calibrator",
    "CameraModel",
    "Error",
    "Errors",
    "Estimate",
    "Frame",
    "GroupEstimate",
    "Kernels",
    "Layer",
    "LightConstants",
    "Model",
    "Polygon",
    "Pose",
    "Recording",
    "RejectedTag",
    "Shadow",
    "Statistics",
    "TableEstimate",
    "Tag",
    "TagMap",
    "Target",
    "TrackedFrame",
    "Tracker",
    "Trajectory",
    "ViewResult",
    "calibrate",
    "calibrate_corners",
    "evaluate",
    "light_for_workspace",
    "load_image",
    "make_kernels",
    "shadow_layers",
]

# As for the names of the extension module, messages and help() show the name in the package.
for _object in (Frame, Recording, calibrate):
    _object.__module__ = __name__
del _object
