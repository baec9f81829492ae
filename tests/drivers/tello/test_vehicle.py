"""The Tello's driver through an unmodified djitellopy, over real sockets, against the emulated
drone.

Where a whole flight is needed the drone's time runs faster than ours.
"""

from __future__ import annotations

import asyncio
import dataclasses
import math
import socket
import time
from typing import Any

import pytest

from drivers.interfaces import FlightMode, VehicleError, VelocitySetpoint
from drivers.tello.address import TelloAddress, check_namespace, check_ports, check_route
from drivers.tello.commands import TelloLink
from drivers.tello.config import TelloVehicleConfig
from drivers.tello.vehicle import TelloVehicle
from path.geometry.rotation import yaw_of
from tests.drivers.tello.tello_stand import STATE_PORT, Stand, context, emulated, until
from tests.free_ports import free_host, free_port

STILL = VelocitySetpoint((0.0, 0.0, 0.0), 0.0)
RISING = VelocitySetpoint((0.0, 0.0, -0.1), 0.0)


def vehicle(stand: Stand, **options: Any) -> TelloVehicle:
    return TelloVehicle(TelloVehicleConfig(**stand.address, **options), context())


def test_a_flight_from_take_off_to_landing() -> None:
    async def fly(stand: Stand) -> None:
        drone = vehicle(stand, north_m=2.0, east_m=-1.0, heading_deg=90.0)
        async with drone:
            state = drone.state
            assert state.position_n_m == pytest.approx((2.0, -1.0, 0.0))
            assert yaw_of(state.q_n_b) == pytest.approx(math.pi / 2.0, abs=0.02)
            assert not state.armed
            await drone.wait_armable(60.0)
            await drone.arm()
            await drone.take_off(1.1, 60.0)
            assert drone.state.mode is FlightMode.HOLD
            assert drone.state.in_air
            assert -drone.state.position_n_m[2] == pytest.approx(1.1, abs=0.2)
            assert stand.drone.true_position_n_m[2] == pytest.approx(
                drone.state.position_n_m[2], abs=0.25
            )
            await drone.start_offboard(STILL)
            assert drone.state.mode is FlightMode.OFFBOARD
            # its nose looks east by the rig and north in truth: north is to its left
            drone.fly(VelocitySetpoint((0.5, 0.0, 0.0), math.pi / 2.0))
            await until(lambda: stand.drone.true_velocity_n_mps[1] < -0.3)
            await until(lambda: drone.state.velocity_n_mps[0] > 0.2)
            await drone.hold()
            assert drone.state.mode is FlightMode.HOLD
            await until(lambda: stand.heard[-3:] == ["rc 0 0 0 0"] * 3)
            await drone.land(60.0)
            assert not drone.state.armed
            assert stand.drone.on_ground
        assert stand.count("takeoff") == 1
        assert stand.count("land") == 1

    with emulated(speed=4.0) as stand:
        asyncio.run(fly(stand))


def test_a_second_drone_is_told_from_the_first() -> None:
    async def both(one: Stand, other: Stand) -> None:
        async with vehicle(one) as first, vehicle(other) as second:
            with other.lock:
                other.drone.autopilot.set_battery(0.31)
            await until(lambda: second.state.battery == pytest.approx(0.31))
            assert first.state.battery > 0.9

    with emulated() as one, emulated() as other:
        asyncio.run(both(one, other))


# --- refusals


def test_a_refused_take_off_is_told_in_the_drone_s_words_and_not_said_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("drivers.tello.vehicle.JUDGE_S", 0.5)

    async def refused(stand: Stand) -> None:
        async with vehicle(stand) as drone:
            await drone.arm()
            with pytest.raises(VehicleError, match="error Motor stop") as caught:
                await drone.take_off(1.0, 10.0)
            assert "propeller" in caught.value.remedy
            assert not drone.state.armed
            await drone.land(5.0)  # nothing to land
        assert stand.count("takeoff") == 1
        assert stand.count("land") == 0

    with emulated() as stand:
        stand.emulator.flight.motor_fault = True
        asyncio.run(refused(stand))


def test_a_take_off_and_a_landing_without_an_answer_are_taken_from_state_packets() -> None:
    async def unanswered(stand: Stand) -> None:
        async with vehicle(stand) as drone:
            await drone.arm()
            stand.emulator.faults.mute = True
            await drone.take_off(1.0, 30.0)
            assert drone.state.armed
            assert -drone.state.position_n_m[2] == pytest.approx(1.0, abs=0.2)
            await drone.land(60.0)
            assert stand.drone.on_ground
        assert stand.count("takeoff") == 1

    with emulated(speed=4.0) as stand:
        asyncio.run(unanswered(stand))


def test_a_take_off_that_is_lost_is_told_and_said_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("drivers.tello.vehicle.JUDGE_S", 0.5)

    async def lost(stand: Stand) -> None:
        async with vehicle(stand) as drone:
            await drone.arm()
            stand.emulator.faults.deaf = True
            with pytest.raises(
                VehicleError, match="no answer to the command to take off: it seems to stand"
            ):
                await drone.take_off(1.0, 0.5)
            assert not drone.state.armed
        assert stand.count("takeoff") == 0

    with emulated() as stand:
        asyncio.run(lost(stand))


def test_a_low_battery_is_not_armable() -> None:
    async def low(stand: Stand) -> None:
        async with vehicle(stand) as drone:
            with stand.lock:
                stand.drone.autopilot.set_battery(0.15)
            await until(lambda: drone.state.battery < 0.2)
            with pytest.raises(VehicleError, match="battery at 15 %, below 20 %"):
                await drone.wait_armable(0.1)

    with emulated() as stand:
        asyncio.run(low(stand))


def test_setpoints_that_are_no_numbers_are_not_sent() -> None:
    async def fly(stand: Stand) -> None:
        async with vehicle(stand) as drone:
            with pytest.raises(VehicleError, match="not finite"):
                drone.fly(VelocitySetpoint((math.nan, 0.0, 0.0), 0.0))
            with pytest.raises(VehicleError, match="not in the air"):
                await drone.start_offboard(STILL)
        assert stand.count("rc") == 0

    with emulated() as stand:
        asyncio.run(fly(stand))


# --- unplugged


def test_when_state_packets_stop_every_wait_ends_and_the_age_is_told() -> None:
    async def unplugged(stand: Stand) -> None:
        async with vehicle(stand) as drone:
            await drone.arm()
            await drone.take_off(0.9, 60.0)
            stand.emulator.faults.no_state = True
            start_s = time.monotonic()
            with pytest.raises(VehicleError, match=r"no state packet from the drone for \d\.\d s"):
                await drone.land(600.0)
            assert time.monotonic() - start_s < 60.0
            # not made to look younger than it is
            assert drone.link.clock.now_ns() - drone.state.stamp_ns > 1e9
            assert drone.state.armed  # nobody has seen it land
        assert stand.count("land") >= 3  # it was told to, and does
        await until(lambda: stand.drone.on_ground)

    with emulated(speed=4.0) as stand:
        asyncio.run(unplugged(stand))


def test_garbled_state_packets_are_counted_and_never_become_a_state() -> None:
    async def garbled(stand: Stand) -> None:
        async with vehicle(stand) as drone:
            stand.emulator.faults.garbled_state = True
            link = drone.link
            await until(lambda: link.bad_reports >= 1)  # what came before it is read
            before = drone.state
            await until(lambda: link.bad_reports >= 4)
            assert drone.state == before

    with emulated() as stand:
        asyncio.run(garbled(stand))


def test_a_late_answer_does_not_satisfy_the_next_command() -> None:
    async def late(stand: Stand) -> None:
        link = TelloLink(TelloAddress(**stand.address), context().clock)
        await link.acquire()
        stand.emulator.faults.late_s = 1.5
        assert await link.ask("speed 33", 0.1) is None
        stand.emulator.faults.late_s = 0.0
        assert await link.ask("battery?", 60.0) == "100"
        assert link.late == 1
        stand.emulator.faults.late_s = 1.0
        assert await link.ask("sdk?", 0.1) is None
        # what cannot wait goes at once, and does not take the other's answer for its own
        assert await link.ask("speed?", 60.0, urgent=True) == "33.0"
        await link.release()

    with emulated() as stand:
        asyncio.run(late(stand))


def test_it_is_kept_awake_while_it_holds_and_not_while_a_script_flies_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("drivers.tello.vehicle.KEEP_ALIVE_S", 0.1)

    async def idle(stand: Stand) -> None:
        async with vehicle(stand) as drone:
            await until(lambda: stand.count("command") >= 3)
            await drone.arm()
            await drone.take_off(0.9, 60.0)
            await until(lambda: stand.heard[-2:] == ["rc 0 0 0 0"] * 2)
            await drone.start_offboard(RISING)
            # and all that was said before it
            await until(lambda: stand.heard[-1] not in ("rc 0 0 0 0", "command"))
            heard = len(stand.heard)
            await asyncio.sleep(0.5)  # nothing is to happen
            assert len(stand.heard) == heard
            await drone.land(60.0)

    with emulated(speed=4.0) as stand:
        asyncio.run(idle(stand))


# --- before anything is sent


def refusal(stand: Stand | None = None, **options: Any) -> VehicleError:
    nobody: dict[str, Any] = {"host": free_host(), "state_port": STATE_PORT}
    address = nobody if stand is None else stand.address
    drone = TelloVehicle(TelloVehicleConfig(**{**address, **options}), context())

    async def open_it() -> None:
        async with drone:
            pass

    with pytest.raises(VehicleError) as caught:
        asyncio.run(open_it())
    return caught.value


def test_a_drone_that_is_not_there(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("drivers.tello.commands.COMMAND_S", 0.1)
    host = free_host()
    error = refusal(host=host, video_port=free_port())
    assert f"no answer from {host}" in str(error)
    assert "Wi-Fi" in error.remedy


def test_a_drone_whose_state_packets_do_not_arrive(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("drivers.tello.commands.STATE_S", 0.3)
    with emulated() as stand:
        stand.emulator.faults.no_state = True
        error = refusal(stand)
    assert "no state packet" in str(error)
    assert str(STATE_PORT) in str(error)


def test_a_firmware_that_cannot_change_its_ports() -> None:
    with emulated({"sdk3": False}) as stand:
        error = refusal(stand)
    assert "'unknown command: port'" in str(error)
    assert "namespace" in error.remedy


def test_the_wrong_drone() -> None:
    with emulated() as stand:
        error = refusal(stand, serial="0TQZH77ED00001")
    assert "is 0TQZH77ED00000, the rig says 0TQZH77ED00001" in str(error)
    assert "swapped" in error.remedy


def test_a_port_that_somebody_else_has() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("", 0))
        port = other.getsockname()[1]
        with pytest.raises(VehicleError, match=f"video_port: UDP port {port} is in use") as caught:
            check_ports(TelloAddress(state_port=STATE_PORT, video_port=port), STATE_PORT)
    assert "ss -lunp" in caught.value.remedy


def test_the_wrong_interface_or_none() -> None:
    check_route(TelloAddress(host="127.0.0.1", interface="lo"))
    with pytest.raises(VehicleError, match="interface: nowlan0 has no address"):
        check_route(TelloAddress(host="127.0.0.1", interface="nowlan0"))


def test_the_wrong_namespace() -> None:
    check_namespace("")
    with pytest.raises(VehicleError, match="no network namespace 'tello-that-is-not'"):
        check_namespace("tello-that-is-not")


@pytest.mark.parametrize(
    ("options", "names"),
    [
        ({"host": "tello"}, "host"),
        ({"host": "::1"}, "host"),
        ({"state_port": 80}, "state_port"),
        ({"video_port": 8890}, "video_port"),
        ({"full_stick_mps": 0.0}, "full_stick_mps"),
    ],
)
def test_options_that_cannot_be(options: dict[str, Any], names: str) -> None:
    with pytest.raises(ValueError, match=names):
        TelloVehicleConfig(**options)


def test_what_it_lacks_is_said() -> None:
    assert {each.value for each in TelloVehicle.lacks} == {
        "geofence",
        "global_position",
        "pilot_override",
    }
    assert dataclasses.fields(TelloVehicleConfig)[0].name == "host"
