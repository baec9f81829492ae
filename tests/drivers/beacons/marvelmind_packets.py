"""Packets of Marvelmind's document that the emulated beacons do not send: old ones, long stamps,
inertial fusion.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping

from hil.beacons.marvelmind_bytes import ANOTHER, NO_ANGLE, frame, ranges
from path.messages import Vec3


def position_cm(stamp_ms: int, address: int, place_m: Vec3, age_ms: int = 0) -> bytes:
    """Code 0x0001, of older firmware."""
    x, y, z = (round(1e2 * each) for each in place_m)
    return frame(
        0x0001, struct.pack("<IhhhBBHH", stamp_ms, x, y, z, ANOTHER, address, NO_ANGLE, age_ms)
    )


def position_nt(stamp_ms: int, address: int, place_m: Vec3, age_ms: int = 0) -> bytes:
    """Code 0x0081, with a stamp of 64 bits."""
    x, y, z = (round(1e3 * each) for each in place_m)
    return frame(
        0x0081, struct.pack("<QiiiBBHH", stamp_ms, x, y, z, ANOTHER, address, NO_ANGLE, age_ms)
    )


def imu_nt(stamp_ms: int, readings: bytes) -> bytes:
    """Code 0x0083: code 0x0003 with a stamp of 64 bits."""
    return frame(0x0083, readings[:18] + bytes(6) + struct.pack("<Q4x", stamp_ms))


def distances_nt(stamp_ms: int, address: int, ranges_m: Mapping[int, float]) -> bytes:
    """Code 0x0084: code 0x0004 with a stamp of 64 bits."""
    return frame(0x0084, ranges(address, ranges_m) + struct.pack("<Q3x", stamp_ms))


def imu_fusion(stamp_ms: int, place_m: Vec3, velocity_mps: Vec3) -> bytes:
    """Code 0x0005, of a beacon that is level and does not turn: position, quaternion, velocity and
    no acceleration.
    """
    return frame(0x0005, _fused(place_m, velocity_mps) + struct.pack("<I4x", stamp_ms % (1 << 32)))


def imu_fusion_nt(stamp_ms: int, place_m: Vec3, velocity_mps: Vec3) -> bytes:
    """Code 0x0085: ``imu_fusion`` with a stamp of 64 bits."""
    return frame(0x0085, _fused(place_m, velocity_mps) + struct.pack("<Q4x", stamp_ms))


def _fused(place_m: Vec3, velocity_mps: Vec3) -> bytes:
    place, velocity = ([round(1e3 * each) for each in vector] for vector in (place_m, velocity_mps))
    return struct.pack("<3i4h3h3h2x", *place, 10_000, 0, 0, 0, *velocity, 0, 0, 0)
