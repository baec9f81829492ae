"""Resumable JSON lines: one for each of many runs, in a file that an interrupted command goes on
with.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Generic, Self, TypeVar

import msgspec

from drivers.interfaces import PartError

Line = TypeVar("Line")


class ResumableLines(Generic[Line]):
    """A file of lines; ``lines`` are those of every run that is done.

    Args:
        file: in the folder of what is done; made when it is not there.
        kind: the type of a line.
        head: what was asked for, ``format`` among it; a file that was begun with something else is
            refused.

    Raises PartError.
    """

    def __init__(
        self,
        file: Path,
        kind: type[Line],
        head: Mapping[str, Any],
    ) -> None:
        self._path = file
        self._kind = kind
        self._head = dict(head)
        self.lines: list[Line] = []

    def __enter__(self) -> Self:
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            whole = self._read()
            self._file = os.open(self._path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
            os.ftruncate(self._file, whole)  # what an interrupt left of a line goes
            if not whole:
                self._write(json.dumps(self._head) + "\n")
        except OSError as error:
            raise PartError(
                f"cannot use {self._path}: {error.strerror}", "name another folder with --out"
            ) from error
        return self

    def __exit__(self, *_: object) -> None:
        os.close(self._file)

    def add(self, lines: Iterable[Line]) -> None:
        """Keep these. Raises PartError when the disk does not take them."""
        new = list(lines)
        text = "".join(msgspec.json.encode(line).decode() + "\n" for line in new)
        try:
            self._write(text)
        except OSError as error:
            raise PartError(
                f"cannot write {self._path}: {error.strerror}", "make room, and start it again"
            ) from error
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
        self._same(head)
        try:
            self.lines = [msgspec.json.decode(line, type=self._kind) for line in lines]
        except msgspec.MsgspecError as error:
            raise self._foreign(f"a line cannot be read: {error}") from error
        return whole

    def _same(self, head: bytes) -> None:
        try:
            found: Any = json.loads(head)
        except ValueError:
            found = None
        if not isinstance(found, dict) or found.get("format") != self._head["format"]:
            raise self._foreign("it is no file of this version")
        other = [
            f"{key} {found.get(key)!r}, not {value!r}"
            for key, value in self._head.items()
            if found.get(key) != value
        ]
        if other:
            raise self._foreign("it was begun with " + "; ".join(other))

    def _foreign(self, why: str) -> PartError:
        return PartError(
            f"{self._path} is of something else: {why}",
            "name another folder with --out, or ask for what was asked then",
        )
