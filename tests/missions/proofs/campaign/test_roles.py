"""The faults in a run of the roles: drawn from its arguments alone, as orders that the harness
understands.
"""

from __future__ import annotations

import pytest

from hil.monitors.monitors import OF_THE_AWAKE
from hil.world.faults import parse_fault
from missions.ground.options.words import LevelName
from missions.proofs.campaign import role_runs
from missions.proofs.campaign.levels import LEVELS
from missions.proofs.campaign.results import RunLine
from missions.proofs.campaign.role_runs import CONCERNS, draw, fly
from missions.proofs.campaign.run import RunOrder


@pytest.mark.parametrize("level", LEVELS)
def test_every_fault_drawn_is_one_that_can_be_ordered(level: LevelName) -> None:
    for number in range(200):
        seed, faults = draw(0, level, number)
        assert (seed, faults) == draw(0, level, number)
        for fault in faults:
            parse_fault(fault)


def test_the_hostile_level_has_every_kind() -> None:
    names = {
        fault.partition("=")[0].partition("@")[0]
        for number in range(200)
        for fault in draw(0, "hostile", number)[1]
    }
    assert names >= {*CONCERNS, "kill_sender", "kill_receiver", "link_out", "link_loss"}


def test_one_whole_run_of_both_programs() -> None:
    (line,) = fly(RunOrder("sim", 0, (("none", 0),)))
    assert isinstance(line, RunLine)
    assert (line.outcome, line.violations) == ("commit", ())
    assert 0.0 < line.figures["gap_s"] < 0.1


def test_programs_stand_still_at_the_levels_where_programs_die() -> None:
    for level in LEVELS:
        faults = [fault for number in range(100) for fault in draw(0, level, number)[1]]
        assert any(fault.startswith("stall_") for fault in faults) is (
            level in ("harsh", "hostile")
        )


def test_some_disks_of_the_hostile_level_lose_records_of_programs_that_begin_again() -> None:
    runs = [draw(0, "hostile", number)[1] for number in range(300)]
    forgetful = [faults for faults in runs if any(fault.startswith("disk_") for fault in faults)]
    assert 5 < len(forgetful) < 60
    for faults in forgetful:
        (loses,) = (fault for fault in faults if fault.startswith("disk_"))
        assert any(
            fault.startswith(loses.partition("=")[0].replace("disk_", "kill_") + "=")
            for fault in faults
        )


@pytest.mark.parametrize(("lost", "end"), [(1, "restarted"), (100, "guard")])
def test_a_sender_whose_disk_forgot_its_commit_lands_and_it_is_told(
    lost: int, end: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def asked(*_: object) -> tuple[int, tuple[str, ...]]:
        return 5, ("kill_sender=0.5@released", f"disk_sender={lost}@preflight")

    monkeypatch.setattr(role_runs, "draw", asked)
    (line,) = fly(RunOrder("sim", 0, (("hostile", 0),)))
    assert (line.violations, line.broken) == ((), ("disk",))
    assert line.outcome == end


def test_a_receiver_that_sleeps_over_its_lease_in_flight_takes_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Its record is on the disk, and it goes on half a second after the sender took back."""

    def asked(*_: object) -> tuple[int, tuple[str, ...]]:
        return 5, ("stall_receiver=2@provisional",)

    monkeypatch.setattr(role_runs, "draw", asked)
    (line,) = fly(RunOrder("sim", 0, (("harsh", 0),)))
    assert (line.violations, line.broken) == ((), ("stall",))
    assert line.outcome == "guard"  # which does not wait for it for two seconds
    assert 1.5 <= line.figures["gap_s"] < 1.65
    assert {what.partition(" ")[0] for what in line.beyond} <= set(OF_THE_AWAKE)
