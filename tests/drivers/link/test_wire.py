from __future__ import annotations

import hashlib
import math
import random
import struct
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.link.dialect import path_dialect as dialect
from drivers.link.wire import LAST_STAMP, UDP_IP_OVERHEAD, Codec, Drop, EncodeError, expected_length, introduce
from flight.config import MissionConfig
from path.messages import (
    Abort,
    AbortReason,
    Accept,
    Candidate,
    Commit,
    Confirm,
    Message,
    Ping,
    Pong,
    Role,
    Status,
    Target,
)
from path.observations import Box, MissReason

KEY = bytes(range(32))
STAMP = 2**63 + 12345
INSTANT = (2**47 + 12345) * 10_000  # what a 48 bit stamp in 10 us can say exactly
TARGET = Target(0xFFFF, 0xFFFE, 255, 0xFFFD, INSTANT, (1.25, -2.5, 0.125), (0.6, 0.0, 0.8), 0.0123)
BOX = Box(-100.5, 200.0625, 50.25, 4095.9375)
CANDIDATE = Candidate(
    0xFFFF, 0xFFFE, 255, 0xFFFD, 0xFFFC, INSTANT, BOX, None, (0.5, -0.25, 1.0), (0.5, 0.5, -0.5, 0.5), 0.0042
)
STATUS = Status(
    Role.SENDER, INSTANT, (1.234, -5.678, -1.4), (0.12, -0.34, 0.05), 3.0, 200, True, False, 0.735, 0x123456
)
FROM_SENDER: tuple[Message, ...] = (
    TARGET,
    STATUS,
    Ping(2**32 - 1, STAMP),
    Pong(2**32 - 1, STAMP, STAMP + 1, STAMP + 2),
    Commit(0xFFFF, 0xFFFE, 255, 2**32 - 1, STAMP + 9, STAMP, 2**24 - 1),
    Confirm(0xFFFF, 0xFFFE, 255, 2**32 - 1, STAMP, 2**24 - 1),
    Abort(0xFFFF, 0xFFFE, AbortReason.SHUTDOWN, STAMP, 2**24 - 1),
)
FROM_RECEIVER: tuple[Message, ...] = (
    CANDIDATE,
    replace(CANDIDATE, box=None, reason=MissReason.NO_MARKER, rotation_v_c2=(1.0, 0.0, 0.0, 0.0)),
    Accept(0xFFFF, 0xFFFE, 255, 2**32 - 1, STAMP, 2**24 - 1),
)


def pair(key: bytes | None = KEY) -> tuple[Codec, Codec]:
    sender, receiver = Codec(Role.SENDER, key), Codec(Role.RECEIVER, key)
    introduce(sender, receiver)
    return sender, receiver


def raw(packet: Any, key: bytes | None = KEY, stamp: int = 1, system: int = 1, component: int = 191) -> bytes:
    """A packet as another program would make it, with pymavlink alone."""
    mav = dialect.MAVLink(None, system, component)
    mav.signing.secret_key = key
    mav.signing.sign_outgoing = key is not None
    mav.signing.timestamp = stamp
    return packet.pack(mav)


def raw_target(**changes: Any) -> Any:
    fields: dict[str, Any] = {
        "capture_low": 1,
        "point_x": 1000,
        "point_y": 1000,
        "point_z": 1000,
        "handoff_id": 1,
        "epoch": 1,
        "sequence": 1,
    }
    fields |= {"gravity_a": 0, "gravity_b": 0, "sigma": 10, "capture_high": 0}
    fields |= {"point_x_part": 0, "point_y_part": 0, "point_z_part": 0, "target_id": 1}
    return dialect.MAVLink_path_target_message(**(fields | changes))


def raw_candidate(**changes: Any) -> Any:
    fields: dict[str, Any] = {"capture_low": 1, "position_x": 1000, "position_y": 1000, "position_z": 1000}
    fields |= {"rotation_x": 0, "rotation_y": 0, "rotation_z": 0}
    fields |= {"handoff_id": 1, "epoch": 1, "sequence": 1, "target_sequence": 1}
    fields |= {"box_x": 1, "box_y": 1, "box_w": 16, "box_h": 16, "sigma": 10, "capture_high": 0}
    fields |= {"position_x_part": 0, "position_y_part": 0, "position_z_part": 0, "target_id": 1, "miss": 0}
    return dialect.MAVLink_path_candidate_message(**(fields | changes))


@pytest.mark.parametrize("key", [None, KEY], ids=["unsigned", "signed"])
@pytest.mark.parametrize("message", FROM_SENDER[2:], ids=lambda m: type(m).__name__)
def test_whole_numbers_come_back_as_they_were(message: Message, key: bytes | None) -> None:
    sender, receiver = pair(key)
    assert receiver.decode(sender.encode(message)) == message


def test_a_target_comes_back_within_the_resolution() -> None:
    sender, receiver = pair()
    back = receiver.decode(sender.encode(TARGET))
    assert isinstance(back, Target)
    assert back.gravity_v == pytest.approx(TARGET.gravity_v, abs=5e-5)
    assert math.hypot(*back.gravity_v) == pytest.approx(1.0, abs=1e-12)
    assert back.sigma_m == pytest.approx(TARGET.sigma_m, abs=5.1e-5)
    assert replace(back, gravity_v=TARGET.gravity_v, sigma_m=TARGET.sigma_m) == TARGET


@pytest.mark.parametrize("message", FROM_RECEIVER, ids=["box", "miss", "accept"])
def test_the_receivers_messages_come_back(message: Message) -> None:
    sender, receiver = pair()
    back = sender.decode(receiver.encode(message))
    if isinstance(message, Candidate):
        assert isinstance(back, Candidate)
        assert back.rotation_v_c2 == pytest.approx(message.rotation_v_c2, abs=5e-5)
        back = replace(back, rotation_v_c2=message.rotation_v_c2)
    assert back == message


def test_a_status_comes_back_within_the_resolution() -> None:
    sender, receiver = pair()
    back = receiver.decode(sender.encode(replace(STATUS, yaw_rad=STATUS.yaw_rad - 2 * math.tau)))
    assert isinstance(back, Status)
    assert back.yaw_rad == pytest.approx(STATUS.yaw_rad, abs=5.1e-5)
    assert replace(back, yaw_rad=STATUS.yaw_rad) == STATUS


@given(reason=st.sampled_from(MissReason))
def test_every_miss_reason_has_a_code(reason: MissReason) -> None:
    sender, receiver = pair(None)
    back = sender.decode(receiver.encode(replace(CANDIDATE, box=None, reason=reason)))
    assert isinstance(back, Candidate) and back.reason is reason and back.box is None


@pytest.mark.parametrize("reason", AbortReason)
def test_every_abort_reason_has_a_code(reason: AbortReason) -> None:
    sender, receiver = pair(None)
    assert sender.decode(receiver.encode(Abort(1, 2, reason, 3))) == Abort(1, 2, reason, 3)


def test_packets_stay_within_the_budget() -> None:
    """Every packet <= 128 B on the wire; all of a link at 60 Hz, signed, <= 12 kB/s even when no byte is cut off."""
    sender, receiver = pair()
    longest = replace(CANDIDATE, box=None, reason=MissReason.NON_FINITE)  # its last byte is not cut off
    sizes = {type(m): len(sender.encode(m)) + UDP_IP_OVERHEAD for m in FROM_SENDER}
    sizes |= {type(m): len(receiver.encode(m)) + UDP_IP_OVERHEAD for m in (*FROM_RECEIVER, longest)}
    assert max(sizes.values()) <= 128
    assert sizes[Target] == 12 + 28 + 13 + 28
    assert sizes[Candidate] == 12 + 41 + 13 + 28
    rates = MissionConfig()
    second = 60 * (sizes[Target] + sizes[Candidate]) + (rates.status_hz + rates.receiver_status_hz) * sizes[Status]
    assert second + 2 * rates.ping_hz * (sizes[Ping] + sizes[Pong]) <= 12_000


NAN, INF = float("nan"), float("inf")


@pytest.mark.parametrize(
    "message",
    [
        replace(TARGET, point_v_m=(NAN, 0.0, 0.0)),
        replace(TARGET, point_v_m=(0.0, INF, 0.0)),
        replace(TARGET, point_v_m=(0.0, 32.8, 0.0)),
        replace(TARGET, point_v_m=(0.0, 0.0, -32.8)),
        replace(TARGET, gravity_v=(NAN, 0.0, 1.0)),
        replace(TARGET, gravity_v=(0.0, 0.0, 9.81)),
        replace(TARGET, gravity_v=(0.0, 0.0, 0.0)),
        replace(TARGET, sigma_m=6.6),
        replace(TARGET, sigma_m=-0.1),
        replace(TARGET, handoff_id=65536),
        replace(TARGET, epoch=-1),
        replace(TARGET, target_id=256),
        replace(TARGET, capture_ns=-1),
        replace(TARGET, capture_ns=2**48 * 10_000),
        replace(STATUS, stamp_ns=2**48 * 10_000),
        replace(CANDIDATE, box=replace(BOX, x=2048.0)),
        replace(CANDIDATE, box=replace(BOX, y=-2048.0)),
        replace(CANDIDATE, box=replace(BOX, w=4096.0)),
        replace(CANDIDATE, box=replace(BOX, h=0.0)),
        replace(CANDIDATE, box=replace(BOX, h=NAN)),
        replace(CANDIDATE, box=None),
        replace(CANDIDATE, reason=MissReason.CLOCK),
        replace(CANDIDATE, rotation_v_c2=(1.0, 0.1, 0.0, 0.0)),
        replace(CANDIDATE, rotation_v_c2=(0.0, 0.0, 0.0, 0.0)),
        replace(CANDIDATE, rotation_v_c2=(NAN, 0.0, 0.0, 0.0)),
        replace(CANDIDATE, position_v_m=(0.0, 0.0, -INF)),
        replace(STATUS, yaw_rad=NAN),
        replace(STATUS, battery=1.1),
        replace(STATUS, phase=256),
        replace(STATUS, velocity_n_mps=(400.0, 0.0, 0.0)),
        Ping(2**32, 0),
        Commit(1, 1, 1, 1, 2**64, 0, 1),
        Commit(1, 1, 1, 1, 0, 0, 2**24),
    ],
)
def test_what_does_not_fit_is_refused_before_it_is_sent(message: Message) -> None:
    with pytest.raises(EncodeError, match=type(message).__name__):
        Codec(Role.SENDER, KEY).encode(message)


@pytest.mark.parametrize(
    ("packet", "drop"),
    [
        (raw_candidate(rotation_x=32767, rotation_y=300), Drop.OUT_OF_RANGE),
        (raw_candidate(rotation_z=-32768, rotation_y=300), Drop.OUT_OF_RANGE),
        (raw_candidate(box_w=0), Drop.OUT_OF_RANGE),
        (raw_candidate(miss=99), Drop.OUT_OF_RANGE),
        (dialect.MAVLink_path_abort_message(1, 1, 1, 1, 0), Drop.OUT_OF_RANGE),
        (dialect.MAVLink_path_status_message(1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 3, 0, 0, 0, 0), Drop.OUT_OF_RANGE),
        (dialect.MAVLink_path_status_message(1, 0, 0, 0, 0, 0, 0, 32000, 0, 0, 1, 0, 0, 0, 0), Drop.OUT_OF_RANGE),
        (dialect.MAVLink_path_status_message(1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 201, 0), Drop.OUT_OF_RANGE),
        (dialect.MAVLink_path_abort_message(1, 2**24, 1, 1, 1), Drop.OUT_OF_RANGE),
        (dialect.MAVLink_path_confirm_message(1, 1, 2**24, 1, 1, 1), Drop.OUT_OF_RANGE),
        (dialect.MAVLink_heartbeat_message(0, 0, 0, 0, 0, 3), Drop.UNKNOWN_ID),
        (dialect.MAVLink_unknown(70000, b""), None),
    ],
)
def test_signed_nonsense_is_dropped_by_reason(packet: Any, drop: Drop | None) -> None:
    receiver = Codec(Role.RECEIVER, KEY)
    if drop is None:  # an id that no dialect knows
        data = bytearray(raw(raw_target()))
        data[7:10] = (70000).to_bytes(3, "little")
        assert receiver.decode(bytes(data)) is Drop.UNKNOWN_ID
    else:
        assert receiver.decode(raw(packet)) is drop


def test_lengths() -> None:
    _, receiver = pair()
    good = raw(raw_target(), stamp=100)
    for size in range(1, len(good)):
        assert receiver.decode(good[:size]) is Drop.TRUNCATED
    assert receiver.decode(b"") is Drop.NOT_MAVLINK
    assert receiver.decode(good + b"\0") is Drop.WRONG_LENGTH
    assert receiver.decode(good + good) is Drop.WRONG_LENGTH
    unsigned = bytearray(raw(raw_target(), key=None))
    unsigned[1] += 5  # a payload longer than the message can be
    assert Codec(Role.RECEIVER, None).decode(bytes(unsigned) + b"12345") is Drop.WRONG_LENGTH
    assert receiver.decode(b"\xfe" + good[1:]) is Drop.NOT_MAVLINK  # MAVLink 1
    assert receiver.decode(good[:2] + b"\x03" + good[3:]) is Drop.NOT_MAVLINK  # a flag nobody defined
    assert isinstance(receiver.decode(good), Target)


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
    assert Codec(Role.RECEIVER, KEY).decode(Codec(Role.SENDER, None).encode(TARGET)) is Drop.UNSIGNED
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
    recorded = [sender.encode(message) for message in (TARGET, Ping(7, 70), Pong(0, 0, 1, 2), *FROM_SENDER[4:])]
    assert isinstance(receiver.decode(recorded[0]), Target)
    again = Codec(Role.RECEIVER, KEY)
    again.encode(Ping(0, 1))  # other pings than those that were answered before
    told = [again.decode(data) for data in recorded]
    assert told == [Drop.UNPROVEN, Ping(7, 70), Drop.UNPROVEN, Drop.UNPROVEN, Drop.UNPROVEN, Drop.UNPROVEN]
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
        assert first.decode(second.encode(TARGET if second is sender else CANDIDATE)) is Drop.UNPROVEN
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
    assert isinstance(Codec(Role.RECEIVER, None).decode(Codec(Role.SENDER, None).encode(TARGET)), Target)


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


@given(data=st.binary(max_size=300))
def test_any_bytes_are_dropped(data: bytes) -> None:
    assert isinstance(Codec(Role.RECEIVER, KEY).decode(data), Drop)
    assert isinstance(Codec(Role.RECEIVER, None).decode(b"\xfd" + data), Drop)


@given(seed=st.integers(0, 2**32), message=st.sampled_from(FROM_SENDER), signed=st.booleans())
def test_any_damage_is_dropped_or_harmless(seed: int, message: Message, signed: bool) -> None:
    """Damage gives a Drop; a damaged packet never passes for a message with a key."""
    rng = random.Random(seed)
    sender, receiver = pair(KEY if signed else None)
    packet = sender.encode(message)
    data = bytearray(packet)
    for _ in range(rng.randint(1, 4)):
        match rng.randrange(4):
            case 0:
                data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
            case 1:
                data = data[: rng.randrange(len(data)) + 1]
            case 2:
                data.insert(rng.randrange(len(data) + 1), rng.randrange(256))
            case _:
                start = rng.randrange(len(data))
                data[start : start + 4] = rng.randbytes(4)
    result = receiver.decode(bytes(data))
    if signed and bytes(data) != packet:
        assert isinstance(result, Drop)


finite = st.floats(-32.0, 32.0)


@given(x=finite, y=finite, w=st.floats(1.0, 2000.0), sigma=st.floats(0.0, 6.5), p=st.tuples(finite, finite, finite))
def test_a_box_comes_back_within_half_a_step(
    x: float, y: float, w: float, sigma: float, p: tuple[float, float, float]
) -> None:
    sender, receiver = pair(None)
    back = sender.decode(receiver.encode(replace(CANDIDATE, box=Box(x, y, w, w), sigma_m=sigma, position_v_m=p)))
    assert isinstance(back, Candidate) and back.box is not None
    half = 1 / 32 + 1e-9
    assert abs(back.box.x - x) <= half and abs(back.box.y - y) <= half and abs(back.box.w - w) <= half
    assert abs(back.sigma_m - sigma) <= 5.1e-5
    assert back.position_v_m == pytest.approx(p, abs=2e-6)


@given(stamp_ns=st.integers(0, 2**48 * 10_000 - 1))
def test_a_stamp_is_never_later_than_it_was(stamp_ns: int) -> None:
    sender, receiver = pair(None)
    for message in (replace(TARGET, capture_ns=stamp_ns), replace(STATUS, stamp_ns=stamp_ns)):
        back = receiver.decode(sender.encode(message))
        assert isinstance(back, Target | Status)
        assert 0 <= stamp_ns - (back.capture_ns if isinstance(back, Target) else back.stamp_ns) < 10_000


def test_no_field_can_be_a_number_that_is_none() -> None:
    ours = [kind for kind in dialect.mavlink_map.values() if kind.msgname.startswith("PATH_")]
    assert len(ours) == 9
    assert not [name for kind in ours for name in kind.fieldtypes if name in ("float", "double")]


def test_signing_begins_with_the_clock() -> None:
    """Also with one that stands at nought: no packet carries a stamp that its clock has not reached."""
    codec = Codec(Role.SENDER, KEY)
    stamps = [int.from_bytes(codec.encode(Ping(1, 1))[-12:-6], "little") for _ in range(3)]
    assert stamps == [0, 1, 2]


@pytest.mark.parametrize("message", [STATUS, *FROM_SENDER[3:]], ids=lambda m: type(m).__name__)
def test_before_its_stream_has_proven_itself_nothing_but_a_ping_of_the_peer_is_taken(message: Message) -> None:
    sender, receiver = Codec(Role.SENDER, KEY), Codec(Role.RECEIVER, KEY)
    assert receiver.decode(sender.encode(message)) is Drop.UNPROVEN
    assert receiver.decode(sender.encode(Ping(7, 8))) == Ping(7, 8)
    assert receiver.decode(sender.encode(message)) is Drop.UNPROVEN
    introduce(sender, receiver)
    back = receiver.decode(sender.encode(message))
    assert type(back) is type(message)


def test_packets_are_numbered_as_they_go() -> None:
    codec = Codec(Role.SENDER, None)
    assert [codec.encode(Ping(1, 1))[4] for _ in range(258)] == [*range(256), 0, 1]


# --- bounds to the last one ------------------------------------------------------------------------------------------


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
    last, beyond = (Codec(Role.SENDER, KEY, stamp=lambda to=to: to) for to in (LAST_STAMP, LAST_STAMP + 1))
    assert stamp_of(last.encode(Ping(1, 1))) == LAST_STAMP
    assert stamp_of(beyond.encode(Ping(1, 1))) < 10
    assert last.encode(Ping(1, 2)) and Codec(Role.RECEIVER, KEY).decode(last.encode(Ping(1, 3))) is Drop.CLOCK_AT_END


def test_a_datagram_is_authentic_from_the_shortest_there_is() -> None:
    """Ten bytes of header, two of checksum, thirteen of signature; of a whole stranger one less is none."""
    codec = Codec(Role.SENDER, KEY)
    for length, authentic in ((25, True), (24, False)):
        body = bytes(length - 12) + (5).to_bytes(6, "little")
        assert codec.authentic(body + hashlib.sha256(KEY + body).digest()[:6]) is authentic


def test_a_header_that_says_more_than_its_message_holds_is_none_of_ours() -> None:
    packet = Codec(Role.SENDER, None).encode(STATUS)
    whole = packet[:10]
    assert expected_length(whole) == len(packet)
    size = dialect.mavlink_map[int.from_bytes(whole[7:10], "little")].unpacker.size
    assert expected_length(whole[:1] + bytes((size,)) + whole[2:]) == size + 12
    assert expected_length(whole[:1] + bytes((size + 1,)) + whole[2:]) is None


@pytest.mark.parametrize("battery", [0.0, 1.0])
def test_a_battery_may_be_empty_or_full_and_nothing_beyond(battery: float) -> None:
    sender, receiver = pair()
    heard = receiver.decode(sender.encode(replace(STATUS, battery=battery)))
    assert isinstance(heard, Status) and heard.battery == battery
    with pytest.raises(EncodeError, match="battery"):
        sender.encode(replace(STATUS, battery=battery + (0.01 if battery else -0.01)))


@pytest.mark.parametrize("yaw", [math.pi, -math.pi])
def test_a_half_turn_of_yaw_arrives(yaw: float) -> None:
    sender, receiver = pair()
    heard = receiver.decode(sender.encode(replace(STATUS, yaw_rad=yaw)))
    assert isinstance(heard, Status) and abs(heard.yaw_rad) == pytest.approx(math.pi, abs=1e-4)


def test_a_packet_of_nothing_but_zeros_may_be_sent_without_a_payload() -> None:
    """Twelve bytes: other programs than ours may leave even the last zero out."""
    header = Codec(Role.SENDER, None).encode(Ping(0, 0))[:10]
    bare = header[:1] + b"\0" + header[2:]
    checksum = dialect.x25crc(bare[1:])
    checksum.accumulate(bytes((dialect.MAVLink_path_ping_message.crc_extra,)))
    packet = bare + checksum.crc.to_bytes(2, "little")
    assert len(packet) == 12
    assert Codec(Role.RECEIVER, None).decode(packet) == Ping(0, 0)
    assert Codec(Role.RECEIVER, None).decode(packet[:11]) is Drop.TRUNCATED
    assert Codec(Role.RECEIVER, None).decode(packet[:3]) is Drop.TRUNCATED
    assert Codec(Role.RECEIVER, None).decode(packet[:2]) is Drop.TRUNCATED


def test_what_was_heard_a_moment_ago_is_not_authentic_again_and_what_comes_next_is() -> None:
    sender, receiver = pair()
    first = sender.encode(STATUS)
    assert receiver.authentic(first)
    assert isinstance(receiver.decode(first), Status)
    assert not receiver.authentic(first)
    assert receiver.authentic(sender.encode(STATUS))


def test_where_nothing_is_signed_everything_is_authentic() -> None:
    assert Codec(Role.RECEIVER, None).authentic(b"")


def test_a_flag_nobody_defined_is_seen_as_soon_as_it_is_there() -> None:
    receiver = Codec(Role.RECEIVER, KEY)
    assert receiver.decode(b"\xfd\x00\x03") is Drop.NOT_MAVLINK
    assert receiver.decode(b"\xfd\x00\x01") is Drop.TRUNCATED


def test_a_link_that_nobody_gave_a_number_is_number_zero() -> None:
    packet = Codec(Role.SENDER, KEY).encode(STATUS)
    assert packet[-13] == 0 and stamp_of(packet) == 0


def test_a_peers_clock_at_the_last_stamp_that_may_be_said_is_heard() -> None:
    sender, receiver = pair()
    sender.decode(receiver.encode(CANDIDATE))
    assert receiver.decode(raw(raw_target(), stamp=LAST_STAMP)) is not Drop.CLOCK_AT_END
