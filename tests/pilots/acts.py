"""What a person may do to a flying drone at any instant: with a transmitter, or at a ground
station. Drawn by seed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from random import Random

from drivers.interfaces import FlightMode
from hil.autopilot.autopilot import Autopilot
from hil.autopilot.radio import CENTRED, Sticks

LAST_S = 16.0  # when a person may begin; a flight without anybody is over by then
MOST_ACTS = 3
TOGETHER = 0.3  # of the acts begin in the same instant as the one before
MODES = (
    FlightMode.HOLD,
    FlightMode.LAND,
    FlightMode.RETURN,
    FlightMode.OFFBOARD,
    FlightMode.TAKEOFF,
)
SLOTS = (0, 1, 2, 3)
GRABS: tuple[Sticks, ...] = (
    (0.0, -0.6, 0.0, 0.0),
    (0.8, 0.0, 0.0, 0.0),
    (0.0, 0.0, -0.9, 0.0),
    (0.0, 0.0, 0.6, 0.5),
)
KINDS = ("switch", "sticks", "kill", "lost", "mode", "arm", "disarm")


@dataclass(frozen=True, slots=True)
class Act:
    """One thing that a person does.

    Attributes:
        at_s: world's clock.
        kind: ``switch``, ``sticks``, ``kill``, ``lost`` (the transmitter falls silent) at the
            radio; ``mode``, ``arm``, ``disarm`` at a ground station, whose goto is the mode
            ``hold``.
        what: slot of the switch, index of the grab, or index of the mode.
        back_s: after so long the person undoes it; 0: never.
    """

    at_s: float
    kind: str
    what: int = 0
    back_s: float = 0.0

    def __str__(self) -> str:
        back = f", back after {self.back_s:g} s" if self.back_s else ""
        what = MODES[self.what].value if self.kind == "mode" else str(self.what)
        return f"{self.at_s:g} s: {self.kind} {what}{back}"


def drawn(rng: Random) -> tuple[Act, ...]:
    """Return the acts of one flight, in order of time."""
    acts: list[Act] = []
    for _ in range(rng.randint(1, MOST_ACTS)):
        at_s = round(rng.uniform(0.0, LAST_S), 2)
        if acts and rng.random() < TOGETHER:
            at_s = acts[-1].at_s
        kind = rng.choice(KINDS)
        most = {"switch": len(SLOTS), "sticks": len(GRABS), "mode": len(MODES)}.get(kind, 1)
        back_s = round(rng.choice((0.0, 0.05, 0.2, 0.5, 1.0, rng.uniform(0.0, 6.0))), 2)
        acts.append(
            Act(
                at_s,
                kind,
                rng.randrange(most),
                0.0 if kind in ("mode", "arm", "disarm") else back_s,
            )
        )
    return tuple(sorted(acts, key=lambda act: act.at_s))


def begin(act: Act, autopilot: Autopilot, now_s: float) -> None:
    """Do it."""
    held = autopilot.radio.transmitter
    match act.kind:
        case "switch":
            held.slot = SLOTS[act.what]
        case "sticks":
            held.sticks = GRABS[act.what]
        case "kill":
            held.kill = True
        case "lost":
            held.on = False
        case "mode":
            if autopilot.request_mode(now_s, MODES[act.what]).accepted:
                autopilot.pilots_mode = MODES[act.what]  # a person's, whatever it was selected with
        case _:
            autopilot.request_arm(now_s, act.kind == "arm")


def undo(act: Act, autopilot: Autopilot) -> None:
    """Put the transmitter back to where it was before the flight."""
    held = autopilot.radio.transmitter
    match act.kind:
        case "switch":
            held.slot = 0
        case "sticks":
            held.sticks = CENTRED
        case "kill":
            held.kill = False
        case _:
            held.on = True


def simpler(acts: tuple[Act, ...]) -> list[tuple[Act, ...]]:
    """Return what to try in place of a sequence that fails: one act less, none undone, rounder
    times.
    """
    fewer = [acts[:k] + acts[k + 1 :] for k in range(len(acts)) if len(acts) > 1]
    changed: list[tuple[Act, ...]] = []
    for k, act in enumerate(acts):
        for other in (
            replace(act, back_s=0.0),
            replace(act, at_s=round(act.at_s, 1)),
            replace(act, what=0),
        ):
            if other != act:
                changed.append((*acts[:k], other, *acts[k + 1 :]))
    return fewer + changed
