"""The rules of the guard: what it saw and heard goes in, what it does comes out. No I/O and no
clock.

A vehicle that a script flies is taken from it when the script's program falls silent, when
setpoints stop, or when a limit stays broken although the script had time to react: first hold, then
land. Whoever else changes the mode has won: the guard then does nothing until the vehicle is
disarmed, or is back in a mode that only scripts fly while none does.
"""

from __future__ import annotations

import math
from dataclasses import replace
from enum import Enum
from typing import Annotated

from drivers.interfaces import SURE, FlightMode
from drivers.mavlink.guard.interfaces import GuardView, Hand, Script, Vec3
from flight.fence import Fence
from flight.guard.battery import battery_trouble
from path.bounds import Bounds
from path.values import frozen, value

_FLOWN = frozenset({FlightMode.OFFBOARD, FlightMode.TAKEOFF, FlightMode.HOLD})
_MOVING = frozenset({FlightMode.OFFBOARD, FlightMode.TAKEOFF})
_DOWN = frozenset({FlightMode.LAND, FlightMode.RETURN})
_EXPECTED = {
    # a take-off ends in HOLD by itself (PX4), or begins in what shows as OFFBOARD (ArduPilot's
    # GUIDED)
    Script.CLIMB: _FLOWN,
    Script.CONTROL: frozenset({FlightMode.OFFBOARD}),
    Script.LANDING: _FLOWN | _DOWN,
}


@frozen
class GuardRules:
    """The ``[mission.guard_process]`` table of a rig. Limits of place, battery and distance are
    those of the mission.

    Attributes:
        beat_age_s: the role's program is taken for dead or hung when its newest beat is older.
        setpoint_gap_s: the same for setpoints while it has control; below PX4's COM_OF_LOSS_T.
        patience_s: a limit is broken for this long before the guard acts: the script acts at once,
            and knows more.
        hold_s: from the hold to the landing.
        ack_s: a command without an answer for this long is followed by the next stronger one.
        confirm_s: the same for a command that was accepted and is not seen in telemetry; PX4's
            heartbeat is at 1 Hz.
        land_tries: how often the landing is commanded before the guard gives up.
        blind_s: what was last seen of the vehicle counts for this long; then nothing is sent.
        answer_age_s: a role whose guard is silent for this long ends its mission.
        mode_grace_s: a mode that the script does not fly is somebody else's after this time;
            telemetry may be late. So long, too, a vehicle that was let go of stays in a mode that
            only scripts fly before the guard takes it.
        position_error_m: of the distance between the drones by their own positions. At or above the
            smallest separation, that distance says nothing and is not looked at; the one measured
            on the marker always is.
    """

    beat_age_s: Annotated[float, Bounds(0.05, 10.0)] = 0.4
    setpoint_gap_s: Annotated[float, Bounds(0.05, 10.0)] = 0.4
    patience_s: Annotated[float, Bounds(0.0, 10.0)] = 0.5
    hold_s: Annotated[float, Bounds(0.0, 60.0)] = 2.0
    ack_s: Annotated[float, Bounds(0.05, 10.0)] = 0.5
    confirm_s: Annotated[float, Bounds(0.05, 10.0)] = 1.5
    land_tries: Annotated[int, Bounds(1, 100, "times")] = 10
    blind_s: Annotated[float, Bounds(0.1, 60.0)] = 2.5
    answer_age_s: Annotated[float, Bounds(0.05, 60.0)] = 1.0
    mode_grace_s: Annotated[float, Bounds(0.0, 30.0)] = 1.2
    position_error_m: Annotated[float, Bounds(0.0, 100.0)] = 2.0

    def __post_init__(self) -> None:
        times = ("beat_age_s", "setpoint_gap_s", "ack_s", "confirm_s", "blind_s", "answer_age_s")
        for name in times:
            if getattr(self, name) <= 0.0:
                raise ValueError(f"{name} must be positive")
        if self.land_tries < 1:
            raise ValueError("land_tries must be at least 1")


@frozen
class Limits:
    """The limits that the mission sets (``[mission.guard]`` and ``[mission.separation]``)."""

    fence: Fence
    min_battery: float
    separation_m: float


@value
class ProgramBeat:
    """The newest of the role's program; stamps are arrivals on the guard's clock.

    Attributes:
        setpoint_ns: when the count of setpoints last grew, or control began.
        separation_m: as measured by the role at ``separation_ns``.
        peer_n_m: the other drone's place, by the role's link or the guard's own; NaN when it is not
            known.
    """

    beat_ns: int
    script: Script
    setpoint_ns: int
    separation_m: float = math.nan
    separation_ns: int = 0
    peer_n_m: Vec3 = (math.nan, math.nan, math.nan)


class Act(Enum):
    """The command that the guard sends, now and once."""

    NOTHING = "nothing"
    HOLD = "hold"
    LAND = "land"


class GuardStage(Enum):
    WATCHING = "watching"
    HOLDING = "holding"
    LANDING = "landing"
    LET_GO = "let go"  # the vehicle is somebody else's
    GAVE_UP = "gave up"  # it does not land though it was told to often enough


_HANDS = {
    GuardStage.HOLDING: Hand.GUARD,
    GuardStage.LANDING: Hand.GUARD,
    GuardStage.GAVE_UP: Hand.GUARD,
    GuardStage.LET_GO: Hand.OTHER,
}


@value
class GuardState:
    """The state of the guard.

    Attributes:
        reason: why the vehicle was taken, or let go of.
        sent_ns: when the newest command was sent.
        shown_ns: when telemetry first showed what was commanded.
        tries: landings commanded.
        broken_ns: since when a limit is broken.
        odd_ns: since when the mode is none that the script flies; of what was let go of, one that
            only scripts fly.
    """

    stage: GuardStage = GuardStage.WATCHING
    reason: str = ""
    sent_ns: int = 0
    shown_ns: int | None = None
    tries: int = 0
    broken_ns: int | None = None
    odd_ns: int | None = None

    def hand(self, script: Script, armed: bool) -> Hand:
        """Return whose the vehicle is."""
        if self.stage is GuardStage.WATCHING:
            return Hand.SCRIPT if armed and script.flies else Hand.FREE
        return _HANDS[self.stage]


def decide(
    state: GuardState,
    view: GuardView | None,
    heard: ProgramBeat | None,
    now_ns: int,
    rules: GuardRules,
    limits: Limits,
) -> tuple[GuardState, Act]:
    """One tick of the guard.

    Args:
        state: from the last tick.
        view: of the vehicle; None before it was ever heard.
        heard: of the role's program; None before it was ever heard.
        now_ns: guard's clock.

    Returns:
        The next state, and what is to be sent.
    """
    if view is None or _s(now_ns - view.heartbeat_ns) > rules.blind_s:
        return state, Act.NOTHING
    if not view.armed:
        return GuardState(), Act.NOTHING
    return _armed(state, view, heard, now_ns, rules, limits)


def _armed(
    state: GuardState,
    view: GuardView,
    heard: ProgramBeat | None,
    now_ns: int,
    rules: GuardRules,
    limits: Limits,
) -> tuple[GuardState, Act]:
    match state.stage:
        case GuardStage.HOLDING:
            return _hold(state, view, now_ns, rules)
        case GuardStage.LANDING:
            return _land(state, view, now_ns, rules)
        case GuardStage.WATCHING if heard is not None and heard.script.flies:
            return _watch(state, view, heard, now_ns, rules, limits)
        case _ if was_let_go(state, heard):
            return _let_go_of(state, view, heard, now_ns, rules)
        case _:
            return state, Act.NOTHING


def was_let_go(state: GuardState, heard: ProgramBeat | None) -> bool:
    """Return whether the vehicle was let go of, by the guard or by the script."""
    by_script = (
        state.stage is GuardStage.WATCHING and heard is not None and heard.script is Script.LET_GO
    )
    return by_script or state.stage is GuardStage.LET_GO


def _s(duration_ns: int) -> float:
    return duration_ns * 1e-9


# --- while the script flies


def _watch(
    state: GuardState,
    view: GuardView,
    heard: ProgramBeat,
    now_ns: int,
    rules: GuardRules,
    limits: Limits,
) -> tuple[GuardState, Act]:
    odd_ns = None if view.mode in _EXPECTED[heard.script] else _since(state.odd_ns, now_ns)
    if odd_ns != state.odd_ns:
        state = replace(state, odd_ns=odd_ns)
    dead_s = _s(now_ns - heard.beat_ns)
    if _somebody_else(state, view, heard, now_ns, rules):
        return _let_go(state, view)
    if view.mode not in _FLOWN:  # on its way down, as the script wants it
        return replace(state, broken_ns=None), Act.NOTHING
    broken = broken_limit(view, heard, now_ns, rules, limits)
    broken_ns = _since(state.broken_ns, now_ns) if broken else None
    gap_s = _s(now_ns - heard.setpoint_ns)
    reason = ""
    if dead_s > rules.beat_age_s:
        reason = f"no sign of life from the role's program for {dead_s:.2f} s"
    elif (
        heard.script is Script.CONTROL
        and view.mode is FlightMode.OFFBOARD
        and gap_s > rules.setpoint_gap_s
    ):
        reason = f"no setpoint for {gap_s:.2f} s"
    elif broken_ns is not None and _s(now_ns - broken_ns) >= rules.patience_s:
        reason = broken
    if broken_ns != state.broken_ns:
        state = replace(state, broken_ns=broken_ns)
    return _take(view, now_ns, reason) if reason else (state, Act.NOTHING)


def _somebody_else(
    state: GuardState, view: GuardView, heard: ProgramBeat, now_ns: int, rules: GuardRules
) -> bool:
    """Return whether the mode is somebody else's doing than the script's.

    A dead program's vehicle may be held by the autopilot's own failsafe: there is nobody to leave
    it to. One that comes down without a script comes down by somebody's will.
    """
    if _s(now_ns - heard.beat_ns) > rules.beat_age_s:
        return view.mode is FlightMode.OTHER or view.mode in _DOWN
    odd_s = 0.0 if state.odd_ns is None else _s(now_ns - state.odd_ns)
    return view.mode is FlightMode.OTHER or odd_s > rules.mode_grace_s


def _since(before_ns: int | None, now_ns: int) -> int:
    return now_ns if before_ns is None else before_ns


def broken_limit(
    view: GuardView, heard: ProgramBeat, now_ns: int, rules: GuardRules, limits: Limits
) -> str:
    """The limit that is broken, in words; empty when none is. A NaN place breaks one."""
    north, east, down = view.position_n_m
    if not limits.fence.holds(view.position_n_m):
        return f"outside the fence at ({north:.1f}, {east:.1f}) m, height {-down:.1f} m"
    battery = battery_trouble(view.battery, view.battery_ns, now_ns, limits.min_battery)
    if battery:
        return battery
    if (
        _s(now_ns - heard.separation_ns) <= rules.beat_age_s
        and heard.separation_m < limits.separation_m
    ):
        return f"separation {heard.separation_m:.2f} m, as measured, is below {limits.separation_m:.2f} m"
    apart_m = math.dist(view.position_n_m, heard.peer_n_m)
    if apart_m < limits.separation_m - rules.position_error_m:
        return f"separation {apart_m:.2f} m by the drones' positions"
    return ""


def flown_by_scripts_alone(view: GuardView) -> bool:
    """Return whether more than one message says that the vehicle is in a mode that no person
    flies.
    """
    return view.mode in _MOVING and view.mode_told >= SURE


def _let_go_of(
    state: GuardState, view: GuardView, heard: ProgramBeat | None, now_ns: int, rules: GuardRules
) -> tuple[GuardState, Act]:
    """Decide on a vehicle that somebody else has, or seemed to have.

    What is in a script's mode again is flown by the living script, or by nobody, and then it is
    taken.
    """
    if not flown_by_scripts_alone(view):
        return replace(state, odd_ns=None), Act.NOTHING
    state = replace(state, odd_ns=_since(state.odd_ns, now_ns))
    if _s(now_ns - _since(state.odd_ns, now_ns)) <= rules.mode_grace_s:
        return state, Act.NOTHING
    if heard is not None and heard.script.flies and _s(now_ns - heard.beat_ns) <= rules.beat_age_s:
        return GuardState(), Act.NOTHING
    why = f" ({state.reason})" if state.reason else ""
    return _take(view, now_ns, f"let go of{why}, and in mode {view.mode.value}: nobody flies it")


def _let_go(state: GuardState, view: GuardView) -> tuple[GuardState, Act]:
    """One packet's word is not enough, but nothing is sent against it either."""
    if view.mode_told < SURE:
        return state, Act.NOTHING
    who = (
        "a pilot changed the mode"
        if view.mode is FlightMode.OTHER
        else f"somebody else selected {view.mode.value}"
    )
    why = f"{who} (taken before: {state.reason})" if state.reason else who
    return replace(state, stage=GuardStage.LET_GO, reason=why, odd_ns=None), Act.NOTHING


# --- once it is taken


def _take(view: GuardView, now_ns: int, reason: str) -> tuple[GuardState, Act]:
    if not view.in_air:  # a landing disarms, a hold on the ground does not
        return GuardState(GuardStage.LANDING, reason, sent_ns=now_ns, tries=1), Act.LAND
    taken = GuardState(GuardStage.HOLDING, reason, sent_ns=now_ns)
    if view.mode is FlightMode.HOLD:
        return replace(taken, shown_ns=now_ns), Act.NOTHING
    return taken, Act.HOLD


def _hold(
    state: GuardState, view: GuardView, now_ns: int, rules: GuardRules
) -> tuple[GuardState, Act]:
    if (
        state.shown_ns is None
        and view.mode is FlightMode.HOLD
        and view.heartbeat_ns > state.sent_ns
    ):
        state = replace(state, shown_ns=now_ns)
    if view.mode in _DOWN:
        # Until the hold is known to have been carried out it may still come, and end the landing
        # that is seen.
        settled = state.shown_ns is not None or _s(now_ns - state.sent_ns) > rules.confirm_s
        return _let_go(state, view) if settled else (state, Act.NOTHING)
    if view.mode is FlightMode.OTHER:
        return _let_go(state, view)
    if state.shown_ns is None:
        over = _unanswered(state, view, now_ns, rules)
    else:  # a script that is back in control does not know yet
        over = (
            view.mode in _MOVING or not view.in_air or _s(now_ns - state.shown_ns) >= rules.hold_s
        )
    return _command_landing(state, now_ns, rules) if over else (state, Act.NOTHING)


def _land(
    state: GuardState, view: GuardView, now_ns: int, rules: GuardRules
) -> tuple[GuardState, Act]:
    if view.mode is FlightMode.OTHER or (
        view.mode is FlightMode.HOLD and state.shown_ns is not None
    ):
        return _let_go(state, view)
    if state.shown_ns is not None:
        return (
            _command_landing(state, now_ns, rules) if view.mode in _MOVING else (state, Act.NOTHING)
        )
    if view.mode in _DOWN and view.heartbeat_ns > state.sent_ns:
        return replace(state, shown_ns=now_ns), Act.NOTHING
    again = _unanswered(state, view, now_ns, rules) and _s(now_ns - state.sent_ns) > rules.ack_s
    return _command_landing(state, now_ns, rules) if again else (state, Act.NOTHING)


def _unanswered(state: GuardState, view: GuardView, now_ns: int, rules: GuardRules) -> bool:
    """Refused, or not acknowledged in time, or acknowledged and not done in time."""
    waited_s = _s(now_ns - state.sent_ns)
    if view.acked is None:
        return waited_s > rules.ack_s
    return not view.acked or waited_s > rules.confirm_s


def _command_landing(state: GuardState, now_ns: int, rules: GuardRules) -> tuple[GuardState, Act]:
    """Landing ends motion: it alone may be commanded again, a bounded number of times."""
    if state.tries >= rules.land_tries:
        return replace(state, stage=GuardStage.GAVE_UP), Act.NOTHING
    landing = replace(
        state, stage=GuardStage.LANDING, sent_ns=now_ns, shown_ns=None, tries=state.tries + 1
    )
    return landing, Act.LAND
