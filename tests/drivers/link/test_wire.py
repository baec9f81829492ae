"""Messages as packets and back: within the resolution and the budget, and nonsense dropped by its
reason.
"""

from __future__ import annotations

import math
import random
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.link.dialect import path_dialect as dialect
from drivers.link.wire import UDP_IP_OVERHEAD, Codec, Drop, EncodeError, expected_length
from flight.config import MissionConfig
from flight.outcome import Outcome, name_of
from path.messages import (
    Abort,
    AbortReason,
    Accept,
    Candidate,
    Commit,
    Message,
    Ping,
    Pong,
    Role,
    Status,
    Target,
)
from path.observations import Box, MissReason
from tests.drivers.link.wire_packets import (
    BOX,
    CANDIDATE,
    FROM_SENDER,
    KEY,
    STAMP,
    STATUS,
    TARGET,
    pair,
    raw,
    raw_target,
)

FROM_RECEIVER: tuple[Message, ...] = (
    CANDIDATE,
    replace(CANDIDATE, box=None, reason=MissReason.NO_MARKER, rotation_v_c2=(1.0, 0.0, 0.0, 0.0)),
    Accept(0xFFFF, 0xFFFE, 255, 2**32 - 1, STAMP, 2**24 - 1),
)


def raw_candidate(**changes: Any) -> Any:
    fields: dict[str, Any] = {
        "capture_low": 1,
        "position_x": 1000,
        "position_y": 1000,
        "position_z": 1000,
    }
    fields |= {"rotation_x": 0, "rotation_y": 0, "rotation_z": 0}
    fields |= {"handoff_id": 1, "epoch": 1, "sequence": 1, "target_sequence": 1}
    fields |= {"box_x": 1, "box_y": 1, "box_w": 16, "box_h": 16, "sigma": 10, "capture_high": 0}
    fields |= {
        "position_x_part": 0,
        "position_y_part": 0,
        "position_z_part": 0,
        "target_id": 1,
        "miss": 0,
    }
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
    """Every packet <= 128 B on the wire; all of a link at 60 Hz, signed, <= 12 kB/s even when no
    byte is cut off.
    """
    sender, receiver = pair()
    # its last byte is not cut off
    longest = replace(CANDIDATE, box=None, reason=MissReason.NON_FINITE)
    sizes = {type(m): len(sender.encode(m)) + UDP_IP_OVERHEAD for m in FROM_SENDER}
    sizes |= {type(m): len(receiver.encode(m)) + UDP_IP_OVERHEAD for m in (*FROM_RECEIVER, longest)}
    assert max(sizes.values()) <= 128
    assert sizes[Target] == 12 + 28 + 13 + 28
    assert sizes[Candidate] == 12 + 41 + 13 + 28
    rates = MissionConfig()
    # as it is while both verify
    sizes[Status] = len(sender.encode(replace(STATUS, alike=None))) + UDP_IP_OVERHEAD
    second = (
        60 * (sizes[Target] + sizes[Candidate])
        + (rates.status_hz + rates.receiver_status_hz) * sizes[Status]
    )
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
        replace(CANDIDATE, box=replace(BOX, x=8192.0)),
        replace(CANDIDATE, box=replace(BOX, y=-8192.0)),
        replace(CANDIDATE, box=replace(BOX, w=16384.0)),
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
        (
            dialect.MAVLink_path_status_message(1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 3, 0, 0, 0, 0, 0),
            Drop.OUT_OF_RANGE,
        ),
        (
            dialect.MAVLink_path_status_message(1, 0, 0, 0, 0, 0, 0, 32000, 0, 0, 1, 0, 0, 0, 0, 0),
            Drop.OUT_OF_RANGE,
        ),
        (
            dialect.MAVLink_path_status_message(1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 201, 0, 0),
            Drop.OUT_OF_RANGE,
        ),
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
    # a flag nobody defined
    assert receiver.decode(good[:2] + b"\x03" + good[3:]) is Drop.NOT_MAVLINK
    assert isinstance(receiver.decode(good), Target)


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


@given(
    x=finite,
    y=finite,
    w=st.floats(1.0, 2000.0),
    sigma=st.floats(0.0, 6.5),
    p=st.tuples(finite, finite, finite),
)
def test_a_box_comes_back_within_half_a_step(
    x: float, y: float, w: float, sigma: float, p: tuple[float, float, float]
) -> None:
    sender, receiver = pair(None)
    back = sender.decode(
        receiver.encode(replace(CANDIDATE, box=Box(x, y, w, w), sigma_m=sigma, position_v_m=p))
    )
    assert isinstance(back, Candidate) and back.box is not None
    half = 1 / 8 + 1e-9
    assert (
        abs(back.box.x - x) <= half and abs(back.box.y - y) <= half and abs(back.box.w - w) <= half
    )
    assert abs(back.sigma_m - sigma) <= 5.1e-5
    assert back.position_v_m == pytest.approx(p, abs=2e-6)


@given(stamp_ns=st.integers(0, 2**48 * 10_000 - 1))
def test_a_stamp_is_never_later_than_it_was(stamp_ns: int) -> None:
    sender, receiver = pair(None)
    for message in (replace(TARGET, capture_ns=stamp_ns), replace(STATUS, stamp_ns=stamp_ns)):
        back = receiver.decode(sender.encode(message))
        assert isinstance(back, Target | Status)
        assert (
            0
            <= stamp_ns - (back.capture_ns if isinstance(back, Target) else back.stamp_ns)
            < 10_000
        )


def test_no_field_can_be_a_number_that_is_none() -> None:
    ours = [kind for kind in dialect.mavlink_map.values() if kind.msgname.startswith("PATH_")]
    assert len(ours) == 10
    assert not [name for kind in ours for name in kind.fieldtypes if name in ("float", "double")]


def test_packets_are_numbered_as_they_go() -> None:
    codec = Codec(Role.SENDER, None)
    assert [codec.encode(Ping(1, 1))[4] for _ in range(258)] == [*range(256), 0, 1]


def test_a_header_that_says_more_than_its_message_holds_is_none_of_ours() -> None:
    packet = Codec(Role.SENDER, None).encode(STATUS)
    whole = packet[:10]
    assert expected_length(whole) == len(packet)
    size = dialect.mavlink_map[int.from_bytes(whole[7:10], "little")].unpacker.size
    assert expected_length(whole[:1] + bytes((size,)) + whole[2:]) == size + 12
    assert expected_length(whole[:1] + bytes((size + 1,)) + whole[2:]) is None


@pytest.mark.parametrize("outcome", Outcome)
def test_a_status_tells_how_a_flight_has_ended(outcome: Outcome) -> None:
    sender, receiver = pair()
    packet = sender.encode(replace(STATUS, ended=outcome.exit_code))
    assert len(packet) + UDP_IP_OVERHEAD <= 128
    heard = receiver.decode(packet)
    assert isinstance(heard, Status) and heard.ended == outcome.exit_code
    assert name_of(heard.ended) == outcome.label or outcome.exit_code == 0


def test_a_battery_of_an_unknown_level_is_told_as_that() -> None:
    sender, receiver = pair()
    heard = receiver.decode(sender.encode(replace(STATUS, battery=math.nan)))
    assert isinstance(heard, Status) and math.isnan(heard.battery)


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


def test_a_flag_nobody_defined_is_seen_as_soon_as_it_is_there() -> None:
    receiver = Codec(Role.RECEIVER, KEY)
    assert receiver.decode(b"\xfd\x00\x03") is Drop.NOT_MAVLINK
    assert receiver.decode(b"\xfd\x00\x01") is Drop.TRUNCATED


def test_a_status_of_an_older_version_says_nothing_of_its_rig() -> None:
    """It ends before these fields, which are an extension: its checksum is the same."""
    sender, receiver = pair()
    ended = replace(STATUS, ended=5)  # the last byte before them, which is cut off when it is 0
    packet = sender.encode(replace(ended, alike=None))
    back = receiver.decode(packet)
    assert isinstance(back, Status)
    assert back == replace(ended, alike=None, yaw_rad=back.yaw_rad)
    assert len(sender.encode(ended)) - len(packet) == 2 * 9


def test_a_digest_that_does_not_fit_is_not_sent() -> None:
    sender, _ = pair()
    assert STATUS.alike is not None
    with pytest.raises(EncodeError, match="sides"):
        sender.encode(replace(STATUS, alike=replace(STATUS.alike, sides=2**16)))
