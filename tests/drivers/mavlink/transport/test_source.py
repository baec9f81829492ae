"""The proof of a vehicle's address, and what becomes of everybody else who has its number."""

from __future__ import annotations

import struct
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import all as mavlink

from drivers.mavlink.transport.frames import (
    HEARTBEAT,
    TIMESYNC,
    crc,
    head_of,
    make,
    take_frames,
    whole,
)
from drivers.mavlink.transport.port import extras
from drivers.mavlink.transport.signing import SignatureCheck, Signer
from drivers.mavlink.transport.source import OTHERS, QUIET_S, VehicleSource

SYSID = 3
HERE, THERE = ("127.0.0.1", 1111), ("127.0.0.1", 2222)
S = 1_000_000_000
KEY = bytes(range(32))


def packed(message: Any, component: int = 1) -> bytes:
    return bytes(message.pack(mavlink.MAVLink(None, srcSystem=SYSID, srcComponent=component)))


BEAT = packed(mavlink.MAVLink_heartbeat_message(2, 12, 1, 0, 4, 3))
ATTITUDE = packed(mavlink.MAVLink_attitude_message(0, 0, 0, 0, 0, 0, 0))


def decoded(frame: bytes) -> Any:
    return mavlink.MAVLink(None).decode(bytearray(frame))


def number_in(question: bytes) -> int:
    message = decoded(question)
    assert (message.get_type(), message.tc1) == ("TIMESYNC", 0)
    assert (message.get_srcSystem(), message.get_srcComponent()) == (246, 191)
    return message.ts1


def answer(number: int, time: int = 5) -> bytes:
    return packed(mavlink.MAVLink_timesync_message(time, number))


def proven(now_ns: int = 0) -> VehicleSource:
    source = VehicleSource(SYSID, (246, 191))
    question = source.question(BEAT, HERE, now_ns)
    assert question is not None
    assert source.believes(answer(number_in(question)), HERE, now_ns)
    return source


def test_a_heartbeat_alone_proves_nothing_and_an_answer_does() -> None:
    source, number = VehicleSource(SYSID, (246, 191)), 0
    for _ in range(3):
        assert not source.believes(BEAT, HERE, 0)
        question = source.question(BEAT, HERE, 0)
        assert question is not None
        number = number_in(question)
    assert source.pinned is None and source.unproven == HERE and source.ignored == {}
    assert not source.believes(answer(number), THERE, 0)  # from where it was not asked
    assert not source.believes(answer(number + 1), HERE, 0)
    assert not source.believes(answer(number, time=0), HERE, 0)  # our own question, thrown back
    assert not source.believes(answer(number)[:-1] + b"?", HERE, 0)
    assert source.believes(answer(number), HERE, 0)
    assert source.pinned == HERE and source.unproven is None
    assert source.believes(BEAT, HERE, 0) and source.believes(ATTITUDE, HERE, 0)


def test_each_address_is_asked_another_number() -> None:
    source = VehicleSource(SYSID, (246, 191))
    numbers = set[int]()
    for port in range(1, 30):
        question = source.question(BEAT, ("10.0.0.1", port), 0)
        assert question is not None
        numbers.add(number_in(question))
    assert len(numbers) == 29 and 0 not in numbers
    assert len(source._asked) == 8  # the oldest are forgotten
    assert ("10.0.0.1", 29) in source._asked and ("10.0.0.1", 21) not in source._asked


def test_a_second_one_is_ignored_counted_and_not_even_asked() -> None:
    source = proven()
    for k in range(5):
        assert not source.believes(BEAT, THERE, k * S // 10)
        assert not source.believes(ATTITUDE, THERE, k * S // 10)
        assert source.question(BEAT, THERE, k * S // 10) is None
    assert source.ignored == {"a second vehicle 3, at 127.0.0.1:2222": 5}
    assert source.rival_ns == 4 * S // 10
    for port in range(100):
        source.believes(BEAT, ("127.0.0.1", 3000 + port), 0)
    assert len(source.ignored) == 9 and source.ignored[OTHERS] == 93


def test_a_vehicle_that_speaks_from_elsewhere_is_found_again_once_the_first_is_silent() -> None:
    source = proven()
    assert source.believes(BEAT, HERE, S)
    assert source.question(BEAT, THERE, S + round((QUIET_S - 0.1) * S)) is None
    question = source.question(BEAT, THERE, S + round((QUIET_S + 0.1) * S))
    assert question is not None
    assert source.believes(answer(number_in(question)), THERE, 9 * S)
    assert source.pinned == THERE
    assert not source.believes(BEAT, HERE, 9 * S)


def test_other_parts_of_the_vehicle_are_heard_where_it_is_and_raise_no_alarm() -> None:
    source = proven()
    gimbal = packed(mavlink.MAVLink_heartbeat_message(2, 12, 1, 0, 4, 3), component=154)
    assert source.believes(gimbal, HERE, 0)
    assert not source.believes(gimbal, THERE, 0)
    assert source.ignored == {}


@given(st.binary(min_size=1, max_size=60), st.integers(0, 255))
def test_frames_made_here_are_mavlinks(payload: bytes, sequence: int) -> None:
    frame = make(TIMESYNC, payload[:16], (SYSID, 1), sequence)
    assert whole(frame) and head_of(frame).message == TIMESYNC
    message = decoded(frame)
    assert struct.pack("<qq", message.tc1, message.ts1) == payload[:16].ljust(16, b"\0")
    damaged = bytearray(frame)
    damaged[-3] ^= 1
    assert not whole(bytes(damaged))


def test_checksums_are_mavlinks() -> None:
    for message in (BEAT, ATTITUDE):
        extra = extras()[head_of(message).message]
        assert crc(message[1:-2], extra) == message[-2:]
    assert whole(BEAT) and head_of(BEAT).message == HEARTBEAT


# --- signatures


def signing(key: bytes, stamp: int) -> Any:
    mav: Any = mavlink.MAVLink(None, srcSystem=SYSID, srcComponent=1)
    mav.signing.secret_key, mav.signing.sign_outgoing, mav.signing.timestamp = key, True, stamp
    return mav


def test_what_is_signed_here_is_signed_as_the_standard_says() -> None:
    signer = Signer(KEY, 7, extras(), clock=lambda: 10**9)
    theirs = signing(KEY, 10**9 - 5)
    for _ in range(3):
        signed = signer.sign(ATTITUDE)
        assert signed is not None
        assert list(take_frames(bytearray(signed))) == [signed]
        message = theirs.decode(bytearray(signed))
        assert message.get_type() == "ATTITUDE" and message.get_signed()
    for what in (signer.sign(ATTITUDE) or b"", b"\xfe" + ATTITUDE[1:]):
        assert signer.sign(what) is None


def test_only_what_the_key_signed_holds_and_once() -> None:
    check, theirs = SignatureCheck(KEY), signing(KEY, 1000)
    first, second = (
        bytes(mavlink.MAVLink_attitude_message(0, 0, 0, 0, 0, 0, 0).pack(theirs)) for _ in range(2)
    )
    forged = bytes(
        mavlink.MAVLink_attitude_message(0, 0, 0, 0, 0, 0, 0).pack(signing(bytes(32), 2**48 - 9))
    )
    assert not check.holds(forged) and not check.holds(ATTITUDE)
    assert check.holds(second)
    assert not check.holds(second) and not check.holds(first)


@pytest.mark.parametrize("index", range(-19, 0))
def test_a_changed_byte_breaks_the_signature(index: int) -> None:
    frame = bytearray(
        mavlink.MAVLink_attitude_message(0, 0, 0, 0, 0, 0, 0).pack(signing(KEY, 1000))
    )
    frame[index] ^= 1
    assert not SignatureCheck(KEY).holds(bytes(frame))
