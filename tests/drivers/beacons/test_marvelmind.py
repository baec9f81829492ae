"""The beacons' driver on a pseudo terminal: stamps, noise, silence, a port that is unplugged; and
records.
"""

from __future__ import annotations

import asyncio
import math
import time
from pathlib import Path
from typing import Any

import pytest

from drivers.beacons.marvelmind import Marvelmind, MarvelmindConfig
from drivers.beacons.record import BeaconRecorder, read_any, replay
from drivers.beacons.stream import ClockMap, MarvelmindStream
from drivers.interfaces import BeaconError, BeaconFix
from hil.beacons import marvelmind_bytes as sent
from hil.beacons.pty import SerialCable
from path.messages import Role
from tests.drivers.beacons import marvelmind_packets as packets
from tests.drivers.beacons.beacon_log import write_beacons
from tests.drivers.link.link_ends import Context, WallClock, run

CONTEXT: Any = Context(Role.SENDER, WallClock())
MS = 1_000_000


def driver(*cables: SerialCable, **options: Any) -> Marvelmind:
    return Marvelmind(
        MarvelmindConfig(tuple(str(cable.link) for cable in cables), **options), CONTEXT
    )


def cable(tmp_path: Path, name: str = "hedge") -> SerialCable:
    made = SerialCable(tmp_path / name)
    made.plug()
    return made


async def refused(beacons: Marvelmind, said: str) -> BeaconError:
    """The error that says this, once all is read that was sent."""
    while True:
        with pytest.raises(BeaconError) as error:
            await beacons.read(0.1)
        if said in str(error.value):
            return error.value


def test_positions_come_with_quality_and_the_instant_of_their_ultrasound(tmp_path: Path) -> None:
    async def test() -> None:
        port = cable(tmp_path)
        async with driver(port) as beacons:
            before_ns = time.monotonic_ns()
            port.send(
                sent.quality(5, 88)
                + sent.imu(1, bytes(18))
                + sent.position(70_000, 5, (1.0, 2.0, 3.0), 60)
            )
            fix = await beacons.read(60.0)
            after_ns = time.monotonic_ns()
            assert (fix.address, fix.position_m, fix.quality, fix.stamp_ns) == (
                5,
                (1.0, 2.0, 3.0),
                88.0,
                70_000 * MS,
            )
            assert fix.host_ns is not None
            assert before_ns - 60 * MS <= fix.host_ns <= after_ns - 60 * MS
        port.unplug()

    run(test())


def test_several_beacons_on_one_port_and_on_ports_of_their_own(tmp_path: Path) -> None:
    async def test() -> None:
        one, other = cable(tmp_path, "one"), cable(tmp_path, "other")
        async with driver(one, other) as beacons:
            one.send(
                sent.position(10, 5, (0.0, 0.0, 1.0), 1) + sent.position(10, 6, (0.0, 0.0, 2.0), 1)
            )
            other.send(sent.position(999, 7, (0.0, 0.0, 3.0), 1))
            fixes = [await beacons.read(60.0) for _ in range(3)]
            assert {fix.address: fix.position_m[2] for fix in fixes} == {5: 1.0, 6: 2.0, 7: 3.0}
            assert all(math.isnan(fix.quality) for fix in fixes)
        one.unplug()
        other.unplug()

    run(test())


@pytest.mark.parametrize(
    ("data", "said"),
    [
        pytest.param(b"", "is silent", id="silence"),
        pytest.param(bytes(range(60)), "no whole frame", id="another protocol"),
        pytest.param(
            sent.position(1, 5, None, 0), "no position for its beacons", id="out of reach"
        ),
        pytest.param(sent.telemetry(3.9, -60), "streams, but no positions", id="no positions"),
    ],
)
def test_why_no_position_comes_is_said(tmp_path: Path, data: bytes, said: str) -> None:
    async def test() -> None:
        port = cable(tmp_path)
        async with driver(port) as beacons:
            port.send(data)
            error = await refused(beacons, said)
            assert "Dashboard" in error.remedy
        port.unplug()

    run(test())


def test_a_port_that_is_unplugged_comes_back_and_what_was_cut_is_dropped(tmp_path: Path) -> None:
    async def test() -> None:
        port = cable(tmp_path)
        async with driver(port) as beacons:
            frame = sent.position(1, 5, (0.0, 0.0, 1.0), 0)
            port.send(frame + sent.position(2, 5, (0.0, 0.0, 2.0), 0)[:20])
            assert (await beacons.read(60.0)).stamp_ns == MS
            port.unplug()
            await refused(beacons, "was unplugged")
            port.plug()
            waiting = asyncio.ensure_future(beacons.read(60.0))
            while not waiting.done():
                port.send(sent.position(3, 5, (0.0, 0.0, 3.0), 0))
                await asyncio.sleep(0.02)
            assert waiting.result().stamp_ns == 3 * MS
            assert beacons.stream.ports[str(port.link)].counters.damaged == 0
        port.unplug()

    run(test())


def test_a_port_that_stays_away_ends_reading_within_its_bound(tmp_path: Path) -> None:
    async def test() -> None:
        port = cable(tmp_path)
        async with driver(port, reopen_s=0.3) as beacons:
            port.unplug()
            with pytest.raises(BeaconError, match="is gone for"):
                await beacons.read(60.0)

    run(test(), within_s=30.0)


def test_a_port_that_cannot_be_opened_is_named(tmp_path: Path) -> None:
    async def test() -> None:
        with pytest.raises(BeaconError, match=r"serial port .*hedge") as error:
            await driver(SerialCable(tmp_path / "hedge")).__aenter__()
        assert "dialout" in error.value.remedy

    run(test())


@pytest.mark.parametrize(
    "options", [{"ports": ()}, {"ports": ("a", "a")}, {"ports": ("a",), "baud": 300}]
)
def test_settings_that_cannot_be_are_refused(options: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=r"ports|baud"):
        MarvelmindConfig(**options)


def test_late_frames_and_a_slow_wire_do_not_move_the_stamps() -> None:
    clock = ClockMap()
    offsets = [
        clock.add(k * 125 * MS, 5_000 * MS + k * 125 * MS + 60 * MS + way * MS, 60 * MS)
        for k, way in enumerate((2, 9, 150, 3))
    ]
    assert offsets == [5_002 * MS] * 4


def test_clocks_that_part_are_followed() -> None:
    """50 ppm, over five minutes: 15 ms."""
    clock = ClockMap()
    instants = [k * 125 * MS for k in range(2400)]
    last = [clock.add(t, t + t * 50 // 1_000_000, 0) for t in instants][-1]
    assert last == pytest.approx(instants[-1] * 50e-6, abs=1.0 * MS)


def test_a_beacon_that_begins_again_and_a_counter_that_wraps() -> None:
    stream = MarvelmindStream()

    def fed(stamp_ms: int, arrival_ms: int) -> BeaconFix:
        (fix,) = stream.feed("p", arrival_ms * MS, sent.position(stamp_ms, 5, (0.0, 0.0, 0.0), 1))
        return fix

    assert fed(3_000_000, 10_000).host_ns == 9_999 * MS
    assert fed(50, 20_000).host_ns == 19_999 * MS  # after a wake-up
    top = (1 << 32) - 100
    assert fed(top, 30_000).host_ns is not None
    assert fed(50, 30_150).stamp_ns == ((1 << 32) + 50) * MS


def test_age_that_a_frame_does_not_say_is_taken_from_the_rig() -> None:
    (fix,) = MarvelmindStream(latency_s=0.08).feed(
        "p", 1000 * MS, packets.position_cm(10, 5, (0.0, 0.0, 0.0))
    )
    assert fix.host_ns == 920 * MS


def recorded(file: Path) -> list[BeaconFix]:
    """A session with noise, a lost port and a repeated position; the positions as they came
    live.
    """
    stream, live = MarvelmindStream(), list[BeaconFix]()
    recorder = BeaconRecorder(file, 0.0)
    frames = [
        sent.quality(5, 90) + sent.position(100 * k, 5, (0.1 * k, 0.0, 1.0), 40)
        for k in range(1, 20)
    ]
    frames[5] = frames[5][:30]
    frames[8] = b"\xff\x47\x11\x00\x16" + frames[8]
    frames[12] += frames[12]
    for k, data in enumerate(frames):
        for piece in (data[:17], data[17:]) if k != 6 else (data[:20], b""):
            arrival_ns = 10**12 + k * 100 * MS
            recorder.write("p", arrival_ns, piece)
            live += stream.feed("p", arrival_ns, piece)
    recorder.close()
    return live


def test_a_record_gives_what_came_live(tmp_path: Path) -> None:
    live = recorded(tmp_path / "beacons.mcap")
    assert len(live) == 17
    assert repr(list(replay(tmp_path / "beacons.mcap"))) == repr(live)


@pytest.mark.parametrize("name", ["beacons.mcap", "beacons.csv"])
def test_a_record_and_a_list_of_positions_are_read_alike(tmp_path: Path, name: str) -> None:
    live = recorded(tmp_path / "beacons.mcap")
    write_beacons(tmp_path / "beacons.csv", live)
    assert [fix.stamp_ns for fix in read_any(tmp_path / name)] == [fix.stamp_ns for fix in live]


@pytest.mark.parametrize("content", [b"", b"no log", b"\x89MCAP0\r\n"])
def test_a_file_that_is_no_record_is_refused(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "beacons.mcap").write_bytes(content)
    with pytest.raises(BeaconError, match="no record of beacons"):
        list(replay(tmp_path / "beacons.mcap"))
