"""The emulated beacons heard by the vendor's own program, marvelmind.py: what it reads from our
serial port.

It is on no package index and not part of this repository. ``PATH_MARVELMIND`` names its file
(docs/beacons.md); without it the frames are still held to the layouts that it unpacks.
"""

from __future__ import annotations

import importlib.util
import math
import os
import struct
import time
import warnings
from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from drivers.beacons.frames import (
    DISTANCES,
    IMU_FUSION,
    IMU_RAW,
    LENGTHS,
    STREAM,
    BeaconFramer,
    Other,
)
from drivers.beacons.stream import MarvelmindStream
from hil.beacons import marvelmind_bytes as sent
from hil.beacons.noise import BeaconConfig
from hil.beacons.pty import SerialCable
from hil.beacons.system import STATIONARY_M, BeaconSystem
from path.messages import Vec3
from tests.drivers.beacons import marvelmind_packets as packets

READER = os.environ.get("PATH_MARVELMIND", "")
ADDRESSES = {"sender": 5, "receiver": 6, "target": 7}
PLACES: dict[str, Vec3] = {
    "sender": (0.0, 0.0, 1.5),
    "receiver": (1.0, -2.0, 1.0),
    "target": (4.0, 3.0, 0.2),
}
TURNS = 60
STAMP_MS, LONG_STAMP_MS = 70_000, 1_763_898_305_120
RANGES_M = {3: 4.567, 4: 12.003}
READINGS = struct.pack("<9h", *range(-400, 500, 100))
NINE = list(range(-400, 500, 100))
PLACE: Vec3 = (1.234, -5.678, 0.9)
VELOCITY: Vec3 = (0.5, -0.25, 0.0)
FOUR_RANGES = [3, 4.567, 4, 12.003, 0, 0.0, 0, 0.0]
FUSED = [*PLACE, 1.0, 0.0, 0.0, 0.0, *VELOCITY, 0.0, 0.0, 0.0]

needs_reader = pytest.mark.skipif(
    not READER, reason="PATH_MARVELMIND names no marvelmind.py of the vendor's (docs/beacons.md)"
)


@contextmanager
def reading(folder: Path) -> Generator[SimpleNamespace]:
    """The vendor's reader in its own thread on a port of ours, and all that it has read, by
    kind.
    """
    spec = importlib.util.spec_from_file_location("vendors_marvelmind", READER)
    assert spec is not None and spec.loader is not None, f"{READER} is no Python file"
    vendors = importlib.util.module_from_spec(spec)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # `is not ''` is its own
        spec.loader.exec_module(vendors)
    cable, seen = (
        SerialCable(folder / "hedge"),
        SimpleNamespace(positions=[], raw=[], fused=[], distances=[]),
    )
    cable.plug()
    hedge: Any = vendors.MarvelmindHedge(tty=str(cable.link), baud=115200)
    hedge.recieveUltrasoundPositionCallback = lambda: seen.positions.append(hedge.position())
    hedge.recieveImuRawDataCallback = lambda: seen.raw.append(hedge.raw_imu())
    hedge.recieveImuDataCallback = lambda: seen.fused.append(hedge.imu_fusion())
    hedge.recieveUltrasoundRawDataCallback = lambda: seen.distances.append(hedge.distances())
    hedge.daemon = True
    hedge.start()

    def send(data: bytes) -> None:
        cable.send(data + b"\0")  # it looks at a byte when the next has come

    seen.hedge, seen.send = hedge, send
    try:
        until(lambda: hedge.serialPort is not None and hedge.serialPort.is_open)
        yield seen
    finally:
        hedge.terminationRequired = True
        cable.send(b"\0\0")
        hedge.join(10.0)
        cable.unplug()


def until(holds: Callable[[], object], seconds: float = 30.0) -> None:
    end_s = time.monotonic() + seconds
    while not holds():
        assert time.monotonic() < end_s, "the reader did not read it"
        time.sleep(0.002)


@needs_reader
def test_the_vendors_reader_has_the_positions_that_our_driver_has(tmp_path: Path) -> None:
    system, stream = BeaconSystem(BeaconConfig(damage_rate=0.0), 4, ADDRESSES), MarvelmindStream()
    ours = list[tuple[int, Vec3, int]]()

    def all_read() -> bool:
        return len(seen.positions) >= len(ours) and len(seen.distances) >= len(ours)

    with reading(tmp_path) as seen:
        for _, (time_s, name) in zip(range(TURNS), system.turns(0.0), strict=False):
            chunk = system.hear(name, time_s, np.array(PLACES[name]))
            fixes = stream.feed("p", round(1e9 * chunk.arrives_s), chunk.data)
            ours += [(fix.address, fix.position_m, fix.stamp_ns // 1_000_000) for fix in fixes]
            seen.send(chunk.data)
            until(all_read)
        until(lambda: len(seen.raw) >= TURNS)
        theirs = [
            (address, (x, y, z), stamp_ms) for address, x, y, z, _, stamp_ms, _ in seen.positions
        ]
        assert seen.hedge.telemetry()[0] == 3900
        assert seen.hedge.quality()[0] in ADDRESSES.values()
    assert len(ours) > 0.8 * TURNS
    for theirs_is, ours_is in zip(theirs, ours, strict=True):
        assert (theirs_is[0], theirs_is[2]) == (ours_is[0], ours_is[2])
        assert theirs_is[1] == pytest.approx(ours_is[1], abs=1e-9)
    for (address, place, _), (beacon, *pairs, _, _) in zip(ours, seen.distances, strict=True):
        assert beacon == address
        for stationary, metres in zip(pairs[::2], pairs[1::2], strict=True):
            assert metres == pytest.approx(math.dist(place, STATIONARY_M[stationary]), abs=2e-3)


@needs_reader
@pytest.mark.parametrize(
    ("frame", "kind", "expected"),
    [
        (
            packets.position_cm(STAMP_MS, 5, PLACE),
            "positions",
            [5, 1.23, -5.68, 0.9, 0, STAMP_MS, False],
        ),
        (
            packets.position_nt(LONG_STAMP_MS, 5, PLACE),
            "positions",
            [5, *PLACE, 0, LONG_STAMP_MS, True],
        ),
        (sent.imu(STAMP_MS, READINGS), "raw", [*NINE, STAMP_MS, False]),
        (packets.imu_nt(LONG_STAMP_MS, READINGS), "raw", [*NINE, LONG_STAMP_MS, True]),
        (packets.imu_fusion(STAMP_MS, PLACE, VELOCITY), "fused", [*FUSED, STAMP_MS, False]),
        (
            packets.imu_fusion_nt(LONG_STAMP_MS, PLACE, VELOCITY),
            "fused",
            [*FUSED, LONG_STAMP_MS, True],
        ),
        (sent.distances(STAMP_MS, 5, RANGES_M), "distances", [5, *FOUR_RANGES, STAMP_MS, False]),
        (
            packets.distances_nt(LONG_STAMP_MS, 5, RANGES_M),
            "distances",
            [5, *FOUR_RANGES, LONG_STAMP_MS, True],
        ),
    ],
    ids=["0001", "0081", "0003", "0083", "0005", "0085", "0004", "0084"],
)
def test_every_frame_is_what_the_vendors_reader_takes_it_for(
    tmp_path: Path, frame: bytes, kind: str, expected: Sequence[float]
) -> None:
    with reading(tmp_path) as seen:
        seen.send(frame)
        until(lambda: getattr(seen, kind))
        assert getattr(seen, kind) == [pytest.approx(expected)]


@pytest.mark.parametrize(
    ("frame", "layout", "expected"),
    [
        (sent.imu(STAMP_MS, READINGS), "<9h6xL4x", [*NINE, STAMP_MS]),
        (packets.imu_nt(LONG_STAMP_MS, READINGS), "<9h6xq4x", [*NINE, LONG_STAMP_MS]),
        (sent.distances(STAMP_MS, 5, RANGES_M), "<BBlxBlxBlxBlxL3x", [5, 3, 4567, 4, 12003, 0, 0, 0, 0, STAMP_MS]),
        (packets.distances_nt(1, 5, RANGES_M), "<BBlxBlxBlxBlxq3x", [5, 3, 4567, 4, 12003, 0, 0, 0, 0, 1]),
        (packets.imu_fusion(9, PLACE, VELOCITY), "<3l10h2xL4x",
         [1234, -5678, 900, 10_000, 0, 0, 0, 500, -250, 0, 0, 0, 0, 9]),
        (packets.imu_fusion_nt(9, PLACE, VELOCITY), "<3l10h2xq4x",
         [1234, -5678, 900, 10_000, 0, 0, 0, 500, -250, 0, 0, 0, 0, 9]),
    ],
    ids=["0003", "0083", "0004", "0084", "0005", "0085"],
)  # fmt: skip
def test_inertial_and_distance_frames_are_laid_out_as_documented_and_passed_over_by_the_driver(
    frame: bytes, layout: str, expected: Sequence[float]
) -> None:
    assert list(struct.unpack(layout, frame[5:-2])) == list(expected)
    code = int.from_bytes(frame[2:4], "little")
    assert len(frame) - 7 in LENGTHS[STREAM, code]
    assert BeaconFramer().feed(frame) == [Other(code)]


def test_the_made_up_system_sends_distances_and_readings_with_its_positions() -> None:
    system, framer = BeaconSystem(BeaconConfig(damage_rate=0.0), 4, ADDRESSES), BeaconFramer()
    for _, (time_s, name) in zip(range(TURNS), system.turns(0.0), strict=False):
        framer.feed(system.hear(name, time_s, np.array(PLACES[name])).data)
    frames = framer.counters.frames
    assert frames[IMU_RAW] == TURNS
    assert frames[DISTANCES] == frames[0x0011] > 0.8 * TURNS
    assert IMU_FUSION not in frames  # sent by beacons that were told to; see docs/beacons.md
    assert framer.counters.skipped == framer.counters.damaged == 0
