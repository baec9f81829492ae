"""One owner for each MAVLink port or device.

MAVSDK opens UDP ports with SO_REUSEADDR: a second program on the port is told all is well and takes
the traffic away from the first. So a port is taken twice: by a lock file against our own processes,
by a probing bind against others.
"""

from __future__ import annotations

import errno
import fcntl
import os
import re
import socket
import tempfile
from pathlib import Path
from typing import Self

from drivers.interfaces import VehicleError

_LISTENING = ("udp", "udpin", "tcpin")


class PortLock:
    """Holds what a MAVSDK connection URL names until ``release``, or until the process is gone.

    Raises VehicleError when somebody else has it, or when the URL cannot be read.
    """

    def __init__(self, url: str) -> None:
        scheme, host, port = _split(url)
        listening = scheme in _LISTENING
        what = (
            f"{'TCP' if scheme.startswith('tcp') else 'UDP'} port {port}"
            if listening
            else f"{host}:{port}"
        )
        self._file = _lock(what)
        if listening:
            try:
                _probe(scheme, host, port, what)
            except VehicleError:
                self.release()
                raise

    def release(self) -> None:
        if self._file >= 0:
            os.close(self._file)
            self._file = -1

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.release()


def _split(url: str) -> tuple[str, str, int]:
    """(scheme, host or device, port or baud rate)."""
    match = re.fullmatch(r"(udp|udpin|udpout|tcpin|tcpout|serial)://(.*):(\d+)", url)
    if match is None:
        remedy = "write it like udpin://127.0.0.1:14541, tcpout://10.0.0.2:5760 or serial:///dev/ttyACM0:921600"
        raise VehicleError(f"{url!r} is no MAVLink connection", remedy)
    return match[1], match[2], int(match[3])


def _lock(what: str) -> int:
    """An open file descriptor that holds the lock. The file stays: removing it would let two owners
    in.
    """
    name = re.sub(r"[^A-Za-z0-9.]+", "-", what)
    path = Path(tempfile.gettempdir()) / f"path-handoff-{os.getuid()}-{name}.lock"
    file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        owner = os.read(file, 32).decode(errors="replace").strip() or "unknown"
        os.close(file)
        remedy = f"end process {owner} (another mission?), or give this vehicle its own url"
        raise VehicleError(
            f"{what} is already used by another vehicle of ours (process {owner})", remedy
        ) from None
    os.truncate(file, 0)
    os.pwrite(file, f"{os.getpid()}\n".encode(), 0)
    return file


def _probe(
    scheme: str,
    host: str,
    port: int,
    what: str,
) -> None:
    """Bind once without SO_REUSEADDR, which fails when anybody else has the port."""
    tcp = scheme.startswith("tcp")
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM if tcp else socket.SOCK_DGRAM) as probe:
        try:
            probe.bind((host, port))
        except OSError as error:
            if error.errno == errno.EADDRINUSE:
                shown = f"ss -{'lt' if tcp else 'lu'}np 'sport = :{port}'"
                remedy = f"end the program that has it ({shown} names it), or choose another port in the vehicle's url"
                raise VehicleError(
                    f"{what} is already in use by another program", remedy
                ) from error
            raise VehicleError(
                f"cannot listen on {host}:{port}: {error.strerror}",
                "use an address of this computer (0.0.0.0 for all) and a port above 1023",
            ) from error
