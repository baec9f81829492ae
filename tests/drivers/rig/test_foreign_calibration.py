"""Calibrations of other programs: each is told as what it is, with its lens, and none is taken for
PATH's own.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from drivers.rig.calibration_file import CalibrationError, read_camera, read_mount
from missions.ground import rig_library

ROS = """image_width: 640
image_height: 480
camera_name: cam
camera_matrix: {rows: 3, cols: 3, data: [600.0, 0.0, 320.0, 0.0, 600.0, 240.0, 0.0, 0.0, 1.0]}
distortion_model: MODEL
distortion_coefficients: {rows: 1, cols: N, data: [COEFFICIENTS]}
"""


def ros(model: str, count: int) -> str:
    coefficients = ", ".join(["0.1"] * count)
    return (
        ROS.replace("MODEL", model).replace("N,", f"{count},").replace("COEFFICIENTS", coefficients)
    )


KALIBR = """cam0:
  camera_model: pinhole
  distortion_coeffs: [0.01, 0.02, 0.003, 0.004]
  distortion_model: MODEL
  intrinsics: [600.0, 600.0, 320.0, 240.0]
  resolution: [640, 480]
"""
XML = """<?xml version="1.0"?>
<opencv_storage><camera_matrix type_id="opencv-matrix"><rows>3</rows><cols>3</cols></camera_matrix></opencv_storage>
"""
YAML = "%YAML:1.0\n---\nK: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   data: [600., 0., 320.]\n"
FILES = {
    "plumb.yaml": (ros("plumb_bob", 5), "a camera_info of ROS"),
    "fisheye.yaml": (ros("equidistant", 4), "a camera_info of ROS"),
    "radtan.yaml": (KALIBR.replace("MODEL", "radtan"), "a camera chain of Kalibr"),
    "opencv.xml": (XML, "OpenCV's FileStorage"),
    "opencv.yml": (YAML, "OpenCV's FileStorage"),
    "opencv.json": ('{"K": {"type_id": "opencv-matrix", "rows": 3}}', "OpenCV's FileStorage"),
    "d435.json": ('{"fx": 600, "ppx": 320, "ppy": 240, "model": "plumb"}', "librealsense"),
    "oak.json": ('{"cameraData": [[0, {"intrinsicMatrix": []}]]}', "DepthAI"),
    "cameras.txt": (
        "# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n1 PINHOLE 640 480 6 6 3 3\n",
        "COLMAP",
    ),
}
MATLAB = '{"FocalLength": [600, 600], "RadialDistortion": [0.1, 0.2]}'


@pytest.mark.parametrize("name", FILES)
def test_a_calibration_of_another_program_is_told_as_what_it_is(tmp_path: Path, name: str) -> None:
    content, what = FILES[name]
    fix = f"path-handoff calibrate import {name}"
    file = tmp_path / name
    file.write_text(content, "utf-8")
    for read in (read_camera, read_mount):
        with pytest.raises(CalibrationError) as refused:
            read(file)
        assert name in str(refused.value) and what in str(refused.value)
        assert fix in refused.value.remedy
    (tmp_path / "rig.toml").write_text(
        f'like = "sim"\n[sender.camera]\ncalibration = "{name}"\n', "utf-8"
    )
    with pytest.raises(rig_library.RigError) as error:
        rig_library.load(str(tmp_path / "rig.toml"))
    assert "sender.camera.calibration" in str(error.value) and what in str(error.value)
    assert fix in str(error.value)


def test_what_cannot_be_read_is_to_be_written_into_the_rig(tmp_path: Path) -> None:
    (tmp_path / "matlab.json").write_text(MATLAB, "utf-8")
    with pytest.raises(CalibrationError, match="MATLAB") as refused:
        read_camera(tmp_path / "matlab.json")
    assert "write its numbers into [sender.camera]" in refused.value.remedy


NO_CALIBRATIONS = {
    "empty.toml": b"",
    "words.toml": b"hello\n",
    "a-picture.jpg": b"\xff\xd8\xff\xe0" + bytes(64),
    "a-list.json": b"[1, 2, 3]",
    "cut.json": b'{"width": 640',
    "utf-16.toml": 'kind = "camera"\n'.encode("utf-16"),
    "a-mount.toml": b'kind = "mount"\nversion = 1\n',
    "of-tomorrow.toml": b'kind = "camera"\nversion = 99\n',
}


@pytest.mark.parametrize("name", NO_CALIBRATIONS)
def test_what_is_no_calibration_is_refused_by_its_name(tmp_path: Path, name: str) -> None:
    file = tmp_path / name
    file.write_bytes(NO_CALIBRATIONS[name])
    with pytest.raises(CalibrationError) as refused:
        read_camera(file)
    assert name in str(refused.value)
    assert "calibrate camera" in refused.value.remedy
    assert file.read_bytes() == NO_CALIBRATIONS[name]
