"""A flight controller on serial ports: real MAVSDK on the one, the harness's truth on the other,
both over ptys.
"""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Callable, Generator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from drivers.interfaces import FlightMode, PartError, Vehicle, VehicleError, VelocitySetpoint
from drivers.mavlink.geodesy import LocalTangent
from drivers.rig.parts import Rig, create, part_context
from drivers.rig.tables import decode_table
from hil.autopilot.simulator import SimulatorConfig
from hil.vehicle.board_pty import BoardPty
from hil.vehicle.simulators.followed_world import SimulatedVehicle, start_simulators
from hil.vehicle.simulators.process import SimulatorBroken
from hil.vehicle.simulators.wire import SerialWire
from hil.world.config import HomeConfig, WorldConfig
from hil.world.world import SimDrone
from missions.ground import rig_library
from path.messages import Role
from tests.exact_world import exact_world
from tests.steady_time import SteadyTime

HEIGHT_M, LIMIT_S = 0.5, 60.0


def on_ports(rig: Rig, folder: Path) -> tuple[Rig, SimulatorConfig]:
    """The rig's sender on these two devices, and how the harness finds its truth."""
    vehicle = rig.sender.vehicle
    own = replace(
        vehicle,
        options={
            **vehicle.options,
            "url": f"serial://{folder}/companion:921600",
            "parameters": {},
            "heartbeat_timeout_s": 3.0,
        },
    )
    config = SimulatorConfig("px4", truth_url=f"serial://{folder}/truth:115200")
    return replace(rig, sender=replace(rig.sender, vehicle=own)), config


@contextmanager
def board(
    rig: Rig, folder: Path, home: HomeConfig
) -> Generator[tuple[SimDrone, Callable[[], None]]]:
    """The board in a thread; gives its drone, and what pulls its cables."""
    world = exact_world(sender_home=home)
    tangent = LocalTangent.at(rig.origin)
    drone, leg_m = world.drone(Role.SENDER), world.config.airframe.leg_m
    sysid = int(rig.sender.vehicle.options["sysid"])
    made = BoardPty(sysid, drone, leg_m, tangent, folder / "companion", folder / "truth")
    stop, passed = threading.Event(), SteadyTime()

    def run() -> None:
        while not stop.wait(0.004):
            world.advance(passed.now_s())
            made.pump(world.time_s)

    thread = threading.Thread(target=run)
    thread.start()

    def pull() -> None:
        stop.set()
        thread.join()
        made.close()

    try:
        yield drone, pull
    finally:
        pull()


async def until(condition: Callable[[], bool], each: Callable[[], None] = lambda: None) -> None:
    async with asyncio.timeout(LIMIT_S):
        while not condition():
            each()
            await asyncio.sleep(0.02)


async def flight(vehicle: Vehicle, simulated: SimulatedVehicle, drone: SimDrone) -> None:
    """Off, north by velocity, a pilot's mode by the harness, down."""

    def truth() -> list[float]:
        simulated.pump(0.0)
        return simulated.follower.row(time.monotonic())[:3].tolist()

    await until(lambda: truth() == pytest.approx(drone.true_position_n_m, abs=0.03))
    await vehicle.wait_armable(LIMIT_S)
    await vehicle.arm()
    await vehicle.take_off(HEIGHT_M, LIMIT_S)
    north = VelocitySetpoint((0.5, 0.0, 0.0), 0.0)
    await vehicle.start_offboard(north)
    begin_m = truth()[0]
    await until(lambda: truth()[0] > begin_m + 0.25, lambda: vehicle.fly(north))
    assert simulated.link.watch.armed and simulated.link.watch.mode is FlightMode.OFFBOARD
    await until(
        lambda: truth() == pytest.approx(drone.true_position_n_m, abs=0.1),
        lambda: vehicle.fly(north),
    )
    simulated.link.pilot_takes_over()
    await until(lambda: vehicle.state.mode is FlightMode.HOLD)
    await vehicle.land(LIMIT_S)
    assert drone.on_ground


def test_it_flies_over_serial_ports_and_a_pulled_cable_is_told(tmp_path: Path) -> None:
    rig, config = on_ports(rig_library.load("hitl"), tmp_path)
    world = decode_table(rig.world, WorldConfig, "world")

    async def fly() -> None:
        with board(rig, tmp_path, world.sender_home) as (drone, pull):
            simulated = SimulatedVehicle(rig, Role.SENDER, config, world, tmp_path)
            try:
                await start_simulators({Role.SENDER: simulated})
                async with create(rig.sender.vehicle, part_context(rig, Role.SENDER)) as vehicle:
                    await flight(vehicle, simulated, drone)
                    pull()
                    with pytest.raises(
                        VehicleError, match=r"heartbeat of vehicle 1 lost on serial://"
                    ):
                        await vehicle._session.until(lambda: False, LIMIT_S)
            finally:
                simulated.close()

    asyncio.run(fly())


def test_a_board_that_stands_elsewhere_is_told_where_to_begin(tmp_path: Path) -> None:
    rig, config = on_ports(rig_library.load("hitl"), tmp_path)
    world = decode_table(rig.world, WorldConfig, "world")

    async def start() -> None:
        with board(rig, tmp_path, HomeConfig((5.0, 0.0))):
            simulated = SimulatedVehicle(rig, Role.SENDER, config, world, tmp_path)
            try:
                with pytest.raises(
                    SimulatorBroken,
                    match=r"stands 5\.0 m from .* SIH_LOC_LAT0 47\.3977000, SIH_LOC_LON0",
                ):
                    await start_simulators({Role.SENDER: simulated})
            finally:
                simulated.close()

    asyncio.run(start())


def test_a_board_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(PartError, match="cannot open serial:///dev/ttyX9:57600") as caught:
        SerialWire("serial:///dev/ttyX9:57600")
    assert "plugged in" in caught.value.remedy
    with pytest.raises(PartError, match="no serial port"):
        SerialWire("serial:///dev/ttyX9")


@pytest.mark.parametrize(
    "options",
    [
        {"url": "udp://127.0.0.1:14540"},
        {"kind": "ardupilot", "speedup": 5.0},
        {"parameters": {"SIM_WIND_SPD": 3.0}},
    ],
)
def test_a_board_is_not_started_by_anybody(options: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match="flight controller"):
        SimulatorConfig(**{"kind": "px4", "truth_url": "serial:///dev/ttyACM0:115200", **options})  # type: ignore[arg-type]
