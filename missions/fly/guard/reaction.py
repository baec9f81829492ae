"""The fate of one vehicle after a fault in ``path-handoff guard --measure``, read from the logs of
its flight.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

from drivers.log.mcap_log import read_log
from flight.outcome import Outcome
from path.messages import Role
from path.values import frozen

TAKEOVER = "pilot_takeover"  # the receiver's vehicle only
LET_GO_S = {TAKEOVER: 0.5, "rc_mode": 0.5, "rc_sticks": 0.5, "rc_kill": 1.5, "rc_lost": 1.0}
"""After this time no setpoint may come. PX4 tells of a kill switch once a second; a radio is lost
after 0.5 s.
"""
HOLD_LIMIT_S = 1.0
RESTORED_S = 1.2  # its heartbeat, which tells that it is disarmed, comes once a second


@frozen
class Reaction:
    """One flight. Times are from the signal; None: it never came.

    Attributes:
        mode: of the vehicle when it happened.
        held_s: until it was in HOLD, LAND or RETURN.
        landed_s: until it was disarmed on the ground.
        let_go_s: until its last setpoint, which may have come before.
        after: modes the vehicle went through afterwards.
        apart_m: least true distance between the two, both in the air, from then on; None: they were
            not.
        other_down: the other drone was on the ground, disarmed, in the end.
        own: how the program itself ended; the run may be called by what the other one came to.
        reason: why the guard took it; empty when it did not.
    """

    fault: str
    role: str
    moment: str
    mode: str
    held_s: float | None
    landed_s: float | None
    let_go_s: float | None
    after: tuple[str, ...]
    reason: str
    outcome: str
    violations: dict[str, int]
    apart_m: float | None = None
    other_down: bool = True
    own: str = ""

    @property
    def reached(self) -> bool:
        """Return whether the vehicle was in the air under a script when it happened."""
        return self.mode in ("offboard", "takeoff", "hold")


def named(fault: str, role: Role) -> str:
    return fault if fault == TAKEOVER else f"{fault}_{role.value}"


def read_reaction(
    out: Path,
    fault: str,
    role: Role,
    moment: str,
    outcome: str,
    violations: dict[str, int],
) -> Reaction:
    """Read what became of the vehicle, by the world's own log; why, by the guard's."""
    at_ns: int | None = None
    last_ns: int | None = None
    apart_m: list[tuple[int, float]] = []
    other_armed = False
    modes: list[tuple[int, str, bool]] = []
    for record in read_log(out / "world.mcap"):
        if record.topic == "/fault" and record.record["fault"].startswith(named(fault, role)):
            at_ns = record.stamp_ns
        elif record.topic == "/autopilot" and record.record["role"] == role.value:
            modes.append((record.stamp_ns, record.record["mode"], record.record["armed"]))
        elif record.topic == "/autopilot":
            other_armed = record.record["armed"]
        elif record.topic == "/truth":
            one = record.record["sender"]
            two = record.record["receiver"]
            if one["in_air"] and two["in_air"]:
                apart_m.append((record.stamp_ns, math.dist(one["t"], two["t"])))
        elif record.topic == "/setpoint_gap" and record.record["role"] == role.value:
            last_ns = record.record["last_ns"]
    if at_ns is None:
        return Reaction(
            fault,
            role.value,
            moment,
            "not reached",
            None,
            None,
            None,
            (),
            "",
            outcome,
            violations,
        )
    before = [mode for stamp_ns, mode, armed in modes if stamp_ns <= at_ns and armed]
    later = [entry for entry in modes if entry[0] > at_ns]
    mode = before[-1] if before else "not armed"
    return Reaction(
        fault=fault,
        role=role.value,
        moment=moment,
        mode=mode,
        held_s=0.0
        if mode == "hold"
        else _first(at_ns, [s for s, m, _ in later if m in ("hold", "land", "return")]),
        landed_s=_first(at_ns, [s for s, _, armed in later if not armed]),
        let_go_s=None if last_ns is None else (last_ns - at_ns) * 1e-9,
        after=tuple(m for _, m, armed in _without_restored(later) if armed),
        reason=_reason(out / f"{role.value}.guard.mcap"),
        outcome=outcome,
        violations=violations,
        apart_m=min(
            (distance_m for stamp_ns, distance_m in apart_m if stamp_ns >= at_ns), default=None
        ),
        other_down=not other_armed,
        own=_own_outcome(out / f"{role.value}.mcap"),
    )


def _without_restored(modes: Sequence[tuple[int, str, bool]]) -> Sequence[tuple[int, str, bool]]:
    """Without the mode from before the landing, which a PX4 selects again a moment before it tells
    that it disarmed.
    """
    for k in range(1, len(modes) - 1):
        (_, before, _), (at_ns, _, _), (disarmed_ns, _, armed) = modes[k - 1 : k + 2]
        if before == "land" and not armed and disarmed_ns - at_ns < RESTORED_S * 1e9:
            return [*modes[:k], *modes[k + 1 :]]
    return modes


def _first(at_ns: int, stamps_ns: Sequence[int]) -> float | None:
    return (min(stamps_ns) - at_ns) * 1e-9 if stamps_ns else None


def _own_outcome(log: Path) -> str:
    """The end that a role's program named; empty when it named none."""
    ends = (
        [r.record["outcome"] for r in read_log(log) if r.topic == "/outcome"]
        if log.exists()
        else []
    )
    return str(ends[-1]) if ends else ""


def _reason(log: Path) -> str:
    taken = [
        r.record
        for r in read_log(log)
        if r.topic == "/guard" and r.record["stage"] in ("holding", "landing")
    ]
    return str(taken[0]["reason"]) if taken else ""


def is_met(reaction: Reaction) -> bool:
    """Held in time and down; or, when its mode was changed, let go of at once. On the ground there
    is nothing to do.
    """
    if not reaction.reached:
        return reaction.mode != "not reached"
    if reaction.fault in LET_GO_S:
        late = reaction.let_go_s is not None and reaction.let_go_s > LET_GO_S[reaction.fault]
        known = Outcome.PILOT_OVERRIDE.label in (reaction.own, reaction.outcome)
        return (
            not late
            and known
            and reaction.other_down
            and not reaction.violations
            and _left_alone(reaction)
        )
    return (
        reaction.held_s is not None
        and reaction.held_s <= HOLD_LIMIT_S
        and reaction.landed_s is not None
    )


def _left_alone(reaction: Reaction) -> bool:
    """Return whether only the pilot, or the autopilot without its radio, changed the mode
    afterwards.
    """
    match reaction.fault:
        case "rc_kill":
            return reaction.after == ()
        case "rc_lost":
            return reaction.after in (("hold", "land"), ("land",))
        case _:
            return len(reaction.after) == 1
