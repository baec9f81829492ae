"""Moments of a flight as its guard sees them."""

from __future__ import annotations

from dataclasses import replace

from drivers.interfaces import FlightMode
from drivers.mavlink.guard.interfaces import GuardView, Script
from flight.fence import Fence
from flight.guard.rules import Act, GuardRules, GuardStage, GuardState, Limits, ProgramBeat, decide

S = 1_000_000_000
NOW = 1000 * S
RULES = GuardRules()
LIMITS = Limits(Fence(25.0, 6.0), min_battery=0.2, separation_m=0.7)
VIEW = GuardView(NOW, NOW, True, True, FlightMode.OFFBOARD, (1.0, 2.0, -1.5), 0.9, None)
HEARD = ProgramBeat(NOW, Script.CONTROL, NOW)
DOWN = (FlightMode.LAND, FlightMode.RETURN)
MOVING = (FlightMode.OFFBOARD, FlightMode.TAKEOFF)


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


HOLDING = GuardState(GuardStage.HOLDING, "why", sent_ns=NOW)
HELD = replace(HOLDING, shown_ns=NOW)


EXACT = GuardRules(
    beat_age_s=0.5, setpoint_gap_s=0.25, patience_s=0.5, hold_s=2.0, ack_s=0.5, confirm_s=1.5, blind_s=2.5,
    mode_grace_s=1.0, position_error_m=0.5,
)  # fmt: skip

WHOLE = Limits(Fence(5.0, 6.0), min_battery=0.25, separation_m=1.0)


def at(
    state: GuardState = GuardState(),  # noqa: B008 (frozen)
    view: GuardView = VIEW,
    heard: ProgramBeat = HEARD,
) -> tuple[GuardState, Act]:
    return decide(state, view, heard, NOW, EXACT, WHOLE)


def ago(seconds: float, more_ns: int = 0) -> int:
    return NOW - ns(seconds) - more_ns
