"""The responsibility over time, from the logs of both roles' programs: nobody's own count is
believed.

A program that died is responsible for nothing until it is started again and says what it is; one
that ended in good order keeps its last word. Instants are of the world's clock.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from drivers.log.mcap_log import parts, read_log
from missions.look.report.records import WORLD_LOG, by_topic, first
from path.messages import Role
from path.values import frozen

ALARMS = frozenset({"orphaned", "unconfirmed"})


@frozen
class RoleEvent:
    """Something one role's log tells, at an instant; ``alive`` False: its program died then."""

    at_ns: int
    role: Role
    alive: bool = True
    responsible: bool | None = None
    duty: str | None = None


@frozen
class Responsibility:
    """
    Attributes:
        both_s: longest time with two responsible drones.
        gap_s: longest time with none between two of its holders, or at the end, that no dead
            program excuses.
        dead_s: longest time with none because the program whose turn it was did not run.
        orphaned: somebody said that nobody may be responsible, and it was so.
        holder: the role that is responsible at the end; None when none is.
        commit_s: from the first responsibility to COMMIT; None without one.
    """

    both_s: float
    gap_s: float
    dead_s: float
    orphaned: bool
    holder: Role | None
    commit_s: float | None


@dataclass(slots=True)
class _Now:
    responsible: dict[Role, bool] = field(default_factory=lambda: dict.fromkeys(Role, False))
    alive: dict[Role, bool] = field(default_factory=lambda: dict.fromkeys(Role, True))
    handed_over: bool = False

    def take(self, told: RoleEvent) -> None:
        self.alive[told.role] = told.alive
        if not told.alive:
            self.responsible[told.role] = False
        if told.responsible is not None:
            self.responsible[told.role] = told.responsible
        if told.duty is not None and told.role is Role.SENDER:
            self.handed_over = told.duty == "handed_over"

    @property
    def excused(self) -> bool:
        """True if nobody can be responsible.

        The program is dead whose turn it is, the sender's until it has handed over.
        """
        return not self.alive[Role.RECEIVER if self.handed_over else Role.SENDER]


def read(folder: Path) -> Responsibility:
    """Read the responsibility of the run in a folder."""
    offsets = _offsets(folder)
    told = list[RoleEvent]()
    commits = list[int]()
    alarm = False
    for role in Role:
        for one in _told(folder, role, offsets[role]):
            if isinstance(one, RoleEvent):
                told.append(one)
            elif one is None:
                alarm = True
            else:
                commits.append(one)
    return judge(sorted(told, key=lambda one: one.at_ns), min(commits, default=None), alarm)


def judge(
    told: Sequence[RoleEvent], commit_ns: int | None = None, alarm: bool = False
) -> Responsibility:
    """
    Args:
        told: in the order of time; nothing counts before the first responsibility.
    """
    now = _Now()
    begin = next((k for k, one in enumerate(told) if one.responsible), len(told))
    for one in told[:begin]:
        now.take(one)
    longest = {"both": 0, "gap": 0, "dead": 0}
    running = dict.fromkeys(longest, 0)
    for one, after in zip(told[begin:], told[begin + 1 :], strict=False):
        now.take(one)
        holders = sum(now.responsible.values())
        what = "both" if holders == 2 else "" if holders else "dead" if now.excused else "gap"
        for name, most in longest.items():
            if name == what:
                running[name] += after.at_ns - one.at_ns
            # a gap goes on where it was when the dead one is back
            elif not (name == "gap" and what == "dead"):
                running[name] = 0
            longest[name] = max(most, running[name])
    if begin < len(told):
        now.take(told[-1])
    holders = [role for role in Role if now.responsible[role]]
    commit_s = (
        (commit_ns - told[begin].at_ns) * 1e-9
        if commit_ns is not None and begin < len(told)
        else None
    )
    return Responsibility(
        both_s=longest["both"] * 1e-9,
        gap_s=longest["gap"] * 1e-9,
        dead_s=longest["dead"] * 1e-9,
        orphaned=alarm and not holders,
        holder=holders[0] if holders else None,
        commit_s=commit_s,
    )


def _told(folder: Path, role: Role, offset_ns: int) -> Iterator[RoleEvent | int | None]:
    """Changes of one role, instants of its COMMITs, and None for each alarm."""
    for part in parts(folder, role.value):
        begun = False
        ended = False
        newest_ns = 0
        until_ns: int | None = None  # the newest claim's end
        for record in read_log(part):
            at_ns = record.stamp_ns - offset_ns
            newest_ns = max(newest_ns, at_ns)
            match record.topic:
                case "/responsibility":
                    if until_ns is not None and until_ns < at_ns:
                        yield RoleEvent(until_ns, role, responsible=False)
                    end_ns = record.record["until_ns"]
                    until_ns = None if end_ns is None else end_ns - offset_ns
                    yield RoleEvent(at_ns, role, responsible=bool(record.record["responsible"]))
                case "/epoch":
                    yield RoleEvent(at_ns, role, duty=str(record.record["duty"]))
                case "/commit":
                    yield at_ns
                case "/settled" if record.record["outcome"] in ALARMS:
                    yield None
                case "/outcome":
                    ended = True
                case _:
                    if not begun:
                        yield RoleEvent(at_ns, role)
            begun = True
        if until_ns is not None and until_ns < newest_ns:
            yield RoleEvent(until_ns, role, responsible=False)
        if begun:
            yield RoleEvent(newest_ns, role, alive=ended)


def _offsets(folder: Path) -> Mapping[Role, int]:
    """Role clock minus world clock, as the world's log tells."""
    scene = first(by_topic(folder / WORLD_LOG), "/scene")
    offsets: Mapping[str, int] = scene["clock_offset_ns"] if scene else {}
    return {role: offsets.get(role.value, 0) for role in Role}
