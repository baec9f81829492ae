"""A link that loses, delays, repeats, damages and reorders: in memory for the sim levels, between
sockets for sitl.
"""

from __future__ import annotations

import asyncio
import random
from collections.abc import Callable, Hashable, Mapping
from typing import Any, Generic, Protocol, Self, TypeVar

from drivers.interfaces import LinkCounters, LinkError, Received
from drivers.link.end import LinkContext, LinkEnd
from drivers.link.udp import Address, open_error
from drivers.link.wire import KEY_LENGTH, Codec
from hil.world.seam import harness_of
from path.messages import Message, Role
from path.values import frozen

HELD_BACK_S = 0.03  # how late a reordered packet is beyond the others
SPACING_S = 1e-6  # packets of one direction never arrive at the very same time: their order is kept
Side = TypeVar("Side", bound=Hashable)
SHARES = ("loss", "duplicate", "corrupt", "reorder")


@frozen
class LinkFaults:
    """The faults that a packet may meet; shares are 0..1 and independent of each other.

    Attributes:
        loss: share that never arrives.
        delay_s, jitter_s: every packet is late by the delay and a uniform part of the jitter, in
            the order of sending.
        duplicate: share that arrives twice.
        corrupt: share that arrives damaged, with bits turned over or cut short.
        reorder: share that is held back, so that later ones overtake it.
    """

    loss: float = 0.0
    delay_s: float = 0.0
    jitter_s: float = 0.0
    duplicate: float = 0.0
    corrupt: float = 0.0
    reorder: float = 0.0

    def __post_init__(self) -> None:
        for name in SHARES:
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise ValueError(f"{name}: {getattr(self, name)!r} is not a share, 0..1")
        if not (0.0 <= self.delay_s < float("inf") and 0.0 <= self.jitter_s < float("inf")):
            raise ValueError("delay_s and jitter_s must be finite and not negative")


# a good radio link, the in-memory link's normal state
AIR = LinkFaults(delay_s=0.002, jitter_s=0.002)


class FaultyChannel:
    """One direction of a link: applies faults to packets, by seed. ``faults`` may change at any
    time.

    The same packets at the same times with the same seed fare the same.
    """

    def __init__(self, seed: str, faults: LinkFaults) -> None:
        self.faults = faults
        self._random = random.Random(seed)
        self._last_s = self._out_until_s = float("-inf")

    def interrupt(self, until_s: float) -> None:
        """Interrupts the channel: nothing that is sent before passes."""
        self._out_until_s = max(self._out_until_s, until_s)

    def arrivals(self, data: bytes, now_s: float) -> list[tuple[float, bytes]]:
        """Return when, on the clock of ``now_s``, and as what a packet arrives: never, once or
        twice.
        """
        faults = self.faults
        chance = self._random.random
        arrivals: list[tuple[float, bytes]] = []
        if chance() < faults.loss or now_s < self._out_until_s:
            return arrivals
        for _ in range(2 if chance() < faults.duplicate else 1):
            at_s = now_s + faults.delay_s + faults.jitter_s * chance()
            if chance() < faults.reorder:
                at_s += HELD_BACK_S
            else:
                at_s = self._last_s = max(at_s, self._last_s + SPACING_S)
            arrivals.append((at_s, self._damaged(data) if chance() < faults.corrupt else data))
        return arrivals

    def carry(self, data: bytes, deliver: Callable[[bytes], None]) -> None:
        """Deliver a packet, as late and as often as it arrives, on the running loop's time."""
        loop = asyncio.get_running_loop()
        for at_s, packet in self.arrivals(data, loop.time()):
            loop.call_at(at_s, deliver, packet)

    def _damaged(self, data: bytes) -> bytes:
        rng = self._random
        if rng.random() < 0.2:
            return data[: rng.randrange(len(data))]
        damaged = bytearray(data)
        for _ in range(rng.randint(1, 8)):
            damaged[rng.randrange(len(damaged))] ^= 1 << rng.randrange(8)
        return bytes(damaged)


def faulty_channel(seed: str, faults: Mapping[str, float]) -> FaultyChannel:
    """Return the channel for faults by name. Raises ValueError, and TypeError for a name that
    there is not.
    """
    return FaultyChannel(seed, LinkFaults(**faults))


class FaultyLink(Generic[Side]):
    """The channels of what each side sends, with the same faults. ``seeds``: one for each side."""

    def __init__(self, seeds: Mapping[Side, str], faults: LinkFaults) -> None:
        self._channels = {side: FaultyChannel(seed, faults) for side, seed in seeds.items()}
        self._faults = faults

    @property
    def faults(self) -> LinkFaults:
        """The faults of both directions; may be changed while it runs."""
        return self._faults

    @faults.setter
    def faults(self, faults: LinkFaults) -> None:
        self._faults = faults
        for channel in self._channels.values():
            channel.faults = faults

    def interrupt(self, seconds: float) -> None:
        """Interrupts the link: nothing that is sent within these seconds passes, either way."""
        until_s = asyncio.get_running_loop().time() + seconds
        for channel in self._channels.values():
            channel.interrupt(until_s)


class MemoryHub(FaultyLink[Role]):
    """Both ends of the in-memory link, and the faults between them."""

    def __init__(self, seed: int, faults: LinkFaults = AIR) -> None:
        super().__init__({role: f"link {role.value} {seed}" for role in Role}, faults)
        self._ends: dict[Role, MemoryLink] = {}
        self._cut: set[Role] = set()

    def join(self, role: Role, end: MemoryLink) -> None:
        """Raise LinkError when the role is there already."""
        if role in self._ends:
            raise LinkError(
                f"the {role.value}'s end of the link is in use", "open one link for each role"
            )
        self._ends[role] = end

    def leave(self, role: Role) -> None:
        self._ends.pop(role, None)

    def cut(self, role: Role) -> None:
        """Cut a role off: from now on nothing comes from or gets to it, its program is dead."""
        self._cut.add(role)

    def mend(self, role: Role) -> None:
        """Its program was started again."""
        self._cut.discard(role)

    def carry(self, role: Role, data: bytes) -> None:
        """Take a packet of one role to the other."""
        peer = Role.RECEIVER if role is Role.SENDER else Role.SENDER
        if role not in self._cut:
            self._channels[role].carry(data, lambda packet: self._deliver(peer, packet))

    def _deliver(self, role: Role, data: bytes) -> None:
        end = self._ends.get(role)
        if end is not None and role not in self._cut:
            end.on_packet(data)


class HubContext(LinkContext, Protocol):
    """The part of ``PartContext`` that the link needs."""

    @property
    def harness(self) -> object | None: ...


@frozen
class MemoryLinkConfig:
    """The faults are the harness's.

    Attributes:
        signed: sign and check packets with a key made up for the simulation, as on the air. Costs
            30 us a message.
    """

    signed: bool = True


class MemoryLink:
    """Implements ``drivers.interfaces.Link`` in one process; packets are encoded and decoded as on
    the air.

    Bytes are counted as if each packet were a UDP datagram, so that the figures compare with the
    real link's.
    """

    Config = MemoryLinkConfig

    def __init__(self, config: MemoryLinkConfig, context: HubContext) -> None:
        self._hub: MemoryHub = harness_of(context.harness, "an in-memory link", LinkError).hub
        self._role = context.role
        self._clock = context.clock
        self._key = bytes(KEY_LENGTH) if config.signed else None
        self._end = self._new_end()
        self._end.inbox.close()

    @property
    def counters(self) -> LinkCounters:
        return self._end.counters

    async def __aenter__(self) -> Self:
        self._hub.join(self._role, self)
        self._end = self._new_end()
        return self

    async def __aexit__(self, *_: object) -> None:
        if not self._end.inbox.closed:
            self._hub.leave(self._role)
            self._end.inbox.close()

    def send(self, message: Message) -> None:
        if self._end.inbox.closed:
            raise LinkError("the link is not open", "enter it with `async with` first")
        data = self._end.pack(message)
        if data is not None:
            self._hub.carry(self._role, data)

    async def receive(self) -> Received:
        return await self._end.inbox.get()

    def on_packet(self, data: bytes) -> None:
        self._end.arrived(data, self._clock.now_ns())

    def _new_end(self) -> LinkEnd:
        return LinkEnd(Codec(self._role, self._key, stamp=_signing_time))


def _signing_time() -> int:
    """Units of 10 us of the loop's time: the same in every run."""
    return round(asyncio.get_running_loop().time() * 1e5)


@frozen
class ProxySide:
    """One side of the proxy: where it listens, and the one end it talks to."""

    listen: Address
    end: Address


class UdpFaultProxy(FaultyLink[int]):
    """Two UDP sockets back to back: what one side's end sends comes out of the other side, with
    faults.
    """

    def __init__(
        self,
        sender: ProxySide,
        receiver: ProxySide,
        seed: int,
        faults: LinkFaults | None = None,
    ) -> None:
        super().__init__({side: f"proxy {side} {seed}" for side in (0, 1)}, faults or LinkFaults())
        self._sides = sender, receiver
        self._transports: list[asyncio.DatagramTransport] = []
        # told each packet, and the side it is for
        self.overheard: Callable[[bytes, int], None] | None = None

    async def __aenter__(self) -> Self:
        """Raise LinkError naming the port that is in use."""
        loop = asyncio.get_running_loop()
        for number, side in enumerate(self._sides):
            forward = _Forward(self, number)
            try:
                transport, _ = await loop.create_datagram_endpoint(
                    lambda f=forward: f, local_addr=side.listen
                )
            except OSError as error:
                await self._close()
                raise open_error(side.listen, error) from error
            self._transports.append(transport)
        return self

    async def __aexit__(self, *_: object) -> None:
        await self._close()

    def forward(
        self,
        data: bytes,
        side: int,
        source: Address,
    ) -> None:
        """A datagram came in on a side: on to the end of the other. Strangers' are ignored."""
        if source == self._sides[side].end:
            if self.overheard is not None:
                self.overheard(data, 1 - side)
            self._channels[side].carry(data, lambda packet: self._out(1 - side, packet))

    def _out(self, side: int, data: bytes) -> None:
        if self._transports:
            self._transports[side].sendto(data, self._sides[side].end)

    def inject(self, data: bytes, side: int) -> None:
        """Into one side's end, as if the other drone had sent it: whoever is on the air can."""
        self._out(side, data)

    async def _close(self) -> None:
        for transport in self._transports:
            transport.abort()
        self._transports = []
        await asyncio.sleep(0)  # the sockets are closed in the loop's next turn


class _Forward(asyncio.DatagramProtocol):
    def __init__(self, proxy: UdpFaultProxy, side: int) -> None:
        self._proxy = proxy
        self._side = side

    def datagram_received(self, data: bytes, addr: tuple[Any, ...]) -> None:
        self._proxy.forward(data, self._side, (str(addr[0]), int(addr[1])))

    def error_received(self, exc: Exception) -> None:
        """An end is not open (yet, or any more): its packets are lost."""
