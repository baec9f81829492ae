"""One program at a time where something is written: locks that end with their program, however it
ends.

A folder is locked itself (``flock``), so that no file is left behind and every user of the computer
meets the same lock. A file is written by renaming another one over it, which a lock of the file
would not outlive: it has a hidden file beside it. On a file system that knows no such locks nothing
is held.
"""

from __future__ import annotations

import errno
import fcntl
import os
from collections.abc import Generator
from contextlib import contextmanager, suppress
from pathlib import Path

from drivers.interfaces import PartError

REMEDY = "wait until it has ended, or name another place with --out"
_BUSY = (errno.EWOULDBLOCK, errno.EAGAIN)
_PROCESSES = Path("/proc")
_held: set[tuple[int, int]] = set()
"""What this program holds by device and number: what it does inside needs no second lock."""


@contextmanager
def held_folder(folder: Path, *, beside: bool = False) -> Generator[None, None, None]:
    """Keep other programs from writing into a folder.

    The programs of a run write into one folder together. So whoever begins one asks for all of it,
    and then shares it: nobody else gets all of it until the last of these programs has ended.

    Args:
        beside: for a program that writes into a run's folder beside others, under names of its own.

    Raises:
        PartError: when another program writes there, or it cannot be looked into.
    """
    try:
        file = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    except OSError as error:
        raise PartError(
            f"cannot use {folder}: {error.strerror}", "name another place with --out"
        ) from error
    own = _number(file)
    if own in _held:
        os.close(file)
        yield
        return
    try:
        alone = beside or _lock(file, fcntl.LOCK_EX)
        # between the two somebody else may get all of it: then this one is refused, and there is
        # still one at most
        if not alone or not _lock(file, fcntl.LOCK_SH):
            raise PartError(f"{folder} is being written to by {_holder(file)}", REMEDY)
        _held.add(own)
        yield
    finally:
        _held.discard(own)
        os.close(file)


@contextmanager
def held_file(file: Path) -> Generator[None, None, None]:
    """Keep other programs from writing a file. Raises PartError when one does."""
    lock = file.with_name(f".{file.name}.lock")
    try:
        descriptor = _open_lock(lock)
    except OSError as error:
        if error.errno in _BUSY:
            raise PartError(f"{file} is being written by process {_noted(lock)}", REMEDY) from error
        yield  # it cannot be locked; whether it can be written shows when it is
        return
    try:
        yield
    finally:
        with suppress(OSError):
            lock.unlink()
        os.close(descriptor)


def _open_lock(path: Path) -> int:
    """Return the open and locked file. Raises OSError."""
    while True:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            # whoever had it may have taken it away in between: then this is a lock of nothing
            if path.exists() and _number(descriptor) == (path.stat().st_dev, path.stat().st_ino):
                os.truncate(descriptor, 0)
                os.pwrite(descriptor, f"{os.getpid()}\n".encode(), 0)
                return descriptor
        except OSError:
            os.close(descriptor)
            raise
        os.close(descriptor)


def _lock(file: int, kind: int) -> bool:
    """Return False when another program's lock forbids it; where there are no locks nothing
    does.
    """
    try:
        fcntl.flock(file, kind | fcntl.LOCK_NB)
    except OSError as error:
        return error.errno not in _BUSY
    return True


def _number(file: int) -> tuple[int, int]:
    status = os.fstat(file)
    return status.st_dev, status.st_ino


def _noted(lock: Path) -> str:
    try:
        return lock.read_text("utf-8", errors="replace").strip() or "unknown"
    except OSError:
        return "unknown"


def _holder(folder: int) -> str:
    """Name the oldest process that has a lock of an open folder, with what it was called by."""
    wanted = _number(folder)
    found: list[int] = []
    for process in _PROCESSES.glob("[0-9]*"):
        with suppress(OSError):
            if int(process.name) != os.getpid() and _locks(process, wanted):
                found.append(int(process.name))
    if not found:
        return "another program"
    oldest = min(found)
    with suppress(OSError):
        words = (_PROCESSES / str(oldest) / "cmdline").read_bytes().rstrip(b"\0").split(b"\0")
        named = " ".join(word.decode(errors="replace") for word in words)
        return f"process {oldest} ({named[:200]})"
    return f"process {oldest}"


def _locks(process: Path, wanted: tuple[int, int]) -> bool:
    for each in (process / "fd").iterdir():
        with suppress(OSError):
            status = each.stat()
            if (status.st_dev, status.st_ino) == wanted:
                return "FLOCK" in (process / "fdinfo" / each.name).read_text()
    return False
