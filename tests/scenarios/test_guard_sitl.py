"""Real processes: a sender's program that stands still in the air, and its guard."""

from __future__ import annotations

from pathlib import Path

from drivers.log.mcap_log import read_log
from missions.fly.handoff.flight import fly_once
from missions.ground import rig_library
from missions.look.report.records import RunFacts
from tests.overloaded import Flown, Repeating


def fly(out: Path) -> Flown[tuple[RunFacts, Path]]:
    faults = ("no_failsafe", "stall_sender=3@take-off+2.5")
    facts = fly_once(rig_library.load("sitl-light"), 0, faults, out, lambda _: None)
    return Flown(facts.outcome, facts.detail, (facts, out))


def test_a_program_that_stalls_in_the_air_finds_its_vehicle_in_the_guards_hand(
    flown_again: Repeating,
) -> None:
    """Whatever it had been about to do, it does not do: the vehicle was held, and is landed."""
    facts, out = flown_again(fly)
    assert facts.outcome == "guard", facts.detail
    assert "the guard took the vehicle: no sign of life" in facts.detail
    assert facts.violations == {}
    taken = [r.record for r in read_log(out / "sender.guard.mcap") if r.topic == "/guard"]
    assert [(record["stage"], record["act"]) for record in taken][:2] == [
        ("holding", "hold"),
        ("landing", "land"),
    ]
    (end,) = [r.record for r in read_log(out / "sender.mcap") if r.topic == "/outcome"]
    assert end["landed"]
    modes = [
        r.record["mode"]
        for r in read_log(out / "world.mcap")
        if r.topic == "/autopilot" and r.record["role"] == "sender" and r.record["armed"]
    ]
    assert modes[-3:] == ["takeoff", "hold", "land"]
