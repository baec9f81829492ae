from __future__ import annotations

from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.link.framing import PacketFramer
from drivers.link.wire import Codec
from path.messages import Accept, Candidate, Message, Role, Target
from path.observations import Box

KEY = bytes(range(32))
TARGET = Target(1, 2, 3, 4, 50_000, (1.0, 2.0, 3.0), (0.0, 0.0, 1.0), 0.01)
CANDIDATE = Candidate(
    1,
    2,
    3,
    4,
    5,
    50_000,
    Box(1.0, 2.0, 3.0, 4.0),
    None,
    (0.1, 0.2, 0.3),
    (1.0, 0.0, 0.0, 0.0),
    0.01,
)
MESSAGES: tuple[Message, ...] = (TARGET, CANDIDATE, Accept(1, 2, 3, 4, 5, 9))


def packets(key: bytes | None = KEY) -> list[bytes]:
    codec = Codec(Role.SENDER, key)
    return [codec.encode(message) for message in MESSAGES]


@given(cuts=st.lists(st.integers(1, 40), max_size=60), signed=st.booleans())
def test_a_stream_cut_anywhere_gives_its_packets(cuts: list[int], signed: bool) -> None:
    sent = packets(KEY if signed else None)
    stream, framer, got = b"".join(sent), PacketFramer(), list[bytes]()
    for cut in cuts:
        got += framer.feed(stream[:cut])
        stream = stream[cut:]
    assert [*got, *framer.feed(stream)] == sent
    assert framer.skipped == 0


@given(
    noise=st.lists(
        st.binary(max_size=40).map(lambda b: b.replace(b"\xfd", b"\xfc")), min_size=4, max_size=4
    )
)
def test_noise_between_packets_is_skipped(noise: list[bytes]) -> None:
    sent = packets()
    stream = noise[0] + b"".join(packet + gap for packet, gap in zip(sent, noise[1:], strict=True))
    framer = PacketFramer()
    assert framer.feed(stream) == sent
    assert framer.skipped == sum(map(len, noise))


@settings(max_examples=300)
@given(noise=st.binary(max_size=400), sizes=st.lists(st.integers(1, 30), max_size=30))
def test_noise_that_looks_like_a_beginning_costs_nothing_behind_it(
    noise: bytes, sizes: list[int]
) -> None:
    """Whatever came before, the packets are there once as many bytes have passed as the false
    beginning claims.
    """
    sent, behind = packets(), bytes(300)
    stream, framer, got = noise + b"".join(sent) + behind, PacketFramer(), list[bytes]()
    for size in sizes:
        got += framer.feed(stream[:size])
        stream = stream[size:]
    got += framer.feed(stream)
    assert got[-len(sent) :] == sent


def test_a_false_beginning_waits_for_no_more_than_a_packet() -> None:
    sent = packets()
    false = sent[0][:20]
    framer = PacketFramer()
    assert framer.feed(false + sent[1]) == [sent[1]]


def test_a_damaged_packet_does_not_take_the_next_one_with_it() -> None:
    sent = packets()
    for index in range(len(sent[0])):
        damaged = bytearray(sent[0])
        damaged[index] ^= 0x10
        framer = PacketFramer()
        got = framer.feed(bytes(damaged) + b"".join(sent[1:]) + bytes(300))
        assert got[-2:] == sent[1:]
