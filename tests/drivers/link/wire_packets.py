"""Messages of both drones and their packets, also ones that no drone would send."""

from __future__ import annotations

from typing import Any

from drivers.link.dialect import path_dialect as dialect
from drivers.link.wire import Codec, introduce
from path.alike import Alike
from path.messages import (
    Abort,
    AbortReason,
    Candidate,
    Commit,
    Confirm,
    KeyframePart,
    Message,
    Ping,
    Pong,
    Role,
    Status,
    Target,
)
from path.observations import Box

KEY = bytes(range(32))
STAMP = 2**63 + 12345
INSTANT = (2**47 + 12345) * 10_000  # what a 48 bit stamp in 10 us can say exactly

TARGET = Target(0xFFFF, 0xFFFE, 255, 0xFFFD, INSTANT, (1.25, -2.5, 0.125), (0.6, 0.0, 0.8), 0.0123)
BOX = Box(-100.5, 200.25, 50.25, 8191.75)
CANDIDATE = Candidate(
    0xFFFF,
    0xFFFE,
    255,
    0xFFFD,
    0xFFFC,
    INSTANT,
    BOX,
    None,
    (0.5, -0.25, 1.0),
    (0.5, 0.5, -0.5, 0.5),
    0.0042,
)

STATUS = Status(
    Role.SENDER, INSTANT, (1.234, -5.678, -1.4), (0.12, -0.34, 0.05), 3.0, 200, True, False, 0.735, 0x123456,
    alike=Alike(1, 2, 3, 0xFFFF, 5, 6, 7, 8, 400),
)  # fmt: skip

PART = KeyframePart(INSTANT, (1.0, 0.0, 0.0, 0.0), 0.3217, 200, 127, bytes(range(59)))

FROM_SENDER: tuple[Message, ...] = (
    TARGET,
    STATUS,
    Ping(2**32 - 1, STAMP),
    Pong(2**32 - 1, STAMP, STAMP + 1, STAMP + 2),
    Commit(0xFFFF, 0xFFFE, 255, 2**32 - 1, STAMP + 9, STAMP, 2**24 - 1),
    Confirm(0xFFFF, 0xFFFE, 255, 2**32 - 1, STAMP, 2**24 - 1),
    Abort(0xFFFF, 0xFFFE, AbortReason.SHUTDOWN, STAMP, 2**24 - 1),
    PART,
)


def pair(key: bytes | None = KEY) -> tuple[Codec, Codec]:
    sender, receiver = Codec(Role.SENDER, key), Codec(Role.RECEIVER, key)
    introduce(sender, receiver)
    return sender, receiver


def raw(
    packet: Any, key: bytes | None = KEY, stamp: int = 1, system: int = 1, component: int = 191
) -> bytes:
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
