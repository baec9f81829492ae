"""Source of the vehicle's words on the script's own port: proven once, all others ignored, signed
with a key.
"""

import asyncio
import socket
import time
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import replace
from itertools import count
from pathlib import Path
from threading import Event, Thread

import pytest
from pymavlink.dialects.v20 import common as mavlink

from drivers.interfaces import FlightMode, VehicleError, Wary
from drivers.mavlink.transport.frames import SIGNED, V2, take_frames
from drivers.mavlink.transport.mavsdk_line import MavsdkLine, needs_line
from drivers.mavlink.transport.port import extras
from drivers.mavlink.transport.signing import SignatureCheck, Signer
from drivers.mavlink.vehicle import MavsdkVehicleConfig
from tests.drivers.mavlink.mavsdk_bench import (
    LIMIT_S,
    STILL,
    SYSID,
    Bench,
    into_the_air,
    px4,
    until,
    vehicle_at,
)
from tests.exact_world import QUICK
from tests.free_ports import free_port

KEY = bytes(range(32))
PILOTS = 1 << 16  # PX4's MANUAL


def heartbeat(custom_mode: int = PILOTS, sequence: int = 0, sysid: int = SYSID) -> bytes:
    mav = mavlink.MAVLink(None, srcSystem=sysid, srcComponent=1)
    mav.seq = sequence % 256
    armed = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | mavlink.MAV_MODE_FLAG_SAFETY_ARMED
    return bytes(mavlink.MAVLink_heartbeat_message(2, 12, armed, custom_mode, 4, 3).pack(mav))


class Forger:
    """Sends to a port of this computer, and hears what comes back."""

    def __init__(self, port: int) -> None:
        self._port = port
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.setblocking(False)

    def send(self, packet: bytes) -> None:
        self.socket.sendto(packet, ("127.0.0.1", self._port))

    def heard(self) -> list[bytes]:
        packets: list[bytes] = []
        while True:
            try:
                packets.append(self.socket.recv(4096))
            except BlockingIOError:
                return packets


def test_heartbeats_in_a_pilots_mode_from_another_address_do_not_take_the_vehicle() -> None:
    """In the air, twenty of them in a row; nothing is sent to where they came from."""

    async def fly(bench: Bench) -> None:
        forger = Forger(bench.port)
        try:
            async with bench.vehicle() as vehicle:
                await into_the_air(vehicle)
                await vehicle.start_offboard(STILL)
                for number in range(20):
                    forger.send(heartbeat(sequence=number))
                    vehicle.fly(STILL)
                    await asyncio.sleep(0.05)
                    assert vehicle.state.mode is FlightMode.OFFBOARD
                assert isinstance(vehicle, Wary)
                assert any(
                    f"a second vehicle {SYSID}, at 127.0.0.1:" in what for what in vehicle.ignored
                )
                assert forger.heard() == []
                await vehicle.hold()
                await vehicle.land(LIMIT_S)
        finally:
            forger.socket.close()

    with px4(replace(QUICK, offboard_loss_s=300.0)) as bench:  # however busy the computer is
        asyncio.run(fly(bench))


def test_a_forger_that_comes_first_is_asked_and_is_not_the_vehicle() -> None:
    async def meet() -> None:
        port, numbers = free_port(), count()
        forger = Forger(port)
        meeting = asyncio.ensure_future(vehicle_at(port, connect_timeout_s=1.0).__aenter__())
        await until(meeting.done, lambda: forger.send(heartbeat(sequence=next(numbers))))
        with pytest.raises(VehicleError, match="no heartbeat"):
            await meeting
        asked = {packet[7] for packet in forger.heard()}
        forger.socket.close()
        assert asked == {mavlink.MAVLINK_MSG_ID_TIMESYNC}

    asyncio.run(meet())


def test_another_vehicle_on_the_port_is_named() -> None:
    async def meet() -> None:
        port, numbers = free_port(), count()
        other = Forger(port)
        meeting = asyncio.ensure_future(vehicle_at(port, connect_timeout_s=1.0).__aenter__())
        await until(meeting.done, lambda: other.send(heartbeat(sequence=next(numbers), sysid=9)))
        with pytest.raises(VehicleError, match="heard only 9"):
            await meeting
        other.socket.close()

    asyncio.run(meet())


@contextmanager
def signing_router(to_script: int, key: bytes) -> Generator[tuple[int, list[bool]]]:
    """Between an autopilot that speaks to the port yielded and the script: signs one way, checks
    and unwraps the other.

    Also yields whether each packet of the script's was rightly signed.
    """
    vehicle_side, script_side = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
    vehicle_side.bind(("127.0.0.1", 0))
    for one in (vehicle_side, script_side):
        one.settimeout(0.01)
    signer, check = Signer(key, 1, extras()), SignatureCheck(key)
    right: list[bool] = []
    stop = Event()

    def run() -> None:
        vehicle: tuple[str, int] | None = None
        while not stop.is_set():
            try:
                packet, vehicle = vehicle_side.recvfrom(4096)
                signed = [signer.sign(frame) for frame in take_frames(bytearray(packet))]
                assert signed and None not in signed
                script_side.sendto(
                    b"".join(frame for frame in signed if frame), ("127.0.0.1", to_script)
                )
            except TimeoutError:
                pass
            script_side.setblocking(False)
            while vehicle is not None:
                try:
                    packet = script_side.recv(4096)
                except BlockingIOError:
                    break
                right.append(packet[0] == V2 and bool(packet[2] & SIGNED) and check.holds(packet))
                vehicle_side.sendto(packet, vehicle)

    thread = Thread(target=run)
    thread.start()
    try:
        yield vehicle_side.getsockname()[1], right
    finally:
        stop.set()
        thread.join()
        vehicle_side.close()
        script_side.close()


def test_with_a_key_all_is_signed_and_what_is_not_is_ignored(tmp_path: Path) -> None:
    key_file = tmp_path / "autopilot.key"
    key_file.write_bytes(KEY)
    key_file.chmod(0o600)

    async def fly(port: int, right: list[bool], bench: Bench) -> None:
        del bench
        async with vehicle_at(port, key_file=key_file) as vehicle:
            await into_the_air(vehicle)
            assert right and all(right)
            forger = Forger(port)
            forger.send(heartbeat())
            await until(lambda: bool(vehicle.ignored))
            assert list(vehicle.ignored) == [
                "packets of the vehicle's number that are not signed with the key"
            ]
            assert vehicle.state.mode is FlightMode.HOLD
            forger.socket.close()
            await vehicle.land(LIMIT_S)

    script_port = free_port()
    with signing_router(script_port, KEY) as (port, right), px4(port=port) as bench:
        asyncio.run(fly(script_port, right, bench))


def test_without_the_key_a_signing_vehicle_is_not_believed(tmp_path: Path) -> None:
    key_file = tmp_path / "autopilot.key"
    key_file.write_bytes(bytes(32))
    key_file.chmod(0o600)

    async def meet(port: int) -> None:
        with pytest.raises(VehicleError, match="no heartbeat"):
            await vehicle_at(port, key_file=key_file, connect_timeout_s=1.0).__aenter__()

    script_port = free_port()
    with signing_router(script_port, KEY) as (port, _), px4(port=port):
        asyncio.run(meet(script_port))


def test_a_key_that_others_can_read_is_refused_as_the_vehicles(tmp_path: Path) -> None:
    key_file = tmp_path / "autopilot.key"
    key_file.write_bytes(KEY)
    key_file.chmod(0o644)

    async def meet() -> None:
        with pytest.raises(VehicleError, match="others can read it"):
            await vehicle_at(free_port(), key_file=key_file).__aenter__()

    asyncio.run(meet())


def test_what_cannot_be_signed_is_said() -> None:
    with pytest.raises(ValueError, match="key_file"):
        MavsdkVehicleConfig("tcpout://10.0.0.2:5760", key_file=Path("a.key"))
    with pytest.raises(VehicleError, match="cannot be signed"):
        MavsdkLine("tcpout://10.0.0.2:5760", SYSID, (245, 190), KEY)
    assert needs_line("udpin://0.0.0.0:14540", None) and needs_line(
        "serial:///dev/ttyACM0:57600", KEY
    )
    assert not needs_line("serial:///dev/ttyACM0:57600", None) and not needs_line(
        "udpout://10.0.0.2:14550", None
    )


class Taking:
    """The packets that MAVSDK would be handed."""

    def __init__(self) -> None:
        self.frames: list[bytes] = []

    def add_any_connection_with_handle(self, url: str) -> None:
        assert url == "raw://"

    def subscribe_raw_bytes_to_be_sent(self, callback: object) -> None: ...

    def pass_received_raw_bytes(self, frame: bytes) -> None:
        self.frames.append(frame)


def test_it_ends_at_once_and_hands_on_nothing_after() -> None:
    port, taking = free_port(), Taking()
    line = MavsdkLine(f"udpin://127.0.0.1:{port}", SYSID, (245, 190))
    line.start(taking)
    other = Forger(port)
    other.send(heartbeat(sysid=9))
    end_s = time.monotonic() + LIMIT_S
    while not taking.frames and time.monotonic() < end_s:
        time.sleep(0.01)
    begun_s = time.monotonic()
    line.stop()
    assert time.monotonic() - begun_s < LIMIT_S / 2.0
    other.send(heartbeat(sysid=9, sequence=1))
    time.sleep(0.05)
    line.close()
    line.close()
    other.socket.close()
    assert len(taking.frames) == 1
