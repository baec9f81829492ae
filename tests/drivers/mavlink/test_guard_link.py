"""The guard's own link, over real sockets to the embedded PX4-like vehicle, a scripted ArduCopter
and a pty.
"""

from __future__ import annotations

import asyncio
import math
import os
import socket
import threading
import time
from collections.abc import Callable, Coroutine, Generator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import all as mavlink

from drivers.interfaces import FlightMode, VehicleError
from drivers.mavlink.guard.interfaces import GuardView
from drivers.mavlink.guard_link import GuardMavlink, GuardMavlinkConfig
from drivers.mavlink.transport.frames import take_frames
from drivers.mavlink.transport.port import UNSIGNED
from drivers.rig.parts import PartContext
from hil.autopilot.values import Severity, StatusText
from tests.doubles import WallClock
from tests.free_ports import free_port
from tests.guard_bench import LIMIT_S, ORIGIN, SYSID, Bench, bench

BIND = f"127.0.0.1:{free_port()}"
HOLD_OR_LAND = (176, 21)


CONTEXT = PartContext(cast(Any, None), WallClock(), *cast(Any, (None, None, None)), origin=ORIGIN)


def guard_at(url: str, sysid: int = SYSID) -> GuardMavlink:
    return GuardMavlink(GuardMavlinkConfig(url, BIND, sysid), CONTEXT)


async def seen(guard: GuardMavlink, condition: Callable[[GuardView], bool]) -> GuardView:
    end_s = time.monotonic() + LIMIT_S
    while True:
        view = guard.view()
        if view is not None and condition(view):
            return view
        assert time.monotonic() < end_s, view
        await asyncio.sleep(0.005)


async def fly(own: Bench, guard: GuardMavlink, by_setpoints: bool = True) -> None:
    """Have it climb while the guard goes on reading, as it does in its program.

    Else its socket fills meanwhile, and the kernel drops what comes next: the answer to the first
    command.
    """
    climbing = asyncio.create_task(asyncio.to_thread(own.in_air, by_setpoints))
    while not climbing.done():
        guard.view()
        await asyncio.sleep(0.005)
    await climbing
    await seen(guard, lambda view: view.armed and view.in_air)


def run(main: Callable[[Bench], Coroutine[Any, Any, None]]) -> None:
    with bench() as own:
        asyncio.run(main(own))


def test_it_sees_what_its_rules_need_and_each_command_is_one_packet() -> None:
    async def main(own: Bench) -> None:
        async with guard_at(f"udpin://127.0.0.1:{own.port}") as guard:
            await seen(guard, lambda view: not view.armed and not view.in_air)
            await fly(own, guard)
            view = await seen(
                guard, lambda v: v.armed and v.in_air and v.mode is FlightMode.OFFBOARD
            )
            view = await seen(
                guard, lambda v: v.position_ns > view.heartbeat_ns and not math.isnan(v.battery)
            )
            with own.lock:
                truth, battery = own.drone.estimate.position_n_m, own.autopilot.battery
            assert math.dist(view.position_n_m, truth) < 0.3
            assert view.battery == pytest.approx(battery, abs=0.02)
            assert view.acked is None
            guard.hold()
            view = await seen(guard, lambda v: v.mode is FlightMode.HOLD)
            assert (await seen(guard, lambda v: v.acked is not None)).acked is True
            guard.land()
            assert (await seen(guard, lambda v: v.acked is not None)).acked is True
            await seen(guard, lambda v: not v.armed)
            assert own.commands(*HOLD_OR_LAND) == [176, 21]
            senders = {
                (m.get_srcSystem(), m.get_srcComponent())
                for m in own.wire
                if m.get_type() == "COMMAND_LONG"
            }
            assert senders == {(246, 191)}
            (kind,) = {m.type for m in own.wire if m.get_type() == "HEARTBEAT"}
            # no ground station: its failsafes must not be fed
            assert kind == mavlink.MAV_TYPE_ONBOARD_CONTROLLER

    run(main)


# of a GPS; of a PX4 with its origin at sea level
@pytest.mark.parametrize("altitude_off_m", [10.0, -10.0, -488.0])
def test_height_may_be_reckoned_from_home_whatever_the_altitude(altitude_off_m: float) -> None:
    async def main(own: Bench) -> None:
        url = f"udpin://127.0.0.1:{own.port}"
        async with guard_at(url) as guard:  # by the altitude
            view = await seen(guard, lambda view: view.position_ns > 0)
            assert view.position_n_m[2] == pytest.approx(-0.1 - altitude_off_m, abs=0.1)
        async with GuardMavlink(
            GuardMavlinkConfig(url, BIND, SYSID, height_from="home"), CONTEXT
        ) as guard:
            view = await seen(guard, lambda view: view.position_ns > 0)
            assert view.position_n_m[2] == pytest.approx(0.0, abs=0.05)
            await fly(own, guard)
            view = await seen(guard, lambda view: view.in_air and view.mode is FlightMode.OFFBOARD)
            assert view.position_n_m[2] == pytest.approx(-1.0, abs=0.35)

    with bench(altitude_off_m=altitude_off_m) as own:
        asyncio.run(main(own))


def test_motors_that_a_switch_stopped_are_known_from_a_text() -> None:
    def say(own: Bench, text: str) -> None:
        with own.lock:
            own.autopilot.status_texts.append(
                StatusText(own.drone.estimate.time_s, Severity.INFO, text)
            )

    async def main(own: Bench) -> None:
        async with guard_at(f"udpin://127.0.0.1:{own.port}") as guard:
            await fly(own, guard)
            await seen(guard, lambda view: view.armed)
            say(own, "RC7: MotorEStop HIGH")  # an ArduCopter's; it goes on calling itself armed
            await seen(guard, lambda view: not view.armed)
            say(own, "RC7: MotorEStop LOW")
            await seen(guard, lambda view: view.armed)

    run(main)


def test_a_refusal_is_seen() -> None:
    async def main(own: Bench) -> None:
        async with guard_at(f"udpin://127.0.0.1:{own.port}") as guard:
            await seen(guard, lambda _: True)
            await fly(own, guard)
            with own.lock:
                own.autopilot.set_battery(0.05)  # it lands by itself, and obeys nobody but a pilot
            await seen(guard, lambda view: view.mode is FlightMode.LAND)
            guard.hold()
            assert (await seen(guard, lambda view: view.acked is not None)).acked is False

    run(main)


def test_another_vehicle_on_the_port_is_not_taken_for_ours() -> None:
    async def main(own: Bench) -> None:
        async with guard_at(f"udpin://127.0.0.1:{own.port}", sysid=9) as guard:
            while own.world.time_s < 1.0:  # dozens of its messages
                assert guard.view() is None
                await asyncio.sleep(0.01)
        # and nothing was said to it
        assert {message.get_srcSystem() for message in own.wire} == {245}

    run(main)


@contextmanager
def spoofer(port: int) -> Generator[socket.socket]:
    """Says fifty times a second, from a port of its own, that our vehicle is in a pilot's mode, and
    not armed.
    """
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as own:
        own.bind(("127.0.0.1", 0))
        own.setblocking(False)
        mav: Any = mavlink.MAVLink(None, srcSystem=SYSID, srcComponent=1)
        stop = threading.Event()

        def spoof() -> None:
            while not stop.wait(0.02):
                for base in (1, 129):
                    beat = mavlink.MAVLink_heartbeat_message(2, 12, base, 3 << 16, 4, 3)
                    own.sendto(beat.pack(mav), ("127.0.0.1", port))
                mode = mavlink.MAVLink_current_mode_message(0, 3 << 16, 3 << 16)
                own.sendto(mode.pack(mav), ("127.0.0.1", port))

        thread = threading.Thread(target=spoof)
        thread.start()
        try:
            yield own
        finally:
            stop.set()
            thread.join()


def test_a_second_vehicle_of_our_number_is_told_of_and_ignored() -> None:
    async def main(own: Bench) -> None:
        async with guard_at(f"udpin://127.0.0.1:{own.port}") as guard:
            await seen(guard, lambda _: True)
            await fly(own, guard)
            await seen(guard, lambda view: view.mode is FlightMode.OFFBOARD)
            with spoofer(own.port) as other:
                await seen(guard, lambda _: bool(guard.ignored))
                begun_s = own.world.time_s
                while own.world.time_s < begun_s + 1.0:
                    view = guard.view()
                    assert view is not None and view.armed and view.mode is FlightMode.OFFBOARD
                    await asyncio.sleep(0.005)
                (what,) = guard.ignored
                assert what == f"a second vehicle 1, at 127.0.0.1:{other.getsockname()[1]}"
                assert guard.ignored[what] > 20
                guard.hold()
                await seen(guard, lambda view: view.mode is FlightMode.HOLD)
                with pytest.raises(BlockingIOError):
                    other.recv(2048)  # nothing was said to it

    run(main)


def test_what_one_packet_says_the_next_one_takes_back() -> None:
    """Even from the vehicle's own address: whoever can write that into a packet is one voice
    between many.
    """

    async def main(own: Bench) -> None:
        async with guard_at(f"udpin://127.0.0.1:{own.port}") as guard:
            await seen(guard, lambda _: True)
            await fly(own, guard)
            await seen(guard, lambda view: view.mode is FlightMode.OFFBOARD and view.mode_told > 1)
            forged = mavlink.MAVLink_heartbeat_message(2, 12, 129, 3 << 16, 4, 3)
            packet = forged.pack(mavlink.MAVLink(None, srcSystem=SYSID, srcComponent=1))
            for _ in range(3):
                with own.lock:
                    own.vehicle._channels[1].send(packet)
                view = await seen(guard, lambda view: view.mode is FlightMode.OTHER)
                assert view.mode_told == 1
                await seen(
                    guard, lambda view: view.mode is FlightMode.OFFBOARD and view.mode_told > 1
                )
            own.select(FlightMode.OTHER, by_pilot=True)
            await seen(guard, lambda view: view.mode is FlightMode.OTHER and view.mode_told > 1)

    run(main)


def test_with_a_key_only_what_is_signed_is_believed_and_the_vehicle_takes_what_is_sent(
    key_file: Path,
) -> None:
    async def main(own: Bench) -> None:
        config = GuardMavlinkConfig(f"udpin://127.0.0.1:{own.port}", BIND, SYSID, key_file=key_file)
        with spoofer(own.port) as other:
            async with GuardMavlink(config, CONTEXT) as guard:
                await seen(
                    guard, lambda view: view.mode is FlightMode.HOLD and view.position_ns > 0
                )
                assert set(guard.ignored) == {UNSIGNED}
                await fly(own, guard, by_setpoints=False)
                guard.land()
                assert (await seen(guard, lambda view: view.acked is not None)).acked is True
                with pytest.raises(BlockingIOError):
                    other.recv(2048)

    with bench(key=key_file.read_bytes()) as own:
        asyncio.run(main(own))


def test_another_key_than_the_vehicles_hears_nothing(key_file: Path) -> None:
    async def main(own: Bench) -> None:
        config = GuardMavlinkConfig(f"udpin://127.0.0.1:{own.port}", BIND, SYSID, key_file=key_file)
        async with GuardMavlink(config, CONTEXT) as guard:
            while not guard.ignored:
                assert guard.view() is None
                await asyncio.sleep(0.01)

    with bench(key=bytes(32)) as own:
        asyncio.run(main(own))


class Copter:
    """ArduCopter's heartbeat in GUIDED on a socket of ours."""

    def __init__(self) -> None:
        self.mav: Any = mavlink.MAVLink(None, srcSystem=SYSID, srcComponent=1)
        self.mode = 4

    def heartbeat(self) -> bytes:
        return mavlink.MAVLink_heartbeat_message(2, 3, 1 | 128, self.mode, 4, 3).pack(self.mav)

    def current_mode(self) -> bytes:
        return mavlink.MAVLink_current_mode_message(0, self.mode, self.mode).pack(self.mav)


def commands(data: bytes) -> list[tuple[int, float, float, float]]:
    parser: Any = mavlink.MAVLink(None)
    messages = parser.parse_buffer(data) or []
    return [
        (m.command, m.param1, m.param2, m.param5)
        for m in messages
        if m.get_type() == "COMMAND_LONG" and m.command in HOLD_OR_LAND
    ]


def test_arducopter_is_braked_and_landed_in_its_own_numbers() -> None:
    async def main() -> None:
        copter = Copter()
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as vehicle:
            vehicle.bind(("127.0.0.1", 0))
            vehicle.settimeout(LIMIT_S)
            async with guard_at(f"udpout://127.0.0.1:{vehicle.getsockname()[1]}") as guard:
                assert guard.view() is None  # it speaks first: a router learns of it so
                _, address = vehicle.recvfrom(2048)
                vehicle.sendto(b"\x00noise" + copter.heartbeat(), address)
                view = await seen(guard, lambda _: True)
                assert (view.mode, view.armed) == (FlightMode.OFFBOARD, True)
                guard.hold()
                guard.land()
                heard: list[tuple[int, float, float, float]] = []
                while len(heard) < 2:
                    heard += commands(vehicle.recv(2048))
                assert heard == [(176, 1.0, 17.0, 0.0), (21, 0.0, 0.0, 0.0)]
                copter.mode = 5  # LOITER: a pilot's
                vehicle.sendto(copter.current_mode(), address)
                later = await seen(guard, lambda v: v.mode is FlightMode.OTHER)
                assert later.heartbeat_ns == view.heartbeat_ns  # it did not wait for the next one

    asyncio.run(main())


def test_a_serial_port_carries_it_too() -> None:
    async def main() -> None:
        ours, theirs = os.openpty()
        os.set_blocking(ours, False)
        copter = Copter()
        async with guard_at(f"serial://{os.ttyname(theirs)}:57600") as guard:
            packet = copter.heartbeat()
            os.write(ours, b"\xfd\x01" + packet[:7])  # the end of another one before it
            assert guard.view() is None
            os.write(ours, packet[7:] + copter.heartbeat() + copter.heartbeat())
            await seen(guard, lambda view: view.mode is FlightMode.OFFBOARD)
            guard.land()
            heard = b""
            end_s = time.monotonic() + LIMIT_S
            while not commands(heard) and time.monotonic() < end_s:
                try:
                    heard += os.read(ours, 4096)
                except BlockingIOError:
                    await asyncio.sleep(0.005)
            assert [command for command, *_ in commands(heard)] == [21]
        os.close(ours)
        os.close(theirs)

    asyncio.run(main())


def test_a_port_that_somebody_has_is_refused() -> None:
    async def main() -> None:
        url = f"udpin://127.0.0.1:{free_port()}"
        async with guard_at(url):
            with pytest.raises(VehicleError, match="already used"):
                await guard_at(url).__aenter__()
        with pytest.raises(VehicleError, match="cannot open"):
            await guard_at("serial:///dev/no-such-port:57600").__aenter__()

    asyncio.run(main())


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"url": "tcp://1.2.3.4:5"}, "url"),
        ({"bind": "10.0.0.1:14561"}, "own computer"),
        ({"vehicle_sysid": 246}, "must differ"),
        ({"own_compid": 0}, "own_compid"),
    ],
)
def test_options_that_cannot_be_are_refused(options: dict[str, Any], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        replace(GuardMavlinkConfig("udpin://127.0.0.1:14551", BIND), **options)


HEARTBEAT = Copter().heartbeat()


@settings(max_examples=200)
@given(st.lists(st.integers(1, len(HEARTBEAT)), max_size=8), st.integers(0, 5))
def test_frames_are_found_however_the_bytes_come(cuts: list[int], frames: int) -> None:
    stream, waiting, found = HEARTBEAT * frames, bytearray(), list[bytes]()
    for size in [*cuts, len(stream)]:
        piece, stream = stream[:size], stream[size:]
        waiting += piece
        found += [bytes(frame) for frame in take_frames(waiting)]
    assert found == [HEARTBEAT] * frames
    assert not waiting


@settings(max_examples=200)
@given(st.binary(max_size=400))
def test_noise_neither_stops_nor_grows(noise: bytes) -> None:
    waiting = bytearray(noise)
    assert all(frame[0] in (0xFD, 0xFE) for frame in take_frames(waiting))
    assert len(waiting) < 300
