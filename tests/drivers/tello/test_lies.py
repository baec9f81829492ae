"""A drone whose words and whose state packets contradict each other: the state packets are
believed.

Real drones were seen to answer with their app's binary packets, with "error" while they obeyed, and
not at all.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Callable
from typing import Any

import pytest

from drivers.interfaces import FlightMode, VehicleError, VelocitySetpoint, Wary
from drivers.tello.commands import is_answer
from drivers.tello.receivers import _take_state  # pyright: ignore[reportPrivateUsage]
from drivers.tello.vehicle import TelloVehicle
from tests.drivers.tello.tello_stand import Stand, emulated, until
from tests.drivers.tello.test_vehicle import vehicle

STILL = VelocitySetpoint((0.0, 0.0, 0.0), 0.0)
BINARY = bytes.fromhex("cc6001b92c885600020000ff9ac3")
TOLD_NOTHING = {
    "error": b"error",
    "a binary packet": BINARY,
    "nothing": b"",
    "no UTF-8": b"\xff\xfe\xfaok",
}
Script = Callable[[Stand, TelloVehicle], Awaitable[None]]


def fly(
    script: Script, prepare: Callable[[Stand], None] = lambda _: None, speed: float = 4.0
) -> None:
    """Run a script against a drone that is prepared to lie before anybody connects."""

    async def whole(stand: Stand) -> None:
        async with vehicle(stand) as drone:
            await script(stand, drone)

    with emulated(speed=speed) as stand:
        prepare(stand)
        asyncio.run(whole(stand))


@pytest.mark.parametrize("answer", TOLD_NOTHING.values(), ids=TOLD_NOTHING.keys())
def test_a_take_off_that_is_answered_by_no_ok_and_flown_is_flown(answer: bytes) -> None:
    async def script(stand: Stand, drone: TelloVehicle) -> None:
        stand.emulator.faults.words["takeoff"] = answer
        await drone.arm()
        await drone.take_off(1.1, 30.0)
        assert drone.state.armed and drone.state.in_air
        assert -drone.state.position_n_m[2] == pytest.approx(1.1, abs=0.2)
        assert stand.count("takeoff") == 1
        await drone.start_offboard(STILL)
        await drone.land(30.0)
        assert stand.drone.on_ground

    fly(script)


@pytest.mark.parametrize(
    "answer", [b"error", b"ok", BINARY], ids=["error", "ok at once", "a binary packet"]
)
def test_a_landing_lasts_until_state_packets_show_it_down(answer: bytes) -> None:
    async def script(stand: Stand, drone: TelloVehicle) -> None:
        await drone.arm()
        await drone.take_off(0.9, 30.0)
        stand.emulator.faults.words["land"] = answer
        await drone.land(30.0)
        assert stand.drone.on_ground
        assert not drone.state.armed

    fly(script)


def test_a_drone_that_says_ok_and_does_not_land_is_told_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("drivers.tello.vehicle.LAND_AGAIN_S", 0.5)
    told: list[None] = []

    async def script(stand: Stand, drone: TelloVehicle) -> None:
        await drone.arm()
        await drone.take_off(0.9, 30.0)
        land = stand.emulator.flight.land

        def deaf_twice() -> str | None:
            told.append(None)
            return "ok" if len(told) <= 2 else land()

        stand.emulator._commands["land"] = deaf_twice  # pyright: ignore[reportPrivateUsage]
        await drone.land(30.0)
        assert stand.drone.on_ground
        assert len(told) >= 3

    fly(script)


def test_a_drone_that_never_lands_is_an_alarm_and_not_kept_awake(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr("drivers.tello.vehicle.KEEP_ALIVE_S", 0.1)
    monkeypatch.setattr("drivers.tello.vehicle.LAND_AGAIN_S", 0.5)

    async def script(stand: Stand, drone: TelloVehicle) -> None:
        await drone.arm()
        await drone.take_off(0.9, 30.0)
        stand.emulator._commands["land"] = lambda: "ok"  # pyright: ignore[reportPrivateUsage]
        with (
            caplog.at_level(logging.ERROR),
            pytest.raises(VehicleError, match=r"not on the ground 1\.5 s after"),
        ):
            await drone.land(1.5)
        assert "not on the ground" in caplog.text
        heard = len(stand.heard)
        await asyncio.sleep(0.6)
        assert stand.heard[heard:] == []
        assert drone.state.armed and drone.state.in_air

    fly(script)


def test_a_take_off_that_failed_is_not_kept_in_the_air(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("drivers.tello.vehicle.KEEP_ALIVE_S", 0.1)
    # it is refused before the drone has begun to climb
    monkeypatch.setattr("drivers.tello.vehicle.JUDGE_S", 0.05)

    async def script(stand: Stand, drone: TelloVehicle) -> None:
        stand.emulator.faults.words["takeoff"] = b"error"
        await drone.arm()
        with pytest.raises(VehicleError, match="refused to take off: it said 'error'"):
            await drone.take_off(1.1, 30.0)
        await until(lambda: drone.state.in_air)  # whatever the script believes
        assert drone.state.armed
        heard = len(stand.heard)
        await asyncio.sleep(0.5)
        assert stand.heard[heard:] == []
        with pytest.raises(VehicleError, match="in the air already"):
            await drone.arm()
        await drone.land(30.0)
        assert stand.drone.on_ground

    fly(script)


def test_a_drone_that_flies_when_it_is_closed_is_told_to_land() -> None:
    async def whole(stand: Stand) -> None:
        async with vehicle(stand) as drone:
            await drone.arm()
            await drone.take_off(0.9, 30.0)
        await until(lambda: stand.drone.on_ground)

    with emulated(speed=4.0) as stand:
        asyncio.run(whole(stand))


def test_a_drone_that_is_found_in_the_air_can_be_landed() -> None:
    async def whole(stand: Stand) -> None:
        stand.emulator._client = "127.0.0.1"  # pyright: ignore[reportPrivateUsage]
        with stand.lock:
            assert stand.emulator.flight.take_off() is None
        await until(lambda: stand.drone.true_position_n_m[2] < -0.6)
        async with vehicle(stand) as drone:
            await until(lambda: drone.state.in_air)
            assert drone.state.mode is FlightMode.HOLD
            await drone.land(30.0)
            assert stand.drone.on_ground

    with emulated(speed=2.0) as stand:
        asyncio.run(whole(stand))


def test_a_late_ok_lands_nothing_by_itself() -> None:
    async def script(stand: Stand, drone: TelloVehicle) -> None:
        await drone.arm()
        await drone.take_off(0.9, 30.0)
        stand.emulator.faults.late_s = 2.0  # of the emulator's time: half a second of ours
        await drone.land(30.0)
        assert stand.drone.on_ground

    fly(script)


def first_is_binary(stand: Stand) -> None:
    """Answer the first "command" with a binary packet alone, as users report."""
    stand.emulator.faults.words["command"] = BINARY

    def tap(_: float, text: str) -> None:
        stand.heard.append(text)
        if stand.heard.count("command") == 2:
            stand.emulator.faults.words.pop("command", None)

    stand.emulator.tap = tap


def beside_is_binary(stand: Stand) -> None:
    stand.emulator.faults.beside = BINARY


@pytest.mark.parametrize("prepare", [first_is_binary, beside_is_binary])
def test_binary_packets_are_passed_over_and_told(prepare: Callable[[Stand], None]) -> None:
    async def script(stand: Stand, drone: TelloVehicle) -> None:
        await drone.arm()
        await drone.take_off(0.9, 30.0)
        await drone.land(30.0)
        assert stand.drone.on_ground
        assert drone.link.passed_over >= 1
        assert isinstance(drone, Wary)
        assert any("no answers" in what for what in drone.ignored)

    fly(script, prepare)


@pytest.mark.parametrize(
    ("data", "is_one"),
    [
        (b"ok", True), (b"error Motor stop", True), (b"100\r\n", True), ("erreur à bord".encode(), True),
        (BINARY, False), (b"", False), (b"\r\n", False), (b"\x00ok", False), (b"o\x01k", False), (b"\xffok", False),
        (b"\xcc\x80ok", False), (b"...", False),
    ],
)  # fmt: skip
def test_what_is_an_answer_in_words(data: bytes, is_one: bool) -> None:
    assert is_answer(data) is is_one


BAD_STATES: dict[str, bytes] = {
    "a byte above 127": b"pitch:0;roll:0;yaw:\xb0;",
    "400 digits": b"pitch:0;roll:0;yaw:0;vgx:0;vgy:0;vgz:0;tof:10;h:%s;bat:87;time:0;temph:63;"
    % (b"9" * 400),
    "5000 digits": b"h:%s;" % (b"9" * 1900),
    "beyond any height": b"pitch:0;roll:0;yaw:0;vgx:0;vgy:0;vgz:0;tof:10;h:9999999;bat:87;time:0;temph:63;",
    "binary": BINARY,
    "empty": b"\x00",
    "temperature": b"pitch:x;temph:%s;" % (b"9" * 400),
}


@pytest.mark.parametrize("packet", BAD_STATES.values(), ids=BAD_STATES.keys())
def test_no_state_packet_ends_the_thread_of_all_drones(packet: bytes) -> None:
    async def script(stand: Stand, drone: TelloVehicle) -> None:
        stand.emulator.faults.state = packet
        await until(lambda: drone.link.bad_reports >= 2)
        before = drone.state.stamp_ns
        stand.emulator.faults.state = b""
        await until(lambda: drone.state.stamp_ns > before)
        assert drone.link.deaf == ""
        assert any("cannot be read" in what for what in drone.ignored)

    fly(script)


def test_a_receiving_thread_that_ended_is_an_alarm(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr("drivers.tello.vehicle.KEEP_ALIVE_S", 0.1)

    async def script(stand: Stand, drone: TelloVehicle) -> None:
        stand.emulator.faults.no_state = True  # what is not received any more
        monkeypatch.setattr(
            "drivers.tello.commands.ended_receivers", lambda: ["udp_state_receiver"]
        )
        with (
            caplog.at_level(logging.ERROR),
            pytest.raises(VehicleError, match="udp_state_receiver has ended"),
        ):
            await asyncio.sleep(1.2)
            await drone.wait_armable(5.0)
        assert "ALARM" in caplog.text
        assert any("has ended" in what for what in drone.ignored)

    fly(script)


def test_state_packets_without_a_drone_of_ours_are_left_to_the_library() -> None:
    """Drones that somebody opened by djitellopy itself, in the same program, are received as
    before.
    """
    entry: dict[str, Any] = {"responses": [], "state": {}}
    _take_state(entry, b"bat:87;")
    _take_state(entry, b"bat:\xff;")
    assert entry["state"] == {"bat": 87}


def test_a_drone_that_sends_too_few_state_packets_is_not_armable(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("hil.tello.emulator.STATE_PERIOD_S", 0.8)

    async def script(_: Stand, drone: TelloVehicle) -> None:
        with pytest.raises(
            VehicleError, match=r"state packets \d\.\d times a second.*needs 4\.0 a second"
        ):
            await drone.wait_armable(3.0)

    fly(script, speed=1.0)
