"""The rigs that come with PATH, and how a rig is loaded for a mission: checked whole before anything moves."""

from __future__ import annotations

import sys
import tomllib
from pathlib import Path
from typing import Any, TextIO

from drivers.rig import Rig
from drivers.rig_check import check_rig
from drivers.rig_file import load_rig
from drivers.tables import Problems, RigError, decode_table
from flight.config import MissionConfig
from missions.options import RigsOptions

FOLDER = Path(__file__).parent / "rigs"


def load(name_or_path: str) -> Rig:
    """A rig by name or path, with everything in it checked before anything moves. Raises RigError."""
    rig = load_rig(name_or_path, [FOLDER])
    problems = Problems()
    for check in (check_rig, mission_of):
        try:
            check(rig)
        except RigError as error:
            problems.absorb(error)
    problems.raise_any()
    return rig


def mission_of(rig: Rig) -> MissionConfig:
    """The rig's ``[mission]``. Raises RigError."""
    return decode_table(rig.mission, MissionConfig, rig.where("mission"))


def run(options: RigsOptions, out: TextIO | None = None) -> int:
    """``path-handoff rigs``."""
    del options
    rigs = [(file.stem, tomllib.loads(file.read_text("utf-8"))) for file in sorted(FOLDER.glob("*.toml"))]
    width = max((len(name) for name, _ in rigs), default=0)
    for name, table in sorted(rigs, key=_by_level):
        (out or sys.stdout).write(f"{name:<{width}}  {table['level']:<12}  {table.get('description', '')}\n")
    return 0


def _by_level(rig: tuple[str, dict[str, Any]]) -> tuple[int, str]:
    levels = ("sim", "sim-rendered", "sitl", "hitl", "field")
    return levels.index(rig[1]["level"]), rig[0]
