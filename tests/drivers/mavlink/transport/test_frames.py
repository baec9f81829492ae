"""Frames of both versions of MAVLink in a stream of bytes, with noise between them, and what a port
sends.
"""

from __future__ import annotations

import os
import socket
from typing import Any

import pytest
from pymavlink.dialects.v10 import common as v1
from pymavlink.dialects.v20 import all as mavlink

from drivers.interfaces import VehicleError
from drivers.mavlink.transport import mavsdk_line, port
from drivers.mavlink.transport.frames import Head, head_of, payload_of, take_frames, whole
from drivers.mavlink.transport.mavsdk_line import MavsdkLine
from drivers.mavlink.transport.port import MavlinkPort, SerialPort, UdpIn, UdpOut, open_transport
from drivers.mavlink.transport.signing import SignatureCheck, Signer
from tests.drivers.mavlink.transport.test_bytes import Line
from tests.free_ports import free_port
from tests.guard_bench import until

SYSID = 3
KEY = bytes(range(32))
OLD = bytes(
    v1.MAVLink_heartbeat_message(2, 12, 1, 0, 4, 3).pack(
        v1.MAVLink(None, srcSystem=9, srcComponent=7)
    )
)
NEW = bytes(
    mavlink.MAVLink_param_value_message(b"X", 1.5, 9, 2, 1).pack(
        mavlink.MAVLink(None, srcSystem=9, srcComponent=7)
    )
)


def test_the_head_of_either_version_says_who_and_what() -> None:
    assert head_of(OLD) == Head(9, 7, 0, 6)
    turned = v1.MAVLink_attitude_message(77, 0, 0, 0, 0, 0, 0)
    packed = turned.pack(v1.MAVLink(None, srcSystem=9, srcComponent=7))
    assert head_of(bytes(packed)) == Head(9, 7, 30, 6)
    assert head_of(NEW) == Head(9, 7, 22, 10)
    assert whole(OLD) and not whole(OLD[:-1] + bytes((OLD[-1] ^ 1,)))
    assert payload_of(OLD, 9) == OLD[6:15]


@pytest.mark.parametrize("noise", [b"", b"\x00", b"\x00\x01\x02" * 9])
def test_frames_are_cut_out_of_noise_and_the_rest_is_kept(noise: bytes) -> None:
    waiting = bytearray(noise + OLD + noise + NEW + noise + NEW[:7])
    assert list(take_frames(waiting)) == [OLD, NEW]
    assert bytes(waiting) == NEW[:7]
    waiting += NEW[7:]
    assert list(take_frames(waiting)) == [NEW] and not waiting


def test_noise_alone_is_dropped() -> None:
    waiting = bytearray(b"\x00" * 50)
    assert list(take_frames(waiting)) == [] and not waiting


@pytest.mark.parametrize("length", range(1, len(OLD)))
def test_a_frame_that_has_not_come_whole_waits(length: int) -> None:
    waiting = bytearray(OLD[:length])
    assert list(take_frames(waiting)) == [] and bytes(waiting) == OLD[:length]


# --- a port


class Wire(Line):
    """A device whose output is kept."""

    def __init__(self, *pieces: tuple[bytes, Any], shared: bool = False) -> None:
        super().__init__(list(pieces))
        self.shared = shared
        self.written: list[tuple[bytes, Any]] = []
        self.closed = 0

    def write(self, packet: bytes, to: Any) -> None:
        self.written.append((packet, to))

    def close(self) -> None:
        self.closed += 1


def port_on(wire: Wire, monkeypatch: pytest.MonkeyPatch, key: bytes | None = None) -> MavlinkPort:
    def opened(_url: str) -> Wire:
        return wire

    monkeypatch.setattr(port, "open_transport", opened)
    return MavlinkPort(
        "serial:///dev/ttyNone:57600", SYSID, (246, 191), frozenset({0}), lambda: 1, key
    )


def beat(sysid: int = SYSID, component: int = 1) -> bytes:
    mav = mavlink.MAVLink(None, srcSystem=sysid, srcComponent=component)
    return bytes(mavlink.MAVLink_heartbeat_message(2, 12, 1, 0, 4, 3).pack(mav))


@pytest.mark.parametrize("key", [None, KEY])
def test_what_is_sent_is_numbered_and_signed_where_there_is_a_key(
    key: bytes | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    wire = Wire()
    opened = port_on(wire, monkeypatch, key)
    message: Any = mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3)
    for _ in range(258):
        opened.send(message)
    opened.close()
    assert wire.closed == 1
    numbers = [packet[4] for packet, _ in wire.written]
    assert numbers == [k % 256 for k in range(258)]
    first, to = wire.written[0]
    assert to is None and (first[5], first[6]) == (246, 191)
    assert bool(first[2] & 1) is (key is not None)


def test_only_wanted_messages_of_the_vehicle_s_own_autopilot_are_handed_on(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    mav = mavlink.MAVLink(None, srcSystem=SYSID, srcComponent=1)
    attitude = bytes(mavlink.MAVLink_attitude_message(0, 0, 0, 0, 0, 0, 0).pack(mav))
    damaged = beat()[:-1] + bytes((beat()[-1] ^ 1,))
    others = beat(SYSID + 1) + beat(component=2) + attitude + damaged
    opened = port_on(Wire((others + beat(), None)), monkeypatch)
    assert [message.get_type() for message in opened.read()] == ["HEARTBEAT"]
    assert opened.ignored == {}
    opened.close()


def test_with_a_key_what_is_not_signed_is_counted_and_not_believed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    opened = port_on(Wire((beat() + beat(), None)), monkeypatch, KEY)
    assert opened.read() == [] and opened.ignored == {port.UNSIGNED: 2}
    opened.close()


def test_a_vehicle_on_a_port_for_everybody_is_asked_before_it_is_believed_and_answered(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    here = ("127.0.0.1", 1111)
    wire = Wire((beat(), here), shared=True)
    opened = port_on(wire, monkeypatch)
    assert opened.read() == []
    ((question, to),) = wire.written
    assert to == here
    asked: Any = mavlink.MAVLink(None).decode(bytearray(question))
    mav = mavlink.MAVLink(None, srcSystem=SYSID, srcComponent=1)
    answer = bytes(mavlink.MAVLink_timesync_message(5, asked.ts1).pack(mav))
    wire.pieces += [(answer, here), (beat(), here)]
    assert [message.get_type() for message in opened.read()] == ["HEARTBEAT"]
    message: Any = mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3)
    opened.send(message)
    assert wire.written[-1][1] == here
    opened.close()


def test_a_flood_is_read_in_bounded_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    wire = Wire(*[(beat(), None)] * 1500)
    opened = port_on(wire, monkeypatch)
    assert len(opened.read()) == 1000
    assert len(opened.read()) == 500
    opened.close()


def test_a_device_that_is_not_there_is_told_and_its_lock_given_back() -> None:
    for _ in range(2):
        with pytest.raises(VehicleError, match=r"the guard cannot open serial:///dev/ttyNone"):
            MavlinkPort("serial:///dev/ttyNone:57600", SYSID, (246, 191), frozenset({0}), lambda: 1)


def test_datagrams_go_both_ways_and_to_nobody_where_nobody_is_known() -> None:
    number = free_port()
    listening = open_transport(f"udpin://127.0.0.1:{number}")
    talking = open_transport(f"udpout://127.0.0.1:{number}")
    assert isinstance(listening, UdpIn) and isinstance(talking, UdpOut)
    assert (listening.shared, talking.shared, SerialPort.shared) == (True, False, False)
    assert listening.read() == (b"", None) and talking.read() == (b"", None)
    talking.write(b"hello", ("127.0.0.1", 9))
    said, source = listening.read()
    assert said == b"hello" and source is not None
    listening.write(b"nobody", None)
    listening.write(b"answer", source)
    assert talking.read() == (b"answer", None)
    assert listening.fileno() >= 0 and talking.fileno() >= 0
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other, pytest.raises(OSError):
        other.bind(("127.0.0.1", number))
    talking.close()
    listening.close()


def test_a_serial_port_is_read_and_written_without_waiting_and_given_back() -> None:
    there, here = os.openpty()
    name = os.ttyname(here)
    device = open_transport(f"serial://{name}:57600")
    assert isinstance(device, SerialPort)
    assert device.read() == (b"", None)
    device.write(b"hello", None)
    assert os.read(there, 9) == b"hello"
    os.write(there, b"answer")
    assert device.read() == (b"answer", None)
    with pytest.raises(OSError):  # it is nobody else's
        SerialPort(name, 57600)
    number = device.fileno()
    device.close()
    with pytest.raises(OSError):
        os.fstat(number)
    os.close(there)
    os.close(here)


# --- MAVSDK's line


class Mavsdk:
    """In the place of MAVSDK: what is handed on to it, and its way to send."""

    def __init__(self) -> None:
        self.heard: list[bytes] = []
        self.connections: list[str] = []
        self.send: Any = None

    def subscribe_raw_bytes_to_be_sent(self, send: Any) -> None:
        self.send = send

    def add_any_connection_with_handle(self, url: str) -> None:
        self.connections.append(url)

    def pass_received_raw_bytes(self, frame: bytes) -> None:
        self.heard.append(frame)


def line_on(wire: Wire, monkeypatch: pytest.MonkeyPatch, key: bytes | None = None) -> MavsdkLine:
    def opened(_url: str) -> Wire:
        return wire

    monkeypatch.setattr(mavsdk_line, "open_transport", opened)
    return MavsdkLine("serial:///dev/ttyNone:57600", SYSID, (246, 191), key)


def test_what_mavsdk_sends_is_signed_with_this_end_s_own_link(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    wire = Wire()
    line = line_on(wire, monkeypatch, KEY)
    line._send(beat(246, 191) + beat(246, 191))
    assert [packet[2] for packet, _ in wire.written] == [1, 1]
    assert {packet[-13] for packet, _ in wire.written} == {191}
    check = SignatureCheck(KEY)
    assert all(check.holds(packet) for packet, _ in wire.written)
    line.close()
    assert wire.closed == 1


@pytest.mark.parametrize("pinned", [None, ("127.0.0.1", 1111)])
def test_neighbours_are_heard_until_the_vehicle_is_known(
    pinned: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    mav = mavlink.MAVLink(None, srcSystem=SYSID + 1, srcComponent=1)
    turned = bytes(mavlink.MAVLink_attitude_message(0, 0, 0, 0, 0, 0, 0).pack(mav))
    line, taker = line_on(Wire(shared=True), monkeypatch), Mavsdk()
    line._mavsdk = taker
    line._source.pinned = pinned
    line._take(beat(SYSID + 1) + turned, ("127.0.0.1", 2222))
    assert taker.heard == ([] if pinned else [beat(SYSID + 1)])
    taker.heard.clear()
    line._take(turned, pinned or ("127.0.0.1", 3333))
    assert taker.heard == ([turned] if pinned else [])
    line.close()


def test_what_is_not_signed_is_counted_and_nothing_is_handed_on_after_the_end(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    line, taker = line_on(Wire(), monkeypatch, KEY), Mavsdk()
    line._mavsdk = taker
    line._take(beat(), None)
    assert taker.heard == [] and line.ignored == {port.UNSIGNED: 1}
    signed = Signer(KEY, 1, port.extras()).sign(beat())
    assert signed is not None
    line._take(signed, None)
    assert taker.heard == [signed]
    line.stop()
    again = Signer(KEY, 2, port.extras()).sign(beat())
    assert again is not None
    line._take(again, None)
    assert taker.heard == [signed]
    line.close()


def test_a_line_hands_on_what_comes_from_its_start_to_its_end() -> None:
    number = free_port()
    line, taker = MavsdkLine(f"udpin://127.0.0.1:{number}", SYSID, (246, 191)), Mavsdk()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as vehicle:
        vehicle.settimeout(5.0)
        vehicle.connect(("127.0.0.1", number))
        line.start(taker)
        assert taker.connections == ["raw://"]
        vehicle.send(beat())
        asked: Any = mavlink.MAVLink(None).decode(bytearray(vehicle.recv(500)))
        mav = mavlink.MAVLink(None, srcSystem=SYSID, srcComponent=1)
        vehicle.send(bytes(mavlink.MAVLink_timesync_message(5, asked.ts1).pack(mav)))
        vehicle.send(beat())
        until(lambda: beat() in taker.heard)
        taker.send(beat(246, 191))  # it goes to the address that was proven
        assert vehicle.recv(500) == beat(246, 191)
    line.close()
    line.close()
    assert not line._thread.is_alive()


@pytest.mark.parametrize(
    ("url", "key", "needs"),
    [("udpin://0.0.0.0:1", None, True), ("udpout://1.2.3.4:1", None, False), ("udpout://1.2.3.4:1", KEY, True)],
)  # fmt: skip
def test_mavsdk_has_no_port_where_others_can_send_or_what_is_said_is_signed(
    url: str, key: bytes | None, needs: bool
) -> None:
    assert mavsdk_line.needs_line(url, key) is needs
