"""The way of the world's pictures to the driver through pyrealsense2: frames, stamps, and a world
that is gone.
"""

from __future__ import annotations

import asyncio
import time
import uuid
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from drivers.interfaces import CameraError
from drivers.realsense.camera import RealSense, RealSenseConfig
from drivers.rig.parts import PartSpec
from hil.camera.segment import folder
from hil.camera.shared import RUN_VARIABLE, SharedCameraWriter
from hil.camera.software_d415 import SoftwareD415, SoftwareD415Config
from hil.camera.software_device import DeviceClock
from hil.harness.realtime.parts import camera_config, depth_size
from missions.ground import rig_library
from path.messages import Role
from tests.drivers.realsense.software_d415 import COLOR, FPS, context

DEPTH_SIZE = (80, 60)
PATIENCE_S = 60.0


@pytest.fixture
def run() -> Iterator[str]:
    name = f"test-{uuid.uuid4().hex[:12]}"
    yield name
    assert not list(folder().glob(f"*{name}*"))


def driver(run: str, **options: Any) -> RealSense:
    source = PartSpec(
        "hil.camera.software_d415:SoftwareD415", {"run": run, **options}, "test: source"
    )
    return RealSense(
        RealSenseConfig(source=source, fps=FPS, depth_size=DEPTH_SIZE, silence_s=0.2), context()
    )


def world(run: str) -> SharedCameraWriter:
    return SharedCameraWriter(run, Role.SENDER, (COLOR.width, COLOR.height), DEPTH_SIZE, FPS)


def draw(writer: SharedCameraWriter, value: int, late_ns: int = 0) -> int:
    stamp_ns = time.monotonic_ns() + late_ns
    color = np.full((COLOR.height, COLOR.width, 3), value, np.uint8)
    writer.write(stamp_ns, color, np.full(DEPTH_SIZE[::-1], 1000, np.uint16))
    return stamp_ns


async def drawing(writer: SharedCameraWriter, ending: asyncio.Event) -> None:
    while not ending.is_set():
        draw(writer, 1)
        await asyncio.sleep(1.0 / FPS)


@pytest.mark.parametrize("clock", ["global_time", "hardware_clock"])
def test_frames_of_the_world_come_through_with_their_instants(run: str, clock: str) -> None:
    async def main() -> None:
        with world(run) as writer:
            ending = asyncio.Event()
            before = asyncio.create_task(drawing(writer, ending))
            async with driver(run, clock=clock) as camera:
                ending.set()
                await before
                stamp_ns, frame = draw(writer, 77), None
                while frame is None or frame.color[0, 0, 0] != 77:
                    frame = await camera.read(PATIENCE_S)
        assert frame.depth_mm is not None
        assert set(frame.color.ravel().tolist()) == {77}
        assert np.abs(frame.depth_mm[20:-20, 20:-20].astype(int) - 1000).max() < 10
        # By the wall clock it is exact; by its own clock it is as late as the quickest arrival.
        assert abs(frame.stamp_ns - stamp_ns) < (
            1_000_000 if clock == "global_time" else 100_000_000
        )

    asyncio.run(main())


def test_no_frame_comes_before_it_is_read_out(run: str) -> None:
    """A stamp that errs by 12 ms would else be of the future on a quick computer, and be
    refused.
    """

    async def main() -> None:
        with world(run) as writer:
            ending = asyncio.Event()
            before = asyncio.create_task(drawing(writer, ending))
            async with driver(run) as camera:
                ending.set()
                await before
                for value in (71, 72, 73):
                    stamp_ns, frame = draw(writer, value, late_ns=12_000_000), None
                    while frame is None or frame.color[0, 0, 0] != value:
                        frame = await camera.read(PATIENCE_S)
                    assert time.monotonic_ns() >= stamp_ns + DeviceClock().readout_ns
                assert camera.counters.clock == 0

    asyncio.run(main())


def test_a_world_that_is_gone_is_said(run: str) -> None:
    async def main() -> None:
        writer = world(run)
        writer.__enter__()
        ending = asyncio.Event()
        before = asyncio.create_task(drawing(writer, ending))
        async with driver(run, open_timeout_s=0.1) as camera:
            ending.set()
            await before
            writer.__exit__()
            message = ""
            async with asyncio.timeout(PATIENCE_S):
                while "the world process" not in message:
                    try:
                        await camera.read(0.3)
                    except CameraError as error:
                        message = str(error)

    asyncio.run(main())


def test_a_world_that_draws_another_size_is_refused(run: str) -> None:
    async def main() -> None:
        other = SharedCameraWriter(run, Role.SENDER, (64, 48), DEPTH_SIZE, FPS)
        with (
            other,
            pytest.raises(CameraError, match=r"is for 96x72 px but the world draws 64x48 px"),
        ):
            await driver(run).__aenter__()

    asyncio.run(main())


def test_without_a_run_it_says_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(RUN_VARIABLE, raising=False)
    with pytest.raises(CameraError, match="no run is named") as caught:
        SoftwareD415(SoftwareD415Config(), context())
    assert RUN_VARIABLE in caught.value.remedy
    monkeypatch.setenv(RUN_VARIABLE, "somewhere")
    SoftwareD415(SoftwareD415Config(), context())


def test_the_world_draws_what_the_driver_asks_for() -> None:
    rig = rig_library.load("sitl")
    assert (camera_config(rig, Role.SENDER).fps, depth_size(rig, Role.SENDER)) == (50, (640, 480))
    perception = rig.sender.perception
    other = {
        **perception.options,
        "camera": {**perception.options["camera"], "depth_size": [320, 240]},
    }
    finer = replace(rig, sender=replace(rig.sender, perception=replace(perception, options=other)))
    assert depth_size(finer, Role.SENDER) == (320, 240)
