"""The seam between a mission and what it flies on: what a harness is asked for and what it answers.

A rig names its harness (``harness = "hil.harness.sim:SimHarness"``); nothing imports one.
"""

from __future__ import annotations

import asyncio
import json
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Protocol

from drivers.interfaces import Log, RecordStore
from drivers.mavlink.guard.interfaces import GuardLine
from drivers.rig.parts import Rig
from flight.outcome import Outcome
from path.messages import Role
from path.values import frozen


@frozen
class Progress:
    """A role's report to the console, a few times a second.

    ``count`` of the ``needed`` agreeing pairs; ``evidence``: reached and needed, when pairs are not
    all that counts.
    """

    role: Role
    stamp_ns: int
    phase: str
    count: int
    needed: int
    iou: float | None
    tau: float | None
    separation_m: float | None
    link_bytes_per_s: float
    responsible: bool
    note: str
    evidence: tuple[float, float] | None = None


ABSENT = "absent"
"""The phase of a role whose program a person has not started yet."""

Emit = Callable[[Progress], None]


@frozen
class RoleResult:
    """The end of one role's program.

    Attributes:
        log_failure: why the log is not whole; the flight went on.
        ended_s: when its course ended, by the loop's time, which is the same in all programs of one
            computer; None: it is not known.
    """

    role: Role
    outcome: Outcome
    detail: str
    responsible: bool
    landed: bool
    log_failure: str = ""
    ended_s: float | None = field(default=None, compare=False)


def with_log(result: RoleResult, failure: str | None) -> RoleResult:
    """The result, with what went wrong with the role's log: a good end whose log is not whole has
    its own outcome.
    """
    if not failure:
        return result
    outcome = Outcome.LOG_FAILED if result.outcome.exit_code == 0 else result.outcome
    return replace(result, outcome=outcome, detail=result.detail or failure, log_failure=failure)


def encode_event(event: Progress | RoleResult) -> str:
    """One line of JSON: how a role's program tells its parent process."""
    if isinstance(event, Progress):
        return json.dumps({"event": "progress", **asdict(event), "role": event.role.value})
    record = {**asdict(event), "role": event.role.value, "outcome": event.outcome.label}
    return json.dumps({"event": "result", **record})


def decode_event(line: str | bytes) -> Progress | RoleResult | None:
    """The event of a line; None when the line is none (a library's own output)."""
    try:
        record = json.loads(line)
        kind = record.pop("event")
        role = Role(record.pop("role"))
        if kind == "progress":
            evidence = record.pop("evidence")
            return Progress(role=role, evidence=tuple(evidence) if evidence else None, **record)
        if kind == "result":
            return RoleResult(
                role=role,
                outcome=Outcome.from_label(record.pop("outcome")),
                **record,
            )
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
        pass
    return None


class InProcess(Protocol):
    """A harness whose world is in the role's own process; its parts know it as more than this."""

    @property
    def seed(self) -> int:
        """The seed of all that is drawn by chance, so that a run can be repeated."""
        ...

    def guard_line(self, role: Role) -> GuardLine:
        """A program's way to its role's guard, in a rig with one."""
        ...


@frozen
class ProgramContext:
    """Everything that a drone's program is given by whoever starts it.

    Attributes:
        stop: tells it to land.
        harness: None where the program has a process of its own.
        store: keeps what it has to know after a restart.
    """

    log: Log
    emit: Emit
    stop: asyncio.Event
    harness: InProcess | None
    store: RecordStore


RoleMain = Callable[[Rig, Role, ProgramContext], Awaitable[RoleResult]]
"""One role's whole program, from opening its parts to the vehicle on the ground. Raises
PartError.
"""


@frozen
class FlightRequest:
    """One run.

    Attributes:
        faults: as written by the user, ``NAME[=VALUE][@WHEN[+SECONDS]]``.
        role_main: for harnesses that run the roles in this process.
        role_command: the command line of one role, for harnesses that run them as processes.
        attack_command: of a program that floods the link; the harness adds what it has to know.
        guard_command: the same of its guard.
    """

    rig: Rig
    out: Path
    seed: int
    faults: Sequence[str]
    role_main: RoleMain
    role_command: Callable[[Role], Sequence[str]]
    emit: Emit
    attack_command: Sequence[str] = ()
    guard_command: Callable[[Role], Sequence[str]] | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Report:
    """What a harness reports of all that is flown on it.

    Attributes:
        violations: number of violations by monitor name; empty when all held.
        simulated_s, wall_s: duration on the mission's clock and on the wall.
        failure: why the harness itself failed; empty when it did not.
        overload: what of a run in real time was late, and how late; empty when the computer kept
            up.
        explained: the monitors of which this lateness explains every violation, by its own time.
        errors: what the world was drawn with: the level's name, and standard deviations by what
            they are of; empty in the real one.
    """

    violations: Mapping[str, int]
    simulated_s: float
    wall_s: float
    interrupted: bool = False
    failure: str = ""
    overload: str = ""
    explained: Sequence[str] = ()
    notes: Sequence[str] = ()
    errors: Mapping[str, str | float] = field(default_factory=dict[str, str | float])


@dataclass(frozen=True, slots=True, kw_only=True)
class FlightReport(Report):
    """The harness's report of a run.

    Attributes:
        results: by role; None for a program that died.
        landed: by role, in truth.
        figures: what the monitors timed, in s by name: "commit_s", from COMMIT to the sender's
            decision, and "gap_s", the longest time with nobody responsible; without what did not
            happen.
        broken: the assumptions that were: "stall" (a program was made to stand still), "disk" (one
            lost a record).
        beyond: what broke after that, which the promises do not bear.
        scene: what its cameras saw, by name; empty for the plain one, and where no frames were
            drawn.
        slow: of a run whose programs were confined: "share" of a core of each, and by role for how
            long they had work to do and were stopped, s.
    """

    results: Mapping[Role, RoleResult | None]
    landed: Mapping[Role, bool]
    figures: Mapping[str, float] = field(default_factory=dict[str, float])
    broken: Sequence[str] = ()
    beyond: Sequence[str] = ()
    scene: str = ""
    slow: Mapping[str, float] = field(default_factory=dict[str, float])


class Harness(Protocol):
    """Flies both roles in a world of its own."""

    def fly(self, request: FlightRequest) -> FlightReport:
        """Blocks until both programs ended and both vehicles are down, or the bound on that is
        over.
        """
        ...
