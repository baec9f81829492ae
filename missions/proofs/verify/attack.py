"""A third process that wants to lock two drones out, or to move something: it floods both with what
it can make.

    python -m missions.proofs.verify.attack RATE AIR_PORT SENDER RECEIVER SEED RUN_FOLDER

It hears the air and has recordings of earlier flights, knows the dialect and where both drones
listen, has keys, but not the pair's. Half of its packets come from an address of its own, half as
if from the other drone. A closed stdin ends it. What it heard is kept beside the run's folder, for
the next attack.
"""

from __future__ import annotations

import asyncio
import sys
from collections import deque
from pathlib import Path
from random import Random
from typing import Any

from drivers.link.udp import Address, address_of
from missions.proofs.verify.forger import REMEMBERED, Forger

TICK_S = 0.01
FORGED_HZ = 4000.0  # a second are made anew; in a faster flood each is sent again and again
POOL = 2000
BATCH = 100  # packets on the air in one datagram,
MANY = 2  # which says so in its first byte
RECORDING = ".air"
OLD_SHARE = 0.2  # of the packets: of earlier flights, sent once more
MOST_RECORDED = 20_000


class Attacker(asyncio.DatagramProtocol):
    """Hears the air on its socket, and sends from it."""

    def __init__(
        self,
        air: Address,
        ends: tuple[Address, Address],
        rng: Random,
        earlier: list[tuple[int, bytes]],
    ) -> None:
        self._air = air
        self._ends = ends
        self._rng = rng
        self._earlier = earlier
        self._forgers = Forger(Random(rng.random())), Forger(Random(rng.random()))
        self._transport: asyncio.DatagramTransport | None = None
        self.heard: deque[tuple[int, bytes]] = deque(maxlen=MOST_RECORDED)
        self._pool: tuple[list[bytes], list[bytes]] = [], []
        self._owed = 0
        self.sent = 0

    def connection_made(self, transport: Any) -> None:
        self._transport = transport
        transport.sendto(b"\0", self._air)  # from here on the air is heard

    def datagram_received(self, data: bytes, addr: tuple[Any, ...]) -> None:
        del addr
        side = data[0]
        packet = data[1:]
        self.heard.append((side, packet))
        self._forgers[side].toward.append(packet)
        self._forgers[1 - side].back.append(packet)

    def error_received(self, exc: Exception) -> None:
        """A drone does not listen now: it may later."""

    async def flood(self, rate_hz: float) -> None:
        """Send for ever; what cannot be sent in time is left out."""
        loop = asyncio.get_running_loop()
        begun_s = loop.time()
        due = 0
        while True:
            await asyncio.sleep(TICK_S)
            now = round((loop.time() - begun_s) * rate_hz)
            number = min(now - due, round(10.0 * rate_hz * TICK_S))
            if rate_hz <= FORGED_HZ:
                for _ in range(number):
                    self._send(*self._made())
            else:
                self._pour(number)
            due = now

    def _pour(self, number: int) -> None:
        """Send so many packets, few of them new ones. What is not of this address goes onto the
        air by the handful.
        """
        for _ in range(min(number, round(FORGED_HZ * TICK_S / 2))):
            side, packet = self._made()
            pool = self._pool[side]
            if packet and len(pool) < POOL:
                pool.append(packet)
            elif packet:
                pool[self._rng.randrange(POOL)] = packet
        assert self._transport is not None
        rounds, self._owed = divmod(self._owed + number, 2 * BATCH)
        for _ in range(rounds):
            side = self._rng.randrange(2)
            pool = self._pool[side]
            if not pool:
                continue
            begin = self._rng.randrange(len(pool))
            packets = [pool[(begin + k) % len(pool)] for k in range(BATCH)]
            for packet in packets:
                self._transport.sendto(packet, self._ends[side])
            together = b"".join(len(packet).to_bytes(2, "little") + packet for packet in packets)
            self._transport.sendto(bytes((MANY + side,)) + together, self._air)
            self.sent += 2 * BATCH

    def _made(self) -> tuple[int, bytes]:
        """Return a packet, and the side that it is for."""
        side = self._rng.randrange(2)
        forger = self._forgers[side]
        if self._earlier and self._rng.random() < OLD_SHARE:
            side, packet = self._rng.choice(self._earlier)
        elif len(forger.toward) > 1 and forger.back:
            _, packet = forger.forge()
        else:
            packet = self._rng.randbytes(self._rng.randrange(REMEMBERED))
        return side, packet

    def _send(self, side: int, packet: bytes) -> None:
        assert self._transport is not None
        if self._rng.random() < 0.5:
            self._transport.sendto(packet, self._ends[side])
        elif packet:
            self._transport.sendto(bytes((side,)) + packet, self._air)
        self.sent += 1


def earlier_flights(out: Path) -> list[tuple[int, bytes]]:
    """Return the packets recorded beside a run's folder before; a line is the side and the
    packet.
    """
    recorded: list[tuple[int, bytes]] = []
    for file in sorted(out.parent.glob(f"*{RECORDING}")):
        for line in file.read_text("ascii").splitlines():
            side, _, packet = line.partition(" ")
            recorded.append((int(side), bytes.fromhex(packet)))
    return recorded


async def attack(
    rate_hz: float,
    air: int,
    ends: tuple[Address, Address],
    seed: int,
    out: Path,
) -> None:
    """Attacks until stdin is closed."""
    loop = asyncio.get_running_loop()
    ended = asyncio.Event()
    loop.add_reader(sys.stdin.fileno(), ended.set)
    attacker = Attacker(("127.0.0.1", air), ends, Random(f"attack {seed}"), earlier_flights(out))
    transport, _ = await loop.create_datagram_endpoint(
        lambda: attacker, local_addr=("127.0.0.1", 0)
    )
    flood = asyncio.create_task(attacker.flood(rate_hz))
    begun_s = loop.time()
    try:
        await asyncio.wait(
            [flood, asyncio.ensure_future(ended.wait())], return_when=asyncio.FIRST_COMPLETED
        )
    finally:
        flood.cancel()
        transport.abort()
        lines = (f"{side} {packet.hex()}\n" for side, packet in attacker.heard)
        out.with_name(out.name + RECORDING).write_text("".join(lines), "ascii")
        for_s = loop.time() - begun_s
        told = f"sent {attacker.sent}\nheard {len(attacker.heard)}\nfor_s {for_s:.1f}\nhz {attacker.sent / for_s:.0f}\n"
        (out / "attack.txt").write_text(told, "ascii")


def main() -> None:
    rate, air, sender, receiver, seed, out = sys.argv[1:]
    ends = address_of(sender, "sender"), address_of(receiver, "receiver")
    asyncio.run(attack(float(rate), int(air), ends, int(seed), Path(out)))


if __name__ == "__main__":
    main()
