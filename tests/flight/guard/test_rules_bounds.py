"""Every duration and limit of the guard's rules, to the nanosecond."""

from __future__ import annotations

from dataclasses import replace

import pytest

from drivers.interfaces import FlightMode
from drivers.mavlink.guard.interfaces import GuardView
from flight.guard.rules import Act, GuardStage, GuardState, ProgramBeat
from tests.flight.guard.guard_views import HEARD, NOW, VIEW, ago, at, dead


@pytest.mark.parametrize("more_ns", [0, 1])
def test_each_duration_is_over_when_it_is_longer_than_the_rule_says(more_ns: int) -> None:
    over = bool(more_ns)
    beat = replace(HEARD, beat_ns=ago(0.5, more_ns))
    assert (at(heard=beat)[1] is Act.HOLD) is over
    assert (at(heard=replace(HEARD, setpoint_ns=ago(0.25, more_ns)))[1] is Act.HOLD) is over
    blind = replace(VIEW, heartbeat_ns=ago(2.5, more_ns))
    assert (at(view=blind, heard=dead(for_s=9.0))[1] is Act.NOTHING) is over
    odd = GuardState(odd_ns=ago(1.0, more_ns))
    assert (at(odd, replace(VIEW, mode=FlightMode.TAKEOFF))[0].stage is GuardStage.LET_GO) is over
    gone = GuardState(GuardStage.LET_GO, "somebody", odd_ns=ago(1.0, more_ns))
    assert (at(gone, heard=dead(for_s=9.0))[1] is Act.HOLD) is over
    nobodys = GuardState(GuardStage.LET_GO, "somebody", odd_ns=ago(1.0, 1))
    assert (at(nobodys, heard=replace(HEARD, beat_ns=ago(0.5, more_ns)))[1] is Act.HOLD) is over
    for acked, waits_s in ((None, 0.5), (True, 1.5)):
        sent = GuardState(GuardStage.HOLDING, "x", sent_ns=ago(waits_s, more_ns))
        assert (at(sent, replace(VIEW, acked=acked))[1] is Act.LAND) is over
        sent = GuardState(GuardStage.LANDING, "x", sent_ns=ago(waits_s, more_ns), tries=1)
        assert (at(sent, replace(VIEW, acked=acked))[1] is Act.LAND) is over
    refused = GuardState(GuardStage.LANDING, "x", sent_ns=ago(0.5, more_ns), tries=1)
    assert (at(refused, replace(VIEW, acked=False))[1] is Act.LAND) is over
    unseen = GuardState(GuardStage.HOLDING, "x", sent_ns=ago(1.5, more_ns))
    assert (at(unseen, replace(VIEW, mode=FlightMode.LAND))[0].stage is GuardStage.LET_GO) is over


@pytest.mark.parametrize("less_ns", [0, 1])
def test_patience_and_the_hold_are_over_when_they_are_reached(less_ns: int) -> None:
    reached = not less_ns
    broken = GuardState(broken_ns=ago(0.5, -less_ns))
    assert (at(broken, replace(VIEW, battery=0.1))[1] is Act.HOLD) is reached
    held = GuardState(GuardStage.HOLDING, "x", sent_ns=ago(9.0), shown_ns=ago(2.0, -less_ns))
    assert (at(held, replace(VIEW, mode=FlightMode.HOLD))[1] is Act.LAND) is reached


@pytest.mark.parametrize(
    ("view", "heard"),
    [
        (replace(VIEW, position_n_m=(3.0, 4.0, -1.5)), HEARD),
        (replace(VIEW, position_n_m=(0.0, 0.0, -6.0)), HEARD),
        (replace(VIEW, battery=0.25), HEARD),
        (VIEW, replace(HEARD, separation_m=1.0, separation_ns=NOW)),
        (VIEW, replace(HEARD, separation_m=0.1, separation_ns=ago(0.5, 1))),  # measured too long ago
        (replace(VIEW, position_n_m=(1.0, 2.0, -1.5)), replace(HEARD, peer_n_m=(1.5, 2.0, -1.5))),
    ],
)
def test_at_a_limit_is_within_it(view: GuardView, heard: ProgramBeat) -> None:
    assert at(GuardState(broken_ns=ago(9.0)), view, heard) == (GuardState(), Act.NOTHING)


@pytest.mark.parametrize(
    ("view", "heard"),
    [
        (replace(VIEW, position_n_m=(3.0, 4.001, -1.5)), HEARD),
        (replace(VIEW, position_n_m=(0.0, 0.0, -6.001)), HEARD),
        (replace(VIEW, battery=0.2499), HEARD),
        (VIEW, replace(HEARD, separation_m=0.999, separation_ns=NOW)),
        (VIEW, replace(HEARD, separation_m=0.1, separation_ns=ago(0.5))),
        (replace(VIEW, position_n_m=(1.0, 2.0, -1.5)), replace(HEARD, peer_n_m=(1.499, 2.0, -1.5))),
    ],
)
def test_beyond_a_limit_is_not(view: GuardView, heard: ProgramBeat) -> None:
    state, act = at(GuardState(broken_ns=ago(9.0)), view, heard)
    assert (state.stage, act) == (GuardStage.HOLDING, Act.HOLD)
