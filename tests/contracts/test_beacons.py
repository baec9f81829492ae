"""The contract of every Beacons: a Marvelmind system on a serial port, and its records of both
kinds.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Generator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from drivers.beacons.marvelmind import Marvelmind, MarvelmindConfig
from drivers.beacons.record import BeaconRecorder, RecordedBeacons, RecordedBeaconsConfig
from drivers.interfaces import BeaconError, BeaconFix, Beacons
from hil.beacons import marvelmind_bytes as sent
from hil.beacons.pty import SerialCable
from path.messages import Role
from tests.drivers.beacons.beacon_log import write_beacons
from tests.drivers.link.link_ends import Context, WallClock, run

CONTEXT: Any = Context(Role.SENDER, WallClock())
MS = 1_000_000
POSITIONS = [(0.1 * k, -0.2 * k, 1.0) for k in range(1, 6)]
GARBAGE = (b"\xff\x47\x11\x00\x16", bytes(range(200)), b"\xff" * 80)
FRAMES = [sent.position(100 * k, 5, position, 0) for k, position in enumerate(POSITIONS, 1)]


@dataclass
class Stage:
    """Beacons, closed; ``play`` has the five positions come, with garbage between them."""

    beacons: Beacons
    play: Callable[[], object]
    ends: bool  # a record does


@contextmanager
def live(folder: Path) -> Generator[Stage]:
    cable = SerialCable(folder / "hedge")
    cable.plug()

    def play() -> None:
        for k, frame in enumerate(FRAMES):
            cable.send(GARBAGE[k % len(GARBAGE)] + frame)

    try:
        yield Stage(Marvelmind(MarvelmindConfig((str(cable.link),)), CONTEXT), play, ends=False)
    finally:
        cable.unplug()


@contextmanager
def recorded(folder: Path) -> Generator[Stage]:
    file = folder / "beacons.mcap"
    recorder = BeaconRecorder(file, 0.0)
    for k, frame in enumerate(FRAMES, 1):
        recorder.write("p", 10**12 + k * 100 * MS, GARBAGE[k % len(GARBAGE)] + frame)
    recorder.close()
    yield Stage(RecordedBeacons(RecordedBeaconsConfig(file), CONTEXT), lambda: None, ends=True)


@contextmanager
def table(folder: Path) -> Generator[Stage]:
    file = folder / "beacons.csv"
    write_beacons(
        file, [BeaconFix(100 * k * MS, 5, position) for k, position in enumerate(POSITIONS, 1)]
    )
    yield Stage(RecordedBeacons(RecordedBeaconsConfig(file), CONTEXT), lambda: None, ends=True)


BEACONS = pytest.mark.parametrize("stage_of", [live, recorded, table])
StageOf = Callable[[Path], contextlib.AbstractContextManager[Stage]]


def on(stage: contextlib.AbstractContextManager[Stage], test: Callable[[Stage], Any]) -> None:
    async def main() -> None:
        with stage as staged:
            await test(staged)

    run(main())


@BEACONS
def test_positions_come_each_once_in_their_order_whatever_is_between_them(
    stage_of: StageOf, tmp_path: Path
) -> None:
    async def test(stage: Stage) -> None:
        async with stage.beacons as beacons:
            stage.play()
            fixes = [fix for _ in POSITIONS if (fix := await beacons.read(60.0)) is not None]
            for fix, position in zip(fixes, POSITIONS, strict=True):
                assert fix.position_m == pytest.approx(position, abs=1e-3)
                assert fix.address == 5
            assert all(
                later.stamp_ns - earlier.stamp_ns == 100 * MS for earlier, later in pairwise(fixes)
            )

    on(stage_of(tmp_path), test)


@BEACONS
def test_after_the_last_a_record_ends_and_a_system_that_is_silent_is_an_error_in_time(
    stage_of: StageOf, tmp_path: Path
) -> None:
    async def test(stage: Stage) -> None:
        async with stage.beacons as beacons:
            stage.play()
            for _ in POSITIONS:
                await beacons.read(60.0)
            if stage.ends:
                assert await beacons.read(0.1) is None
                assert await beacons.read(0.1) is None
                return
            start_s = asyncio.get_running_loop().time()
            with pytest.raises(BeaconError, match="no position from the beacons") as caught:
                await beacons.read(0.1)
            assert asyncio.get_running_loop().time() - start_s < 20.0
            assert caught.value.remedy

    on(stage_of(tmp_path), test)


@BEACONS
def test_what_is_not_open_is_not_read(stage_of: StageOf, tmp_path: Path) -> None:
    async def test(stage: Stage) -> None:
        async def refused() -> None:
            with pytest.raises(BeaconError, match="not open") as caught:
                await stage.beacons.read(60.0)
            assert caught.value.remedy

        await refused()
        async with stage.beacons:
            pass
        await refused()
        await stage.beacons.__aexit__(None, None, None)

    on(stage_of(tmp_path), test)


@BEACONS
def test_opened_again_it_begins_anew(stage_of: StageOf, tmp_path: Path) -> None:
    async def test(stage: Stage) -> None:
        async with stage.beacons as beacons:
            stage.play()
            first = await beacons.read(60.0)
            await asyncio.sleep(0.05)  # the others have come too, and nobody reads them
        async with stage.beacons as beacons:
            if stage.ends:
                # NaN where there is no quality
                assert repr(await beacons.read(60.0)) == repr(first)
                return
            with pytest.raises(BeaconError):  # not what came before it was closed
                await beacons.read(0.1)

    on(stage_of(tmp_path), test)


@BEACONS
def test_closing_ends_a_wait(stage_of: StageOf, tmp_path: Path) -> None:
    async def test(stage: Stage) -> None:
        if stage.ends:
            pytest.skip("nobody waits for a record")
        async with stage.beacons as beacons:
            waiting = asyncio.create_task(beacons.read(600.0))
            await asyncio.sleep(0)
        with pytest.raises(BeaconError, match="not open"):
            async with asyncio.timeout(60.0):
                await waiting

    on(stage_of(tmp_path), test)
