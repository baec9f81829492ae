"""Calibrations of other programs, read as cameras: the same pixels as OpenCV gives for their
numbers.
"""

from __future__ import annotations

import io
import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from drivers.interfaces import PartError
from drivers.rig.calibration_file import read_camera
from missions.field.calibrate.foreign import import_camera
from missions.ground.options.calibrate import CalibrateImportOptions
from path.camera.model import CameraModel

FX, FY, CX, CY = 610.0, 612.0, 318.0, 243.0
MATRIX = np.array([[FX, 0.0, CX], [0.0, FY, CY], [0.0, 0.0, 1.0]])
PLAIN = (0.08, -0.15, 0.001, -0.002, 0.03)
RATIONAL = (0.3, -0.2, 0.001, -0.002, 0.03, 0.25, -0.12, 0.01)
FISHEYE = (0.02, -0.01, 0.004, -0.001)
POINTS = np.array([[0.0, 0.0, 1.0], [0.3, -0.2, 1.0], [-0.4, 0.3, 1.0], [0.45, 0.33, 1.0]])
SIZE = "image_width: 640\nimage_height: 480\n"


def flat(numbers: object) -> str:
    return ", ".join(str(k) for k in np.asarray(numbers, float).ravel())


def ros(model: str, numbers: tuple[float, ...]) -> str:
    return (
        f"{SIZE}camera_name: head\ndistortion_model: {model}\n"
        f"camera_matrix:\n  rows: 3\n  cols: 3\n  data: [{flat(MATRIX)}]\n"
        f"distortion_coefficients:\n  rows: 1\n  cols: {len(numbers)}\n  data: [{flat(numbers)}]\n"
    )


def kalibr(model: str, numbers: tuple[float, ...], lens: str = "pinhole") -> str:
    return (
        f"cam0:\n  camera_model: {lens}\n  distortion_coeffs: [{flat(numbers)}]\n"
        f"  distortion_model: {model}\n  intrinsics: [{FX}, {FY}, {CX}, {CY}]\n"
        "  resolution: [640, 480]\n  rostopic: /cam0/image_raw\n"
    )


def opencv(suffix: str, names: tuple[str, str], numbers: tuple[float, ...], size: bool) -> str:
    flags = cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY
    storage = cv2.FileStorage(suffix, flags)
    if size:
        storage.write("image_width", 640)
        storage.write("image_height", 480)
    storage.write(names[0], MATRIX)
    storage.write(names[1], np.array([numbers]))
    return storage.releaseAndGetString()


def colmap(model: str, numbers: tuple[float, ...]) -> str:
    values = " ".join(str(k) for k in (FX, FY, CX + 0.5, CY + 0.5, *numbers))
    return f"# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n1 {model} 640 480 {values}\n"


def printed(numbers: tuple[float, ...]) -> str:
    """A camera_info as ``ros2 topic echo`` prints it."""
    return (
        f"height: 480\nwidth: 640\ndistortion_model: plumb_bob\nd: [{flat(numbers)}]\n"
        f"k: [{flat(MATRIX)}]\nbinning_x: 0\n"
    )


def euroc(numbers: tuple[float, ...]) -> str:
    return (
        f"sensor_type: camera\nresolution: [640, 480]\ncamera_model: pinhole\n"
        f"intrinsics: [{FX}, {FY}, {CX}, {CY}]\ndistortion_model: radial-tangential\n"
        f"distortion_coefficients: [{flat(numbers)}]\n"
    )


def plain_json(numbers: tuple[float, ...]) -> str:
    named = {"camera_matrix": MATRIX.tolist(), "dist_coeffs": [list(numbers)]}
    return json.dumps({**named, "image_width": 640, "image_height": 480})


REALSENSE = {"width": 640, "height": 480, "fx": FX, "fy": FY, "ppx": CX, "ppy": CY}
DEPTHAI = {"width": 640, "height": 480, "intrinsicMatrix": MATRIX.tolist(), "cameraType": 0}


def realsense(model: str, numbers: tuple[float, ...]) -> str:
    return json.dumps({"color": {**REALSENSE, "model": model, "coeffs": numbers}})


def depthai(numbers: tuple[float, ...]) -> str:
    filled = [*numbers, *(0.0,) * (14 - len(numbers))]
    return json.dumps({"cameraData": [[0, {**DEPTHAI, "distortionCoeff": filled}]]})


OWN = ("camera_matrix", "distortion_coefficients")
FILES: dict[str, tuple[str, tuple[float, ...]]] = {
    "ros.yaml": (ros("plumb_bob", PLAIN), PLAIN),
    "ros8.yaml": (ros("rational_polynomial", RATIONAL), RATIONAL),
    "ros4.yaml": (ros("equidistant", FISHEYE), FISHEYE),
    "echo.yaml": (printed(PLAIN), PLAIN),
    "sensor.yaml": (euroc(PLAIN[:4]), PLAIN[:4]),
    "own5.json": (plain_json(PLAIN), PLAIN),
    "radtan.yaml": (kalibr("radtan", PLAIN[:4]), PLAIN[:4]),
    "equi.yaml": (kalibr("equidistant", FISHEYE), FISHEYE),
    "none.yaml": (kalibr("none", ()), (0.0,) * 5),
    "own.yml": (opencv(".yml", OWN, PLAIN, True), PLAIN),
    "own.xml": (opencv(".xml", ("cameraMatrix", "distCoeffs"), PLAIN, True), PLAIN),
    "own.json": (opencv(".json", ("K", "D"), RATIONAL, True), RATIONAL),
    "colmap.txt": (colmap("OPENCV", PLAIN[:4]), PLAIN[:4]),
    "fisheye.txt": (colmap("OPENCV_FISHEYE", FISHEYE), FISHEYE),
    "d435.json": (realsense("distortion.brown_conrady", PLAIN), PLAIN),
    "oak.json": (depthai(RATIONAL), RATIONAL),
}


def imported(tmp_path: Path, name: str, text: str, **more: str) -> tuple[CameraModel, str]:
    (tmp_path / name).write_text(text, "utf-8")
    out = io.StringIO()
    options = CalibrateImportOptions(tmp_path / name, out=tmp_path / "cam.toml", **more)
    assert import_camera(options, out) == 0
    calibration = read_camera(tmp_path / "cam.toml")
    assert calibration.grade == "weak" and calibration.source == name
    return calibration.camera.model(), out.getvalue()


def pixels_by_opencv(numbers: tuple[float, ...]) -> np.ndarray:
    still = np.zeros(3)
    if numbers == FISHEYE:
        points = POINTS.reshape(-1, 1, 3)
        seen, _ = cv2.fisheye.projectPoints(points, still, still, MATRIX, np.array(numbers))
    else:
        seen, _ = cv2.projectPoints(POINTS, still, still, MATRIX, np.array(numbers))
    return seen.reshape(-1, 2)


@pytest.mark.parametrize("name", FILES)
def test_a_camera_of_another_program_sees_where_opencv_says(tmp_path: Path, name: str) -> None:
    text, numbers = FILES[name]
    camera, told = imported(tmp_path, name, text)
    assert (camera.width, camera.height) == (640, 480)
    assert np.abs(camera.project(POINTS) - pixels_by_opencv(numbers)).max() < 0.25
    assert "640x480 px, lens" in told and "grade: weak" in told


def test_an_inverse_lens_is_no_plain_one(tmp_path: Path) -> None:
    plain, _ = imported(tmp_path, "a.json", realsense("brown_conrady", PLAIN))
    (tmp_path / "cam.toml").unlink()
    inverse, told = imported(tmp_path, "b.json", realsense("inverse_brown_conrady", PLAIN))
    assert "off by at most" in told
    assert np.abs(plain.project(POINTS) - inverse.project(POINTS)).max() > 5.0


def test_a_size_that_the_file_does_not_say_is_asked_for(tmp_path: Path) -> None:
    text = opencv(".yml", OWN, PLAIN, False)
    with pytest.raises(PartError) as refused:
        imported(tmp_path, "own.yml", text)
    assert "--size" in refused.value.remedy
    camera, _ = imported(tmp_path, "own.yml", text, size="640x480")
    assert camera.width == 640


def test_of_several_cameras_one_is_named(tmp_path: Path) -> None:
    text = kalibr("radtan", PLAIN[:4])
    two = text + kalibr("none", ()).replace("cam0", "cam1").replace("640, 480", "1280, 720")
    with pytest.raises(PartError, match="2 cameras in it, but cam0, cam1"):
        imported(tmp_path, "two.yaml", two)
    camera, _ = imported(tmp_path, "two.yaml", two, camera="cam1")
    assert camera.width == 1280


REFUSED = {
    "omni.yaml": (kalibr("radtan", PLAIN[:4], "omni"), "omni"),
    "prism.yaml": (ros("thin_prism_fisheye", FISHEYE), "thin_prism_fisheye"),
    "tilted.json": (depthai((*RATIONAL, 0.1, 0.2)), "thin prisms"),
    "wide.yaml": (ros("equidistant", (0.3, 0.2, 0.1, 0.05)).replace("610", "150"), "off by"),
    "cut.json": (realsense("brown_conrady", PLAIN)[:-30], "damaged"),
    "cut.yaml": (ros("plumb_bob", PLAIN)[:-60], "missing"),
    "short.txt": (colmap("OPENCV", PLAIN[:2]), "missing"),
    "new.txt": (colmap("THIN_PRISM_FISHEYE", PLAIN), "THIN_PRISM_FISHEYE"),
    "words.txt": ("hello\n", "no calibration that is known"),
    "empty.yml": ("%YAML:1.0\n---\n", "no camera"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_read_is_refused_by_what_it_is(tmp_path: Path, name: str) -> None:
    text, told = REFUSED[name]
    with pytest.raises(PartError, match=told):
        imported(tmp_path, name, text)
    assert not (tmp_path / "cam.toml").exists()
