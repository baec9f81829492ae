"""A flood from a third process, on real sockets: true packets come through it, and nothing else
does.
"""

from __future__ import annotations

import asyncio
import os
import socket
from collections import Counter
from contextlib import suppress
from pathlib import Path
from random import Random
from types import SimpleNamespace
from typing import Any, cast

import pytest

from drivers.interfaces import PartError, Received
from drivers.link.udp import UdpLink, UdpLinkConfig, address_of
from hil.harness.virtual_time import run_virtual
from hil.link.air import Air
from hil.link.faulty import ProxySide, UdpFaultProxy
from missions.fly.handoff.flight import fly_once
from missions.ground import rig_library
from missions.proofs.verify.attack import RECORDING, Attacker, attack, earlier_flights
from path.messages import Message, Ping, Pong, Role, Status
from tests.drivers.link.link_ends import Context, WallClock, until
from tests.free_ports import free_ports

RATE_HZ = 2000.0
AIR = ("127.0.0.1", 9)


def status(role: Role, stamp_ns: int) -> Status:
    return Status(
        role, stamp_ns, (1.0, 2.0, -1.5), (0.0, 0.0, 0.0), 0.1, 3, role is Role.SENDER, True, 0.5
    )


async def talk(role: Role, link: UdpLink, heard: list[Message]) -> None:
    """A Status and a Ping twenty times a second; pings are answered."""

    async def speak() -> None:
        for number in range(1, 10_000):
            link.send(status(role, number * 1_000_000))
            link.send(Ping(number, number))
            await asyncio.sleep(0.05)

    speaker = asyncio.create_task(speak())
    try:
        while True:
            received: Received = await link.receive()
            if isinstance(received.message, Ping):
                link.send(Pong(received.message.nonce, received.message.sent_ns, 1, 2))
            else:
                heard.append(received.message)
    finally:
        speaker.cancel()


def test_two_drones_that_are_flooded_from_the_start_hear_each_other_and_nobody_else(
    tmp_path: Path,
) -> None:
    key = tmp_path / "pair.key"
    key.write_bytes(os.urandom(32))
    key.chmod(0o600)
    sender, receiver, to_receiver, to_sender = (f"127.0.0.1:{port}" for port in free_ports(4))
    ends = address_of(sender, "sender"), address_of(receiver, "receiver")
    sides = (
        ProxySide(address_of(to_receiver, ""), ends[0]),
        ProxySide(address_of(to_sender, ""), ends[1]),
    )
    places = {Role.SENDER: (sender, to_receiver), Role.RECEIVER: (receiver, to_sender)}
    links = {
        role: UdpLink(UdpLinkConfig(bind, peer, key), Context(role, WallClock()))
        for role, (bind, peer) in places.items()
    }
    heard: dict[Role, list[Message]] = {role: [] for role in Role}

    async def main() -> Attacker:
        loop = asyncio.get_running_loop()
        async with (
            asyncio.timeout(120.0),
            UdpFaultProxy(*sides, seed=1) as proxy,
            Air(proxy) as air,
        ):
            attacker = Attacker(("127.0.0.1", air.port), ends, Random(1), [])
            transport, _ = await loop.create_datagram_endpoint(
                lambda: attacker, local_addr=("127.0.0.1", 0)
            )
            tasks = [asyncio.create_task(attacker.flood(RATE_HZ))]
            async with links[Role.SENDER], links[Role.RECEIVER]:
                tasks += [
                    asyncio.create_task(talk(role, link, heard[role]))
                    for role, link in links.items()
                ]
                await until(
                    lambda: (
                        min(len(each) for each in heard.values()) >= 40 and attacker.sent >= 1500
                    )
                )
                for task in tasks:
                    task.cancel()
                await asyncio.gather(*tasks, return_exceptions=True)
            transport.abort()
            return attacker

    attacker = asyncio.run(main())
    for role, peer in ((Role.SENDER, Role.RECEIVER), (Role.RECEIVER, Role.SENDER)):
        statuses = [one for one in heard[role] if isinstance(one, Status)]
        stamps = [one.stamp_ns for one in statuses]
        assert statuses == [status(peer, stamp) for stamp in stamps]  # nothing forged or altered
        assert stamps == sorted(set(stamps))  # nothing twice
        dropped = links[role].counters.dropped
        assert {"stranger", "bad_signature", "replayed"} <= set(dropped)
        assert sum(dropped.values()) > 0.2 * attacker.sent


class Sockets:
    """What an attacker sends, by where to."""

    def __init__(self) -> None:
        self.sent: Counter[tuple[str, int]] = Counter()
        self.on_air: list[bytes] = []

    def sendto(self, data: bytes, to: tuple[str, int]) -> None:
        self.sent[to] += 1
        if to == AIR:
            self.on_air.append(data)


def test_a_flood_of_fifty_thousand_a_second_is_one_half_of_it_as_if_from_the_other_drone() -> None:
    attacker, sockets = (
        Attacker(AIR, (("127.0.0.1", 1), ("127.0.0.1", 2)), Random(3), []),
        Sockets(),
    )

    async def main() -> None:
        attacker.connection_made(sockets)
        with suppress(TimeoutError):
            async with asyncio.timeout(1.0):
                await attacker.flood(50_000.0)

    run_virtual(main())
    injected: list[int] = []

    def inject(data: bytes, side: int) -> None:
        assert data
        injected.append(side)

    air = Air(cast(Any, SimpleNamespace(inject=inject)))
    for datagram in sockets.on_air[1:]:  # the first one says that it listens
        air.datagram_received(datagram, AIR)
    assert attacker.sent == pytest.approx(50_000, rel=0.05)
    assert (
        len(injected)
        == sockets.sent["127.0.0.1", 1] + sockets.sent["127.0.0.1", 2]
        == attacker.sent // 2
    )
    assert 0.4 < injected.count(0) / len(injected) < 0.6


def test_what_was_heard_is_there_for_the_next_attack(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "run").mkdir()
    (tmp_path / f"earlier{RECORDING}").write_text("0 0102\n1 ff\n")
    assert earlier_flights(tmp_path / "run") == [(0, b"\x01\x02"), (1, b"\xff")]
    reading, writing = os.pipe()
    os.close(writing)  # whoever started it is gone
    with os.fdopen(reading) as stdin, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as air:
        monkeypatch.setattr("sys.stdin", stdin)
        air.bind(("127.0.0.1", 0))
        asyncio.run(
            attack(
                100.0,
                air.getsockname()[1],
                (("127.0.0.1", 9), ("127.0.0.1", 9)),
                1,
                tmp_path / "run",
            )
        )
    assert (tmp_path / f"run{RECORDING}").exists()
    assert "sent" in (tmp_path / "run" / "attack.txt").read_text()


@pytest.mark.parametrize(("rig", "says"), [("sim", "real sockets"), ("sitl", "no key_file")])
def test_an_attack_that_would_show_nothing_is_refused(tmp_path: Path, rig: str, says: str) -> None:
    with pytest.raises(PartError, match=says):
        fly_once(rig_library.load(rig), 1, ["attack=100"], tmp_path, lambda _: None)
