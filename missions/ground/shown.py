"""Output to somebody who may be gone: a closed terminal, a full disk behind stdout. A flight goes
on.
"""

from __future__ import annotations

import errno
import os
import sys
from contextlib import suppress
from pathlib import Path
from typing import Self, TextIO


class FolderGone(OSError):
    """The folder of a run was taken away while the run wrote into it."""

    @classmethod
    def of(cls, folder: Path) -> Self:
        return cls(errno.ENOENT, "it was taken away while it was written to", str(folder))


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
    else:
        again = "`path-handoff report DIR` makes the report of a flight again"
        fix = f"free some space, or name another folder with --out; {again}"
    with suppress(OSError, ValueError):
        sys.stderr.write(f"error: {what}{error.strerror or error}\n  fix: {fix}\n")


def flush_or_drop(stream: TextIO) -> bool:
    """Returns whether what was written to a stream came out. What did not is dropped, so that
    nothing fails at exit.
    """
    try:
        stream.flush()
    except (OSError, ValueError):
        drop(stream)
        return False
    return True


def drop(stream: TextIO) -> None:
    """Sends nowhere whatever is still in a stream, or comes."""
    with suppress(OSError, ValueError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, stream.fileno())
        os.close(nowhere)
