"""A mission from outside that searches, hands over what it found, and goes on: written from the
surface alone.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import pytest

from missions.fly.own.command import fly_mission
from missions.ground import rig_library
from missions.look.report.command import make_report
from missions.look.report.records import RunFacts

MISSION = Path(__file__).parent / "search_and_hand_over.py"
PAGE = Path(__file__).parents[2] / "docs" / "own-missions.md"
ASKED = """
async def sender(drone):
    {sender}

async def receiver(drone):
    {receiver}
"""


def fly(mission: Path, out: Path, seed: int, *, operator: bool = True) -> RunFacts:
    """``operator``: somebody stands beside the field and points at the target."""
    out.mkdir(exist_ok=True)
    rig = rig_library.load("sim")
    if not operator:
        rig = replace(rig, sender=replace(rig.sender, operator=None))
    return fly_mission(mission, rig, seed, (), out, lambda _: None)


def test_what_was_searched_and_found_is_handed_over_and_followed(tmp_path: Path) -> None:
    facts = fly(MISSION, tmp_path, 7)
    assert (facts.outcome, facts.violations) == ("flown", {}), facts.detail
    summary = make_report(tmp_path, True, sys.stdout)
    assert summary["t_commit_s"] > 0.0 and summary["wrong_handover"] is False
    assert summary["lost_after_taking_over"] is False
    assert (tmp_path / "run.png").is_file()


def test_the_pages_example_is_the_one_that_flies_and_short() -> None:
    text = MISSION.read_text("utf-8")
    assert "(../tests/outside/search_and_hand_over.py)" in PAGE.read_text("utf-8")
    assert len(text.splitlines()) <= 40


@pytest.mark.parametrize(
    ("sender", "receiver", "why"),
    [
        (
            "await drone.hand_over()",
            "await drone.take_over()",
            "to hand over it has to take off first",
        ),
        ("await drone.take_over()", "await drone.take_over()", "the sender carries the marker"),
        (
            "await drone.until(lambda: False, 30.0, 'waits')",
            "await drone.hand_over()",
            "only the sender carries",
        ),
        (
            "await drone.hand_over(to='sender')",
            "await drone.take_over()",
            "there is no drone 'sender'",
        ),
    ],
)
def test_what_cannot_be_handed_over_is_said_on_the_ground(
    sender: str, receiver: str, why: str, tmp_path: Path
) -> None:
    mission = tmp_path / "asked.py"
    mission.write_text(ASKED.format(sender=sender, receiver=receiver), "utf-8")
    facts = fly(mission, tmp_path / "run", 1)
    assert facts.outcome == "mission_failed" and why in facts.detail


def test_a_place_where_nothing_is_ends_as_a_handover_does_and_both_drones_land(
    tmp_path: Path,
) -> None:
    mission = tmp_path / "nothing.py"
    given = "await drone.take_off(1.5)\n    await drone.hand_over((-6.0, 5.0, 0.0), error_m=0.3)"
    mission.write_text(ASKED.format(sender=given, receiver="await drone.take_over()"), "utf-8")
    facts = fly(mission, tmp_path / "run", 1, operator=False)
    assert (facts.outcome, facts.violations) == ("target_not_found", {}), facts.detail
