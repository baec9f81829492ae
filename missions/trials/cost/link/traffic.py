"""The packets of a verification, as both ends of a link encode and sign them, in virtual time."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from drivers.link.dialect import path_dialect as dialect
from drivers.link.wire import KEY_LENGTH, UDP_IP_OVERHEAD, Codec
from flight.clocks import answer
from flight.config import MissionConfig
from flight.phases import Phase
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

HANDOFF = 1
EPOCH = 7
TARGET_ID = 1
INSTANCE = 0xA3F01C
NONCE = 0x8F3A61C4
BOOTED_NS = 3600 * 10**9  # since both computers were switched on
LEASE_NS = 2 * 10**9


@frozen
class Packet:
    """One datagram."""

    kind: str
    sender: Role
    payload_b: int
    mavlink_b: int

    @property
    def wire_b(self) -> int:
        """The size with its UDP and IPv4 headers, which the kernel adds."""
        return self.mavlink_b + UDP_IP_OVERHEAD


def packets_of(role: Role, key: bytes, messages: Iterator[Message]) -> list[Packet]:
    """Encode and sign what one end sends."""
    codec = Codec(role, key)
    return [packet_of(role, codec.encode(message)) for message in messages]


def packet_of(role: Role, data: bytes) -> Packet:
    """Return what a datagram is, by its header."""
    name = dialect.mavlink_map[int.from_bytes(data[7:10], "little")].msgname
    return Packet(name.removeprefix("PATH_").lower(), role, data[1], len(data))


def verification(hz: int, seconds: int, mission: MissionConfig, seed: int) -> list[Packet]:
    """Return all packets of both ends that verify for so long, and hand over at the end of it."""
    key = np.random.default_rng([seed, 0]).bytes(KEY_LENGTH)
    packets: list[Packet] = []
    for k, role in enumerate(Role):
        rng = np.random.default_rng([seed, hz, k])
        packets += packets_of(role, key, said_by(role, hz, seconds, mission, rng))
    return packets


def said_by(
    role: Role, hz: int, seconds: int, mission: MissionConfig, rng: np.random.Generator
) -> Iterator[Message]:
    """Yield the messages of one role, stream by stream: no size depends on their order."""
    frame = a_target if role is Role.SENDER else a_candidate
    for number, now_ns in enumerate(_instants(hz, seconds)):
        yield frame(rng, 1000 + number, now_ns)
    status_hz = mission.status_hz if role is Role.SENDER else mission.receiver_status_hz
    for now_ns in _instants(status_hz, seconds):
        yield a_status(role, rng, now_ns)
    for number, now_ns in enumerate(_instants(mission.ping_hz, seconds)):
        ping = Ping(number + 1, now_ns)
        yield ping
        # The peer pings as often, and is answered.
        yield answer(ping, now_ns, now_ns)
    yield from _handover(role, BOOTED_NS + seconds * 10**9)


def _instants(rate_hz: float, seconds: int) -> list[int]:
    return [BOOTED_NS + round(k * 1e9 / rate_hz) for k in range(round(rate_hz * seconds))]


def _handover(role: Role, now_ns: int) -> tuple[Message, ...]:
    if role is Role.RECEIVER:
        return (Accept(HANDOFF, EPOCH, TARGET_ID, NONCE, now_ns, INSTANCE),)
    commit = Commit(HANDOFF, EPOCH, TARGET_ID, NONCE, now_ns + LEASE_NS, now_ns, INSTANCE)
    return commit, Confirm(HANDOFF, EPOCH, TARGET_ID, NONCE, now_ns, INSTANCE)


def a_status(role: Role, rng: np.random.Generator, stamp_ns: int) -> Status:
    """Return a Status of a drone that verifies."""
    position = _vector(rng, 5.0)
    velocity = _vector(rng, 0.4)
    yaw = float(rng.uniform(-3.1, 3.1))
    battery = float(rng.uniform(0.3, 1.0))
    phase = int(Phase.VERIFY)
    responsible = role is Role.SENDER
    return Status(
        role, stamp_ns, position, velocity, yaw, phase, responsible, True, battery, INSTANCE
    )


def a_target(rng: np.random.Generator, sequence: int, stamp_ns: int) -> Target:
    """Return a Target with everything it can carry, as in a verification two metres from the
    target.
    """
    x, y, z = rng.normal((0.0, 0.0, 1.0), 0.3).tolist()
    norm = float(np.linalg.norm((x, y, z)))
    gravity = (x / norm, y / norm, z / norm)
    point = _vector(rng, 2.0)
    sigma_m = float(rng.uniform(0.004, 0.02))
    return Target(HANDOFF, EPOCH, TARGET_ID, sequence, stamp_ns, point, gravity, sigma_m)


def a_candidate(rng: np.random.Generator, sequence: int, stamp_ns: int) -> Candidate:
    """Return a Candidate with box and pose."""
    w, x, y, z = rng.standard_normal(4).tolist()
    norm = float(np.linalg.norm((w, x, y, z)))
    rotation: Quat = (w / norm, x / norm, y / norm, z / norm)
    low = (0.0, 0.0, 30.0, 30.0)
    high = (1100.0, 600.0, 150.0, 100.0)
    box = Box(*rng.uniform(low, high).tolist())
    sigma_m = float(rng.uniform(0.002, 0.02))
    ids = HANDOFF, EPOCH, TARGET_ID, sequence, sequence - 1
    return Candidate(*ids, stamp_ns, box, None, _vector(rng, 1.5), rotation, sigma_m)


def _vector(rng: np.random.Generator, reach: float) -> Vec3:
    x, y, z = rng.uniform(-reach, reach, 3).tolist()
    return x, y, z


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
