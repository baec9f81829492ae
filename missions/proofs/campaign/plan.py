"""The plan of one run of the machines: drawn from its seed, its level and its number, and from
nothing else.
"""

from __future__ import annotations

import random
from collections.abc import Mapping
from dataclasses import replace
from typing import Literal

from missions.ground.options.words import LevelName
from missions.proofs.campaign.levels import MACHINE_LEVELS, MachineLevel, Range
from path.messages import Role
from path.values import frozen

Forgotten = Literal["nothing", "newest", "all"]
ROLES = (Role.SENDER, Role.RECEIVER)
CLOCKS_S = (100.0, 2000.0)  # what the clocks say when the run begins
# of what happens at any moment
EARLIEST_S = 0.5
LATEST_S = 8.0
AROUND_S = (-0.3, 2.5)  # of what happens around the commit
STEP_S = 30.0


@frozen
class Outage:
    """A time in which nothing that is sent arrives; ``of``: whose packets, None for both roles'."""

    begin_s: float
    end_s: float
    of: Role | None


@frozen
class Crash:
    """A program is killed between two of its effects, the ``after``-th since an instant, and
    started again.

    Attributes:
        halfway: killed once that effect is done, not before it.
        reboot: with another clock.
        flying: its vehicle is in the air when it is started again.
        forgets: what its disk has lost by then, though it had said that it has it.
    """

    role: Role
    at_s: float
    after: int
    halfway: bool
    down_s: float
    reboot: bool
    flying: bool
    forgets: Forgotten = "nothing"


@frozen
class Stall:
    """A program stands still between two of its effects, the ``after``-th since an instant, and
    then goes on.
    """

    role: Role
    at_s: float
    after: int
    for_s: float


@frozen
class Step:
    """A clock is set, forward or back."""

    role: Role
    at_s: float
    by_s: float


@frozen
class RunPlan:
    """One run. Instants are true time since its beginning, in s.

    Attributes:
        seed: of everything that is drawn while it runs.
        link: faults by name, both ways.
        start_s: when each program begins; ``offset_s``, ``drift_ppm``: of each clock against true
            time.
        offer_s: when the target is offered, after the sender's start.
        agree_s: how long the views have to agree, from the first Candidate of an attempt; None when
            they never do.
        wrong: an agreement on another object is claimed first.
        pilots: who ends its mission, and when.
        blind: the receiver does not see the target between these.
    """

    seed: str
    level: LevelName
    link: Mapping[str, float]
    start_s: Mapping[Role, float]
    offset_s: Mapping[Role, float]
    drift_ppm: Mapping[Role, float]
    offer_s: float
    agree_s: float | None
    wrong: bool
    outages: tuple[Outage, ...]
    steps: tuple[Step, ...]
    crashes: tuple[Crash, ...]
    pilots: tuple[tuple[Role, float], ...]
    blind: tuple[float, float] | None
    stalls: tuple[Stall, ...]
    forged_hz: float
    disk_s: float
    late_s: float


def seed_of(
    program: str,
    seed: int,
    level: str,
    number: int,
) -> str:
    return f"{program} {seed} {level} {number}"


def draw(
    seed: int,
    level: LevelName,
    number: int,
) -> RunPlan:
    """The plan of a run of the machines."""
    of = MACHINE_LEVELS[level]
    name = seed_of("machines", seed, level, number)
    rng = random.Random(name)
    start_s = {role: rng.uniform(0.0, 0.5) for role in ROLES}
    offer_s = rng.uniform(0.2, 1.2)
    agree_s = None if rng.random() < of.never else rng.uniform(0.3, 2.5)
    commit_s = start_s[Role.SENDER] + offer_s + (agree_s or 1.0)
    return RunPlan(
        seed=name,
        level=level,
        link=_link(of, rng),
        start_s=start_s,
        offset_s={role: rng.uniform(*CLOCKS_S) for role in ROLES},
        drift_ppm={role: rng.uniform(-of.drift_ppm, of.drift_ppm) for role in ROLES},
        offer_s=offer_s,
        agree_s=agree_s,
        wrong=rng.random() < of.wrong,
        outages=tuple(_outage(of, rng, commit_s) for _ in range(rng.randint(0, of.outages))),
        steps=(Step(rng.choice(ROLES), _when(rng, commit_s), _step(rng)),)
        if rng.random() < of.step
        else (),
        crashes=_forgetful(of, random.Random(f"{name} disks"), _crashes(of, rng, commit_s)),
        pilots=((rng.choice(ROLES), _when(rng, commit_s)),) if rng.random() < of.pilot else (),
        blind=_blind(of, rng, commit_s),
        forged_hz=rng.uniform(0.0, of.forged_hz),
        disk_s=rng.uniform(0.0, of.disk_s),
        late_s=rng.uniform(0.0, of.late_s),
        stalls=_stalls(of, random.Random(f"{name} stalls"), commit_s),
    )


def _link(of: MachineLevel, rng: random.Random) -> dict[str, float]:
    def some(most: float) -> float:
        return rng.uniform(0.0, most)

    return {
        "loss": rng.uniform(*of.loss),
        "delay_s": rng.uniform(*of.delay_s),
        "jitter_s": rng.uniform(*of.jitter_s),
        "duplicate": some(of.duplicate),
        "corrupt": some(of.corrupt),
        "reorder": some(of.reorder),
    }


def _when(rng: random.Random, commit_s: float) -> float:
    """Half of what goes wrong goes wrong around the commit: there it matters most."""
    around: Range = (commit_s + AROUND_S[0], commit_s + AROUND_S[1])
    return max(
        0.0, rng.uniform(*around) if rng.random() < 0.5 else rng.uniform(EARLIEST_S, LATEST_S)
    )


def _outage(
    of: MachineLevel,
    rng: random.Random,
    commit_s: float,
) -> Outage:
    begin_s = _when(rng, commit_s)
    return Outage(begin_s, begin_s + rng.uniform(0.05, of.outage_s), rng.choice((*ROLES, None)))


def _step(rng: random.Random) -> float:
    size_s = rng.uniform(0.2, 2.0) if rng.random() < 0.5 else rng.uniform(2.0, STEP_S)
    return rng.choice((-1.0, 1.0)) * size_s


def _crashes(
    of: MachineLevel,
    rng: random.Random,
    commit_s: float,
) -> tuple[Crash, ...]:
    crashes: list[Crash] = []
    while len(crashes) < 2 and rng.random() < of.crash:
        at_s = _when(rng, commit_s)
        down_s = rng.uniform(0.05, 1.0) if rng.random() < 0.5 else rng.uniform(1.0, 6.0)
        crashes.append(
            Crash(
                rng.choice(ROLES), at_s, rng.randint(1, 8), rng.random() < 0.5, down_s,
                reboot=rng.random() < 0.25, flying=rng.random() < 0.75,
            )
        )  # fmt: skip
    return tuple(crashes)


def _forgetful(
    of: MachineLevel,
    rng: random.Random,
    crashes: tuple[Crash, ...],
) -> tuple[Crash, ...]:
    def one(crash: Crash) -> Crash:
        kind: Forgotten = "newest" if rng.random() < 0.5 else "all"
        return replace(crash, forgets=kind) if rng.random() < of.forget else crash

    return tuple(one(crash) for crash in crashes)


def _stalls(
    of: MachineLevel,
    rng: random.Random,
    commit_s: float,
) -> tuple[Stall, ...]:
    """Half of them sleep over the lease's end, if the COMMIT comes when it is expected."""
    stalls: list[Stall] = []
    for _ in range(2):
        if rng.random() < of.stall:
            near = rng.random() < 0.5
            at_s = commit_s + rng.uniform(1.2, 1.5) if near else _when(rng, commit_s)
            for_s = rng.choice((0.1, 0.39, 2.0)) if near else rng.uniform(0.05, 2.0)
            stalls.append(Stall(rng.choice(ROLES), at_s, rng.randint(1, 4), for_s))
    return tuple(stalls)


def _blind(
    of: MachineLevel,
    rng: random.Random,
    commit_s: float,
) -> tuple[float, float] | None:
    if rng.random() >= of.unable:
        return None
    begin_s = commit_s + rng.uniform(-1.0, 1.0)
    return begin_s, begin_s + rng.uniform(0.1, 3.0)
