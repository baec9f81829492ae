"""Faults of a run in real time: told to the world, or striking a program, once."""

from __future__ import annotations

import asyncio
import signal
import textwrap
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest

from drivers.log.state_file import StateFile
from flight.harness.flights import encode_event
from flight.outcome import Outcome
from hil.harness import sitl
from hil.harness.realtime import children
from hil.world.faults import AT_COUNT
from path.messages import Role
from path.protocol.values import Handoff, ReceiverRecord
from tests.hil.harness.programs_on_stage import (
    Stage,
    progress,
    result,
    results,
    saying,
)


def test_a_fault_that_is_due_is_told_to_the_world(stage: Stage) -> None:
    programs = {
        Role.SENDER: saying(progress(Role.SENDER, AT_COUNT - 1), progress(Role.SENDER, AT_COUNT)),
        Role.RECEIVER: saying(result(Role.RECEIVER)),
    }
    stage.fly(programs, ["marker_hidden"])
    assert stage.told() == [("marker_hidden", "sender", None)]


def test_a_fault_that_kills_kills_the_program_and_no_other(stage: Stage) -> None:
    programs = {
        Role.SENDER: saying(progress(Role.SENDER, AT_COUNT), result(Role.SENDER)),
        Role.RECEIVER: saying(then="import time; time.sleep(600)"),
    }
    run = stage.fly(programs, ["kill_receiver"])
    assert results(run) == {Role.SENDER: result(Role.SENDER)}
    assert stage.processes[2].returncode == -signal.SIGKILL
    assert stage.told() == [("kill_receiver", "receiver", None)]


def test_a_program_is_started_again_after_its_death(stage: Stage) -> None:
    programs = {
        Role.SENDER: [
            saying(progress(Role.SENDER, AT_COUNT), then="import time; time.sleep(600)"),
            saying(progress(Role.SENDER, AT_COUNT), result(Role.SENDER, Outcome.RESTARTED)),
        ],
        Role.RECEIVER: saying(result(Role.RECEIVER)),
    }
    run = stage.fly(programs, ["kill_sender=0.05"])
    assert results(run)[Role.SENDER].outcome is Outcome.RESTARTED
    assert [process.returncode for process in stage.processes].count(-signal.SIGKILL) == 1
    assert stage.told() == [("kill_sender", "sender", 0.05)]


@pytest.mark.parametrize("again", [False, True])
def test_a_fault_that_is_due_while_its_program_is_being_started_strikes_once_it_has_begun(
    stage: Stage, again: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The other drone's count makes it due, and of this one's program nothing is known here yet."""
    begun: list[asyncio.subprocess.Process] = []

    async def spawn(
        command: Sequence[str], errors: Path, run: str = ""
    ) -> asyncio.subprocess.Process:
        process = await children.spawn(command, errors, run)
        if errors.name == "receiver.stderr.txt":
            begun.append(process)
            if len(begun) == 1 + again:
                (stage.out / "begins").touch()
                async with asyncio.timeout(60.0):
                    while Role.SENDER not in [shown.role for shown in stage.shown]:  # noqa: ASYNC110 (another process's)
                        await asyncio.sleep(0.001)
        return process

    monkeypatch.setattr("hil.harness.realtime.programs.spawn", spawn)
    waits = f"import os, time\nwhile not os.path.exists({str(stage.out / 'begins')!r}): time.sleep(0.001)\n"
    receiver = saying(
        replace(progress(Role.RECEIVER), phase="waiting"), then="import time; time.sleep(600)"
    )
    programs = {
        Role.SENDER: waits + saying(progress(Role.SENDER, AT_COUNT), result(Role.SENDER)),
        Role.RECEIVER: [receiver] * (1 + again),
    }
    faults = ["kill_receiver=0@waiting"] * again + ["kill_receiver"]
    run = stage.fly(programs, faults, limit_s=60.0)
    assert set(results(run)) == {Role.SENDER}
    assert [process.returncode for process in begun] == [-signal.SIGKILL] * len(faults)
    assert stage.told()[-1] == ("kill_receiver", "receiver", None) and len(stage.told()) == len(
        faults
    )
    assert run.missed == []


def test_a_fault_of_a_program_that_has_ended_is_told_as_missed_in_the_report(stage: Stage) -> None:
    pid = stage.out / "pid"
    waits = f"""
        import os, time
        while not os.path.exists({str(pid)!r}) or os.path.exists("/proc/" + open({str(pid)!r}).read()):
            time.sleep(0.001)
    """
    writes = f"import os; open('{pid}.new', 'w').write(str(os.getpid())); os.rename('{pid}.new', {str(pid)!r})"
    programs = {
        Role.SENDER: textwrap.dedent(waits)
        + saying(progress(Role.SENDER, AT_COUNT), result(Role.SENDER)),
        Role.RECEIVER: saying(result(Role.RECEIVER), then=writes),
    }
    run = stage.fly(programs, ["kill_receiver", "guard_death", "marker_hidden"])
    assert stage.told() == [("marker_hidden", "sender", None)]
    assert sitl.report_of(stage.request, run, stage.ending).notes[-2:] == [
        "fault kill_receiver had nothing to strike: the receiver's program had ended",
        "fault guard_death had nothing to strike: the sender has no guard",
    ]


@pytest.mark.parametrize("late_s", [0.0, 0.3])
def test_a_record_that_is_written_down_is_a_moment_too(
    stage: Stage, late_s: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is noticed on the disk: nobody but the file says so, and a quick program writes it before
    it is known here.
    """

    async def spawn(
        command: Sequence[str], errors: Path, run: str = ""
    ) -> asyncio.subprocess.Process:
        process = await children.spawn(command, errors, run)
        until_s = time.monotonic() + 30.0
        if late_s and errors.name == "receiver.stderr.txt":
            while not has_written.exists() and time.monotonic() < until_s:  # noqa: ASYNC110 (another process's)
                await asyncio.sleep(0.01)
            await asyncio.sleep(late_s)
        return process

    monkeypatch.setattr("hil.harness.realtime.programs.spawn", spawn)
    provisional = StateFile(stage.out / "x", Role.RECEIVER)
    provisional.save(ReceiverRecord(1, "provisional", Handoff(1, 1, 1)))
    text, has_written = (stage.out / "x").read_text(), stage.out / "receiver.state.json"
    writes = f"import time; open({str(has_written)!r}, 'w').write({text!r}); time.sleep(600)"
    programs = {Role.SENDER: saying(result(Role.SENDER)), Role.RECEIVER: writes}
    run = stage.fly(programs, ["kill_receiver@provisional"], limit_s=60.0)
    assert stage.ending.failure == ""
    assert list(results(run)) == [Role.SENDER]


RUNS = """
import time
begun_s = last_s = time.monotonic()
"""
STANDS_STILL = """
while last_s - begun_s < 60.0:
    time.sleep(0.01)
    now_s = time.monotonic()
    if now_s - last_s > 0.4:  # it slept longer than it meant to
        break
    last_s = now_s
print(LAST, flush=True)
"""


def test_a_program_that_stalls_goes_on_afterwards(stage: Stage) -> None:
    programs = {
        Role.SENDER: f"LAST = {encode_event(result(Role.SENDER))!r}\n{RUNS}"
        + saying(progress(Role.SENDER, AT_COUNT), then=STANDS_STILL),
        Role.RECEIVER: saying(result(Role.RECEIVER)),
    }
    run = stage.fly(programs, ["stall_sender=0.5"])
    assert set(results(run)) == set(Role)
    assert stage.told() == [("stall_sender", "sender", 0.5)]
