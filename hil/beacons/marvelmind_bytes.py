"""The bytes that Marvelmind's beacons send, written from the document, independent of the driver
that reads them.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping

from path.messages import Vec3

# another: not the beacon that is connected
UNAVAILABLE = 0x01
ANOTHER = 0x40
NO_ANGLE = 0x2000


def checksum(data: bytes) -> int:
    """CRC-16/MODBUS bit by bit."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0xA001 if crc & 1 else 0)
    return crc


def frame(code: int, body: bytes) -> bytes:
    told = bytes((0xFF, 0x47)) + code.to_bytes(2, "little") + bytes((len(body),)) + body
    return told + checksum(told).to_bytes(2, "little")


def position(
    stamp_ms: int,
    address: int,
    place_m: Vec3 | None,
    age_ms: int,
    flags: int = ANOTHER,
) -> bytes:
    """Code 0x0011, mm. Without a place the system has lost the beacon."""
    x, y, z = (round(1e3 * each) for each in place_m or (0.0, 0.0, 0.0))
    flags |= 0 if place_m is not None else UNAVAILABLE
    told = struct.pack("<IiiiBBHH", stamp_ms % (1 << 32), x, y, z, flags, address, NO_ANGLE, age_ms)
    return frame(0x0011, told)


def quality(address: int, percent: int) -> bytes:
    return frame(0x0007, bytes((address, percent)) + bytes(14))


def telemetry(battery_v: float, rssi_dbm: int) -> bytes:
    return frame(0x0006, struct.pack("<Hb13x", round(1e3 * battery_v), rssi_dbm))


def imu(stamp_ms: int, readings: bytes) -> bytes:
    """Code 0x0003: nine raw readings of two bytes each."""
    return frame(0x0003, readings[:18] + bytes(6) + struct.pack("<I4x", stamp_ms % (1 << 32)))


def distances(
    stamp_ms: int,
    address: int,
    ranges_m: Mapping[int, float],
) -> bytes:
    """Code 0x0004: raw distances to at most four beacons; address 0 where there are fewer."""
    return frame(0x0004, ranges(address, ranges_m) + struct.pack("<I3x", stamp_ms % (1 << 32)))


def ranges(address: int, ranges_m: Mapping[int, float]) -> bytes:
    """The part that packets of distances share."""
    told = [*((beacon, round(1e3 * each)) for beacon, each in ranges_m.items()), *4 * [(0, 0)]][:4]
    return bytes((address,)) + b"".join(struct.pack("<Bix", *each) for each in told)


def stationary(places_m: Mapping[int, Vec3]) -> bytes:
    told = (
        struct.pack("<Biiix", address, *(round(1e3 * e) for e in place))
        for address, place in places_m.items()
    )
    return frame(0x0012, bytes((len(places_m),)) + b"".join(told))
