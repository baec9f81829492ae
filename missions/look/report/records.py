"""The contents of a run folder and its logs' records: the contract between those who log and those
who report.

    sender.mcap, receiver.mcap   one log per role, stamps of the role's own clock; sender.2.mcap and so on of a role
                                 whose program was started again
    world.mcap                   truth, at levels with a simulated world, stamps of the world's clock
    run.json                     what was asked for and what the harness saw (``RunFacts``)
    summary.json, run.png        made from the others by ``missions.look.report``
    run.html                     all of it on a page, by ``missions.look.report.page``
    replay.png, merged.mcap      when they are asked for, by ``missions.look.replay`` and ``missions.look.logs.merge``

Topics and their fields: ``drivers.log.topics``; what viewers draw: ``drivers.log.foxglove``.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import field
from pathlib import Path
from typing import Any

import msgspec

from drivers.interfaces import PartError
from drivers.log.mcap_log import LogRecord, parts, read_log
from missions.ground.run_folder import RunKind
from path.messages import Role
from path.values import frozen

SENDER_LOG = "sender.mcap"
RECEIVER_LOG = "receiver.mcap"
WORLD_LOG = "world.mcap"
FACTS = "run.json"
SUMMARY = "summary.json"
PICTURE = "run.png"
PAGE = "run.html"
REPLAY = "replay.png"
MERGED = "merged.mcap"

RUN = RunKind(
    FACTS,
    (SUMMARY, PICTURE, PAGE, REPLAY, MERGED),
    ("sender", "receiver", "world", "attack", "operator"),
)

Records = Mapping[str, Sequence[LogRecord]]
"""Records of one log by topic, in the order written."""


class RunFolderError(PartError):
    """A folder that is not a run's."""


@frozen
class RunFacts:
    """The facts of a run that its logs cannot tell: what was asked for, and what the harness saw.

    Attributes:
        outcome: label of the whole run's ``flight.outcome.Outcome``.
        detail: what was seen when it ended so; empty after a commit.
        simulated_s, wall_s: duration on the mission's clock and on the wall.
        violations: number of violations by monitor name.
        notes: lines for the crew, details of violations.
        mission: file of a mission of somebody's own that was flown; "" for a hand-over.
        errors, scene, slow: of the world, as ``flight.harness.flights.FlightReport`` has them.
    """

    rig: str
    level: str
    seed: int
    outcome: str
    exit_code: int
    detail: str = ""
    faults: tuple[str, ...] = ()
    simulated_s: float = 0.0
    wall_s: float = 0.0
    violations: dict[str, int] = field(default_factory=dict[str, int])
    notes: tuple[str, ...] = ()
    errors: dict[str, str | float] = field(default_factory=dict[str, str | float])
    scene: str = ""
    slow: dict[str, float] = field(default_factory=dict[str, float])
    mission: str = ""


@frozen
class RunRecords:
    """A whole run as read back. ``facts`` is None when the run was cut off before its end."""

    facts: RunFacts | None
    sender: Records
    receiver: Records
    world: Records

    def role(self, role: Role) -> Records:
        return self.sender if role is Role.SENDER else self.receiver


def write_facts(folder: Path, facts: RunFacts) -> None:
    """Raise OSError."""
    (folder / FACTS).write_bytes(msgspec.json.format(msgspec.json.encode(facts), indent=2) + b"\n")


def load_run(folder: Path, topics: Collection[str] | None = None) -> RunRecords:
    """Read a run folder; what is missing in it is empty. ``topics``: those that are read; None:
    all.

    Raises RunFolderError when it holds neither log nor facts.
    """
    names = (SENDER_LOG, RECEIVER_LOG, WORLD_LOG)
    logs = [parts(folder, Path(name).stem) for name in names]
    if not any(logs) and load_facts(folder) is None:
        raise RunFolderError(
            f"{folder} is not the folder of a run: it holds none of {', '.join(names)}",
            "name the folder that `path-handoff handoff` printed, such as runs/20261104-101500",
        )
    return RunRecords(load_facts(folder), *(by_topic(*files, topics=topics) for files in logs))


def drone_logs(folder: Path) -> dict[str, list[LogRecord]]:
    """The records of every drone's log in a run's folder, by the log's name, whatever the drones
    are called.

    Raises RunFolderError when there is none.
    """
    return {name: read_parts(*parts(folder, name)) for name in drone_names(folder)}


def drone_names(folder: Path) -> list[str]:
    """The names of the drones' logs in a run's folder. Raises RunFolderError when there is none."""
    others = (Path(WORLD_LOG).stem, Path(MERGED).stem, "attack")
    names = sorted(
        path.stem
        for path in folder.glob("*.mcap")
        if "." not in path.stem and path.stem not in others
    )
    if not names and load_facts(folder) is None:
        raise RunFolderError(
            f"{folder} is not the folder of a run: it holds no drone's log",
            "name the folder that `path-handoff handoff` printed, such as runs/20261104-101500",
        )
    return names


def read_parts(*paths: Path) -> list[LogRecord]:
    """All records of a log's parts in order. Raises RunFolderError for what is no log."""
    try:
        return [record for path in paths for record in read_log(path)]
    except (OSError, ValueError) as error:
        raise RunFolderError(str(error), "the file is damaged; fly again") from error


def load_facts(folder: Path) -> RunFacts | None:
    """Return the facts of a run; None when it was cut off before its end."""
    try:
        return msgspec.json.decode((folder / FACTS).read_bytes(), type=RunFacts)
    except (OSError, msgspec.DecodeError):  # the marker of an unfinished run is not all of it
        return None


def by_topic(*paths: Path, topics: Collection[str] | None = None) -> dict[str, list[LogRecord]]:
    """Return the records of a log's parts by topic, of all topics or of some; empty when there is
    no such file.

    Raises RunFolderError for what is no log.
    """
    found: dict[str, list[LogRecord]] = {}
    try:
        for path in paths:
            for record in read_log(path, topics):
                found.setdefault(record.topic, []).append(record)
    except FileNotFoundError:
        return {}
    except (OSError, ValueError) as error:
        raise RunFolderError(str(error), "the file is damaged; fly again") from error
    return found


def first(records: Records, topic: str) -> dict[str, Any] | None:
    """The first record of a topic; None when there is none."""
    found = records.get(topic)
    return found[0].record if found else None


def judged_pairs(run: RunRecords) -> list[LogRecord]:
    """One record for every candidate that the sender judged, up to the commit."""
    commit = last(run.sender, "/commit")
    return [
        r
        for r in run.sender.get("/agreement", ())
        if commit is None or r.stamp_ns <= commit.stamp_ns
    ]


def phase_changes(records: Records) -> list[LogRecord]:
    """The records with which a phase begins."""
    phases = records.get("/phase", ())
    return [
        r
        for k, r in enumerate(phases)
        if k == 0 or r.record["phase"] != phases[k - 1].record["phase"]
    ]


def last(records: Records, topic: str) -> LogRecord | None:
    found = records.get(topic)
    return found[-1] if found else None
