"""One MAVLink port of the embedded vehicle: its socket, and the rates of its own streams, as on a
real autopilot.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator

from pymavlink.dialects.v20 import common as mavlink

from hil.vehicle.arrival import Address, bound, packets
from hil.vehicle.messages import STREAMS

PHASE_TOLERANCE_S = 1e-3


class UdpChannel:
    """Sends to ``remote``, and answers whoever speaks to it."""

    def __init__(self, bind: Address, remote: Address) -> None:
        self._remote = remote
        self._socket = bound(bind)
        self._intervals_s = {
            message: 1.0 / rate for message, (_, rate) in STREAMS.items() if rate > 0.0
        }
        self._due_s = dict.fromkeys(self._intervals_s, -math.inf)

    @property
    def address(self) -> Address:
        return self._socket.getsockname()

    def close(self) -> None:
        self._socket.close()

    def send(self, packet: bytes, to: Address | None = None) -> None:
        # a full buffer loses the packet, as a radio does
        with contextlib.suppress(BlockingIOError):
            self._socket.sendto(packet, to or self._remote)

    def packets(self) -> Iterator[tuple[bytes, Address, float]]:
        """All that came in: bytes, sender, and arrival in seconds of the monotonic clock."""
        return packets(self._socket)

    def beat_every(self, interval_s: float | None) -> None:
        """Heartbeats at an interval of the vehicle's own, if it has one."""
        if interval_s is not None:
            self._intervals_s[mavlink.MAVLINK_MSG_ID_HEARTBEAT] = interval_s

    def heartbeat_now(self) -> None:
        self._due_s[mavlink.MAVLINK_MSG_ID_HEARTBEAT] = -math.inf

    def due(self, at_s: float) -> Iterator[int]:
        """The messages whose time has come."""
        for message, due_s in self._due_s.items():
            if at_s < due_s - PHASE_TOLERANCE_S:
                continue
            interval_s = self._intervals_s[message]
            # Keep the phase while on time; after a stall go on from here instead of catching up in
            # a burst.
            late = at_s - due_s > interval_s
            self._due_s[message] = (at_s if late else due_s) + interval_s
            yield message

    def interval_us(self, message: int) -> int:
        """A stream's interval as MESSAGE_INTERVAL tells it: -1 when it is not sent, 0 when it is
        not known.
        """
        if message not in STREAMS:
            return 0
        interval_s = self._intervals_s.get(message)
        return -1 if interval_s is None else round(interval_s * 1e6)

    def set_interval(
        self,
        message: int,
        interval_us: int,
        at_s: float,
    ) -> bool:
        """Set a stream's interval as MAV_CMD_SET_MESSAGE_INTERVAL asks: 0 is the default rate, -1
        ends it.

        False when refused.
        """
        if message not in STREAMS or interval_us < -1:
            return False
        default_hz = STREAMS[message][1]
        interval_s = (
            interval_us * 1e-6 if interval_us > 0 else 1.0 / default_hz if default_hz > 0.0 else 0.0
        )
        if interval_us == -1 or interval_s == 0.0:
            if message == mavlink.MAVLINK_MSG_ID_HEARTBEAT:
                return False
            self._intervals_s.pop(message, None)
            self._due_s.pop(message, None)
        else:
            self._intervals_s[message] = interval_s
            self._due_s[message] = at_s
        return True
