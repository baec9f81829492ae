"""The guard's decision table, walked through whole, and what must hold whatever it sees."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import product

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.interfaces import FlightMode
from drivers.mavlink.guard.interfaces import GuardView, Hand, Script
from flight.guard.rules import Act, GuardRules, GuardStage, GuardState, Limits, ProgramBeat, decide

S = 1_000_000_000
NOW = 1000 * S
RULES = GuardRules()
LIMITS = Limits(fence_radius_m=25.0, fence_height_m=6.0, min_battery=0.2, separation_m=0.7)
VIEW = GuardView(NOW, NOW, True, True, FlightMode.OFFBOARD, (1.0, 2.0, -1.5), 0.9, None)
HEARD = ProgramBeat(NOW, Script.CONTROL, NOW)

FLOWN = (FlightMode.OFFBOARD, FlightMode.TAKEOFF, FlightMode.HOLD)
DOWN = (FlightMode.LAND, FlightMode.RETURN)
MOVING = (FlightMode.OFFBOARD, FlightMode.TAKEOFF)
FLIES = tuple(script for script in Script if script.flies)


def ns(seconds: float) -> int:
    return round(seconds * S)


def step(
    state: GuardState = GuardState(),  # noqa: B008 (frozen)
    view: GuardView | None = VIEW,
    heard: ProgramBeat | None = HEARD,
    now_ns: int = NOW,
    rules: GuardRules = RULES,
) -> tuple[GuardState, Act]:
    return decide(state, view, heard, now_ns, rules, LIMITS)


def dead(script: Script = Script.CONTROL, for_s: float = RULES.beat_age_s + 0.01) -> ProgramBeat:
    return ProgramBeat(NOW - ns(for_s), script, NOW - ns(for_s))


# --- the table: whose program is silent, in which mode ---------------------------------------------------------------


@pytest.mark.parametrize(
    ("script", "mode", "armed", "in_air"), [*product(Script, FlightMode, (True, False), (True, False))]
)
def test_a_silent_program_s_vehicle_is_taken_when_it_is_flown_and_never_else(
    script: Script, mode: FlightMode, armed: bool, in_air: bool
) -> None:
    state, act = step(view=replace(VIEW, mode=mode, armed=armed, in_air=in_air), heard=dead(script))
    if not (armed and script.flies):
        assert (state.stage, act) == (GuardStage.WATCHING, Act.NOTHING)
    elif mode not in FLOWN:
        assert (state.stage, act) == (GuardStage.LET_GO, Act.NOTHING)
    elif not in_air:
        assert (state.stage, act) == (GuardStage.LANDING, Act.LAND)
    else:
        expected = Act.NOTHING if mode is FlightMode.HOLD else Act.HOLD  # it holds already
        assert (state.stage, act) == (GuardStage.HOLDING, expected)
        assert "no sign of life" in state.reason


@pytest.mark.parametrize(("script", "mode"), [*product(Script, FlightMode)])
def test_a_living_program_within_its_limits_is_left_alone(script: Script, mode: FlightMode) -> None:
    state, act = step(view=replace(VIEW, mode=mode), heard=replace(HEARD, script=script))
    assert act is Act.NOTHING
    by_a_pilot = script.flies and mode is FlightMode.OTHER
    assert state.stage is (GuardStage.LET_GO if by_a_pilot else GuardStage.WATCHING)


ODD = {
    Script.CLIMB: {FlightMode.LAND, FlightMode.RETURN},
    Script.CONTROL: {FlightMode.HOLD, FlightMode.TAKEOFF, FlightMode.LAND, FlightMode.RETURN},
    Script.LANDING: set[FlightMode](),
}


@pytest.mark.parametrize(("script", "mode"), [*product(FLIES, FLOWN + DOWN)])
def test_a_mode_the_script_does_not_fly_is_somebody_else_s_after_a_grace(script: Script, mode: FlightMode) -> None:
    state, view = GuardState(), replace(VIEW, mode=mode)
    for passed_s in (0.0, RULES.mode_grace_s - 0.01, RULES.mode_grace_s + 0.01):
        now = NOW + ns(passed_s)
        heard = ProgramBeat(now, script, now)
        state, act = step(state, replace(view, heartbeat_ns=now), heard, now)
        assert act is Act.NOTHING
        late = passed_s > RULES.mode_grace_s
        assert state.stage is (GuardStage.LET_GO if late and mode in ODD[script] else GuardStage.WATCHING)


def test_the_beat_may_be_as_old_as_the_rule_says_and_no_older() -> None:
    assert step(heard=dead(for_s=RULES.beat_age_s - 0.001))[1] is Act.NOTHING
    assert step(heard=dead(for_s=RULES.beat_age_s + 0.001))[1] is Act.HOLD


def test_a_program_that_lives_but_sends_no_setpoints_loses_the_vehicle() -> None:
    gap = replace(HEARD, setpoint_ns=NOW - ns(RULES.setpoint_gap_s + 0.01))
    state, act = step(heard=gap)
    assert (state.stage, act) == (GuardStage.HOLDING, Act.HOLD)
    assert "no setpoint" in state.reason
    assert step(heard=replace(gap, script=Script.CLIMB))[1] is Act.NOTHING  # none are due yet
    assert step(replace(GuardState()), replace(VIEW, mode=FlightMode.HOLD), gap)[1] is Act.NOTHING


@pytest.mark.parametrize(
    ("view", "heard", "said"),
    [
        (replace(VIEW, position_n_m=(20.0, 16.0, -1.0)), HEARD, "fence"),
        (replace(VIEW, position_n_m=(0.0, 0.0, -6.1)), HEARD, "fence"),
        (replace(VIEW, position_n_m=(math.nan, 0.0, -1.0)), HEARD, "fence"),
        (replace(VIEW, battery=0.19), HEARD, "battery"),
        (VIEW, replace(HEARD, separation_m=0.69, separation_ns=NOW), "as measured"),
    ],
)
def test_a_limit_that_stays_broken_takes_the_vehicle(view: GuardView, heard: ProgramBeat, said: str) -> None:
    state, act = step(view=view, heard=heard)
    assert (state.stage, act) == (GuardStage.WATCHING, Act.NOTHING)  # the script is given time
    late = NOW + ns(RULES.patience_s + 0.01)
    separation_ns = late if heard.separation_ns else 0
    heard = replace(heard, beat_ns=late, setpoint_ns=late, separation_ns=separation_ns)
    recovered, _ = step(state, replace(VIEW, heartbeat_ns=late), replace(heard, separation_m=2.0), late)
    assert recovered.broken_ns is None
    state, act = step(state, replace(view, heartbeat_ns=late), heard, late)
    assert (state.stage, act) == (GuardStage.HOLDING, Act.HOLD)
    assert said in state.reason


def test_positions_count_as_far_as_they_can_be_trusted() -> None:
    near = replace(HEARD, peer_n_m=(1.0, 2.1, -1.5))
    exact, coarse = replace(RULES, position_error_m=0.1), RULES
    assert step(heard=near, rules=exact)[0].broken_ns == NOW
    assert step(heard=near, rules=coarse)[0].broken_ns is None
    assert step(heard=replace(near, peer_n_m=(math.nan, 2.1, -1.5)), rules=exact)[0].broken_ns is None
    old = replace(HEARD, separation_m=0.1, separation_ns=NOW - S)
    assert step(heard=old)[0].broken_ns is None


# --- once it is taken ------------------------------------------------------------------------------------------------

HOLDING = GuardState(GuardStage.HOLDING, "why", sent_ns=NOW)
HELD = replace(HOLDING, shown_ns=NOW)
LANDING = GuardState(GuardStage.LANDING, "why", sent_ns=NOW, tries=1)
COMING_DOWN = replace(LANDING, shown_ns=NOW)


def later(state: GuardState, seconds: float, mode: FlightMode, acked: bool | None = None) -> tuple[GuardState, Act]:
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
def test_a_script_that_wakes_up_and_takes_control_is_landed(taken: GuardState, mode: FlightMode) -> None:
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
def test_one_message_alone_lets_nobody_go_and_nothing_is_sent_against_it(state: GuardState, script: Script) -> None:
    view = replace(VIEW, mode=FlightMode.OTHER, mode_told=1)
    after, act = step(state, view, dead(script))
    assert act is Act.NOTHING and after.stage is state.stage
    after, act = step(after, replace(VIEW, mode=FlightMode.OFFBOARD, mode_told=1), replace(HEARD, script=script))
    assert after.stage is not GuardStage.LET_GO
    assert step(state, replace(view, mode_told=2), dead(script))[0].stage is GuardStage.LET_GO


LET_GO = GuardState(GuardStage.LET_GO, "a pilot changed the mode")
GONE = replace(HEARD, script=Script.LET_GO, beat_ns=NOW - 9 * S)


@pytest.mark.parametrize("mode", MOVING)
@pytest.mark.parametrize(("state", "heard"), [(LET_GO, dead()), (LET_GO, None), (LET_GO, GONE), (GuardState(), GONE)])
def test_what_was_let_go_of_and_nobody_took_is_taken_back(
    state: GuardState, heard: ProgramBeat | None, mode: FlightMode
) -> None:
    begun, grace = state, RULES.mode_grace_s
    for passed_s, told in ((0.0, 1), (0.1, 2), (grace, 9)):
        now = NOW + ns(passed_s)
        state, act = step(state, replace(VIEW, mode=mode, mode_told=told, heartbeat_ns=now), heard, now)
        assert (state.stage, act) == (begun.stage, Act.NOTHING)
    now = NOW + ns(grace + 0.11)
    flickered, _ = step(state, replace(VIEW, mode=FlightMode.OTHER, mode_told=1, heartbeat_ns=now), heard, now)
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
    assert later(LANDING, 0.1, FlightMode.HOLD)[0].stage is GuardStage.LANDING  # of the hold before it


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


@pytest.mark.parametrize("stage", GuardStage)
def test_a_vehicle_that_is_not_seen_is_told_nothing(stage: GuardStage) -> None:
    state = replace(HELD, stage=stage)
    blind = replace(VIEW, heartbeat_ns=NOW - ns(RULES.blind_s + 0.1))
    assert step(state, blind, dead(for_s=9.0)) == (state, Act.NOTHING)
    assert step(state, None, dead(for_s=9.0)) == (state, Act.NOTHING)


def test_whose_the_vehicle_is() -> None:
    hands = {stage: replace(HELD, stage=stage).hand(Script.CONTROL, armed=True) for stage in GuardStage}
    assert hands == {
        GuardStage.WATCHING: Hand.SCRIPT,
        GuardStage.HOLDING: Hand.GUARD,
        GuardStage.LANDING: Hand.GUARD,
        GuardStage.GAVE_UP: Hand.GUARD,
        GuardStage.LET_GO: Hand.OTHER,
    }
    assert GuardState().hand(Script.CONTROL, armed=False) is Hand.FREE
    assert GuardState().hand(Script.LET_GO, armed=True) is Hand.FREE


@pytest.mark.parametrize("name", ["beat_age_s", "setpoint_gap_s", "ack_s", "confirm_s", "blind_s", "answer_age_s"])
def test_rules_without_time_are_refused(name: str) -> None:
    with pytest.raises(ValueError, match=name):
        replace(RULES, **{name: 0.0})
    with pytest.raises(ValueError, match="land_tries"):
        GuardRules(land_tries=0)


# --- whatever it sees ------------------------------------------------------------------------------------------------

AGES_S = st.floats(0.0, 4.0)
VIEWS = st.builds(
    GuardView,
    heartbeat_ns=AGES_S.map(lambda age_s: NOW - ns(age_s)),
    position_ns=st.just(NOW),
    armed=st.booleans(),
    in_air=st.booleans(),
    mode=st.sampled_from(FlightMode),
    position_n_m=st.tuples(*[st.floats(-40.0, 40.0) | st.just(math.nan)] * 3),
    battery=st.floats(0.0, 1.0) | st.just(math.nan),
    acked=st.none() | st.booleans(),
    mode_told=st.integers(1, 3),
)
HEARDS = st.builds(
    ProgramBeat,
    beat_ns=AGES_S.map(lambda age_s: NOW - ns(age_s)),
    script=st.sampled_from(Script),
    setpoint_ns=AGES_S.map(lambda age_s: NOW - ns(age_s)),
    separation_m=st.floats(0.0, 3.0) | st.just(math.nan),
    separation_ns=st.just(NOW),
    peer_n_m=st.just((math.nan,) * 3),
)
STATES = st.builds(
    GuardState,
    stage=st.sampled_from(GuardStage),
    reason=st.just("why"),
    sent_ns=AGES_S.map(lambda age_s: NOW - ns(age_s)),
    shown_ns=st.none() | AGES_S.map(lambda age_s: NOW - ns(age_s)),
    tries=st.integers(0, 12),
    broken_ns=st.none() | AGES_S.map(lambda age_s: NOW - ns(age_s)),
    odd_ns=st.none() | AGES_S.map(lambda age_s: NOW - ns(age_s)),
)


@settings(max_examples=400)
@given(STATES, VIEWS, HEARDS | st.none())
def test_whatever_it_sees(state: GuardState, view: GuardView, heard: ProgramBeat | None) -> None:
    after, act = step(state, view, heard)
    if act is not Act.NOTHING:
        assert view.armed
        assert view.mode is not FlightMode.OTHER  # never against a pilot
        assert state.stage is not GuardStage.GAVE_UP
        assert state.stage is not GuardStage.LET_GO or (view.mode in MOVING and view.mode_told > 1)  # nobody's
        assert after.sent_ns == NOW and after.shown_ns is None
        assert NOW - view.heartbeat_ns <= ns(RULES.blind_s)
    if act is Act.HOLD:
        let_go = state.stage is GuardStage.LET_GO or (heard is not None and heard.script is Script.LET_GO)
        assert let_go or (state.stage is GuardStage.WATCHING and heard is not None and heard.script.flies)
    if act is Act.LAND:
        assert after.stage is GuardStage.LANDING and after.tries <= RULES.land_tries
        assert view.mode not in (FlightMode.LAND, FlightMode.RETURN) or state.stage is GuardStage.LANDING
    if state.stage is GuardStage.LET_GO and view.armed and view.mode not in MOVING:
        assert replace(after, odd_ns=None) == replace(state, odd_ns=None)
    if after.stage is GuardStage.LET_GO and state.stage is not GuardStage.LET_GO:
        assert view.mode_told > 1
    if heard is None and state.stage is GuardStage.WATCHING:
        assert after.stage is GuardStage.WATCHING


@settings(max_examples=200)
@given(st.lists(st.sampled_from(FLOWN), min_size=60, max_size=60))
def test_however_a_dead_script_s_vehicle_behaves_it_is_told_to_land_in_bounded_time(modes: list[FlightMode]) -> None:
    """Modes that only a script would select, in any order, at 10 Hz: taken at once, landed soon, not told for ever."""
    state, acts = GuardState(), list[tuple[float, Act]]()
    for k, mode in enumerate(modes):
        now = NOW + ns(0.1 * k)
        state, act = step(state, replace(VIEW, mode=mode, heartbeat_ns=now), dead(), now)
        acts += [] if act is Act.NOTHING else [(0.1 * k, act)]
        assert state.stage is not GuardStage.WATCHING
        if state.stage in (GuardStage.LET_GO, GuardStage.GAVE_UP):
            break
    landings = [at_s for at_s, act in acts if act is Act.LAND]
    assert sum(act is Act.HOLD for _, act in acts) <= 1
    assert landings and landings[0] <= RULES.confirm_s + RULES.hold_s + 0.2
    assert len(landings) <= RULES.land_tries


def test_a_limit_that_is_broken_again_after_a_landing_was_begun_has_its_patience_again() -> None:
    low = replace(VIEW, battery=0.1)
    state, _ = step(view=low)
    assert state.broken_ns == NOW
    landing = ProgramBeat(NOW + 1, Script.LANDING, NOW + 1)
    state, _ = step(state, replace(low, mode=FlightMode.LAND, heartbeat_ns=NOW + 1), landing, NOW + 1)
    assert (state.stage, state.broken_ns) == (GuardStage.WATCHING, None)


# --- every bound to the nanosecond -----------------------------------------------------------------------------------

EXACT = GuardRules(
    beat_age_s=0.5, setpoint_gap_s=0.25, patience_s=0.5, hold_s=2.0, ack_s=0.5, confirm_s=1.5, blind_s=2.5,
    mode_grace_s=1.0, position_error_m=0.5,
)  # fmt: skip
WHOLE = Limits(fence_radius_m=5.0, fence_height_m=6.0, min_battery=0.25, separation_m=1.0)


def at(
    state: GuardState = GuardState(),  # noqa: B008 (frozen)
    view: GuardView = VIEW,
    heard: ProgramBeat = HEARD,
) -> tuple[GuardState, Act]:
    return decide(state, view, heard, NOW, EXACT, WHOLE)


def ago(seconds: float, more_ns: int = 0) -> int:
    return NOW - ns(seconds) - more_ns


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


def test_a_landing_that_was_seen_leaves_the_vehicle_to_whoever_ends_it() -> None:
    """By a hold, too; one that was never seen to land may be holding by the guard's own word."""
    state, act = at(GuardState(GuardStage.LANDING, "x", sent_ns=ago(0.3), tries=1), replace(VIEW, mode=FlightMode.LAND))
    assert act is Act.NOTHING and state.shown_ns == NOW
    assert at(state, replace(VIEW, mode=FlightMode.HOLD))[0].stage is GuardStage.LET_GO
    unseen = GuardState(GuardStage.LANDING, "x", sent_ns=ago(0.3), tries=1)
    assert at(unseen, replace(VIEW, mode=FlightMode.HOLD)) == (unseen, Act.NOTHING)
    old = replace(VIEW, mode=FlightMode.LAND, heartbeat_ns=ago(0.3))  # said as the command was sent: not its doing
    assert at(unseen, old)[0].shown_ns is None


def test_a_vehicle_taken_on_the_ground_is_told_to_land_as_often_as_the_rule_says() -> None:
    rules = replace(EXACT, land_tries=3)
    view, now, acts = replace(VIEW, in_air=False), NOW, list[Act]()
    state, act = decide(GuardState(), view, dead(for_s=9.0), now, rules, WHOLE)
    while state.stage is not GuardStage.GAVE_UP and now < NOW + 60 * S:
        acts.append(act)
        now += ns(0.6)
        state, act = decide(state, replace(view, heartbeat_ns=now), dead(for_s=9.0), now, rules, WHOLE)
    assert acts == 3 * [Act.LAND]


def test_the_reason_of_a_let_go_names_what_it_was_taken_for_only_if_it_was() -> None:
    pilot = replace(VIEW, mode=FlightMode.OTHER)
    assert at(view=pilot)[0].reason == "a pilot changed the mode"
    taken = GuardState(GuardStage.HOLDING, "battery at 10 %", sent_ns=ago(1.0))
    assert at(taken, pilot)[0].reason == "a pilot changed the mode (taken before: battery at 10 %)"
    home = replace(VIEW, mode=FlightMode.RETURN)
    assert at(view=home, heard=dead(for_s=9.0))[0].reason == "somebody else selected return"


def test_a_vehicle_that_holds_already_is_held_for_its_time_though_nothing_was_sent() -> None:
    """No answer is awaited: it is not landed early for want of one, by a guard that hears no newer heartbeat."""
    holding = replace(VIEW, mode=FlightMode.HOLD)
    state, act = step(view=holding, heard=dead())
    assert (state.stage, act) == (GuardStage.HOLDING, Act.NOTHING)
    acts = [step(state, holding, None, NOW + ns(after_s))[1] for after_s in (RULES.ack_s + 0.1, RULES.hold_s - 0.1)]
    assert acts == [Act.NOTHING, Act.NOTHING]
    assert step(state, holding, None, NOW + ns(RULES.hold_s))[1] is Act.LAND
