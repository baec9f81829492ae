"""Each message's fields as the dialect's numbers, and back (``drivers/dialect/path.xml`` has the
layout).

Every number is checked both ways; ``drivers.link.units`` has the units and what a round trip costs.
"""

from __future__ import annotations

import dataclasses
import math
from collections import namedtuple
from collections.abc import Callable, Sequence
from typing import Any

from drivers.link.dialect import path_dialect as dialect
from drivers.link.units import (
    I16,
    I32,
    U8,
    U16,
    U24,
    U32,
    U64,
    OutOfRange,
    box_from,
    box_to,
    direction_from,
    direction_to,
    instant_from,
    instant_to,
    point_from,
    point_to,
    rotation_from,
    rotation_to,
    scaled,
    sigma_from,
    sigma_to,
    whole,
)
from path.alike import Alike
from path.messages import (
    PART_BYTES,
    STEPS,
    Abort,
    AbortReason,
    Accept,
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
    Vec3,
)
from path.observations import MissReason

Numbers = tuple[int, ...]

_MILLI = 1000.0
_CENTI = 100.0
_YAW = 10000.0
_STEPS_BIT = 2  # of the flags: what is above the two counts the steps of an estimator
_BATTERY = 200.0
_UNKNOWN_BATTERY = 255

_MISS_CODE = {
    reason: code
    for reason in MissReason
    if (code := getattr(dialect, f"PATH_MISS_{reason.name}", None)) is not None
}
_MISS = {code: reason for reason, code in _MISS_CODE.items()}
_ABORT_CODE = {reason: getattr(dialect, f"PATH_ABORT_{reason.name}") for reason in AbortReason}
_ABORT = {code: reason for reason, code in _ABORT_CODE.items()}
_ROLE_CODE = {Role.SENDER: dialect.PATH_ROLE_SENDER, Role.RECEIVER: dialect.PATH_ROLE_RECEIVER}
_ROLE = {code: role for role, code in _ROLE_CODE.items()}


_ALIKE = tuple(field.name for field in dataclasses.fields(Alike))


def _target_to(m: Target) -> Numbers:
    mm, parts = point_to("point_v_m", m.point_v_m)
    low, high = instant_to("capture_ns", m.capture_ns)
    return (
        low,
        *mm,
        whole("handoff_id", m.handoff_id, U16),
        whole("epoch", m.epoch, U16),
        whole("sequence", m.sequence, U16),
        *direction_to("gravity_v", m.gravity_v),
        sigma_to(m.sigma_m),
        high,
        *parts,
        whole("target_id", m.target_id, U8),
    )


def _target_from(p: Any) -> Target:
    return Target(
        handoff_id=p.handoff_id,
        epoch=p.epoch,
        target_id=p.target_id,
        sequence=p.sequence,
        capture_ns=instant_from(p.capture_low, p.capture_high),
        point_v_m=point_from(
            (p.point_x, p.point_y, p.point_z), (p.point_x_part, p.point_y_part, p.point_z_part)
        ),
        gravity_v=direction_from(p.gravity_a, p.gravity_b),
        sigma_m=sigma_from(p.sigma),
    )


def _miss_to(m: Candidate) -> int:
    if (m.box is None) == (m.reason is None):
        raise OutOfRange("exactly one of box and reason must be given")
    if m.reason is None:
        return dialect.PATH_MISS_NONE
    if m.reason not in _MISS_CODE:
        raise OutOfRange(f"reason = {m.reason} has no code in the dialect")
    return _MISS_CODE[m.reason]


def _candidate_to(m: Candidate) -> Numbers:
    miss = _miss_to(m)
    mm, parts = point_to("position_v_m", m.position_v_m)
    low, high = instant_to("capture_ns", m.capture_ns)
    return (
        low,
        *mm,
        *rotation_to("rotation_v_c2", m.rotation_v_c2),
        whole("handoff_id", m.handoff_id, U16),
        whole("epoch", m.epoch, U16),
        whole("sequence", m.sequence, U16),
        whole("target_sequence", m.target_sequence, U16),
        *box_to(m.box),
        sigma_to(m.sigma_m),
        high,
        *parts,
        whole("target_id", m.target_id, U8),
        miss,
    )


def _candidate_from(p: Any) -> Candidate:
    reason = None
    box = None
    if p.miss == dialect.PATH_MISS_NONE:
        box = box_from(p.box_x, p.box_y, p.box_w, p.box_h)
    else:
        reason = _MISS.get(p.miss)
        if reason is None:
            raise OutOfRange(f"miss = {p.miss} is unknown")
    return Candidate(
        handoff_id=p.handoff_id,
        epoch=p.epoch,
        target_id=p.target_id,
        sequence=p.sequence,
        target_sequence=p.target_sequence,
        capture_ns=instant_from(p.capture_low, p.capture_high),
        box=box,
        reason=reason,
        position_v_m=point_from(
            (p.position_x, p.position_y, p.position_z),
            (p.position_x_part, p.position_y_part, p.position_z_part),
        ),
        rotation_v_c2=rotation_from("rotation", (p.rotation_x, p.rotation_y, p.rotation_z)),
        sigma_m=sigma_from(p.sigma),
    )


def _three(name: str, values: Vec3, scale: float, limit: int) -> tuple[int, int, int]:
    x, y, z = values
    return (
        scaled(name, x, scale, -limit, limit),
        scaled(name, y, scale, -limit, limit),
        scaled(name, z, scale, -limit, limit),
    )


def _status_to(m: Status) -> Numbers:
    if not math.isfinite(m.yaw_rad):
        raise OutOfRange(f"yaw_rad = {m.yaw_rad} is not finite")
    flags = (
        dialect.PATH_FLAG_RESPONSIBLE * m.responsible | dialect.PATH_FLAG_OBSERVING * m.observing
    )
    flags |= whole("steps", m.steps, STEPS - 1) << _STEPS_BIT
    low, high = instant_to("stamp_ns", m.stamp_ns)
    instance_high, instance_low = divmod(whole("instance", m.instance, U24), 1 << 16)
    return (
        low,
        *_three("position_n_m", m.position_n_m, _MILLI, I32),
        *_three("velocity_n_mps", m.velocity_n_mps, _CENTI, I16),
        scaled("yaw_rad", math.remainder(m.yaw_rad, math.tau), _YAW, -I16, I16),
        high,
        instance_low,
        _ROLE_CODE[m.role],
        whole("phase", m.phase, U8),
        flags,
        _UNKNOWN_BATTERY
        if math.isnan(m.battery)
        else scaled("battery", m.battery, _BATTERY, 0, round(_BATTERY)),
        instance_high,
        whole("ended", m.ended, U8),
        *_alike_to(m.alike),
    )


def _alike_to(alike: Alike | None) -> Numbers:
    if alike is None:
        return (0,) * len(_ALIKE)
    return tuple(whole(name, getattr(alike, name), U16) for name in _ALIKE)


def _alike_from(p: Any) -> Alike | None:
    """None for a Status that ends before these fields, as an older version of PATH sends it."""
    return Alike(*(getattr(p, name) for name in _ALIKE)) if p.dialect else None


def _status_from(p: Any) -> Status:
    role = _ROLE.get(p.role)
    known = p.battery != _UNKNOWN_BATTERY
    if role is None or (known and p.battery > _BATTERY) or abs(p.yaw) > math.pi * _YAW + 1.0:
        raise OutOfRange(f"role = {p.role}, battery = {p.battery}, yaw = {p.yaw}")
    return Status(
        role=role,
        stamp_ns=instant_from(p.stamp_low, p.stamp_high),
        position_n_m=(p.north / _MILLI, p.east / _MILLI, p.down / _MILLI),
        velocity_n_mps=(p.v_north / _CENTI, p.v_east / _CENTI, p.v_down / _CENTI),
        yaw_rad=p.yaw / _YAW,
        phase=p.phase,
        responsible=bool(p.flags & dialect.PATH_FLAG_RESPONSIBLE),
        observing=bool(p.flags & dialect.PATH_FLAG_OBSERVING),
        battery=p.battery / _BATTERY if known else math.nan,
        instance=p.instance_low + (p.instance_high << 16),
        steps=p.flags >> _STEPS_BIT,
        ended=p.ended,
        alike=_alike_from(p),
    )


def _ping_to(m: Ping) -> Numbers:
    return whole("sent_ns", m.sent_ns, U64), whole("nonce", m.nonce, U32)


def _pong_to(m: Pong) -> Numbers:
    return (
        whole("ping_sent_ns", m.ping_sent_ns, U64),
        whole("received_ns", m.received_ns, U64),
        whole("sent_ns", m.sent_ns, U64),
        whole("nonce", m.nonce, U32),
    )


def _commit_to(m: Commit) -> Numbers:
    return whole("lease_end_ns", m.lease_end_ns, U64), *_answer_fields(m)


def _answer_fields(m: Commit | Accept | Confirm) -> tuple[int, int, int, int, int, int]:
    return (
        whole("stamp_ns", m.stamp_ns, U64),
        whole("nonce", m.nonce, U32),
        whole("instance", m.instance, U24),
        whole("handoff_id", m.handoff_id, U16),
        whole("epoch", m.epoch, U16),
        whole("target_id", m.target_id, U8),
    )


def _abort_to(m: Abort) -> Numbers:
    return (
        whole("stamp_ns", m.stamp_ns, U64),
        whole("instance", m.instance, U24),
        whole("handoff_id", m.handoff_id, U16),
        whole("epoch", m.epoch, U16),
        _ABORT_CODE[m.reason],
    )


def _abort_from(p: Any) -> Abort:
    reason = _ABORT.get(p.reason)
    if reason is None:
        raise OutOfRange(f"reason = {p.reason} is unknown")
    return Abort(p.handoff_id, p.epoch, reason, p.stamp_ns, _instance(p))


def _instance(p: Any) -> int:
    if p.instance > U24:
        raise OutOfRange(f"instance = {p.instance} is outside 0..{U24}")
    return int(p.instance)


def _part_to(m: KeyframePart) -> Numbers:
    if len(m.data) != PART_BYTES:
        raise OutOfRange(f"data = {len(m.data)} bytes, not {PART_BYTES}")
    low, high = instant_to("capture_ns", m.capture_ns)
    return (
        low,
        *rotation_to("rotation_n_c", m.rotation_n_c),
        sigma_to(m.patch_m),
        high,
        whole("corners", m.corners, U8),
        whole("number", m.number, U8),
        *m.data,
    )


def _part_from(p: Any) -> KeyframePart:
    return KeyframePart(
        capture_ns=instant_from(p.capture_low, p.capture_high),
        rotation_n_c=rotation_from("rotation", (p.rotation_x, p.rotation_y, p.rotation_z)),
        patch_m=sigma_from(p.patch),
        corners=p.corners,
        number=p.number,
        data=bytes(p.data),
    )


TO_WIRE: dict[type[Message], Callable[[Any], Numbers]] = {
    Target: _target_to,
    Candidate: _candidate_to,
    Status: _status_to,
    Ping: _ping_to,
    Pong: _pong_to,
    Commit: _commit_to,
    Accept: _answer_fields,
    Confirm: _answer_fields,
    Abort: _abort_to,
    KeyframePart: _part_to,
}
"""A message's numbers, in the order in which they are sent."""

KINDS: dict[type[Message], type[Any]] = {
    Target: dialect.MAVLink_path_target_message,
    Candidate: dialect.MAVLink_path_candidate_message,
    Status: dialect.MAVLink_path_status_message,
    Ping: dialect.MAVLink_path_ping_message,
    Pong: dialect.MAVLink_path_pong_message,
    Commit: dialect.MAVLink_path_commit_message,
    Accept: dialect.MAVLink_path_accept_message,
    Confirm: dialect.MAVLink_path_confirm_message,
    Abort: dialect.MAVLink_path_abort_message,
    KeyframePart: dialect.MAVLink_path_keyframe_message,
}


def _named(kind: type[Any]) -> Callable[[Sequence[int]], Any]:
    """Return what names the numbers of a message; an array, which stands last, is one field."""
    names = kind.ordered_fieldnames
    make = namedtuple(kind.__name__, names)._make  # pyright: ignore[reportUntypedNamedTuple]
    if kind.array_lengths[-1] == 0:
        return make
    single = len(names) - 1
    return lambda numbers: make((*numbers[:single], numbers[single:]))


NAMED: dict[type[Any], Callable[[Sequence[int]], Any]] = {
    kind: _named(kind) for kind in KINDS.values()
}
"""Gives numbers that came, in the order in which they were sent, the dialect's names, as
``FROM_WIRE`` takes them.
"""

FROM_WIRE: dict[type[Any], Callable[[Any], Message]] = {
    dialect.MAVLink_path_target_message: _target_from,
    dialect.MAVLink_path_candidate_message: _candidate_from,
    dialect.MAVLink_path_status_message: _status_from,
    dialect.MAVLink_path_ping_message: lambda p: Ping(p.nonce, p.sent_ns),
    dialect.MAVLink_path_pong_message: lambda p: Pong(
        p.nonce, p.ping_sent_ns, p.received_ns, p.sent_ns
    ),
    dialect.MAVLink_path_commit_message: lambda p: Commit(
        p.handoff_id, p.epoch, p.target_id, p.nonce, p.lease_end_ns, p.stamp_ns, _instance(p)
    ),
    dialect.MAVLink_path_accept_message: lambda p: Accept(
        p.handoff_id, p.epoch, p.target_id, p.nonce, p.stamp_ns, _instance(p)
    ),
    dialect.MAVLink_path_confirm_message: lambda p: Confirm(
        p.handoff_id, p.epoch, p.target_id, p.nonce, p.stamp_ns, _instance(p)
    ),
    dialect.MAVLink_path_abort_message: _abort_from,
    dialect.MAVLink_path_keyframe_message: _part_from,
}
