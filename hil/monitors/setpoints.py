"""S8 in real time: the gaps between a drone's setpoints, and what of each the computer has to
answer for.

A gap is the script's, unless the drone's own program says that it was given no core just then, or
stood for a disk, for so long that the rest of the gap is within the bound. A program that kept its
loop busy, or slept, was late by its own doing.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from hil.autopilot.values import MAX_SETPOINT_GAP_S
from path.values import frozen

LATE = "/late"
"""The topic of a program's own lateness: ``drivers.lateness``."""
READ_S = 0.05
"""A thread that waits is only known to have waited once it runs again, and was looked at."""


@frozen
class SetpointGap:
    """No setpoint of a drone arrived between two instants, s of the world's clock."""

    who: str
    from_s: float
    to_s: float

    @property
    def long_s(self) -> float:
        return self.to_s - self.from_s


@frozen
class Late:
    """How late a program was between two instants, s of the world's clock.

    Attributes:
        loop_s: its event loop woke so much later than it had asked for, whatever the reason.
        unserved_s: it was ready to run and had no core.
        disk_s: it stood in the kernel for a disk.
    """

    from_s: float
    to_s: float
    loop_s: float
    unserved_s: float
    disk_s: float = 0.0


def late_of(record: Mapping[str, Any], to_s: float) -> Late:
    """What a record of ``LATE`` says, which was written at ``to_s`` of the world's clock."""
    unserved_ns = record["waited_ns"] + record["beside_ns"] + record["stolen_ns"]
    return Late(
        to_s - record["since_ns"] * 1e-9,
        to_s,
        record["loop_ns"] * 1e-9,
        unserved_ns * 1e-9,
        record["disk_ns"] * 1e-9,
    )


@frozen
class JudgedGap:
    """A gap, and what the drone's program says of that time."""

    gap: SetpointGap
    loop_s: float
    unserved_s: float
    disk_s: float = 0.0
    # the world, which takes setpoints by their arrival and so explains nothing
    stood_s: float = 0.0

    @property
    def explained(self) -> bool:
        """Whether without the computer's lateness the gap would have been within the bound."""
        return self.gap.long_s - self.unserved_s - self.disk_s <= MAX_SETPOINT_GAP_S

    @property
    def taken(self) -> str:
        """What the computer took from the program then."""
        disk = f" and stood for a disk for {self.disk_s:.2f} s" if self.disk_s > 0.0 else ""
        return f"had no core for {self.unserved_s:.2f} s{disk}"

    @property
    def lateness(self) -> str:
        """What is said of the lateness at that time."""
        late = f"then its program's loop was {self.loop_s:.2f} s late and {self.taken}"
        if max(self.loop_s, self.unserved_s) == 0.0:
            late = "its program was not late then"
        return (
            f"{late}, the world stood still for {self.stood_s:.2f} s"
            if self.stood_s > 0.0
            else late
        )


def judged(
    gap: SetpointGap,
    late: Iterable[Late],
    stood: Iterable[Sequence[float]] = (),
) -> JudgedGap:
    """A gap beside all that its own drone's program says of its lateness.

    Args:
        stood: from when to when the world itself stood still.
    """
    then = [each for each in late if each.to_s > gap.from_s and each.from_s < gap.to_s + READ_S]
    stood_s = (to_s - from_s for from_s, to_s in stood if to_s > gap.from_s and from_s < gap.to_s)
    return JudgedGap(
        gap,
        loop_s=max((each.loop_s for each in then), default=0.0),
        unserved_s=min(gap.long_s, sum(each.unserved_s for each in then)),
        disk_s=min(gap.long_s, sum(each.disk_s for each in then)),
        stood_s=max(stood_s, default=0.0),
    )


def told_with(details: Sequence[str], gaps: Sequence[JudgedGap]) -> list[str]:
    """The details of a run, those of S8 with the lateness of that time."""
    known = {detail_of(each.gap): each.lateness for each in gaps}
    told: list[str] = []
    for detail in details:
        lateness = next((late for what, late in known.items() if detail.endswith(what)), "")
        told.append(f"{detail}; {lateness}" if lateness else detail)
    return told


def detail_of(gap: SetpointGap) -> str:
    return f"{gap.who}: {gap.long_s:.3f} s between setpoints, until {gap.to_s:.2f} s"


def all_explained(violations: Mapping[str, int], gaps: Sequence[JudgedGap]) -> bool:
    """Whether the computer explains every violation of S8 of a run; others of S8 are of vehicles
    and failsafes.
    """
    return (
        bool(gaps) and violations.get("S8", 0) == len(gaps) and all(each.explained for each in gaps)
    )


def excuse_of(gaps: Sequence[JudgedGap]) -> str:
    """What a computer was too slow for, by the setpoints that it explains; empty where it explains
    none.
    """
    gaps = [each for each in gaps if each.explained]
    if not gaps:
        return ""
    worst = max(gaps, key=lambda each: each.gap.long_s)
    return (
        f"{worst.gap.who}'s program {worst.taken} of the {worst.gap.long_s:.2f} s "
        f"without a setpoint at {worst.gap.from_s:.2f} s"
    )
