"""Every duration and limit of the guard's rules, to the nanosecond."""

from __future__ import annotations

from dataclasses import replace

import pytest

from drivers.interfaces import FlightMode
from drivers.mavlink.guard.interfaces import GuardView
from flight.guard.rules import Act, GuardRules, GuardStage, GuardState, ProgramBeat
from tests.flight.guard.guard_views import HEARD, NOW, VIEW, ago, at, dead, step


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
        # measured too long ago
        (VIEW, replace(HEARD, separation_m=0.1, separation_ns=ago(0.5, 1))),
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


@pytest.mark.parametrize("more_ns", [0, 1])
def test_a_program_is_dead_or_alive_when_its_vehicle_comes_down(more_ns: int) -> None:
    """Of a living one the script may have ordered it, telemetry is late; of a dead one it is
    somebody's will.
    """
    beat = replace(HEARD, beat_ns=ago(0.5, more_ns))
    assert (
        at(view=replace(VIEW, mode=FlightMode.LAND), heard=beat)[0].stage is GuardStage.LET_GO
    ) is bool(more_ns)


@pytest.mark.parametrize("stage", [GuardStage.HOLDING, GuardStage.LANDING])
@pytest.mark.parametrize("more_ns", [0, 1])
def test_a_heartbeat_shows_what_was_commanded_only_when_it_is_younger_than_the_command(
    stage: GuardStage, more_ns: int
) -> None:
    state = GuardState(stage, "x", sent_ns=NOW - more_ns, tries=1)
    mode = FlightMode.HOLD if stage is GuardStage.HOLDING else FlightMode.LAND
    shown_ns = at(state, replace(VIEW, mode=mode))[0].shown_ns
    assert shown_ns == (NOW if more_ns else None)


def test_the_mode_that_the_script_flies_is_its_own_without_any_grace() -> None:
    strict = GuardRules(mode_grace_s=0.0)
    assert step(rules=strict) == (GuardState(), Act.NOTHING)


def test_a_vehicle_that_was_let_go_of_in_a_mode_of_scripts_has_its_grace_from_then_on() -> None:
    gone, act = at(GuardState(odd_ns=ago(1.0, 1)), replace(VIEW, mode=FlightMode.TAKEOFF))
    assert (gone.stage, gone.odd_ns, act) == (GuardStage.LET_GO, None, Act.NOTHING)


def test_a_landing_may_be_commanded_once_only() -> None:
    once = GuardRules(land_tries=1)
    state = GuardState(GuardStage.LANDING, "x", sent_ns=ago(9.0), tries=1)
    after, act = step(state, replace(VIEW, acked=False), dead(), rules=once)
    assert (after.stage, act) == (GuardStage.GAVE_UP, Act.NOTHING)
