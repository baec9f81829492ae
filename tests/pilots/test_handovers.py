"""Whole hand-overs under persons' hands: those that were found to fail once, and what is drawn.

Hundreds of them: ``python -m tests.pilots --handovers --seed 1 --flights 300``.
"""

from __future__ import annotations

from dataclasses import replace

import pytest

from flight.harness.flights import Progress, RoleResult
from flight.outcome import Outcome
from path.messages import Role
from tests.pilots import handovers
from tests.pilots.acts import Act
from tests.pilots.handovers import Acts, Console, shown, simpler_acts

FOUND = {
    # its motors turned again in OFFBOARD, where nobody flew it any more: no gap of the script's
    "stopped motors for a moment": Acts(7, receiver=(Act(34.0, "kill", 0, 0.2),)),
    # they turned again in the climb, where nobody flew it any more: its guard took and landed it
    "stopped motors in the climb": Acts(4, receiver=(Act(18.75, "kill", 0, 0.5),)),
    # the other drone, which follows the target beside it, was not told
    "sticks on the way home, and a radio lost": Acts(
        7, sender=(Act(35.97, "sticks", 1, 1.0), Act(44.03, "lost"))
    ),
}


@pytest.mark.parametrize("acts", FOUND.values(), ids=FOUND.keys())
def test_what_was_found_ends_well(acts: Acts) -> None:
    flown, consoles = shown(acts)
    assert flown.wrong == ()
    assert flown.outcome == Outcome.PILOT_OVERRIDE.label
    assert all(console.says("pilot_override") for console in consoles.values())


def test_a_console_that_does_not_say_why_is_found() -> None:
    ends = {
        Role.SENDER: RoleResult(Role.SENDER, Outcome.PILOT_OVERRIDE, "", True, False, ended_s=5.0),
        Role.RECEIVER: RoleResult(Role.RECEIVER, Outcome.PEER_LOST, "", False, True, ended_s=6.0),
    }
    consoles = {role: Console() for role in Role}
    own = "pilot_override: sticks"
    assert len(handovers.unsaid(ends, consoles)) == 2
    consoles[Role.SENDER].lines += [own]
    assert len(handovers.unsaid(ends, consoles)) == 2  # who has the target is not said
    consoles[Role.SENDER].lines += ["nobody does"]
    (left,) = handovers.unsaid(ends, consoles)
    assert left.startswith("receiver: ended as peer_lost")
    consoles[Role.RECEIVER].lines += [own]
    assert handovers.unsaid(ends, consoles) == []


def test_a_console_keeps_each_line_once_and_when_each_phase_began() -> None:
    console = Console()
    seen = Progress(Role.SENDER, 0, "verify", 0, 1, None, None, None, 0.0, False, "a note")
    console.show(seen, 1.0)
    console.show(replace(seen, responsible=True), 2.0)
    assert (console.lines, console.moments) == (["a note"], {"verify": 1.0, "responsible": 2.0})


def test_what_is_simpler_is_less() -> None:
    one = Act(1.25, "kill", 0, 0.5)
    both = Acts(1, (one,), (one,))
    tried = simpler_acts(both)
    assert Acts(1, (), (one,)) in tried and Acts(1, (one,), ()) in tried
    assert all(Acts(1) != each for each in simpler_acts(Acts(1, (one,))))
