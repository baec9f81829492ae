"""Frames of both versions of MAVLink in a stream of bytes, with noise between them, and what a port
sends.
"""

from __future__ import annotations

import socket
from typing import Any

import pytest
from pymavlink.dialects.v10 import common as v1
from pymavlink.dialects.v20 import all as mavlink

from drivers.interfaces import VehicleError
from drivers.mavlink.transport import port
from drivers.mavlink.transport.frames import Head, head_of, payload_of, take_frames, whole
from drivers.mavlink.transport.port import MavlinkPort, SerialPort, UdpIn, UdpOut, open_transport
from tests.drivers.mavlink.transport.test_bytes import Line
from tests.free_ports import free_port

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
