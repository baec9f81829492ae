"""What is kept of a campaign: a line for each run, in a file that an interrupted campaign goes on with."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import msgspec

from drivers.interfaces import PartError

FILE = "runs.jsonl"
FORMAT = "path-handoff campaign 1"


@dataclass(frozen=True, slots=True)
class RunLine:
    """One run.

    Attributes:
        number, level: with the campaign's program and seed, what the run was drawn from.
        outcome: how it ended.
        violations: each "NAME at T s: what".
        beyond: the same after a clock was set, which is outside every lease's assumptions.
        figures: seconds by name, such as "decided_s"; what was not measured is not there.
    """

    number: int
    level: str
    outcome: str
    violations: tuple[str, ...] = ()
    beyond: tuple[str, ...] = ()
    figures: Mapping[str, float] = field(default_factory=dict[str, float])


class Results:
    """The file of a campaign in its folder; ``lines`` are those of every run that is done.

    Args:
        asked: what was asked for; a folder that holds another campaign is refused.

    Raises PartError.
    """

    def __init__(self, folder: Path, asked: Mapping[str, Any]) -> None:
        self._path = folder / FILE
        self._head = {"format": FORMAT, **asked}
        self.lines: list[RunLine] = []

    def __enter__(self) -> Self:
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            whole = self._read()
            self._file = os.open(self._path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
            os.ftruncate(self._file, whole)  # what an interrupt left of a line goes
            if not whole:
                self._write(json.dumps(self._head) + "\n")
        except OSError as error:
            raise PartError(f"cannot use {self._path}: {error.strerror}", "name another folder with --out") from error
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None, /
    ) -> None:
        os.close(self._file)

    def add(self, lines: Iterable[RunLine]) -> None:
        """Keep these. Raises PartError when the disk does not take them."""
        new = list(lines)
        text = "".join(msgspec.json.encode(line).decode() + "\n" for line in new)
        try:
            self._write(text)
        except OSError as error:
            raise PartError(f"cannot write {self._path}: {error.strerror}", "make room, and start it again") from error
        self.lines.extend(new)

    def _write(self, text: str) -> None:
        data = text.encode()
        while data:
            data = data[os.write(self._file, data) :]

    def _read(self) -> int:
        """Take what is there; how many bytes of it are whole lines."""
        if not self._path.exists():
            return 0
        text = self._path.read_bytes()
        whole = text.rfind(b"\n") + 1
        head, *lines = text[:whole].split(b"\n")[:-1] or [b""]
        if not head:
            return 0
        self._same_campaign(head)
        try:
            self.lines = [msgspec.json.decode(line, type=RunLine) for line in lines]
        except msgspec.MsgspecError as error:
            raise self._foreign(f"a line cannot be read: {error}") from error
        return whole

    def _same_campaign(self, head: bytes) -> None:
        try:
            found: Any = json.loads(head)
        except ValueError:
            found = None
        if not isinstance(found, dict) or found.get("format") != FORMAT:
            raise self._foreign("it is no file of this version of the campaign")
        other = [
            f"{key} {found.get(key)!r}, not {value!r}" for key, value in self._head.items() if found.get(key) != value
        ]
        if other:
            raise self._foreign("it was begun with " + "; ".join(other))

    def _foreign(self, why: str) -> PartError:
        return PartError(
            f"{self._path} is of another campaign: {why}",
            "name another folder with --out, or ask for what was asked then",
        )
