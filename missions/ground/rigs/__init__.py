"""The rigs that come with PATH, as files."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).parent


def tables() -> dict[str, dict[str, Any]]:
    """Return what the files say, by name of the rig."""
    files = sorted(FOLDER.glob("*.toml"))
    return {file.stem: tomllib.loads(file.read_text("utf-8")) for file in files}
