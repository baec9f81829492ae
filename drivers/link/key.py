"""The signing of a pair's packets: the key that only the two drones have, and the clock of the
signatures.
"""

from __future__ import annotations

import os
import stat
import time
from datetime import UTC, datetime
from pathlib import Path

from drivers.interfaces import LinkError
from drivers.link.wire import KEY_LENGTH, LAST_STAMP
from drivers.rig.part_check import Finding

SIGNING_EPOCH_S = 1_420_070_400  # 2015-01-01, the zero of MAVLink signing time


def signing_key(path: Path | None) -> bytes | None:
    """The pair's key for packets that are signed from now on; None where nothing is signed. Raises
    LinkError.
    """
    if path is None:
        return None
    key = read_key(path)
    if not 0 <= signing_time() <= LAST_STAMP:
        said = datetime.fromtimestamp(time.time(), UTC).date()
        raise LinkError(
            f"this computer's clock says {said}: signatures reach from 2015 to 2104",
            "set the clock",
        )
    return key


def read_key(path: Path) -> bytes:
    """The pair's key. Raises LinkError for a file that is missing, open to others or of a wrong
    length.
    """
    make = f"head -c {KEY_LENGTH} /dev/urandom > {path} && chmod 600 {path}, and copy it to the other drone"
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
        with os.fdopen(descriptor, "rb") as file:
            mode = os.fstat(descriptor).st_mode
            key = file.read(KEY_LENGTH + 1) if stat.S_ISREG(mode) else b""
    except OSError as error:
        raise LinkError(f"key file {path}: {error.strerror}", make) from error
    if not stat.S_ISREG(mode):
        raise LinkError(f"key file {path} is not a file", make)
    if mode & 0o077:
        raise LinkError(
            f"key file {path} has mode {stat.S_IMODE(mode):04o}: others can read it",
            f"chmod 600 {path}",
        )
    if len(key) != KEY_LENGTH:
        found = f"more than {KEY_LENGTH}" if len(key) > KEY_LENGTH else str(len(key))
        raise LinkError(f"key file {path} has {found} bytes, not {KEY_LENGTH}", make)
    return key


def key_finding(path: Path | None) -> Finding:
    """Return the finding on the key of a link that is open.

    A key that cannot be used was refused when it was opened.
    """
    if path is None:
        return Finding(
            "note",
            "key",
            "none: packets are unsigned",
            "name a `key_file` unless nobody else can send to it",
        )
    return Finding("ok", "key", f"{path.name}, {KEY_LENGTH} bytes, readable by its owner alone")


def signing_time() -> int:
    """Units of 10 us of wall time, so that a restarted role never goes back."""
    return int((time.time() - SIGNING_EPOCH_S) * 1e5)
