"""Where a run leaves what it wrote, and what it may take away of an earlier one's."""

from __future__ import annotations

import json
import re
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from drivers.interfaces import PartError


@dataclass(frozen=True, slots=True)
class RunKind:
    """What the folder of a run holds.

    Attributes:
        marker: the file that is written first, and says that the folder is a run's.
        results: the files that are made of the logs.
        actors: whose logs, errors and records there are.
    """

    marker: str
    results: tuple[str, ...]
    actors: tuple[str, ...]

    def files(self, folder: Path) -> Iterator[Path]:
        """Those in a folder that have the names of a run's."""
        logs = re.compile(
            rf"({'|'.join(map(re.escape, self.actors))})(\.guard)?(\.\d+)?\.(mcap|stderr\.txt|state\.json)"
        )
        for file in sorted(folder.iterdir()):
            if file.name in (self.marker, *self.results) or logs.fullmatch(file.name):
                yield file


def new_folder(out: Path | None) -> Path:
    """The folder of a run, made; ``runs/<time>`` by default. Raises PartError."""
    folder = out or Path("runs") / datetime.now().strftime("%Y%m%d-%H%M%S")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise PartError(f"cannot make {folder}: {error.strerror}", "name another folder with --out") from error
    return folder


def claim_folder(folder: Path, kind: RunKind) -> None:
    """Take away what an earlier run of this kind left in a folder: nothing of it may be taken for the new one's.

    Other files stay as they are. Raises PartError when the folder has files with the names of a run's and no marker
    that says whose they are, or cannot be written to.
    """
    try:
        there = list(kind.files(folder))
        if there and not _is_marker(folder / kind.marker):
            raise PartError(
                f"{folder} holds {_some(there)}, and no {kind.marker} of an earlier run: nothing is written over",
                "name another folder with --out, or move these files away",
            )
        for file in there:
            file.unlink()
        (folder / kind.marker).write_text(json.dumps({"outcome": "unfinished"}) + "\n", "utf-8")
    except OSError as error:
        raise PartError(f"cannot write to {folder}: {error.strerror}", "name another folder with --out") from error


def claim_result(folder: Path, result: str, of: str) -> None:
    """Refuse to write a result over a file that is not an earlier one's: then ``of`` matches nothing in the folder.

    Raises PartError.
    """
    if (folder / result).exists() and not any(folder.glob(of)):
        raise PartError(f"{folder} holds a {result} of something else", "name another folder with --out")


def _is_marker(file: Path) -> bool:
    try:
        return "outcome" in json.loads(file.read_bytes())
    except (OSError, ValueError, TypeError):
        return False


def _some(files: Collection[Path]) -> str:
    names = [file.name for file in files]
    return ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")
