"""A whole mission flown for a trial: its facts and its logs, which are thrown away once they were
read; and what many of them are held against.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from drivers.rig.parts import Rig
from missions.fly.handoff.flight import fly_once
from missions.ground.run_folder import discard, new_folder
from missions.look.report.records import RUN, RunFacts, RunRecords, load_run
from missions.trials.shared.statistics import wilson
from missions.trials.shared.trial import TrialFinding, verdict


def fly(
    rig: Rig,
    seed: int,
    faults: Sequence[str],
    folder: Path,
) -> tuple[RunFacts, RunRecords]:
    """Fly one mission from take-off to landing into a new folder. Raises what a flight raises."""
    own = new_folder(folder)
    facts = fly_once(rig, seed, tuple(faults), own, lambda _: None)
    return facts, load_run(own)


def fly_and_throw_away(
    rig: Rig,
    seed: int,
    faults: Sequence[str],
    folder: Path,
) -> tuple[RunFacts, RunRecords]:
    """Fly one mission; its logs are read and thrown away. Raises what a flight raises."""
    try:
        return fly(rig, seed, faults, folder)
    finally:
        throw_away(folder)


def throw_away(folder: Path) -> None:
    """Remove the logs of a mission that were read, and nothing else."""
    discard(folder, RUN)


def at_least(quantity: str, count: int, total: int, goal: float) -> TrialFinding:
    """Return a share of flights held against the least that is asked."""
    rate = count / total
    low, high = wilson(count, total)
    return TrialFinding(
        quantity,
        f"{rate:.1%}",
        f"{low:.1%} to {high:.1%} of {total}",
        goal=f">= {goal:.0%}",
        verdict=verdict(rate >= goal),
    )


def never(quantity: str, count: int) -> TrialFinding:
    """Return how often something came about that must not."""
    return TrialFinding(quantity, str(count), goal="0", verdict=verdict(count == 0))
