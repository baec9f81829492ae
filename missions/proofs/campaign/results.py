"""The file that keeps a campaign's runs."""

from __future__ import annotations

import tempfile
from collections.abc import Generator, Mapping
from contextlib import contextmanager
from dataclasses import field
from datetime import datetime
from pathlib import Path
from typing import Any

from missions.ground.resumable_lines import ResumableLines
from path.values import frozen

FILE = "runs.jsonl"
FORMAT = "path-handoff campaign 1"
OBSERVED_PERCENT = 99.0  # of the time, each target of a team


@frozen
class RunLine:
    """One run.

    Attributes:
        number, level: with the campaign's program and seed, what the run was drawn from.
        outcome: how it ended.
        violations: each "NAME at T s: what".
        beyond: the same after an assumption was broken.
        figures: seconds by name, such as "decided_s"; what was not measured is not there.
        broken: the assumptions that were: "clock" (it was set), "disk" (it lost a record),
            "stall" (a program stood still, and a bound in time of programs that run is not asked
            for).
        observed_percent: of a team, by target that was ever acquired.
    """

    number: int
    level: str
    outcome: str
    violations: tuple[str, ...] = ()
    beyond: tuple[str, ...] = ()
    figures: Mapping[str, float] = field(default_factory=dict[str, float])
    broken: tuple[str, ...] = ()
    observed_percent: Mapping[str, float] = field(default_factory=dict[str, float])


def resumable_results(folder: Path, asked: Mapping[str, Any]) -> ResumableLines[RunLine]:
    """The file of a campaign in its folder; a folder that holds another campaign is refused."""
    return ResumableLines(folder / FILE, RunLine, {"format": FORMAT, **asked})


@contextmanager
def unread_folder() -> Generator[Path]:
    """Give a run a folder for logs that nobody will read: they need no disk."""
    memory = Path("/dev/shm")
    with tempfile.TemporaryDirectory(dir=memory if memory.is_dir() else None) as folder:
        yield Path(folder)


def story_folder(out: Path | None) -> Path:
    """Return the folder for the logs of a run that is flown again to be looked at."""
    folder = out or Path("runs") / f"{datetime.now():%Y%m%d-%H%M%S}-campaign"
    folder.mkdir(parents=True, exist_ok=True)
    return folder
