"""The bytes that Marvelmind's beacons send, written from the document, independent of the driver that reads them."""

from __future__ import annotations

import struct
from collections.abc import Mapping

from path.messages import Vec3

UNAVAILABLE, ANOTHER, NO_ANGLE = 0x01, 0x40, 0x2000  # another: not the beacon that is connected


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


def position(stamp_ms: int, address: int, place_m: Vec3 | None, age_ms: int, flags: int = ANOTHER) -> bytes:
    """Code 0x0011, mm. Without a place the system has lost the beacon."""
    x, y, z = (round(1e3 * each) for each in place_m or (0.0, 0.0, 0.0))
    flags |= 0 if place_m is not None else UNAVAILABLE
    told = struct.pack("<IiiiBBHH", stamp_ms % (1 << 32), x, y, z, flags, address, NO_ANGLE, age_ms)
    return frame(0x0011, told)


def position_cm(stamp_ms: int, address: int, place_m: Vec3, age_ms: int = 0) -> bytes:
    """Code 0x0001, of older firmware."""
    x, y, z = (round(1e2 * each) for each in place_m)
    return frame(0x0001, struct.pack("<IhhhBBHH", stamp_ms, x, y, z, ANOTHER, address, NO_ANGLE, age_ms))


def position_nt(stamp_ms: int, address: int, place_m: Vec3, age_ms: int = 0) -> bytes:
    """Code 0x0081, with a stamp of 64 bits."""
    x, y, z = (round(1e3 * each) for each in place_m)
    return frame(0x0081, struct.pack("<QiiiBBHH", stamp_ms, x, y, z, ANOTHER, address, NO_ANGLE, age_ms))


def quality(address: int, percent: int) -> bytes:
    return frame(0x0007, bytes((address, percent)) + bytes(14))


def telemetry(battery_v: float, rssi_dbm: int) -> bytes:
    return frame(0x0006, struct.pack("<Hb13x", round(1e3 * battery_v), rssi_dbm))


def imu(stamp_ms: int, readings: bytes) -> bytes:
    """Code 0x0003: nine raw readings of two bytes each."""
    return frame(0x0003, readings[:18] + bytes(6) + struct.pack("<I4x", stamp_ms % (1 << 32)))


def imu_nt(stamp_ms: int, readings: bytes) -> bytes:
    """Code 0x0083: ``imu`` with a stamp of 64 bits."""
    return frame(0x0083, readings[:18] + bytes(6) + struct.pack("<Q4x", stamp_ms))


def distances(stamp_ms: int, address: int, ranges_m: Mapping[int, float]) -> bytes:
    """Code 0x0004: raw distances to at most four beacons; address 0 where there are fewer."""
    return frame(0x0004, _ranges(address, ranges_m) + struct.pack("<I3x", stamp_ms % (1 << 32)))


def distances_nt(stamp_ms: int, address: int, ranges_m: Mapping[int, float]) -> bytes:
    """Code 0x0084: ``distances`` with a stamp of 64 bits."""
    return frame(0x0084, _ranges(address, ranges_m) + struct.pack("<Q3x", stamp_ms))


def _ranges(address: int, ranges_m: Mapping[int, float]) -> bytes:
    told = [*((beacon, round(1e3 * each)) for beacon, each in ranges_m.items()), *4 * [(0, 0)]][:4]
    return bytes((address,)) + b"".join(struct.pack("<Bix", *each) for each in told)


def imu_fusion(stamp_ms: int, place_m: Vec3, velocity_mps: Vec3) -> bytes:
    """Code 0x0005, of a beacon that is level and does not turn: position, quaternion, velocity and no acceleration."""
    return frame(0x0005, _fused(place_m, velocity_mps) + struct.pack("<I4x", stamp_ms % (1 << 32)))


def imu_fusion_nt(stamp_ms: int, place_m: Vec3, velocity_mps: Vec3) -> bytes:
    """Code 0x0085: ``imu_fusion`` with a stamp of 64 bits."""
    return frame(0x0085, _fused(place_m, velocity_mps) + struct.pack("<Q4x", stamp_ms))


def _fused(place_m: Vec3, velocity_mps: Vec3) -> bytes:
    place, velocity = ([round(1e3 * each) for each in vector] for vector in (place_m, velocity_mps))
    return struct.pack("<3i4h3h3h2x", *place, 10_000, 0, 0, 0, *velocity, 0, 0, 0)


def stationary(places_m: Mapping[int, Vec3]) -> bytes:
    told = (struct.pack("<Biiix", address, *(round(1e3 * e) for e in place)) for address, place in places_m.items())
    return frame(0x0012, bytes((len(places_m),)) + b"".join(told))
