"""Packets that come in pieces, as a serial line cuts them: none is lost, and nobody's rest hides
another's packet.
"""

from __future__ import annotations

from typing import Any

import pytest
from pymavlink.dialects.v20 import all as mavlink

from drivers.mavlink.transport import mavsdk_line, port
from drivers.mavlink.transport.mavsdk_line import MavsdkLine
from drivers.mavlink.transport.port import MavlinkPort
from drivers.mavlink.transport.source import VehicleSource

SYSID, OWN = 3, (246, 191)
HERE, THERE = ("127.0.0.1", 1111), ("127.0.0.1", 2222)
URL = "serial:///dev/ttyNone:57600"
Pieces = list[tuple[bytes, Any]]


def time_of(message: Any) -> int:
    return message.time_boot_ms


def packet(sequence: int) -> bytes:
    mav = mavlink.MAVLink(None, srcSystem=SYSID, srcComponent=1)
    mav.seq = sequence
    return bytes(mavlink.MAVLink_attitude_message(sequence, 1, 1, 1, 1, 1, 1).pack(mav))


class Line:
    """In the place of a device or a socket: the pieces that come, one for each time it is read."""

    shared = False

    def __init__(self, pieces: Pieces) -> None:
        self.pieces = pieces

    def read(self) -> tuple[bytes, Any]:
        return self.pieces.pop(0) if self.pieces else (b"", None)

    def write(self, packet: bytes, to: Any) -> None: ...

    def close(self) -> None: ...


class Taker:
    """In the place of MAVSDK."""

    def __init__(self) -> None:
        self.taken: list[bytes] = []

    def pass_received_raw_bytes(self, data: bytes) -> None:
        self.taken.append(data)


def believed(*_: object) -> bool:
    return True


@pytest.fixture(params=["the script's line", "the guard's port"])
def heard(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Any:
    """What of some pieces is handed on: the packets' own times. Both addresses are believed."""
    monkeypatch.setattr(VehicleSource, "believes", believed)

    def by_line(pieces: Pieces) -> list[int]:
        monkeypatch.setattr(mavsdk_line, "open_transport", {URL: Line(list(pieces))}.__getitem__)
        line, taker = MavsdkLine(URL, SYSID, OWN), Taker()
        line._mavsdk = taker
        for piece in pieces:
            line._take(*piece)
        return [time_of(mavlink.MAVLink(None).decode(bytearray(each))) for each in taker.taken]

    def by_port(pieces: Pieces) -> list[int]:
        monkeypatch.setattr(port, "open_transport", {URL: Line(list(pieces))}.__getitem__)
        wanted = frozenset({mavlink.MAVLINK_MSG_ID_ATTITUDE})
        opened = MavlinkPort(URL, SYSID, OWN, wanted, lambda: 1)
        try:
            return [time_of(message) for _ in range(200) for message in opened.read()]
        finally:
            opened.close()

    return by_line if request.param == "the script's line" else by_port


@pytest.mark.parametrize("size", [1, 7, 38, 39, 100])
def test_a_stream_is_heard_whole_however_it_is_cut(heard: Any, size: int) -> None:
    """A serial line gives what has come so far: the rest of a packet comes with the next
    reading.
    """
    stream = b"".join(packet(number) for number in range(3))
    pieces: Pieces = [(stream[at : at + size], None) for at in range(0, len(stream), size)]
    assert heard(pieces) == [0, 1, 2]


def test_what_somebody_left_unfinished_does_not_hide_what_comes_next(heard: Any) -> None:
    """Datagrams are whole or nothing, and each address's own."""
    assert heard([(packet(0)[:20], THERE), (packet(1), HERE), (packet(2), HERE)]) == [1, 2]


def test_several_packets_in_one_reading_are_all_heard(heard: Any) -> None:
    assert heard([(packet(0) + packet(1), HERE), (packet(2), HERE)]) == [0, 1, 2]
