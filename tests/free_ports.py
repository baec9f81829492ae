"""Ports for parts that must be told theirs before they open it."""

from __future__ import annotations

import os
import socket
from contextlib import suppress
from itertools import count

FIRST, EACH, SLOTS = 20_000, 500, 25  # below those that the system gives to whoever asks for any
_next = count()


def _slot() -> int:
    """Of this process: another one for each worker of a run, and mostly for another run's."""
    worker = os.environ.get("PYTEST_XDIST_WORKER", "")
    number = int(worker.removeprefix("gw")) if worker else os.getpid()
    return (number % 5 + 5 * (os.getppid() % 5)) % SLOTS


def free_port(kind: socket.SocketKind = socket.SOCK_DGRAM, family: socket.AddressFamily = socket.AF_INET) -> int:
    """Returns a port that is free, and stays it until it is used: no other worker of a run is given it."""
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
