"""Output to somebody who may be gone: a closed terminal, a full disk behind stdout. A flight goes
on.
"""

from __future__ import annotations

import errno
import os
import sys
from contextlib import suppress
from functools import partial
from io import FileIO
from pathlib import Path
from typing import Self, TextIO

from drivers.written_behind import WrittenBehind, write_whole


class FolderGone(OSError):
    """The folder of a run was taken away while the run wrote into it."""

    @classmethod
    def of(cls, folder: Path) -> Self:
        return cls(errno.ENOENT, "it was taken away while it was written to", str(folder))


class Said:
    """What a program says on a stream while it flies, line by line: a terminal that is held
    (Ctrl-S), or a reader that stands still, holds up no loop. Never raises. Close it.
    """

    MOST_BYTES = 1 << 22
    CLOSE_S = 3.0

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._behind: WrittenBehind | None = None
        # A stream that is no file is a person's own: it is written to here.
        with suppress(OSError, ValueError):
            stream.flush()
            write = FileIO(stream.fileno(), "wb", closefd=False).write
            self._behind = WrittenBehind(partial(write_whole, write), self.MOST_BYTES, "said")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._behind is not None:
            self._behind.close(self.CLOSE_S)

    def __call__(self, line: str) -> None:
        if self._behind is not None:
            self._behind.put(f"{line}\n".encode())
            return
        with suppress(OSError, ValueError):
            self._stream.write(line + "\n")
            self._stream.flush()

    @property
    def lost(self) -> int:
        """How many lines found no room, as nobody took them."""
        return 0 if self._behind is None else self._behind.lost


def tell_line(line: str) -> None:
    """A line on stdout, to nobody when it cannot be written."""
    with suppress(OSError, ValueError):
        sys.stdout.write(line + "\n")
        sys.stdout.flush()


def say_unwritten(error: OSError) -> None:
    """Name what could not be written or shown, and the fix."""
    what = f"{error.filename}: " if error.filename else "the output: "
    if isinstance(error, FolderGone):
        fix = "leave the folder where it is until the command has ended; what was in it is lost"
    elif error.errno in (errno.EACCES, errno.EPERM):
        fix = "name a place that this user may read and write, or change its mode or its owner"
    else:
        again = "`path-handoff report DIR` makes the report of a flight again"
        fix = f"free some space, or name another folder with --out; {again}"
    with suppress(OSError, ValueError):
        sys.stderr.write(f"error: {what}{error.strerror or error}\n  fix: {fix}\n")


def flush_or_drop(stream: TextIO) -> bool:
    """Return whether what was written to a stream came out. What did not is dropped, so that
    nothing fails at exit.
    """
    try:
        stream.flush()
    except (OSError, ValueError):
        drop(stream)
        return False
    return True


def drop(stream: TextIO) -> None:
    """Send nowhere whatever is still in a stream, or comes."""
    with suppress(OSError, ValueError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, stream.fileno())
        os.close(nowhere)
