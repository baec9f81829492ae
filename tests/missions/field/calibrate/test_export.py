"""Calibrations written for other programs: what they read is the camera that PATH has."""

from __future__ import annotations

import io
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from drivers.interfaces import PartError
from drivers.rig.calibration_file import (
    made_of_no_views,
    read_camera,
    write_calibration,
)
from missions.field.calibrate.export import export_camera
from missions.field.calibrate.foreign import import_camera
from missions.ground.options.calibrate import CalibrateExportOptions, CalibrateImportOptions
from path.camera.model import CameraModel

BENT = (0.08, -0.15, 0.001, -0.002, 0.03)
NO_K3 = (0.08, -0.15, 0.001, -0.002, 0.0)
STRONG_K3 = (0.08, -0.15, 0.001, -0.002, 0.4)


def calibration(folder: Path, distortion: tuple[float, float, float, float, float]) -> Path:
    camera = CameraModel(640, 480, 610.0, 612.0, 318.0, 243.0, distortion)
    made = made_of_no_views(camera, "0815", "a test", "weak", "by hand")
    file = folder / "d1.camera.toml"
    write_calibration(file, made)
    return file


def exported(file: Path, to: str, out: Path) -> Path:
    options = CalibrateExportOptions(file, to=to, out=out)  # type: ignore[arg-type]
    assert export_camera(options, io.StringIO()) == 0
    return out


@pytest.mark.parametrize(("to", "distortion"), [("ros", BENT), ("opencv", BENT), ("kalibr", NO_K3)])
def test_what_is_exported_and_imported_again_is_the_same_camera(
    tmp_path: Path, to: str, distortion: tuple[float, float, float, float, float]
) -> None:
    file = calibration(tmp_path, distortion)
    foreign = exported(file, to, tmp_path / "theirs.yaml")
    back = tmp_path / "back.toml"
    assert import_camera(CalibrateImportOptions(foreign, out=back), io.StringIO()) == 0
    before, after = read_camera(file).camera, read_camera(back).camera
    assert (after.width, after.height) == (before.width, before.height)
    assert np.allclose([after.fx, after.fy, after.cx, after.cy], [610.0, 612.0, 318.0, 243.0])
    assert np.allclose(after.distortion, before.distortion)


def test_opencv_projects_by_its_file_to_the_pixels_of_this_camera(tmp_path: Path) -> None:
    file = calibration(tmp_path, BENT)
    foreign = exported(file, "opencv", tmp_path / "theirs.yml")
    storage = cv2.FileStorage(str(foreign), cv2.FILE_STORAGE_READ)
    matrix = storage.getNode("camera_matrix").mat()
    lens = storage.getNode("distortion_coefficients").mat()
    storage.release()
    points = np.array([[0.3, -0.2, 1.0], [-0.4, 0.3, 1.0], [0.45, 0.33, 1.0]])
    theirs, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), matrix, lens)
    ours = read_camera(file).camera.model().project(points)
    assert np.allclose(theirs.reshape(-1, 2), ours, atol=1e-6)


def test_a_camera_info_has_what_ros_asks_for(tmp_path: Path) -> None:
    info = yaml.safe_load(
        exported(calibration(tmp_path, BENT), "ros", tmp_path / "ros.yaml").read_text("utf-8")
    )
    assert info["camera_name"] == "0815"
    assert info["distortion_model"] == "plumb_bob"
    for name, rows, columns in (
        ("camera_matrix", 3, 3),
        ("distortion_coefficients", 1, 5),
        ("rectification_matrix", 3, 3),
        ("projection_matrix", 3, 4),
    ):
        matrix = info[name]
        assert (matrix["rows"], matrix["cols"]) == (rows, columns)
        assert len(matrix["data"]) == rows * columns


def test_a_lens_that_kalibr_cannot_say_is_refused_by_how_far_it_would_be_off(
    tmp_path: Path,
) -> None:
    file = calibration(tmp_path, STRONG_K3)
    with pytest.raises(PartError, match=r"no k3.*off by \d+\.\d px"):
        exported(file, "kalibr", tmp_path / "theirs.yaml")
    assert not (tmp_path / "theirs.yaml").exists()


def test_a_file_of_somebody_else_is_not_written_over(tmp_path: Path) -> None:
    other = tmp_path / "notes.txt"
    other.write_text("do not lose this", "utf-8")
    with pytest.raises(PartError, match="not written over"):
        exported(calibration(tmp_path, BENT), "ros", other)
    assert other.read_text("utf-8") == "do not lose this"
