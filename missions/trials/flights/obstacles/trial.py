"""Whole hand-overs among obstacles: worlds by seed, flown by drones whose crew measured what stands
there, by drones that see it, and straight.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from drivers.rig.facts import SiteFacts
from drivers.rig.obstacle import Obstacle
from drivers.rig.parts import Rig
from flight.fence import Fence
from flight.plan.complete import complete
from missions.ground.rig_library import mission_of
from missions.look.report.summary import summarize
from missions.trials.shared.flown import at_least, fly_and_throw_away, never
from missions.trials.shared.statistics import wilson
from missions.trials.shared.trial import (
    TrialFinding,
    TrialRequest,
    TrialResult,
    TrialTable,
    verdict,
)
from path.values import frozen

TITLE = "Obstacles: hand-overs around pillars, trees, vehicles and walls"
PAPER = ""
NEEDS = ("obstacles",)
WORLDS = 200
OBSTACLES = 6
COMMIT_RATE = 0.9
POSITION_M = 0.25
"""Of where drones take themselves to be in the minutes after they left a measured home."""
MOST_PLANNING_MS = 20.0
PLANS = 200
AREA_M = 12.0
How = Literal["around", "looking", "straight"]


@frozen
class Order:
    """One flight to fly: ``around`` what its crew knows, ``looking`` out for what nobody knows, or
    ``straight`` through the same world.
    """

    rig: Rig
    seed: int
    how: How
    folder: Path


@frozen
class Flown:
    """The end of one flight."""

    how: How
    seed: int
    outcome: str
    wrong: bool
    violations: Counter[str]

    @property
    def committed(self) -> bool:
        """Return whether the target was handed over and held, whatever was touched."""
        return self.outcome == "committed"


def run(request: TrialRequest) -> TrialResult:
    """Fly every world both ways. Raises PartError."""
    draw = request.part("obstacles")
    first = 1000 * request.seed
    orders: list[Order] = []
    plans_ms: list[float] = []
    for seed in range(first, first + (1 if request.quick else WORLDS)):
        obstacles = draw(request.rig, OBSTACLES, seed)
        rig = knowing(request.rig, obstacles)
        plans_ms += planned_ms(mission_of(rig).fence, seed)
        orders.append(Order(rig, seed, "around", request.out / f"{seed}-around"))
        rig = not_knowing(request.rig, obstacles)
        orders.append(Order(rig, seed, "straight", request.out / f"{seed}-straight"))
        orders.append(Order(looking(rig), seed, "looking", request.out / f"{seed}-looking"))
    flown = request.work.map("hand-overs flown", fly_order, orders)
    return result(flown, float(np.percentile(plans_ms, 99)))


def knowing(rig: Rig, obstacles: tuple[Obstacle, ...]) -> Rig:
    """Return a rig whose crew measured the obstacles. Raises RigError."""
    return complete(replace(rig, site=replace(_site(rig), obstacles=obstacles)))


def looking(rig: Rig) -> Rig:
    """Return a rig whose drones keep off what they see. Raises RigError."""
    return complete(replace(rig, site=replace(_site(rig), unmeasured=True)))


def _site(rig: Rig) -> SiteFacts:
    return rig.site or SiteFacts(position_m=POSITION_M)


def not_knowing(rig: Rig, obstacles: tuple[Obstacle, ...]) -> Rig:
    """Return a rig in whose world they stand, unknown to the crew."""
    known = [asdict(each) for each in obstacles]
    return replace(rig, world={**rig.world, "obstacles": {"known": known}})


def fly_order(order: Order) -> Flown:
    """Fly one; its logs are read and thrown away."""
    facts, records = fly_and_throw_away(order.rig, order.seed, (), order.folder)
    wrong = bool(summarize(records)["wrong_handover"])
    return Flown(order.how, order.seed, facts.outcome, wrong, Counter(facts.violations))


def planned_ms(fence: Fence, seed: int) -> list[float]:
    """Return the time of a core that places and ways took, between places in the area."""
    rng = np.random.default_rng(seed)
    taken_ms: list[float] = []
    for north, east, to_north, to_east in (AREA_M * rng.uniform(-0.5, 0.5, (PLANS, 4))).tolist():
        began_s = time.thread_time()
        there = fence.nearest((to_north + 0.25 * AREA_M, to_east, -1.5))
        fence.towards(there, (north + 0.25 * AREA_M, east, -2.0))
        taken_ms.append(1e3 * (time.thread_time() - began_s))
    return taken_ms


def result(flown: Sequence[Flown], p99_ms: float) -> TrialResult:
    """Return the result of so many flights."""
    ways = {how: [each for each in flown if each.how == how] for how in get_args(How)}
    around = ways["around"]
    committed = sum(each.committed for each in around)
    rate = _rate(around)
    low, high = wilson(committed, len(around))
    touched = _touches(around)
    wrong = sum(each.wrong for each in flown)
    findings = (
        at_least(
            "committed and held, around what the crew knows", committed, len(around), COMMIT_RATE
        ),
        never("obstacles touched", touched),
        *(
            TrialFinding(
                f"the same worlds unknown, flown {how}: committed without a touch",
                f"{_rate(ways[how]):.1%}",
                note=f"{_touches(ways[how])} obstacles touched",
            )
            for how in ("looking", "straight")
        ),
        never("wrong objects", wrong),
        TrialFinding(
            "a place and the way to it, ms of a core, 99th percentile",
            f"{p99_ms:.2f}",
            goal=f"<= {MOST_PLANNING_MS:g}",
            verdict=verdict(p99_ms <= MOST_PLANNING_MS),
        ),
    )
    summary = {
        "worlds": len(around),
        "commit_rate": rate,
        "commit_interval": [low, high],
        "commit_rate_looking": _rate(ways["looking"]),
        "commit_rate_before": _rate(ways["straight"]),
        "collisions": touched,
        "collisions_looking": _touches(ways["looking"]),
        "collisions_before": _touches(ways["straight"]),
        "wrong": wrong,
        "planning_p99_ms": p99_ms,
        "not_committed": {each.seed: each.outcome for each in around if not each.committed},
    }
    violations = sum((each.violations for each in around), Counter[str]())
    return TrialResult(summary, findings, tables=(_ends(flown),), violations=violations)


def _rate(flown: Sequence[Flown]) -> float:
    return sum(each.committed for each in flown) / len(flown)


def _touches(flown: Sequence[Flown]) -> int:
    return sum(each.violations["S11"] for each in flown)


def _ends(flown: Sequence[Flown]) -> TrialTable:
    counted = Counter((each.outcome, each.how) for each in flown)
    outcomes = sorted({each.outcome for each in flown})
    rows = [
        (outcome, *(str(counted[outcome, how]) for how in get_args(How))) for outcome in outcomes
    ]
    return TrialTable("How they ended", ("outcome", *get_args(How)), tuple(rows))
