"""The key of the line between a program and its guard, one for each run of the guard, and the seals
made with it.

Whoever listens on the guard's address owns it and makes the key: a file of the same user, mode
0600, beside the lock files of the ports. A program that is started again in the air finds it there;
one of another user does not.
"""

from __future__ import annotations

import contextlib
import hashlib
import hmac
import os
import re
import stat
import tempfile
import time
from pathlib import Path

KEY_BYTES = 32
_STAMP_BYTES = 8
_TAG_BYTES = 16
SEAL_BYTES = _STAMP_BYTES + _TAG_BYTES


def key_path(bind: str) -> Path:
    """Return the place of the key of the guard that listens on ``bind``."""
    name = re.sub(r"[^A-Za-z0-9.]+", "-", bind)
    return Path(tempfile.gettempdir()) / f"path-handoff-{os.getuid()}-guard-{name}.key"


def make_key(bind: str) -> bytes:
    """A new key, in the place of an earlier guard's. Raises OSError."""
    key = os.urandom(KEY_BYTES)
    _write(key_path(bind), key)
    return key


def keep_key(bind: str, key: bytes) -> None:
    """Write a key again whose file, or folder, somebody has removed: a cleaner of temporary files.
    Never raises.
    """
    path = key_path(bind)
    if path.exists():
        return
    # it is tried again; until then no program of this user finds the guard
    with contextlib.suppress(OSError):
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        _write(path, key)


def _write(path: Path, key: bytes) -> None:
    handle, made = tempfile.mkstemp(prefix=path.name, dir=path.parent)  # mode 0600
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(key)
        Path(made).replace(path)
    except OSError:
        Path(made).unlink(missing_ok=True)
        raise


def forget_key(bind: str, key: bytes) -> None:
    """Remove it, unless another guard has made its own."""
    if KeyReader(bind).read() == key:
        key_path(bind).unlink(missing_ok=True)


class KeyReader:
    """The present key of a guard, read again whenever its file is another one."""

    def __init__(self, bind: str) -> None:
        self._path = key_path(bind)
        self._known: tuple[int, int] | None = None
        self._key: bytes | None = None

    def read(self) -> bytes | None:
        """None while there is none, or it is not one that only this user can read. Never raises."""
        try:
            found = self._path.lstat()
            known = found.st_ino, found.st_ctime_ns
            if known != self._known:
                self._key = _content(self._path)
                self._known = known
        except OSError:
            self._key = self._known = None
        return self._key


def _content(path: Path) -> bytes | None:
    with os.fdopen(
        os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC), "rb"
    ) as file:
        found = os.fstat(file.fileno())
        own = (
            stat.S_ISREG(found.st_mode)
            and found.st_uid == os.getuid()
            and not found.st_mode & 0o077
        )
        key = file.read(KEY_BYTES + 1) if own else b""
    return key if len(key) == KEY_BYTES else None


class Seals:
    """Seals what one end says. Stamps are the computer's own clock, so that a program started again
    is never older.
    """

    def __init__(self) -> None:
        self._newest = 0

    def seal(self, key: bytes, said: bytes) -> bytes:
        self._newest = max(self._newest + 1, time.monotonic_ns())
        packet = self._newest.to_bytes(_STAMP_BYTES, "big") + said
        return packet + _tag(key, packet)


class Opener:
    """Opens what the other end sealed, each once and in order."""

    def __init__(self) -> None:
        self._newest = -1

    def open(self, key: bytes, packet: bytes) -> bytes | None:
        """Return the words in a packet.

        None when it is not sealed with the key, or no newer than what was opened before.
        """
        if len(packet) <= SEAL_BYTES or not hmac.compare_digest(
            _tag(key, packet[:-_TAG_BYTES]), packet[-_TAG_BYTES:]
        ):
            return None
        stamp = int.from_bytes(packet[:_STAMP_BYTES], "big")
        if stamp <= self._newest:
            return None
        self._newest = stamp
        return packet[_STAMP_BYTES:-_TAG_BYTES]


def _tag(key: bytes, packet: bytes) -> bytes:
    return hmac.digest(key, packet, hashlib.sha256)[:_TAG_BYTES]
