"""The in-process vehicle on a virtual loop: the whole flight, telemetry as it arrives, refusals, a
dead link.
"""

import asyncio
import math
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from drivers.interfaces import FlightMode, VehicleError, VelocitySetpoint
from drivers.rig.parts import Mount, Origin, PartContext
from hil.autopilot.autopilot import AutopilotConfig
from hil.harness.virtual_time import run_virtual
from hil.vehicle.sim_vehicle import SimVehicle
from hil.world.config import WorldConfig
from hil.world.world import TICK_S, World
from path.camera.model import CameraModel
from path.geometry.transforms import Pose
from path.marker.layout import Marker, MarkerLayout
from path.messages import Role

STILL = VelocitySetpoint((0.0, 0.0, 0.0), 0.0)
CLOCK_AHEAD_S = 1000.0
IDENTITY = Pose(np.eye(3), np.zeros(3))


class Clock:
    """A role's clock, a thousand seconds ahead of the world."""

    def now_ns(self) -> int:
        return round((asyncio.get_running_loop().time() + CLOCK_AHEAD_S) * 1e9)


@dataclass
class Harness:
    """The world, always at the loop's present."""

    truth: World
    silent_vehicles: set[Role] = field(default_factory=set[Role])

    @property
    def world(self) -> World:
        self.truth.advance(asyncio.get_running_loop().time())
        return self.truth


def context(harness: object | None) -> PartContext:
    camera = CameraModel(640, 480, 615.0, 615.0, 319.5, 239.5, (0.0, 0.0, 0.0, 0.0, 0.0))
    layout = MarkerLayout((Marker(0, 0.04, 0.0, IDENTITY),), "DICT_4X4_50")
    mount = Mount(IDENTITY, IDENTITY)
    return PartContext(
        Role.SENDER, Clock(), camera, mount, layout, Origin(47.0, 8.0, 400.0), harness
    )


def fly(
    mission: Callable[[SimVehicle, Harness], Awaitable[None]],
    config: WorldConfig | None = None,
    seed: int = 1,
) -> None:
    """Run a coroutine on an open vehicle in virtual time."""

    async def main() -> None:
        harness = Harness(World(config or WorldConfig(), seed))
        async with SimVehicle(SimVehicle.Config(), context(harness)) as vehicle:
            await mission(vehicle, harness)

    run_virtual(main())


async def up(vehicle: SimVehicle, height_m: float = 1.5) -> None:
    await vehicle.wait_armable(10.0)
    await vehicle.arm()
    await vehicle.take_off(height_m, 20.0)


async def keep_flying(vehicle: SimVehicle, setpoint: VelocitySetpoint, seconds: float) -> None:
    for _ in range(round(seconds / 0.02)):
        vehicle.fly(setpoint)
        await asyncio.sleep(0.02)


def test_a_flight_from_the_ground_to_the_ground() -> None:
    async def mission(vehicle: SimVehicle, harness: Harness) -> None:
        assert not vehicle.state.in_air
        await up(vehicle)
        state = vehicle.state
        assert (state.armed, state.in_air, state.mode) == (True, True, FlightMode.HOLD)
        assert -harness.world.drone(Role.SENDER).true_position_n_m[2] == pytest.approx(1.6, abs=0.3)
        await vehicle.start_offboard(STILL)
        assert vehicle.state.mode is FlightMode.OFFBOARD
        before = vehicle.state.position_n_m
        await keep_flying(vehicle, VelocitySetpoint((0.5, 0.0, 0.0), 0.0), 4.0)
        after = vehicle.state.position_n_m
        assert after[0] - before[0] == pytest.approx(2.0, abs=0.4)
        await vehicle.hold()
        assert vehicle.state.mode is FlightMode.HOLD
        await vehicle.land(30.0)
        assert not vehicle.state.armed
        assert not vehicle.state.in_air
        assert harness.world.drone(Role.SENDER).on_ground
        assert harness.world.drone(Role.SENDER).autopilot.setpoint_gap_s <= 0.2
        await vehicle.land(1.0)  # is down already

    fly(mission)


def test_telemetry_comes_late_and_with_the_stamps_of_its_arrival() -> None:
    async def mission(vehicle: SimVehicle, harness: Harness) -> None:
        await asyncio.sleep(1.0131 - asyncio.get_running_loop().time())
        stamp_s = vehicle.state.stamp_ns * 1e-9 - CLOCK_AHEAD_S
        assert stamp_s == pytest.approx(1.004, abs=1e-6)  # of the tick at 1.000 s
        assert vehicle.state.heartbeat_ns * 1e-9 - CLOCK_AHEAD_S == pytest.approx(1.004, abs=0.0201)
        told = {round(t.time_s, 3): t for t in harness.world.drone(Role.SENDER).telemetry}
        estimates = {time_s: each.estimate for time_s, each in told.items()}
        assert vehicle.state.position_n_m == told[1.0].position_n_m
        assert vehicle.state.position_n_m[:2] == estimates[1.0].position_n_m[:2]
        # on the ground: above its home
        assert vehicle.state.position_n_m[2] == pytest.approx(0.0, abs=0.2)
        half_way = vehicle.attitude_at(round((0.994 + CLOCK_AHEAD_S) * 1e9))
        middle = [
            (a + b) / 2 for a, b in zip(estimates[0.98].q_n_b, estimates[1.0].q_n_b, strict=True)
        ]
        assert half_way == pytest.approx(middle, abs=1e-6)
        assert vehicle.attitude_at(0) == estimates[0.0].q_n_b

    fly(mission)


def test_what_is_told_does_not_depend_on_how_often_is_asked() -> None:
    async def asked(every_s: float) -> tuple[object, ...]:
        harness = Harness(World(WorldConfig(), 2))
        vehicle = SimVehicle(SimVehicle.Config(), context(harness))
        async with vehicle:
            end_s = 1.37
            while asyncio.get_running_loop().time() + every_s < end_s:
                await asyncio.sleep(every_s)
                _ = vehicle.state
            await asyncio.sleep(end_s - asyncio.get_running_loop().time())
            return (
                vehicle.state.position_n_m,
                vehicle.state.q_n_b,
                round(vehicle.state.stamp_ns, -1),
            )

    assert run_virtual(asked(0.9)) == run_virtual(asked(0.013))


def test_refusals_carry_the_reason() -> None:
    async def mission(vehicle: SimVehicle, harness: Harness) -> None:
        with pytest.raises(
            VehicleError, match="refused to arm: Arming denied: position estimate is settling"
        ):
            await vehicle.arm()
        with pytest.raises(
            VehicleError, match="not ready to arm after 4 s: compass not calibrated"
        ):
            await vehicle.wait_armable(4.0)
        with pytest.raises(VehicleError, match="refused to arm: Arming denied: compass"):
            await vehicle.arm()
        with pytest.raises(VehicleError, match="not armed"):
            await vehicle.take_off(1.5, 10.0)
        with pytest.raises(VehicleError, match="height"):
            await vehicle.take_off(math.nan, 10.0)

    fly(mission, WorldConfig(autopilot=AutopilotConfig(arming_fault="compass not calibrated")))


@pytest.mark.parametrize(
    ("setpoint", "text"),
    [
        (VelocitySetpoint((math.nan, 0.0, 0.0), 0.0), "not finite"),
        (VelocitySetpoint((0.0, 0.0, 0.0), math.inf), "not finite"),
        (VelocitySetpoint((4.0, 4.0, 0.0), 0.0), "max_speed_mps"),
    ],
)
def test_bad_setpoints_are_not_sent(setpoint: VelocitySetpoint, text: str) -> None:
    async def mission(vehicle: SimVehicle, harness: Harness) -> None:
        await up(vehicle)
        with pytest.raises(VehicleError, match=text):
            vehicle.fly(setpoint)
        with pytest.raises(VehicleError, match=text):
            await vehicle.start_offboard(setpoint)
        assert harness.world.drone(Role.SENDER).autopilot.offboard_sessions == []

    fly(mission)


def test_a_take_off_that_takes_too_long_or_is_taken_away_ends_in_an_error() -> None:
    async def mission(vehicle: SimVehicle, harness: Harness) -> None:
        await vehicle.wait_armable(10.0)
        await vehicle.arm()
        with pytest.raises(VehicleError, match=r"not at 5 m 2 s after"):
            await vehicle.take_off(5.0, 2.0)
        climb = asyncio.ensure_future(vehicle.take_off(5.0, 20.0))
        await asyncio.sleep(1.0)
        own = harness.world.drone(Role.SENDER).autopilot
        own.request_mode(harness.world.time_s, FlightMode.OTHER, by_pilot=True)
        with pytest.raises(VehicleError, match="mode other"):
            await climb

    fly(mission)


def test_a_landing_that_the_pilot_stops_ends_in_an_error() -> None:
    async def mission(vehicle: SimVehicle, harness: Harness) -> None:
        await up(vehicle)
        landing = asyncio.ensure_future(vehicle.land(20.0))
        await asyncio.sleep(1.0)
        own = harness.world.drone(Role.SENDER).autopilot
        own.request_mode(harness.world.time_s, FlightMode.OTHER, by_pilot=True)
        with pytest.raises(VehicleError, match="mode other"):
            await landing

    fly(mission)


def test_after_a_lost_link_all_resumes() -> None:
    async def mission(vehicle: SimVehicle, harness: Harness) -> None:
        await up(vehicle)
        harness.silent_vehicles.add(Role.SENDER)
        state = vehicle.state
        with pytest.raises(VehicleError, match="no answer to the command to hold"):
            await vehicle.hold()
        assert vehicle.state == state
        harness.silent_vehicles.clear()
        await asyncio.sleep(0.3)
        await vehicle.land(20.0)
        assert harness.world.drone(Role.SENDER).on_ground

    fly(mission)


def test_a_companion_that_stops_sending_sees_its_drone_land() -> None:
    async def mission(vehicle: SimVehicle, harness: Harness) -> None:
        await up(vehicle)
        await vehicle.start_offboard(STILL)
        seen: list[FlightMode] = []
        while vehicle.state.armed:
            if not seen or seen[-1] is not vehicle.state.mode:
                seen.append(vehicle.state.mode)
            await asyncio.sleep(TICK_S)
            assert harness.world.time_s < 40.0
        assert seen[:3] == [FlightMode.OFFBOARD, FlightMode.HOLD, FlightMode.LAND]

    fly(mission)


def test_opening_needs_a_world_that_speaks() -> None:
    with pytest.raises(VehicleError, match="simulated world"):
        SimVehicle(SimVehicle.Config(), context(None))

    async def main() -> None:
        harness = Harness(World(WorldConfig(), 1), {Role.SENDER})
        vehicle = SimVehicle(SimVehicle.Config(), context(harness))
        with pytest.raises(VehicleError, match="no heartbeat"):
            async with vehicle:
                pass
        with pytest.raises(VehicleError, match="not connected"):
            _ = vehicle.state

    run_virtual(main())


def test_the_same_seed_flies_the_same_flight() -> None:
    tracks: list[list[tuple[float, float, float]]] = []

    async def mission(vehicle: SimVehicle, harness: Harness) -> None:
        await up(vehicle)
        await vehicle.start_offboard(STILL)
        track: list[tuple[float, float, float]] = []
        for _ in range(100):
            vehicle.fly(VelocitySetpoint((0.4, 0.2, 0.0), 0.3))
            await asyncio.sleep(0.02)
            track.append(vehicle.state.position_n_m)
        tracks.append(track)

    for seed in (8, 8, 9):
        fly(mission, seed=seed)
    assert tracks[0] == tracks[1] != tracks[2]


def test_refuses_options_that_make_no_sense() -> None:
    with pytest.raises(ValueError, match="latency_s"):
        replace(SimVehicle.Config(), latency_s=-0.1)
