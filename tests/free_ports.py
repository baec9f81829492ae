"""Ports, and loopback addresses, for parts that must be told theirs before they open it."""

from __future__ import annotations

import socket
from contextlib import suppress
from functools import cache
from itertools import count

FIRST, EACH, SLOTS = 20_000, 500, 25  # below those that the system gives to whoever asks for any
_next = count()
_hosts = count(2)


@cache
def _slot() -> tuple[int, socket.socket]:
    """Return this process's own slot, and what nobody else on this computer can have as long as it
    lives.

    The first port of each slot says whose it is: runs of tests share the ports, and not always a
    folder for locks.
    """
    for slot in range(SLOTS):
        mark = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            mark.bind(("127.0.0.1", FIRST + EACH * slot))
        except OSError:
            mark.close()
            continue
        return slot, mark
    raise OSError(f"{SLOTS} runs of tests are under way")


def free_port(
    kind: socket.SocketKind = socket.SOCK_DGRAM, family: socket.AddressFamily = socket.AF_INET
) -> int:
    """Returns a port that is free, and stays it until it is used: no other run, nor worker of it,
    is given it.
    """
    first, ports = FIRST + EACH * _slot()[0] + 1, EACH - 1
    for _ in range(ports):
        port = first + next(_next) % ports
        with socket.socket(family, kind) as probe, suppress(OSError):
            probe.bind(("", port))
            return port
    raise OSError(f"no free port within {first}..{first + ports - 1}")


def free_ports(
    number: int,
    kind: socket.SocketKind = socket.SOCK_DGRAM,
    family: socket.AddressFamily = socket.AF_INET,
) -> list[int]:
    return [free_port(kind, family) for _ in range(number)]


def free_host() -> str:
    """Returns a loopback address that no test had before: for a device whose ports are the same
    everywhere.
    """
    number = next(_hosts)
    return f"127.{1 + _slot()[0]}.{number // 250}.{number % 250}"
