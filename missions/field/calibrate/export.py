"""``path-handoff calibrate export``: PATH's calibration in the words of another program."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, TextIO

import cv2
import numpy as np
import yaml

from drivers.rig.calibration_file import (
    MADE_BY,
    CalibrationError,
    CameraCalibration,
    read_camera,
)
from missions.ground.held import held_file
from missions.ground.options.calibrate import CalibrateExportOptions
from missions.ground.run_folder import claim_result
from path.camera.lenses import GRID, MOST_PX
from path.camera.model import CameraModel

CAMERA_NAME = "camera"  # of one whose serial number is not known


def export_camera(options: CalibrateExportOptions, out: TextIO) -> int:
    """Carry the command out; return 0 when the file was written. Raises PartError."""
    calibration = read_camera(options.file)
    text = WRITERS[options.to](calibration, options.file)
    target = options.out or options.file.with_suffix(SUFFIXES[options.to])
    with held_file(target):
        claim_result(target, MADE_BY)
        target.write_text(text, "utf-8")
    out.write(
        f"{target}: {options.to}, {calibration.camera.width}x{calibration.camera.height} px\n"
    )
    return 0


def _ros(calibration: CameraCalibration, source: Path) -> str:
    camera = calibration.camera
    matrix = [camera.fx, 0.0, camera.cx, 0.0, camera.fy, camera.cy, 0.0, 0.0, 1.0]
    straight = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
    projection = [*matrix[0:3], 0.0, *matrix[3:6], 0.0, *matrix[6:9], 0.0]
    table = {
        "image_width": camera.width,
        "image_height": camera.height,
        "camera_name": calibration.serial or CAMERA_NAME,
        "camera_matrix": _matrix(3, 3, matrix),
        "distortion_model": "plumb_bob",
        "distortion_coefficients": _matrix(1, 5, list(camera.distortion)),
        "rectification_matrix": _matrix(3, 3, straight),
        "projection_matrix": _matrix(3, 4, projection),
    }
    return _yaml(table, calibration, source)


def _matrix(
    rows: int,
    columns: int,
    numbers: list[float],
) -> dict[str, Any]:
    return {"rows": rows, "cols": columns, "data": numbers}


def _kalibr(calibration: CameraCalibration, source: Path) -> str:
    """A camera chain of one. Raises CalibrationError for a lens that Kalibr's four numbers do not
    hold.
    """
    camera = calibration.camera
    k1, k2, p1, p2, k3 = camera.distortion
    off_px = _off_without_k3_px(camera.model()) if k3 else 0.0
    if off_px > MOST_PX:
        raise CalibrationError(
            f"{source}: Kalibr's radtan has no k3, and without it this lens is off by {off_px:.1f} px in its corners",
            "export it to ros or to opencv",
        )
    table = {
        "cam0": {
            "camera_model": "pinhole",
            "intrinsics": [camera.fx, camera.fy, camera.cx, camera.cy],
            "distortion_model": "radtan",
            "distortion_coeffs": [k1, k2, p1, p2],
            "resolution": [camera.width, camera.height],
        }
    }
    return _yaml(table, calibration, source)


def _off_without_k3_px(camera: CameraModel) -> float:
    """Return by how many pixels the lens is off at worst when its k3 is left out."""
    columns = np.linspace(0.0, camera.width - 1.0, GRID[0])
    rows = np.linspace(0.0, camera.height - 1.0, GRID[1])
    u, v = np.meshgrid(columns, rows)
    pixels = np.column_stack((u.ravel(), v.ravel()))
    plain = replace(camera, distortion=(*camera.distortion[:4], 0.0))
    points = np.column_stack((camera.rays(pixels), np.ones(len(pixels))))
    off = plain.project(points) - pixels
    return float(np.hypot(off[:, 0], off[:, 1]).max())


def _yaml(
    table: dict[str, Any],
    calibration: CameraCalibration,
    source: Path,
) -> str:
    text = yaml.safe_dump(table, sort_keys=False, default_flow_style=None, width=100)
    return f"# {_said(calibration, source)}\n{text}"


def _said(calibration: CameraCalibration, source: Path) -> str:
    """What these programs' files have no place for, in words."""
    errors = calibration.standard_errors
    known = ", ".join(f"{name} {sigma:.3g}" for name, sigma in errors.items())
    return (
        f"{MADE_BY} export` of {source.name}, made {calibration.made}, grade {calibration.grade};"
        f" standard errors: {known or 'not stated'}"
    )


def _opencv(calibration: CameraCalibration, source: Path) -> str:
    camera = calibration.camera
    flags = cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY
    storage = cv2.FileStorage(".yml", flags)
    storage.writeComment(_said(calibration, source))
    storage.write("image_width", camera.width)
    storage.write("image_height", camera.height)
    storage.write("camera_matrix", camera.model().K)
    storage.write("distortion_coefficients", np.array([camera.distortion]))
    return str(storage.releaseAndGetString())


WRITERS = {"ros": _ros, "kalibr": _kalibr, "opencv": _opencv}
SUFFIXES = {"ros": ".ros.yaml", "kalibr": ".kalibr.yaml", "opencv": ".opencv.yml"}
