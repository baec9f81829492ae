"""A world alone: the harness hears of programs that somebody else starts, and the crew what to type."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

from drivers.interfaces import PartError
from drivers.log.mcap_log import McapLog, new_part
from drivers.rig.parts import Rig
from flight.harness.flights import FlightReport, FlightRequest, Progress, RoleResult, decode_event
from flight.outcome import Outcome
from hil.camera import shared
from missions import rig_library
from missions.handoff import command, flight, served
from missions.options.flights import HandoffOptions
from path.messages import Role

OUTCOME = {"outcome": "committed", "detail": "", "responsible": False, "landed": True}


def test_a_log_that_begins_later_is_followed_to_its_outcome_also_after_a_kill(tmp_path: Path) -> None:
    stands_in = [sys.executable, "-m", "missions.handoff.elsewhere", "receiver", str(tmp_path)]
    with subprocess.Popen(stands_in, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        killed = McapLog(new_part(tmp_path, "receiver"), "receiver")
        killed.write("/phase", 1, {"phase": "preflight", "note": ""})
        first = decode_event(process.stdout.readline())
        with McapLog(new_part(tmp_path, "receiver"), "receiver") as log:
            log.write("/phase", 2, {"phase": "landing", "note": "again"})
            log.write("/outcome", 3, OUTCOME)
        second, last = (decode_event(process.stdout.readline()) for _ in range(2))
        assert process.wait(60.0) == 0
        killed.close()
    assert isinstance(first, Progress) and isinstance(second, Progress)
    assert (first.phase, second.phase, second.note) == ("preflight", "landing", "again")
    assert last == RoleResult(Role.RECEIVER, Outcome.COMMITTED, "", responsible=False, landed=True)


def test_it_does_not_wait_for_a_program_that_never_came(tmp_path: Path) -> None:
    stands_in = [sys.executable, "-m", "missions.handoff.elsewhere", "receiver", str(tmp_path)]
    with subprocess.Popen(stands_in, stdout=subprocess.PIPE, text=True) as process:
        with pytest.raises(subprocess.TimeoutExpired):
            process.wait(3.0)
        process.terminate()
        assert process.wait(60.0) in (0, -15)


def test_the_crew_is_told_what_to_type_and_when(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The harness starts a stand-in where it would start a program; then it is time."""
    commands: list[Sequence[str]] = []

    class Harness:
        def fly(self, request: FlightRequest) -> FlightReport:
            commands.extend(request.role_command(role) for role in Role)
            ends = {role: RoleResult(role, Outcome.COMMITTED, "", responsible=False, landed=True) for role in Role}
            return FlightReport(ends, dict.fromkeys(Role, True), {}, 1.0, 1.0)

    def harness_of(rig: Rig) -> Harness:
        del rig
        return Harness()

    monkeypatch.setattr(flight, "harness_of", harness_of)
    assert command.run(HandoffOptions("sitl", out=tmp_path, serve_world=True, picture=False)) == 0
    said = capsys.readouterr().out
    for role in Role:
        assert f" path-handoff {role.value} --rig sitl --out {tmp_path}" in said
    assert f"{shared.RUN_VARIABLE}=run-" in said
    assert said.count("start it now") == 2
    assert [each[2] for each in commands] == ["missions.handoff.elsewhere"] * 2


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
