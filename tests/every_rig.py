"""A name for everything that the rigs which come with PATH come as."""

from __future__ import annotations

from drivers.rig.choice import LIGHT, Choice
from missions.ground.rigs import tables


def every_name() -> list[str]:
    """Return a name for everything that each rig comes as."""
    return [
        Choice(rig, level, autopilot, light).name
        for rig, table in tables().items()
        for level, autopilots in table["options"].items()
        if level != LIGHT
        for autopilot in autopilots
        for light in {False, level in table["options"].get(LIGHT, ())}
    ]
