"""The line between a role's program and its guard: UDP datagrams on one computer, beats there and
answers back.

A hung or killed program simply sends nothing more; nothing here waits for anybody. Both ends seal
what they say with the key of the guard's run: what another program sends is counted and ignored.
"""

from __future__ import annotations

import contextlib
import socket
import struct
from typing import Self

from drivers.interfaces import Clock, PartError
from drivers.link.udp import Address, address_of
from drivers.mavlink.guard.interfaces import Beat, GuardAnswer, Hand, Script
from drivers.mavlink.guard.seal import (
    KeyReader,
    Opener,
    Seals,
    forget_key,
    keep_key,
    key_path,
    make_key,
)

_BEAT = struct.Struct("!4sBIffff")  # magic, script, setpoints, separation, peer's north, east, down
_ANSWER = struct.Struct("!4sBB")  # magic, sees, hand; then reason and alarm
_BEAT_MAGIC = b"PGb1"
_ANSWER_MAGIC = b"PGa1"
_MOST_BYTES = 1024
# a role whose guard's key is gone is silent; it is taken for dead after beat_age_s
_KEY_LOOK_NS = 100_000_000
_MOST_READS = 1000  # at once: a flood does not keep a guard from its rules
_WORDS_BYTES = 400
_BETWEEN = "\0"  # reason and alarm
FOREIGN = "beats that are not sealed by this run's program"


def encode_beat(beat: Beat) -> bytes:
    setpoints = beat.setpoints & 0xFFFFFFFF
    return _BEAT.pack(_BEAT_MAGIC, beat.script.value, setpoints, beat.separation_m, *beat.peer_n_m)


def decode_beat(packet: bytes) -> Beat | None:
    """None for what is no beat."""
    if len(packet) != _BEAT.size:
        return None
    magic, script, setpoints, separation_m, *peer = _BEAT.unpack(packet)
    if magic != _BEAT_MAGIC or script not in (known.value for known in Script):
        return None
    return Beat(Script(script), setpoints, separation_m, (peer[0], peer[1], peer[2]))


def encode_answer(answer: GuardAnswer) -> bytes:
    words = [
        text.replace(_BETWEEN, " ").encode("utf-8")[:_WORDS_BYTES]
        for text in (answer.reason, answer.alarm)
    ]
    return _ANSWER.pack(_ANSWER_MAGIC, answer.sees, answer.hand.value) + _BETWEEN.encode().join(
        words
    )


def decode_answer(packet: bytes) -> GuardAnswer | None:
    """None for what is no answer."""
    if len(packet) < _ANSWER.size:
        return None
    magic, sees, hand = _ANSWER.unpack_from(packet)
    if magic != _ANSWER_MAGIC or sees not in (0, 1) or hand not in (known.value for known in Hand):
        return None
    reason, _, alarm = packet[_ANSWER.size :].decode("utf-8", "replace").partition(_BETWEEN)
    return GuardAnswer(bool(sees), Hand(hand), reason, alarm)


def is_taken(bind: str) -> bool:
    """Return whether somebody listens there: a guard, one hopes; the role asks it before it
    flies.
    """
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind(address_of(bind, "bind"))
        except OSError:
            return True
    return False


class _Socket:
    """A datagram socket that never blocks and never raises once it is open."""

    def __init__(self) -> None:
        self._socket: socket.socket | None = None

    def open(self, bind: Address | None, peer: Address | None) -> None:
        opened = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        opened.setblocking(False)
        try:
            if bind is not None:
                opened.bind(bind)
            if peer is not None:
                opened.connect(peer)
        except OSError:
            opened.close()
            raise
        self._socket = opened

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def send(self, packet: bytes, to: Address | None = None) -> None:
        if self._socket is None:
            return
        with contextlib.suppress(OSError):  # nobody there: that is for the answers to tell
            self._socket.sendto(packet, to) if to else self._socket.send(packet)

    def receive(self) -> tuple[bytes, Address] | None:
        """One packet that waits; None when there is none."""
        while self._socket is not None:
            try:
                return self._socket.recvfrom(_MOST_BYTES)
            except BlockingIOError:
                return None
            except OSError:  # an earlier packet found nobody: the next ones may wait behind this
                continue
        return None


class UdpGuardLine:
    """A ``drivers.mavlink.guard.interfaces.GuardLine``: the role's end."""

    def __init__(self, guard: str, clock: Clock) -> None:
        """``guard``: ``host:port`` where the guard listens."""
        self.name = guard
        self._clock = clock
        self._socket = _Socket()
        self._key, self._seals, self._opener = KeyReader(guard), Seals(), Opener()
        self._answer: tuple[int, GuardAnswer] | None = None

    async def __aenter__(self) -> Self:
        try:
            self._socket.open(None, address_of(self.name, "bind"))
        except OSError as error:
            raise PartError(
                f"no way to the guard at {self.name}: {error.strerror}", "correct its bind"
            ) from error
        return self

    async def __aexit__(self, *_: object) -> None:
        self._socket.close()

    def beat(self, beat: Beat) -> None:
        key = self._key.read()
        if key is not None:  # there is no guard yet, or it is another user's
            self._socket.send(self._seals.seal(key, encode_beat(beat)))

    def answer(self) -> tuple[int, GuardAnswer] | None:
        while (received := self._socket.receive()) is not None:
            key = self._key.read()
            said = None if key is None else self._opener.open(key, received[0])
            answer = None if said is None else decode_answer(said)
            if answer is not None:
                self._answer = self._clock.now_ns(), answer
        return self._answer


class UdpBeatLine:
    """A ``drivers.mavlink.guard.interfaces.BeatLine``: the guard's end."""

    def __init__(self, bind: str, clock: Clock) -> None:
        self._bind = bind
        self._clock = clock
        self._socket = _Socket()
        self._key, self._seals, self._opener = b"", Seals(), Opener()
        self._looked_ns = 0
        self._from: Address | None = None
        self.ignored: dict[str, int] = {}

    async def __aenter__(self) -> Self:
        try:
            self._socket.open(address_of(self._bind, "bind"), None)
        except OSError as error:
            remedy = "is another guard of this drone running? end it, or give each its own bind"
            raise PartError(
                f"the guard cannot listen on {self._bind}: {error.strerror}", remedy
            ) from error
        try:
            self._key = make_key(self._bind)
        except OSError as error:
            self._socket.close()
            remedy = "make room there, and remove what another user left under this name"
            raise PartError(
                f"the guard's key {key_path(self._bind)}: {error.strerror}", remedy
            ) from error
        return self

    async def __aexit__(self, *_: object) -> None:
        self._socket.close()
        forget_key(self._bind, self._key)

    def newest(self) -> tuple[int, Beat] | None:
        now_ns = self._clock.now_ns()
        if now_ns - self._looked_ns > _KEY_LOOK_NS:
            self._looked_ns = now_ns
            keep_key(self._bind, self._key)
        newest: Beat | None = None
        for _ in range(_MOST_READS):
            received = self._socket.receive()
            if received is None:
                break
            said = self._opener.open(self._key, received[0])
            beat = None if said is None else decode_beat(said)
            if beat is None:
                self.ignored[FOREIGN] = self.ignored.get(FOREIGN, 0) + 1
            else:
                newest = beat
                self._from = received[1]
        return None if newest is None else (self._clock.now_ns(), newest)

    def answer(self, answer: GuardAnswer) -> None:
        if self._from is not None:
            self._socket.send(self._seals.seal(self._key, encode_answer(answer)), self._from)
