"""Calibrations that other programs wrote: what they are is told, and none is taken for one of
PATH's.

A lens of another model has numbers of the same names: eight of a rational one, four of a fisheye.
Taken as Brown-Conrady's they give a camera that looks right in the middle of the image and is wrong
at its edges. ``foreign_lens`` reads most of them with their lens.
"""

from __future__ import annotations

from collections.abc import Sequence

ROS = "a camera_info of ROS"
KALIBR = "a camera chain of Kalibr"
OPENCV = "a file of OpenCV's FileStorage"
COLMAP = "a cameras.txt of COLMAP"
REALSENSE = "a file of librealsense"
DEPTHAI = "a calibration of DepthAI"
MATRIX = "a camera matrix with its distortion"
MATLAB = "a calibration of MATLAB"
PROGRAMS: Sequence[tuple[str, tuple[str, ...]]] = (
    (OPENCV, ("opencv_storage",)),
    (OPENCV, ("%YAML:1.0",)),
    (OPENCV, ("opencv-matrix",)),
    (ROS, ("camera_matrix", "distortion_model")),
    (ROS, ("camera_matrix", "image_width")),
    (ROS, ("distortion_model: ", "width: ", "k:")),
    (ROS, ("distortion_model: ", "width: ", "K:")),
    (KALIBR, ("camera_model", "intrinsics")),
    (COLMAP, ("CAMERA_ID, MODEL",)),
    (REALSENSE, ("ppx", "ppy")),
    (DEPTHAI, ("cameraData", "intrinsicMatrix")),
    (MATLAB, ("FocalLength", "RadialDistortion")),
    (MATLAB, ("IntrinsicMatrix",)),
    (MATRIX, ("camera_matrix", "dist")),
)
"""What a file is, by words that are all in it; the first counts."""
NUMBERS = (
    "write its numbers into [sender.camera] or [receiver.camera] of the rig: "
    "width, height, fx, fy, cx, cy, distortion = [k1, k2, p1, p2, k3]"
)


def program_of(text: str) -> str | None:
    """Return what wrote a calibration; None for what is none that is known."""
    return next((name for name, words in PROGRAMS if all(word in text for word in words)), None)


def foreign_calibration(text: str, name: str) -> tuple[str, str] | None:
    """Return what another program's calibration is, and how to go on; None for what is none that is
    known.
    """
    program = program_of(text)
    if program is None:
        return None
    if program == MATLAB:
        return f"this is {program}", NUMBERS
    stem = name.rpartition(".")[0] or name
    return (
        f"this is {program}",
        f"read it with `path-handoff calibrate import {name} --out {stem}.camera.toml`, and name that",
    )
