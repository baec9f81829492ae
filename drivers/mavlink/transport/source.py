"""The address that a vehicle speaks from: proven once, pinned from then on. Everybody else with its
number is ignored.

A heartbeat proves nothing: anybody can send one, from any address. Whoever sends one is asked
(TIMESYNC with a number that nobody can guess), and only what listens at that address can answer.
The first address that does is the vehicle's. Another one is asked only once that one has been
silent for ``QUIET_S``. Where the vehicle signs, heartbeat and answer must be rightly signed, so
that the proof is of the key.
"""

from __future__ import annotations

import os
import struct
from dataclasses import dataclass, field

from drivers.mavlink.transport.frames import (
    AUTOPILOT,
    HEARTBEAT,
    TIMESYNC,
    Head,
    head_of,
    make,
    payload_of,
    whole,
)

Address = tuple[str, int]
QUIET_S = 5.0
_MOST_ASKED = 8  # addresses; the oldest is forgotten
_MOST_KINDS = 8  # of what is ignored
_TIMESYNC = struct.Struct("<qq")  # the answerer's time, zero in a question; the asker's number
OTHERS = "more of the same"


@dataclass(slots=True)
class VehicleSource:
    """The address of one vehicle on one port. Instants are of any one clock.

    Attributes:
        pinned: the address that was proven; None before.
        ignored: what came with the vehicle's number and was not believed, in words, and how often.
        rival_ns: when the newest of it came.
        unproven: an address that was asked and has not answered.
    """

    sysid: int
    own: tuple[int, int]
    pinned: Address | None = None
    ignored: dict[str, int] = field(default_factory=dict[str, int])
    rival_ns: int | None = None
    unproven: Address | None = None
    _heard_ns: int = 0
    _asked: dict[Address, int] = field(default_factory=dict[Address, int])

    def believes(
        self,
        frame: bytes,
        source: Address,
        now_ns: int,
    ) -> bool:
        """Return whether a frame comes from the vehicle's own address; takes the answers that
        prove one.
        """
        head = head_of(frame)
        if (head.system, head.component) != (self.sysid, AUTOPILOT):
            return source == self.pinned
        if source == self.pinned or self._answers(head, frame, source):
            self._heard_ns = now_ns
            return True
        if self.pinned is not None and head.message == HEARTBEAT:
            self.rival_ns = now_ns
            self.ignore(f"a second vehicle {self.sysid}, at {source[0]}:{source[1]}")
        return False

    def question(
        self,
        frame: bytes,
        source: Address,
        now_ns: int,
    ) -> bytes | None:
        """Return what to ask where a heartbeat came from that is not believed; None when nothing
        is to be asked.
        """
        head = head_of(frame)
        of_ours = (head.system, head.component, head.message) == (self.sysid, AUTOPILOT, HEARTBEAT)
        if not of_ours or source == self.pinned or not whole(frame):
            return None
        if self.pinned is not None and (now_ns - self._heard_ns) * 1e-9 < QUIET_S:
            return None
        if source not in self._asked and len(self._asked) >= _MOST_ASKED:
            del self._asked[next(iter(self._asked))]
        number = self._asked.setdefault(source, int.from_bytes(os.urandom(7), "big") + 1)
        self.unproven = source
        return make(TIMESYNC, _TIMESYNC.pack(0, number), self.own, 0)

    def ignore(self, what: str) -> None:
        """Count something that was not believed; of a crowd no more kinds than can be told."""
        kind = what if what in self.ignored or len(self.ignored) < _MOST_KINDS else OTHERS
        self.ignored[kind] = self.ignored.get(kind, 0) + 1

    def _answers(
        self,
        head: Head,
        frame: bytes,
        source: Address,
    ) -> bool:
        asked = self._asked.get(source)
        if asked is None or head.message != TIMESYNC or not whole(frame):
            return False
        time, number = _TIMESYNC.unpack_from(payload_of(frame, _TIMESYNC.size))
        if number != asked or time == 0:
            return False
        self.pinned = source
        self.unproven = None
        self._asked.clear()
        return True
