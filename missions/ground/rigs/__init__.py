"""The rigs that come with PATH, as files."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

from drivers.rig.choice import LIGHT, Choice

FOLDER = Path(__file__).parent


def tables() -> dict[str, dict[str, Any]]:
    """Return what the files say, by name of the rig."""
    files = sorted(FOLDER.glob("*.toml"))
    return {file.stem: tomllib.loads(file.read_text("utf-8")) for file in files}


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
