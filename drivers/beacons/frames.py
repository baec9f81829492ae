"""Marvelmind's streaming protocol: frames out of a stream of bytes, and what they say.

A frame is ``ff 47 code:u16 length:u8 payload crc:u16``, little-endian throughout; the CRC is
Modbus' CRC-16 over all before it (Marvelmind, "Interfaces and protocols of data exchange",
streaming packets). Codes that are not used here, the inertial ones among them, are taken whole and
ignored: their bytes are never taken for the beginning of another.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial

from path.messages import Vec3
from path.values import frozen

DESTINATION = 0xFF
# packet types; the second carries way points and user data
STREAM = 0x47
USER = 0x4A
HEADER = struct.Struct("<BBHB")
CRC_BYTES = 2

POSITION_CM = 0x0001
STATIONARY_CM = 0x0002
POSITION_MM = 0x0011
STATIONARY_MM = 0x0012
POSITION_NT = 0x0081
IMU_RAW = 0x0003
DISTANCES = 0x0004
IMU_FUSION = 0x0005
TELEMETRY = 0x0006
QUALITY = 0x0007

LENGTHS: dict[tuple[int, int], range] = {
    (STREAM, POSITION_CM): range(16, 17),
    (STREAM, STATIONARY_CM): range(1, 250, 8),
    (STREAM, IMU_RAW): range(32, 33),
    (STREAM, DISTANCES): range(32, 33),
    (STREAM, IMU_FUSION): range(42, 43),
    (STREAM, TELEMETRY): range(16, 17),
    (STREAM, QUALITY): range(16, 17),
    # newer firmware appends to it, as to those with stamps of 64 bits
    (STREAM, POSITION_MM): range(22, 64),
    (STREAM, STATIONARY_MM): range(1, 254, 14),
    (STREAM, POSITION_NT): range(26, 64),
    (STREAM, 0x0083): range(32, 64),
    (STREAM, 0x0084): range(32, 64),
    (STREAM, 0x0085): range(42, 72),
    (USER, 0x0201): range(12, 13),
    (USER, 0x0280): range(8, 128),
}
"""Payload bytes there can be, by packet type and code: the rest of what cannot be is not waited
for.
"""

UNAVAILABLE = 1 << 0  # flag of a position
ANGLE_MASK = 0x0FFF
NO_ANGLE = 1 << 13


def crc16(data: bytes | bytearray | memoryview) -> int:
    """Modbus' CRC-16; that of b"123456789" is 0x4B37."""
    crc = 0xFFFF
    for byte in data:
        crc = (crc >> 8) ^ _TABLE[(crc ^ byte) & 0xFF]
    return crc


def _table_entry(value: int) -> int:
    for _ in range(8):
        value = (value >> 1) ^ 0xA001 if value & 1 else value >> 1
    return value


_TABLE = tuple(_table_entry(value) for value in range(256))


@frozen
class MobilePosition:
    """One position of a mobile beacon ("hedgehog").

    Attributes:
        address: of the beacon.
        stamp_ms: instant of the ultrasound on the system's clock; ``bits`` is where it wraps.
        age_ms: from the ultrasound to the sending of this frame; 0 from firmware that does not say.
        position_m: in the map of the system, z up; None while the system has none.
        orientation_rad: of a pair of beacons, counter-clockwise from x; None without one.
    """

    address: int
    stamp_ms: int
    bits: int
    age_ms: int
    position_m: Vec3 | None
    orientation_rad: float | None


@frozen
class StationaryPositions:
    """The positions of the stationary beacons, by address, in m."""

    positions_m: dict[int, Vec3]


@frozen
class Rating:
    """The system's confidence in a beacon's newest position, in percent."""

    address: int
    percent: int


@frozen
class Power:
    """Battery and radio of the beacon that is connected."""

    battery_v: float
    rssi_dbm: int


@frozen
class Other:
    """A whole frame of no use here."""

    code: int


Packet = MobilePosition | StationaryPositions | Rating | Power | Other


@dataclass(slots=True)
class FrameCounters:
    """
    Attributes:
        skipped: bytes that were no part of a whole frame.
        damaged: beginnings of a frame whose checksum did not hold.
        frames: whole ones, by code.
    """

    skipped: int = 0
    damaged: int = 0
    frames: dict[int, int] = field(default_factory=dict[int, int])


class BeaconFramer:
    """Cuts a stream into packets. What looks like a frame and is none costs one byte, and no true
    frame behind it.
    """

    def __init__(self) -> None:
        self._waiting = bytearray()
        self.counters = FrameCounters()

    def feed(self, data: bytes) -> list[Packet]:
        """Take bytes as they come; the packets that are complete with them, in order."""
        waiting = self._waiting
        counters = self.counters
        waiting += data
        packets: list[Packet] = []
        begin = 0
        while (found := waiting.find(DESTINATION, begin)) >= 0:
            counters.skipped += found - begin
            begin = found
            size = _frame_size(waiting, begin)
            if size is None or (size > 0 and len(waiting) < begin + size):
                break  # the rest of it is still to come
            frame = bytes(waiting[begin : begin + size])
            if size > 0 and crc16(frame[:-CRC_BYTES]) == int.from_bytes(
                frame[-CRC_BYTES:], "little"
            ):
                packet, code = _decoded(frame)
                packets.append(packet)
                counters.frames[code] = counters.frames.get(code, 0) + 1
                begin += size
                continue
            counters.damaged += size > 0
            counters.skipped += 1
            begin += 1
        if found < 0:
            counters.skipped += len(waiting) - begin
            begin = len(waiting)
        del waiting[:begin]
        return packets

    def cut(self) -> None:
        """Drop what waits: the bytes that follow do not continue it."""
        self.counters.skipped += len(self._waiting)
        self._waiting.clear()


def _frame_size(waiting: bytearray, begin: int) -> int | None:
    """Bytes of the whole frame that begins here; 0 when none can, None when too little has come to
    tell.
    """
    if len(waiting) > begin + 1 and waiting[begin + 1] not in (STREAM, USER):
        return 0
    if len(waiting) < begin + HEADER.size:
        return None
    _, kind, code, length = HEADER.unpack_from(waiting, begin)
    if length not in LENGTHS.get((kind, code), ()):
        return 0
    return HEADER.size + length + CRC_BYTES


def _decoded(frame: bytes) -> tuple[Packet, int]:
    """A packet and its code, of a frame whose checksum holds."""
    _, kind, code, length = HEADER.unpack_from(frame)
    body = frame[HEADER.size : HEADER.size + length]
    packet: Packet = Other(code)
    if kind == STREAM and code in DECODERS:
        packet = DECODERS[code](body) or packet
    return packet, code


def _position(
    layout: str,
    unit_m: float,
    stamp_bits: int,
    body: bytes,
) -> MobilePosition:
    stamp_ms, x, y, z, flags, address, angle, age_ms = struct.unpack_from(layout, body)
    position_m = None if flags & UNAVAILABLE else (unit_m * x, unit_m * y, unit_m * z)
    orientation_rad = None if angle & NO_ANGLE else math.radians(0.1 * (angle & ANGLE_MASK))
    return MobilePosition(address, stamp_ms, stamp_bits, age_ms, position_m, orientation_rad)


def _stationary(
    layout: str,
    unit_m: float,
    body: bytes,
) -> StationaryPositions | None:
    each = struct.calcsize(layout)
    if len(body) != 1 + body[0] * each:
        return None
    found = (struct.unpack_from(layout, body, 1 + k * each) for k in range(body[0]))
    return StationaryPositions(
        {address: (unit_m * x, unit_m * y, unit_m * z) for address, x, y, z in found}
    )


def _rating(body: bytes) -> Rating:
    return Rating(body[0], min(body[1], 100))


def _power(body: bytes) -> Power:
    millivolt, rssi_dbm = struct.unpack_from("<Hb", body)
    return Power(1e-3 * millivolt, rssi_dbm)


DECODERS: dict[int, Callable[[bytes], Packet | None]] = {
    POSITION_CM: partial(_position, "<IhhhBBHH", 0.01, 32),
    POSITION_MM: partial(_position, "<IiiiBBHH", 1e-3, 32),
    POSITION_NT: partial(_position, "<QiiiBBHH", 1e-3, 64),
    STATIONARY_CM: partial(_stationary, "<Bhhhx", 0.01),
    STATIONARY_MM: partial(_stationary, "<Biiix", 1e-3),
    QUALITY: _rating,
    TELEMETRY: _power,
}
