"""This side's end of any link: codec, counters, and the messages that wait for their reader."""

from __future__ import annotations

import asyncio
from collections import deque
from typing import Generic, Protocol, TypeVar

from drivers.interfaces import Clock, LinkCounters, LinkError, Received
from drivers.link.wire import UDP_IP_OVERHEAD, Codec, Drop, EncodeError
from path.messages import Candidate, KeyframePart, Message, Role, Status, Target

STREAMS = (Target, Candidate, Status)
MAX_WAITING = 64
MOST_HZ = 3000  # packets judged a second: twenty times what a peer sends, 0.05 s of a core
MOST_AT_ONCE = 300


class LinkContext(Protocol):
    """The part of ``PartContext`` that a link needs."""

    @property
    def role(self) -> Role: ...

    @property
    def clock(self) -> Clock: ...


Item = TypeVar("Item")


class Waiting(Generic[Item]):
    """A queue that keeps the newest of each stream, and every word of the rest up to a number.

    A Target, Candidate or Status that waits is replaced by a newer one, so that no latency builds
    up. What the hand-over and the clocks say comes first, in its order; parts of keyframes come
    last.

    Args:
        most: words that wait, and parts; then the oldest goes.
        superseded, full: what is counted when a stream's message is replaced, and when the oldest
            word goes.
    """

    def __init__(
        self,
        counters: LinkCounters,
        most: int,
        superseded: str,
        full: str,
    ) -> None:
        self._counters = counters
        self._most = most
        self._reasons = superseded, full
        self._first: deque[Item] = deque()
        self._newest: dict[type[Message], Item] = {}  # in the order of the oldest wait
        self._parts: deque[Item] = deque()

    def __bool__(self) -> bool:
        return bool(self._first or self._newest or self._parts)

    def put(self, kind: type[Message], item: Item) -> None:
        superseded, full = self._reasons
        if kind in STREAMS:
            if kind in self._newest:
                count(self._counters, superseded)
            self._newest[kind] = item
            return
        queue = self._parts if kind is KeyframePart else self._first
        if len(queue) >= self._most:
            queue.popleft()
            count(self._counters, full)
        queue.append(item)

    def pop(self) -> Item:
        """The next one. Raises when there is none."""
        if self._first:
            return self._first.popleft()
        if self._newest:
            return self._newest.pop(next(iter(self._newest)))
        return self._parts.popleft()

    def clear(self) -> None:
        self._first.clear()
        self._newest.clear()
        self._parts.clear()


class Inbox:
    """Messages that wait for one reader, who sees the present however slow it is."""

    def __init__(self, counters: LinkCounters) -> None:
        self._waiting = Waiting[Received](counters, MAX_WAITING, "superseded", "inbox_full")
        self._arrival = asyncio.Event()
        self.closed = False

    def put(self, received: Received) -> None:
        self._waiting.put(type(received.message), received)
        self._arrival.set()

    async def get(self) -> Received:
        """The next message. Raises LinkError once the link is closed, and before it is open."""
        while True:
            if self.closed:
                raise LinkError("the link is closed", "enter it with `async with` first")
            if self._waiting:
                return self._waiting.pop()
            self._arrival.clear()
            await self._arrival.wait()

    def close(self) -> None:
        self.closed = True
        self._arrival.set()


class RateLimit:
    """A bucket of ``MOST_AT_ONCE`` packets that ``MOST_HZ`` a second flow into."""

    def __init__(self) -> None:
        self._left = float(MOST_AT_ONCE)
        self._newest_ns: int | None = None

    def admits(self, now_ns: int) -> bool:
        since_ns = 0 if self._newest_ns is None else max(0, now_ns - self._newest_ns)
        self._newest_ns = now_ns
        self._left = min(float(MOST_AT_ONCE), self._left + since_ns * 1e-9 * MOST_HZ)
        if self._left < 1.0:
            return False
        self._left -= 1.0
        return True


class LinkEnd:
    """Messages to counted packets and back. Whoever has the channel moves the packets.

    A link makes one for each time that it is open, and one that is closed before the first.

    Args:
        codec: of this role.
        overhead: bytes that the channel adds to a packet, for the counters.
    """

    def __init__(self, codec: Codec, overhead: int = UDP_IP_OVERHEAD) -> None:
        self.counters = LinkCounters()
        self.inbox = Inbox(self.counters)
        self._codec = codec
        self._overhead = overhead
        self._limit = RateLimit()
        self._false = RateLimit()  # of what is not the peer's: only to tell by reason what it was

    def pack(self, message: Message) -> bytes | None:
        """The packet to send; None, and counted as dropped, when a number in the message does not
        fit the wire.
        """
        try:
            data = self._codec.encode(message)
        except EncodeError:
            count(self.counters, "cannot_encode")
            return None
        self.counters.packets_sent += 1
        self.counters.bytes_sent += len(data) + self._overhead
        return data

    def arrived(
        self,
        data: bytes,
        arrival_ns: int,
        stranger: bool = False,
    ) -> None:
        """Take a packet as it came: counted, and put into the inbox or dropped by reason. Never
        raises.
        """
        self.counters.packets_received += 1
        self.counters.bytes_received += len(data) + self._overhead
        if stranger:
            count(self.counters, "stranger")
            return
        limit = self._limit if self._codec.authentic(data) else self._false
        # a flood shall not take the time that the vehicle is flown in
        if not limit.admits(arrival_ns):
            count(self.counters, "flooded")
            return
        message = self._codec.decode(data)
        if isinstance(message, Drop):
            count(self.counters, message.value)
        else:
            self.inbox.put(Received(message, arrival_ns))


def count(counters: LinkCounters, reason: str) -> None:
    counters.dropped[reason] = counters.dropped.get(reason, 0) + 1
