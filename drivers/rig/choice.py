"""A rig by name: which one, at which level, flown by which autopilot.

A folder of rigs has a file for each rig, and a rig with an ``[options]`` table is several: the car
at level sitl, flown by two PX4. A name says which, its words in any order: ``sitl-px4`` is the rig
``car`` with the level ``sitl`` and the autopilot ``px4``, and ``sim-person`` is ``person`` at level
``sim``. What a name leaves out is what the rig's options name first.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from path.values import frozen

USUAL_RIG = "car"
"""The rig that a name means which names none, such as ``sitl-px4``."""
LEVELS = ("sim-rendered", "sim", "sitl")
EMBEDDED = "embedded"
AUTOPILOTS = (EMBEDDED, "px4", "ardupilot", "mixed")
LIGHT = "light"
OTHER_NAMES = {"sim-tello": "sim-rendered-tello"}
"""Names of an earlier release that say a level wrongly."""


@frozen
class Choice:
    """A rig with its options; None for what is not said."""

    rig: str = USUAL_RIG
    level: str | None = None
    autopilot: str | None = None
    light: bool = False

    @classmethod
    def of(cls, name: str) -> Choice:
        """Return what a name says."""
        rest = f"-{OTHER_NAMES.get(name, name)}-"
        said: list[str] = []
        for word in (*LEVELS, *AUTOPILOTS, LIGHT):
            if f"-{word}-" in rest:
                rest = rest.replace(f"-{word}-", "-", 1)
                said.append(word)
        return cls(
            rig=rest.strip("-") or USUAL_RIG,
            level=next((word for word in said if word in LEVELS), None),
            autopilot=next((word for word in said if word in AUTOPILOTS), None),
            light=LIGHT in said,
        )

    @property
    def name(self) -> str:
        """The shortest name that says it."""
        level = self.level if self.level in LEVELS else None
        autopilot = None if self.autopilot == EMBEDDED else self.autopilot
        rig = None if self.rig == USUAL_RIG and level else self.rig
        words = (level, autopilot, rig, LIGHT if self.light else None)
        return "-".join(word for word in words if word)

    @property
    def options(self) -> str:
        """The same in words of the command line."""
        level = f" --level {self.level}" if self.level else ""
        autopilot = f" --autopilot {self.autopilot}" if self.autopilot else ""
        return f"--rig {self.rig}{level}{autopilot}{' --light' if self.light else ''}"

    def but_for(
        self,
        level: str | None,
        autopilot: str | None,
        light: bool,
    ) -> Choice:
        """Return the same rig with what is given instead."""
        return Choice(
            self.rig,
            level or self.level,
            autopilot or self.autopilot,
            light or self.light,
        )

    def within(self, options: Mapping[str, Any]) -> Choice:
        """Return the choice with what it leaves out, as the rig's options name it first. Raises
        ValueError for one that the rig does not come as.

        Args:
            options: levels, each with its autopilots; ``light`` has the levels that come light.
        """
        for level, autopilots in options.items():
            fits = self.level in {None, level} and self.autopilot in {None, *autopilots}
            bears = not self.light or level in options.get(LIGHT, ())
            if level != LIGHT and fits and bears:
                return replace(self, level=level, autopilot=self.autopilot or autopilots[0])
        raise ValueError(f"the rig does not come as {self.options}")

    def meets(self, conditions: str) -> bool:
        """Return whether one of the conditions, between commas, holds: all of its words are
        said.
        """
        said = {self.rig, self.level, self.autopilot, LIGHT if self.light else None}
        return any(set(condition.split()) <= said for condition in conditions.split(","))


def shown(options: Mapping[str, Any]) -> list[str]:
    """Return what a rig comes as, in words of the command line: a line a level."""
    lines: list[str] = []
    for level, autopilots in options.items():
        if level in LEVELS:
            light = ", --light" if level in options.get(LIGHT, ()) else ""
            lines.append(f"--level {level} --autopilot {'|'.join(autopilots)}{light}")
    return lines or ["as it is"]
