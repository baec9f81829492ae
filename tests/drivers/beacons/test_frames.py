"""Marvelmind's frames: read as documented, and found again in noise."""

from __future__ import annotations

import math
import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.beacons.frames import (
    BeaconFramer,
    MobilePosition,
    Other,
    Packet,
    Power,
    Rating,
    StationaryPositions,
    crc16,
)
from hil.beacons import marvelmind_bytes as sent
from tests.drivers.beacons import marvelmind_packets as packets

PLACE = (1.234, -5.678, 0.9)
FRAME = sent.position(123_456, 7, PLACE, 61)
PACKET = MobilePosition(7, 123_456, 32, 61, PLACE, None)


def read(data: bytes) -> list[Packet]:
    return BeaconFramer().feed(data)


def test_the_checksum_is_modbus() -> None:
    assert crc16(b"123456789") == 0x4B37


def test_a_frame_written_down_by_hand_is_read() -> None:
    """Byte by byte as in the document: beacon 5 at (1, -2, 0.5) m, 1000 ms, 20 ms old, pair turned
    by 90 degrees.
    """
    body = "e8030000" + "e8030000" + "30f8ffff" + "f4010000" + "02" + "05" + "8403" + "1400"
    told = bytes.fromhex("ff47110016" + body)
    (packet,) = read(told + struct.pack("<H", crc16(told)))
    assert isinstance(packet, MobilePosition)
    assert (packet.address, packet.stamp_ms, packet.age_ms) == (5, 1000, 20)
    assert packet.position_m == pytest.approx((1.0, -2.0, 0.5))
    assert packet.orientation_rad == pytest.approx(math.pi / 2.0)


def test_every_kind_is_read() -> None:
    assert read(FRAME)[0] == PACKET
    (coarse,) = read(packets.position_cm(9, 7, PLACE, 3))
    assert isinstance(coarse, MobilePosition)
    assert coarse.position_m == pytest.approx(PLACE, abs=0.0051)
    (precise,) = read(packets.position_nt(1 << 40, 7, PLACE))
    assert isinstance(precise, MobilePosition)
    assert (precise.stamp_ms, precise.bits) == (1 << 40, 64)
    assert read(sent.quality(7, 93)) == [Rating(7, 93)]
    assert read(sent.telemetry(3.9, -61)) == [Power(3.9, -61)]
    (fixed,) = read(sent.stationary({1: (0.0, 0.0, 2.0), 2: (4.0, -0.5, 2.1)}))
    assert isinstance(fixed, StationaryPositions)
    assert fixed.positions_m[2] == pytest.approx((4.0, -0.5, 2.1))
    assert read(sent.imu(5, bytes(range(18)))) == [Other(3)]
    (lost,) = read(sent.position(1, 7, None, 0))
    assert isinstance(lost, MobilePosition)
    assert lost.position_m is None


def test_a_longer_frame_of_newer_firmware_is_read() -> None:
    body = FRAME[5:-2] + b"\x01" + struct.pack("<hhh", 100, 0, -100)
    assert read(sent.frame(0x0011, body)) == [PACKET]


def test_inertial_frames_hide_nothing_that_looks_like_a_frame() -> None:
    """Readings may be the very bytes of a position."""
    assert read(sent.imu(5, FRAME[:18]) + FRAME) == [Other(3), PACKET]


@pytest.mark.parametrize("cut", range(1, len(FRAME)))
def test_a_cut_frame_costs_no_other(cut: int) -> None:
    framer = BeaconFramer()
    assert framer.feed(FRAME[:cut] + FRAME + FRAME) == [PACKET, PACKET]
    assert framer.counters.skipped == cut


@pytest.mark.parametrize("bit", range(0, 8 * len(FRAME), 7))
def test_a_wrong_bit_never_passes(bit: int) -> None:
    wrong = bytearray(FRAME)
    wrong[bit // 8] ^= 1 << bit % 8
    assert [packet for packet in read(bytes(wrong) + FRAME * 10) if packet != PACKET] == []


@settings(max_examples=60)
@given(st.lists(st.binary(max_size=60), max_size=4), st.integers(1, 40))
def test_frames_are_found_in_any_noise_however_the_bytes_come(
    noise: list[bytes], size: int
) -> None:
    """Noise can cost no more than the wait for the end of a frame that it seemed to begin: under
    262 bytes.
    """
    stream = b"".join(each + FRAME for each in noise) + FRAME * 10
    framer = BeaconFramer()
    found = [
        packet for k in range(0, len(stream), size) for packet in framer.feed(stream[k : k + size])
    ]
    assert found == [PACKET] * (len(noise) + 10)
