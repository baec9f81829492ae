"""Calibrations that other programs wrote: what they are is told, and their lens; none is taken for
one of PATH's.

A lens of another model has numbers of the same names: eight of a rational one, four of a fisheye.
Taken as Brown-Conrady's they give a camera that looks right in the middle of the image and is wrong
at its edges.
"""

from __future__ import annotations

from collections.abc import Sequence

PROGRAMS: Sequence[tuple[str, tuple[str, ...]]] = (
    ("a camera_info of ROS", ("camera_matrix", "distortion_model")),
    ("a camera_info of ROS", ("camera_matrix", "image_width")),
    ("a camera chain of Kalibr", ("camera_model", "intrinsics")),
    ("a file of OpenCV's FileStorage", ("opencv_storage",)),
    ("a file of OpenCV's FileStorage", ("%YAML:1.0",)),
    ("a file of OpenCV's FileStorage", ("opencv-matrix",)),
    ("a cameras.txt of COLMAP", ("CAMERA_ID, MODEL",)),
    ("a file of librealsense", ("ppx", "ppy")),
    ("a calibration of MATLAB", ("FocalLength", "RadialDistortion")),
    ("a calibration of MATLAB", ("IntrinsicMatrix",)),
)
"""What a file is, by words that are all in it."""
LENSES: Sequence[tuple[str, str]] = (
    ("rational_polynomial", "a rational lens (eight coefficients)"),
    ("rational", "a rational lens (eight coefficients)"),
    ("equidistant", "an equidistant lens (a fisheye, four coefficients)"),
    ("fisheye", "a fisheye lens"),
    ("kannala", "a fisheye lens of Kannala and Brandt"),
    ("thin_prism", "a lens with thin prisms"),
    ("inverse_brown", "an inverse Brown-Conrady lens"),
    ("inverse brown", "an inverse Brown-Conrady lens"),
    ("omni", "an omnidirectional lens"),
    ("double_sphere", "a double-sphere lens"),
    ("mei", "an omnidirectional lens"),
)
"""Models that are none of this program's; the first that is named counts."""
OWN_LENS = (
    "[sender.camera] or [receiver.camera] of the rig: "
    "width, height, fx, fy, cx, cy, distortion = [k1, k2, p1, p2, k3]"
)


def foreign_calibration(text: str) -> tuple[str, str] | None:
    """Return what another program's calibration is, and how to go on; None for what is none that is
    known.
    """
    program = next((name for name, words in PROGRAMS if all(word in text for word in words)), None)
    if program is None:
        return None
    lower = text.lower()
    lens = next((name for word, name in LENSES if word in lower), None)
    if lens is None:
        return f"this is {program}", f"write its numbers into {OWN_LENS}"
    again = "calibrate this camera with `path-handoff calibrate camera`, which says whether such a lens fits"
    return (
        f"this is {program}, of {lens}: a rig's lens is Brown-Conrady's, with k1 k2 p1 p2 k3",
        again,
    )
