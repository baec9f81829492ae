"""The traffic of a verification, over real UDP links on loopback, counted by a tap between the two
ends.
"""

from __future__ import annotations

import asyncio
import os
import socket
import tempfile
from collections.abc import Callable, Sequence
from contextlib import AsyncExitStack
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from drivers.clock import stopwatch_ns
from drivers.interfaces import LinkError
from drivers.link.dialect import path_dialect as dialect
from drivers.link.udp import UdpLink
from drivers.link.wire import KEY_LENGTH, UDP_IP_OVERHEAD
from flight.clocks import answer
from flight.config import MissionConfig
from flight.phases import Phase
from missions.ground.work import Work
from path.alike import Alike
from path.messages import (
    STEPS,
    Abort,
    AbortReason,
    Accept,
    Candidate,
    Commit,
    Confirm,
    Message,
    Ping,
    Pong,
    Quat,
    Role,
    Status,
    Target,
    Vec3,
)
from path.observations import Box, MissReason
from path.values import frozen

HOST = "127.0.0.1"
HANDOFF = 1
EPOCH = 7
TARGET_ID = 1
INSTANCE = 0xA3F01C
SETTLE_S = 0.3


@frozen
class TappedPacket:
    """One datagram as the tap saw it."""

    kind: str
    direction: Role  # who sent it
    payload_b: int
    mavlink_b: int
    at_s: float

    @property
    def wire_b(self) -> int:
        """The size with its UDP and IPv4 headers, which the kernel adds."""
        return self.mavlink_b + UDP_IP_OVERHEAD


@dataclass(slots=True)
class LinkTraffic:
    """The traffic on one link.

    Attributes:
        hz: frames a second on both sides.
        seconds: how long; packets sent after that are in ``extremes``.
        extremes: one packet of each kind, no byte of which MAVLink could cut off.
        sent, received: packets of both ends, by their own counters.
        dropped: of both ends, by reason.
    """

    hz: int
    seconds: int
    packets: list[TappedPacket] = field(default_factory=list[TappedPacket])
    extremes: list[TappedPacket] = field(default_factory=list[TappedPacket])
    sent: int = 0
    received: int = 0
    dropped: dict[str, int] = field(default_factory=dict[str, int])


@frozen
class _Clock:
    def now_ns(self) -> int:
        return stopwatch_ns()


@frozen
class _Context:
    role: Role
    clock: _Clock


class _Tap(asyncio.DatagramProtocol):
    """One side of the tap: what comes in is counted and leaves by the other side."""

    def __init__(self, direction: Role, to: tuple[str, int]) -> None:
        self.direction = direction
        self.packets: list[TappedPacket] = []
        self.other: _Tap | None = None
        self._to = to  # the link end on this side
        self._transport: asyncio.DatagramTransport | None = None

    def connection_made(self, transport: asyncio.DatagramTransport) -> None:
        self._transport = transport

    def datagram_received(self, data: bytes, addr: tuple[str, int]) -> None:
        kind = (
            dialect.mavlink_map[int.from_bytes(data[7:10], "little")]
            .msgname.removeprefix("PATH_")
            .lower()
        )
        self.packets.append(
            TappedPacket(
                kind, self.direction, data[1], len(data), asyncio.get_running_loop().time()
            )
        )
        if self.other is not None and self.other._transport is not None:
            self.other._transport.sendto(data, self.other._to)


def flow(
    work: Work, rates_hz: Sequence[int], seconds: int, mission: MissionConfig, seed: int
) -> list[LinkTraffic]:
    """The traffic at each rate, all at the same time. Raises LinkError when a port cannot be
    had.
    """
    return asyncio.run(_flow(work, rates_hz, seconds, mission, seed))


async def _flow(
    work: Work, rates_hz: Sequence[int], seconds: int, mission: MissionConfig, seed: int
) -> list[LinkTraffic]:
    async with AsyncExitStack() as stack:
        key = Path(stack.enter_context(tempfile.TemporaryDirectory())) / "pair.key"
        with os.fdopen(os.open(key, os.O_WRONLY | os.O_CREAT, 0o600), "wb") as file:
            file.write(np.random.default_rng([seed, 0]).bytes(KEY_LENGTH))
        flows = [asyncio.create_task(_one(hz, seconds, mission, seed, key)) for hz in rates_hz]
        try:
            for _ in work.steps("seconds on the link", range(seconds)):
                await asyncio.wait(flows, timeout=1.0, return_when=asyncio.FIRST_EXCEPTION)
            return list(await asyncio.gather(*flows))
        finally:
            for one in flows:
                one.cancel()


async def _one(hz: int, seconds: int, mission: MissionConfig, seed: int, key: Path) -> LinkTraffic:
    """One pair of links with the tap between them."""
    own = dict(zip(Role, _free_ports(2), strict=True))
    async with AsyncExitStack() as stack:
        loop = asyncio.get_running_loop()
        taps: dict[Role, _Tap] = {}
        links: dict[Role, UdpLink] = {}
        for role in Role:
            tap = _Tap(role, (HOST, own[role]))
            transport, _ = await loop.create_datagram_endpoint(
                lambda tap=tap: tap, local_addr=(HOST, 0)
            )
            stack.callback(transport.abort)
            port = transport.get_extra_info("sockname")[1]
            config = UdpLink.Config(f"{HOST}:{own[role]}", f"{HOST}:{port}", key)
            links[role] = await stack.enter_async_context(UdpLink(config, _Context(role, _Clock())))
            taps[role] = tap
        taps[Role.SENDER].other = taps[Role.RECEIVER]
        taps[Role.RECEIVER].other = taps[Role.SENDER]
        pumps = [asyncio.create_task(_pump(link)) for link in links.values()]
        rngs = (np.random.default_rng([seed, hz, k]) for k in range(2))
        sides = [
            _Side(role, links[role], mission, hz, rng) for role, rng in zip(Role, rngs, strict=True)
        ]
        await asyncio.gather(*(side.talk(seconds) for side in sides))
        await asyncio.sleep(SETTLE_S)
        traffic = LinkTraffic(hz, seconds, _taken(taps))
        for role, link in links.items():
            for message in extremes(role):
                link.send(message)
        await asyncio.sleep(SETTLE_S)
        traffic.extremes = _taken(taps)
        for pump in pumps:
            pump.cancel()
        await asyncio.gather(*pumps, return_exceptions=True)
    for link in links.values():
        traffic.sent += link.counters.packets_sent
        traffic.received += link.counters.packets_received
        for reason, count in link.counters.dropped.items():
            traffic.dropped[reason] = traffic.dropped.get(reason, 0) + count
    return traffic


def _taken(taps: dict[Role, _Tap]) -> list[TappedPacket]:
    packets = sorted(
        (packet for tap in taps.values() for packet in tap.packets), key=lambda packet: packet.at_s
    )
    for tap in taps.values():
        tap.packets = []
    return packets


async def _pump(link: UdpLink) -> None:
    """Pumps as a role does: answers pings, takes the rest."""
    while True:
        received = await link.receive()
        if isinstance(received.message, Ping):
            link.send(answer(received.message, received.arrival_ns, stopwatch_ns()))


class _Side:
    """The messages of one role while it verifies, and the hand-over at the end of it."""

    def __init__(
        self, role: Role, link: UdpLink, mission: MissionConfig, hz: int, rng: np.random.Generator
    ) -> None:
        self._role = role
        self._link = link
        self._rng = rng
        status_hz = mission.status_hz if role is Role.SENDER else mission.receiver_status_hz
        self._streams = (
            (float(hz), self._frame),
            (status_hz, self._status),
            (mission.ping_hz, self._ping),
        )

    async def talk(self, seconds: int) -> None:
        await asyncio.gather(*(self._stream(rate, send, seconds) for rate, send in self._streams))
        for message in _handover(self._role):
            self._link.send(message)

    async def _stream(self, rate_hz: float, send: Callable[[int], None], seconds: int) -> None:
        loop = asyncio.get_running_loop()
        begin_s = loop.time()
        for k in range(round(rate_hz * seconds)):
            await asyncio.sleep(max(0.0, begin_s + k / rate_hz - loop.time()))
            send(k)
        await asyncio.sleep(max(0.0, begin_s + seconds - loop.time()))

    def _frame(self, k: int) -> None:
        make = a_target if self._role is Role.SENDER else a_candidate
        self._link.send(make(self._rng, 1000 + k, stopwatch_ns()))

    def _status(self, _: int) -> None:
        rng = self._rng
        responsible = self._role is Role.SENDER
        position = _vector(rng, 5.0)
        velocity = _vector(rng, 0.4)
        yaw = float(rng.uniform(-3.1, 3.1))
        battery = float(rng.uniform(0.3, 1.0))
        self._link.send(
            Status(
                self._role,
                stopwatch_ns(),
                position,
                velocity,
                yaw,
                int(Phase.VERIFY),
                responsible,
                True,
                battery,
                INSTANCE,
            )
        )

    def _ping(self, k: int) -> None:
        self._link.send(Ping(k + 1, stopwatch_ns()))


def a_target(rng: np.random.Generator, sequence: int, stamp_ns: int) -> Target:
    """Return a Target with everything it can carry, as in a verification two metres from the
    target.
    """
    x, y, z = rng.normal((0.0, 0.0, 1.0), 0.3).tolist()
    norm = float(np.linalg.norm((x, y, z)))
    gravity = (x / norm, y / norm, z / norm)
    point = _vector(rng, 2.0)
    return Target(
        HANDOFF,
        EPOCH,
        TARGET_ID,
        sequence,
        stamp_ns,
        point,
        gravity,
        float(rng.uniform(0.004, 0.02)),
    )


def a_candidate(rng: np.random.Generator, sequence: int, stamp_ns: int) -> Candidate:
    """Return a Candidate with box and pose."""
    w, x, y, z = rng.standard_normal(4).tolist()
    norm = float(np.linalg.norm((w, x, y, z)))
    rotation: Quat = (w / norm, x / norm, y / norm, z / norm)
    u, v, width, height = rng.uniform(
        (0.0, 0.0, 30.0, 30.0), (1100.0, 600.0, 150.0, 100.0)
    ).tolist()
    box = Box(u, v, width, height)
    sigma_m = float(rng.uniform(0.002, 0.02))
    return Candidate(
        HANDOFF,
        EPOCH,
        TARGET_ID,
        sequence,
        sequence - 1,
        stamp_ns,
        box,
        None,
        _vector(rng, 1.5),
        rotation,
        sigma_m,
    )


def _vector(rng: np.random.Generator, reach: float) -> Vec3:
    x, y, z = rng.uniform(-reach, reach, 3).tolist()
    return x, y, z


def _handover(role: Role) -> tuple[Message, ...]:
    now_ns = stopwatch_ns()
    nonce = 0x8F3A61C4
    if role is Role.RECEIVER:
        return (Accept(HANDOFF, EPOCH, TARGET_ID, nonce, now_ns, INSTANCE),)
    commit = Commit(HANDOFF, EPOCH, TARGET_ID, nonce, now_ns + 2_000_000_000, now_ns, INSTANCE)
    return commit, Confirm(HANDOFF, EPOCH, TARGET_ID, nonce, now_ns, INSTANCE)


def extremes(role: Role) -> tuple[Message, ...]:
    """One message of every kind the role sends, as long as it can be on the wire: its last byte is
    not zero.
    """
    late = 2**64 - 1
    full = 2**16 - 1
    most = 2**32 - 1
    alike = Alike(full, full, full, full, full, full, full, full, full)
    status = Status(
        role,
        late // 8,
        (1e3, -1e3, -50.0),
        (9.0, -9.0, 3.0),
        -3.0,
        255,
        True,
        True,
        1.0,
        INSTANCE,
        ended=255,
        steps=STEPS - 1,
        alike=alike,
    )
    ping = Ping(most, late)
    pong = Pong(most, late, late, late)
    abort = Abort(full, full, AbortReason.SHUTDOWN, late, INSTANCE)
    if role is Role.SENDER:
        target = a_target(np.random.default_rng(1), full, late // 8)
        commit = Commit(full, full, 255, most, late, late, INSTANCE)
        confirm = Confirm(full, full, 255, most, late, INSTANCE)
        return target, status, ping, pong, commit, confirm, abort
    pose: Quat = (0.5, -0.5, 0.5, 0.5)
    missed = MissReason.NO_CANDIDATE
    candidate = Candidate(
        full, full, 255, full, full, late // 8, None, missed, (-1.0, 2.0, 0.5), pose, 0.05
    )
    return candidate, status, ping, pong, Accept(full, full, 255, most, late, INSTANCE), abort


def _free_ports(count: int) -> list[int]:
    """UDP ports that are free now; they are named in the links' configuration, so they must be
    known before.
    """
    sockets = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(count)]
    try:
        for one in sockets:
            one.bind((HOST, 0))
        return [int(one.getsockname()[1]) for one in sockets]
    except OSError as error:
        raise LinkError(f"no free UDP port on {HOST}: {error.strerror}") from error
    finally:
        for one in sockets:
            one.close()
