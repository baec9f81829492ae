"""Ports, and loopback addresses, for parts that must be told theirs before they open it."""

from __future__ import annotations

import fcntl
import os
import socket
import tempfile
from contextlib import suppress
from functools import cache
from itertools import count
from pathlib import Path

FIRST, EACH, SLOTS = 20_000, 500, 25  # below those that the system gives to whoever asks for any
_next = count()
_hosts = count(2)


@cache
def _slot() -> int:
    """This process's own: nobody else's on this computer as long as it lives."""
    for slot in range(SLOTS):
        lock = Path(tempfile.gettempdir()) / f"path-handoff-{os.getuid()}-tests-{slot}.lock"
        file = os.open(lock, os.O_CREAT | os.O_RDWR, 0o600)
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            os.close(file)
            continue
        return slot
    raise OSError(f"{SLOTS} runs of tests are under way")


def free_port(kind: socket.SocketKind = socket.SOCK_DGRAM, family: socket.AddressFamily = socket.AF_INET) -> int:
    """Returns a port that is free, and stays it until it is used: no other run, nor worker of it, is given it."""
    first = FIRST + EACH * _slot()
    for _ in range(EACH):
        port = first + next(_next) % EACH
        with socket.socket(family, kind) as probe, suppress(OSError):
            probe.bind(("", port))
            return port
    raise OSError(f"no free port within {first}..{first + EACH - 1}")


def free_ports(
    number: int, kind: socket.SocketKind = socket.SOCK_DGRAM, family: socket.AddressFamily = socket.AF_INET
) -> list[int]:
    return [free_port(kind, family) for _ in range(number)]


def free_host() -> str:
    """Returns a loopback address that no test had before: for a device whose ports are the same everywhere."""
    number = next(_hosts)
    return f"127.{1 + _slot()}.{number // 250}.{number % 250}"
