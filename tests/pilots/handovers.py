"""Whole hand-overs under persons' hands, in virtual time, and what was wrong with them.

Both drones of the rig ``sim``, with all that they fly with; a person at either, or one at each.
Nothing differs from a flight without persons until the first of them does something, so the moments
of such a flight (``calm``) are those near which the next ones are drawn.
"""

from __future__ import annotations

import asyncio
import math
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from random import Random
from typing import Any, cast

from drivers.collector import collector_off
from drivers.rig.parts import PartSpec, Rig, RoleRig
from flight.harness.flights import FlightReport, FlightRequest, Progress, RoleResult
from flight.outcome import Outcome
from hil.harness import sim
from hil.harness.virtual_time import run_virtual
from hil.monitors.truth_log import TruthLog
from missions.fly.handoff.flight import judge
from missions.fly.handoff.right_object import watch_object
from missions.fly.leg.process import fly_role, load_program
from missions.ground import rig_library
from path.messages import Role
from tests.pilots.acts import Act, drawn, simpler
from tests.pilots.flight import Flown
from tests.pilots.watched import Watched, act_on, ends_badly, keep_looking

SEEDS = (3, 4, 5, 7)  # of the world: calm flights of these are handed over
NEAR = 0.6  # of the first acts are drawn near a moment of the calm flight
BEFORE_S = 0.3
RATE_HZ = 25.0
AFTER_S = 1.2


@dataclass(frozen=True, slots=True)
class Acts:
    """What is done at each drone, and the seed of the world."""

    seed: int
    sender: tuple[Act, ...] = ()
    receiver: tuple[Act, ...] = ()

    def of(self, role: Role) -> tuple[Act, ...]:
        return self.sender if role is Role.SENDER else self.receiver


@dataclass(slots=True)
class Console:
    """What one program's console has shown.

    Attributes:
        moments: when each phase began, and when it was first responsible; the world's clock.
    """

    lines: list[str] = field(default_factory=list[str])
    moments: dict[str, float] = field(default_factory=dict[str, float])

    def show(self, progress: Progress, now_s: float) -> None:
        if progress.note and progress.note not in self.lines:
            self.lines.append(progress.note)
        self.moments.setdefault(progress.phase, now_s)
        if progress.responsible:
            self.moments.setdefault("responsible", now_s)

    def says(self, what: str) -> bool:
        return any(what in line for line in self.lines)


class _Flight(sim._Flight):  # pyright: ignore[reportPrivateUsage]
    """The harness's own flight, with persons."""

    def __init__(self, request: FlightRequest, acts: Acts) -> None:
        super().__init__(request, [])
        self._acts = acts
        self._persons: list[asyncio.Task[None]] = []
        self.noted = {role: Watched() for role in Role}
        self.wrong: list[str] = []
        self.ends: Mapping[Role, RoleResult | None] = {}

    async def _fly_roles(self) -> dict[Role, RoleResult | None]:
        for role in Role:
            self.noted[role].put_round(self.world.drone(role).autopilot)
            harness = cast(Any, self.drones[role].harness)
            harness.noted = self.noted[role]
            doings = (act_on(act, role, harness) for act in self._acts.of(role))
            for each in (keep_looking(role, harness), *doings):
                self._persons.append(asyncio.create_task(each))
        return await super()._fly_roles()

    def _findings(self, truth: TruthLog, results: dict[Role, RoleResult | None]) -> dict[str, Any]:
        for person in self._persons:
            person.cancel()
        self.ends = results
        for role in Role:
            autopilot = self.world.drone(role).autopilot
            bad = ends_badly(results[role], autopilot, self.noted[role])
            own = [*self.noted[role].wrong[:3], *bad]
            self.wrong += [f"{role.value}: {what}" for what in own]
        self._excuse_persons()
        return super()._findings(truth, results)

    def _excuse_persons(self) -> None:
        """Nobody sends setpoints to a vehicle that a person puts into OFFBOARD."""
        for role in Role:
            autopilot = self.world.drone(role).autopilot
            theirs = [at_s for at_s, _, whose in self.noted[role].modes if whose == "person"]
            for session in autopilot.offboard_sessions:
                if session.start_s in theirs:
                    session.long_gaps.clear()


def fly(acts: Acts) -> Flown:
    """Fly one hand-over under persons' hands."""
    return shown(acts)[0]


def shown(acts: Acts) -> tuple[Flown, dict[Role, Console]]:
    """Fly one hand-over under persons' hands; how it ended, and what both consoles have shown."""
    load_program()
    consoles = {role: Console() for role in Role}

    def emit(progress: Progress) -> None:
        consoles[progress.role].show(progress, asyncio.get_running_loop().time())

    with tempfile.TemporaryDirectory() as folder:
        request = FlightRequest(
            _rig(), Path(folder), acts.seed, (), fly_role, lambda role: (role.value,), emit
        )
        flight = _Flight(request, acts)
        with collector_off():
            report = FlightReport(**run_virtual(flight.run()), wall_s=0.0)
        report = watch_object(report, Path(folder))
    outcome, detail = judge(report)
    violated = [note for note in report.notes if note.partition(" ")[0] in report.violations]
    unsafe = [
        f"{role.value}: not on the ground, and no person has it"
        for role, down in report.landed.items()
        if not down and not flight.noted[role].has_a_person
    ]
    ends = {role: end for role, end in flight.ends.items() if end is not None}
    wrong = (*flight.wrong, *violated, *unsafe, *unsaid(ends, consoles))
    crossed = sum(noted.crossed for noted in flight.noted.values())
    return Flown(outcome.label, detail, wrong, report.simulated_s, crossed), consoles


def unsaid(ends: Mapping[Role, RoleResult], consoles: Mapping[Role, Console]) -> list[str]:
    """What the crew were not told: why a drone that nobody touched came down, and that nobody has
    the target.
    """
    wrong: list[str] = []
    for role, end in ends.items():
        # a pilot may also take it on its way home, after all that it had to do was done
        cut_short = end.responsible and consoles[role].says(f"{end.outcome.label}: ")
        if cut_short and not consoles[role].says("nobody does"):
            wrong.append(f"{role.value}: its console does not say that nobody has the target")
        if end.outcome is not Outcome.PILOT_OVERRIDE:
            continue
        if not consoles[role].says(end.outcome.label):
            wrong.append(f"{role.value}: its console does not say {end.outcome.label}")
        for other, others in ends.items():
            if other is role or others.outcome is Outcome.PILOT_OVERRIDE:
                continue
            told = consoles[other].says(end.outcome.label)
            sooner = (others.ended_s or math.inf) < (end.ended_s or math.inf)
            if not (told or sooner):
                wrong.append(
                    f"{other.value}: ended as {others.outcome.label}, and its console does not say"
                    f" that the other one's pilot took it"
                )
    return wrong


@cache
def _rig() -> Rig:
    """The rig ``sim`` with guards whose commands are known. Half as many pictures and no
    look-alikes: which object it is, is not asked here, and a flight takes half as long.
    """
    rig = rig_library.load("sim")
    parts: dict[str, RoleRig] = {}
    for role in Role:
        own = rig.role(role)
        guard = replace(cast(PartSpec, own.guard), factory="tests.pilots.watched:NotedGuard")
        seen = replace(own.perception, options={**own.perception.options, "rate_hz": RATE_HZ})
        parts[role.value] = replace(own, guard=guard, perception=seen)
    world = {**rig.world, "look_alikes": {"count": 0, "driving": 0}}
    return replace(rig, world=world, sender=parts["sender"], receiver=parts["receiver"])


@cache
def calm(seed: int) -> tuple[tuple[float, ...], float]:
    """The moments of a flight that nobody touches, and its end, s."""
    flown, consoles = shown(Acts(seed))
    assert flown.outcome == Outcome.COMMITTED.label, flown
    moments = sorted({at for each in consoles.values() for at in each.moments.values()})
    return tuple(moments), flown.seconds


def drawn_acts(rng: Random) -> Acts:
    """What persons do in one flight: at one drone mostly, at both in every fourth."""
    seed = rng.choice(SEEDS)
    moments, end_s = calm(seed)

    def some() -> tuple[Act, ...]:
        begin_s = rng.uniform(0.0, end_s)
        if rng.random() < NEAR:
            begin_s = max(0.0, rng.choice(moments) + rng.uniform(-BEFORE_S, AFTER_S))
        acts = drawn(rng)
        later_s = begin_s - acts[0].at_s
        return tuple(replace(act, at_s=round(act.at_s + later_s, 2)) for act in acts)

    who = rng.choice(("sender", "receiver", "sender", "receiver", "sender", "receiver", "both"))
    at = {role: some() for role in ("sender", "receiver") if who in (role, "both")}
    return Acts(seed, **at)


def simpler_acts(acts: Acts) -> list[Acts]:
    """Return what to try in place of acts that fail: those of one person, or simpler ones."""
    both = bool(acts.sender and acts.receiver)
    alone = [replace(acts, sender=()), replace(acts, receiver=())] if both else []
    senders = [replace(acts, sender=each) for each in simpler(acts.sender)]
    return alone + senders + [replace(acts, receiver=each) for each in simpler(acts.receiver)]
