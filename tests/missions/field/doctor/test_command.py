"""The doctor: what is missing is named with its fix, and nothing that flies is touched."""

from __future__ import annotations

import io
import socket
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from drivers.interfaces import CameraError
from drivers.rig.part_check import Finding, State
from missions.field.doctor import command as doctor
from missions.field.doctor import room
from missions.ground import rig_library
from missions.ground.options.field import DoctorOptions


def gives(value: Any) -> Callable[[str], Any]:
    return lambda _: value


@pytest.mark.parametrize(("state", "code"), [("ok", 0), ("note", 0), ("fault", doctor.EXIT_UNFIT)])
def test_only_faults_make_a_machine_unfit(
    monkeypatch: pytest.MonkeyPatch, state: State, code: int
) -> None:
    monkeypatch.setattr(doctor, "findings", gives([Finding(state, "thing", "is so", "do this")]))
    out = io.StringIO()
    assert doctor.run(DoctorOptions("sim"), out) == code
    assert "thing" in out.getvalue()
    assert "fix: do this" in out.getvalue()


def test_this_machine_has_what_the_tests_need() -> None:
    found = {finding.name: finding for finding in doctor.findings("no-such-rig")}
    for name in ("Python", "packages", "OpenCV", "MAVSDK", "pymavlink", "numba", "RealSense"):
        assert found[name].state == "ok", found[name]
    assert found["rig"].state == "fault"
    assert "no rig named 'no-such-rig'" in found["rig"].detail


@pytest.mark.parametrize(("rig", "state"), [("sitl", "fault"), ("sim", "note")])
def test_a_missing_camera_library_is_a_fault_where_it_is_needed(
    monkeypatch: pytest.MonkeyPatch, rig: str, state: State
) -> None:
    def missing() -> None:
        raise CameraError("pyrealsense2 cannot be used", "build librealsense")

    monkeypatch.setattr(doctor, "import_realsense", missing)
    finding = doctor.check_realsense(needed=doctor.uses(rig, doctor.REALSENSE))
    assert (finding.state, finding.fix) == (state, "build librealsense")


def test_an_opencv_with_windows_or_without_aruco_is_a_fault(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    text = "  GUI:                           QT5\n"
    fakes = {
        "without ArUco": SimpleNamespace(__version__="5", getBuildInformation=lambda: text),
        "QT5 windows": SimpleNamespace(
            __version__="5", aruco=None, getBuildInformation=lambda: text
        ),
    }
    for words, fake in fakes.items():
        monkeypatch.setattr(doctor.importlib, "import_module", gives(fake))
        finding = doctor.check_opencv()
        assert finding.state == "fault"
        assert words in finding.detail
        assert "pip uninstall" in finding.fix


def test_another_package_of_the_same_name_is_a_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    other = SimpleNamespace(__file__="/elsewhere/path/__init__.py")
    monkeypatch.setattr(doctor.importlib, "import_module", gives(other))
    assert doctor.check_paths().state == "fault"


def test_a_port_in_use_is_a_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    size = SimpleNamespace(width=640, height=480)
    own = SimpleNamespace(camera=size)
    rig = SimpleNamespace(file=Path("r.toml"), level="sitl", sender=own, receiver=own)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        port = taken.getsockname()[1]
        monkeypatch.setattr(doctor.rig_library, "load", gives(rig))
        monkeypatch.setattr(doctor, "local_ports", gives({port: "sender.link.bind"}))
        found = list(doctor.check_rig_file("r"))
    assert found[-1].state == "fault"
    assert f"{port} for sender.link.bind is in use" in found[-1].detail
    assert list(doctor.check_rig_file("r"))[-1].state == "ok"


def test_the_row_about_room_says_what_a_rig_records(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = rig_library.whole("sim-rendered")
    for record in ("keyframes", "all"):
        (tmp_path / f"{record}.toml").write_text(
            text.replace("[mission]\n", f'[mission]\nrecord = "{record}"\n'), "utf-8"
        )
    assert "record" not in room.check_room(str(tmp_path / "keyframes.toml")).detail
    found = room.check_room(str(tmp_path / "all.toml"))
    assert "MB a minute" in found.detail
    monkeypatch.setattr(room, "MINUTES", 1e6)
    assert room.check_room(str(tmp_path / "all.toml")).state == "note"


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (("side_m = 0.04", "side_m = 0.064"), "side_m (40.0 mm here, 64.0 mm there)"),
        (("[method]", "[method]\nmount_sigma_m = 0.003"), "[method]"),
        (("[mission]", "[mission]"), ""),
    ],
)
def test_the_other_drone_s_rig_is_compared_where_it_is_at_hand(
    tmp_path: Path, change: tuple[str, str], said: str
) -> None:
    text = rig_library.whole("sim-tello")
    assert change[0] in text
    other = tmp_path / "other.toml"
    other.write_text(text.replace(*change, 1), "utf-8")
    found = list(doctor.check_pair(rig_library.load("sim-tello"), str(other)))
    assert [finding.state for finding in found] == (["fault"] if said else ["ok"])
    assert said in found[0].detail


def test_another_rig_that_cannot_be_read_is_a_fault() -> None:
    (finding,) = doctor.check_pair(rig_library.load("sim"), "/nowhere/d2.toml")
    assert finding.state == "fault"
    assert "/nowhere/d2.toml" in finding.detail
