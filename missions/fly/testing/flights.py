"""Flights of a test, and their results."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Collection, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import pytest

from drivers.interfaces import PartError
from drivers.log.mcap_log import LogRecord
from drivers.rig.parts import Rig
from missions.fly.handoff.flight import HANDOFF, FlightPrograms, fly_once
from missions.fly.own.command import programs_of
from missions.look.report.records import Records, RunFacts, last, load_run
from missions.look.report.summary import summarize
from path.messages import Role
from path.values import frozen


@frozen
class FlownDrone:
    """One drone of a run, by its own log.

    Attributes:
        name: ``sender`` or ``receiver``.
        records: everything it logged, by topic.
    """

    name: str
    records: Records

    @property
    def outcome(self) -> str:
        """The end of its own program; ``died`` when it did not come to say so."""
        end = last(self.records, "/outcome")
        return "died" if end is None else str(end.record["outcome"])

    @property
    def landed(self) -> bool:
        """Return whether its own program brought it down."""
        end = last(self.records, "/outcome")
        return end is not None and bool(end.record["landed"])

    def logged(self, topic: str) -> Sequence[LogRecord]:
        """The records of a topic; of a mission's own ones that is ``/mission/<topic>``."""
        return self.records.get(topic, ())


class FlownRun:
    """A run that a test flew.

    Attributes:
        folder: its logs and ``run.json``.
        facts: what was asked for and what the harness saw.
    """

    def __init__(self, folder: Path, facts: RunFacts) -> None:
        self.folder = folder
        self.facts = facts
        self._run = load_run(folder)

    @property
    def outcome(self) -> str:
        """The end of the whole run (docs/faults.md)."""
        return self.facts.outcome

    @property
    def monitors(self) -> Mapping[str, int]:
        """Violations, by monitor; empty when all held."""
        return self.facts.violations

    @cached_property
    def drones(self) -> Mapping[str, FlownDrone]:
        """Both drones by name."""
        return {role.value: FlownDrone(role.value, self._run.role(role)) for role in Role}

    @property
    def world(self) -> Records:
        """The truth, as the world logged it; empty where there is no simulated one."""
        return self._run.world

    @cached_property
    def summary(self) -> Mapping[str, Any]:
        """Its figures, as in summary.json."""
        return summarize(self._run)


class PytestFlights:
    """Flies for one test, each run into a folder of its own.

    Args:
        rig: what is flown.
        folder: of the test's runs.
        base: what a mission's file is relative to.
        note: is told the folder of every run.
    """

    def __init__(
        self,
        rig: Rig,
        folder: Path,
        base: Path,
        note: Callable[[Path], object],
    ) -> None:
        self._rig = rig
        self._folder = folder
        self._base = base
        self._note = note
        self._runs = 0

    def mission(
        self,
        file: str | Path,
        seed: int = 0,
        faults: Sequence[str] = (),
        may_violate: Collection[str] = (),
    ) -> FlownRun:
        """Fly a mission's file; a relative one is beside the test. Monitors in ``may_violate`` do
        not fail the test.
        """
        return self._fly(lambda: programs_of(self._base / file), seed, faults, may_violate)

    def handoff(
        self,
        seed: int = 0,
        faults: Sequence[str] = (),
        may_violate: Collection[str] = (),
    ) -> FlownRun:
        """Fly a handoff, as ``path-handoff handoff`` does."""
        return self._fly(lambda: HANDOFF, seed, faults, may_violate)

    def _fly(
        self,
        programs: Callable[[], FlightPrograms],
        seed: int,
        faults: Sequence[str],
        may_violate: Collection[str],
    ) -> FlownRun:
        self._runs += 1
        folder = self._folder / f"run-{self._runs}"
        shutil.rmtree(folder, ignore_errors=True)  # of an earlier failure of this test
        folder.mkdir(parents=True)
        self._note(folder)
        try:
            run = FlownRun(
                folder, fly_once(self._rig, seed, faults, folder, lambda _: None, programs())
            )
        except PartError as error:
            pytest.fail(f"{error}\n  fix: {error.remedy}", pytrace=False)
        if set(run.monitors) - set(may_violate):
            pytest.fail(
                "\n".join(("a safety monitor was violated", *run.facts.notes)), pytrace=False
            )
        return run
