"""MAVLink frames as bytes: cut out of what came in, looked at, made and checked without a library
of messages.
"""

from __future__ import annotations

from collections.abc import Iterator

from path.values import frozen

V1 = 0xFE
V2 = 0xFD
SIGNED = 0x01  # of the incompatibility flags
SIGNATURE = 13
_V1_HEADER = 6
_V2_HEADER = 10
_CRC = 2
HEARTBEAT = 0
TIMESYNC = 111
CRC_EXTRA = {HEARTBEAT: 50, TIMESYNC: 34}  # a byte that stands for the message's layout
AUTOPILOT = 1  # MAV_COMP_ID_AUTOPILOT1


@frozen
class Head:
    """The sender and the kind of a frame. ``payload_at``: where its payload begins."""

    system: int
    component: int
    message: int
    payload_at: int


def head_of(frame: bytes) -> Head:
    """Return the head of a whole frame, as ``take_frames`` cuts it out."""
    if frame[0] == V2:
        return Head(frame[5], frame[6], int.from_bytes(frame[7:_V2_HEADER], "little"), _V2_HEADER)
    return Head(frame[3], frame[4], frame[5], _V1_HEADER)


def take_frames(waiting: bytearray) -> Iterator[bytes]:
    """Cut whole frames off the front of a stream of bytes; what is no frame is skipped.

    A damaged frame may hide the next one for once: the checksum is for whoever decodes it, and
    telemetry comes again.
    """
    while waiting:
        if waiting[0] not in (V1, V2):
            begin = min(
                (at for at in (waiting.find(V1), waiting.find(V2)) if at >= 0), default=len(waiting)
            )
            del waiting[:begin]
            continue
        if len(waiting) < 3:
            return
        length = waiting[1] + _V1_HEADER + _CRC
        if waiting[0] == V2:
            length = waiting[1] + _V2_HEADER + _CRC + (SIGNATURE if waiting[2] & SIGNED else 0)
        if len(waiting) < length:
            return
        frame = bytes(waiting[:length])
        del waiting[:length]
        yield frame


def whole(frame: bytes) -> bool:
    """Return whether the checksum of one of the two known messages holds; of others nothing is
    known here.
    """
    head = head_of(frame)
    extra = CRC_EXTRA.get(head.message)
    end = head.payload_at + frame[1]
    return extra is not None and crc(frame[1:end], extra) == frame[end : end + _CRC]


def payload_of(frame: bytes, size: int) -> bytes:
    """The payload, with the zeros that MAVLink 2 leaves away."""
    at = head_of(frame).payload_at
    return frame[at : at + frame[1]].ljust(size, b"\0")


def make(
    message: int,
    payload: bytes,
    sender: tuple[int, int],
    sequence: int,
) -> bytes:
    """An unsigned MAVLink 2 frame of one of the two known messages."""
    payload = payload.rstrip(b"\0") or b"\0"
    rest = (
        bytes((len(payload), 0, 0, sequence & 0xFF, *sender))
        + message.to_bytes(3, "little")
        + payload
    )
    return bytes((V2,)) + rest + crc(rest, CRC_EXTRA[message])


def crc(data: bytes, extra: int) -> bytes:
    """CRC-16/MCRF4XX of a frame less its marker, and of the byte that stands for the message's
    layout.
    """
    value = 0xFFFF
    for byte in (*data, extra):
        mixed = (byte ^ value) & 0xFF
        mixed = (mixed ^ (mixed << 4)) & 0xFF
        value = (value >> 8) ^ (mixed << 8) ^ (mixed << 3) ^ (mixed >> 4)
    return value.to_bytes(_CRC, "little")
