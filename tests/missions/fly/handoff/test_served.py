"""A world alone: the harness hears of programs that somebody else starts, and the crew what to
type.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

from drivers.interfaces import PartError
from drivers.log.mcap_log import McapLog, new_part
from drivers.rig.parts import Rig
from flight.harness.flights import (
    ABSENT,
    FlightReport,
    FlightRequest,
    Progress,
    RoleResult,
    decode_event,
)
from flight.outcome import Outcome
from hil.camera import shared
from missions.fly.handoff import command, elsewhere, flight, served
from missions.ground import rig_library
from missions.ground.options.flights import HandoffOptions
from path.messages import Role

OUTCOME = {"outcome": "committed", "detail": "", "responsible": False, "landed": True}


def stand_in(role: Role, folder: Path, wait_s: float = 600.0) -> list[str]:
    module = "missions.fly.handoff.elsewhere"
    return [
        sys.executable,
        "-m",
        module,
        role.value,
        str(folder),
        f"{wait_s:g}",
        f"path-handoff {role.value}",
    ]


def test_a_log_that_begins_later_is_followed_to_its_outcome_also_after_a_kill(
    tmp_path: Path,
) -> None:
    with subprocess.Popen(
        stand_in(Role.RECEIVER, tmp_path), stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        absent = decode_event(process.stdout.readline())
        killed = McapLog(new_part(tmp_path, "receiver"), "receiver")
        killed.write("/phase", 1, {"phase": "preflight", "note": ""})
        first = decode_event(process.stdout.readline())
        with McapLog(new_part(tmp_path, "receiver"), "receiver") as log:
            log.write("/phase", 2, {"phase": "landing", "note": "again"})
            log.write("/outcome", 3, OUTCOME)
        second, last = (decode_event(process.stdout.readline()) for _ in range(2))
        assert process.wait(60.0) == 0
        killed.close()
    assert isinstance(absent, Progress) and absent.phase == ABSENT
    assert isinstance(first, Progress) and isinstance(second, Progress)
    assert (first.phase, second.phase, second.note) == ("preflight", "landing", "again")
    assert last == RoleResult(Role.RECEIVER, Outcome.COMMITTED, "", responsible=False, landed=True)


def test_it_does_not_wait_for_a_program_that_never_came(tmp_path: Path) -> None:
    with subprocess.Popen(
        stand_in(Role.RECEIVER, tmp_path), stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        decode_event(process.stdout.readline())
        process.terminate()
        ended = decode_event(process.stdout.readline())
        assert process.wait(60.0) == 0
    assert isinstance(ended, RoleResult) and ended.outcome is Outcome.INTERRUPTED
    assert ended.detail == "it ended before anybody started its program"


def test_what_to_type_is_said_again_and_after_the_wait_that_nobody_came() -> None:
    waiting = elsewhere.Waiting(Role.SENDER, 70.0, "path-handoff sender --rig sitl", 1000.0)
    said = [
        (at_s, waiting.news(1000.0 + at_s)) for at_s in (0.0, 0.1, 29.9, 30.0, 60.1, 69.9, 70.0)
    ]
    notes = {at_s: event.note for at_s, event in said if isinstance(event, Progress)}
    assert list(notes) == [0.0, 30.0, 60.1]
    assert (
        notes[30.0] == "start it now, within 40 s, in another shell: path-handoff sender --rig sitl"
    )
    end = said[-1][1]
    assert isinstance(end, RoleResult)
    assert (end.outcome, end.detail) == (
        Outcome.NOT_STARTED,
        "nobody started its program within 70 s",
    )
    assert end.landed and not end.responsible


def test_a_program_that_nobody_starts_is_waited_for_so_long_and_no_longer(tmp_path: Path) -> None:
    ran = subprocess.run(
        stand_in(Role.SENDER, tmp_path, 0.3),
        stdout=subprocess.PIPE,
        text=True,
        check=True,
        timeout=60.0,
    )
    end = decode_event(ran.stdout.splitlines()[-1])
    assert isinstance(end, RoleResult) and end.outcome is Outcome.NOT_STARTED
    assert list(tmp_path.iterdir()) == []


def test_the_crew_is_told_what_to_type_and_when(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The harness starts a stand-in where it would start a program; then it is time."""
    commands: list[Sequence[str]] = []

    class Harness:
        def fly(self, request: FlightRequest) -> FlightReport:
            commands.extend(request.role_command(role) for role in Role)
            ends = {
                role: RoleResult(role, Outcome.COMMITTED, "", responsible=False, landed=True)
                for role in Role
            }
            return FlightReport(
                results=ends,
                landed=dict.fromkeys(Role, True),
                violations={},
                simulated_s=1.0,
                wall_s=1.0,
            )

    def harness_of(rig: Rig) -> Harness:
        del rig
        return Harness()

    monkeypatch.setattr(flight, "harness_of", harness_of)
    assert command.run(HandoffOptions("sitl", out=tmp_path, serve_world=True, picture=False)) == 0
    said = capsys.readouterr().out
    for role in Role:
        assert f" path-handoff {role.value} --rig sitl --out {tmp_path}" in said
    assert f"{shared.RUN_VARIABLE}=run-" in said
    assert f"within {served.WAIT_S:g} s" in said
    for role, each in zip(Role, commands, strict=True):
        assert each[2:6] == [
            "missions.fly.handoff.elsewhere",
            role.value,
            str(tmp_path),
            f"{served.WAIT_S:g}",
        ]
        assert each[6] in said


@pytest.mark.parametrize(
    "options",
    [
        HandoffOptions("sim", serve_world=True),
        HandoffOptions("sitl", serve_world=True, seeds=2),
        HandoffOptions("sitl", serve_world=True, fault=("kill_sender=1@verify",)),
    ],
)
def test_what_cannot_be_served_is_refused(options: HandoffOptions) -> None:
    with pytest.raises(PartError, match="--serve-world"):
        served.check_served(rig_library.load(options.rig), options)
