"""The world and the parent of a relay in real time: what is judged, in which order, and what is
refused.
"""

from __future__ import annotations

import asyncio
import os
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from drivers.rig.parts import Rig, with_slow
from drivers.rig.tables import RigError
from flight.harness.flights import Progress
from flight.harness.relay import OFTEN, WATCHED, DroneProcesses, RelayRequest
from hil.autopilot.values import OffboardSession
from hil.harness.leg_faults import LegFaults
from hil.harness.realtime.children import end, spawn
from hil.harness.realtime.programs import RECORD
from hil.harness.realtime.relay_world import RelaySitlWorld, field_of
from hil.harness.realtime.run import Ending, RealTimeRun
from hil.harness.relay_sitl import RelaySitl, check_drones, orders_of, report_of
from hil.monitors.hindsight import Hindsight
from hil.world.faults import Fault, parse_fault
from missions.ground import rig_library
from path.messages import Role
from tests.doubles import NoLog


@pytest.fixture(scope="module")
def rig() -> Rig:
    return rig_library.load("relay-sitl")


class Judge:
    """In the place of the monitors."""

    seen: Any = None

    def __init__(self) -> None:
        self.judged: list[Any] = []

    def on_record(self, *about: Any) -> None:
        self.judged.append(about)

    def on_death(self, name: str) -> None:
        self.judged.append(name)


def test_what_is_told_of_late_is_judged_in_its_turn() -> None:
    judge: Any = Judge()
    hindsight = Hindsight(judge)
    hindsight.put(5.02, "on_record", "D2", "takes over")
    hindsight.put(5.01, "on_record", "D1", "lets go")
    hindsight.put(5.01, "on_death", "D1")
    hindsight.judge(5.0)
    assert judge.judged == []
    hindsight.judge(5.015)
    hindsight.judge(6.0)
    assert judge.judged == [("D1", "lets go"), "D1", ("D2", "takes over")]


def test_a_record_is_judged_by_the_truth_of_its_time() -> None:
    judge: Any = Judge()
    hindsight = Hindsight(judge)
    for k in range(1000):
        truth: Any = ({"at": k}, ())
        hindsight.remember(k * 0.02, truth)
    assert judge.seen(19.0)[0] == {"at": 950}
    assert len(hindsight._truth) < 250


def test_programs_that_take_their_frames_up_late_are_found_in_what_is_watched(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # so that it reaches the world, and is in no log
    assert "/frame" in WATCHED and "/frame" in OFTEN
    with Path(os.devnull).open() as nothing:
        monkeypatch.setattr(sys, "stdin", nothing)
        world = RelaySitlWorld(rig_library.load("team-sitl"), 0, "3", "2", "0.1")
    for number in range(60):
        for name, age_s in (("D1", 0.5), ("D2", 0.05)):
            world.record(
                name, "/frame", number, {"number": number, "age_ns": round(age_s * 1e9), "bytes": 1}
            )
    assert (
        world.findings()["overload"] == "D1's program: 60 of 60 frames were late, a tenth by 0.50 s"
    )


@pytest.mark.parametrize(("name", "explained"), [("D1", ["S8"]), ("D2", [])])
def test_a_gap_is_explained_by_what_its_own_drones_program_was_watched_to_say(
    monkeypatch: pytest.MonkeyPatch, name: str, explained: list[str]
) -> None:
    assert WATCHED["/late"] == 0.0 and "/late" in OFTEN
    with Path(os.devnull).open() as nothing:
        monkeypatch.setattr(sys, "stdin", nothing)
        world = RelaySitlWorld(rig_library.load("team-sitl"), 0, "3", "2", "0.1")
    session = OffboardSession(3.0)
    session.note_gap(12.0, 12.244)
    world._world.switch_on("D1")
    world._world.drone("D1").autopilot.offboard_sessions.append(session)
    late = {
        "since_ns": 230_000_000,
        "loop_ns": 190_000_000,
        "waited_ns": 180_000_000,
        "beside_ns": 0,
        "stolen_ns": 0,
        "disk_ns": 0,
    }
    world.record(name, "/late", 12_240_000_000, late)
    found = world.findings()
    assert (found["violations"], found["explained"]) == ({"S8": 1}, explained)
    assert ("D1's program had no core for 0.18 s" in found["overload"]) is bool(explained)
    (note,) = found["notes"]
    assert note.startswith("S8 at 12.00 s: D1: 0.244 s between setpoints, until 12.24 s; ")


def test_each_drone_is_its_own_on_the_wire(rig: Rig) -> None:
    config = field_of(rig, 3, 0)
    check_drones(rig, config)
    first, second, *_ = config.drones
    with pytest.raises(RigError, match="D2 needs a vehicle"):
        check_drones(rig, replace(config, drones=(first, replace(second, link=None))))
    assert first.link is not None
    with pytest.raises(RigError, match="is already used"):
        check_drones(
            rig,
            replace(
                config, drones=(first, replace(second, link=replace(first.link, where="D2's")))
            ),
        )


def test_the_faults_of_a_leg_are_its_own_and_follow_its_roles() -> None:
    begun: list[tuple[int, str]] = []

    def inject(leg: int, fault: Fault) -> None:
        begun.append((leg, fault.name))

    texts = {0: ["link_loss=0.1"], 2: ["kill_receiver@approach", "kill_sender@released"]}
    legs = LegFaults(
        {leg: [parse_fault(text) for text in faults] for leg, faults in texts.items()}, inject
    )

    def says(name: str, role: Role, phase: str) -> None:
        legs.on_progress(name, Progress(role, 0, phase, 0, 30, None, None, None, 0.0, False, ""))

    legs.open_leg(1, "D1", "D2")
    says("D2", Role.RECEIVER, "approach")
    assert begun == [(1, "link_loss")]
    legs.open_leg(2, "D2", "D3")
    says("D2", Role.RECEIVER, "approach")  # what it still was
    says("D1", Role.RECEIVER, "approach")  # not in this leg
    assert begun[1:] == [(2, "link_loss")]
    assert (
        legs.waits_for_duty("D2")
        and not legs.waits_for_duty("D3")
        and not legs.waits_for_duty("D1")
    )
    legs.on_duty("D2", "released")
    says("D3", Role.RECEIVER, "approach")
    assert begun[2:] == [(2, "kill_sender"), (2, "kill_receiver")]
    assert (legs.end_of(2, Role.RECEIVER), legs.end_of(1, Role.RECEIVER)) == ("D3", "D2")


NOBODY: Any = None
NO_PROCESSES = DroneProcesses(NOBODY, NOBODY, NOBODY, NOBODY)
WRITES_DOWN = """
import sys
with open({file!r}, "w") as file:
    file.writelines(sys.stdin)
"""
DIES_IN_THE_MIDDLE = """
import os, signal
print({record!r})
print('{{"event": "ask", "battery": 0.5, "wait_s": 9.0}}')
print({half!r}, end="", flush=True)
os.kill(os.getpid(), signal.SIGKILL)
"""


def test_what_a_killed_program_did_not_finish_saying_is_not_passed_on(
    rig: Rig, tmp_path: Path
) -> None:
    record = '{"event":"record","record":["D1","/phase",1,{"phase":"follow"}]}'
    said: list[Any] = []
    nothing: Any = None

    def heard(name: str, word: Any) -> None:
        said.append((name, word["event"]))

    processes = DroneProcesses(nothing, nothing, nothing, heard)
    request = RelayRequest(rig, field_of(rig, 3, 0), tmp_path, 1, {}, nothing, nothing, processes)

    async def main() -> object:
        relay = RealTimeRun(orders_of(request), ("D1", "D2", "D3"), {})
        python = [sys.executable, "-I", "-S", "-c"]
        relay.world = await spawn(
            [*python, WRITES_DOWN.format(file=str(tmp_path / "told"))], tmp_path / "world.txt"
        )
        dies = DIES_IN_THE_MIDDLE.format(record=record, half=record[:40])
        program = await spawn([*python, dies], tmp_path / "D1.txt")
        await relay._listen(relay.drones["D1"], program)
        await end([relay.world, program])
        return relay.drones["D1"].result

    assert asyncio.run(main()) is None
    assert (tmp_path / "told").read_text() == record + "\n"
    assert said == [("D1", "ask")]


def test_a_run_without_findings_is_reported_too(rig: Rig, tmp_path: Path) -> None:
    nothing: Any = None
    request = RelayRequest(
        rig, field_of(rig, 3, 0), tmp_path, 1, {}, nothing, nothing, NO_PROCESSES
    )
    run = RealTimeRun(orders_of(request), ("D1", "D2", "D3"), {})
    report = report_of(request, run, Ending({}, "the world's process ended", "", 3.0, 1.0))
    assert report.failure == "the world's process ended"
    assert [watched.first_s for watched in report.watched] == [None]


def test_the_parent_knows_a_record_from_other_lines(capsys: pytest.CaptureFixture[str]) -> None:
    from missions.fly.fleet.process import RelayedLog  # noqa: PLC0415 (what it says is all that is asked for)

    RelayedLog(NoLog(), "D1", whole=False).write("/phase", 1, {"phase": "follow"})
    assert capsys.readouterr().out.encode().startswith(RECORD)


def test_a_share_of_a_core_is_refused_by_a_relay_which_confines_nobody(
    rig: Rig, tmp_path: Path
) -> None:
    nothing: Any = None
    request = RelayRequest(
        with_slow(rig, 0.2), field_of(rig, 3, 0), tmp_path, 1, {}, nothing, nothing, nothing
    )
    with pytest.raises(RigError, match="confines no program"):
        RelaySitl().fly(request)
