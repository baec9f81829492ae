"""A vehicle that the guard has taken: held, landed, let go of, taken back, and ended by whoever
disarms it.
"""

from __future__ import annotations

from dataclasses import replace

import pytest

from drivers.interfaces import FlightMode
from drivers.mavlink.guard.interfaces import Script
from flight.guard.rules import Act, GuardStage, GuardState, ProgramBeat, decide
from tests.flight.guard.guard_views import (
    DOWN,
    EXACT,
    HEARD,
    HELD,
    HOLDING,
    MOVING,
    NOW,
    RULES,
    VIEW,
    WHOLE,
    S,
    ago,
    at,
    dead,
    ns,
    step,
)

LANDING = GuardState(GuardStage.LANDING, "why", sent_ns=NOW, tries=1)
COMING_DOWN = replace(LANDING, shown_ns=NOW)


def later(
    state: GuardState, seconds: float, mode: FlightMode, acked: bool | None = None
) -> tuple[GuardState, Act]:
    now = NOW + ns(seconds)
    return step(state, replace(VIEW, heartbeat_ns=now, mode=mode, acked=acked), None, now)


def test_a_hold_that_is_seen_is_followed_by_the_landing_after_its_time() -> None:
    state, act = later(HOLDING, 0.1, FlightMode.HOLD, acked=True)
    assert (state.stage, act) == (GuardStage.HOLDING, Act.NOTHING)
    assert state.shown_ns == NOW + ns(0.1)
    assert later(state, RULES.hold_s, FlightMode.HOLD)[1] is Act.NOTHING
    state, act = later(state, RULES.hold_s + 0.11, FlightMode.HOLD)
    assert (state.stage, act, state.tries) == (GuardStage.LANDING, Act.LAND, 1)


@pytest.mark.parametrize("mode", [FlightMode.OFFBOARD, FlightMode.TAKEOFF])
@pytest.mark.parametrize(
    ("after_s", "acked", "act"),
    [
        (0.4, None, Act.NOTHING),
        (0.6, None, Act.LAND),  # nobody answered
        (0.1, False, Act.LAND),  # refused
        (1.4, True, Act.NOTHING),
        (1.6, True, Act.LAND),  # agreed, and not done
    ],
)
def test_a_hold_that_is_not_carried_out_becomes_a_landing(
    mode: FlightMode, after_s: float, acked: bool | None, act: Act
) -> None:
    assert later(HOLDING, after_s, mode, acked)[1] is act


def test_a_landing_alone_is_commanded_again_and_not_for_ever() -> None:
    state, sent, now_s = LANDING, 1, 0.0
    while state.stage is GuardStage.LANDING:
        now_s += 0.02
        state, act = later(state, now_s, FlightMode.OFFBOARD, acked=False)
        sent += act is Act.LAND
        assert now_s < 2 * RULES.land_tries * RULES.ack_s
    assert (state.stage, sent) == (GuardStage.GAVE_UP, RULES.land_tries)
    assert now_s > (RULES.land_tries - 1) * RULES.ack_s  # not all at once
    assert later(state, now_s + 60.0, FlightMode.OFFBOARD) == (state, Act.NOTHING)


@pytest.mark.parametrize("taken", [HELD, COMING_DOWN])
@pytest.mark.parametrize("mode", [FlightMode.OFFBOARD, FlightMode.TAKEOFF])
def test_a_script_that_wakes_up_and_takes_control_is_landed(
    taken: GuardState, mode: FlightMode
) -> None:
    state, act = later(taken, 0.1, mode)
    assert (state.stage, act) == (GuardStage.LANDING, Act.LAND)


@pytest.mark.parametrize("taken", [HOLDING, HELD, LANDING, COMING_DOWN])
def test_a_pilot_wins_at_any_time(taken: GuardState) -> None:
    state, act = later(taken, 0.1, FlightMode.OTHER)
    assert (state.stage, act) == (GuardStage.LET_GO, Act.NOTHING)
    for mode in set(FlightMode) - set(MOVING):
        assert later(state, 9.0, mode) == (state, Act.NOTHING)


@pytest.mark.parametrize("state", [GuardState(), HOLDING, HELD, LANDING, COMING_DOWN])
@pytest.mark.parametrize("script", [script for script in Script if script.flies])
def test_one_message_alone_lets_nobody_go_and_nothing_is_sent_against_it(
    state: GuardState, script: Script
) -> None:
    view = replace(VIEW, mode=FlightMode.OTHER, mode_told=1)
    after, act = step(state, view, dead(script))
    assert act is Act.NOTHING and after.stage is state.stage
    after, act = step(
        after, replace(VIEW, mode=FlightMode.OFFBOARD, mode_told=1), replace(HEARD, script=script)
    )
    assert after.stage is not GuardStage.LET_GO
    assert step(state, replace(view, mode_told=2), dead(script))[0].stage is GuardStage.LET_GO


LET_GO = GuardState(GuardStage.LET_GO, "a pilot changed the mode")
GONE = replace(HEARD, script=Script.LET_GO, beat_ns=NOW - 9 * S)


@pytest.mark.parametrize("mode", MOVING)
@pytest.mark.parametrize(
    ("state", "heard"), [(LET_GO, dead()), (LET_GO, None), (LET_GO, GONE), (GuardState(), GONE)]
)
def test_what_was_let_go_of_and_nobody_took_is_taken_back(
    state: GuardState, heard: ProgramBeat | None, mode: FlightMode
) -> None:
    begun, grace = state, RULES.mode_grace_s
    for passed_s, told in ((0.0, 1), (0.1, 2), (grace, 9)):
        now = NOW + ns(passed_s)
        state, act = step(
            state, replace(VIEW, mode=mode, mode_told=told, heartbeat_ns=now), heard, now
        )
        assert (state.stage, act) == (begun.stage, Act.NOTHING)
    now = NOW + ns(grace + 0.11)
    flickered, _ = step(
        state, replace(VIEW, mode=FlightMode.OTHER, mode_told=1, heartbeat_ns=now), heard, now
    )
    assert flickered.odd_ns is None
    state, act = step(state, replace(VIEW, mode=mode, heartbeat_ns=now), heard, now)
    assert (state.stage, act) == (GuardStage.HOLDING, Act.HOLD)
    assert "nobody flies it" in state.reason and begun.reason in state.reason


def test_a_script_that_still_flies_is_watched_again() -> None:
    state, _ = step(LET_GO)
    now = NOW + ns(RULES.mode_grace_s + 0.1)
    heard = replace(HEARD, beat_ns=now, setpoint_ns=now)
    assert step(state, replace(VIEW, heartbeat_ns=now), heard, now) == (GuardState(), Act.NOTHING)


def test_a_pilot_may_stop_the_landing_by_hold_too() -> None:
    assert later(COMING_DOWN, 0.5, FlightMode.HOLD)[0].stage is GuardStage.LET_GO
    # of the hold before it
    assert later(LANDING, 0.1, FlightMode.HOLD)[0].stage is GuardStage.LANDING


@pytest.mark.parametrize("mode", DOWN)
def test_a_vehicle_that_comes_down_by_another_s_will_is_left_to_it(mode: FlightMode) -> None:
    assert later(HELD, 0.5, mode) == (
        replace(HELD, stage=GuardStage.LET_GO, reason=later(HELD, 0.5, mode)[0].reason),
        Act.NOTHING,
    )
    # a hold that is on its way may still end that landing
    assert later(HOLDING, 0.5, mode) == (HOLDING, Act.NOTHING)
    assert later(HOLDING, RULES.confirm_s + 0.1, mode)[0].stage is GuardStage.LET_GO


@pytest.mark.parametrize("stage", GuardStage)
def test_whoever_disarms_has_ended_it(stage: GuardStage) -> None:
    state, act = step(replace(HELD, stage=stage), replace(VIEW, armed=False), dead())
    assert (state, act) == (GuardState(), Act.NOTHING)


def test_a_landing_that_was_seen_leaves_the_vehicle_to_whoever_ends_it() -> None:
    """By a hold, too; one that was never seen to land may be holding by the guard's own word."""
    state, act = at(
        GuardState(GuardStage.LANDING, "x", sent_ns=ago(0.3), tries=1),
        replace(VIEW, mode=FlightMode.LAND),
    )
    assert act is Act.NOTHING and state.shown_ns == NOW
    assert at(state, replace(VIEW, mode=FlightMode.HOLD))[0].stage is GuardStage.LET_GO
    unseen = GuardState(GuardStage.LANDING, "x", sent_ns=ago(0.3), tries=1)
    assert at(unseen, replace(VIEW, mode=FlightMode.HOLD)) == (unseen, Act.NOTHING)
    # said as the command was sent: not its doing
    old = replace(VIEW, mode=FlightMode.LAND, heartbeat_ns=ago(0.3))
    assert at(unseen, old)[0].shown_ns is None


def test_a_vehicle_taken_on_the_ground_is_told_to_land_as_often_as_the_rule_says() -> None:
    rules = replace(EXACT, land_tries=3)
    view, now, acts = replace(VIEW, in_air=False), NOW, list[Act]()
    state, act = decide(GuardState(), view, dead(for_s=9.0), now, rules, WHOLE)
    while state.stage is not GuardStage.GAVE_UP and now < NOW + 60 * S:
        acts.append(act)
        now += ns(0.6)
        state, act = decide(
            state, replace(view, heartbeat_ns=now), dead(for_s=9.0), now, rules, WHOLE
        )
    assert acts == 3 * [Act.LAND]


def test_the_reason_of_a_let_go_names_what_it_was_taken_for_only_if_it_was() -> None:
    pilot = replace(VIEW, mode=FlightMode.OTHER)
    assert at(view=pilot)[0].reason == "a pilot changed the mode"
    taken = GuardState(GuardStage.HOLDING, "battery at 10 %", sent_ns=ago(1.0))
    assert at(taken, pilot)[0].reason == "a pilot changed the mode (taken before: battery at 10 %)"
    home = replace(VIEW, mode=FlightMode.RETURN)
    assert at(view=home, heard=dead(for_s=9.0))[0].reason == "somebody else selected return"


def test_a_vehicle_that_holds_already_is_held_for_its_time_though_nothing_was_sent() -> None:
    """No answer is awaited: it is not landed early for want of one, by a guard that hears no newer
    heartbeat.
    """
    holding = replace(VIEW, mode=FlightMode.HOLD)
    state, act = step(view=holding, heard=dead())
    assert (state.stage, act) == (GuardStage.HOLDING, Act.NOTHING)
    acts = [
        step(state, holding, None, NOW + ns(after_s))[1]
        for after_s in (RULES.ack_s + 0.1, RULES.hold_s - 0.1)
    ]
    assert acts == [Act.NOTHING, Act.NOTHING]
    assert step(state, holding, None, NOW + ns(RULES.hold_s))[1] is Act.LAND
