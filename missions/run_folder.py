"""Where a run leaves what it wrote."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path

from drivers.interfaces import PartError


def new_folder(out: Path | None) -> Path:
    """The folder of a run, made; ``runs/<time>`` by default. Raises PartError."""
    folder = out or Path("runs") / datetime.now().strftime("%Y%m%d-%H%M%S")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise PartError(f"cannot make {folder}: {error.strerror}", "name another folder with --out") from error
    return folder
