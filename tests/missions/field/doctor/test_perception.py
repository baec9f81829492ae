"""The test of a perception, with the D415 driver on librealsense's software device: what is well,
and what is not.
"""

from __future__ import annotations

import gc
import time
from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.perception.pixels import PixelPerception
from drivers.rig.part_check import Finding
from drivers.rig.parts import PartSpec, create
from missions.field.doctor import perception as doctor_perception
from missions.field.doctor.perception import (
    FrameSample,
    WantedMarker,
    age,
    brightness,
    check_detector,
    check_perception,
    rate,
)
from path.camera.model import CameraModel
from path.marker.layout import single_marker
from path.observations import Detection, Region
from tests.drivers.realsense.software_d415 import COLOR, FPS, context
from tests.missions.field.doctor.doctor_bench import BENCHES, Bench
from tests.missions.field.doctor.doctor_findings import found

LAYOUT = single_marker(side_m=1.5 * 30.0 / COLOR.fx)  # as large as 30 px are on a wall at 1.5 m
# a plate on a wall, a camera that looks ahead
WANTED = WantedMarker(LAYOUT, (0.0, -1.0, 0.0), (0.0, 1.0, 0.0))
FED_HZ = 40.0
TRIES = 5


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, seconds in (("SETTLE_S", 0.1), ("SAMPLE_S", 0.5), ("FRAME_S", 30.0)):
        monkeypatch.setattr(doctor_perception, name, seconds)


def picture(grey: int = 160, marker_px: int = 0) -> NDArray[np.uint8]:
    image = np.full((COLOR.height, COLOR.width), grey, np.uint8)
    if marker_px:
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, LAYOUT.dictionary))
        printed = cv2.aruco.generateImageMarker(dictionary, LAYOUT.markers[0].id, marker_px)
        image[20 : 20 + marker_px, 30 : 30 + marker_px] = printed
    return np.repeat(image[:, :, None], 3, axis=2)


def examined(bench: Bench, calibrated: str = "", model: CameraModel = COLOR) -> dict[str, Finding]:
    BENCHES["d415"] = bench
    source = {"factory": "tests.missions.field.doctor.doctor_bench:Named", "name": "d415"}
    camera = {
        "factory": "drivers.realsense.camera:RealSense",
        "fps": FPS,
        "silence_s": 30.0,
        "reopen_s": 0.0,
        "source": source,
    }
    options = {"camera": camera, "detector": {"factory": "drivers.detectors.color:ColorDetector"}}
    here = replace(context(model), camera_serial=calibrated)
    perception: PixelPerception = create(
        PartSpec("drivers.perception.pixels:PixelPerception", options, "test"), here
    )
    with bench.running(FED_HZ):
        every = found(check_perception(perception, here.clock, WANTED))
    del BENCHES["d415"], perception
    gc.collect()  # librealsense's devices have files open until they are collected
    return every


def test_a_camera_that_is_well_has_figures_and_a_marker() -> None:
    device = {
        "firmware_version": "5.16.0",
        "recommended_firmware_version": "5.16.0",
        "usb_type_descriptor": "3.2",
    }
    every = examined(Bench(picture(marker_px=30), device=device))
    for _ in range(TRIES):
        if every["pairs"].state == every["stamps"].state == "ok":  # a busy computer's may not be
            break
        every = examined(Bench(picture(marker_px=30), device=device))
    assert every["targets"].detail.endswith(" ms") or every["targets"].fix
    del every["calibration"], every["rate"], every["missed"], every["targets"]  # a busy computer's
    assert {finding.state for finding in every.values()} == {"ok"}, every
    assert "firmware 5.16.0" in every["device"].detail
    assert every["size"].detail == "96x72, as its calibration 96x72"
    assert every["range"].detail.startswith("1.50 m")
    assert every["stamped by"].detail == "global_time"
    assert every["marker"].detail.startswith("id 0 in 6 of 6 frames, side 30 px")


def test_a_plate_that_is_the_wrong_way_up_is_told() -> None:
    upside_down = np.ascontiguousarray(np.rot90(picture(marker_px=30), 2))
    every = examined(Bench(upside_down))
    assert every["marker"].state == "ok"
    assert every["marker turned"].state == "note"
    assert "is the plate the right way up" in every["marker turned"].detail
    assert "stand both drones level" in every["marker turned"].fix


def test_a_marker_whose_size_contradicts_depth_is_a_fault_with_the_size_that_depth_says(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    wrong = single_marker(side_m=1.6 * LAYOUT.markers[0].side_m)
    monkeypatch.setattr(
        "tests.missions.field.doctor.test_perception.WANTED", replace(WANTED, layout=wrong)
    )
    size = examined(Bench(picture(marker_px=30)))["marker size"]
    assert size.state == "fault"
    by_depth_mm = float(size.detail.partition("by the rig and ")[2].partition(" ")[0])
    assert by_depth_mm == pytest.approx(1000.0 * LAYOUT.markers[0].side_m, rel=0.03)
    assert "caliper" in size.fix


def test_a_marker_that_is_printed_wrongly_is_said_as_what_it_is() -> None:
    inverted, plate = picture(), (slice(10, 66), slice(20, 76))
    inverted[plate] = 255 - picture(255, marker_px=36)[plate]
    every = examined(Bench(inverted))
    assert every["marker"].state == "note"
    assert "marker 0 of DICT_4X4_50 is there, inverted, white on black" in every["marker"].detail


def test_what_is_not_as_it_should_be_is_said_with_its_fix() -> None:
    device = {
        "firmware_version": "5.15.0",
        "recommended_firmware_version": "5.16.0",
        "usb_type_descriptor": "2.1",
    }
    every = examined(Bench(picture(grey=20), skip=4, device=device))
    wrong = {
        "device": "5.16.0",
        "USB": "2.1",
        "missed": "%",
        "brightness": "mean 20",
        "marker": "no marker",
    }
    for name, words in wrong.items():
        assert every[name].state == "note", every[name]
        assert words in every[name].detail
        assert every[name].fix
    assert (
        every["calibration"].detail
        == "does not say of which camera it is; it is not compared with the camera's"
    )


def test_a_camera_that_is_silent_or_of_another_size_ends_the_test_with_its_reason() -> None:
    silent = Bench(picture())
    silent.plugged = False
    assert "nothing is plugged in" in examined(silent)[""].detail
    assert examined(silent)[""].state == "fault"
    other = replace(COLOR, width=100)
    assert examined(Bench(picture()), model=other)[""].state == "fault"


def sampled(stamps_s: Sequence[float], ids: Sequence[int], age_ms: float = 30.0) -> FrameSample:
    ages = tuple(round(age_ms * 1e6) for _ in ids)
    return FrameSample(tuple(round(each * 1e9) for each in stamps_s), tuple(ids), ages, ())


@pytest.mark.parametrize(("hz", "state"), [(30.0, "ok"), (27.0, "note"), (15.0, "fault")])
def test_the_rate_is_held_against_the_rig_s(hz: float, state: str) -> None:
    sample = sampled([k / hz for k in range(30)], range(30))
    assert rate(sample, 30.0).state == state
    assert rate(sample, None).state == "ok"


@pytest.mark.parametrize(("age_ms", "state"), [(30.0, "ok"), (-5.0, "fault"), (900.0, "fault")])
def test_frames_of_another_clock_are_a_fault(age_ms: float, state: str) -> None:
    assert age(sampled([0.0, 0.1, 0.2], [1, 2, 3], age_ms)).state == state


@pytest.mark.parametrize(("grey", "state"), [(130, "ok"), (2, "fault"), (254, "note")])
def test_a_picture_has_light_enough(grey: int, state: str) -> None:
    assert brightness(picture(grey)).state == state


class Slow:
    def __init__(self, seconds: float) -> None:
        self.seconds = seconds

    def detect(self, image: NDArray[np.uint8], region: Region | None) -> Sequence[Detection]:
        assert image.shape == (COLOR.height, COLOR.width, 3)
        end_s = time.monotonic() + self.seconds
        while time.monotonic() < end_s:
            pass
        return ()


def test_a_detector_slower_than_the_camera_is_told() -> None:
    clock = context().clock
    assert check_detector(Slow(0.0), COLOR, 30.0, clock).state == "ok"
    slow = check_detector(Slow(0.03), COLOR, 50.0, clock)
    assert slow.state == "note"
    assert "more than a frame's 20 ms" in slow.detail
