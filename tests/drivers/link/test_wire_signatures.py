"""Signatures, streams and restarts: whose packet it is, and that it is taken once."""

from __future__ import annotations

import hashlib
import struct

import pytest

from drivers.link.wire import LAST_STAMP, Codec, Drop, introduce
from path.messages import Candidate, Message, Ping, Pong, Role, Status, Target
from tests.drivers.link.wire_packets import (
    CANDIDATE,
    FROM_SENDER,
    KEY,
    STATUS,
    TARGET,
    pair,
    raw,
    raw_target,
)


def test_a_wrong_crc_is_told_from_a_wrong_signature() -> None:
    _, receiver = pair()
    good = bytearray(raw(raw_target(), stamp=100))
    flipped = good.copy()
    flipped[12] ^= 1
    assert receiver.decode(bytes(flipped)) is Drop.BAD_CRC
    for index in range(len(good) - 13, len(good)):  # link id, stamp, hash
        forged = good.copy()
        forged[index] ^= 1
        assert receiver.decode(bytes(forged)) is Drop.BAD_SIGNATURE
    assert isinstance(receiver.decode(bytes(good)), Target)


def test_the_signature_is_the_one_of_the_mavlink_standard() -> None:
    data = Codec(Role.SENDER, KEY, link_id=7, stamp=lambda: 1234).encode(TARGET)
    assert data[-13] == 7
    assert struct.unpack("<IH", data[-12:-6]) == (1234, 0)
    assert data[-6:] == hashlib.sha256(KEY + data[:-6]).digest()[:6]


def test_keys_must_match() -> None:
    sender = Codec(Role.SENDER, KEY)
    assert Codec(Role.RECEIVER, bytes(32)).decode(sender.encode(TARGET)) is Drop.BAD_SIGNATURE
    assert Codec(Role.RECEIVER, None).decode(sender.encode(TARGET)) is Drop.UNEXPECTED_SIGNATURE
    assert (
        Codec(Role.RECEIVER, KEY).decode(Codec(Role.SENDER, None).encode(TARGET)) is Drop.UNSIGNED
    )
    with pytest.raises(ValueError, match="32"):
        Codec(Role.SENDER, b"short")


def test_a_packet_is_taken_once() -> None:
    sender, receiver = pair()
    first, second = sender.encode(TARGET), sender.encode(TARGET)
    assert isinstance(receiver.decode(first), Target)
    assert receiver.decode(first) is Drop.REPLAYED
    assert isinstance(receiver.decode(second), Target)
    assert receiver.decode(first) is Drop.REPLAYED


def test_a_forged_stamp_does_not_lock_out_the_true_sender() -> None:
    """pymavlink's own check believes the stamp before it compares the hash."""
    sender, receiver = pair()
    forged = raw(raw_target(), key=bytes(32), stamp=2**48 - 1)
    for _ in range(3):
        assert receiver.decode(forged) is Drop.BAD_SIGNATURE
    assert isinstance(receiver.decode(sender.encode(TARGET)), Target)
    assert len(receiver._streams) == 1


@pytest.mark.parametrize("clock", [2**48, 2**60, -1, LAST_STAMP + 1])
def test_a_clock_beyond_the_range_of_signatures_signs_on_from_where_it_was(clock: int) -> None:
    now = [1000]
    sender, receiver = Codec(Role.SENDER, KEY, stamp=lambda: now[0]), Codec(Role.RECEIVER, KEY)
    introduce(sender, receiver)
    for now[0] in (2000, clock, clock):
        assert isinstance(receiver.decode(sender.encode(TARGET)), Target)


def test_a_peers_clock_at_the_top_of_the_range_takes_no_one_there() -> None:
    sender, receiver = pair()
    for stamp in (LAST_STAMP + 1, 2**48 - 1):
        assert receiver.decode(raw(raw_target(), stamp=stamp)) is Drop.CLOCK_AT_END
    for _ in range(3):
        assert not isinstance(sender.decode(receiver.encode(CANDIDATE)), Drop)
    assert isinstance(receiver.decode(sender.encode(TARGET)), Target)


def test_our_own_packets_reflected_are_not_the_peers() -> None:
    sender, _ = pair()
    assert sender.decode(sender.encode(STATUS)) is Drop.WRONG_SYSTEM
    assert Codec(Role.RECEIVER, KEY).decode(raw(raw_target(), component=1)) is Drop.WRONG_SYSTEM


@pytest.mark.parametrize("system", [0, 3, 255])
def test_a_third_system_is_nobody_even_with_the_key(system: int) -> None:
    sender, receiver = pair()
    assert isinstance(receiver.decode(sender.encode(TARGET)), Target)
    assert receiver.decode(raw(raw_target(), stamp=10**6, system=system)) is Drop.WRONG_SYSTEM


def test_a_recording_tells_a_restarted_side_nothing() -> None:
    sender, receiver = pair()
    recorded = [
        sender.encode(message)
        for message in (TARGET, Ping(7, 70), Pong(0, 0, 1, 2), *FROM_SENDER[4:7])
    ]
    assert isinstance(receiver.decode(recorded[0]), Target)
    again = Codec(Role.RECEIVER, KEY)
    again.encode(Ping(0, 1))  # other pings than those that were answered before
    told = [again.decode(data) for data in recorded]
    assert told == [
        Drop.UNPROVEN,
        Ping(7, 70),
        Drop.UNPROVEN,
        Drop.UNPROVEN,
        Drop.UNPROVEN,
        Drop.UNPROVEN,
    ]
    again.decode(sender.encode(Pong(0, 1, 2, 3)))
    assert isinstance(again.decode(sender.encode(TARGET)), Target)
    assert {again.decode(data) for data in recorded} == {Drop.REPLAYED}


def test_a_recorded_ping_is_heard_once_and_never_after_a_true_one() -> None:
    """Each would be answered, and a flood of them would fill the air while the peer is away."""
    sender, _ = pair()
    recorded = [sender.encode(Ping(number, number)) for number in range(3)]
    again = Codec(Role.RECEIVER, KEY)
    assert again.decode(recorded[1]) == Ping(1, 1)
    assert [again.decode(data) for data in (*recorded[:2], recorded[1])] == [Drop.REPLAYED] * 3
    assert again.decode(recorded[2]) == Ping(2, 2)
    assert again.decode(sender.encode(Ping(9, 9))) == Ping(9, 9)
    assert {again.decode(data) for data in recorded} == {Drop.REPLAYED}


def test_two_sides_that_restart_at_once_find_each_other() -> None:
    sender, receiver = Codec(Role.SENDER, KEY), Codec(Role.RECEIVER, KEY)
    for first, second in ((sender, receiver), (receiver, sender)):
        assert second.decode(first.encode(Ping(1, 5))) == Ping(1, 5)
        assert (
            first.decode(second.encode(TARGET if second is sender else CANDIDATE)) is Drop.UNPROVEN
        )
        assert first.decode(second.encode(Pong(1, 5, 6, 7))) == Pong(1, 5, 6, 7)
    assert isinstance(receiver.decode(sender.encode(TARGET)), Target)
    assert isinstance(sender.decode(receiver.encode(CANDIDATE)), Candidate)


def test_another_stream_of_the_peer_has_to_prove_itself_too() -> None:
    sender, receiver = pair()
    radio = Codec(Role.SENDER, KEY, link_id=1, stamp=lambda: 10**9)
    assert receiver.decode(radio.encode(TARGET)) is Drop.UNPROVEN
    receiver.encode(Ping(3, 30))
    assert isinstance(receiver.decode(radio.encode(Pong(3, 30, 31, 32))), Pong)
    assert isinstance(receiver.decode(radio.encode(TARGET)), Target)
    assert isinstance(receiver.decode(sender.encode(TARGET)), Target)


def test_without_a_key_nobody_can_prove_anything_and_nobody_is_asked() -> None:
    assert isinstance(
        Codec(Role.RECEIVER, None).decode(Codec(Role.SENDER, None).encode(TARGET)), Target
    )


def test_a_side_that_restarts_in_1970_catches_up_with_the_other() -> None:
    """A companion computer without a battery clock: what it hears sets it right, proven or not."""
    early, right = Codec(Role.SENDER, KEY, stamp=lambda: 10**12), Codec(Role.RECEIVER, KEY)
    introduce(early, right)
    early = Codec(Role.SENDER, KEY)
    assert right.decode(early.encode(Ping(1, 5))) is Drop.REPLAYED
    assert early.decode(right.encode(CANDIDATE)) is Drop.UNPROVEN
    early.encode(Ping(2, 6))  # its stamp may be one that the other has heard; the next is not
    assert right.decode(early.encode(Ping(3, 7))) == Ping(3, 7)
    assert isinstance(early.decode(right.encode(Pong(3, 7, 8, 9))), Pong)
    assert isinstance(right.decode(early.encode(TARGET)), Target)


def test_signing_begins_with_the_clock() -> None:
    """Also with one that stands at nought: no packet carries a stamp that its clock has not
    reached.
    """
    codec = Codec(Role.SENDER, KEY)
    stamps = [int.from_bytes(codec.encode(Ping(1, 1))[-12:-6], "little") for _ in range(3)]
    assert stamps == [0, 1, 2]


@pytest.mark.parametrize("message", [STATUS, *FROM_SENDER[3:]], ids=lambda m: type(m).__name__)
def test_before_its_stream_has_proven_itself_nothing_but_a_ping_of_the_peer_is_taken(
    message: Message,
) -> None:
    sender, receiver = Codec(Role.SENDER, KEY), Codec(Role.RECEIVER, KEY)
    assert receiver.decode(sender.encode(message)) is Drop.UNPROVEN
    assert receiver.decode(sender.encode(Ping(7, 8))) == Ping(7, 8)
    assert receiver.decode(sender.encode(message)) is Drop.UNPROVEN
    introduce(sender, receiver)
    back = receiver.decode(sender.encode(message))
    assert type(back) is type(message)


def test_an_answer_counts_for_the_last_sixteen_pings_and_no_more() -> None:
    for later, taken in ((15, True), (16, False)):
        one, other = Codec(Role.SENDER, KEY), Codec(Role.RECEIVER, KEY)
        for number in range(later + 1):
            one.encode(Ping(number, 100 + number))
        pong = Pong(0, 100, 0, 0)
        assert one.decode(other.encode(pong)) == (pong if taken else Drop.UNPROVEN)


def stamp_of(packet: bytes) -> int:
    return int.from_bytes(packet[-12:-6], "little")


def test_the_clock_is_used_up_to_the_last_stamp_that_is_taken() -> None:
    """Beyond it a clock counts as standing still, and a packet is refused."""
    last, beyond = (
        Codec(Role.SENDER, KEY, stamp=lambda to=to: to) for to in (LAST_STAMP, LAST_STAMP + 1)
    )
    assert stamp_of(last.encode(Ping(1, 1))) == LAST_STAMP
    assert stamp_of(beyond.encode(Ping(1, 1))) < 10
    assert (
        last.encode(Ping(1, 2))
        and Codec(Role.RECEIVER, KEY).decode(last.encode(Ping(1, 3))) is Drop.CLOCK_AT_END
    )


def test_a_datagram_is_authentic_from_the_shortest_there_is() -> None:
    """Ten bytes of header, two of checksum, thirteen of signature; of a whole stranger one less is
    none.
    """
    codec = Codec(Role.SENDER, KEY)
    for length, authentic in ((25, True), (24, False)):
        body = bytes(length - 12) + (5).to_bytes(6, "little")
        assert codec.authentic(body + hashlib.sha256(KEY + body).digest()[:6]) is authentic


def test_what_was_heard_a_moment_ago_is_not_authentic_again_and_what_comes_next_is() -> None:
    sender, receiver = pair()
    first = sender.encode(STATUS)
    assert receiver.authentic(first)
    assert isinstance(receiver.decode(first), Status)
    assert not receiver.authentic(first)
    assert receiver.authentic(sender.encode(STATUS))


def test_where_nothing_is_signed_everything_is_authentic() -> None:
    assert Codec(Role.RECEIVER, None).authentic(b"")


def test_a_link_that_nobody_gave_a_number_is_number_zero() -> None:
    packet = Codec(Role.SENDER, KEY).encode(STATUS)
    assert packet[-13] == 0 and stamp_of(packet) == 0


def test_a_peers_clock_at_the_last_stamp_that_may_be_said_is_heard() -> None:
    sender, receiver = pair()
    sender.decode(receiver.encode(CANDIDATE))
    assert receiver.decode(raw(raw_target(), stamp=LAST_STAMP)) is not Drop.CLOCK_AT_END
