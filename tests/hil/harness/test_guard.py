"""The guard in virtual time: a killed program's vehicle comes down although the autopilot would fly
on.
"""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from drivers.interfaces import PartError
from drivers.log.mcap_log import read_log
from drivers.mavlink.guard.interfaces import Beat, Script
from hil.harness.guard import MemoryBeatLine
from missions.fly.handoff.flight import fly_once
from missions.ground import rig_library


class StillClock:
    def now_ns(self) -> int:
        return 7


def decisions(out: Path, role: str) -> list[tuple[float, str, str]]:
    records = [r for r in read_log(out / f"{role}.guard.mcap") if r.topic == "/guard"]
    return [(r.stamp_ns * 1e-9, r.record["stage"], r.record["act"]) for r in records]


def test_a_killed_program_s_vehicle_is_held_and_landed_by_its_guard(tmp_path: Path) -> None:
    rig = rig_library.load("sim")
    shown = list[str]()
    facts = fly_once(
        rig, 3, ("no_failsafe", "kill_sender@acquire+1"), tmp_path, lambda p: shown.append(p.phase)
    )
    assert facts.outcome == "crashed"
    assert facts.violations == {}
    assert "acquire" in shown
    stages = decisions(tmp_path, "sender")
    assert [(stage, act) for _, stage, act in stages] == [
        ("holding", "hold"),
        ("landing", "land"),
        ("watching", "nothing"),
    ]
    world = list(read_log(tmp_path / "world.mcap"))
    (killed_s,) = (
        r.stamp_ns * 1e-9
        for r in world
        if r.topic == "/fault" and r.record["fault"] == "kill_sender"
    )
    modes = [
        (r.stamp_ns * 1e-9, r.record["mode"], r.record["armed"])
        for r in world
        if r.topic == "/autopilot" and r.record["role"] == "sender" and r.stamp_ns * 1e-9 > killed_s
    ]
    assert [mode for _, mode, _ in modes] == ["hold", "land", "hold"]
    assert modes[0][0] - killed_s < 0.6
    assert not modes[-1][2]
    assert [stage for _, stage, _ in decisions(tmp_path, "receiver")] in (
        [],
        ["landing", "watching"],
    )


@pytest.mark.parametrize("fault", ["stop_sender", "stop_receiver", "guard_death"])
def test_what_needs_a_process_is_refused(tmp_path: Path, fault: str) -> None:
    with pytest.raises(PartError, match="programs of their own"):
        fly_once(rig_library.load("sim"), 1, (fault,), tmp_path, lambda _: None)


def test_of_a_dead_program_nothing_reaches_the_guard() -> None:
    async def main() -> None:
        line = MemoryBeatLine(StillClock())
        async with line.role_end() as first:
            first.beat(Beat(Script.CONTROL, 1))
            newest = line.newest()
            assert newest is not None and newest[1].setpoints == 1
            line.cut()
            first.beat(Beat(Script.LET_GO, 2))
            assert line.newest() is None

    asyncio.run(main())
