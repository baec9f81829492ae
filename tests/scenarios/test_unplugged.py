"""One role's session on real drivers, whose far side is unplugged in the air: a named end, a
vehicle on the ground.

The course is short, what ends it and brings the vehicle down is the missions' own. docs/faults.md
has the table.
"""

from __future__ import annotations

import asyncio
import random
import time
from collections.abc import Callable, Generator
from contextlib import AsyncExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest

from drivers.clock import SystemClock
from drivers.interfaces import Link, Perception, Vehicle
from drivers.mavlink.vehicle import MavsdkVehicle, MavsdkVehicleConfig
from drivers.perception.pixels import PixelPerception, PixelPerceptionConfig
from drivers.rig.parts import PartContext
from drivers.rig.tables import decode_table
from drivers.tello.config import TelloVehicleConfig
from drivers.tello.vehicle import TelloVehicle
from flight.config import MissionConfig
from flight.guidance import Anchor
from flight.harness.flights import RoleResult
from flight.outcome import MissionEnd, Outcome
from flight.phases import Phase
from hil.tello import video as tello_video
from missions.fly.leg.course import fly_course
from missions.fly.leg.session import RoleSession
from missions.fly.leg.steps import bring_down, take_off
from missions.ground import rig_library
from path.geometry.rotation import yaw_of
from path.messages import Role
from tests.drivers.link.link_ends import STATUS, Cable, introduce, serial_links
from tests.drivers.mavlink.mavsdk_bench import CONTEXT, SYSID, px4
from tests.drivers.realsense import software_d415
from tests.drivers.tello import tello_stand
from tests.exact_world import QUICK
from tests.missions.fly.leg.session_bench import Recorder
from tests.pauses import undisturbed

NO_CONTEXT: Any = None
CLOCK = SystemClock(SystemClock.Config(), NO_CONTEXT)
HEIGHT_M = 0.9
VIDEO_HZ = 15
PATIENT = {"connect_timeout_s": 60.0, "command_timeout_s": 10.0}
PAUSE_S = 0.3  # longer ones are an end of their own: a camera that gives no frame
BUSY_S = 5.0  # that a machine may stand still; what is not noticed is not noticed at all
LIMIT_S = 180.0  # for a whole flight, on a machine that is busy with others


@dataclass
class Stage:
    """The parts that fly; ``silence`` and ``blind`` unplug the vehicle's far side and the
    camera's.
    """

    vehicle: Vehicle
    perception: Perception
    silence: Callable[[], object]
    blind: Callable[[], object]
    on_ground: Callable[[], bool]


def perception(context: PartContext, camera: dict[str, Any]) -> PixelPerception:
    table = {"camera": camera, "detector": {"factory": "drivers.detectors.color:ColorDetector"}}
    return PixelPerception(
        decode_table(table, PixelPerceptionConfig, "rig.toml: sender.perception"), context
    )


@contextmanager
def d415() -> Generator[tuple[Perception, software_d415.Feed]]:
    feed = software_d415.Feed()
    camera = {
        "factory": "drivers.realsense.camera:RealSense",
        "fps": software_d415.FPS,
        "silence_s": 0.2,
    }
    seeing = perception(software_d415.context(), camera)
    opened: Any = seeing._camera
    opened.source = feed
    with feed.running():
        yield seeing, feed


@contextmanager
def autopilot_and_d415() -> Generator[Stage]:
    with d415() as (seeing, feed), px4(replace(QUICK, offboard_loss_s=1.5), speed=3.0) as bench:
        config = MavsdkVehicleConfig(
            url=f"udpin://127.0.0.1:{bench.port}",
            sysid=SYSID,
            heartbeat_timeout_s=1.0,
            connect_timeout_s=60.0,
            command_timeout_s=10.0,
            mode_timeout_s=30.0,
        )
        yield Stage(
            MavsdkVehicle(config, replace(CONTEXT, clock=CLOCK)),
            seeing,
            lambda: setattr(bench.endpoint, "silent", True),
            lambda: setattr(feed, "plugged", False),
            lambda: bench.drone.on_ground,
        )


@contextmanager
def tello_and_d415() -> Generator[Stage]:
    with d415() as (seeing, feed), tello_stand.emulated(speed=4.0) as stand:
        yield Stage(
            TelloVehicle(TelloVehicleConfig(**stand.address), tello_stand.context()),
            seeing,
            lambda: setattr(stand.emulator.faults, "no_state", True),
            lambda: setattr(feed, "plugged", False),
            lambda: stand.drone.on_ground,
        )


@contextmanager
def tello() -> Generator[Stage]:
    """All of its video is damaged when it is corrupt, not only a quarter."""
    with (
        pytest.MonkeyPatch.context() as patch,
        tello_stand.emulated(rate_hz=VIDEO_HZ, speed=4.0) as stand,
    ):
        patch.setattr(tello_video, "CORRUPT_SHARE", 1.0)
        context = tello_stand.context()
        camera = {
            "factory": "drivers.tello.camera:TelloCamera",
            "rate_hz": VIDEO_HZ,
            **stand.address,
        }
        yield Stage(
            TelloVehicle(TelloVehicleConfig(**stand.address), context),
            perception(context, camera),
            lambda: setattr(stand.emulator.faults, "no_state", True),
            lambda: setattr(stand.video, "corrupt", True),
            lambda: stand.drone.on_ground,
        )


class Flight:
    """A sender's session: up, looking and listening until something ends it, and down."""

    def __init__(self, stage: Stage, link: Link) -> None:
        self.log = Recorder()
        parts = (CLOCK, stage.vehicle, stage.perception, link)
        self.session = RoleSession(
            rig_library.load("sim"), Role.SENDER, MissionConfig(), self.log, lambda _: None, asyncio.Event(), parts,
            random.Random(1),
        )  # fmt: skip
        self.flying = asyncio.Event()
        self.ended_s = 0.0

    async def course(self) -> None:
        session = self.session
        await session.vehicle.wait_armable(60.0)
        await take_off(session, HEIGHT_M)
        session.enter(Phase.FOLLOW)
        while True:
            await session.perception.view(session.config.guard.frame_age_s)
            session.require_peer()
            if session.pilot.setpoints > 5:
                self.flying.set()

    async def recover(self, end: MissionEnd | None) -> bool:
        self.ended_s = time.monotonic()
        state = self.session.vehicle.state
        return await bring_down(self.session, end, Anchor(state.position_n_m, yaw_of(state.q_n_b)))


async def say_status(link: Link) -> None:
    while True:
        link.send(replace(STATUS, role=Role.RECEIVER))
        await asyncio.sleep(0.1)


async def fly(
    stage: Stage, folder: Path, unplug: Callable[[Stage, Cable], object]
) -> tuple[RoleResult, float]:
    """Returns how it ended, and how long after the unplugging."""
    cable = Cable(folder)
    cable.plug()
    sender, receiver = serial_links(cable, None)
    try:
        async with AsyncExitStack() as stack, asyncio.timeout(LIMIT_S):
            link, peer = (
                await stack.enter_async_context(sender),
                await stack.enter_async_context(receiver),
            )
            await introduce(link, peer)
            saying = asyncio.create_task(say_status(peer))
            await stack.enter_async_context(stage.perception)
            await stack.enter_async_context(stage.vehicle)
            flight = Flight(stage, link)
            flown = asyncio.create_task(fly_course(flight.session, flight.course, flight.recover))
            up = asyncio.create_task(flight.flying.wait())
            await asyncio.wait([up, flown], return_when=asyncio.FIRST_COMPLETED)
            up.cancel()
            assert not flown.done(), flown.result()
            assert not stage.on_ground()
            unplugged_s = time.monotonic()
            unplug(stage, cable)
            result = await flown
            saying.cancel()
            async with asyncio.timeout(60.0):
                while not stage.on_ground():  # noqa: ASYNC110 (it has no event)
                    await asyncio.sleep(0.02)
            return result, flight.ended_s - unplugged_s
    finally:
        cable.unplug()


def blinded(stage: Stage, cable: Cable) -> None:
    del cable
    stage.blind()


def silenced(stage: Stage, cable: Cable) -> None:
    del cable
    stage.silence()


def garbled(stage: Stage, cable: Cable) -> None:
    """And then pulled out, while the other drone's silence is not yet long enough."""
    del stage
    cable.garble()
    asyncio.get_running_loop().call_later(1.0, cable.unplug)


@pytest.mark.parametrize(
    ("stage_of", "unplug", "outcome", "landed", "within_s"),
    [
        pytest.param(autopilot_and_d415, blinded, Outcome.CAMERA_LOST, True, 1.0, id="frames stop"),
        pytest.param(
            autopilot_and_d415, silenced, Outcome.VEHICLE_LOST, False, 1.0, id="heartbeats stop"
        ),
        pytest.param(
            autopilot_and_d415,
            garbled,
            Outcome.PEER_LOST,
            True,
            3.5,
            id="garbage on serial, then nothing",
        ),
        pytest.param(
            tello_and_d415, silenced, Outcome.VEHICLE_LOST, False, 1.0, id="state packets stop"
        ),
        pytest.param(tello, blinded, Outcome.CAMERA_LOST, True, 1.5, id="video corrupt"),
    ],
)
def test_what_is_unplugged_in_the_air_has_its_name_and_the_vehicle_comes_down(
    stage_of: Any, unplug: Any, outcome: Outcome, landed: bool, within_s: float, tmp_path: Path
) -> None:
    def flown() -> tuple[RoleResult, float]:
        with stage_of() as stage:
            return asyncio.run(fly(stage, tmp_path, unplug))

    result, after_s = undisturbed(flown, PAUSE_S)
    assert (result.outcome, result.landed) == (outcome, landed), result.detail
    assert after_s < within_s + BUSY_S
