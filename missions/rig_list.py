"""``path-handoff rigs``: the rigs that come with PATH."""

from __future__ import annotations

import sys
import tomllib
from pathlib import Path
from typing import Any, TextIO

from missions.options import RigsOptions

FOLDER = Path(__file__).parent / "rigs"
LEVELS = ("sim", "sim-rendered", "sitl", "hitl", "field")


def run(options: RigsOptions, out: TextIO | None = None) -> int:
    """List them by level, with what each is for."""
    del options
    tables = [(file.stem, tomllib.loads(file.read_text("utf-8"))) for file in FOLDER.glob("*.toml")]
    width = max((len(name) for name, _ in tables), default=0)
    for name, table in sorted(tables, key=_by_level):
        level = "" if table["level"] == name else f"level {table['level']}: "
        (out or sys.stdout).write(f"{name:<{width}}  {level}{table.get('description', '')}\n")
    return 0


def _by_level(rig: tuple[str, dict[str, Any]]) -> tuple[int, str]:
    return LEVELS.index(rig[1]["level"]), rig[0]
