"""Forged, altered and repeated packets by the million, and what a link's end makes of them.

Between the forger's packets the true peer goes on sending, messages of every type equally often:
each of its packets must still be taken, whatever came in between. The forger hears every packet and
has everything but the key. Now and then the victim's process is started anew, and knows nothing of
what it took before; until the peer has proven itself a recorded ping may be answered, as that moves
nothing, and nothing else may come through, be it the true peer's. Now and then the peer's packet is
rightly signed and *nearly* valid: one of its fields means nothing, and it must be dropped.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial
from itertools import zip_longest
from pathlib import Path
from random import Random
from typing import Any, TextIO

from rich.table import Table

from drivers.clock import busy_ns
from drivers.link.fields import FROM_WIRE, KINDS, NAMED, TO_WIRE
from drivers.link.units import OutOfRange
from drivers.link.wire import KEY_LENGTH, Codec, Drop
from missions.ground.work import Work, call
from missions.look.report.command import show as tell
from missions.proofs.verify.forger import HASH, HEADER, SIGNATURE, Forger, framed, sign
from path.messages import Candidate, Message, Ping, Pong, Role, Status, Target
from path.values import frozen

CHUNK = 20_000  # packets forged in one piece of work
BURST = 40  # of them between two packets of the true peer
STEP = 2_000  # units of 10 us from one of those to the next
BEGIN = 10**12  # of the signing clocks
RESTARTS = 0.2  # of the bursts come upon a victim that was just started
NEARLY = 0.3  # of the true peer's packets are followed by one with a field that means nothing
ANSWERED = "ping, answered by a side just started"
SHOWN = 5  # failures told in full
PAGE_KIB = os.sysconf("SC_PAGE_SIZE") / 1024.0

TRIES = 40  # for a number that means nothing
SMALL = {"role": 3, "battery": 201, "miss": 19, "reason": 9, "instance": 1 << 24}
"""Fields that few of all numbers mean something in, and how many do."""
MakeCodec = Callable[[Role, bytes, Callable[[], int]], Codec]


@frozen
class Fuzzed:
    """The result of fuzzing.

    Attributes:
        forged: packets by way of forging; ``dropped``: by the link's reason.
        failures: what was accepted or raised, told so that it can be found again; ``failed`` how
            many.
        genuine, lost: packets of the true peer in between by type; those refused, or taken as
            something else.
        nearly, believed: rightly signed ones with a meaningless field, by type; those not dropped
            for it.
        early, believed_early: of the true peer before it has proven itself, by type; those that
            were taken.
        decode_s: time that decoding took, of this thread.
        process: which it was, ``grown_kib`` by how much its memory grew meanwhile.
    """

    forged: Counter[str]
    dropped: Counter[str]
    failed: int
    failures: tuple[str, ...]
    genuine: Counter[str]
    lost: int
    nearly: Counter[str]
    believed: int
    early: Counter[str]
    believed_early: int
    decode_s: float
    process: int
    grown_kib: float


def hardened(role: Role, key: bytes, stamp: Callable[[], int]) -> Codec:
    """The link's own."""
    return Codec(role, key, stamp=stamp)


def fuzz(packets: int, seed: int, work: Work, make: MakeCodec = hardened) -> list[Fuzzed]:
    """Try at least ``packets`` forged packets, towards each role in turn, on all cores."""
    pieces = [
        partial(play, seed, k, min(CHUNK, packets), make) for k in range(-(-packets // CHUNK))
    ]
    return work.map("packets forged, in pieces", call, pieces)


def play(seed: int, number: int, packets: int, make: MakeCodec) -> Fuzzed:
    """Set one forger against one end of a link. ``make``: of the victim's end."""
    rng = Random(f"{seed} {number}")
    exchange = _Exchange(rng, tuple(Role)[number % 2], make)
    exchange.begin()
    forged = Counter[str]()
    dropped = Counter[str]()
    failures = list[str]()
    failed = 0
    decode_ns = 0
    before = _resident_kib()
    while forged.total() < packets:
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
                failures.append(f"seed {seed}, piece {number}, {way}: {data.hex()} -> {result!r}")
        exchange.go_on()
    return Fuzzed(
        forged, dropped, failed, tuple(failures), exchange.genuine, exchange.lost, exchange.nearly, exchange.believed,
        exchange.early, exchange.believed_early, decode_ns * 1e-9, os.getpid(), _resident_kib() - before,
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
        self.genuine, self.nearly, self.early = Counter[str](), Counter[str](), Counter[str]()
        self.lost = self.believed = self.believed_early = 0

    def begin(self) -> None:
        """Send so many packets each way that the forger has something to work on."""
        for _ in range(4 * len(FROM_WIRE)):
            self.go_on()

    def go_on(self) -> None:
        """The peer sends one packet and the victim one, 20 ms after the last ones."""
        self._now += STEP
        if not self.proven:
            self._peer_speaks_too_early()
            self._introduce()
        self._peer_sends(a_message(self._peer_role, self._rng))
        if self._rng.random() < NEARLY:
            self._peer_sends_nonsense()
        self.forger.back.append(self.victim.encode(a_message(self._role, self._rng)))
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
        self.genuine[type(message).__name__] += 1
        try:
            taken: object = self.victim.decode(data)
        except Exception as error:
            taken = error
        # what the wire makes of the numbers, told by ends that know no key
        self.lost += taken != self._bare[self._role].decode(
            self._bare[self._peer_role].encode(message)
        )
        self.forger.toward.append(data)

    def _peer_speaks_too_early(self) -> None:
        """Rightly signed, and for all that the victim can know a recording."""
        message = a_message(self._peer_role, self._rng)
        self.early[type(message).__name__] += 1
        taken = self.victim.decode(self._peer.encode(message))
        self.believed_early += taken is not Drop.UNPROVEN and not isinstance(taken, Ping)

    def _peer_sends_nonsense(self) -> None:
        """One field of a message means nothing; checksum and signature hold."""
        message = a_message(self._peer_role, self._rng)
        payload = nonsense(message, self._rng)
        if payload is None:
            return
        self.nearly[type(message).__name__] += 1
        data = (
            framed(self._peer.encode(message)[:HEADER], payload)
            + self._peer.encode(message)[-SIGNATURE:-HASH]
        )
        self.believed += self.victim.decode(data + sign(self._key, data)) is not Drop.OUT_OF_RANGE


def a_message(role: Role, rng: Random) -> Message:
    """One that a role might send, of each type as likely; any numbers in it that the wire can
    carry.
    """
    never = Candidate if role is Role.SENDER else Target
    wanted = rng.choice([kind for kind in FROM_WIRE if kind is not KINDS[never]])
    while True:
        values = _values(wanted, rng)
        for name, most in SMALL.items():
            if name in values:
                values[name] %= most
        message = _meaning(wanted, values)
        if message is None or (isinstance(message, Status) and message.role is not role):
            continue
        if _sendable(message):
            return message


def nonsense(message: Message, rng: Random) -> bytes | None:
    """The payload of a message with one number in it that means nothing; None where every number
    means something.
    """
    kind = KINDS[type(message)]
    values = _named(kind, TO_WIRE[type(message)](message))
    for _ in range(TRIES):
        name = rng.choice(kind.fieldnames)
        altered = values | {name: _values(kind, rng)[name]}
        if _meaning(kind, altered) is None:
            return _packed(kind, altered)
    return None


def _values(kind: type[Any], rng: Random) -> dict[str, Any]:
    """Any bits."""
    return _named(kind, kind.unpacker.unpack(rng.randbytes(kind.unpacker.size)))


def _named(kind: type[Any], numbers: Sequence[int]) -> dict[str, Any]:
    """Return a payload's numbers by their fields."""
    named: dict[str, Any] = NAMED[kind](numbers)._asdict()
    return named


def _packed(kind: type[Any], values: dict[str, Any]) -> bytes:
    numbers: list[int] = []
    for name, length in zip(kind.ordered_fieldnames, kind.array_lengths, strict=True):
        numbers += values[name] if length else [values[name]]
    packed: bytes = kind.unpacker.pack(*numbers)
    return packed


def _meaning(kind: type[Any], values: dict[str, Any]) -> Message | None:
    try:
        return FROM_WIRE[kind](kind(**values))
    except OutOfRange:
        return None


def _sendable(message: Message) -> bool:
    """A few numbers can be heard and not said: the lowest that a field of both signs can hold."""
    try:
        TO_WIRE[type(message)](message)
    except OutOfRange:
        return False
    return True


def _resident_kib() -> float:
    return int(Path("/proc/self/statm").read_text("ascii").split()[1]) * PAGE_KIB


def summary(fuzzed: Sequence[Fuzzed]) -> dict[str, Any]:
    """Figures of a run. ``grown_kib``: of the process that grew most, after its first piece."""
    forged, dropped, genuine, nearly, early = (Counter[str]() for _ in range(5))
    for each in fuzzed:
        forged += each.forged
        dropped += each.dropped
        genuine += each.genuine
        nearly += each.nearly
        early += each.early
    decode_s = sum(each.decode_s for each in fuzzed)
    return {
        "packets": forged.total(),
        "accepted_or_raised": sum(each.failed for each in fuzzed),
        "failures": [told for each in fuzzed for told in each.failures][:SHOWN],
        "genuine": genuine.total(),
        "genuine_lost": sum(each.lost for each in fuzzed),
        "nearly_valid": nearly.total(),
        "nearly_valid_taken": sum(each.believed for each in fuzzed),
        "early": early.total(),
        "early_taken": sum(each.believed_early for each in fuzzed),
        "packets_per_s": forged.total() / decode_s if decode_s > 0.0 else None,
        "grown_kib": max((sum(own) for own in _grown(fuzzed).values()), default=0.0),
        "by_way": dict(forged.most_common()),
        "by_reason": dict(dropped.most_common()),
        "by_message": {
            "genuine": dict(genuine),
            "nearly valid": dict(nearly),
            "early": dict(early),
        },
    }


def _grown(fuzzed: Sequence[Fuzzed]) -> dict[int, list[float]]:
    by_process: dict[int, list[float]] = {}
    for each in fuzzed:
        by_process.setdefault(each.process, []).append(each.grown_kib)
    return {process: grown[1:] for process, grown in by_process.items()}


def sound(figures: dict[str, Any]) -> bool:
    """Return whether nothing was taken that should not be, nothing raised, and no packet of the
    true peer lost.
    """
    bad = ("accepted_or_raised", "genuine_lost", "nearly_valid_taken", "early_taken")
    return all(figures[name] == 0 for name in bad)


def show(figures: dict[str, Any], stream: TextIO) -> None:
    """Show a person what was sent, and what stopped it."""
    rows = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="dim")
    rows.add_column("forged")
    rows.add_column("packets", justify="right")
    rows.add_column("dropped as")
    rows.add_column("packets", justify="right")
    for (way, sent), (reason, count) in zip_longest(
        figures["by_way"].items(), figures["by_reason"].items(), fillvalue=("", None)
    ):
        rows.add_row(
            way, "" if sent is None else f"{sent:,}", reason, "" if count is None else f"{count:,}"
        )
    stream.write("\n")
    tell(rows, stream)
    for failure in figures["failures"]:
        stream.write(f"TAKEN OR RAISED: {failure}\n")
    stream.write(
        f"\n{figures['packets']:,} packets: {figures['accepted_or_raised']} taken or raised; "
        f"{figures['genuine']:,} of the true peer between them, {figures['genuine_lost']} lost; "
        f"{figures['nearly_valid']:,} nearly valid, {figures['nearly_valid_taken']} taken; "
        f"{figures['early']:,} before it had proven itself, {figures['early_taken']} taken; "
        f"{figures['packets_per_s'] or 0.0:,.0f} decoded a second and core; "
        f"memory grew by {figures['grown_kib']:,.0f} KiB\n"
    )
