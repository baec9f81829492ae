"""The MAVSDK driver over loopback against the embedded PX4-like vehicle.

Where a whole flight is needed the vehicle's time runs faster than ours.
"""

import asyncio
import gc
import math
import socket
import threading
import time
import weakref
from dataclasses import replace
from typing import Any

import pytest
from mavsdk.mavsdk import Mavsdk
from pymavlink.dialects.v20 import common as mavlink

from drivers.interfaces import FlightMode, TakenOver, VehicleError, VelocitySetpoint
from drivers.mavlink.preflight.parameters import Difference
from drivers.mavlink.session import ARM_DISARM
from drivers.mavlink.transport.port_lock import PortLock
from drivers.mavlink.vehicle import MavsdkVehicle, MavsdkVehicleConfig
from flight.config import MissionConfig
from flight.outcome import MissionEnd
from flight.pilot import Pilot
from hil.autopilot.autopilot import Ack, AutopilotConfig
from hil.autopilot.radio import RadioConfig
from path.geometry.rotation import yaw_of
from tests.doubles import NoLog
from tests.drivers.mavlink.mavsdk_bench import (
    HEIGHT_M,
    LIMIT_S,
    STILL,
    SYSID,
    Bench,
    LoopClock,
    into_the_air,
    px4,
    threads,
    until,
    vehicle_at,
)
from tests.exact_world import QUICK
from tests.free_ports import free_port

SPEED = 3.0


FAST = replace(QUICK, offboard_loss_s=SPEED * QUICK.offboard_loss_s)  # as long as ever by our time


def test_a_flight_from_arming_to_landing() -> None:
    async def fly(bench: Bench) -> None:
        before = threads()
        async with bench.vehicle() as vehicle:
            await vehicle.wait_armable(LIMIT_S)
            assert not vehicle.state.armed
            await until(lambda: abs(LoopClock().now_ns() - vehicle.state.stamp_ns) < 1_000_000_000)
            await until(lambda: vehicle.state.resets == 0)
            bench.drone.resets = 3  # its estimator steps, and ODOMETRY counts that
            await until(lambda: vehicle.state.resets == 3)
            await vehicle.arm()
            assert vehicle.state.armed
            await vehicle.take_off(HEIGHT_M, LIMIT_S)
            state = vehicle.state
            assert (state.mode, state.in_air) == (FlightMode.HOLD, True)
            assert state.position_n_m == pytest.approx((3.0, -2.0, -0.1 - HEIGHT_M), abs=0.32)
            with pytest.raises(VehicleError, match="not finite"):
                vehicle.fly(VelocitySetpoint((0.0, math.nan, 0.0), 0.0))
            await vehicle.start_offboard(STILL)
            assert vehicle.state.mode is FlightMode.OFFBOARD
            for north, east in ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)):
                await square_leg(vehicle, north, east)
            q_n_b = vehicle.attitude_at(vehicle.state.stamp_ns)
            assert yaw_of(q_n_b) == pytest.approx(0.5, abs=0.02)
            await vehicle.hold()
            assert vehicle.state.mode is FlightMode.HOLD
            await vehicle.land(LIMIT_S)
            assert not vehicle.state.armed
            await vehicle.land(LIMIT_S)  # nothing to do
        await until(lambda: threads() == before)  # one that has ended is counted for a moment
        with pytest.raises(VehicleError, match="not open"):
            vehicle.fly(STILL)

    with px4(FAST, SPEED) as bench:
        asyncio.run(fly(bench))
        assert not bench.autopilot.armed
        assert bench.autopilot.setpoint_gap_s / SPEED < QUICK.offboard_loss_s
        wire = bench.wire
    for command, times in (
        (mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1),
        (mavlink.MAV_CMD_NAV_TAKEOFF, 1),
    ):
        assert len(wire.commands(command)) == times
    assert {
        (sp.type_mask, sp.coordinate_frame) for sp in wire.of("SET_POSITION_TARGET_LOCAL_NED")
    } == {(2503, 1)}
    assert all(math.isfinite(sp.vy) for sp in wire.of("SET_POSITION_TARGET_LOCAL_NED"))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as again:
        again.bind(("127.0.0.1", bench.port))  # the port is free again


def test_a_mode_that_disarming_brings_back_is_no_pilots() -> None:
    """CURRENT_MODE shows it 20 times a second; that it was disarmed comes with a heartbeat, up to a
    second later.
    """

    async def fly(bench: Bench) -> None:
        async with bench.vehicle(heartbeat_timeout_s=5.0) as vehicle:
            for _ in range(3):
                await into_the_air(vehicle)
                await vehicle.land(LIMIT_S)
                assert not vehicle.state.armed

    with px4(replace(QUICK, heartbeat_hz=1.0 / SPEED), speed=SPEED) as bench:
        asyncio.run(fly(bench))


def test_height_may_be_reckoned_from_home() -> None:
    async def fly(bench: Bench) -> None:
        async with bench.vehicle(height_from="home") as vehicle:
            await vehicle.wait_armable(LIMIT_S)
            # its origin is 0.1 m over the ground
            assert vehicle.state.position_n_m[2] == pytest.approx(0.0, abs=0.02)

    with px4() as bench:
        asyncio.run(fly(bench))


async def square_leg(vehicle: MavsdkVehicle, north: float, east: float) -> None:
    """Fly 0.3 m in one direction, by the vehicle's own telemetry."""
    n, e, _ = vehicle.state.position_n_m
    setpoint = VelocitySetpoint((0.6 * north, 0.6 * east, 0.0), 0.5)

    def there() -> bool:
        at = vehicle.state.position_n_m
        return (at[0] - n) * north + (at[1] - e) * east > 0.3

    await until(there, lambda: vehicle.fly(setpoint))
    velocity = vehicle.state.velocity_n_mps
    assert velocity[0] * north + velocity[1] * east > 0.3


def test_when_python_hangs_the_setpoints_stop_and_the_vehicle_lands() -> None:
    async def fly(bench: Bench) -> None:
        async with bench.vehicle() as vehicle:
            await into_the_air(vehicle)
            await vehicle.start_offboard(STILL)
            await until(
                lambda: bench.drone.estimate.velocity_n_mps[0] > 0.25,
                lambda: vehicle.fly(VelocitySetpoint((0.3, 0.0, 0.0), 0.0)),
            )
            sent = len(bench.wire.of("SET_POSITION_TARGET_LOCAL_NED"))
            end_s = time.monotonic() + LIMIT_S
            while bench.autopilot.armed and time.monotonic() < end_s:
                time.sleep(0.01)  # noqa: ASYNC251 (this is the hang)
            assert len(bench.wire.of("SET_POSITION_TARGET_LOCAL_NED")) - sent <= 1
            await until(lambda: not vehicle.state.armed)

    with px4(FAST, SPEED) as bench:
        asyncio.run(fly(bench))
        modes = [session.ended_by for session in bench.autopilot.offboard_sessions]
        texts = [text.text for text in bench.autopilot.status_texts]
    assert modes == [FlightMode.HOLD]
    assert "No offboard setpoints, landing" in texts


@pytest.mark.parametrize("gps_off_m", [0.0, 10.0])
def test_a_take_off_climbs_to_its_height_however_lately_a_parameter_was_set(
    gps_off_m: float,
) -> None:
    """PX4 acknowledges a parameter and looks at it up to a second later: it climbed to the height
    it had before.
    """

    async def fly(bench: Bench) -> None:
        async with bench.vehicle(height_from="home") as vehicle:
            await vehicle.wait_armable(LIMIT_S)
            await vehicle.set_parameter(Difference("GF_MAX_VER_DIST", 9.0, 0.0))
            await vehicle.arm()
            await vehicle.take_off(HEIGHT_M, 8.0)
        assert bench.drone.autopilot.config.default_takeoff_m == pytest.approx(
            HEIGHT_M
        )  # an older one climbs no less than this

    with px4(FAST, gps_off_m=gps_off_m) as bench:
        asyncio.run(fly(bench))


def test_a_landing_that_the_end_of_a_take_off_goes_over_is_commanded_again() -> None:
    async def fly(bench: Bench) -> None:
        own = bench.autopilot.request_mode
        asked: list[FlightMode] = []

        def as_a_px4(now_s: float, mode: FlightMode, by_pilot: bool = False) -> Ack:
            asked.append(mode)
            over = asked == [FlightMode.LAND] and bench.autopilot.mode is FlightMode.TAKEOFF
            return own(now_s, FlightMode.HOLD if over else mode, by_pilot)

        bench.autopilot.request_mode = as_a_px4
        async with bench.vehicle() as vehicle:
            await vehicle.wait_armable(LIMIT_S)
            await vehicle.arm()
            climb = asyncio.create_task(vehicle.take_off(HEIGHT_M, LIMIT_S))
            await until(lambda: vehicle.state.mode is FlightMode.TAKEOFF and vehicle.state.in_air)
            climb.cancel()
            await vehicle.land(LIMIT_S)
            assert asked == [FlightMode.LAND, FlightMode.LAND]

    with px4(FAST, SPEED) as bench:
        asyncio.run(fly(bench))


def test_a_kill_switch_during_the_take_off_is_a_pilots() -> None:
    async def fly(bench: Bench) -> None:
        async with bench.vehicle() as vehicle:
            await vehicle.wait_armable(LIMIT_S)
            await vehicle.arm()
            climb = asyncio.create_task(vehicle.take_off(HEIGHT_M, LIMIT_S))
            await until(lambda: vehicle.state.mode is FlightMode.TAKEOFF)
            bench.autopilot.radio.transmitter.kill = True
            with pytest.raises(TakenOver, match="the motors were stopped"):
                await climb
            assert not vehicle.state.armed

    # however busy the computer is
    with px4(replace(FAST, radio=RadioConfig(kill_disarm_s=30.0)), SPEED) as bench:
        asyncio.run(fly(bench))


def test_the_pilot_and_a_lost_link_end_every_wait() -> None:
    async def fly(bench: Bench) -> None:
        autopilot, endpoint = bench.autopilot, bench.endpoint
        async with bench.vehicle() as vehicle:
            await vehicle.wait_armable(LIMIT_S)
            await vehicle.arm()
            climb = asyncio.create_task(vehicle.take_off(HEIGHT_M, LIMIT_S))
            await until(lambda: vehicle.state.mode is FlightMode.TAKEOFF)
            autopilot.request_mode(bench.drone.estimate.time_s, FlightMode.OTHER, by_pilot=True)
            with pytest.raises(TakenOver, match="take-off ended on the way: mode other"):
                await climb
            await vehicle.hold()
            landing = asyncio.create_task(vehicle.land(LIMIT_S))
            await until(lambda: vehicle.state.mode is FlightMode.LAND)
            autopilot.request_mode(bench.drone.estimate.time_s, FlightMode.OTHER, by_pilot=True)
            # By whichever of its looks sees it first: that it lands, or that it does no more.
            ended = (
                r"landing ended by a change to mode other|agreed to land, and was put in mode other"
            )
            with pytest.raises(TakenOver, match=ended):
                await landing
            endpoint.silent = True
            with pytest.raises(VehicleError, match=rf"heartbeat of vehicle {SYSID} lost"):
                await vehicle.hold()
            state = vehicle.state  # still answers, and shows its age
            assert LoopClock().now_ns() - state.heartbeat_ns > 1_000_000_000
            assert LoopClock().now_ns() - state.stamp_ns > 1_000_000_000
            endpoint.silent = False
            await until(lambda: LoopClock().now_ns() - vehicle.state.heartbeat_ns < 300_000_000)
            await vehicle.land(LIMIT_S)

    with px4() as bench:
        asyncio.run(fly(bench))


@pytest.mark.parametrize("base_mode", [129, 1], ids=["a pilot's mode", "not armed"])
def test_one_forged_heartbeat_does_not_leave_the_vehicle_to_nobody(
    base_mode: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As if from the vehicle's own address; from any other it is not believed at all."""
    # on a busy computer the next ones come later than in flight
    monkeypatch.setattr("flight.pilot.DOUBT_S", LIMIT_S)

    async def fly(bench: Bench) -> None:
        forged = mavlink.MAVLink_heartbeat_message(2, 12, base_mode, 3 << 16, 4, 3)
        packet = forged.pack(mavlink.MAVLink(None, srcSystem=SYSID, srcComponent=1))
        async with bench.vehicle(heartbeat_hz=10.0) as vehicle:
            await into_the_air(vehicle)
            pilot = Pilot(vehicle, LoopClock(), MissionConfig(), NoLog())
            await pilot.take_control()
            flying = asyncio.create_task(pilot.run())
            while pilot.taken_back < 2:  # which of them comes between two ticks is luck
                bench.endpoint.send_raw(packet)
                await until(lambda: vehicle.state.mode_told < 3)
                await until(lambda: min(vehicle.state.mode_told, vehicle.state.armed_told) >= 3)
                assert not flying.done()
            sent = pilot.setpoints
            await until(lambda: pilot.setpoints > sent + 5)
            assert bench.autopilot.mode is FlightMode.OFFBOARD
            autopilot = bench.autopilot
            autopilot.request_mode(bench.drone.estimate.time_s, FlightMode.OTHER, by_pilot=True)
            with pytest.raises(MissionEnd, match="mode is other"):
                await flying

    with px4(replace(QUICK, offboard_loss_s=300.0)) as bench:
        asyncio.run(fly(bench))


@pytest.mark.parametrize("back", [False, True])
def test_a_pilot_who_takes_it_while_offboard_is_entered_is_not_landed_for(back: bool) -> None:
    async def main(bench: Bench) -> None:
        async with bench.vehicle(mode_timeout_s=1.5) as vehicle:
            await vehicle.wait_armable(LIMIT_S)
            await vehicle.arm()
            await vehicle.take_off(HEIGHT_M, LIMIT_S)
            select = bench.autopilot.request_mode

            def taken(now_s: float, mode: FlightMode, by_pilot: bool = False) -> Ack:
                """Agree to OFFBOARD, which a pilot's switch ends in the same moment."""
                if mode is not FlightMode.OFFBOARD:
                    return select(now_s, mode, by_pilot)
                select(now_s, FlightMode.LAND if back else FlightMode.OTHER, by_pilot=True)
                return Ack(True)

            bench.autopilot.request_mode = taken  # type: ignore[method-assign]
            entering = asyncio.create_task(vehicle.start_offboard(STILL))
            await asyncio.sleep(0.9)
            if back:
                select(bench.drone.estimate.time_s, FlightMode.HOLD, by_pilot=True)
            with pytest.raises(
                TakenOver, match="agreed to enter offboard control, and was put in mode"
            ):
                await entering
            assert bench.wire.commands(mavlink.MAV_CMD_NAV_LAND) == []

    with px4() as bench:
        asyncio.run(main(bench))


def test_a_hold_far_below_the_height_is_somebody_elses() -> None:
    async def fly(bench: Bench) -> None:
        async with bench.vehicle() as vehicle:
            await vehicle.wait_armable(LIMIT_S)
            await vehicle.arm()
            climb = asyncio.create_task(vehicle.take_off(10.0, LIMIT_S))
            await until(lambda: vehicle.state.in_air)
            bench.autopilot.request_mode(
                bench.drone.estimate.time_s, FlightMode.HOLD, by_pilot=True
            )
            with pytest.raises(TakenOver, match="take-off ended on the way: mode hold"):
                await climb

    with px4() as bench:
        asyncio.run(fly(bench))


def test_a_take_off_that_ends_far_above_its_height_is_told_as_that_and_no_pilots() -> None:
    """A height that stepped, or a vehicle with a least height of its own."""

    async def fly(bench: Bench) -> None:
        asked = bench.autopilot.request_takeoff

        def higher(now_s: float, height_m: float, *more: Any) -> Any:
            return asked(now_s, height_m + 4.0, *more)

        bench.autopilot.request_takeoff = higher
        async with bench.vehicle() as vehicle:
            await vehicle.wait_armable(LIMIT_S)
            await vehicle.arm()
            with pytest.raises(
                VehicleError, match=r"ended at \d\.\d m, by the vehicle's own"
            ) as end:
                await vehicle.take_off(HEIGHT_M, LIMIT_S)
            assert not isinstance(end.value, TakenOver)

    with px4(FAST, SPEED) as bench:
        asyncio.run(fly(bench))


def test_the_mode_is_asked_for_beside_heartbeats() -> None:
    """PX4's come once a second: a pilot must not wait for them."""

    async def watch(bench: Bench) -> None:
        async with bench.vehicle() as vehicle:
            for mode in (FlightMode.OTHER, FlightMode.HOLD):
                bench.autopilot.request_mode(bench.drone.estimate.time_s, mode, by_pilot=True)
                await until(lambda wanted=mode: vehicle.state.mode is wanted)

    with px4() as bench:
        asyncio.run(watch(bench))
        asked = {int(command.param1): command.param2 for command in bench.wire.commands(511)}
    assert asked[436] == 50_000  # CURRENT_MODE, us


# --- closing ---


def test_closing_ends_the_plugins_before_mavsdk_however_the_garbage_collector_runs(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A plugin that the collector ends in one thread while MAVSDK ends in another takes the process
    down.
    """
    alive: list[bool] = []
    destroy = Mavsdk.destroy

    async def fly(bench: Bench) -> None:
        async with bench.vehicle() as vehicle:
            session = vehicle._session
            assert session.parameters is not None
            plugins = [
                weakref.ref(plugin)
                for plugin in (session._plugin, session._direct, session.parameters._plugin)
            ]

            def collected_before(mavsdk: Mavsdk) -> None:
                gc.collect()
                alive.extend(plugin() is not None for plugin in plugins)
                destroy(mavsdk)

            monkeypatch.setattr(Mavsdk, "destroy", collected_before)

    with px4() as bench:
        asyncio.run(fly(bench))
    assert alive == [True, True, True]


def test_closing_waits_for_a_parameter_that_is_being_read() -> None:
    """A read blocks in MAVSDK in a thread of its own, which cancelling does not end."""

    async def fly(bench: Bench) -> None:
        async with bench.vehicle() as vehicle:
            session = vehicle._session
            assert session.parameters is not None
            plugin = session.parameters._plugin
            get, reading, ended = plugin.get_param_int, threading.Event(), threading.Event()

            def watched(name: str) -> int:
                reading.set()
                try:
                    return get(name)
                finally:
                    ended.set()

            plugin.get_param_int = watched
            read = asyncio.create_task(session.parameters.read(["NOT_THERE"]))
            await until(reading.is_set)
            read.cancel()
            destroyed_after_it: list[bool] = []
            destroy = plugin.destroy

            def watched_destroy() -> None:
                destroyed_after_it.append(ended.is_set())
                destroy()

            plugin.destroy = watched_destroy
        assert destroyed_after_it[0]

    with px4() as bench:
        asyncio.run(fly(bench))


# --- refusals ---


def test_a_refused_arm_says_why() -> None:
    async def fly(bench: Bench) -> None:
        async with bench.vehicle() as vehicle:
            with pytest.raises(
                VehicleError, match=r"not ready to arm after 0\.2 s: waiting for arming checks"
            ):
                await vehicle.wait_armable(0.2)
            with pytest.raises(
                VehicleError,
                match=r"refused to arm \(temporarily rejected\): Arming denied: compass inconsistent",
            ):
                await vehicle.arm()
            with pytest.raises(VehicleError, match="not armed"):
                await vehicle.take_off(HEIGHT_M, LIMIT_S)
            with pytest.raises(VehicleError, match="never sent"):
                await vehicle._session.command(ARM_DISARM, (0.0, 21196.0))

    with px4(AutopilotConfig(settle_s=0.2, arming_fault="compass inconsistent")) as bench:
        asyncio.run(fly(bench))
        assert len(bench.wire.commands(ARM_DISARM)) == 1


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            {"sysid": SYSID + 1, "connect_timeout_s": 4.0},
            rf"vehicle {SYSID + 1} is not on .*heard only {SYSID}",
        ),
        ({"autopilot": "ardupilot"}, "is px4, the rig says ardupilot"),
    ],
)
def test_the_wrong_vehicle_is_refused_and_the_port_given_back(
    options: dict[str, Any], message: str
) -> None:
    async def fly(bench: Bench) -> None:
        with pytest.raises(VehicleError, match=message):
            await bench.vehicle(**options).__aenter__()
        async with bench.vehicle() as vehicle:
            assert vehicle.state.mode is FlightMode.HOLD

    with px4() as bench:
        asyncio.run(fly(bench))


def test_without_a_heartbeat_the_error_names_url_and_wait() -> None:
    port = free_port()
    with pytest.raises(
        VehicleError, match=rf"no heartbeat on udpin://127.0.0.1:{port} in 0.2 s"
    ) as caught:
        asyncio.run(vehicle_at(port, connect_timeout_s=0.2).__aenter__())
    assert "powered" in caught.value.remedy


def test_a_port_has_one_owner() -> None:
    port = free_port()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        stranger.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        stranger.bind(("127.0.0.1", port))
        with pytest.raises(VehicleError, match=rf"UDP port {port} is already in use") as caught:
            asyncio.run(vehicle_at(port).__aenter__())
        assert "choose another port" in caught.value.remedy
    with (
        PortLock(f"udpin://127.0.0.1:{port}"),
        pytest.raises(VehicleError, match=rf"UDP port {port} is already used by another vehicle"),
    ):
        PortLock(f"udpin://0.0.0.0:{port}")
    with PortLock("serial:///dev/ttyX7:57600"), pytest.raises(VehicleError, match="already used"):
        PortLock("serial:///dev/ttyX7:57600")


@pytest.mark.parametrize("url", ["", "udpin://127.0.0.1", "http://127.0.0.1:80", "14541"])
def test_a_malformed_url_is_refused(url: str) -> None:
    with pytest.raises(VehicleError, match="no MAVLink connection") as caught:
        PortLock(url)
    assert "udpin://" in caught.value.remedy


@pytest.mark.parametrize("options", [{"sysid": 0}, {"sysid": 256}, {"sysid": 245}])
def test_impossible_system_ids_are_refused(options: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match="sysid"):
        MavsdkVehicleConfig(url="udpin://127.0.0.1:14541", **options)
