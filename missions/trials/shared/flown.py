"""A whole mission flown for a trial: its facts and its logs, which are thrown away once they were
read.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from drivers.rig.parts import Rig
from missions.fly.handoff.flight import fly_once
from missions.ground.run_folder import discard, new_folder
from missions.look.report.records import RUN, RunFacts, RunRecords, load_run


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


def throw_away(folder: Path) -> None:
    """Remove the logs of a mission that were read, and nothing else."""
    discard(folder, RUN)
