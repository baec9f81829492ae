"""The check that a computer kept up with a run in real time."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from hil.monitors.setpoints import JudgedGap, excuse_of

LEFT_OUT = 0.5  # of the pictures
# of the frames, when a program took them up
OLD_S = 0.25
OLD_SHARE = 0.2
ENOUGH = 50  # frames
STOOD_S = 0.5  # of a world: for longer no drone takes a silent vehicle for a living one
# of a program that has a share of a core: for longer no setpoint is in time, whatever the program
# does
STOPPED_S = 0.3
TOGETHER_S = 0.3
LOOK_S = 0.1
STAT = Path("/proc/stat")


def overload_of(
    ages_s: Mapping[str, Sequence[float]],
    pictures: Mapping[str, Any],
    whose: str = "{}'s",
    stood_s: float = 0.0,
    stolen_s: float = 0.0,
    share: float | None = None,
    gaps: Sequence[JudgedGap] = (),
) -> str:
    """Return what was late, and how late; empty when all kept up.

    Args:
        ages_s: of each drone's frames, from their capture until its program took them up.
        pictures: by drone, how many were ``rendered`` and how many ``left_out`` because it was too
            late for them.
        whose: how something of a drone is called.
        stood_s: for how long the world stood still at the most while drones flew.
        stolen_s: for how long this computer's own host took a core away at the most, at once, while
            drones flew.
        gaps: between setpoints, that were too long.
        share: of a core that each program had. The kernel counts what the host took as what the
            program used.
    """
    late = [f"the world stood still for {stood_s:.1f} s"] if stood_s > STOOD_S else []
    if share is not None and stolen_s / share > STOPPED_S:
        late.append(
            f"this computer's host took a core for {stolen_s:.2f} s, {stolen_s / share:.1f} s of a share"
        )
    if excuse := excuse_of(gaps):
        late.append(excuse)
    for name in dict.fromkeys((*ages_s, *pictures)):
        made = pictures.get(name, {})
        its = whose.format(name)
        rendered = int(made.get("rendered", 0))
        left_out = int(made.get("left_out", 0))
        if rendered + left_out >= ENOUGH and left_out > LEFT_OUT * (rendered + left_out):
            late.append(
                f"{its} pictures: {left_out} of {rendered + left_out} were not rendered in time"
            )
        late += late_program(f"{its} program", ages_s.get(name, ()))
    return "; ".join(late)


class StolenTime:
    """Time that this computer's own host took from a core, by the kernel's count: 0 where there is
    no host.

    Attributes:
        longest_s: the most of one core within ``TOGETHER_S``, while it was watched.
    """

    def __init__(self, stat: Path = STAT) -> None:
        self.longest_s = 0.0
        self._stat, self._tick_s = stat, 1.0 / os.sysconf("SC_CLK_TCK")
        self._seen: deque[tuple[float, list[float]]] = deque()

    def watch(self, now_s: float) -> None:
        """Looks, if it is time to; to be called often, and not while nobody flies."""
        seen = self._seen
        if seen and now_s - seen[-1][0] < LOOK_S:
            return
        if seen and now_s - seen[-1][0] > TOGETHER_S:
            seen.clear()  # nobody watched meanwhile
        seen.append((now_s, self._stolen_s()))
        while now_s - seen[0][0] > TOGETHER_S:
            seen.popleft()
        taken = (now - then for now, then in zip(seen[-1][1], seen[0][1], strict=True))
        self.longest_s = max(self.longest_s, *taken, 0.0)

    def _stolen_s(self) -> list[float]:
        """Since the start, of each core."""
        if not self._stat.exists():
            return []
        lines = (line.split() for line in self._stat.read_text("ascii").splitlines())
        return [
            int(words[8]) * self._tick_s
            for words in lines
            if words[0].startswith("cpu") and words[0] != "cpu"
        ]


def frame_age_s(topic: str, record: Mapping[str, Any]) -> list[float]:
    """Return how old a frame was when it was taken up; nothing for a record that is of none."""
    return [float(record["age_ns"]) * 1e-9] if topic == "/frame" else []


def late_program(name: str, ages_s: Sequence[float]) -> list[str]:
    """Return what is said of a program whose frames were old when it took them up; nothing of one
    that kept up.
    """
    ages = sorted(ages_s)
    old = sum(age > OLD_S for age in ages)
    if len(ages) < ENOUGH or old <= OLD_SHARE * len(ages):
        return []
    return [
        f"{name}: {old} of {len(ages)} frames were late, a tenth by {ages[int(0.9 * len(ages))]:.2f} s"
    ]
