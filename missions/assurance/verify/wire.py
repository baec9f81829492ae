"""Forged, altered and repeated packets by the million, and what a link's end makes of them.

Between the forger's packets the true peer goes on sending: each of its packets must still be taken, whatever came in
between. The forger hears every packet and has everything but the key. Now and then the victim's process is started
anew, and knows nothing of what it took before; until the peer has proven itself a recorded ping may be answered, as
that moves nothing, and nothing else may come through.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from random import Random
from typing import Any, TextIO

from rich.table import Table

from drivers.clock import busy_ns
from drivers.link.fields import FROM_WIRE
from drivers.link.units import OutOfRange
from drivers.link.wire import KEY_LENGTH, Codec, Drop
from missions.assurance.verify.forger import Forger
from missions.report.command import show as tell
from missions.work import Work
from path.messages import Candidate, Message, Ping, Pong, Role, Status, Target

CHUNK = 20_000  # packets forged in one piece of work
BURST = 40  # of them between two packets of the true peer
STEP = 2_000  # units of 10 us from one of those to the next
BEGIN = 10**12  # of the signing clocks
RESTARTS = 0.2  # of the bursts come upon a victim that was just started
ANSWERED = "ping, answered by a side just started"
SHOWN = 5  # failures told in full
PAGE_KIB = os.sysconf("SC_PAGE_SIZE") / 1024.0

MakeCodec = Callable[[Role, bytes, Callable[[], int]], Codec]


@dataclass(frozen=True, slots=True)
class Piece:
    """Packets to forge in one process. ``make``: of the victim's end."""

    seed: int
    number: int
    packets: int
    make: MakeCodec


@dataclass(frozen=True, slots=True)
class Fuzzed:
    """What came of it.

    Attributes:
        forged: packets by way of forging; ``dropped``: by the link's reason.
        failures: what was accepted or raised, told so that it can be found again; ``failed`` how many.
        genuine, lost: packets of the true peer in between; those refused, or taken as something else.
        decode_s: time that decoding took, of this thread.
        process: which it was, ``grown_kib`` by how much its memory grew meanwhile.
    """

    forged: Counter[str]
    dropped: Counter[str]
    failed: int
    failures: tuple[str, ...]
    genuine: int
    lost: int
    decode_s: float
    process: int
    grown_kib: float


def hardened(role: Role, key: bytes, stamp: Callable[[], int]) -> Codec:
    """The link's own."""
    return Codec(role, key, stamp=stamp)


def fuzz(packets: int, seed: int, work: Work, make: MakeCodec = hardened) -> list[Fuzzed]:
    """At least ``packets`` forged packets, towards each role in turn, on all cores."""
    pieces = [Piece(seed, k, min(CHUNK, packets), make) for k in range(-(-packets // CHUNK))]
    return work.map("packets forged, in pieces", play, pieces)


def play(piece: Piece) -> Fuzzed:
    """One forger against one end of a link."""
    rng = Random(f"{piece.seed} {piece.number}")
    exchange = _Exchange(rng, tuple(Role)[piece.number % 2], piece.make)
    exchange.begin()
    forged, dropped, failures = Counter[str](), Counter[str](), list[str]()
    failed, decode_ns, before = 0, 0, _resident_kib()
    while forged.total() < piece.packets:
        burst = [exchange.forger.forge() for _ in range(BURST)]
        results: list[Message | Drop | Exception] = []
        begun = busy_ns()
        for _, data in burst:
            try:
                results.append(exchange.victim.decode(data))
            except Exception as error:
                results.append(error)
        decode_ns += busy_ns() - begun
        for (way, data), result in zip(burst, results, strict=True):
            forged[way] += 1
            if isinstance(result, Drop):
                dropped[result.value] += 1
                continue
            if isinstance(result, Ping) and not exchange.proven:
                dropped[ANSWERED] += 1
                continue
            failed += 1
            if len(failures) < SHOWN:
                failures.append(f"seed {piece.seed}, piece {piece.number}, {way}: {data.hex()} -> {result!r}")
        exchange.go_on()
    return Fuzzed(
        forged, dropped, failed, tuple(failures), exchange.genuine, exchange.lost, decode_ns * 1e-9,
        os.getpid(), _resident_kib() - before,
    )  # fmt: skip


class _Exchange:
    """A peer, its victim, and a forger that hears both."""

    def __init__(self, rng: Random, victim: Role, make: MakeCodec) -> None:
        self._key = rng.randbytes(KEY_LENGTH)
        self._rng = rng
        self._now = BEGIN
        self._role = victim
        self._peer_role = Role.RECEIVER if victim is Role.SENDER else Role.SENDER
        self._make = make
        self.victim = make(victim, self._key, lambda: self._now)
        self._peer = Codec(self._peer_role, self._key, stamp=lambda: self._now)
        self._bare = {role: Codec(role, None) for role in Role}
        self.proven = False
        self.forger = Forger(Random(rng.random()))
        self.genuine = self.lost = 0

    def begin(self) -> None:
        """So many packets each way that the forger has something to work on."""
        for _ in range(4 * len(FROM_WIRE)):
            self.go_on()

    def go_on(self) -> None:
        """The peer sends one packet and the victim one, 20 ms after the last ones."""
        self._now += STEP
        if not self.proven:
            self._introduce()
        self._peer_sends(_message(self._peer_role, self._rng))
        self.forger.back.append(self.victim.encode(_message(self._role, self._rng)))
        if self._rng.random() < RESTARTS:
            self.victim = self._make(self._role, self._key, lambda: self._now)
            self.proven = False

    def _introduce(self) -> None:
        ping = Ping(self._rng.randrange(2**32), self._rng.randrange(2**63))
        asked = self.victim.encode(ping)
        self._peer.decode(asked)
        self.forger.back.append(asked)
        self._peer_sends(Pong(ping.nonce, ping.sent_ns, 0, 0))
        self.proven = True

    def _peer_sends(self, message: Message) -> None:
        """One packet of the true peer's, which must come through."""
        data = self._peer.encode(message)
        self.genuine += 1
        try:
            taken: object = self.victim.decode(data)
        except Exception as error:
            taken = error
        # what the wire makes of the numbers, told by ends that know no key
        self.lost += taken != self._bare[self._role].decode(self._bare[self._peer_role].encode(message))
        self.forger.toward.append(data)


def _message(role: Role, rng: Random) -> Message:
    """One that a role might send, any numbers in it that the wire can carry."""
    never = Candidate if role is Role.SENDER else Target
    while True:
        kind = rng.choice(tuple(FROM_WIRE))
        payload = kind.unpacker.unpack(rng.randbytes(kind.unpacker.size))
        try:
            message = FROM_WIRE[kind](kind(*[payload[place] for place in kind.orders]))
        except OutOfRange:
            continue
        if not isinstance(message, never) and not (isinstance(message, Status) and message.role is not role):
            return message


def _resident_kib() -> float:
    return int(Path("/proc/self/statm").read_text("ascii").split()[1]) * PAGE_KIB


def summary(fuzzed: Sequence[Fuzzed]) -> dict[str, Any]:
    """Figures of a run. ``grown_kib``: of the process that grew most, after its first piece."""
    forged, dropped = Counter[str](), Counter[str]()
    for each in fuzzed:
        forged += each.forged
        dropped += each.dropped
    decode_s = sum(each.decode_s for each in fuzzed)
    return {
        "packets": forged.total(),
        "accepted_or_raised": sum(each.failed for each in fuzzed),
        "failures": [told for each in fuzzed for told in each.failures][:SHOWN],
        "genuine": sum(each.genuine for each in fuzzed),
        "genuine_lost": sum(each.lost for each in fuzzed),
        "packets_per_s": forged.total() / decode_s if decode_s > 0.0 else None,
        "grown_kib": max((sum(own) for own in _grown(fuzzed).values()), default=0.0),
        "by_way": dict(forged.most_common()),
        "by_reason": dict(dropped.most_common()),
    }


def _grown(fuzzed: Sequence[Fuzzed]) -> dict[int, list[float]]:
    by_process: dict[int, list[float]] = {}
    for each in fuzzed:
        by_process.setdefault(each.process, []).append(each.grown_kib)
    return {process: grown[1:] for process, grown in by_process.items()}


def sound(figures: dict[str, Any]) -> bool:
    """Nothing taken, nothing raised, and no packet of the true peer lost."""
    return figures["accepted_or_raised"] == 0 and figures["genuine_lost"] == 0


def show(figures: dict[str, Any], stream: TextIO) -> None:
    """For a person: what was sent, and what stopped it."""
    rows = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="dim")
    rows.add_column("forged")
    rows.add_column("packets", justify="right")
    rows.add_column("dropped as")
    rows.add_column("packets", justify="right")
    for (way, sent), (reason, count) in zip_longest(
        figures["by_way"].items(), figures["by_reason"].items(), fillvalue=("", None)
    ):
        rows.add_row(way, "" if sent is None else f"{sent:,}", reason, "" if count is None else f"{count:,}")
    stream.write("\n")
    tell(rows, stream)
    for failure in figures["failures"]:
        stream.write(f"TAKEN OR RAISED: {failure}\n")
    stream.write(
        f"\n{figures['packets']:,} packets: {figures['accepted_or_raised']} taken or raised; "
        f"{figures['genuine']:,} of the true peer between them, {figures['genuine_lost']} lost; "
        f"{figures['packets_per_s'] or 0.0:,.0f} decoded a second and core; "
        f"memory grew by {figures['grown_kib']:,.0f} KiB\n"
    )
