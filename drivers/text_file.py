"""Files that a person names: read when they are files, and no larger than such a file is."""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path

MOST_BYTES = 16 << 20
"""More than any rig, calibration or table has. /dev/zero has no end, and a pipe that nobody writes
none either.
"""


def read_file(path: Path, most_bytes: int = MOST_BYTES) -> bytes:
    """Return what is in a file. Raises OSError also for what is no regular file, and for a file
    that is too large.
    """
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    with os.fdopen(descriptor, "rb") as file:
        if not stat.S_ISREG(os.fstat(descriptor).st_mode):
            raise OSError(errno.EINVAL, "it is not a regular file", str(path))
        content = file.read(most_bytes + 1)
    if len(content) > most_bytes:
        raise OSError(errno.EFBIG, f"it has more than {most_bytes >> 20} MiB", str(path))
    return content


def is_file(path: Path) -> bool:
    """Return whether there is a regular file; False also for a name that cannot be one."""
    try:
        return path.is_file()
    except (OSError, ValueError):  # too long, or with a zero byte in it
        return False
