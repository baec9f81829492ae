"""The test of the beacons through pyserial on a pseudo terminal: heard, missing, silent, not on
this computer.
"""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from drivers.beacons.marvelmind import Marvelmind, MarvelmindConfig
from drivers.interfaces import BeaconFix
from drivers.rig.part_check import Finding
from hil.beacons import marvelmind_bytes as sent
from hil.beacons.pty import SerialCable
from missions.field.doctor import beacons as doctor_beacons
from missions.field.doctor.beacons import BeaconReadings, check_beacons, judged
from path.messages import Role
from tests.drivers.link.link_ends import Context, WallClock
from tests.missions.field.doctor.doctor_findings import found
from tests.repeating import repeating

CONTEXT: Any = Context(Role.SENDER, WallClock())
WANTED = {"sender": 5, "receiver": 6}


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, seconds in (("FIRST_S", 30.0), ("SAMPLE_S", 0.5)):
        monkeypatch.setattr(doctor_beacons, name, seconds)


@contextmanager
def streaming(cable: SerialCable, addresses: tuple[int, ...], quality: int) -> Generator[None]:
    stamps_ms = itertools.count(1050, 50)

    def send() -> None:
        stamp_ms = next(stamps_ms)
        for address in addresses:
            cable.send(
                sent.quality(address, quality)
                + sent.position(stamp_ms, address, (1.0, 2.0, 3.0), 40)
            )
        cable.send(sent.telemetry(3.9, -60))

    with repeating(send, 0.05):
        yield


def looked_at(tmp_path: Path, addresses: tuple[int, ...], quality: int = 90) -> dict[str, Finding]:
    cable = SerialCable(tmp_path / "hedge")
    cable.plug()
    try:
        with streaming(cable, addresses, quality):
            beacons = Marvelmind(MarvelmindConfig((str(cable.link),)), CONTEXT)
            return found(check_beacons(beacons, WANTED, CONTEXT.clock))
    finally:
        cable.unplug()


def test_beacons_that_are_well_have_their_rate_quality_and_battery(tmp_path: Path) -> None:
    every = looked_at(tmp_path, (5, 6))
    assert {finding.state for finding in every.values()} == {"ok"}, every
    assert "quality 90 of 100" in every["sender"].detail
    assert "battery 3.90 V, radio -60 dBm" in every["port"].detail
    assert "ms old" in every["age"].detail


def test_one_that_is_missing_poor_or_a_stranger_is_told(tmp_path: Path) -> None:
    every = looked_at(tmp_path, (5, 9), quality=20)
    assert every["receiver"].state == "fault"
    assert "beacon 6" in every["receiver"].detail
    assert every["sender"].state == "note"
    assert every["others"].detail.endswith(": 9")


def test_silence_is_a_fault_and_a_port_that_is_not_here_a_note(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(doctor_beacons, "FIRST_S", 1.0)
    every = looked_at(tmp_path, ())
    assert every[""].state == "fault"
    assert "streams, but no positions" in every[""].detail
    absent = Marvelmind(MarvelmindConfig((str(tmp_path / "absent"),)), CONTEXT)
    every = found(check_beacons(absent, WANTED, CONTEXT.clock))
    assert every[""].state == "note"
    assert "cannot be opened here" in every[""].detail


def test_rare_positions_are_a_note() -> None:
    fixes = tuple(BeaconFix(k, 5, (0.0, 0.0, 0.0), math.nan, time.monotonic_ns()) for k in range(3))
    assert next(judged(BeaconReadings(fixes, (0.1,) * 3, 3.0), {"sender": 5})).state == "note"
    assert next(judged(BeaconReadings(fixes, (0.1,) * 3, 1.0), {"sender": 5})).state == "ok"
