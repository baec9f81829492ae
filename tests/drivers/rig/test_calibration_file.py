"""Calibrations on disk: what is written can be read, by a rig too; what does not belong together is
refused.
"""

from __future__ import annotations

import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drivers.rig.calibration_file import (
    CalibrationError,
    CameraCalibration,
    CameraTable,
    MarkerPrint,
    MountCalibration,
    Quality,
    check_serial,
    check_size,
    read_camera,
    read_mount,
    write_calibration,
)
from drivers.rig.check import check_rig
from drivers.rig.file import load_rig
from drivers.rig.tables import RigError
from drivers.rig.toml_text import toml_text
from missions.ground import rig_library

DOUBT = (1.5, 1.4, 0.1, -0.2, 0.01, -0.05, 0.0, 0.001, 0.1)
CAMERA = CameraCalibration(
    kind="camera",
    version=1,
    made="2026-11-21T20:00:00+00:00",
    serial="0815",
    source="views",
    board="a board",
    camera=CameraTable(
        640, 480, 610.1234568, 611.0, 320.5, 240.25, (0.1, -0.2, 0.001, -0.002, 0.05), (DOUBT,)
    ),
    standard_errors={"fx": 0.1, "fy": 0.1},
    quality=Quality(0.02, 0.021, 25, 1300, 0.9),
)
MOUNT = MountCalibration(
    kind="mount",
    version=1,
    made="2026-11-21T20:00:00+00:00",
    serial="0815",
    source="pairs",
    markers=(MarkerPrint(0, 0.040),),
    position_v_m=(0.01, 0.02, -0.28),
    q_v_c=(0.5, 0.5, -0.5, 0.5),
    position_sigma_m=(0.0002, 0.0003, 0.0004),
    rotation_sigma_deg=(0.02, 0.02, 0.01),
)


def rig_with(
    tmp_path: Path, *, camera: str | None = None, marker: str | None = None, more: str = ""
) -> Path:
    """The rig sim-rendered with the sender's numbers replaced."""
    table = tomllib.loads(rig_library.whole("sim-rendered"))
    sender = table["sender"]
    if camera is not None:
        sender["camera"] = tomllib.loads(camera)
    if marker is not None:
        sender["mount"]["marker"] = tomllib.loads(marker)
    sender["perception"]["camera"].update(tomllib.loads(more))
    file = tmp_path / "rig.toml"
    file.write_text(toml_text(table), "utf-8")
    return file


def test_a_file_comes_back_as_it_was_and_a_person_can_read_it(tmp_path: Path) -> None:
    write_calibration(tmp_path / "c.toml", CAMERA)
    write_calibration(tmp_path / "m.toml", MOUNT)
    assert read_camera(tmp_path / "c.toml") == CAMERA
    assert read_mount(tmp_path / "m.toml") == MOUNT
    lines = (tmp_path / "c.toml").read_text("utf-8").splitlines()
    assert lines[0].startswith("# Made by `path-handoff calibrate camera`")
    assert "fx = 610.1234568" in (tmp_path / "c.toml").read_text("utf-8")


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("version = 1", "version = 2", "version 2 of this file is not known"),
        ('kind = "camera"', 'kind = "mount"', "kind: expected one of"),
        ("fx = 610", "focal = 610", "unknown key 'focal'"),
        ("width = 640", "width = 300", "another stream size"),
        ("[camera]", "[camera", "c.toml"),
    ],
)
def test_a_damaged_file_is_refused_with_its_name(
    tmp_path: Path, old: str, new: str, words: str
) -> None:
    file = tmp_path / "c.toml"
    write_calibration(file, CAMERA)
    file.write_text(file.read_text("utf-8").replace(old, new), "utf-8")
    with pytest.raises(CalibrationError, match=words) as caught:
        read_camera(file)
    assert "calibrate camera" in caught.value.remedy
    with pytest.raises(CalibrationError, match="No such file"):
        read_camera(tmp_path / "missing.toml")


def test_a_rig_takes_camera_and_mount_from_their_files(tmp_path: Path) -> None:
    write_calibration(tmp_path / "c.toml", CAMERA)
    write_calibration(tmp_path / "m.toml", MOUNT)
    rig = load_rig(
        rig_with(tmp_path, camera='calibration = "c.toml"', marker='calibration = "m.toml"')
    )
    assert rig.sender.camera == CAMERA.camera.model()
    assert rig.sender.camera.doubts == (DOUBT,)
    assert rig.receiver.camera.doubts == ()
    assert rig.sender.camera_serial == "0815"
    assert rig.receiver.camera_serial == ""
    assert rig.sender.mount.T_v_c.t == pytest.approx(np.array(MOUNT.position_v_m))
    assert pytest.approx(MOUNT.T_v_c.R) == rig.sender.mount.T_v_c.R
    assert rig.receiver.mount.T_b_v.t == pytest.approx(rig.sender.mount.T_b_v.t)


@pytest.mark.parametrize(
    ("mount", "words"),
    [
        (
            replace(MOUNT, markers=(MarkerPrint(0, 0.050),)),
            r"it is of the markers 0 \(50 mm\), this rig has 0 \(40 mm",
        ),
        (replace(MOUNT, serial="4711"), "serial number 4711, sender.camera.calibration of 0815"),
        (
            replace(MOUNT, position_sigma_m=(0.001, 0.006, 0.001)),
            "promise more than .* has: 0.006 m",
        ),
    ],
)
def test_a_mount_of_something_else_is_refused(
    tmp_path: Path, mount: MountCalibration, words: str
) -> None:
    write_calibration(tmp_path / "c.toml", CAMERA)
    write_calibration(tmp_path / "m.toml", mount)
    with pytest.raises(RigError, match=words):
        load_rig(
            rig_with(tmp_path, camera='calibration = "c.toml"', marker='calibration = "m.toml"')
        )


def test_a_missing_calibration_names_rig_key_and_file(tmp_path: Path) -> None:
    with pytest.raises(
        RigError, match=r"rig.toml: sender.camera.calibration: .*gone.toml: No such file"
    ):
        load_rig(rig_with(tmp_path, camera='calibration = "gone.toml"'))
    with pytest.raises(RigError, match=r"rig.toml: sender.camera: unknown key 'fx'"):
        load_rig(rig_with(tmp_path, camera='calibration = "gone.toml"\nfx = 600.0'))


def test_a_rig_whose_camera_has_another_serial_number_is_refused(tmp_path: Path) -> None:
    write_calibration(tmp_path / "c.toml", CAMERA)
    folder = tmp_path / "recorded"
    folder.mkdir()

    def rig(serial: str) -> Path:
        file = rig_with(tmp_path, camera='calibration = "c.toml"', more="")
        text = file.read_text("utf-8")
        begin = text.index("[sender.perception.camera]")
        end = text.index("[sender.perception.detector]")
        part = f'factory = "drivers.recordings.camera:RecordedCamera"\nfile = "recorded"\nserial = "{serial}"\n\n'
        file.write_text(f"{text[:begin]}[sender.perception.camera]\n{part}{text[end:]}", "utf-8")
        return file

    with pytest.raises(RigError, match=r"camera with serial number 0815, this one is 4711"):
        check_rig(load_rig(rig("4711")))
    check_rig(load_rig(rig("0815")))


def test_sizes_and_serial_numbers_that_differ_are_both_named() -> None:
    check_size((640, 480), (640, 480), "stream")
    with pytest.raises(CalibrationError, match="for 640x480 px but the frames are 1280x720 px"):
        check_size((640, 480), (1280, 720), "stream")
    for calibrated, camera in (("", "2"), ("1", ""), ("1", "1")):
        check_serial(calibrated, camera, "camera")
    with pytest.raises(CalibrationError, match="serial number 1, this one is 2"):
        check_serial("1", "2", "camera")


def test_toml_comes_back_whatever_is_in_it() -> None:
    table = {
        "text": 'a "quoted" \\ line\nand\ttab Ω',
        "flag": True,
        "list": [1, 2.5, -3e-9],
        "inner": {"x": 1.0, "deep": {"y": "z"}},
        "many": [{"a": 1}, {"a": 2}],
    }
    assert tomllib.loads(toml_text(table, "a comment\nof two lines")) == table
    with pytest.raises(TypeError, match="cannot write a set"):
        toml_text({"x": {1, 2}})
