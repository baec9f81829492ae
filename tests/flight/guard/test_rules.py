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
from flight.guard.rules import Act, GuardRules, GuardStage, GuardState, ProgramBeat
from tests.flight.guard.guard_views import (
    DOWN,
    HEARD,
    HELD,
    MOVING,
    NOW,
    RULES,
    VIEW,
    S,
    dead,
    ns,
    step,
)

FLOWN = (FlightMode.OFFBOARD, FlightMode.TAKEOFF, FlightMode.HOLD)
FLIES = tuple(script for script in Script if script.flies)


# --- the table: whose program is silent, in which mode


@pytest.mark.parametrize(
    ("script", "mode", "armed", "in_air"),
    [*product(Script, FlightMode, (True, False), (True, False))],
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
def test_a_mode_the_script_does_not_fly_is_somebody_else_s_after_a_grace(
    script: Script, mode: FlightMode
) -> None:
    state, view = GuardState(), replace(VIEW, mode=mode)
    for passed_s in (0.0, RULES.mode_grace_s - 0.01, RULES.mode_grace_s + 0.01):
        now = NOW + ns(passed_s)
        heard = ProgramBeat(now, script, now)
        state, act = step(state, replace(view, heartbeat_ns=now), heard, now)
        assert act is Act.NOTHING
        late = passed_s > RULES.mode_grace_s
        assert state.stage is (
            GuardStage.LET_GO if late and mode in ODD[script] else GuardStage.WATCHING
        )


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
def test_a_limit_that_stays_broken_takes_the_vehicle(
    view: GuardView, heard: ProgramBeat, said: str
) -> None:
    state, act = step(view=view, heard=heard)
    assert (state.stage, act) == (GuardStage.WATCHING, Act.NOTHING)  # the script is given time
    late = NOW + ns(RULES.patience_s + 0.01)
    separation_ns = late if heard.separation_ns else 0
    heard = replace(heard, beat_ns=late, setpoint_ns=late, separation_ns=separation_ns)
    recovered, _ = step(
        state, replace(VIEW, heartbeat_ns=late), replace(heard, separation_m=2.0), late
    )
    assert recovered.broken_ns is None
    state, act = step(state, replace(view, heartbeat_ns=late), heard, late)
    assert (state.stage, act) == (GuardStage.HOLDING, Act.HOLD)
    assert said in state.reason


def test_positions_count_as_far_as_they_can_be_trusted() -> None:
    near = replace(HEARD, peer_n_m=(1.0, 2.1, -1.5))
    exact, coarse = replace(RULES, position_error_m=0.1), RULES
    assert step(heard=near, rules=exact)[0].broken_ns == NOW
    assert step(heard=near, rules=coarse)[0].broken_ns is None
    assert (
        step(heard=replace(near, peer_n_m=(math.nan, 2.1, -1.5)), rules=exact)[0].broken_ns is None
    )
    old = replace(HEARD, separation_m=0.1, separation_ns=NOW - S)
    assert step(heard=old)[0].broken_ns is None


@pytest.mark.parametrize("stage", GuardStage)
def test_a_vehicle_that_is_not_seen_is_told_nothing(stage: GuardStage) -> None:
    state = replace(HELD, stage=stage)
    blind = replace(VIEW, heartbeat_ns=NOW - ns(RULES.blind_s + 0.1))
    assert step(state, blind, dead(for_s=9.0)) == (state, Act.NOTHING)
    assert step(state, None, dead(for_s=9.0)) == (state, Act.NOTHING)


def test_whose_the_vehicle_is() -> None:
    hands = {
        stage: replace(HELD, stage=stage).hand(Script.CONTROL, armed=True) for stage in GuardStage
    }
    assert hands == {
        GuardStage.WATCHING: Hand.SCRIPT,
        GuardStage.HOLDING: Hand.GUARD,
        GuardStage.LANDING: Hand.GUARD,
        GuardStage.GAVE_UP: Hand.GUARD,
        GuardStage.LET_GO: Hand.OTHER,
    }
    assert GuardState().hand(Script.CONTROL, armed=False) is Hand.FREE
    assert GuardState().hand(Script.LET_GO, armed=True) is Hand.FREE


@pytest.mark.parametrize(
    "name", ["beat_age_s", "setpoint_gap_s", "ack_s", "confirm_s", "blind_s", "answer_age_s"]
)
def test_rules_without_time_are_refused(name: str) -> None:
    with pytest.raises(ValueError, match=name):
        replace(RULES, **{name: 0.0})
    with pytest.raises(ValueError, match="land_tries"):
        GuardRules(land_tries=0)


# --- whatever it sees

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
        # nobody's
        assert state.stage is not GuardStage.LET_GO or (view.mode in MOVING and view.mode_told > 1)
        assert after.sent_ns == NOW and after.shown_ns is None
        assert NOW - view.heartbeat_ns <= ns(RULES.blind_s)
    if act is Act.HOLD:
        let_go = state.stage is GuardStage.LET_GO or (
            heard is not None and heard.script is Script.LET_GO
        )
        assert let_go or (
            state.stage is GuardStage.WATCHING and heard is not None and heard.script.flies
        )
    if act is Act.LAND:
        assert after.stage is GuardStage.LANDING and after.tries <= RULES.land_tries
        assert (
            view.mode not in (FlightMode.LAND, FlightMode.RETURN)
            or state.stage is GuardStage.LANDING
        )
    if state.stage is GuardStage.LET_GO and view.armed and view.mode not in MOVING:
        assert replace(after, odd_ns=None) == replace(state, odd_ns=None)
    if after.stage is GuardStage.LET_GO and state.stage is not GuardStage.LET_GO:
        assert view.mode_told > 1
    if heard is None and state.stage is GuardStage.WATCHING:
        assert after.stage is GuardStage.WATCHING


@settings(max_examples=200)
@given(st.lists(st.sampled_from(FLOWN), min_size=60, max_size=60))
def test_however_a_dead_script_s_vehicle_behaves_it_is_told_to_land_in_bounded_time(
    modes: list[FlightMode],
) -> None:
    """Modes that only a script would select, in any order, at 10 Hz: taken at once, landed soon,
    not told for ever.
    """
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
    state, _ = step(
        state, replace(low, mode=FlightMode.LAND, heartbeat_ns=NOW + 1), landing, NOW + 1
    )
    assert (state.stage, state.broken_ns) == (GuardStage.WATCHING, None)
