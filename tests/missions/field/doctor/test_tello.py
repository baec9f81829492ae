"""A Tello's tests through djitellopy, on the emulated drone: its answers, its video, and a drone
that is not there.
"""

from __future__ import annotations

import pytest

from drivers.rig.part_check import Finding
from drivers.rig.parts import PartSpec, create
from drivers.tello.config import TelloVehicleConfig
from drivers.tello.vehicle import TelloVehicle
from missions.field.doctor import perception as doctor_perception
from missions.field.doctor import vehicle as doctor_vehicle
from missions.field.doctor.perception import check_perception
from missions.field.doctor.vehicle import check_flyer
from tests.drivers.tello.tello_stand import CAMERA, STATE_PORT, context, emulated
from tests.free_ports import free_host, free_port
from tests.missions.field.doctor.doctor_findings import found

TRIES = 5
MOTION = ("takeoff", "land", "rc", "emergency")


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("drivers.rig.part_check.COUNT_S", 0.5)
    monkeypatch.setattr(doctor_vehicle, "SAMPLE_S", 0.6)
    monkeypatch.setattr(doctor_perception, "SETTLE_S", 0.1)
    monkeypatch.setattr("drivers.tello.camera.PACE_S", 0.4)
    monkeypatch.setattr(doctor_perception, "SAMPLE_S", 0.5)
    monkeypatch.setattr(doctor_perception, "FRAME_S", 30.0)


def test_a_drone_that_is_well_answers_with_sdk_battery_and_state_packets_and_does_not_move() -> (
    None
):
    with emulated() as stand:
        every = found(
            check_flyer(
                TelloVehicle(TelloVehicleConfig(**stand.address), context()), context().clock, 0.2
            )
        )
        assert [word for word in MOTION if stand.count(word)] == []
    assert every["SDK"].detail == "30"
    assert every["serial"].detail == "0TQZH77ED00000"
    assert every["Wi-Fi"].detail == "signal to noise 90"
    for name in ("connects", "armed", "battery", "ready to arm", "temperature"):
        assert every[name].state == "ok", every
    assert "of 10 a second" in every["state packets"].detail


def test_an_early_firmware_cannot_have_other_ports() -> None:
    with emulated({"sdk3": False}) as stand:
        every = found(
            check_flyer(
                TelloVehicle(TelloVehicleConfig(**stand.address), context()), context().clock, 0.2
            )
        )
    assert every[""].state == "fault"  # other ports than the stock ones need SDK 3
    assert "SDK 3" in every[""].fix


def video_findings() -> dict[str, Finding]:
    with emulated(rate_hz=30.0) as stand:
        camera = {"factory": "drivers.tello.camera:TelloCamera", "latency_s": 0.0, **stand.address}
        options = {
            "camera": camera,
            "detector": {"factory": "drivers.detectors.color:ColorDetector"},
        }
        here = context()
        perception = create(
            PartSpec("drivers.perception.pixels:PixelPerception", options, "t"), here
        )
        return found(check_perception(perception, here.clock, None))


def test_its_video_is_timed_from_the_first_frame_on() -> None:
    every = video_findings()
    for _ in range(TRIES):
        if every["damaged"].state == "ok":  # a busy computer loses packets
            break
        every = video_findings()
    assert every["opens"].detail.startswith("first frame after ")
    assert "of 30 a second" in every["rate"].detail
    assert (
        every["size"].detail
        == f"{CAMERA.width}x{CAMERA.height}, as its calibration {CAMERA.width}x{CAMERA.height}"
    )
    assert every["latency"].state == every["damaged"].state == "ok"
    assert "range" not in every  # it has none of its own
    assert "marker" not in every  # a sender looks for none


def test_a_drone_that_is_not_there_is_a_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("drivers.tello.commands.COMMAND_S", 0.1)
    config = TelloVehicleConfig(host=free_host(), state_port=STATE_PORT, video_port=free_port())
    every = found(check_flyer(TelloVehicle(config, context()), context().clock, 0.2))
    assert list(every) == [""]
    assert "is the drone on" in every[""].fix
