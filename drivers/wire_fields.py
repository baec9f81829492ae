"""Each message's fields as the dialect's numbers, and back (``drivers/dialect/path.xml`` has the layout).

Every number is checked both ways. On the wire a box edge is in 1/16 px, a standard deviation in 0.1 mm, a unit vector
in 1/32767; so a round trip moves an edge by at most 0.031 px, a sigma by 0.05 mm, a direction by 0.0016 degrees.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from drivers.dialect import path_dialect as dialect
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
    Vec3,
)
from path.observations import Box, MissReason

U8, U16, U32, U64 = 2**8 - 1, 2**16 - 1, 2**32 - 1, 2**64 - 1
I16, I32 = 2**15 - 1, 2**31 - 1
_UNIT = 32767.0
_PIXEL = 16.0
_SIGMA = 10000.0
_MILLI = 1000.0
_CENTI = 100.0
_YAW = 10000.0
_BATTERY = 200.0
_UNIT_TOLERANCE = 1e-2  # of a gravity vector's length
_QUATERNION_TOLERANCE = 1e-3  # of a quaternion's length
_LARGEST_FLOAT = 3.4028234e38

_MISS_CODE = {
    reason: code for reason in MissReason if (code := getattr(dialect, f"PATH_MISS_{reason.name}", None)) is not None
}
_MISS = {code: reason for reason, code in _MISS_CODE.items()}
_ABORT_CODE = {reason: getattr(dialect, f"PATH_ABORT_{reason.name}") for reason in AbortReason}
_ABORT = {code: reason for reason, code in _ABORT_CODE.items()}
_ROLE_CODE = {Role.SENDER: dialect.PATH_ROLE_SENDER, Role.RECEIVER: dialect.PATH_ROLE_RECEIVER}
_ROLE = {code: role for role, code in _ROLE_CODE.items()}


class OutOfRange(ValueError):
    """A number that the wire, or the meaning of its field, does not allow. ``finite`` is False for NaN and infinity."""

    def __init__(self, message: str, finite: bool = True) -> None:
        super().__init__(message)
        self.finite = finite


def _whole(name: str, value: int, high: int) -> int:
    if not 0 <= value <= high:
        raise OutOfRange(f"{name} = {value} is outside 0..{high}")
    return value


def _scaled(name: str, value: float, scale: float, low: int, high: int) -> int:
    """``value * scale``, rounded, when that lies in ``low..high``."""
    if not math.isfinite(value):
        raise OutOfRange(f"{name} = {value} is not finite", finite=False)
    scaled = round(value * scale)
    if not low <= scaled <= high:
        raise OutOfRange(f"{name} = {value} is outside {low / scale}..{high / scale}")
    return scaled


def _real(name: str, value: float) -> float:
    if not math.isfinite(value):
        raise OutOfRange(f"{name} = {value} is not finite", finite=False)
    if not -_LARGEST_FLOAT <= value <= _LARGEST_FLOAT:
        raise OutOfRange(f"{name} = {value} is too large")
    return value


def _length(name: str, values: tuple[float, ...], tolerance: float) -> float:
    """The length of what should be a unit vector; both zero and a wrong length are refused."""
    length = math.sqrt(sum(value * value for value in values))
    if not abs(length - 1.0) <= tolerance:
        raise OutOfRange(f"{name} = {values} has length {length}, not 1", finite=math.isfinite(length))
    return length


def _target_to(m: Target) -> Any:
    x, y, z = m.point_v_m
    _length("gravity_v", m.gravity_v, _UNIT_TOLERANCE)
    gx, gy, gz = m.gravity_v
    return dialect.MAVLink_path_target_message(
        _whole("capture_ns", m.capture_ns, U64),
        _real("point_v_m", x),
        _real("point_v_m", y),
        _real("point_v_m", z),
        _whole("handoff_id", m.handoff_id, U16),
        _whole("epoch", m.epoch, U16),
        _whole("sequence", m.sequence, U16),
        _scaled("gravity_v", max(-1.0, min(gx, 1.0)), _UNIT, -I16, I16),
        _scaled("gravity_v", max(-1.0, min(gy, 1.0)), _UNIT, -I16, I16),
        _scaled("gravity_v", max(-1.0, min(gz, 1.0)), _UNIT, -I16, I16),
        _scaled("sigma_m", m.sigma_m, _SIGMA, 0, U16),
        _whole("target_id", m.target_id, U8),
    )


def _target_from(p: Any) -> Target:
    gravity = (p.gravity_x / _UNIT, p.gravity_y / _UNIT, p.gravity_z / _UNIT)
    length = _length("gravity", gravity, _UNIT_TOLERANCE)
    return Target(
        handoff_id=p.handoff_id,
        epoch=p.epoch,
        target_id=p.target_id,
        sequence=p.sequence,
        capture_ns=p.capture_ns,
        point_v_m=(_real("point_x", p.point_x), _real("point_y", p.point_y), _real("point_z", p.point_z)),
        gravity_v=(gravity[0] / length, gravity[1] / length, gravity[2] / length),
        sigma_m=p.sigma / _SIGMA,
    )


def _box_to(box: Box | None) -> tuple[int, int, int, int]:
    if box is None:
        return 0, 0, 0, 0
    return (
        _scaled("box.x", box.x, _PIXEL, -I16, I16),
        _scaled("box.y", box.y, _PIXEL, -I16, I16),
        _scaled("box.w", box.w, _PIXEL, 1, U16),
        _scaled("box.h", box.h, _PIXEL, 1, U16),
    )


def _miss_to(m: Candidate) -> int:
    if (m.box is None) == (m.reason is None):
        raise OutOfRange("exactly one of box and reason must be given")
    if m.reason is None:
        return dialect.PATH_MISS_NONE
    if m.reason not in _MISS_CODE:
        raise OutOfRange(f"reason = {m.reason} has no code in the dialect")
    return _MISS_CODE[m.reason]


def _candidate_to(m: Candidate) -> Any:
    miss = _miss_to(m)
    x, y, z = m.position_v_m
    w, i, j, k = m.rotation_v_c2
    if m.box is not None or any(m.rotation_v_c2):  # all zero: a miss that has no pose to tell
        _length("rotation_v_c2", m.rotation_v_c2, _QUATERNION_TOLERANCE)
    return dialect.MAVLink_path_candidate_message(
        _whole("capture_ns", m.capture_ns, U64),
        _real("position_v_m", x),
        _real("position_v_m", y),
        _real("position_v_m", z),
        w,
        i,
        j,
        k,
        _whole("handoff_id", m.handoff_id, U16),
        _whole("epoch", m.epoch, U16),
        _whole("sequence", m.sequence, U16),
        _whole("target_sequence", m.target_sequence, U16),
        *_box_to(m.box),
        _scaled("sigma_m", m.sigma_m, _SIGMA, 0, U16),
        _whole("target_id", m.target_id, U8),
        miss,
    )


def _candidate_from(p: Any) -> Candidate:
    reason, box = None, None
    if p.miss == dialect.PATH_MISS_NONE:
        if not (p.box_w and p.box_h):
            raise OutOfRange("an empty box")
        box = Box(p.box_x / _PIXEL, p.box_y / _PIXEL, p.box_w / _PIXEL, p.box_h / _PIXEL)
    else:
        reason = _MISS.get(p.miss)
        if reason is None:
            raise OutOfRange(f"miss = {p.miss} is unknown")
    q = (p.q_w, p.q_x, p.q_y, p.q_z)
    if box is not None or any(q):
        length = _length("q", q, _QUATERNION_TOLERANCE)
        q = (q[0] / length, q[1] / length, q[2] / length, q[3] / length)
    return Candidate(
        handoff_id=p.handoff_id,
        epoch=p.epoch,
        target_id=p.target_id,
        sequence=p.sequence,
        target_sequence=p.target_sequence,
        capture_ns=p.capture_ns,
        box=box,
        reason=reason,
        position_v_m=(
            _real("position_x", p.position_x),
            _real("position_y", p.position_y),
            _real("position_z", p.position_z),
        ),
        rotation_v_c2=q,
        sigma_m=p.sigma / _SIGMA,
    )


def _three(name: str, values: Vec3, scale: float, limit: int) -> tuple[int, int, int]:
    x, y, z = values
    return (
        _scaled(name, x, scale, -limit, limit),
        _scaled(name, y, scale, -limit, limit),
        _scaled(name, z, scale, -limit, limit),
    )


def _status_to(m: Status) -> Any:
    if not math.isfinite(m.yaw_rad):
        raise OutOfRange(f"yaw_rad = {m.yaw_rad} is not finite", finite=False)
    flags = dialect.PATH_FLAG_RESPONSIBLE * m.responsible | dialect.PATH_FLAG_OBSERVING * m.observing
    return dialect.MAVLink_path_status_message(
        _whole("stamp_ns", m.stamp_ns, U64),
        *_three("position_n_m", m.position_n_m, _MILLI, I32),
        *_three("velocity_n_mps", m.velocity_n_mps, _CENTI, I16),
        _scaled("yaw_rad", math.remainder(m.yaw_rad, math.tau), _YAW, -I16, I16),
        _ROLE_CODE[m.role],
        _whole("phase", m.phase, U8),
        flags,
        _scaled("battery", m.battery, _BATTERY, 0, round(_BATTERY)),
    )


def _status_from(p: Any) -> Status:
    role = _ROLE.get(p.role)
    if role is None or p.battery > _BATTERY or abs(p.yaw) > math.pi * _YAW + 1.0:
        raise OutOfRange(f"role = {p.role}, battery = {p.battery}, yaw = {p.yaw}")
    return Status(
        role=role,
        stamp_ns=p.stamp_ns,
        position_n_m=(p.north / _MILLI, p.east / _MILLI, p.down / _MILLI),
        velocity_n_mps=(p.v_north / _CENTI, p.v_east / _CENTI, p.v_down / _CENTI),
        yaw_rad=p.yaw / _YAW,
        phase=p.phase,
        responsible=bool(p.flags & dialect.PATH_FLAG_RESPONSIBLE),
        observing=bool(p.flags & dialect.PATH_FLAG_OBSERVING),
        battery=p.battery / _BATTERY,
    )


def _ping_to(m: Ping) -> Any:
    return dialect.MAVLink_path_ping_message(_whole("sent_ns", m.sent_ns, U64), _whole("nonce", m.nonce, U32))


def _pong_to(m: Pong) -> Any:
    return dialect.MAVLink_path_pong_message(
        _whole("ping_sent_ns", m.ping_sent_ns, U64),
        _whole("received_ns", m.received_ns, U64),
        _whole("sent_ns", m.sent_ns, U64),
        _whole("nonce", m.nonce, U32),
    )


def _commit_to(m: Commit) -> Any:
    return dialect.MAVLink_path_commit_message(_whole("lease_end_ns", m.lease_end_ns, U64), *_answer_fields(m))


def _answer_fields(m: Commit | Accept | Confirm) -> tuple[int, int, int, int, int]:
    return (
        _whole("stamp_ns", m.stamp_ns, U64),
        _whole("nonce", m.nonce, U32),
        _whole("handoff_id", m.handoff_id, U16),
        _whole("epoch", m.epoch, U16),
        _whole("target_id", m.target_id, U8),
    )


def _abort_to(m: Abort) -> Any:
    return dialect.MAVLink_path_abort_message(
        _whole("stamp_ns", m.stamp_ns, U64),
        _whole("handoff_id", m.handoff_id, U16),
        _whole("epoch", m.epoch, U16),
        _ABORT_CODE[m.reason],
    )


def _abort_from(p: Any) -> Abort:
    reason = _ABORT.get(p.reason)
    if reason is None:
        raise OutOfRange(f"reason = {p.reason} is unknown")
    return Abort(p.handoff_id, p.epoch, reason, p.stamp_ns)


TO_WIRE: dict[type[Message], Callable[[Any], Any]] = {
    Target: _target_to,
    Candidate: _candidate_to,
    Status: _status_to,
    Ping: _ping_to,
    Pong: _pong_to,
    Commit: _commit_to,
    Accept: lambda m: dialect.MAVLink_path_accept_message(*_answer_fields(m)),
    Confirm: lambda m: dialect.MAVLink_path_confirm_message(*_answer_fields(m)),
    Abort: _abort_to,
}

FROM_WIRE: dict[type[Any], Callable[[Any], Message]] = {
    dialect.MAVLink_path_target_message: _target_from,
    dialect.MAVLink_path_candidate_message: _candidate_from,
    dialect.MAVLink_path_status_message: _status_from,
    dialect.MAVLink_path_ping_message: lambda p: Ping(p.nonce, p.sent_ns),
    dialect.MAVLink_path_pong_message: lambda p: Pong(p.nonce, p.ping_sent_ns, p.received_ns, p.sent_ns),
    dialect.MAVLink_path_commit_message: lambda p: Commit(
        p.handoff_id, p.epoch, p.target_id, p.nonce, p.lease_end_ns, p.stamp_ns
    ),
    dialect.MAVLink_path_accept_message: lambda p: Accept(p.handoff_id, p.epoch, p.target_id, p.nonce, p.stamp_ns),
    dialect.MAVLink_path_confirm_message: lambda p: Confirm(p.handoff_id, p.epoch, p.target_id, p.nonce, p.stamp_ns),
    dialect.MAVLink_path_abort_message: _abort_from,
}
