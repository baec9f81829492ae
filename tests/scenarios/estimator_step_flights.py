"""Whole handoffs in virtual time in which an estimator steps: how many are handed over, and how the
others end.

    .venv/bin/python -m tests.scenarios.estimator_step_flights --seed 1 --count 200

Everything is drawn from the seed: which drone, what steps (place, height, heading, or place and
heading), by how much (0.25 to 3 m, 5 to 40 degrees) and when (any instant from preflight to
landing). One line a flight that was not handed over, with what stepped; counts by kind at the end.
"""

from __future__ import annotations

import argparse
import math
import random
import sys
import tempfile
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from missions.fly.handoff.flight import fly_once
from missions.ground import rig_library
from missions.look.report.records import load_run
from path.messages import Role

KINDS = ("place", "height", "heading", "place and heading")
LEAST_M, MOST_M = 0.25, 3.0
LEAST_DEG, MOST_DEG = 5.0, 40.0
LAST_S = 36.0  # a handoff of the rig sim is over by then
RIG = "sim"


@dataclass(frozen=True)
class StepFlight:
    """One flight: its seed and the faults that were ordered for it."""

    seed: int
    role: Role
    kind: str
    at_s: float
    faults: tuple[str, ...]


def drawn(seed: int, number: int) -> StepFlight:
    """The flight of a number, by the seed alone. Kinds and drones take turns."""
    rng = random.Random(f"estimator steps {seed} {number}")
    kind = KINDS[number % len(KINDS)]
    role = tuple(Role)[number // len(KINDS) % 2]
    at_s = rng.uniform(0.0, LAST_S)
    size_m = rng.uniform(LEAST_M, MOST_M)
    towards = rng.uniform(0.0, 2.0 * math.pi)
    turn_deg = rng.choice((-1.0, 1.0)) * rng.uniform(LEAST_DEG, MOST_DEG)
    steps: dict[str, float] = {}
    if "place" in kind:
        steps["north"] = size_m * math.cos(towards)
        steps["east"] = size_m * math.sin(towards)
    if kind == "height":
        steps["height"] = math.copysign(size_m, turn_deg)
    if "heading" in kind:
        steps["yaw"] = turn_deg
    when = f"@preflight+{at_s:.2f}"
    faults = tuple(f"step_{what}_{role.value}={by:.3f}{when}" for what, by in steps.items())
    return StepFlight(rng.getrandbits(31), role, kind, at_s, faults)


def fly(flight: StepFlight, rig: str = RIG) -> tuple[str, str, dict[str, int], int]:
    """Its outcome and detail, what it violated, and how many steps both drones saw."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder)
        facts = fly_once(rig_library.load(rig), flight.seed, flight.faults, out, lambda _: None)
        run = load_run(out)
        seen = sum(len(run.role(role).get("/estimator_step", ())) for role in Role)
    return facts.outcome, facts.detail, dict(facts.violations), seen


def main(argv: Sequence[str]) -> int:
    """Returns 1 when a monitor was violated."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--rig", default=RIG)
    asked = parser.parse_args(argv)
    flown: Counter[str] = Counter()
    committed: Counter[str] = Counter()
    violations: Counter[str] = Counter()
    for number in range(asked.first, asked.first + asked.count):
        flight = drawn(asked.seed, number)
        outcome, detail, violated, seen = fly(flight, asked.rig)
        flown[flight.kind] += 1
        committed[flight.kind] += outcome == "committed"
        violations.update(violated)
        if outcome != "committed" or violated:
            what = " ".join(flight.faults)
            print(
                f"{number} seed {flight.seed} {what}: {outcome} {detail} {violated or ''} ({seen} seen)",
                flush=True,
            )
    for kind in KINDS:
        print(f"{kind}: {committed[kind]} of {flown[kind]} handed over")
    print(f"all: {committed.total()} of {flown.total()}; violations: {dict(violations) or 'none'}")
    return 1 if violations else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
