"""UDP packets with the time at which the kernel took them in: the process that reads them may come
to it late.
"""

from __future__ import annotations

import contextlib
import math
import socket
import struct
import time
from collections.abc import Iterator

from drivers.clock import wall_offset_ns

Address = tuple[str, int]
SO_TIMESTAMPNS = 35  # Linux's; the socket module does not name it


def bound(address: Address) -> socket.socket:
    """A socket that does not block, with stamps where the system has them. Raises OSError when the
    port is taken.
    """
    made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    made.setblocking(False)
    with contextlib.suppress(OSError):
        made.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
    try:
        made.bind(address)
    except OSError:
        made.close()
        raise
    return made


def packets(source: socket.socket) -> Iterator[tuple[bytes, Address, float]]:
    """All that waits: bytes, sender, and arrival in seconds of the monotonic clock, which never
    goes back.
    """
    newest_s = -math.inf
    while True:
        try:
            packet, extra, _, sender = source.recvmsg(4096, 64)
        except BlockingIOError:
            return
        except ConnectionError:  # nobody listens where this socket sent to
            continue
        newest_s = max(newest_s, _arrival_s(extra))
        yield packet, sender, newest_s


def _arrival_s(extra: list[tuple[int, int, bytes]]) -> float:
    for level, kind, data in extra:
        if level == socket.SOL_SOCKET and kind == SO_TIMESTAMPNS:
            seconds, nanoseconds = struct.unpack("@ll", data[:16])
            arrival_ns = seconds * 1_000_000_000 + nanoseconds - wall_offset_ns(time.monotonic_ns)
            return min(arrival_ns, time.monotonic_ns()) * 1e-9
    return time.monotonic()
