from __future__ import annotations

import asyncio
import gc
import socket
import time
from datetime import UTC, datetime
from pathlib import Path

import pytest
from pytest import MonkeyPatch

from drivers.interfaces import LinkError, Received
from drivers.link.key import read_key, signing_time
from drivers.link.udp import UdpLink, address_of
from drivers.link.wire import Codec
from path.messages import Accept, Commit, Ping, Pong, Role
from tests.drivers.link.link_ends import TARGET, Context, WallClock, introduce, run, until
from tests.free_ports import free_ports


def link(role: Role, bind: str, peer: str, key_file: Path | None = None) -> UdpLink:
    return UdpLink(UdpLink.Config(bind, peer, key_file), Context(role, WallClock()))


def pair(key_file: Path | None = None, host: str = "127.0.0.1") -> tuple[UdpLink, UdpLink]:
    ports = free_ports(2, family=socket.AF_INET6 if ":" in host else socket.AF_INET)
    a, b = (f"{host}:{port}" for port in ports)
    return link(Role.SENDER, a, b, key_file), link(Role.RECEIVER, b, a, key_file)


def sent_by_hand(data: bytes, to: str, port: int = 0) -> None:
    """One datagram, from a port of choice."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
        one.bind(("127.0.0.1", port))
        one.sendto(data, address_of(to, "to"))


@pytest.mark.parametrize("signed", [True, False])
def test_messages_cross_both_ways_and_are_counted_with_their_headers(
    signed: bool, key_file: Path
) -> None:
    async def test() -> None:
        sender, receiver = pair(key_file if signed else None)
        async with sender, receiver:
            if signed:
                await introduce(sender, receiver)
            before = sender.counters.bytes_sent
            start_ns = time.monotonic_ns()
            sender.send(TARGET)
            received = await receiver.receive()
            assert received.message == TARGET
            assert start_ns <= received.arrival_ns <= time.monotonic_ns()
            receiver.send(Accept(1, 2, 3, 4, 5, 9))
            assert (await sender.receive()).message == Accept(1, 2, 3, 4, 5, 9)
            pings = 2 * signed  # each end's, and their answers
            assert sender.counters.packets_sent == sender.counters.packets_received == 1 + pings
            assert sender.counters.bytes_sent == receiver.counters.bytes_received
            assert sender.counters.bytes_sent - before == 28 + 12 + 28 + 13 * signed
            assert sender.counters.dropped == receiver.counters.dropped == {}

    run(test())


def test_ipv6() -> None:
    try:
        sender, receiver = pair(host="[::1]")
    except OSError:
        pytest.skip("no IPv6 on this computer")

    async def test() -> None:
        async with sender, receiver:
            sender.send(TARGET)
            assert (await receiver.receive()).message == TARGET
            assert receiver.counters.bytes_received == 48 + 12 + 28

    run(test())


def test_strangers_forgers_and_noise_are_dropped_by_reason(key_file: Path) -> None:
    async def test() -> None:
        a, b = (f"127.0.0.1:{port}" for port in free_ports(2))
        receiver = link(Role.RECEIVER, b, a, key_file)
        true = Codec(Role.SENDER, read_key(key_file), stamp=signing_time)
        async with receiver:
            sent_by_hand(true.encode(TARGET), to=b)  # well signed, from another address
            port = address_of(a, "a")[1]
            unsigned, forger = (
                Codec(Role.SENDER, None),
                Codec(Role.SENDER, bytes(32), stamp=lambda: 2**48 - 9),
            )
            for data in (b"noise", unsigned.encode(TARGET), forger.encode(TARGET)):
                sent_by_hand(data, to=b, port=port)
            sent_by_hand(true.encode(TARGET), to=b, port=port)  # perhaps a recording
            receiver.send(Ping(1, 5))
            answer, good = true.encode(Pong(1, 5, 6, 7)), true.encode(TARGET)
            for data in (answer, good[:-1], good, good):
                sent_by_hand(data, to=b, port=port)
            assert (await receiver.receive()).message == Pong(1, 5, 6, 7)
            assert (await receiver.receive()).message == TARGET
            await until(lambda: receiver.counters.packets_received == 9)
            reasons = (
                "stranger",
                "not_mavlink",
                "unsigned",
                "bad_signature",
                "truncated",
                "replayed",
                "unproven",
            )
            # the ping, to a port that nobody has
            receiver.counters.dropped.pop("network_error", None)
            assert receiver.counters.dropped == dict.fromkeys(reasons, 1)

    run(test())


def test_a_closed_peer_is_silence_and_it_may_come_back() -> None:
    async def test() -> None:
        sender, receiver = pair()
        async with sender:
            for _ in range(3):
                sender.send(TARGET)
                await asyncio.sleep(0)
            async with receiver:
                receiver.send(Accept(1, 2, 3, 4, 5, 9))
                assert isinstance(await sender.receive(), Received)

    run(test())


def test_a_network_that_is_gone_is_counted() -> None:
    async def test() -> None:
        (port,) = free_ports(1)
        config = UdpLink.Config(f"127.0.0.1:{port}", "192.0.2.1:47001", allow_unsigned=True)
        async with UdpLink(config, Context(Role.SENDER, WallClock())) as sender:
            sender.send(TARGET)  # a loopback address cannot reach another computer
            await until(lambda: sender.counters.dropped == {"network_error": 1})

    run(test())


def test_a_used_port_is_named() -> None:
    async def test() -> None:
        sender, _ = pair()
        again = UdpLink(
            UdpLink.Config(sender_bind(sender), "127.0.0.1:9"), Context(Role.SENDER, WallClock())
        )
        async with sender:
            with pytest.raises(LinkError, match=rf"{sender._bind[1]} is in use"):
                await again.__aenter__()
        async with again:  # free again at once
            pass

    run(test())


def sender_bind(one: UdpLink) -> str:
    return f"{one._bind[0]}:{one._bind[1]}"


def test_an_address_that_is_not_this_computers() -> None:
    async def test() -> None:
        config = UdpLink.Config("192.0.2.1:47001", "192.0.2.2:47001", allow_unsigned=True)
        with pytest.raises(LinkError, match=r"192\.0\.2\.1:47001"):
            await UdpLink(config, Context(Role.SENDER, WallClock())).__aenter__()

    run(test())


def test_closing_frees_the_port_at_once_and_leaves_no_socket() -> None:
    async def test() -> None:
        sender, receiver = pair()
        async with receiver, sender:
            pass
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.bind(sender._bind)

    before, end_s = open_files(), time.monotonic() + 20.0
    run(test())
    # other tests' threads open and close some, too
    while open_files() > before and time.monotonic() < end_s:
        time.sleep(0.05)
    assert open_files() <= before


def open_files() -> int:
    gc.collect()  # what earlier tests left to it as well
    return len(list(Path("/proc/self/fd").iterdir()))


def test_a_key_file_is_looked_at_hard(key_file: Path, tmp_path: Path) -> None:
    assert read_key(key_file) == bytes(range(32))
    key_file.chmod(0o640)
    with pytest.raises(LinkError, match="0640") as caught:
        read_key(key_file)
    assert caught.value.remedy == f"chmod 600 {key_file}"
    key_file.chmod(0o600)
    for content, found in ((b"short", "5"), (bytes(33), "more than 32"), (b"", "0")):
        key_file.write_bytes(content)
        with pytest.raises(LinkError, match=f"{key_file} has {found} bytes") as caught:
            read_key(key_file)
        assert "head -c 32" in caught.value.remedy
    with pytest.raises(LinkError, match="No such file"):
        read_key(tmp_path / "missing")
    with pytest.raises(LinkError, match="not a file"):
        read_key(Path("/dev/zero"))


@pytest.mark.parametrize("year", [2014, 2105, 9999])
def test_a_clock_that_no_signature_can_say_opens_nothing(
    year: int, key_file: Path, monkeypatch: MonkeyPatch
) -> None:
    seconds = datetime(year, 1, 2, tzinfo=UTC).timestamp()
    monkeypatch.setattr(time, "time", lambda: seconds)

    async def test() -> None:
        sender, _ = pair(key_file)
        with pytest.raises(LinkError, match=f"clock says {year}-01-02") as caught:
            await sender.__aenter__()
        assert "set the clock" in caught.value.remedy
        unsigned, _ = pair()
        async with unsigned:
            pass

    run(test())


def test_what_the_peer_says_in_a_flood_is_taken(key_file: Path) -> None:
    """400 forged datagrams from the peer's own address for each of its own, as in a flood of 50,000
    a second.
    """
    (port,) = free_ports(1)
    forged = Codec(Role.SENDER, bytes(32), stamp=signing_time).encode(TARGET)
    true = Codec(Role.SENDER, read_key(key_file), stamp=signing_time)

    async def test() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as peer:
            peer.bind(("127.0.0.1", 0))
            receiver = link(
                Role.RECEIVER, f"127.0.0.1:{port}", f"127.0.0.1:{peer.getsockname()[1]}", key_file
            )
            sent = 0

            async def say(*packets: bytes) -> None:
                nonlocal sent
                for packet in packets:
                    peer.sendto(packet, ("127.0.0.1", port))
                sent += len(packets)
                await until(lambda: receiver.counters.packets_received == sent)

            async with receiver:
                receiver.send(Ping(1, 5))
                await say(true.encode(Pong(1, 5, 6, 7)))
                assert (await receiver.receive()).message == Pong(1, 5, 6, 7)
                for number in range(50):
                    for _ in range(4):
                        await say(*[forged] * 100)
                    await say(true.encode(Commit(number, 2, 3, 4, 5, 6, 9)))
                    assert (await receiver.receive()).message == Commit(number, 2, 3, 4, 5, 6, 9)
                dropped = receiver.counters.dropped
                assert dropped["bad_signature"] + dropped["flooded"] == 20_000
                assert set(dropped) == {"bad_signature", "flooded"}

    run(test(), 120.0)


def test_a_bad_key_opens_nothing(key_file: Path) -> None:
    key_file.chmod(0o644)

    async def test() -> None:
        sender, _ = pair(key_file)
        with pytest.raises(LinkError, match="0644"):
            await sender.__aenter__()
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.bind(sender._bind)

    run(test())


@pytest.mark.parametrize(
    ("bind", "peer", "problem"),
    [
        ("127.0.0.1:47001", "192.168.1.2:47001", "key_file"),
        ("0.0.0.0:47001", "127.0.0.1:47002", "key_file"),
        ("127.0.0.1:47001", "127.0.0.1:47001", "itself"),
        ("127.0.0.1:47001", "[::1]:47002", "both"),
        ("127.0.0.1", "127.0.0.1:47002", "bind"),
        ("127.0.0.1:47001", "127.0.0.1:99999", "peer"),
        ("127.0.0.1:47001", "drone:47001", "peer"),
    ],
)
def test_a_config_that_cannot_be_used_is_refused(bind: str, peer: str, problem: str) -> None:
    with pytest.raises(ValueError, match=problem):
        UdpLink.Config(bind, peer)


def test_unsigned_flight_must_be_asked_for() -> None:
    assert (
        UdpLink.Config("0.0.0.0:47001", "192.168.1.2:47001", allow_unsigned=True).key_file is None
    )
